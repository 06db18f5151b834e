"""`gonio demo`: one command from nothing to a report that opens in a browser."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from gonio import measurement
from tests.system.conftest import HANGS_S, Command, command_line, environment

pytestmark = pytest.mark.slow  # the whole line is walked once for all


@pytest.fixture(scope="module")
def quick_demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("demo")
    done = subprocess.run(
        [*command_line(), "demo", "--quick", "--out", "out"],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=HANGS_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


@pytest.mark.slow
def test_prints_the_report_last(quick_demo: tuple[Path, str]) -> None:
    folder, printed = quick_demo
    report = Path(printed.strip().splitlines()[-1])
    assert report.name == "index.html"
    assert (folder / report).is_file()


def test_every_step_left_a_file(quick_demo: tuple[Path, str]) -> None:
    folder, _ = quick_demo
    for name in ("plan.toml", "sample.toml"):
        assert list((folder / "out").rglob(name)), name
    for name in ("run.toml", "plan.csv", "journal.jsonl", "brdf.csv", "summary.json"):
        assert list((folder / "out").rglob(name)), name


def test_report_is_one_self_contained_file(quick_demo: tuple[Path, str]) -> None:
    folder, _ = quick_demo
    html = next((folder / "out").rglob("index.html")).read_text(encoding="utf-8")
    assert "<svg" in html or "data:image" in html
    outside = re.findall(r'(?:src|href)\s*=\s*"(?!#|data:)([^"]+)"', html) + re.findall(
        r"url\((?!#|data:)[^)]*\)", html
    )
    assert not [link for link in outside if not link.endswith((".csv", ".json"))]


def test_summary_holds_the_fit(quick_demo: tuple[Path, str]) -> None:
    folder, _ = quick_demo
    summary = json.loads(next((folder / "out").rglob("summary.json")).read_text(encoding="utf-8"))
    text = json.dumps(summary)
    assert "sigma0_um" in text
    assert "reduced_chi_square" in text
    assert "NaN" not in text  # not JSON: a missing number is null


@pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium on this machine: the report is not rendered")
def test_report_renders_without_errors(quick_demo: tuple[Path, str], tmp_path: Path) -> None:
    folder, _ = quick_demo
    html = next((folder / "out").rglob("index.html"))
    done = subprocess.run(
        [
            *("chromium", "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync"),
            *("--disable-background-networking", "--disable-component-update", f"--user-data-dir={tmp_path}"),
            *("--enable-logging=stderr", "--window-size=1280,2000", "--dump-dom", html.as_uri()),
        ],
        capture_output=True,
        encoding="utf-8",
        timeout=HANGS_S,
        check=False,
    )
    assert done.returncode == 0
    assert "sigma0" in done.stdout
    assert not [
        line for line in done.stderr.splitlines() if "CONSOLE" in line and ("rror" in line or "Refused" in line)
    ]


def test_a_copy_of_the_table_says_that_it_is_simulated(quick_demo: tuple[Path, str], tmp_path: Path) -> None:
    folder, _ = quick_demo
    measurement.write(measurement.read(folder / "out" / "run" / "brdf.csv"), tmp_path / "copy.csv")
    assert measurement.is_simulated(measurement.read(tmp_path / "copy.csv"))


def test_help_names_every_command(gonio: Command) -> None:
    text = gonio("--help").stdout
    for name in ("demo", "rig", "plan", "measure", "reduce", "fit", "compare", "report", "convert"):
        assert name in text
