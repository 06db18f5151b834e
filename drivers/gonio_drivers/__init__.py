"""Drivers of laboratory devices, behind the rig interface."""

import logging

log = logging.getLogger("gonio.devices")
"""What all drivers say by it during a measurement goes into the run's journal."""
