"""Names are data: no text of a figure is read as a formula, ends the drawing, or warns.

The kind: a character that means something to whoever draws (`$`, `_`, a control character), or that its font lacks.
"""

import io
import random
import xml.etree.ElementTree as ElementTree

import pytest
from matplotlib.figure import Figure

from gonio import canvas
from gonio.shown import visible
from tests.names import SCRIPTS, drawn_names


def drawing(names: list[str]) -> Figure:
    figure = Figure(figsize=(4.0, 3.0))
    with canvas.literal():
        ax = figure.add_subplot()
        lines = [ax.plot([1, 2, 3], [1e-3, 10.0, 1e3 * k], label=name)[0] for k, name in enumerate(names, 1)]
        ax.set_yscale("log")
        ax.set_xticks(range(1, 1 + len(names)), names)
        ax.set(title=names[0], xlabel=names[-1])
        figure.legend(lines, names)
        figure.suptitle(names[0])
    return figure


def written(figure: Figure) -> list[str]:
    """The texts of its SVG, which is XML."""
    svg = io.StringIO()
    canvas.save(figure, svg, format="svg")
    canvas.save(figure, io.BytesIO(), format="png")
    return ["".join(found.itertext()) for found in ElementTree.fromstring(svg.getvalue()).iter() if found.text]


@pytest.fixture(autouse=True)
def _texts(monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib

    monkeypatch.setitem(matplotlib.rcParams, "svg.fonttype", "none")


@pytest.mark.parametrize("names", [["c$x$", "p$\\bad$q"], ["$", "\\$ $$ $"], ["_a", "__"], ["^{", "}_{\\frac"]])
def test_no_name_is_a_formula(names: list[str]) -> None:
    found = written(drawing(names))
    for name in names:
        assert found.count(name) >= 3  # a title or label, the ticks, the legend


def test_numbers_along_a_logarithmic_axis_keep_their_powers() -> None:
    figure = drawing(["a", "b"])
    found = written(figure)
    assert not [words for words in found if "mathdefault" in words]
    assert "10" in "".join(found)
    assert all(text.get_parse_math() for text in figure.axes[0].yaxis.get_ticklabels())


def test_scripts_that_no_font_has_are_drawn_without_a_warning() -> None:
    names = list(SCRIPTS.values())
    for k in range(0, len(names), 12):
        found = written(drawing(names[k : k + 12]))
        assert set(names[k : k + 12]) <= set(found)


def test_drawn_names() -> None:
    names = drawn_names(random.Random(5), 12)
    assert set(names) <= set(written(drawing(names)))


def test_control_characters_stand_there_as_their_codes() -> None:
    names = [f"a{sign}b" for sign in "\x00\x0b\x1b\x7f\x9b\ufffe\ud800\u202e"]
    found = written(drawing(names))
    assert {visible(name) for name in names} <= set(found)
    assert visible("a\x0bb\ud800\n\tc") == "a\\x0bb\\ud800\n\tc"


def test_what_the_usual_font_has_needs_no_other() -> None:
    assert canvas.fallbacks("θr = 30°, µm, sr⁻¹, Образец, دع") == []
