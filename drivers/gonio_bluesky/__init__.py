"""Bluesky: a run as documents of its event model, and a rig as its devices (docs/interchange.md)."""

from gonio_bluesky.devices import Devices, devices
from gonio_bluesky.event_documents import Frames, documents
from gonio_bluesky.measuring import Measurement, measurement

__all__ = ["Devices", "Frames", "Measurement", "devices", "documents", "measurement"]
