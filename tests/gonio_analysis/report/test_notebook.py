"""What scripts and notebooks take from `gonio` and `gonio_analysis`."""

import subprocess
import sys
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import ClassVar

import gonio_analysis
import numpy as np
import pandas as pd
import pytest
from gonio_analysis.selection.compare import Dataset

import gonio
from gonio import plugins, shown
from gonio.errors import ConfigError, DataError
from gonio.models import ArrayModel, Fitted, Lambert, OrenNayar, build
from gonio.typing import Floats
from tests.command_line import says, some
from tests.gonio_analysis.synthetic import joined, measure

CLAY = OrenNayar(0.6, 20.0)


class _Cells(HTMLParser):
    """The cells of a table."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.cells: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        assert not self._open

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self._open.append(tag)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if {"td", "th"} & set(self._open):
            self.cells[-1] += data


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return measure(CLAY, noise=0.005)


def test_the_names_are_there_and_import_nothing_before_they_are_asked_for() -> None:
    code = (
        "import sys, gonio, gonio_analysis\n"
        "assert not {'numpy', 'pandas', 'numba', 'scipy', 'matplotlib'} & set(sys.modules)\n"
        "from gonio import (read, write, open_rig, HeTorrance, CookTorrance, OrenNayar, Blinn, Phong, Lambert, Sum,\n"
        "                   apparent_brdf)\n"
        "from gonio_analysis import fit, compare, polar, semilog, change\n"
        "assert 'matplotlib' not in sys.modules\n"
        "assert callable(change) and 'read' in dir(gonio) and 'fit' in dir(gonio_analysis)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for module in (gonio, gonio_analysis):
        with pytest.raises(AttributeError, match="no_such_name"):
            module.no_such_name  # noqa: B018


def test_a_fit_from_a_table_a_file_and_a_class(table: pd.DataFrame, tmp_path: Path) -> None:
    gonio.write(table, tmp_path / "clay.csv")
    results = [
        gonio_analysis.fit(gonio.read(tmp_path / "clay.csv"), "oren-nayar"),
        gonio_analysis.fit(tmp_path / "clay.csv", gonio.OrenNayar),
        gonio_analysis.fit(str(tmp_path / "clay.csv"), CLAY, name="clay"),
    ]
    for r in results:
        assert r.parameters["albedo"].value == results[0].parameters["albedo"].value
    text = repr(results[0])
    assert len(text) < 250
    says(text, "albedo = 0.6", "reduced chi-square")
    says(_Cells(results[0]._repr_html_()).cells, "sigma_deg", "fitted")
    with pytest.raises(ConfigError, match="did you mean"):
        gonio_analysis.fit(table, "oren-nayer")


def test_a_comparison(table: pd.DataFrame) -> None:
    found = gonio_analysis.compare(table, ["lambert", gonio.OrenNayar])
    assert isinstance(found, Dataset)
    assert some(found.choice.named).candidate.model == "oren-nayar"
    assert len(repr(found)) < 500
    assert "2 models fitted" in repr(found)
    assert {"lambert", "oren-nayar"} <= set(_Cells(found._repr_html_()).cells)


def test_a_change_of_tables_and_models(table: pd.DataFrame) -> None:
    same = gonio_analysis.change(table, measure(CLAY, noise=0.005, seed=1))
    assert not some(same.verdict).changed
    assert "no sign of a change" in repr(same)
    other = gonio_analysis.change(table, OrenNayar(0.5, 20.0))
    assert some(other.verdict).changed
    assert "changed" in repr(other)
    assert "log_ratio" in _Cells(other._repr_html_()).cells
    assert gonio_analysis.change(CLAY, CLAY).metrics["log_ratio"] == 0.0


def test_plots_from_tables_models_and_fits(table: pd.DataFrame) -> None:
    from matplotlib.figure import Figure

    for model, theory in ((None, False), (CLAY, True), (gonio_analysis.fit(table, "oren-nayar"), True)):
        for draw in (gonio_analysis.polar, gonio_analysis.semilog):
            ax = Figure().subplots()
            assert draw(ax, table, model)
            longest = max(np.size(line.get_xdata()) for line in ax.lines)
            assert (longest > 100) == theory  # theory has an angle every degree, the measurement one every five
    with pytest.raises(DataError, match="plane of incidence"):
        gonio_analysis.polar(Figure().subplots(), table.iloc[:1])
    with pytest.raises(ConfigError, match="no model is given"):
        gonio_analysis.polar(Figure().subplots(), table, normalise="model")


def test_a_fit_at_all_wavelengths_is_drawn_at_one() -> None:
    from matplotlib.figure import Figure

    parts = [
        measure(build("oren-nayar", {"albedo": a, "sigma_deg": 20.0}), wavelength_nm=w)
        for w, a in ((500, 0.3), (600, 0.5))
    ]
    whole = joined(*parts)
    result = gonio_analysis.fit(whole, "oren-nayar", each=["albedo"])
    assert "albedo@500" in repr(result)
    assert gonio_analysis.semilog(Figure().subplots(), whole, result, wavelength_nm=600.0)


def test_a_rig_opens_by_name(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text('name = "clay"\nmodel = "oren-nayar"\n[parameters]\nalbedo = 0.6\n')
    with gonio.open_rig("sim-ideal", sample=tmp_path / "s.toml") as rig:
        assert rig is not None
    with pytest.raises(ConfigError, match="did you mean"):
        gonio.open_rig("sin")


@dataclass(frozen=True)
class Dull(ArrayModel):
    """A model that no package brings."""

    level: float = 0.5
    name = "dull"
    fitted: ClassVar = {"level": Fitted(0.0, 1.0, starts="diffuse")}

    @property
    def convention(self) -> str:
        return "level / pi."

    def evaluate(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> Floats:
        return np.full(len(omega_i), self.level / np.pi)


class Usurper(Dull):
    """One that takes the name of a model that ships."""

    name = "lambert"


def test_a_class_of_ones_own_is_fitted_compared_and_given_intervals() -> None:
    flat = measure(Lambert(0.3), noise=0.005)
    result = gonio_analysis.fit(flat, Dull)
    assert result.parameters["level"].value == pytest.approx(0.3, abs=4 * 0.3 * 0.005)  # noise of one value
    (interval,) = result.intervals().values()
    assert interval.holds(result.parameters["level"].value)
    assert repr(interval).startswith("<95 % interval of level: 0.2")
    assert some(gonio_analysis.compare(flat, ["oren-nayar", Dull]).choice.named).candidate.model == "dull"
    assert gonio_analysis.compare(flat, Dull).choice.named is not None
    with pytest.raises(ConfigError, match="is not fitted; it fits level"):
        result.intervals("lever")


def test_a_class_that_cannot_be_found_again_is_refused(table: pd.DataFrame) -> None:
    class Hidden(Dull):
        name = "hidden"

    with pytest.raises(ConfigError, match="outside of functions"):
        gonio_analysis.fit(table, Hidden)
    with pytest.raises(ConfigError, match=r'"lambert".*has that name already'):
        gonio_analysis.fit(table, Usurper)
    with pytest.raises(ConfigError, match="with a name, not int"):
        gonio_analysis.fit(table, int)  # type: ignore[arg-type]
    assert not plugins._added


@pytest.mark.slow
def test_a_comparison_assumes_an_uncertainty_and_takes_a_metric(table: pd.DataFrame) -> None:
    bare = table.assign(u_brdf=np.nan, u_random=np.nan)
    bare.attrs = table.attrs
    assert gonio_analysis.compare(bare, ["oren-nayar"]).choice.judged[0].fit.chi_square is None
    found = gonio_analysis.compare(bare, ["oren-nayar"], u_rel=0.005, name="clay")
    assert "assumed uncertainty of 0.5 %" in found.choice.words
    assert gonio_analysis.compare(bare, "oren-nayar", metric="ngan").choice.judged[0].fit.goal.metric == "ngan"
    with pytest.raises(ConfigError, match="no such metric"):
        gonio_analysis.compare(bare, "oren-nayar", metric="mean")
    with pytest.raises(ConfigError, match="u-rel"):
        gonio_analysis.compare(bare, "oren-nayar", u_rel=-1.0)


@pytest.mark.parametrize(
    ("number", "u", "unit", "text"),
    [
        (0.279368, 0.00123, "um", "0.2794 ± 0.0012 µm"),
        (7.2429e-07, 7.1e-07, "", "(7.2 ± 7.1) × 10⁻⁷"),
        (0.047728, 0.134, "", "0.05 ± 0.13"),
        (12345.6, 321.0, "nm", "12\u00a0350 ± 320 nm"),
        (1.5, None, "", "1.5"),
        (1.5, 0.0, "deg", "1.5 deg"),
        (0.1, float("inf"), "", "0.1"),
    ],
)
def test_values_are_shown_to_the_second_digit_of_their_uncertainty(
    number: float, u: float | None, unit: str, text: str
) -> None:
    assert shown.value(number, u, unit) == text


@pytest.mark.parametrize("theory", [None, CLAY])
def test_curves_carry_their_names_for_a_legend(table: pd.DataFrame, theory: OrenNayar | None) -> None:
    from matplotlib.figure import Figure

    for draw in (gonio_analysis.polar, gonio_analysis.semilog):
        ax = Figure().subplots()
        draw(ax, table, theory)
        assert ax.get_legend_handles_labels()[1] == ["θi = 10°", "θi = 30°", "θi = 60°"]
    assert ax.get_xlabel().startswith("θr: retro side negative")
