"""Text files of pab's gonio-photometers, one incidence or several."""

import math
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError
from gonio.formats import of_content

HEAD = '#data written by hand\n#sample_name "white paint"\n#intheta\t30\n#inphi 180\n#format: theta phi DSF\n'
ONE = HEAD + "30.0\t0.0\t0.5\r\n60 0 0.1\n60 90 0.05\n120 0 0.3\n90 0 0.0\n"
SECOND = "#format: theta phi BSDF\n#incident_angle 60 180\n30 0 0.25\n60.0 0 1.5e0\n"


def parse(text: str) -> pd.DataFrame:
    return measurement.parse(text.encode(), Path("white.dat"))


def test_directions_leave_the_surface_and_dsf_is_divided_by_the_cosine() -> None:
    frame = measurement.parse(ONE.encode(), Path("white.dat"))
    assert (frame.attrs["format"], frame.attrs["sample"]) == ("pab", "white paint")
    assert frame["theta_i_deg"].unique().tolist() == [30.0]
    assert frame["phi_i_deg"].unique().tolist() == [180.0]  # and phi_r = 0 is the mirror side
    assert frame["theta_r_deg"].tolist() == [30.0, 60.0, 60.0, 90.0]
    assert frame["phi_r_deg"].tolist() == [0.0, 0.0, 90.0, 0.0]
    cosine = math.cos(math.radians(60.0))
    assert frame["brdf"].tolist()[:3] == pytest.approx(
        [0.5 / math.cos(math.radians(30.0)), 0.1 / cosine, 0.05 / cosine], rel=1e-15
    )
    assert frame["flag"].tolist() == ["", "", "", "grazing"]
    notes = " ".join(frame.attrs["notes"])
    assert "1 of 5 values are transmission, and are left out" in notes
    assert "divided by the cosine" in notes
    assert frame["wavelength_nm"].isna().all()


def test_several_incidences_joined_are_one_table() -> None:
    frame = measurement.parse((ONE + SECOND).encode(), Path("white.dat"))
    assert frame["theta_i_deg"].tolist() == [30.0] * 4 + [60.0] * 2
    assert frame["brdf"].tolist()[-2:] == [0.25, 1.5]


def test_colours_are_three_values_of_which_the_luminous_one_is_taken() -> None:
    text = "#intheta 0\n#inphi 0\n#colorimetry: CIE-XYZ\n#format: theta phi BRDF\n10 0 0.1 0.2 0.3\n"
    frame = measurement.parse(text.encode(), Path("a.txt"))
    assert frame["brdf"].tolist() == [0.2]
    assert any("values are Y" in note for note in frame.attrs["notes"])


def test_the_back_is_a_sample_of_its_own_seen_against_its_own_normal() -> None:
    back = "#format: theta phi BRDF\n#intheta 150\n#inphi 180\n150 0 0.7\n"
    frame = measurement.parse((ONE + back).encode(), Path("white.dat"))
    assert frame.attrs["samples"] == ["white paint front", "white paint back"]
    row = frame[frame["sample"] == "white paint back"].iloc[0]
    assert (row["theta_i_deg"], row["theta_r_deg"], row["brdf"]) == (30.0, 30.0, 0.7)
    assert (row["phi_r_deg"] - row["phi_i_deg"]) % 360.0 == 180.0  # still the mirror direction


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("#format: theta phi DSF", "#format: theta phi candela", 'line 5: values are "candela"; DSF, BSDF'),
        ("#format: theta phi DSF", "#no", 'line 6: values before a line "#format'),
        ("#inphi 180", "#up 180", 'line 6: values before the angle of incidence; "#intheta" and "#inphi"'),
        ("60 0 0.1", "60 0 x", 'line 7: value is "x", not a number'),
        ("60 0 0.1", "60 0 0.1 0.2", "line 7: 4 numbers, and theta, phi, value are needed"),
        ("60 0 0.1", "200 0 0.1", "line 7: theta is 200 degrees"),
        ("#intheta\t30", "#intheta 400", "#intheta is 400 degrees"),
        ("#intheta\t30", "#intheta thirty", 'line 3: #intheta is "thirty", not a number'),
        ("#inphi 180", "#inphi 180\n#colorimetry: RGB", 'line 5: colorimetry "RGB" is not known'),
    ],
)
def test_what_is_wrong_is_told_with_its_line(old: str, new: str, told: str) -> None:
    with pytest.raises(DataError) as error:
        parse(ONE.replace(old, new))
    assert told in str(error.value)
    assert "white.dat" in str(error.value)


def test_transmission_alone_is_refused_and_a_header_alone_too() -> None:
    with pytest.raises(DataError, match="holds transmission alone"):
        parse(HEAD + "150 0 0.3\n")
    with pytest.raises(DataError, match="holds a header and no values"):
        parse(HEAD)


def test_it_is_told_from_the_content(survives: Callable[..., None]) -> None:
    assert of_content(ONE.encode(), Path("a.dat")).name == "pab"
    survives((ONE + SECOND).encode(), "a.dat", format="pab")
