"""Many models on many samples: which one the data do not reject, and how well its parameters are known."""
