"""What scripts and notebooks take from `gonio` and `gonio_analysis`."""

from __future__ import annotations

import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import gonio_analysis
import numpy as np
import pandas as pd
import pytest
from gonio_analysis.selection.compare import Dataset

import gonio
from gonio.errors import ConfigError, DataError
from gonio.models import OrenNayar, build
from tests.gonio_analysis.synthetic import measure

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
        if self._open and self._open[-1] in ("td", "th"):
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
    assert "albedo = 0.6" in text
    assert "reduced chi-square" in text
    cells = _Cells(results[0]._repr_html_()).cells
    assert "sigma_deg" in cells
    assert "fitted" in cells
    with pytest.raises(ConfigError, match="did you mean"):
        gonio_analysis.fit(table, "oren-nayer")


def test_a_comparison(table: pd.DataFrame) -> None:
    found = gonio_analysis.compare(table, ["lambert", gonio.OrenNayar])
    assert isinstance(found, Dataset)
    assert found.choice.named is not None
    assert found.choice.named.candidate.model == "oren-nayar"
    assert len(repr(found)) < 500
    assert "2 models fitted" in repr(found)
    assert {"lambert", "oren-nayar"} <= set(_Cells(found._repr_html_()).cells)


def test_a_change_of_tables_and_models(table: pd.DataFrame) -> None:
    again = measure(CLAY, noise=0.005, seed=1)
    same = gonio_analysis.change(table, again)
    assert same.verdict is not None
    assert not same.verdict.changed
    assert "no sign of a change" in repr(same)
    other = gonio_analysis.change(table, OrenNayar(0.5, 20.0))
    assert other.verdict is not None
    assert other.verdict.changed
    assert "changed" in repr(other)
    assert "log_ratio" in _Cells(other._repr_html_()).cells
    assert gonio_analysis.change(CLAY, CLAY).metrics["log_ratio"] == 0.0


def test_plots_from_tables_models_and_fits(table: pd.DataFrame) -> None:
    from matplotlib.figure import Figure

    result = gonio_analysis.fit(table, "oren-nayar")
    for model, theory in ((None, False), (CLAY, True), (result, True)):
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
    whole = pd.concat(parts, ignore_index=True)
    whole.attrs = parts[0].attrs
    result = gonio_analysis.fit(whole, "oren-nayar", each=["albedo"])
    assert "albedo@500" in repr(result)
    assert gonio_analysis.semilog(Figure().subplots(), whole, result, wavelength_nm=600.0)


def test_a_rig_opens_by_name(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text('name = "clay"\nmodel = "oren-nayar"\n[parameters]\nalbedo = 0.6\n')
    with gonio.open_rig("sim-ideal", sample=tmp_path / "s.toml") as rig:
        assert rig is not None
    with pytest.raises(ConfigError, match="did you mean"):
        gonio.open_rig("sin")
