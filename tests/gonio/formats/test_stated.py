"""What a file states of its own values: one direction in two ways, a wavelength in another unit, a kind by its keys.

Each case stands for a kind of statement that is obeyed, or refused by name; none is passed over.
"""

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from gonio import formats, measurement
from gonio.errors import DataError

ENDS = (0.0, 90.0, 180.0, 360.0)


def bird(path: Path, phi_r: Sequence[float], brdf: Sequence[float], nm: float = 550.0, **keys: object) -> Path:
    count = len(brdf)

    def column(unit: str, values: Sequence[float]) -> dict[str, object]:
        return {"unit": unit, "values": list(values)}

    data = {"theta_i": column("deg", [30.0] * count), "phi_i": column("deg", [0.0] * count)}
    data |= {"theta_r": column("deg", [20.0] * count), "phi_r": column("deg", phi_r)}
    data |= {"wavelength_i": column("nm", [nm] * count), "BRDF": column("1/sr", brdf)}
    path.write_text(json.dumps({"metadata": {}, "data": data, **keys}), encoding="utf-8")
    return path


def astm(path: Path, phi_r: Sequence[float], brdf: Sequence[float]) -> Path:
    lines = [f"VARS theta_i,phi_i,theta_s,phi_s,550nm\n{'':s}"]
    lines += [f"0.523599,0,0.349066,{math.radians(phi):.6f},{value}" for phi, value in zip(phi_r, brdf, strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def pab(path: Path, phi_r: Sequence[float], brdf: Sequence[float]) -> Path:
    lines = ["#format: theta phi BSDF", "#intheta 30", "#inphi 0"]
    lines += [f"20 {phi} {value}" for phi, value in zip(phi_r, brdf, strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def alta(path: Path, phi_r: Sequence[float], brdf: Sequence[float]) -> Path:
    lines = ["#DIM 3 1", "#PARAM_IN ISOTROPIC_TV_TL_DPHI", "#PARAM_OUT INV_STERADIAN"]
    # degrees 20 and 30 in radians, and azimuths with the decimals that people write
    lines += [f"0.349066 0.523599 {math.radians(phi):.5f} {value}" for phi, value in zip(phi_r, brdf, strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def nist(path: Path, phi_r: Sequence[float], brdf: Sequence[float]) -> Path:
    lines = ["lambda,thetai,phi,thetar,phir,f_r11"]
    lines += [f"0.55,30,0,20,{phi},{value}" for phi, value in zip(phi_r, brdf, strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def own(path: Path, phi_r: Sequence[float], brdf: Sequence[float]) -> Path:
    path = path.with_suffix(".csv")
    lines = ["ti;pr;tr;R"] + [f"30;{phi};20;{value}" for phi, value in zip(phi_r, brdf, strict=True)]
    path.write_text("\n".join([lines[0] + ";pi", *(f"{line};0" for line in lines[1:])]) + "\n", encoding="utf-8")
    path.with_suffix(".columns.toml").write_text(
        'theta_i = "ti"\nphi_i = "pi"\ntheta_r = "tr"\nphi_r = "pr"\nbrdf = "R"\n', encoding="utf-8"
    )
    return path


def own_rad(path: Path, phi_r: Sequence[float], brdf: Sequence[float]) -> Path:
    path = own(path, phi_r, brdf)
    lines = [f"30;{math.radians(phi):.4f};20;{value};0" for phi, value in zip(phi_r, brdf, strict=True)]
    path.write_text("\n".join(["ti;pr;tr;R;pi", *lines]) + "\n", encoding="utf-8")
    pairs = path.with_suffix(".columns.toml")
    pairs.write_text(pairs.read_text(encoding="utf-8").replace('"pr"', '"pr:rad"'), encoding="utf-8")
    return path


MAKERS = [bird, astm, pab, alta, nist, own, own_rad]


@pytest.mark.parametrize("make", MAKERS)
def test_a_whole_turn_counts_its_ends_once(tmp_path: Path, make: type) -> None:
    frame = measurement.read(make(tmp_path / "a.brdf", ENDS, (0.1, 0.2, 0.3, 0.1)))
    # radians to four decimals are known to 3e-3 degrees
    np.testing.assert_allclose(np.sort(frame["phi_r_deg"]), [0.0, 90.0, 180.0], atol=3e-3)
    assert any("stated in two ways" in note for note in frame.attrs["notes"])


@pytest.mark.parametrize("make", MAKERS)
def test_ends_of_a_turn_that_differ_are_named(tmp_path: Path, make: type) -> None:
    with pytest.raises(
        DataError, match=r"a\.(brdf|csv): .*, 0\) and .*, 360(\.001)?\) degrees are one.* 0\.1 and 0\.4"
    ):
        measurement.read(make(tmp_path / "a.brdf", ENDS, (0.1, 0.2, 0.3, 0.4)))


@pytest.mark.parametrize("make", [pab, nist, own, own_rad, alta])
def test_half_turns_of_either_sign_are_one_direction(tmp_path: Path, make: type) -> None:
    frame = measurement.read(make(tmp_path / "a.brdf", (-180.0, -90.0, 0.0, 90.0, 180.0), (0.1, 0.2, 0.3, 0.4, 0.1)))
    np.testing.assert_allclose(np.sort(frame["phi_r_deg"]), [0.0, 90.0, 180.0, 270.0], atol=3e-3)  # four decimals


def test_other_azimuths_of_a_table_are_refused_with_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf\n30,0,20,0,0.1\n30,0,20,360,0.1\n", "utf-8")
    with pytest.raises(DataError, match=r"a\.csv, line 3: phi_r_deg = 360; .* write 360 as 0.*--columns"):
        measurement.read(path)
    with pytest.raises(DataError, match=r"phi_r_deg = 540; azimuths lie"):  # beyond a turn it is another mistake
        measurement.read(own(tmp_path / "b.csv", (0.0, 540.0), (0.1, 0.1)))


def test_a_repeated_measurement_stays(tmp_path: Path) -> None:
    assert len(measurement.read(pab(tmp_path / "a.txt", (0.0, 90.0, 90.0), (0.1, 0.2, 0.21)))) == 3


def zemax(path: Path, azimuths: Sequence[float], rows: Sequence[str], rotations: Sequence[float] = (0.0,)) -> Path:
    block = "TIS 0.1\n" + "\n".join(rows)
    path.write_text(
        "Source Measured\nSymmetry ASymmetrical4D\nSpectralContent Monochrome\nScatterType BRDF\n"
        f"SampleRotation {len(rotations)}\n{' '.join(map(str, rotations))}\nAngleOfIncidence 1\n10\n"
        f"ScatterAzimuth {len(azimuths)}\n{' '.join(map(str, azimuths))}\nScatterRadial 2\n5 20\n"
        "Monochrome\nDataBegin\n" + "\n".join([block] * len(rotations)) + "\nDataEnd\n",
        encoding="utf-8",
    )
    return path


def test_a_grid_of_a_whole_turn_counts_its_ends_once(tmp_path: Path) -> None:
    rows = ["0.1 0.2", "0.3 0.4", "0.5 0.6", "0.1 0.2"]
    assert len(measurement.read(zemax(tmp_path / "a.bsdf", ENDS, rows))) == 6
    assert len(measurement.read(zemax(tmp_path / "b.bsdf", ENDS, rows, (0.0, 360.0)))) == 6
    with pytest.raises(DataError, match=r"c\.bsdf: AngleOfIncidence 10: both ends of ScatterAzimuth .* 0\.2 .* 0\.25"):
        measurement.read(zemax(tmp_path / "c.bsdf", ENDS, [*rows[:3], "0.1 0.25"]))


@pytest.mark.parametrize("nm", [0.55, 10.6, 5e-7])
def test_micrometres_in_a_column_of_nanometres_are_refused(tmp_path: Path, nm: float) -> None:
    with pytest.raises(DataError, match=rf"wavelength_nm = {nm:g}; from 100 to 200000 nanometres"):
        measurement.read(bird(tmp_path / "a.brdf", (0.0, 90.0), (0.1, 0.2), nm))
    (tmp_path / "a.csv").write_text(
        f"theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,wavelength_nm,brdf\n30,0,20,0,{nm},0.1\n", encoding="utf-8"
    )
    with pytest.raises(DataError, match=r"a\.csv, line 2: wavelength_nm"):
        measurement.read(tmp_path / "a.csv")


def test_json_of_another_kind_is_not_called_bird(tmp_path: Path) -> None:
    other = {"$schema": "s", "metadata": {"name": "x"}, "brdf": {"values": [0.1]}}
    (tmp_path / "a.other").write_text(json.dumps(other), encoding="utf-8")
    with pytest.raises(DataError, match="is in no format known"):
        formats.of_content((tmp_path / "a.other").read_bytes(), tmp_path / "a.other")
    (tmp_path / "a.json").write_text(json.dumps(other), encoding="utf-8")
    with pytest.raises(
        DataError, match=r"""a\.json: is JSON, and not of BiRD.*keys are '\$schema', 'metadata', 'brdf'"""
    ):
        measurement.read(tmp_path / "a.json")
