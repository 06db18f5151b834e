"""`gonio calibrate light`."""

from __future__ import annotations

from gonio.cli.calibrate import app as app
