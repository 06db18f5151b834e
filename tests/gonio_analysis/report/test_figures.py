"""Figures hold what their captions say, and no panel stays empty."""

import re
from pathlib import Path

import numpy as np
import pytest
from gonio_analysis.report import figures, make
from gonio_analysis.selection.compare import Dataset, examine
from matplotlib.figure import Figure

from gonio import measurement
from gonio.formats.reader import table
from gonio.models import build
from tests.gonio_analysis.synthetic import facts_of, measure


def test_random_directions_leave_no_empty_panel(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    theta_i, theta_r = rng.uniform(5.0, 75.0, (2, 60))
    phi_i, phi_r = rng.uniform(0.0, 360.0, (2, 60))
    value = 0.16 * (1.0 + 0.05 * rng.normal(size=60))
    frame = table(
        theta_i_deg=theta_i, phi_i_deg=phi_i, theta_r_deg=theta_r, phi_r_deg=phi_r, wavelength_nm=550.0,
        brdf=value, u_brdf=0.05 * value, u_random=0.05 * value, attrs={"sample": "random"},
    )  # fmt: skip
    measurement.write(frame, tmp_path / "random.csv")
    make([str(tmp_path / "random.csv")], tmp_path / "out", models=["lambert"])
    svg = (tmp_path / "out" / "figures" / "random-absolute-lambert.svg").read_text(encoding="utf-8")
    box = re.search(r'viewBox="0 0 (\S+) (\S+)"', svg)
    assert box is not None
    assert float(box[2]) < 0.5 * float(box[1])  # one low panel: with the one above it is 0.72
    html = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "residuals alone" in html
    assert "with error bars" not in html


@pytest.fixture(scope="module")
def gloss() -> Dataset:
    table = measure(build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30}), noise=0.01, name="gloss")
    return examine(table, ["lambert", "oren-nayar", "phong"], name="gloss")


@pytest.mark.slow
def test_models_that_coincide_are_drawn_once_and_both_named(gloss: Dataset) -> None:
    groups = figures.coinciding(gloss)
    assert sorted(name for group in groups for name in group) == sorted(gloss.models)
    for group in groups:
        first = gloss.models[group[0]]
        for name in group[1:]:
            np.testing.assert_allclose(gloss.models[name].fit.predicted, first.fit.predicted, rtol=figures.SAME_CURVE)
    # a forward lobe leaves Oren and Nayar's backscatter nothing: sigma is 0, which is Lambert's surface
    assert groups == [["lambert", "oren-nayar"], ["phong"]]
    facts = facts_of(gloss)
    drawn = [d for d in figures.draw(facts, 500) if d.kind == "polar"]
    assert len(drawn) == len(groups)
    assert "which coincide" in drawn[0].caption
    assert all(name in drawn[0].caption for name in groups[0])


def test_all_models_stand_together_on_every_curve(gloss: Dataset) -> None:
    (overlay,) = [one for one in figures.draw(facts_of(gloss), 500) if one.kind == "overlay"]
    svg = overlay.rendered().svg
    for words in ("θi = 10°", "θi = 30°", "θi = 60°", "lambert = oren-nayar", "phong", "measurement"):
        assert f">{words}<" in svg
    figure = Figure(figsize=overlay.inches)
    overlay.on(figure)
    panels = [ax for ax in figure.axes if ax.axison]
    assert len(panels) == len(gloss.curves)
    for ax in panels:
        assert sum(line.get_linestyle() != "None" for line in ax.get_lines()) == 2


@pytest.mark.parametrize("kind", ["polar", "absolute", "overlay"])
def test_legends_stand_near_their_axes_and_overprint_nothing(gloss: Dataset, kind: str) -> None:
    for one in [one for one in figures.draw(facts_of(gloss), 500) if one.kind == kind]:
        figure = Figure(figsize=one.inches)
        one.on(figure)
        figure.canvas.draw()
        boxes = [ax.get_tightbbox() for ax in figure.axes if ax.axison or ax.texts]
        lowest = min(box.y0 for box in boxes if box is not None)
        keys = [key.get_window_extent() for key in figure.legends]
        assert max(key.y1 for key in keys) <= lowest
        assert lowest - max(key.y1 for key in keys) < 0.3 * figure.dpi  # inches
        assert not keys[0].overlaps(keys[1])
        assert all(key.x0 >= 0 and key.x1 <= figure.bbox.x1 and key.y0 >= 0 for key in keys)
