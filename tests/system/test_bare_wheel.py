"""The wheel alone, in an empty environment without devices' libraries, and without its optional packages."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gonio import measurement, plugins
from gonio.errors import EXTRAS
from gonio.models import Lambert
from tests.gonio_analysis.synthetic import measure
from tests.places import ROOT

pytestmark = pytest.mark.slow


def run(*words: str | Path, **settings: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(word) for word in words], capture_output=True, text=True, **settings)  # type: ignore[call-overload]


@pytest.fixture(scope="module")
def gonio(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The command `gonio` of the environment."""
    here = tmp_path_factory.mktemp("bare")
    pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
    built = run(*pip, "wheel", "--no-deps", "--wheel-dir", here, ROOT)
    if built.returncode:
        pytest.skip(f"no wheel can be built here (no package index?): {built.stderr[-200:]}")
    (wheel,) = here.glob("gonio-*.whl")
    run(sys.executable, "-m", "venv", here / "env", check=True)
    python = here / "env" / "bin" / "python"
    run(python, *pip[1:], "install", "--no-compile", "-c", ROOT / "constraints.txt", wheel, check=True)
    (site,) = (here / "env").glob("lib/python*/site-packages")
    for names in plugins.ROOMS.values():
        for package in names.values():
            shutil.rmtree(site / package, ignore_errors=True)
    return here / "env" / "bin" / "gonio"


def test_the_wheel_alone_runs_the_demo_fits_and_reports(gonio: Path, tmp_path: Path) -> None:
    for module in EXTRAS:
        assert run(gonio.with_name("python"), "-c", f"import {module}").returncode, f"{module} is there"
    done = run(gonio, "demo", "--quick", "--out", tmp_path / "demo", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    table = tmp_path / "demo" / "run" / "brdf.csv"
    done = run(gonio, "fit", table, "--model", "cook-torrance", "--ior", "Al", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    done = run(gonio, "compare", table, "--models", "lambert", "--out", tmp_path / "page", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "page" / "index.html").is_file()
    shutil.rmtree(tmp_path / "demo")


def test_what_an_extra_brings_is_named_with_how_to_get_it(gonio: Path, tmp_path: Path) -> None:
    measurement.write(measure(Lambert(0.6), incidences=(20.0,)), tmp_path / "t.csv")
    workbook = run(gonio, "convert", tmp_path / "t.csv", tmp_path / "t.xlsx", cwd=tmp_path)
    assert workbook.returncode == 2
    assert workbook.stderr.strip().endswith('pip install "gonio[workbooks]"'), workbook.stderr
    (tmp_path / "lab.toml").write_text('rig = "lab"\n')
    rig = run(gonio, "rig", "check", "--rig", "lab", cwd=tmp_path)
    assert rig.returncode == 2
    assert rig.stderr.strip().endswith('pip install "gonio[lab]"'), rig.stderr
