"""The words of every kind of figure stand clear of each other, and curves are told apart without their colours."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.changes.laboratories import compared
from gonio_analysis.changes.point_by_point import change
from gonio_analysis.changes.sides import of_table
from gonio_analysis.curves.in_plane import curves
from gonio_analysis.plots import diagnostics, in_plane, maps, pixels, style
from gonio_analysis.report import budget, change_figures, checks, drawing, health
from gonio_analysis.report import making as report
from gonio_analysis.report.drawing import Drawing, Figure
from gonio_analysis.result_records import ChecksSummary
from gonio_analysis.selection.compare import examine
from gonio_maps.report import map_change, map_page

from gonio.formats.reader import MUELLER, U_MUELLER, table
from gonio.models import build
from gonio.run_facts import BudgetCurve, BudgetFacts, BudgetPart, HealthSummary
from gonio.typing import Floats
from tests.gonio_analysis.synthetic import facts_of, joined, measure
from tests.gonio_maps.map_files import fits
from tests.pictures import faults

GLOSS = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30})
LONG = "a sample whose name is far longer than anybody would make it, of the third delivery of the year"


def clear(drawings: Sequence[Drawing], *kinds: str) -> None:
    """Of every figure the words stand clear; the kinds are those that should be among them."""
    assert set(kinds) <= {one.kind for one in drawings}
    assert [fault for one in drawings for fault in faults(one)] == []


def of_report(frame: pd.DataFrame, *models: str) -> list[Drawing]:
    """Every figure of a sample in a report."""
    found = examine(frame, models or ("lambert", "phong"), name=str(frame.attrs["sample"]))
    (drawn,) = report._drawings([facts_of(found)], None)
    return drawn


def times(factor: float) -> pd.DataFrame:
    frame = measure(GLOSS, name="x", reference=0.01)
    values = ["brdf", "u_brdf", "u_random", "s_reference"]
    return frame.assign(**{name: frame[name] * factor for name in values})


def dome() -> pd.DataFrame:
    rng = np.random.default_rng(3)
    theta_i, phi_r = np.repeat([10.0, 40.0, 65.0], 120), rng.uniform(0.0, 360.0, 360)
    theta_r = np.degrees(np.arccos(rng.uniform(0.1, 1.0, 360)))
    value = GLOSS.brdf(np.radians(theta_i), 0.0, np.radians(theta_r), np.radians(phi_r))
    return table(
        theta_i_deg=theta_i, phi_i_deg=0.0, theta_r_deg=theta_r, phi_r_deg=phi_r, wavelength_nm=550.0,
        brdf=value * (1 + 0.01 * rng.normal(size=360)), u_brdf=0.01 * value, u_random=0.01 * value,
        attrs={"sample": "dome"},
    )  # fmt: skip


def spectrum() -> pd.DataFrame:
    each = [build("phong", {"k_d": nm / 2000, "k_s": 0.5, "exponent": nm / 20}) for nm in (450.0, 550.0, 650.0)]
    parts = [measure(m, wavelength_nm=nm, name="x") for m, nm in zip(each, (450.0, 550.0, 650.0), strict=True)]
    return joined(*parts)


SAMPLES: dict[str, Callable[[], pd.DataFrame]] = {
    "one incidence": lambda: measure(GLOSS, incidences=(30.0,)),
    "seven incidences": lambda: measure(GLOSS, incidences=(0.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0), reference=0.01),
    "coarse": lambda: measure(GLOSS, views=np.array([-60.0, 0.0, 30.0, 60.0])),
    "dense": lambda: measure(GLOSS, views=np.arange(-85.0, 85.01, 0.5)),
    "a long name": lambda: measure(GLOSS, name=LONG),
    "letters that are square": lambda: measure(GLOSS, name="塗料" * 20),
    "tiny": lambda: times(1e-12),
    "huge": lambda: times(1e12),
    "lost in noise": lambda: measure(GLOSS, floor=0.3),
    "two alike": lambda: measure(GLOSS, incidences=(30.0, 30.04)),
    "narrow": lambda: measure(build("phong", {"k_d": 0.01, "k_s": 0.9, "exponent": 3000.0}), reference=0.001),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLES)
def test_figures_of_a_sample(name: str) -> None:
    clear(of_report(SAMPLES[name]()), "polar", "absolute", "overlay")


@pytest.mark.slow
def test_figures_out_of_the_plane() -> None:
    clear(of_report(dome()), "heat", "slices", "lobe", "profile")


@pytest.mark.slow
def test_figures_of_a_spectrum() -> None:
    clear(of_report(spectrum()), "series")


@pytest.mark.slow
def test_figures_of_both_sides_and_of_matrices() -> None:
    reflected, through = (measure(GLOSS, incidences=(0.0, 30.0, 60.0), name="sheet") for _ in range(2))
    through = through.assign(theta_r_deg=180.0 - through["theta_r_deg"])
    frame = joined(reflected.assign(side="reflection"), through.assign(side="transmission"))
    clear(of_report(frame), "both-sides", "transmission")
    flag = reflected.pop("flag")
    matrix = dict.fromkeys(MUELLER, 0.4) | dict.fromkeys(U_MUELLER, 0.02)
    clear(of_report(reflected.assign(**matrix, flag=flag)), "mueller")


def test_figures_of_a_budget() -> None:
    angle = [-75.0, -30.0, 0.0, 30.0, 75.0]
    names = ["noise", "reference", "encoder", "coarse", "theta_i_zero"]
    each = [
        BudgetCurve(i, angle, [[0.2 + 0.01 * k] * 5 for k in range(5)]) for i in (0.0, 15.0, 30.0, 45.0, 60.0, 75.0)
    ]
    parts = [BudgetPart(name, True, 0.004, 0.01, 0.19) for name in names]
    for some in (each, each[:1], each[:3]):
        found = BudgetFacts(550.0, 99, 0.01, 0.02, 0.01, 0.02, parts, names, some, None, 0, {}, None)
        clear(budget.draw(found, "s"), "budget-shares")


def test_figures_of_a_run() -> None:
    time = np.linspace(0.0, 11.3, 200)

    def read(device: str, quantity: str, unit: str, value: Floats) -> HealthSummary:
        return HealthSummary(device, quantity, unit, 200, 0.0, 0.0, 1.0, 2.0, 1.0, list(time), list(value))

    many = [read(name, "temperature", "C", 1e4 * np.sin(time + k)) for k, name in enumerate(("light", "arm", "camera"))]
    many += [read("light", "current_max", "mA", 1e-7 * time), read("light", "voltage_min", "V", 12.0 + 0 * time)]
    clear(health.draw(SimpleNamespace(health=many, pauses=[]), "s"), "health")  # type: ignore[arg-type]
    for size in (1e-7, 0.01, 3.0):
        pairs = {name: list(size * np.linspace(-1.0, 1.0, 9)) for name in ("reciprocity", "mirror symmetry", "repeats")}
        found = ChecksSummary([], pairs, list(time), list(1e5 * (1 + size * np.abs(np.sin(time)))))
        clear(checks.draw(found, [], "s"), "checks")


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 8])
def test_figures_of_laboratories(count: int) -> None:
    every = [
        one.assign(brdf=one["brdf"] * (1.3 if k == 5 else 1.0))
        for k, one in enumerate(measure(GLOSS, seed=k, reference=0.005) for k in range(count))
    ]
    for word in ("lab", "the laboratory for optical metrology of the university of"):
        sides = [of_table(f"{word} {k + 1}", "x", one) for k, one in enumerate(every)]
        clear(change_figures.draw_laboratories(compared(sides, {})), "overview", "polar", "deviations", "youden", "map")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["x", LONG])
def test_figures_of_a_change(name: str) -> None:
    a, b = (of_table(f"{name} {k}", "x", measure(GLOSS, seed=k)) for k in range(2))
    for one, other in ((a, b), (of_table(f"{name} 3", "x", dome()), of_table(name, "x", dome().assign(brdf=1.0)))):
        found = change(one, other)
        at = replace(found.at, brdf=found.value_a, rows=np.arange(len(found.at)))
        drawn = curves(at)
        clear(change_figures.draw(found, at, drawn, 550.0), "map", *["values"] * bool(drawn))


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Drawing]:
    """What a page would have drawn."""
    every: list[Drawing] = []

    def note(self: Any, drawings: Sequence[Drawing], *rest: Any, **named: Any) -> list[Figure]:
        every.extend(drawings)
        return [replace_by_nothing(one) for one in drawings]

    monkeypatch.setattr(drawing.FigureWorkers, "draw", note)
    monkeypatch.setattr("gonio.platform.processors", lambda: 1)
    return every


def replace_by_nothing(one: Drawing) -> Figure:
    return Figure(one.name, one.kind, one.model, one.caption, one.alt, '<svg viewBox="0 0 1 1"></svg>', b"")


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "cols", "size"), [(12, 20, 1.0), (40, 4, 1e-9), (3, 60, 1e7)])
def test_figures_of_maps(rows: int, cols: int, size: float, tmp_path: Path, drawn: list[Drawing]) -> None:
    y, x = np.mgrid[:rows, :cols]
    paths = []
    for k in range(2):
        value = {"s": size * (0.3 + 0.001 * x), "m": 0.1 + 0.01 * y + 0.05 * k, "ior": 1.5 + 0.0 * y}
        u = {name: 0.02 * one for name, one in value.items()}
        paths.append(fits(tmp_path / f"{k}.h5", value, u, attrs={"parameters": list(value), "fixed": {"k": 0.0}}))
    map_page.make(paths[0], tmp_path / "map")
    map_change.make([str(path) for path in paths], tmp_path / "change")
    clear(drawn, "map", "histograms")


# --- without colours -----------------------------------------------------------------------------------------------

LIGHTER = 0.15
"""Difference of luminance that is seen in grey print: a step of the eight that a reader tells there."""


def luminance(colour: str) -> float:
    """Relative luminance of a colour, of the sRGB standard IEC 61966-2-1."""
    from matplotlib.colors import to_rgb

    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    return float(np.dot([0.2126, 0.7152, 0.0722], linear))


@pytest.mark.parametrize(
    ("look", "count"),
    [
        (lambda k: in_plane.style(k)["marker"], 6),
        (in_plane.dashes, 6),
        (lambda k: diagnostics.look(k)["ls"], 6),
        (lambda k: budget._filled(k, 7)["hatch"], 6),
        (lambda k: (in_plane.style(k)["color"], in_plane.style(k)["marker"]), 36),
        (lambda k: (in_plane.style(k)["color"], in_plane.dashes(k)), 36),
    ],
)
def test_curves_differ_without_their_colours(look: Callable[[int], object], count: int) -> None:
    assert len({look(k) for k in range(count)}) == count


@pytest.mark.parametrize("inches", [2.0, 5.6, 7.0])
@pytest.mark.parametrize("name", ["θi = 10°*", "matte plaster, dark (simulated)", "塗料のサンプル"])
def test_names_that_stand_beside_each_other_are_whole(name: str, inches: float) -> None:
    count = style.columns([name] * 6, inches)
    assert count == 1 or style.short(name, inches, beside=count) == name


def test_theory_and_measurement_of_a_curve_are_solid_and_dashed() -> None:
    theory, measured = in_plane.kinds("theory", "measured")
    assert (theory.is_dashed(), measured.is_dashed()) == (False, True)


def test_marks_that_a_colour_alone_tells_apart_differ_in_grey() -> None:
    kinds = pixels.KINDS[:2]  # most maps have two: what is usual, and what is not
    for one, other in combinations([luminance(c) for c in kinds], 2):
        assert abs(one - other) > LIGHTER


def test_colours_of_curves_are_those_for_any_colour_vision() -> None:
    okabe_ito = {"#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9"}
    assert okabe_ito < set(in_plane.COLOURS)  # and a yellow that is dark enough on white


@pytest.mark.parametrize("name", [maps.SEQUENTIAL, pixels.VALUES, pixels.UNCERTAINTIES])
def test_colours_of_values_rise_evenly_in_lightness(name: str) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    y = np.array([luminance(to_hex(colormaps[name](v))) for v in np.linspace(0.0, 1.0, 33)])
    lightness = np.where(y > 216 / 24389, 116 * np.cbrt(y) - 16, y * 24389 / 27)  # CIE 1976 L*
    steps = np.diff(lightness)
    # a step is at most twice the mean: jet, whose lightness falls twice, has negative ones
    assert (steps > 0).all()
    assert steps.max() < 2 * steps.mean()
