"""Plot functions draw on the axes that they are given and leave matplotlib's settings alone."""

import re
from dataclasses import replace
from typing import Any

import matplotlib
import numpy as np
import pytest
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.plots import diagnostics, in_plane, style
from gonio_analysis.plots.style import xy
from matplotlib.artist import Artist
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure


def line(label: str = "θi = 30°", top: float = 1.0, negative: bool = False) -> Line:
    angle = np.radians(np.linspace(-80, 80, 33))
    value = top * np.cos(angle - 0.5) ** 2
    if negative:
        value[:4] = -0.01
    return Line(label, angle, np.abs(value), angle, value, np.full(33, 0.02), 0.5, np.linspace(-3, 3, 33))


def values(angle: Any, value: Any) -> Line:
    """A measured curve without uncertainties or theory."""
    return Line("x", np.empty(0), np.empty(0), angle, value, np.full(np.size(angle), np.nan))


def axes() -> Any:
    return Figure(figsize=(5, 4)).add_subplot()


def half_disc_of(lines: list[Line], **how: Any) -> tuple[Any, list[tuple[str, Any]]]:
    """Axes of a half disc as pages have it, and its words with the room that each takes."""
    figure = Figure(figsize=(5.6, 3.6))
    ax = figure.add_axes((0.01, 0.1, 0.98, 0.89))
    in_plane.polar(ax, lines, **how)
    figure.canvas.draw()
    return ax, [(text.get_text(), text.get_window_extent()) for text in ax.texts]


def overprinted(words: list[tuple[str, Any]]) -> list[tuple[str, str]]:
    return [(a, b) for k, (a, one) in enumerate(words) for b, other in words[k + 1 :] if one.overlaps(other)]


def rim_of(ax: Any, radius: float) -> Any:
    """Points of the rim on the canvas."""
    turn = np.radians(np.linspace(-90.0, 90.0, 1441))
    return ax.transData.transform(np.stack(xy(turn, np.full(turn.size, radius)), axis=1))


@pytest.mark.parametrize(
    "draw",
    [
        lambda ax: in_plane.polar(ax, [line(), line("θi = 60°", 1.6)], radius_label="f / f(mirror)"),
        lambda ax: in_plane.semilog(ax, [line(), line(negative=True)]),
        lambda ax: in_plane.residuals(ax, [line()], whitened=True),
        lambda ax: in_plane.residuals(ax, [line()], whitened=False, others=(np.zeros(2), np.array([50.0, -3.0]))),
        lambda ax: in_plane.residuals(ax, [line()], whitened=False, others=(np.zeros(2), np.array([np.inf, -3.0]))),
        lambda ax: diagnostics.budget(ax, [("combined", 0.01, 0.03), ("reference", 0.002, 0.002)]),
        lambda ax: diagnostics.series(ax, np.arange(3.0), np.ones(3), np.full(3, np.nan), x_label="x", y_label="y"),
    ],
)
def test_returns_artists_and_touches_no_settings(draw: Any) -> None:
    before = dict(matplotlib.rcParams)
    ax = axes()
    artists = draw(ax)
    assert artists
    for artist in artists:
        for one in artist if isinstance(artist, tuple) else (artist,):
            if isinstance(one, Artist):
                assert one.figure is ax.figure
    ax.figure.canvas.draw()
    assert dict(matplotlib.rcParams) == before


def test_half_disc_has_the_retro_side_left_and_the_mirror_side_right() -> None:
    artists = in_plane.polar(axes(), [values(np.radians([-60.0, 60.0]), np.array([0.2, 1.0]))])
    x, y = artists[1].get_data()  # the markers; the line between them has more points
    # a sine and a product: some roundings
    np.testing.assert_allclose(x, [-0.2 * np.sin(np.radians(60)), np.sin(np.radians(60))], rtol=1e-14)
    np.testing.assert_allclose(y, [0.1, 0.5], rtol=1e-14)


def test_radius_shows_ordinary_curves_whole() -> None:
    assert in_plane.radius_of([line(top=1.0)]) == 1.0
    assert in_plane.radius_of([line(top=1.3)]) == pytest.approx(1.4, rel=1e-14)  # a rounding of tenths


@pytest.mark.parametrize("unit", [1e-12, 0.037, 1.0, 1e12])
def test_the_rim_follows_what_is_shown_in_any_unit(unit: float) -> None:
    lines = [alone("a", 0.5 * unit), line("b", 1.3 * unit), line("c", 0.6 * unit)]
    rim = in_plane.radius_of(lines)
    top = max(float(x.max()) for one in lines for x in (one.theory, one.measured) if x.size)
    assert top <= rim < 1.5 * top  # the widest gap of round numbers: from 1.6 to 2, or from 2 to 2.5, and a little
    assert in_plane.radius_of([]) == in_plane.radius_of([values(np.zeros(2), np.array([-1.0, 0.0]))]) == 1.0


def test_neither_a_spike_nor_a_rejected_model_shrinks_the_lobes() -> None:
    lobes = [line("a", 0.9), line("b", 1.1)]
    for other in (line("spike", 300.0), alone("theory", 12.0)):
        assert in_plane.radius_of([*lobes, other]) == pytest.approx(1.2, rel=1e-14)  # a rounding of tenths
    assert in_plane.radius_of([*lobes, line("spike", 300.0)], np.inf) == pytest.approx(300.0, rel=1e-14)


@pytest.mark.parametrize("radius", [0.0013, 0.37, 1.0, 1.7, 2.3, 9.99, 123.0, 4e5])
def test_any_radius_has_ticks_that_keep_clear_of_each_other(radius: float) -> None:
    _, words = half_disc_of([line("a", radius)], radius=radius, radius_label="BRDF / sr⁻¹")
    assert not overprinted(words)
    ticks = [text for text, _ in words if re.fullmatch(r"[\d.]+", text)]
    assert 7 <= len(ticks) <= 17  # 3 to 8 a side


def test_a_band_of_a_factor_of_two_is_two_lines() -> None:
    from matplotlib.patches import Polygon

    for draw in (in_plane.polar, in_plane.semilog):
        for factor, thin in ((1.9, 0), (2.1, 2), (1e9, 2)):
            ax = axes()
            draw(ax, [replace(line(), tau=float(np.log(factor)))])
            filled = [one for one in ax.get_children() if isinstance(one, Polygon | PolyCollection)]
            assert len(filled) == (0 if thin else 1)
            assert sum(one.get_linewidth() == style.THIN for one in ax.get_lines()) == thin


def test_captions_say_where_the_rim_is_and_what_stands_on_it() -> None:
    assert in_plane.rim_words([line()], 1.4) == (
        " The rim is at 1.4, by what is shown. Strokes on the rim, in the colours of the curves: their mirror"
        " directions."
    )
    assert in_plane.rim_words([values(np.zeros(1), np.ones(1))], 2.0, 2.0) == " The rim is at 2, as asked for."


def test_a_curve_beyond_the_rim_is_cut_with_a_note() -> None:
    lines = [line(top=1.0), line("θi = 75°", 40.0)]
    rim = in_plane.radius_of(lines)
    assert rim < 2
    texts = [a.get_text() for a in in_plane.polar(axes(), lines, radius=rim) if hasattr(a, "get_text")]
    assert texts == ["θi = 75°: theory to 40 and measured to 40"]


def test_notes_of_six_curves_overprint_no_label_and_not_the_rim() -> None:
    ax, words = half_disc_of([line(f"θi = {k}5°", 40.0 + k) for k in range(1, 7)], radius=2.5)
    assert not overprinted(words)
    notes = [box for text, box in words if "theory to" in text]
    assert len(notes) == 6
    assert not any(note.contains(*point) for note in notes for point in rim_of(ax, 2.5))


def test_error_bars_have_the_length_of_u() -> None:
    from matplotlib.collections import LineCollection

    bars = next(a for a in in_plane.polar(axes(), [line()]) if isinstance(a, LineCollection))
    segment = bars.get_segments()[16]  # at the normal, where the radius is y
    assert segment[1][1] - segment[0][1] == pytest.approx(0.04, abs=1e-15)  # a difference of numbers near 1


@pytest.mark.parametrize("size", [5e-324, 1e-300, 1e300])
def test_any_number_that_a_table_may_hold_can_be_drawn(size: float) -> None:
    figure = Figure()
    ax = figure.add_subplot()
    value = size * np.array([1.0, 1e3, 1e6])
    in_plane.semilog(ax, [values(np.radians([-30.0, 0.0, 30.0]), value)])
    with np.errstate(all="ignore"):
        figure.canvas.draw()
    (shown,) = [line for line in ax.get_lines() if np.size(line.get_ydata()) == 3]
    np.testing.assert_array_equal(shown.get_ydata(), value)
    low, high = ax.get_ylim()
    assert 0 < low <= value.min()
    assert value.max() <= high < np.inf


def alone(label: str, top: float = 1.0) -> Line:
    angle = np.radians(np.linspace(-80, 80, 33))
    nothing = np.empty(0)
    return Line(label, angle, top * np.cos(angle) ** 2, nothing, nothing, nothing, 0.5)


@pytest.mark.parametrize("draw", [in_plane.polar, in_plane.semilog, lambda ax, x: in_plane.linear(ax, x, y_label="f")])
def test_theory_wears_no_markers_and_without_values_dashes_of_its_own(draw: Any) -> None:
    ax = axes()
    draw(ax, [alone("a"), alone("b")])
    curves = [one for one in ax.get_lines() if np.size(one.get_xdata()) == 33]
    assert [one.get_marker() for one in curves] == ["None", "None"]
    assert [one.is_dashed() for one in curves] == [False, True]
    ax = axes()
    draw(ax, [line("a"), alone("b")])  # dashes are those of the measurement
    theory = [one for one in ax.get_lines() if one.get_label() in ("a", "b")]
    assert [one.is_dashed() for one in theory] == [False, False]


def test_a_half_disc_whose_light_comes_from_the_right() -> None:
    lines = [line(f"θi = {k}5°", 40.0 + k) for k in range(1, 7)]
    how = {"radius": 2.5, "radius_label": "intensity", "retro_right": True, "called": "simulated"}
    ax, words = half_disc_of(lines, **how)
    boxes, end = dict(words), ax.figure.bbox
    assert boxes["retro side"].x0 > boxes["mirror side"].x1
    assert boxes["−60°"].x0 > boxes["60°"].x1
    assert any("simulated to" in text for text in boxes)
    assert not overprinted(words)
    assert all(box.x0 >= 0 and box.x1 <= end.x1 and box.y0 >= 0 and box.y1 <= end.y1 for _, box in words)


def test_theory_beyond_the_measured_angles_does_not_press_the_values_flat() -> None:
    angle = np.radians([-60.0, 0.0, 60.0])
    measured = np.array([0.3, 0.3, 0.5])
    one = Line("x", np.radians([0.0, 60.0, 89.0]), np.array([0.3, 0.5, 30.0]), angle, measured, np.full(3, np.nan))
    ax = axes()
    in_plane.semilog(ax, [one])
    low, high = np.log(ax.get_ylim())
    assert (np.log(0.5) - np.log(0.3)) / (high - low) > 0.2  # 0.09 where the axis reaches to 30
    assert low < np.log(0.3)
    assert high > np.log(0.5)


def test_an_overlay_has_every_model_and_the_values() -> None:
    ax = axes()
    angle = np.radians([-30.0, 0.0, 30.0])
    ends = in_plane.overlay(ax, line(), [(angle, np.full(3, 0.1)), (angle, np.array([0.1, 9.0, np.inf]))])
    assert ends[0] == line().measured[line().measured > 0].min()
    assert ends[1] == 9.0
    models = [one for one in ax.get_lines() if np.size(one.get_xdata()) == 3]
    assert [one.get_marker() for one in models] == ["None", "None"]
    assert len({(one.get_color(), one.is_dashed()) for one in models}) == 2
    (points,) = [one for one in ax.get_lines() if one.get_marker() == "."]
    assert np.size(points.get_xdata()) == np.count_nonzero(line().measured > 0)


def test_a_line_between_values_far_apart_goes_around_the_disc() -> None:
    artists = in_plane.polar(axes(), [values(np.radians([-40.0, 40.0]), np.ones(2))])
    # a chord of 3 degrees dips by 1 - cos(1.5 degrees) below the circle; one of 80 degrees by 0.23
    assert np.hypot(*artists[0].get_data()).min() == pytest.approx(1.0, abs=1e-12)
    assert np.degrees(np.diff(np.arctan2(*artists[0].get_data()))).max() < 3.2


def test_angles_around_the_half_disc_do_not_stand_on_its_rim() -> None:
    ax, words = half_disc_of([line()], radius=1.0)
    labels = [box for text, box in words if text in ("−60°", "−30°", "30°", "60°")]
    assert len(labels) == 4
    assert not any(box.contains(*point) for box in labels for point in rim_of(ax, 1.0))


def test_a_line_goes_through_every_value_that_it_joins() -> None:
    angle = np.radians([-80.0, -20.0, -19.0, -18.5, 0.0, 2.0, 80.0])  # dense, sparse, and between
    value = np.array([0.1, 0.5, 0.9, 0.2, 0.3, 0.8, 0.1])
    drawn = np.stack(in_plane.polar(axes(), [values(angle, value)])[0].get_data(), axis=1)
    for point in np.stack(xy(angle, value), axis=1):
        assert np.hypot(*(drawn - point).T).min() < 1e-14  # a rounding of the sum of an angle and a step
