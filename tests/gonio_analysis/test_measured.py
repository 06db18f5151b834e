"""Reports of other laboratories' measurements, where these lie beside the project."""

import json
from pathlib import Path
from typing import Any

import pytest
from gonio_analysis.report import make

from tests.places import measured
from tests.recipes import infrared_metals

pytestmark = pytest.mark.slow

MODELS = ("cook-torrance", "oren-nayar", "he-torrance")


def report(tmp_path: Path, *names: str, models: tuple[str, ...] = MODELS, **options: Any) -> list[dict[str, Any]]:
    tables = [name if Path(name).is_absolute() else str(measured(f"brdf/{name}")) for name in names]
    index = make(tables, tmp_path / "out", models=models, **options)
    return json.loads(index.with_name("summary.json").read_text(encoding="utf-8"))["datasets"]


def test_cornell_paint(tmp_path: Path) -> None:
    (paint,) = report(tmp_path, "cornell_astm/krylon_blue.astm")
    assert set(paint["models"]) == set(MODELS)
    assert paint["wavelength_nm"] == 550
    assert paint["left_out"]["flagged clamped"] == 1439 - paint["used"]
    assert paint["uncertainty_stated"] is False
    assert paint["curves_without_mirror"]
    assert len(paint["models"]["cook-torrance"]["series"]) == 31
    blue = {
        r["wavelength_nm"]: r["parameters"]["diffuse_albedo"]["value"]
        for r in paint["models"]["cook-torrance"]["series"]
    }
    assert blue[450] > 3 * blue[600]  # a blue paint


def test_nist_ptfe(tmp_path: Path) -> None:
    (ptfe,) = report(tmp_path, "nist_ptfe/PTFE.data.csv", models=("oren-nayar",), wavelength_nm=633)
    assert ptfe["wavelength_nm"] == 633
    assert ptfe["scanned"] == "theta_r"
    # pi f = 0.993 at 0/45: a nearly white diffuser
    assert 0.85 < ptfe["models"]["oren-nayar"]["parameters"]["albedo"]["value"] <= 1.0


def test_infrared_metal_in_a_broad_band(tmp_path: Path) -> None:
    name = f"{infrared_metals(tmp_path)}:sandblasted aluminium"
    (metal,) = report(tmp_path, name)
    assert metal["wavelength_nm"] is None
    assert "--wavelength-nm" in metal["skipped"]["he-torrance"]
    assert metal["scanned"] == "theta_i"
    assert metal["receiver_solid_angle_sr"] is None
    (metal,) = report(tmp_path, name, models=("he-torrance",), wavelength_nm=3500)
    assert metal["models"]["he-torrance"]["wavelength_nm"] == 3500


def test_a_metal_s_fit_that_reflects_more_than_it_receives_is_marked(tmp_path: Path) -> None:
    """In-plane scans of brushed steel leave the width across the plane open: an isotropic lobe is too wide there."""
    name = f"{infrared_metals(tmp_path)}:brushed stainless steel"
    (metal,) = report(tmp_path, name, models=("cook-torrance",))
    steel = metal["models"]["cook-torrance"]
    assert steel["reflects_too_much"]
    assert max(r.get("given") or r["rho_dh"] for r in steel["rho_dh"]) > 2
    assert "Against the conservation of energy cook-torrance" in metal["conclusion"]
    assert "the only model tried: it misses this sample by a factor of " in metal["conclusion"]
