"""Fits, comparisons, plots and reports."""
