"""Reports on large tables: pages that a browser takes, figures by several processes, and all values in files."""

import csv
import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.fitting.observations import observations
from gonio_analysis.plots import thinning
from gonio_analysis.report import change, drawing, html, make, page, viewer
from gonio_analysis.report.blocks import Figures, section
from gonio_analysis.report.drawing import Drawing, Figure, figure_workers
from gonio_analysis.report.text import glued
from gonio_analysis.result_records import as_json
from gonio_analysis.selection.choice import ModelChoice, choose
from gonio_analysis.selection.judging import Candidate

from gonio import measurement
from gonio.models import Phong, build
from tests.gonio_analysis.synthetic import joined, measure

pytestmark = pytest.mark.slow

LIMIT = 5_000_000
"""Bytes of a page."""
GLOSS = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30})


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """45 000 values in the plane of incidence and out of it, with noise: a marker for each would be 6 MB."""
    folder = tmp_path_factory.mktemp("large")
    flat = measure(GLOSS, views=np.linspace(-85.0, 85.0, 12_000), noise=0.05, name="large")
    around = []
    for dphi in (30.0, 60.0, 90.0):
        part = measure(GLOSS, incidences=(30.0,), views=np.linspace(-85.0, 85.0, 3_000), noise=0.05, name="large")
        around.append(part.assign(phi_r_deg=(part["phi_r_deg"] + dphi) % 360.0))
    measurement.write(joined(flat, *around), folder / "large.csv")
    make([str(folder / "large.csv")], folder / "out", models=["lambert", "phong"])
    return folder / "out"


def summary(report: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((report / "summary.json").read_text(encoding="utf-8"))
    return found


def test_a_large_table_makes_a_small_page_with_all_values_beside_it(large: Path) -> None:
    assert (large / "index.html").stat().st_size < LIMIT
    for drawn in (large / "figures").iterdir():
        assert drawn.stat().st_size < LIMIT / 5, drawn.name  # a page has a dozen
    facts = summary(large)["datasets"][0]
    with open(large / "tables" / "large-values.csv", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == facts["used"] == 45_000
    extremes = max(float(r["brdf"]) for r in rows), min(float(r["brdf"]) for r in rows)
    assert extremes == (facts["brdf_max"], facts["brdf_min"])
    with open(large / "tables" / "large-curves.csv", encoding="utf-8") as stream:
        curves = [r for r in csv.DictReader(stream) if r["kind"] == "measured" and r["model"] == "phong"]
    assert len(curves) == sum(c["points"] for c in facts["models"]["phong"]["curves"])
    assert len(curves) >= 36_000  # and some within 1.5 degrees of the plane near the normal


def test_a_page_says_how_many_values_are_drawn(large: Path) -> None:
    captions = {f["name"]: f["caption"].replace("\u00a0", "") for f in summary(large)["figures"]}
    for name in ("large-polar-phong", "large-absolute-phong", "large-heat-1", "large-slices-1", "large-lobe"):
        found = re.search(r"Drawn are (\d+) of (\d+) values", captions[name])
        assert found, name
        assert 100 < int(found[1]) < int(found[2])
    text = (large / "index.html").read_text(encoding="utf-8")
    assert all(glued(f["caption"]).partition(":")[2][:200] in text for f in summary(large)["figures"][:1])


def test_the_interactive_plot_is_thinned_with_its_extremes(large: Path) -> None:
    found = re.search(r'id="large-viewer-data">(.*?)</script>', (large / "index.html").read_text(encoding="utf-8"))
    assert found
    view = json.loads(found[1])
    assert len(found[1]) < 2_000_000
    facts = summary(large)["datasets"][0]["models"]["phong"]["curves"]
    for curve, whole in zip(view["waves"][0]["curves"], facts, strict=True):
        values = next(s["brdf"] for s in curve["series"] if s["name"] == "measured")
        assert len(values) < whole["points"]
        assert max(values) == pytest.approx(whole["measured_peak"], rel=1e-6)  # seven digits are embedded
    assert f"of the {sum(c['points'] for c in facts)} values" in view["note"]


def test_a_comparison_of_large_tables_has_a_small_page(tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 2)):
        table = measure(GLOSS, views=np.linspace(-85.0, 85.0, 4_000), noise=0.05, seed=seed, name=name)
        measurement.write(table, tmp_path / f"{name}.csv")
    change.make([str(tmp_path / "a.csv"), str(tmp_path / "b.csv")], tmp_path / "out")
    # 1.2 MB for the interactive plot, three figures of at most 0.35 MB, and text: whatever the number of rows
    assert (tmp_path / "out" / "index.html").stat().st_size < viewer.BYTES + 3 * 350_000 + 100_000
    with open(tmp_path / "out" / "tables" / "change.csv", encoding="utf-8") as stream:
        assert sum(1 for _ in stream) == 12_001
    assert all("Drawn are" in f["caption"] for f in summary(tmp_path / "out")["figures"])


def test_many_samples_are_spread_over_pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["one", "two", "three"]
    for name in names:
        measurement.write(measure(GLOSS, incidences=(20.0,), name=name), tmp_path / f"{name}.csv")
    specs = [str(tmp_path / f"{name}.csv") for name in names]
    make(specs, tmp_path / "whole", models=["lambert"])
    whole = (tmp_path / "whole" / "index.html").stat().st_size
    assert [p.name for p in (tmp_path / "whole").glob("*.html")] == ["index.html"]
    most = int(0.8 * whole)
    monkeypatch.setattr(page, "MOST_BYTES", most)
    make(specs, tmp_path / "out", models=["lambert"])
    pages = {p.name: p.read_text(encoding="utf-8") for p in (tmp_path / "out").glob("*.html")}
    assert {"index.html", "samples-2.html"} <= set(pages)
    assert all(len(text.encode()) <= most for text in pages.values())
    where = {name: [p for p, text in pages.items() if f'<details id="{name}">' in text] for name in names}
    assert all(len(found) == 1 for found in where.values())
    for text in pages.values():
        for target, anchor in re.findall(r'href="([^"#]*)#([^"]+)"', text):
            assert f'id="{anchor}"' in (pages[target] if target else text)


def test_a_section_that_is_too_large_names_its_largest_drawings() -> None:
    figures = [
        Figure(f"f{k}", "heat", "", f"c{k}: c", "", f"<svg>{'x' * length}</svg>", b"")
        for k, length in enumerate((100, 5000, 900))
    ]
    whole = section([Figures(tuple(figures))])
    small = html.fragment([html.within(whole, 2000)])
    assert len(small) <= 2000
    assert "figures/f1.svg" in small
    assert "figures/f0.svg" not in small
    assert all(f"c{k}" in small for k in range(3))
    assert html.within(whole, 10_000) == whole


def test_hundreds_of_causes_and_reasons_leave_a_page_readable(tmp_path: Path) -> None:
    table = measure(GLOSS, name="wide")
    causes = {f"s_cause_{k}": table["brdf"] * 1e-5 * (1 + k % 97) for k in range(400)}
    table = pd.concat([table, pd.DataFrame(causes)], axis=1)
    table.attrs = measure(GLOSS, name="wide").attrs
    table.loc[:39, "flag"] = [f"reason {k}" for k in range(40)]
    measurement.write(table, tmp_path / "wide.csv")
    make([str(tmp_path / "wide.csv")], tmp_path / "out", models=["lambert"])
    text = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert len(text.encode()) < LIMIT / 4
    assert "The first 300 of 402 rows; all are in tables/wide-budget.csv." in text
    with open(tmp_path / "out" / "tables" / "wide-budget.csv", encoding="utf-8") as stream:
        assert sum(1 for _ in stream) == 403
    assert "28 for 28 other reasons" in text
    assert len(summary(tmp_path / "out")["datasets"][0]["left_out"]) == 40
    assert "The 20 largest of 400 common causes" in text


# --- which values are drawn ----------------------------------------------------------------------------------------


def test_extremes_marked_values_and_ends_stay() -> None:
    rng = np.random.default_rng(3)
    x, y = np.sort(rng.uniform(0, 330, 50_000)), rng.normal(100, 10, 50_000)
    y[[7_000, 31_000]] = 260.0, -40.0
    marked = np.zeros(x.size, dtype=bool)
    marked[[11, 25_000, 49_000]] = True
    rows = thinning.enough(x, y, most=500, keep=marked)
    assert rows.size <= 500
    assert {0, 7_000, 31_000, x.size - 1} | set(np.flatnonzero(marked)) <= set(rows)
    assert np.all(np.diff(rows) > 0)
    assert np.diff(x[rows]).max() < 10.0  # no part of the angle is left empty


def test_few_values_are_all_drawn() -> None:
    x = np.linspace(0, 300, 120)
    assert thinning.enough(x, np.sin(x), most=200).tolist() == list(range(120))
    assert thinning.words(120, 120) == ""


def test_what_is_cut_at_the_rim_keeps_its_largest_value() -> None:
    angle = np.linspace(-1.5, 1.5, 5000)
    value = np.full(5000, 0.5)
    value[2500:2600] = np.linspace(3.0, 9.0, 100)
    none = np.empty(0)
    thin = thinning.on_half_disc([Line("l", none, none, angle, value, 0.01 * value)], 1.0, 170.0, 100)[0]
    assert thin.angle.size < 200
    assert thin.measured.max() == 9.0


# --- who draws -------------------------------------------------------------------------------------------------------


def _curve(figure: Any, *, power: int) -> None:
    ax = figure.add_axes((0.1, 0.1, 0.8, 0.8))
    x = np.linspace(0, 1, 30)
    ax.plot(x, x**power, marker="o")


def _fails(figure: Any) -> None:
    raise ZeroDivisionError


def drawings(on: Any, **each: list[Any]) -> list[Drawing]:
    (name, values), *_ = each.items()
    return [Drawing(f"d{k}", "k", "", "c", "a", (2.0, 1.5), partial(on, **{name: v})) for k, v in enumerate(values)]


def test_any_number_of_processes_makes_the_same_figures() -> None:
    wanted = drawings(_curve, power=list(range(1, 9)))
    with figure_workers(8, processes=1) as alone:
        first = alone.draw(wanted)
    with figure_workers(8, processes=3) as many:
        second = many.draw(wanted)
    assert first == second
    assert [f.name for f in second] == [d.name for d in wanted]


def test_a_drawing_that_fails_ends_every_process() -> None:
    wanted = [Drawing("d", "k", "", "c", "a", (2.0, 1.5), _fails) for _ in range(8)]
    with pytest.raises(ZeroDivisionError), figure_workers(8, processes=3) as workers:
        workers.draw(wanted)
    assert len(workers._processes) == 2
    assert all(p.returncode is not None for p in workers._processes)


def test_a_choice_is_the_same_whoever_works_it_out() -> None:
    table = measure(Phong(k_d=0.3, k_s=0.2, exponent=20.0))
    models = ["lambert", "oren-nayar", "phong"]
    data = observations(table, "sample")
    alone = choose(data, [Candidate(m) for m in models])
    with figure_workers(8, processes=2) as workers:
        shared = choose(data, [Candidate(m) for m in models], share=workers.share)

    def numbers(c: ModelChoice) -> Any:
        return [as_json(replace(x, wall_s=0.0)) for x in c.judged], as_json(c.intervals)

    assert numbers(shared) == numbers(alone)
    assert shared.words == alone.words


def test_few_figures_start_no_process() -> None:
    with figure_workers(drawing.FEW - 1, processes=4) as workers:
        assert workers._processes == []
