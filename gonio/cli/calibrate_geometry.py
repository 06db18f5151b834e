"""`gonio calibrate geometry`."""

from __future__ import annotations

from gonio.cli.calibrate import app as app
