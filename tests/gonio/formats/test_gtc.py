"""GTC archives: opened by GTC itself, which computes what the values have in common."""

from pathlib import Path

import numpy as np
import pytest

from gonio import measurement
from gonio.checks import hemisphere
from gonio.checks.values import CheckedValues
from gonio.errors import DataError
from gonio.geometry import Directions
from tests.command_line import gonio

GTC = pytest.importorskip("GTC")


def table_of(folder: Path, *, u: bool = True, flag: bool = False) -> Path:
    """A hemisphere at 20 degrees of incidence with noise, a scale and a zero in common."""
    rows = ["theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,wavelength_nm,polarisation,brdf,u_brdf,u_random,flag"]
    rows[0] += ",s_scale,s_zero" if u else ""
    for theta in range(0, 90, 8):
        for phi in range(0, 360, 30) if theta else [0]:
            f = 0.2 + 0.1 * np.cos(np.radians(phi)) * np.sin(np.radians(theta))
            stated = (f"{np.hypot(0.001, np.hypot(0.01 * f, 1e-5 * theta))},0.001", f",{0.01 * f},{1e-5 * theta}")
            own, common = stated if u else (",", "")
            why = "saturated" if flag and theta == 40 and phi == 30 else ""
            rows.append(f"20,0,{theta},{phi},550,unpolarised,{f},{own},{why}{common}")
    (folder / "t.csv").write_text("\n".join(rows) + "\n")
    return folder / "t.csv"


def test_gtc_computes_our_uncertainty_of_the_hemisphere(tmp_path: Path) -> None:
    table = measurement.read(table_of(tmp_path))
    gonio(tmp_path, "convert", "t.csv", "x.gtc.json", expect=0)
    with (tmp_path / "x.gtc.json").open() as stream:
        archive = GTC.persistence.load_json(stream)
    random, common, _ = measurement.uncertainty(table)
    data = CheckedValues(Directions.from_table(table), table["brdf"].to_numpy(), random, common)
    (ours,) = hemisphere.reflectances(data)
    # the same sum in another order: rounding of some hundred terms
    assert GTC.uncertainty(archive.extract("rho_dh_20")) == pytest.approx(ours.u_values, rel=1e-9)
    values = archive.extract(*(f"brdf_{row}" for row in range(len(table))))
    pairs = zip(values, ours.weights, strict=True)
    assert GTC.uncertainty(sum(w * v for v, w in pairs if w)) == pytest.approx(ours.u_values, rel=1e-9)
    whole = np.diag(random**2) + common @ common.T
    wanted = whole[3, 40] / np.sqrt(whole[3, 3] * whole[40, 40])
    assert GTC.get_correlation(values[3], values[40]) == pytest.approx(wanted, rel=1e-9)


def test_a_flagged_value_is_left_out_and_one_without_uncertainty_refused(tmp_path: Path) -> None:
    table = measurement.read(table_of(tmp_path, flag=True))
    assert any("flag" in text for text in measurement.write(table, tmp_path / "x.gtc.json"))
    with (tmp_path / "x.gtc.json").open() as stream:
        archive = GTC.persistence.load_json(stream)
    assert len([tag for tag in archive.keys() if tag.startswith("brdf_")]) == len(table) - 1  # noqa: SIM118
    bare = measurement.read(table_of(tmp_path, u=False))
    with pytest.raises(DataError, match="no value has an uncertainty"):
        measurement.write(bare, tmp_path / "y.gtc.json")
    assert not (tmp_path / "y.gtc.json").exists()
    with pytest.raises(DataError, match="written, not read"):
        measurement.read(tmp_path / "x.gtc.json")
