"""Where tests find what is not beside them."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
REFERENCE = ROOT / "tests" / "reference"
SHARED_DATA = Path(os.environ.get("GONIO_SHARED_DATA", ROOT / ".." / "shared" / "data"))
"""Measured data that are not part of the project; tests that need them skip where they are missing."""
