"""The values of a run that grows: count rates are kept from choice to choice, the rest is reduced anew."""
