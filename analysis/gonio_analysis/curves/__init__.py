"""Curves through a measurement, and what each is normalised by."""
