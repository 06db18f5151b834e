"""A run's frames -> a map of values."""
