"""Simulated values are called simulated: in titles, captions, legends, the interactive plot and on the console."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from gonio_analysis import commands
from gonio_analysis.report import appearance as report_on_appearance
from gonio_analysis.report import change, make

from gonio import measurement
from gonio.models import build
from tests.command_line import says
from tests.gonio_analysis.synthetic import measure

MATTE = build("lambert", {"albedo": 0.5})


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A simulated table (a copy, without its run) and a measured one."""
    folder = tmp_path_factory.mktemp("tables")
    for name, simulated in (("made", True), ("real", False)):
        frame = measure(
            MATTE, incidences=(20.0, 50.0), views=np.arange(-75.0, 76.0, 15.0), seed=int(simulated), name=name
        )
        frame.attrs["provenance"] = {"simulated": simulated}
        measurement.write(frame, folder / f"{name}.csv")
    return folder / "made.csv", folder / "real.csv"


def page(folder: Path) -> tuple[str, dict[str, object]]:
    return (folder / "index.html").read_text(encoding="utf-8"), json.loads(
        (folder / "summary.json").read_text(encoding="utf-8")
    )


def test_a_report_of_a_copied_table(files: tuple[Path, Path], tmp_path: Path) -> None:
    make([str(files[0])], tmp_path / "out", models=["lambert", "oren-nayar"])
    html, facts = page(tmp_path / "out")
    assert facts["title"] == "made (simulated)"
    says(html, "<title>made (simulated)", "What was simulated, and how")
    embedded = re.search(r"<script[^>]*application/json[^>]*>(.*?)</script>", html, re.DOTALL)
    assert embedded is not None
    view = json.loads(embedded[1])
    assert view["points"] == ["simulated"]
    assert {s["name"] for w in view["waves"] for c in w["curves"] for s in c["series"]} >= {"simulated"}
    drawn = [p for p in (tmp_path / "out" / "figures").glob("*.svg") if re.search("polar|absolute|overlay", p.name)]
    assert drawn
    for path in drawn:  # a figure that is taken out of its page
        assert ">simulated measurement<" in path.read_text(encoding="utf-8"), path.name


def test_a_report_of_both_marks_one(files: tuple[Path, Path], tmp_path: Path) -> None:
    make([str(f) for f in files], tmp_path / "out", models=["lambert"])
    html, facts = page(tmp_path / "out")
    assert facts["title"] == "made (simulated) and real"
    says(re.findall(r"<h2[^>]*>(.*?)</h2>", html), "made (simulated)", "real")


def test_a_change(files: tuple[Path, Path], tmp_path: Path) -> None:
    change.make([str(f) for f in files], tmp_path / "out")
    html, facts = page(tmp_path / "out")
    assert facts["title"] == "real against made (simulated)"
    says(html, "A: made (simulated)", " simulated values, with uncertainties")
    values = (tmp_path / "out" / "figures" / "values.svg").read_text(encoding="utf-8")
    says(values, ">A: made (simulated)<", ">B: real<")
    for figure in ("change", "map-plane"):
        caption = next(f["caption"] for f in facts["figures"] if f["name"] == figure)  # type: ignore[attr-defined]
        assert "Simulated: A." in caption


def test_appearance(files: tuple[Path, Path], tmp_path: Path) -> None:
    from gonio_analysis.report.appearance import of

    report_on_appearance.make(of(str(files[0])), tmp_path / "out")
    html, _ = page(tmp_path / "out")
    says(html, "Appearance of a simulated measurement", "<h1>made (simulated)</h1>")


def test_a_fit_on_the_console_and_as_json(files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    commands.fit("lambert", str(files[0]))
    assert "made (simulated)" in " ".join(capsys.readouterr().out.split())
    for path, simulated in zip(files, (True, False), strict=True):
        commands.fit("lambert", str(path), as_json=True)
        assert json.loads(capsys.readouterr().out)["simulated"] is simulated
