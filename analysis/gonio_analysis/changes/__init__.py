"""Measurements, files or models compared point by point; laboratories compared with each other."""
