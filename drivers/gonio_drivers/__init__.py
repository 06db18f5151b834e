"""Drivers of laboratory devices, behind the rig interface."""
