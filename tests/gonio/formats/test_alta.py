"""ALTA text: coordinates in radians, the cosine taken out, directions kept when written."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError

TAPE = """#SAMPLE "Tape"
#DIM 3 1
#VS 0
#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI
#PARAM_OUT INV_STERADIAN_COSINE_FACTOR
0.523598775598298815 0.523598775598298815 0.0 0.75
0.523598775598298815 -1.047197551196597631 1.3e-16 0.25
0.523598775598298815 0.0 0.785398163397448279 0.10
0.000000000000000000 0.0 0.0 0.3
"""


def test_projected_coordinates_and_the_cosine() -> None:
    frame = measurement.parse(TAPE.encode(), Path("tape.dat"))
    assert frame["theta_i_deg"].tolist() == [30.0, 30.0, 30.0, 0.0]
    assert frame["theta_r_deg"].tolist() == [30.0, 60.0, 45.0, 0.0]
    assert frame["phi_r_deg"].tolist() == [0.0, 180.0, 90.0, 0.0]  # 0 is retro
    cosine = math.cos(math.pi / 6)
    np.testing.assert_allclose(frame["brdf"], [0.75 / cosine, 0.25 / cosine, 0.1 / cosine, 0.3], rtol=1e-14)
    assert frame["wavelength_nm"].isna().all()
    assert frame.attrs["sample"] == "Tape"


def test_other_coordinates() -> None:
    text = (
        TAPE.replace("TL_TV_PROJ_DPHI", "TV_TL_DPHI")
        .replace("_COSINE_FACTOR", "")
        .replace("-1.047197551196597631", "0.5")
    )
    frame = measurement.parse(text.encode(), Path("tape.dat"))
    assert (frame["theta_r_deg"].iloc[0], frame["brdf"].tolist()) == (30.0, [0.75, 0.25, 0.1, 0.3])


def test_round_trip(tmp_path: Path, small: pd.DataFrame) -> None:
    small["flag"] = ""
    measurement.write(small, tmp_path / "a.dat")
    pd.testing.assert_frame_equal(measurement.read(tmp_path / "a.dat"), small, check_exact=True)
    small["wavelength_nm"] = np.nan
    broad = small.drop_duplicates(["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"], ignore_index=True)
    measurement.write(broad, tmp_path / "b.dat")
    pd.testing.assert_frame_equal(measurement.read(tmp_path / "b.dat"), broad, check_exact=True)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("ISOTROPIC_TL_TV_PROJ_DPHI", "RUSIN_TH_TD_PD", 'tape.dat: #PARAM_IN is "RUSIN_TH_TD_PD"'),
        ("#DIM 3 1", "#DIM 3 3", "tape.dat: 3 values a line, and 0 wavelengths"),
        ("#DIM 3 1", "#DIM 4 1", "tape.dat: #DIM 4 1"),
        ("0.25\n", "\n", "tape.dat, line 7: 3 numbers"),
        ("-1.047197551196597631", "-2.0", "tape.dat, line 7: the viewer stands at 114.592 degrees"),
        ("0.10\n", "0.1O\n", 'tape.dat, line 8: value 1 is "0.1O"'),
    ],
)
def test_damage_is_located(old: str, new: str, told: str) -> None:
    with pytest.raises(DataError, match=re.escape(told)):
        measurement.parse(TAPE.replace(old, new).encode(), Path("tape.dat"))


def test_damaged_files(survives: Callable[..., None]) -> None:
    survives(TAPE.encode(), "tape.dat")
