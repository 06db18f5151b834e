"""Tables [texture.NAME] of a sample file: where what lies, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.errors import ConfigError
from gonio.samples.files import load_sample, shipped_samples
from gonio.samples.textures import SampleTexture

SAMPLE = 'name = "s"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n'


@pytest.mark.parametrize(
    ("keys", "at", "expected"),
    [
        ({"pattern": "edge", "origin_mm": [1, 0]}, [(0.999, 5), (1.0, -5), (3, 0)], [2, 4, 4]),
        ({"pattern": "edge", "azimuth_deg": 90}, [(7, -0.1), (7, 0.1)], [2, 4]),  # u is y
        (
            {"pattern": "gradient", "size_mm": [4, 1], "origin_mm": [1, 0]},
            [(-2, 0), (-1, 0), (0, 3), (1, 3), (3, 0), (4, 0)],
            [2, 2, 2.5, 3, 4, 4],
        ),
        (
            {"pattern": "scratch", "size_mm": [6, 1], "azimuth_deg": 90},
            [(0, 2.9), (0, 3.1), (0.4, -2), (0.6, -2)],
            [4, 2, 4, 2],
        ),
        # halves of a tile are 1 mm: 1 where both halves are alike
        ({"pattern": "checker", "size_mm": [2, 2]}, [(0.5, 0.5), (1.5, 0.5), (-0.5, 0.5), (-0.5, -0.5)], [4, 2, 2, 4]),
        ({"pattern": "stripes", "size_mm": [2, 9], "origin_mm": [0.5, 0]}, [(0.6, 3), (1.6, 3), (0.4, 3)], [4, 2, 2]),
        ({"pattern": "dots", "size_mm": [10, 10]}, [(5, 5), (7.9, 5), (8.1, 5), (-5, 25)], [4, 4, 2, 4]),
    ],
)
def test_patterns_lie_where_origin_azimuth_and_size_say(
    keys: dict[str, Any], at: list[tuple[float, float]], expected: list[float]
) -> None:
    texture = SampleTexture.model_validate({"low": 2.0, "high": 4.0} | keys)
    x, y = np.array(at, dtype=float).T
    np.testing.assert_allclose(texture.values(x, y), expected, rtol=1e-12)  # a rounding of the turned axes


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            '[texture.albdo]\npattern = "edge"\nlow = 0\nhigh = 1',
            r's\.toml: .*texture: there is no number "albdo".*there are albedo',
        ),
        ("[texture.albedo]\nlow = 0\nhigh = 1\nsize_mm = [1, 1]", r"texture\.albedo: a texture needs either file or"),
        ('[texture.albedo]\npattern = "dots"\nlow = 0\nhigh = 1', r"texture\.albedo: size_mm = \[along u, along v\]"),
        ('[texture.albedo]\npattern = "edge"\nlow = 0\nhigh = 1.5', r"\[texture\.albedo\] high: albedo = 1\.5"),
        ('[texture.albedo]\npattern = "edge"\nhigh = 1', r"texture\.albedo\.low is missing"),
        ('[texture.albedo]\npattern = "edges"\nlow = 0\nhigh = 1', r"texture\.albedo\.pattern = 'edges'"),
        (
            '[texture.albedo]\nfile = "no.png"\nlow = 0\nhigh = 1\nsize_mm = [1, 1]',
            r"s\.toml: texture\.albedo\.file = '.*no\.png': there is no such file",
        ),
    ],
)
def test_wrong_textures_are_refused_when_the_file_is_read(tmp_path: Path, table: str, message: str) -> None:
    (tmp_path / "s.toml").write_text(SAMPLE + table)
    with pytest.raises(ConfigError, match=message):
        load_sample(tmp_path / "s.toml")


def test_who_needs_one_model_refuses_textures(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(SAMPLE + '[texture.albedo]\npattern = "edge"\nlow = 0\nhigh = 1')
    assert load_sample(tmp_path / "s.toml").texture
    with pytest.raises(ConfigError, match=r"s\.toml: \[texture\.albedo\]: one model is needed here"):
        load_sample(tmp_path / "s.toml", uniform=True)


def test_shipped_samples_are_read_by_name() -> None:
    assert {"brushed-plate", "two-paints", "rough-gradient"} <= set(shipped_samples())
    for name in shipped_samples():
        assert load_sample(name).texture
    with pytest.raises(ConfigError, match=r"brushd-plate: there is no such file.*brushed-plate"):
        load_sample("brushd-plate")
