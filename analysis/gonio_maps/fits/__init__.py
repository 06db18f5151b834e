"""A map of values -> a map of fits."""
