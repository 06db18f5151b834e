"""The budget in a report: its words, and its figure."""

import pytest
from gonio_analysis.report import budget
from gonio_analysis.report.blocks import Paragraph, Table, plain
from gonio_analysis.report.text import cause, meaning
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gonio.lab.reduction import angle_errors, table
from gonio.lab.reduction.table import COMPONENTS
from gonio.run_facts import BudgetCurve, BudgetFacts, BudgetPart

CAMERA = ("s_linearity", "s_linearity_2", "s_stray_light", "s_stray_light_2")
COMMON = (
    *table.COMMON,
    *table.DARK,
    *table.GEOMETRY,
    *table.LAMP,
    *table.POLARISATION,
    *table.LIGHT,
    *angle_errors.CAUSES.values(),
    *CAMERA,
)


@pytest.mark.parametrize("common", [True, False])
def test_every_cause_that_a_reduction_budgets_is_told_in_words_of_its_own(common: bool) -> None:
    names = [name.removeprefix("s_").replace("_", " ") for name in (COMMON if common else COMPONENTS)]
    words = [meaning(name, common=common) for name in names]
    assert all(words), dict(zip(names, words, strict=True))
    assert len(set(words)) == len(words)


def test_a_common_part_and_an_own_part_of_one_cause_are_told_apart() -> None:
    for name in ("beam", "polarisation"):
        assert meaning(name, common=True) != meaning(name, common=False)


def test_numbers_behind_a_cause_tell_its_patterns() -> None:
    assert meaning("polarisation", common=True) == "what lamp and lens polarise"
    assert meaning("polarisation 3", common=True) == (
        "what lamp and lens polarise: pattern 3 of those that values share, the strongest first"
    )
    assert cause("lamp_wander_2") == "lamp instability 2"
    assert cause("s_3") == "s 3", "the name of a cause that others wrote"


def test_titles_of_the_panels_keep_clear_of_the_scales() -> None:
    curves = [BudgetCurve(theta, [-60.0, 0.0, 60.0], [[0.5, 0.4, 0.6], [0.2, 0.3, 0.2]]) for theta in (0, 30, 60, 75)]
    figure = Figure(figsize=(5.6, 2 * budget.PANEL_IN + budget.FOOT_IN))
    FigureCanvasAgg(figure)
    budget._on_panels(figure, curves=curves, names=["a", "b", budget.REST], rows=2, columns=2)
    figure.draw_without_rendering()
    shown = [label for ax in figure.axes for label in ax.get_yticklabels() + ax.get_xticklabels() if label.get_text()]
    for ax in figure.axes:
        (title,) = (t for t in (ax.title, ax._left_title) if t.get_text())  # type: ignore[attr-defined]
        box = title.get_window_extent().padded(float(title.get_fontsize()) * figure.dpi / 72)  # a letter around
        assert not [label.get_text() for label in shown if box.overlaps(label.get_window_extent())]


def test_a_cause_without_a_part_has_no_row_of_zeros() -> None:
    parts = [BudgetPart("noise", False, 0.004, 0.01, 0.9), BudgetPart("geometry", False, 0.0, 0.0, 0.0)]
    facts = BudgetFacts(
        wavelength_nm=550.0, values=57, median=0.004, highest=0.01, median_apart=0.004, highest_apart=0.01,
        parts=parts, largest=["noise"], curves=[], nu_eff=None, coarse=0, left_out={}, monte_carlo=None,
    )  # fmt: skip
    found = budget.section(facts, [])
    (rows,) = (block.rows for block in found if isinstance(block, Table))
    assert [plain(row[0]) for row in rows] == ["combined", "noise"]
    said = " ".join(plain(block.text) for block in found if isinstance(block, Paragraph))
    assert "57 values in this budget, those beyond 3 u" in said
    assert "without a part in these values: geometry" in said
