"""Scene files of tests, as tables."""

import copy
from pathlib import Path
from typing import Any

from gonio_scenes.render import Picture, render
from gonio_scenes.scene import Scene, SceneFile, build

from gonio.config import parse

SPHERE: dict[str, Any] = {
    "name": "a sphere",
    "wavelength_nm": [550.0],
    "camera": {
        "position_mm": [0.0, 0.0, 1000.0],
        "look_at_mm": [0.0, 0.0, 0.0],
        "vertical_field_deg": 6.0,
        "width": 48,
        "height": 40,
    },
    "shape": [{"kind": "sphere", "center_mm": [0.0, 0.0, 0.0], "radius_mm": 40.0, "material": "m"}],
    "material": {"m": {"model": "lambert", "parameters": {"albedo": 0.7}}},
    "light": [{"kind": "directional", "toward": [1.0, 0.5, 2.0], "irradiance": 3.0}],
}


def tables(**changes: Any) -> dict[str, Any]:
    """The tables of `SPHERE` with some of them changed."""
    return copy.deepcopy(SPHERE) | changes


def scene(folder: Path = Path(), **changes: Any) -> Scene:
    """The scene of `tables`."""
    return build(parse(SceneFile, tables(**changes), "scene.toml"), folder / "scene.toml")


def rendered(folder: Path = Path(), **changes: Any) -> Picture:
    """The picture of `scene`."""
    return render(scene(folder, **changes))
