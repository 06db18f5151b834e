"""Fitting a model to a measurement table: data, parameters, what is made small, the search, and what it says."""
