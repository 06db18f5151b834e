"""The wheel alone, in an empty environment without devices' libraries, and without its optional packages."""

import json
import os
import re
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from gonio import measurement, plugins
from gonio.errors import EXTRAS
from gonio.models import Lambert
from tests.gonio_analysis.synthetic import measure
from tests.places import ROOT

pytestmark = pytest.mark.slow
PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")


def run(*words: str | Path, **settings: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(word) for word in words], capture_output=True, text=True, **settings)  # type: ignore[call-overload]


def required(requirements: list[str], found: dict[str, metadata.Distribution]) -> None:
    """Add what these requirements bring, extras aside, and what that requires."""
    for one in map(Requirement, requirements):
        name = re.sub("[-_.]+", "-", one.name).lower()
        if name not in found and (one.marker is None or one.marker.evaluate({"extra": ""})):
            found[name] = metadata.distribution(name)
            required(found[name].requires or [], found)


def take_along(site: Path) -> None:
    """Machine code that this checkout has of the same sources: numba knows these by time and size."""
    for folder in (ROOT / "gonio", *(ROOT / "analysis").iterdir(), *(ROOT / "sim").iterdir()):
        for path in (*folder.rglob("*.py"), *folder.rglob("*.nb[ic]")):
            there = site / path.relative_to(folder.parent)
            if path.suffix != ".py" and there.parent.parent.is_dir():
                there.parent.mkdir(exist_ok=True)
                shutil.copy2(path, there)
            elif there.exists() and there.read_bytes() == path.read_bytes():
                os.utime(there, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns))


@pytest.fixture(scope="module")
def gonio(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The command `gonio` of the environment, in which links stand for the packages that the wheel requires."""
    here = tmp_path_factory.mktemp("bare")
    built = run(*PIP, "wheel", "--no-deps", "--wheel-dir", here, ROOT)
    if built.returncode:
        pytest.skip(f"no wheel can be built here (no package index?): {built.stderr[-200:]}")
    (wheel,) = here.glob("gonio-*.whl")
    run(sys.executable, "-m", "venv", "--without-pip", here / "env", check=True)
    python = here / "env" / "bin" / "python"
    run(*PIP, "--python", python, "install", "--no-deps", "--no-compile", wheel, check=True)
    (site,) = (here / "env").glob("lib/python*/site-packages")
    (made,) = metadata.distributions(name="gonio", path=[str(site)])
    found: dict[str, metadata.Distribution] = {}
    required(made.requires or [], found)
    for each in found.values():
        for top in {file.parts[0] for file in each.files or ()} - {"..", "__pycache__"}:
            (site / top).symlink_to(Path(str(each.locate_file(top))).resolve())
    for names in plugins.ROOMS.values():
        for package in names.values():
            shutil.rmtree(site / package, ignore_errors=True)
    take_along(site)
    return here / "env" / "bin" / "gonio"


def test_the_wheel_alone_runs_the_demo_and_reports(gonio: Path, tmp_path: Path) -> None:
    """One command from nothing to a report that opens in a browser; each step leaves a file."""
    for module in EXTRAS:
        assert run(gonio.with_name("python"), "-c", f"import {module}").returncode, f"{module} is there"
    done = run(gonio, "demo", "--quick", "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = tmp_path / done.stdout.strip().splitlines()[-1]
    assert report.name == "index.html"
    assert report.is_file()
    for name in ("plan.toml", "sample.toml", "run.toml", "plan.csv", "journal.jsonl", "brdf.csv", "summary.json"):
        assert list((tmp_path / "out").rglob(name)), name
    text = next((tmp_path / "out").rglob("summary.json")).read_text(encoding="utf-8")
    assert "sigma0_um" in text
    assert "reduced_chi_square" in text
    assert "NaN" not in text  # not JSON: a missing number is null
    json.loads(text)
    table = tmp_path / "out" / "run" / "brdf.csv"
    assert measurement.is_simulated(measurement.read(table))
    done = run(gonio, "compare", table, "--models", "lambert", "--out", tmp_path / "page", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "page" / "index.html").is_file()


def test_what_an_extra_brings_is_named_with_how_to_get_it(gonio: Path, tmp_path: Path) -> None:
    measurement.write(measure(Lambert(0.6), incidences=(20.0,)), tmp_path / "t.csv")
    workbook = run(gonio, "convert", tmp_path / "t.csv", tmp_path / "t.xlsx", cwd=tmp_path)
    assert workbook.returncode == 2
    assert workbook.stderr.strip().endswith('pip install "gonio[workbooks]"'), workbook.stderr
    (tmp_path / "lab.toml").write_text('rig = "lab"\n')
    rig = run(gonio, "rig", "check", "--rig", "lab", cwd=tmp_path)
    assert rig.returncode == 2
    assert rig.stderr.strip().endswith('pip install "gonio[lab]"'), rig.stderr
