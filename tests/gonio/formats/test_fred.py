"""Blocks of angles and values: FRED's tabulated scatter, and RPC Photonics' files."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError

FRED = """type bsdf_data
format angles=deg bsdf=value scale=2
15\t0
-40\t0\t0.010
15\t0\t0.021
30\t0\t0.017
60\t90
20,50,0.03
"""
RPC = "!!EDX 20-10     RPC Photonics     1/2/2013\n!!BSDF Data\n20.000 10.000\n20.0 10.0 1.5\n0.0 0.0 0.25\n"


def parse(text: str) -> pd.DataFrame:
    return measurement.parse(text.encode(), Path("black.txt"))


def test_the_specular_direction_is_the_mirror_and_a_signed_theta_lies_across_the_normal() -> None:
    frame = parse(FRED)
    assert (frame.attrs["format"], frame.attrs["sample"]) == ("fred", "black")
    assert frame["theta_i_deg"].tolist() == [15.0, 15.0, 15.0, 60.0]
    assert frame["theta_r_deg"].tolist() == [40.0, 15.0, 30.0, 20.0]
    assert ((frame["phi_r_deg"] - frame["phi_i_deg"]) % 360).tolist() == [0.0, 180.0, 180.0, 140.0]
    assert frame["brdf"].tolist() == [0.02, 0.042, 0.034, 0.06]  # times the scale
    notes = " ".join(frame.attrs["notes"])
    assert "taken as reflection" in notes
    assert "multiplied by the file's scale, 2" in notes


def test_sines_and_logarithms() -> None:
    frame = parse("type bsdf_data\nformat angles=sin bsdf=log exclude=0.03\n0 0.5\n0 -0.5 -2\n0.3 0 -1.5\n")
    assert frame["theta_i_deg"].tolist() == pytest.approx([30.0, 30.0], abs=1e-12)
    assert frame["theta_r_deg"].tolist() == pytest.approx([30.0, math.degrees(math.asin(0.3))], abs=1e-12)
    assert ((frame["phi_r_deg"] - frame["phi_i_deg"]) % 360).tolist() == pytest.approx([0.0, 270.0], abs=1e-9)
    assert frame["brdf"].tolist() == pytest.approx([0.01, 10**-1.5], rel=1e-14)
    assert any("exclude" in note for note in frame.attrs["notes"])


def test_a_diffuser_of_rpc_is_transmission_about_the_straight_direction() -> None:
    frame = parse(RPC + RPC.replace("20.000 10.000", "30.000 10.000"))
    assert set(frame["side"]) == {"transmission"}
    assert frame["theta_i_deg"].tolist() == [20.0, 20.0, 30.0, 30.0]  # two files joined
    straight = frame.iloc[0]
    assert (straight["theta_r_deg"], (straight["phi_r_deg"] - straight["phi_i_deg"]) % 360) == (160.0, 180.0)
    assert straight["brdf"] == 1.5
    assert any("taken as transmission" in note for note in frame.attrs["notes"])


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("format angles=deg", "format angles=rad", 'line 2: angles is "rad"; read are deg and sin'),
        ("format angles=deg bsdf=value scale=2\n", "", 'line 2: a line as "format angles=deg'),
        ("scale=2", "scale=0", "line 2: scale = 0"),
        ("scale=2", "scale=2 units=sr", 'line 2: "units" is not known'),
        ("15\t0\n-40", "-40", "line 3: values before a specular direction"),
        ("-40\t0\t0.010", "-40\t0\t0.010\t7", "line 4: 4 numbers; two are needed"),
        ("-40\t0\t0.010", "-140\t0\t0.010", "line 4: the scattered direction is beyond 90"),
        ("0.021", "x", 'line 5: bsdf is "x", not a number'),
        ("bsdf=value scale=2\n15\t0\n-40\t0\t0.010", "bsdf=log\n15\t0\n-40\t0\t400", "line 4: the value is beyond"),
    ],
)
def test_damage_is_located(old: str, new: str, told: str) -> None:
    with pytest.raises(DataError, match=re.escape(f"black.txt, {told}")):
        parse(FRED.replace(old, new, 1))


def test_damaged_files(survives: Callable[..., None]) -> None:
    survives(FRED.encode(), "black.txt", format="fred")
    survives(RPC.encode(), "diffuser.txt", format="fred")


def test_a_published_file(shared: Callable[[str], Path]) -> None:
    frame = measurement.read(shared("loft_rt300s") / "processed_fred" / "AnoBlackEC1onAlum.txt")
    assert len(frame) == 4 * 286
    mirror = frame.query("theta_i_deg == 10 and theta_r_deg == 10 and phi_r_deg == 0")["brdf"].item()
    assert mirror == 0.034800  # as printed in the file
    brightest = frame.iloc[int(frame["brdf"].to_numpy().argmax())]
    assert (brightest["theta_i_deg"], brightest["phi_i_deg"]) == (70.0, 180.0)
