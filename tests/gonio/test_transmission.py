"""Transmission in the measurement table: stated in each row, kept apart from reflection, refused where not said."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import ArgumentError, DataError
from gonio.models import HeTorrance, Lambert, build

HEAD = "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf"


def both() -> pd.DataFrame:
    """Two rows of each side."""
    text = f"{HEAD},side\n30,0,30,180,0.2,reflection\n30,0,0,0,0.1,reflection\n"
    text += "30,0,150,180,0.4,transmission\n30,0,180,0,0.3,transmission\n"
    return measurement.parse(text.encode(), Path("opal.csv"))


def test_a_table_holds_both_sides_and_says_so(tmp_path: Path) -> None:
    frame = both()
    assert frame.attrs["quantity"] == "bsdf"
    measurement.write(frame, tmp_path / "opal.csv")
    again = measurement.read(tmp_path / "opal.csv")
    pd.testing.assert_frame_equal(again, frame)
    measurement.write(again, tmp_path / "opal.csv")  # its own attributes are replaced
    reflected, through = measurement.reflection(again), measurement.transmission(again)
    assert reflected["brdf"].tolist() == [0.2, 0.1]
    assert "2 rows of transmission are left out" in reflected.attrs["notes"]
    assert through is not None
    assert (through["brdf"].tolist(), through.attrs["quantity"]) == ([0.4, 0.3], "btdf")
    turned = measurement.turned_over(through)
    assert turned["theta_r_deg"].tolist() == [30.0, 0.0]  # straight through stands where the mirror does
    assert measurement.transmission(reflected) is None


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (f"{HEAD}\n30,0,95,180,0.2\n", 'line 2: theta_r_deg = 95; .*"side" says "transmission"'),
        (f"{HEAD},side\n30,0,95,180,0.2,reflection\n", "theta_r_deg = 95"),
        (f"{HEAD},side\n30,0,59,180,0.2,transmission\n", r"theta_r_deg = 59; .*\(90, 180\] degrees"),
        (f"{HEAD},side\n30,0,90,180,0.2,transmission\n", "theta_r_deg = 90"),
        (f"{HEAD},side\n95,0,150,180,0.2,transmission\n", "theta_i_deg = 95"),
        (f"{HEAD},side\n30,0,181,180,0.2,transmission\n", "theta_r_deg = 181"),
        (f"{HEAD},side\n30,0,30,180,0.2,front\n", "side = 'front'; one of reflection, transmission"),
    ],
)
def test_a_wrong_angle_never_becomes_transmission(rows: str, told: str) -> None:
    with pytest.raises(DataError, match=told):
        measurement.parse(rows.encode(), Path("opal.csv"))


@pytest.mark.parametrize("ending", ["astm", "brdf", "alta", "binary"])
def test_formats_without_a_word_for_it_refuse(ending: str, tmp_path: Path) -> None:
    frame = both().assign(wavelength_nm=550.0)
    with pytest.raises(DataError, match="2 of 4 rows are transmission"):
        measurement.write(frame, tmp_path / f"opal.{ending}")
    assert list(tmp_path.iterdir()) == []


def test_columns_of_ones_own_may_name_the_side() -> None:
    text = "ti,phi_i_deg,tr,phi_r_deg,f,which\n30,0,150,180,0.4,transmission\n"
    columns = {"theta_i": "ti", "theta_r": "tr", "brdf": "f", "side": "which"}
    assert measurement.parse(text.encode(), Path("a.csv"), columns=columns)["side"].tolist() == ["transmission"]


def test_a_diffuse_transmitter_is_lambert_on_both_sides() -> None:
    model = build("diffuse-transmitter", {"reflectance": 0.5, "transmittance": 0.3})
    assert model.brdf(0.3, 0.0, 0.2, 1.0) == pytest.approx(0.5 / np.pi, rel=1e-15)
    theta, weight = np.polynomial.legendre.leggauss(20)
    angle = 0.75 * np.pi + 0.25 * np.pi * theta
    btdf = model.btdf(0.3, 0.0, angle, 0.0)
    tau = 2 * np.pi * np.sum(0.25 * np.pi * weight * btdf * np.abs(np.cos(angle)) * np.sin(angle))
    assert tau == pytest.approx(0.3, rel=1e-12)  # Gauss-Legendre with 20 nodes is exact to rounding here
    assert model.directional_hemispherical(0.4) == pytest.approx(0.5)
    with pytest.raises(ArgumentError, match="together they are at most 1"):
        build("diffuse-transmitter", {"reflectance": 0.7, "transmittance": 0.4})


def test_other_models_are_opaque_and_refuse_an_angle_behind() -> None:
    for model in (Lambert(0.5), HeTorrance()):
        assert np.array_equal(model.btdf(0.3, 0.0, [2.0, 3.0], 0.0), [0.0, 0.0])
        with pytest.raises(ArgumentError, match="theta_r"):
            model.brdf(0.3, 0.0, 2.0, 0.0)
        with pytest.raises(ArgumentError, match="theta_r"):
            model.btdf(0.3, 0.0, 1.0, 0.0)
