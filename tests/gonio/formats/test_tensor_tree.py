"""Tensor trees: which cell is which pair of directions, of either side, and back again."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError
from gonio.formats import tensor_tree
from gonio.models import Lambert


def tree(data: str, rank: int = 3, direction: str = "Reflection Back", band: str = "Visible") -> bytes:
    block = tensor_tree._BLOCK.format(band=band, direction=direction, letter="R", data=data)
    return tensor_tree._XML.format(product="Blind", rank=rank, blocks=block).encode()


def parse(data: bytes) -> pd.DataFrame:
    return measurement.parse(data, Path("blind.xml"))


ISOTROPIC = "{ {1}{0}{2}{0}{3}{0}{ 41 42 43 44 45 46 47 48 }{0} }"
FOUR = "{" + " ".join(f"{k + 1}" for k in range(16)) + "}"


def test_the_map_of_shirley_and_chiu_keeps_areas_and_its_inverse_undoes_it() -> None:
    axis = (np.arange(40) + 0.5) / 40
    points = np.array([(a, b + 0.003) for a in axis for b in axis])  # off the diagonals, where the map has a kink
    xy = tensor_tree.disk(points)
    np.testing.assert_allclose(tensor_tree.square(xy), points, rtol=0, atol=1e-14)
    corners = [tensor_tree.disk(points + d) for d in ([1e-6, 0.0], [0.0, 1e-6])]
    (ax, ay), (bx, by) = ((corner - xy).T / 1e-6 for corner in corners)
    np.testing.assert_allclose(ax * by - ay * bx, math.pi, rtol=1e-4)  # a disk has the area pi; steps of 1e-6
    # by hand: a = 1/2, b = 1/4 on [-1, 1]: r = 1/2, phi = pi/8
    expected = [0.5 * math.cos(math.pi / 8), 0.5 * math.sin(math.pi / 8)]
    np.testing.assert_allclose(tensor_tree.disk(np.array([[0.75, 0.625]]))[0], expected, rtol=1e-15)


def test_branches_have_the_first_coordinate_in_the_lowest_bit_and_grids_have_it_slowest() -> None:
    frame = parse(tree(ISOTROPIC))
    assert (frame.attrs["format"], frame.attrs["samples"]) == ("tensor-tree", ["Blind back Visible"])
    assert set(frame["phi_i_deg"]) == {180.0}
    sines = np.sin(np.deg2rad(frame["theta_i_deg"].to_numpy())).round(9).tolist()
    azimuths = frame["phi_r_deg"].round(6).tolist()
    found = set(zip(frame["brdf"].to_numpy(np.float64).tolist(), sines, azimuths, strict=True))
    # coarse branches 0, 2, 4: first coordinate 1/4, so that sin theta_i = 1/2; the others in three quadrants
    assert {(1.0, 0.5, 225.0), (2.0, 0.5, 315.0), (3.0, 0.5, 135.0)} <= found
    # the fourth branch is a grid: first coordinates 1/8 and 3/8, sin theta_i = 3/4 and 1/4
    assert {(value, sine) for value, sine, _ in found if value > 40} == {
        *((float(v), 0.75) for v in (41, 42, 43, 44)),
        *((float(v), 0.25) for v in (45, 46, 47, 48)),
    }
    assert len(frame) == 3 + 8  # the upper half of the first coordinate is not used


def test_light_goes_on_in_the_mirror_direction_and_the_front_is_seen_from_its_own_side() -> None:
    back, front = (parse(tree(FOUR, 4, f"Reflection {side}")) for side in ("Back", "Front"))
    assert (len(back), back["theta_i_deg"].nunique()) == (16, 1)
    by_value = back.set_index("brdf")
    # values 1, 6, 11 and 16: both coordinates in one quadrant; light travels there, and is mirrored there
    # azimuths beyond a turn are rounded to ten digits behind the point, 5e-11 each
    for value in (1, 6, 11, 16):
        row = by_value.loc[value]
        assert (row["phi_r_deg"] - row["phi_i_deg"]) % 360 == pytest.approx(180.0, abs=1e-9)
    np.testing.assert_allclose((front["phi_r_deg"] + back["phi_r_deg"]) % 360, 0.0, atol=1e-9)
    through = parse(tree(FOUR, 4, "Transmission Back"))
    # the same cells, and the same subtraction
    np.testing.assert_allclose(through["theta_r_deg"], 180.0 - back["theta_r_deg"], rtol=0, atol=0)
    assert set(through["side"]) == {"transmission"}


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (tree("{ 1 2 3 }"), "3 numbers; a power of 8 is needed"),
        (tree("{ {1}{2} }"), "2 branches and 0 numbers; 8 branches are needed"),
        (tree("{ 1 } { 2 }"), "a second tree"),
        (tree("{ 1"), "is no whole tree"),
        (tree("1 }"), "a bracket closes that did not open"),
        (tree("{ x }"), 'a value is "x", not a number'),
        (tree("{" * 40), "more than 12 levels"),
        (tree("{ 1 }").replace(b"TensorTree3", b"TensorTree9"), 'IncidentDataStructure is "TensorTree9"'),
        (tree("{ 1 }").replace(b"Shirley", b"Klems"), 'AngleBasis is "LBNL/Klems-Chiu"'),
        (tree("{ 1 }", direction="Absorption Back"), 'WavelengthDataDirection is "Absorption Back"'),
        (tree("{ 1 }", band="CIE-u"), "holds no block"),
    ],
)
def test_damage_is_located(data: bytes, told: str) -> None:
    with pytest.raises(DataError, match=re.escape(told)):
        measurement.parse(data, Path("blind.xml"), format="tensor-tree")


def test_damaged_files(survives: Callable[..., None]) -> None:
    survives(tree(ISOTROPIC), "blind.xml", format="tensor-tree")


@pytest.mark.parametrize(
    "data",
    [tree(ISOTROPIC), tree("{ 0.3 }"), tree(FOUR, 4, "Transmission Front"), tree("{ {1}{2}" + "{3}" * 14 + "}", 4)],
)
def test_round_trip(data: bytes, tmp_path: Path) -> None:
    frame = parse(data)
    measurement.write(frame, tmp_path / "a.xml", format="tensor-tree")
    again = measurement.read(tmp_path / "a.xml")
    order = ["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"]
    before, after = (f.assign(place=f[order].round(6).apply(tuple, axis=1)).set_index("place") for f in (frame, again))
    assert before["brdf"].to_dict() == after["brdf"].to_dict()
    assert again.attrs["samples"] == frame.attrs["samples"]


def test_other_directions_are_refused(small: pd.DataFrame, tmp_path: Path) -> None:
    usable = small[(small["flag"] == "") & (small["wavelength_nm"] == 500)].reset_index(drop=True)
    with pytest.raises(DataError, match="no centres of a tensor tree's cells"):
        measurement.write(usable, tmp_path / "a.xml", format="tensor-tree")
    with pytest.raises(DataError, match="no room for polarised or flagged"):
        measurement.write(small, tmp_path / "a.xml", format="tensor-tree")
    assert list(tmp_path.iterdir()) == []


def test_a_model_is_written_for_renderers(tmp_path: Path) -> None:
    tensor_tree.write_model(Lambert(albedo=0.5), "half", tmp_path / "half.xml")
    frame = measurement.read(tmp_path / "half.xml")
    assert len(frame) == 32 * 64 * 64
    np.testing.assert_allclose(frame["brdf"], 0.5 / math.pi, rtol=1e-5)  # six digits in the file
