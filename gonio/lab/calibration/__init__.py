"""Calibrations of a rig: measured values of its rig file, with their covariance."""
