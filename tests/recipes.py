"""Tables of other laboratories that docs/formats.md says how to read, read as it says."""

import re
from pathlib import Path
from typing import Any

from gonio.formats import own_pairs
from tests.places import ROOT, example, measured

PAGE = ROOT / "docs" / "formats.md"


def infrared_metals(folder: Path) -> Path:
    """The shared table of metals in the infrared, with its columns named beside it."""
    return _made("infrared", "mwir_metals/mwir_inplane_reflected_radiance.csv", folder / "metals.csv")


def reflectance_factors(folder: Path) -> Path:
    """The shared table of reflectance factors, with its columns named beside it."""
    return _made("reflectance_factors", "reflectance_factor_table/two_dimensional_reflectance_factor.csv",
                 folder / "paint.csv")  # fmt: skip


def _made(recipe: str, name: str, out: Path) -> Path:
    steps: dict[str, Any] = {}
    exec(example("tables_of_others.py"), steps)
    steps[recipe](measured(f"brdf/{name}"), out)
    said = re.search(rf"gonio compare {out.name} --columns \\\s+(\S+)", PAGE.read_text(encoding="utf-8"))
    assert said is not None
    own_pairs.remember(out, own_pairs.pairs(said[1]))
    return out
