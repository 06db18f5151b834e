"""Tables of optics programs: LightTools, TracePro, and surface scattering distribution data."""

import math
import re
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError

TRACEPRO = """TracePro Surface Property Data
File Name\tpaint.txt
TracePro Release: 7 0 0

Name\tmatte paint
Scatter    5

Temperature\tWavelength\tIncAngle
300\t0.55\t30
Table_BSDF_Data
Temperature\tWavelength\tIncAngle\tAziAngle\tScatterBeta\tScatterAzimuth\tBRDF\tBTDF
300\t0.55\t30\t0\t0\t0\t0.5\t0
300\t0.55\t30\t0\t0.5\t0\t0.2\t0
300\t0.55\t30\t0\t0.25\t180\t0.3\t0.04
300\t0.55\t30\t0\t0.6\t180\t0.1\t0
SAVE-DATA
"""
LIGHTTOOLS = """# a comment
Symmetry PlaneSymmetrical
SpectralContent Monochrome
ScatterAzimuth 2
90 270
ScatterRadial 3
0 20 90
DataBegin
AOI 20 POI 0 Side Front Wavelength 550 ScatterType BRDF TIS 0.3
0.1 0.2 0.3
0.1 0.4 0.5
AOI 20 POI 0 Side Front Wavelength 550 ScatterType BTDF TIS 0.1
0.01 0.02 0
0.01 0.05 0
DataEnd
"""
SSDD = """VERSION 0.3
# a comment
DATA_TYPE brdf
COLOR_MODEL spectrum
WAVELENGTH_LIST 500 600
PARAM_TYPE spherical_coordinate_system
PARAM0_LIST 0 30
PARAM2_LIST 0 30
PARAM3_LIST 0 180
DATA ascii
1 101
2 102
3 103
4 104
5 105
6 106
7 107
8 108
DATA_TYPE specular_reflectance
COLOR_MODEL monochrome
PARAM0_LIST 0 90
DATA ascii
0.05
0.06
"""


def parse(text: str | bytes, name: str) -> pd.DataFrame:
    return measurement.parse(text if isinstance(text, bytes) else text.encode(), Path(name))


def test_beta_minus_beta0_is_about_the_mirror() -> None:
    frame = parse(TRACEPRO, "paint.txt")
    assert (frame.attrs["format"], frame.attrs["sample"]) == ("tracepro", "matte paint")
    assert set(frame["wavelength_nm"]) == {550.0}
    lit = frame[frame["side"] == "reflection"]
    # beta0 = -1/2 along x; by hand -1/2, 0 and -3/4; the fourth, -1.1, is no direction
    assert lit["theta_r_deg"].tolist() == pytest.approx([30.0, 0.0, math.degrees(math.asin(0.75))], abs=1e-9)
    assert lit["phi_r_deg"].tolist() == [180.0, 0.0, 180.0]
    assert lit["brdf"].tolist() == [0.5, 0.2, 0.3]
    through = frame[frame["side"] == "transmission"]
    assert through["theta_r_deg"].tolist()[2] == pytest.approx(180 - math.degrees(math.asin(0.75)), abs=1e-9)
    assert any("1 of 4 rows are no direction" in note for note in frame.attrs["notes"])


def test_light_of_lighttools_comes_from_ninety_degrees() -> None:
    frame = parse(LIGHTTOOLS, "a.bsdf")
    assert frame.attrs["format"] == "lighttools"
    mirror = frame[(frame["side"] == "reflection") & (frame["theta_r_deg"] == 20) & (frame["phi_r_deg"] == 270)]
    assert ((mirror["phi_r_deg"] - mirror["phi_i_deg"]).item(), mirror["brdf"].item()) == (180.0, 0.4)
    through = frame[frame["side"] == "transmission"]
    assert through["theta_r_deg"].tolist() == [180.0, 160.0, 180.0, 160.0]  # without the horizon
    assert through["brdf"].tolist() == [0.01, 0.02, 0.01, 0.05]
    colours = LIGHTTOOLS.replace("Monochrome", "XYZ").replace("BRDF TIS", "BRDF TristimulusValue TrisX TIS")
    assert parse(colours, "a.bsdf").attrs["samples"] == ["a front X", "a front"]


def test_the_first_parameter_of_ssdd_runs_fastest() -> None:
    frame = parse(SSDD, "a.ssdd")
    assert (frame.attrs["format"], len(frame)) == ("ssdd", 16)
    first = frame[frame["wavelength_nm"] == 500]
    assert first["brdf"].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]
    assert first["theta_i_deg"].tolist() == [0.0, 30.0] * 4
    assert first["theta_r_deg"].tolist() == [0.0, 0.0, 30.0, 30.0] * 2
    assert first["phi_r_deg"].tolist() == [0.0] * 4 + [180.0] * 4
    assert any("specular_reflectance is no BRDF" in note for note in frame.attrs["notes"])


HEAD = "VERSION 0.2\nDATA_TYPE {kind}\nCOLOR_MODEL rgb\nPARAM_TYPE {system}\n"


def test_other_coordinates_of_ssdd_colours_and_binary_values() -> None:
    lists = "PARAM0_LIST 30\nPARAM2_LIST 0 30 100\nPARAM3_LIST 0\nDATA binary\n"
    values = struct.pack("<9f", *range(1, 10))
    head = HEAD.format(kind="btdf", system="specular_coordinate_system")
    frame = parse((head + lists).encode() + values + b"\n", "blue.ssdd")
    assert frame.attrs["samples"] == ["blue red", "blue green", "blue blue"]
    red = frame[frame["sample"] == "blue red"]
    # about the straight direction: itself, the normal, and 100 inward, 70 degrees beyond it
    assert red["theta_r_deg"].tolist() == pytest.approx([150.0, 180.0, 110.0], abs=1e-9)
    assert red["phi_r_deg"].tolist()[::2] == [180.0, 0.0]
    assert red["brdf"].tolist() == [1.0, 4.0, 7.0]
    half = HEAD.format(kind="brdf", system="half_difference_coordinate_system").replace("rgb", "monochrome")
    frame = parse(half + "PARAM0_LIST 0 20\nPARAM2_LIST 40\nPARAM3_LIST 0\nDATA ascii\n0.5\n0.6\n", "a.ssdd")
    # half vector at the normal: the mirror; half vector at 20, difference 40 in the plane: 60 and -20
    assert frame["theta_i_deg"].tolist() == pytest.approx([40.0, 60.0], abs=1e-9)
    assert frame["theta_r_deg"].tolist() == pytest.approx([40.0, 20.0], abs=1e-9)
    np.testing.assert_allclose((frame["phi_r_deg"] - frame["phi_i_deg"]) % 360, 180.0, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "name", "old", "new", "told"),
    [
        (TRACEPRO, "paint.txt", "Table_BSDF_Data\n", "", "has 0 tables"),
        (TRACEPRO, "paint.txt", "\tScatterBeta", "\tBeta", "line 11: the columns Temperature"),
        (TRACEPRO, "paint.txt", "0.55\t30\t0\t0.5", "550\t30\t0\t0.5", "line 13: 550, 30, 0, 0.5 for wavelength [um]"),
        (TRACEPRO, "paint.txt", "300\t0.55\t30\t0\t0.5", "310\t0.55\t30\t0\t0.5", "has 2 temperatures"),
        (LIGHTTOOLS, "a.bsdf", "ScatterType BRDF", "ScatterType BSDF", 'line 9: ScatterType is "BSDF"'),
        (LIGHTTOOLS, "a.bsdf", "AOI 20", "AOI 120", "line 9: AOI = 120 lies outside"),
        (LIGHTTOOLS, "a.bsdf", "0 20 90", "0 90 20", "line 7: ScatterRadial has to grow"),
        (LIGHTTOOLS, "a.bsdf", "DataEnd\n", "", "line 14: the file ends before DataEnd"),
        (SSDD, "a.ssdd", "spherical_coo", "distorted_spherical_coo", 'line 10: PARAM_TYPE is "distorted'),
        (SSDD, "a.ssdd", "3 103", "3", "line 13: 1 numbers for value 3 of 8; 2 are needed"),
        (SSDD, "a.ssdd", "PARAM2_LIST 0 30", "PARAM2_LIST 30 0", "line 10: PARAM2_LIST needs numbers that grow"),
        (SSDD, "a.ssdd", "DATA ascii", "DATA hex", 'line 10: DATA is "hex"'),
    ],
)
def test_damage_is_located(text: str, name: str, old: str, new: str, told: str) -> None:
    with pytest.raises(DataError, match=re.escape(told)) as caught:
        parse(text.replace(old, new, 1), name)
    assert name in str(caught.value)


def test_damaged_files(survives: Callable[..., None]) -> None:
    survives(TRACEPRO.encode(), "paint.txt", format="tracepro")
    survives(LIGHTTOOLS.encode(), "a.bsdf", format="lighttools")
    survives(SSDD.encode(), "a.ssdd", format="ssdd")
