"""Speos surface files in text: tables about the normal, scaled by a percentage."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError
from gonio.formats.speos import hemisphere

ANISOTROPIC = """OPTIS - Anisotropic BSDF surface file v8.0
0
a comment
10
two
lines.
0\t1\t0
1\t0
1
1
0.0\t
2
20.0\t50.0\t
20.0\t0

2
350\t50
850\t50
2 3
\t0.0\t180.0\t360.0
0.0\t3\t3\t3
90.0\t3\t3\t3
3 2
\t0.0\t180.0
0.0\t2\t2
50.0\t9\t1
90.0\t0\t0
End of file
"""
BRDF = """OPTIS - brdf surface file v8.0
0
a comment
0

1\t1
0
1\t2
30
500\t600
25
2\t1
\t0
0\t1
60\t1
50
2\t1
\t0
0\t4
60\t4
10
2\t1
\t0
120\t1
180\t1
20
2\t1
\t0
120\t1
180\t1
"""


def parse(text: str, name: str = "paint.anisotropicbsdf") -> pd.DataFrame:
    return measurement.parse(text.encode(), Path(name))


def test_an_integral_is_that_of_what_is_linear_in_between() -> None:
    theta, phi = np.array([0.0, 90.0]), np.array([0.0, 180.0, 360.0])
    assert hemisphere(theta, phi, np.full((2, 3), 1.0)) == pytest.approx(math.pi, rel=1e-15)
    falling = np.array([[1.0] * 3, [0.0] * 3])  # 1 - theta / 90 degrees: pi/2 by hand
    assert hemisphere(theta, phi, falling) == pytest.approx(math.pi / 2, rel=1e-14)
    assert hemisphere(theta + 90, phi, falling[::-1]) == pytest.approx(math.pi / 2, rel=1e-14)
    assert hemisphere(theta, phi[:1], falling[:, :1]) == hemisphere(theta, phi[:2], falling[:, :2])


def test_values_are_scaled_to_the_percentage_and_azimuth_zero_is_the_mirror() -> None:
    frame = parse(ANISOTROPIC)
    assert frame["wavelength_nm"].isna().all()  # equal percentages: one band
    first = frame[frame["theta_i_deg"] == 20]
    assert first["brdf"].tolist() == pytest.approx([0.5 / math.pi] * 3, rel=1e-14)  # 50 % of a constant
    assert first["theta_r_deg"].tolist() == [0.0, 90.0, 90.0]  # the pole once, and 360 degrees is 0
    second = frame[frame["theta_i_deg"] == 50]
    assert ((second["phi_r_deg"] - second["phi_i_deg"]) % 360).tolist() == [180.0, 180.0, 0.0, 180.0, 0.0]
    assert second["brdf"].tolist() == pytest.approx([v / 6 / math.pi for v in (2, 9, 1, 0, 0)], rel=1e-14)


def test_a_table_of_a_brdf_file_has_its_own_percentage_and_intensities_are_divided_by_the_cosine() -> None:
    frame = parse(BRDF, "paint.brdf")
    assert frame.attrs["format"] == "speos"
    # intensity 1 from 0 to 60 degrees is 1 at the normal and 2 at 60; linear in between, by hand:
    third = math.pi / 3
    moment = math.sin(2 * third) / 8 - third * math.cos(2 * third) / 4
    integral = 2 * math.pi * (math.sin(third) ** 2 / 2 + moment / third)
    expected = {500.0: 0.25, 600.0: 0.5}
    for nm, share in expected.items():
        lit = frame[(frame["wavelength_nm"] == nm) & (frame["side"] == "reflection")]
        assert lit["brdf"].tolist() == pytest.approx([share / integral, 2 * share / integral], rel=1e-12)
    through = frame[(frame["side"] == "transmission") & (frame["wavelength_nm"] == 600)]
    assert through["theta_r_deg"].tolist() == [120.0, 180.0]
    assert through["brdf"].tolist() == pytest.approx([0.4 / integral, 0.2 / integral], rel=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("v8.0", "v3.0", 'line 1: "OPTIS - Anisotropic BSDF surface file v3.0"; read are'),
        ("v8.0\n0\n", "v8.0\n1\n", "line 2: is a binary Speos file"),
        ("1\t0\n1\n", "0\t0\n1\n", "line 8: holds neither reflection nor transmission"),
        ("2 3\n", "2 99999999\n", "line 19: a table of 2 x 99999999; at most"),
        ("0.0\t180.0\t360.0", "0.0\t180.0", "line 20: 2 numbers; azimuths of a table needs 3"),
        ("90.0\t3\t3\t3", "95.0\t3\t3\t3", "line 22: theta of reflection has to grow within [0, 90]"),
        ("50.0\t9\t1", "50.0\t9\t-1", "line 27: the table that ends here has values below zero"),
        ("50.0\t9\t1", "50.0\t9\tx", 'line 26: theta and its values is "x", not a number'),
        ("90.0\t0\t0\nEnd of file\n", "", "line 26: the file ends before theta and its values"),
    ],
)
def test_damage_is_located(old: str, new: str, told: str) -> None:
    with pytest.raises(DataError, match=re.escape(f"paint.anisotropicbsdf, {told}")):
        parse(ANISOTROPIC.replace(old, new, 1))


def test_damaged_files(survives: Callable[..., None]) -> None:
    survives(ANISOTROPIC.encode(), "paint.anisotropicbsdf")
    survives(BRDF.encode(), "paint.brdf", format="speos")


@pytest.mark.parametrize(("text", "name"), [(ANISOTROPIC, "a.anisotropicbsdf"), (BRDF, "b.brdf")])
def test_round_trip(text: str, name: str, tmp_path: Path) -> None:
    frame = parse(text, name)
    measurement.write(frame, tmp_path / name, format="speos")
    again = measurement.read(tmp_path / name)
    pd.testing.assert_frame_equal(again, frame, rtol=1e-14)  # a percentage and its division


def test_what_a_file_cannot_hold_is_refused(tmp_path: Path) -> None:
    frame = parse(BRDF, "b.brdf")
    with pytest.raises(DataError, match="has one shape for all wavelengths"):
        measurement.write(frame, tmp_path / "a.anisotropicbsdf")
    with pytest.raises(DataError, match=r"a wavelength in each row; name it \.anisotropicbsdf"):
        measurement.write(parse(ANISOTROPIC), tmp_path / "a.brdf", format="speos")
    holes = parse(ANISOTROPIC).drop(index=[1]).reset_index(drop=True)
    holes.attrs = frame.attrs
    with pytest.raises(DataError, match="1 of 4 values are missing"):
        measurement.write(holes, tmp_path / "a.anisotropicbsdf")
    with pytest.raises(DataError, match="no values below zero"):
        measurement.write(frame.assign(brdf=-1.0), tmp_path / "a.anisotropicbsdf")
    assert list(tmp_path.iterdir()) == []
