"""Zemax's tabular BSDF: angles about the mirror direction, turned into directions of the sample."""

import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError

FILE = """# a comment
Source\tMeasured
Symmetry\tPlaneSymmetrical
SpectralContent\tMonochrome
ScatterType\tBRDF
SampleRotation\t1
0
AngleOfIncidence\t2
0\t30
ScatterAzimuth\t3
0\t90\t180
ScatterRadial\t3
0\t30\t70

Monochrome
DataBegin
TIS\t0.1
9.0\t1.0\t0.5
9.0\t1.1\t0.5
9.0\t1.2\t0.0
TIS\t0.2
8.0\t2.0\t0.6
8.0\t2.1\t0.7
8.0\t2.2\t0.0
DataEnd
"""


def value(frame: pd.DataFrame, theta_i: float, theta_r: float, dphi: float) -> float:
    chosen = (frame["theta_i_deg"] == theta_i) & (frame["theta_r_deg"] == theta_r) & (frame["phi_r_deg"] == dphi)
    return float(frame.loc[chosen, "brdf"].item())


def test_radial_zero_is_the_mirror_and_azimuth_zero_points_to_the_normal() -> None:
    frame = measurement.parse(FILE.encode(), Path("black.bsdf"))
    assert value(frame, 30, 30, 180) == 8.0
    assert value(frame, 30, 0, 180) == 2.0  # 30 degrees inward from the mirror is the normal
    assert value(frame, 30, 40, 0) == 0.6  # 70 inward: across the normal, on the retro side
    assert (value(frame, 30, 60, 180), value(frame, 0, 30, 0)) == (2.2, 1.0)
    # 70 degrees outward of 30 is below the surface, and gone; at normal incidence a zero there was not measured
    assert (len(frame), frame.loc[frame["flag"] == "not_measured", "theta_i_deg"].tolist()) == (7 + 6, [0.0])


def test_btdf_is_about_the_straight_direction() -> None:
    frame = measurement.parse(FILE.replace("ScatterType\tBRDF", "ScatterType\tBTDF").encode(), Path("opal.bsdf"))
    assert set(frame["side"]) == {"transmission"}
    assert value(frame, 30, 150, 180) == 8.0  # radial 0: straight through, theta_r = 180 - theta_i
    assert value(frame, 30, 180, 180) == 2.0  # 30 degrees inward: the normal of the back
    assert value(frame, 30, 140, 0) == 0.6  # 70 inward: across that normal


def test_tristimulus_values_are_three_samples() -> None:
    head, block = FILE.replace("SpectralContent\tMonochrome", "SpectralContent\tXYZ").split("\nMonochrome\n")
    text = head + "".join(f"\nTristimulus{c}\n{block.replace('8.0', n)}" for c, n in zip("XYZ", "567", strict=True))
    frame = measurement.parse(text.encode(), Path("red.bsdf"))
    assert frame.attrs["samples"] == ["red X", "red Y", "red Z"]
    assert [value(part, 30, 30, 180) for _, part in frame.groupby("sample")] == [5.0, 6.0, 7.0]
    with pytest.raises(DataError, match=r'red\.bsdf, line 27: "TristimulusZ" where TristimulusY is needed'):
        measurement.parse(text.replace("TristimulusY", "TristimulusZ").encode(), Path("red.bsdf"))


def test_round_trip_of_transmission(tmp_path: Path) -> None:
    frame = measurement.parse(FILE.replace("ScatterType\tBRDF", "ScatterType\tBTDF").encode(), Path("opal.bsdf"))
    measurement.write(frame, tmp_path / "opal.bsdf")
    pd.testing.assert_frame_equal(measurement.read(tmp_path / "opal.bsdf"), frame)
    both = pd.concat([frame, frame.assign(theta_r_deg=180 - frame["theta_r_deg"], side="reflection")])
    both = both.reset_index(drop=True)
    both.attrs = frame.attrs
    with pytest.raises(DataError, match="reflection or transmission, and this table has both"):
        measurement.write(both, tmp_path / "both.bsdf")


def test_round_trip(tmp_path: Path) -> None:
    frame = measurement.parse(FILE.encode(), Path("black.bsdf"))
    frame["wavelength_nm"] = 650.0
    measurement.write(frame, tmp_path / "a.bsdf")
    pd.testing.assert_frame_equal(measurement.read(tmp_path / "a.bsdf"), frame, check_exact=True)


def test_a_table_that_is_no_such_grid_is_refused(tmp_path: Path, small: pd.DataFrame) -> None:
    one = small[small["wavelength_nm"] == 500].reset_index(drop=True)
    with pytest.raises(DataError, match="grid"):
        measurement.write(one, tmp_path / "a.bsdf")
    with pytest.raises(DataError, match="one wavelength"):
        measurement.write(small, tmp_path / "a.bsdf")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("BRDF", "BSDF", 'line 5: ScatterType is "BSDF"'),
        ("\nMonochrome", "\nTristimulusX", 'line 15: "TristimulusX" where Monochrome'),
        ("0\t30\n", "30\t0\n", "line 9: AngleOfIncidence has to grow"),
        ("0\t30\t70", "0\t30", "line 13: 2 angles, and ScatterRadial counts 3"),
        ("9.0\t1.1\t0.5\n", "9.0\t1.1\n", "line 19: 2 values"),
        ("DataEnd", "", "line 25: the file ends before DataEnd"),
    ],
)
def test_damage_is_located(old: str, new: str, told: str) -> None:
    with pytest.raises(DataError, match=re.escape(f"black.bsdf, {told}")):
        measurement.parse(FILE.replace(old, new, 1).encode(), Path("black.bsdf"))


def test_damaged_files(survives: Callable[..., None]) -> None:
    survives(FILE.encode(), "black.bsdf")
    three = "".join(f"\nTristimulus{c}\n" + FILE.split("\nMonochrome\n")[1] for c in "XYZ")
    survives((FILE.split("\nMonochrome\n")[0].replace("Monochrome", "XYZ") + three).encode(), "red.bsdf")


def test_a_published_file_and_the_same_data_in_sample_angles(shared: Callable[[str], Path], tmp_path: Path) -> None:
    """The laboratory published the same measurement also by theta and phi of the sample, in FRED's format."""
    folder = shared("loft_rt300s")
    frame = measurement.read(folder / "processed_zemax" / "AnoBlackEC1onAlum.bsdf")
    for theta_i, peak in ((10, 0.034800), (30, 0.04202), (50, 0.09325), (70, 1.234)):
        assert value(frame, theta_i, theta_i, 180) == pytest.approx(peak, rel=1e-3)  # four digits in the file
    fred: dict[float, float] = {}
    lines = (folder / "processed_fred" / "AnoBlackEC1onAlum.txt").read_text().splitlines()
    start = next(k for k, line in enumerate(lines) if line.split() == ["50", "0"])
    for theta_r, phi_r, brdf in (line.split() for line in lines[start + 1 :] if len(line.split()) == 3):
        if phi_r == "0":
            fred.setdefault(float(theta_r), float(brdf))
    # at 50 degrees the lobe doubles outward of the mirror and falls inward of it; the grid about the mirror is the
    # laboratory's interpolation of scattered points, within 8 % of the ones that it published beside it
    assert fred[60] > 1.5 * fred[40]
    for view in (30.0, 40.0, 60.0, 70.0):
        assert value(frame, 50, view, 180) == pytest.approx(fred[view], rel=0.08)
    measurement.write(frame, tmp_path / "a.bsdf")
    pd.testing.assert_frame_equal(measurement.read(tmp_path / "a.bsdf"), frame, check_exact=True)
