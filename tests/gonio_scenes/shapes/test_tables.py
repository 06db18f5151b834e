"""Bad input: one message that names the key or the file, and what to do."""

from typing import Any

import pytest
from gonio_scenes.shapes import AnyShape

from gonio.config import Strict, parse
from gonio.errors import ConfigError
from tests.gonio_scenes.shapes.solids import shape


class Scene(Strict):
    shape: list[AnyShape]


def refusal(**keys: Any) -> str:
    with pytest.raises(ConfigError) as told:
        parse(Scene, {"shape": [{"material": "white", **keys}]}, "scene.toml")
    return str(told.value)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"kind": "sphere"}, "radius_mm is missing"),
        ({"kind": "sphere", "radius_mm": -1}, "radius_mm = -1: must be greater than 0"),
        ({"kind": "sphere", "radius_mm": float("nan")}, "radius_mm = nan"),
        ({"kind": "sphere", "radius_mm": 1e12}, "less than or equal to 1000000000"),
        ({"kind": "sphere", "radius_mm": 1, "axis": [0, 0, 0]}, "is no direction"),
        ({"kind": "sphere", "radius_mm": 1, "center_mm": [0, 0]}, "center_mm"),
        ({"kind": "sphere", "radius_mm": 1, "radius": 1}, "unknown key shape[1].radius; did you mean"),
        ({"kind": "disc", "radius_mm": 1, "normal": [0, 0, 0]}, "is no direction"),
        ({"kind": "disc", "radius_mm": 1, "normal": [0, 0, 2], "x_axis": [0, 0, -1]}, "parallel to normal"),
        ({"kind": "box", "size_mm": [1, 2, 3], "axis": [1, 1, 0], "x_axis": [2, 2, 0]}, "parallel to axis"),
        ({"kind": "box", "size_mm": [1, 0, 3]}, "size_mm[2] = 0"),
        ({"kind": "cylinder", "radius_mm": 1}, "height_mm is missing"),
        ({"kind": "plane", "tile_mm": [1, -1]}, "tile_mm[2] = -1"),
        ({"kind": "revolution", "profile_mm": [[1, 2]]}, "must hold at least 2, and holds 1"),
        ({"kind": "revolution", "profile_mm": [[1, 2], [-0.5, 3]]}, "profile_mm[2] has r = -0.5"),
        ({"kind": "revolution", "profile_mm": [[1, 2], [1, 2]]}, "[1] and [2] are one point"),
        ({"kind": "revolution", "profile_mm": [[0, 2], [0, 3]]}, "lies on the axis"),
        (
            {"kind": "revolution", "profile_mm": [[0, 0], [10, 0], [10, 10], [5, 5], [12, 5], [0, 20]]},
            "profile_mm crosses itself between [2], [3] and [4], [5]",
        ),
        ({"kind": "mesh", "file": "a.obj"}, "kind"),
        ({"kind": "spere", "radius_mm": 1}, "kind"),
    ],
)
def test_a_wrong_key_is_named(keys: dict[str, Any], says: str) -> None:
    text = refusal(**keys)
    assert says in text
    assert text.startswith("scene.toml: ")
    assert "\n" not in text


def test_a_smooth_profile_that_crosses_the_axis_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"profile_mm: the smooth curve crosses the axis near point \d"):
        shape("revolution", profile_mm=[[30, 0], [0.1, 10], [0.1, 30], [30, 40]], smooth=True)
