"""The command `gonio appearance`: JSON, terminal, page, and what it says of bad input."""

import json
from pathlib import Path

import numpy as np
import pytest

from gonio import measurement
from gonio.models import HeTorrance
from tests.command_line import gonio, says
from tests.gonio_analysis.appearance.simulated import hemisphere, measured, plane

GLASS = 'name = "glass"\nmodel = "he-torrance"\n[parameters]\nsigma0_um = 0.0\ntau_um = 1.0\nior = 1.567\n'
PAINT = HeTorrance(sigma0_um=0.1, tau_um=2.0, ior=1.5, diffuse_albedo=0.1)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A measurement of a paint at four incidences."""
    signed = np.arange(-85.0, 85.1, 2.5)
    directions = np.vstack([hemisphere(8.0), *(plane(t, signed) for t in (20.0, 45.0, 60.0))])
    path = tmp_path / "paint.csv"
    measurement.write(measured(PAINT, directions), path)
    return path


def test_a_sample_file_as_json(tmp_path: Path) -> None:
    (tmp_path / "glass.toml").write_text(GLASS, encoding="utf-8")
    found = json.loads(gonio(tmp_path, "appearance", "glass.toml", "--json", expect=0).stdout)
    for angle in (20, 60, 85):
        assert found[f"gloss_{angle}_gu"]["value"] == pytest.approx(100.0, abs=0.005)  # two decimals
        assert found[f"gloss_{angle}_gu"]["u"] is None
    assert (found["kind"], found["wavelength_nm"]) == ("model", 550.0)


def test_a_table_and_its_page(tmp_path: Path, table: Path) -> None:
    found = json.loads(gonio(tmp_path, "appearance", table.name, "--json", "--out", "page", expect=0).stdout)
    assert found["gloss_60_gu"]["u"] > 0.0
    assert found["gloss_85_gu"]["value"] is None
    assert "no in-plane curve at 85°" in found["gloss_85_gu"]["why"]
    kept = json.loads((tmp_path / "page" / "summary.json").read_text(encoding="utf-8"))
    assert {key: kept[key] for key in found} == found
    says((tmp_path / "page" / "index.html").read_text(encoding="utf-8"), "gloss at 60°", "no in-plane curve at 85°")
    figures = {path.name for path in (tmp_path / "page" / "figures").iterdir()}
    assert "gloss.svg" in figures
    assert "colour.svg" not in figures  # of one wavelength there is none
    (tmp_path / "glass.toml").write_text(GLASS, encoding="utf-8")
    assert gonio(tmp_path, "appearance", "glass.toml", "--out", "model").returncode == 0
    assert (tmp_path / "model" / "figures" / "colour.svg").is_file()


def test_on_the_terminal(tmp_path: Path, table: Path) -> None:
    done = gonio(tmp_path, "appearance", table.name, "--out", "page", expect=0)
    says(done.stdout, "gloss at 20°", "±")
    assert done.stdout.rstrip().endswith("index.html")


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("sample.toml", GLASS.replace("tau_um", "tau"), 'no parameter "tau"; did you mean "tau_um"?'),
        ("sample.toml", GLASS.replace("ior = 1.567", "ior = -1"), "ior"),
        ("sample.toml", GLASS.replace("he-torrance", "he-torrence"), "he-torrence"),
        ("table.csv", "theta_i_deg,brdf\n1,2\n", "columns missing"),
    ],
)
def test_bad_input_is_named(tmp_path: Path, file: str, text: str, words: str) -> None:
    (tmp_path / file).write_text(text, encoding="utf-8")
    done = gonio(tmp_path, "appearance", file, "--out", "page")
    assert done.returncode in (1, 2)
    assert file in done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "page").exists()


def test_a_wavelength_that_is_none(tmp_path: Path, table: Path) -> None:
    assert "--wavelength-nm -5" in gonio(tmp_path, "appearance", table.name, "--wavelength-nm", "-5", expect=2).stderr


def test_a_missing_file(tmp_path: Path) -> None:
    assert "absent.csv: there is no such file" in gonio(tmp_path, "appearance", "absent.csv", expect=2).stderr
