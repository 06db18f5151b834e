"""Access to the reference vectors in tests/reference (see its README): exact inputs, outputs as strings of up to 30
digits.
"""

import json
from typing import Any

from tests.places import REFERENCE


def cases(name: str) -> list[dict[str, Any]]:
    return json.loads((REFERENCE / f"{name}_public.json").read_text())["cases"]
