"""Plots: each draws on the axes that it is given and returns its artists."""
