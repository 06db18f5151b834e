"""A part of the page of one's own: numbers, a drawing and words, by one object and one line."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from gonio_analysis.report import making as report
from gonio_analysis.report import sample, sections
from gonio_analysis.report.blocks import Block, Figures, Heading, Paragraph
from gonio_analysis.report.drawing import Drawing
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.section import Figures as ByKind
from gonio_analysis.report.section import Section
from gonio_analysis.selection.compare import Dataset

from gonio import measurement
from gonio.models import build
from tests.gonio_analysis.synthetic import measure


def histogram(figure: Any, values: list[float]) -> None:
    figure.add_subplot().hist(values)


def facts(d: Dataset) -> dict[str, float]:
    return {"brightest": float(d.data.brdf.max())}


def draw(d: Dataset, f: DatasetSummary) -> list[Drawing]:
    on = partial(histogram, values=d.data.brdf.tolist())
    return [Drawing(f"{f.slug}-spread", "spread", "", "How values spread.", "Histogram.", (4.0, 2.0), on)]


def blocks(d: DatasetSummary, figures: ByKind) -> list[Block]:
    assert d.sections is not None
    brightest = d.sections["spread"]["brightest"]
    return [Heading(3, "Spread"), Paragraph(f"The brightest value is {brightest:.3g}."), Figures(figures["spread"])]


def test_a_section_of_ones_own_is_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = (*sections.SECTIONS, Section("spread", blocks, draw, facts))
    for module in (report, sample):
        monkeypatch.setattr(module, "SECTIONS", listed)
    table = measure(build("lambert", {"albedo": 0.5}), incidences=(30.0,), name="matte")
    measurement.write(table, tmp_path / "t.csv")
    page = report.make([str(tmp_path / "t.csv")], tmp_path / "page", models=("lambert",)).read_text(encoding="utf-8")
    assert "The brightest value is " in page
    assert "How values spread." in page
    summary = json.loads((tmp_path / "page" / "summary.json").read_text(encoding="utf-8"))
    assert summary["datasets"][0]["sections"]["spread"]["brightest"] == pytest.approx(table["brdf"].max())
    assert list((tmp_path / "page" / "figures").glob("*-spread.svg"))
