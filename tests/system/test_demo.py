"""`gonio demo`: one command from nothing to a report that opens in a browser."""

import json
import subprocess
from pathlib import Path

import pytest

from gonio import measurement
from tests.system.conftest import HANGS_S, command_line, environment

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


def test_every_step_leaves_a_file_and_the_report_is_printed_last(quick_demo: tuple[Path, str]) -> None:
    folder, printed = quick_demo
    report = Path(printed.strip().splitlines()[-1])
    assert report.name == "index.html"
    assert (folder / report).is_file()
    for name in ("plan.toml", "sample.toml", "run.toml", "plan.csv", "journal.jsonl", "brdf.csv", "summary.json"):
        assert list((folder / "out").rglob(name)), name
    text = next((folder / "out").rglob("summary.json")).read_text(encoding="utf-8")
    assert "sigma0_um" in text
    assert "reduced_chi_square" in text
    assert "NaN" not in text  # not JSON: a missing number is null
    json.loads(text)
    assert measurement.is_simulated(measurement.read(folder / "out" / "run" / "brdf.csv"))
