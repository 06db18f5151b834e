"""A cell of a notebook shows plot and table of a fit, a comparison and a measurement."""

from types import SimpleNamespace
from typing import Any

import gonio_analysis
import pandas as pd
import pytest
from gonio_analysis.report import cells

from gonio.errors import DataError
from gonio.models import build
from tests.gonio_analysis.synthetic import measure

GLOSS = build("phong", {"k_d": 0.3, "k_s": 0.4, "exponent": 40.0})


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return measure(GLOSS, noise=0.01, name="a <b> & $c$")


@pytest.fixture(scope="module")
def fit(table: pd.DataFrame) -> cells.ShownFit:
    return gonio_analysis.fit(table, "phong")


def test_a_fit(fit: cells.ShownFit) -> None:
    shown = fit._repr_html_()
    assert shown.count("<svg") == 1
    assert "exponent" in shown
    ax = fit.plot()
    assert len(fit.plot(ax=ax.figure.add_subplot(), semilog=True).lines) > 0


def test_a_comparison_begins_with_the_verdict_of_a_report(table: pd.DataFrame) -> None:
    found = gonio_analysis.compare(table, ["lambert", "phong"])
    shown = found._repr_html_()
    assert shown.index("phong describes the values within their uncertainties") < shown.index("<svg")
    assert shown.index("<svg") < shown.index("<table") < shown.index("95 % interval")
    assert "a &lt;b&gt; &amp; $c$" in shown
    assert "<b> &" not in shown
    assert len(found.plot(model="lambert").lines) > 0


def test_a_measurement_table_has_its_plot_and_no_other_table_changes(table: pd.DataFrame) -> None:
    registered: dict[Any, Any] = {}
    formatter = SimpleNamespace(for_type=lambda kind, shows: registered.update({kind: shows}))
    cells.add(SimpleNamespace(formatters={"text/html": formatter}))
    shows = registered[pd.DataFrame]
    assert shows(table).count("<svg") == 1
    assert "theta_i_deg" in shows(table)
    for other in (pd.DataFrame({"a": [1, 2]}), table[["theta_i_deg", "theta_r_deg", "phi_r_deg", "brdf"]].head(8)):
        assert shows(other) == getattr(other, "_repr_html_")()  # noqa: B009


def test_values_that_lie_on_no_curve_are_a_table_alone(table: pd.DataFrame) -> None:
    few = table.iloc[:1]
    shown = cells.table_html(few)
    assert shown is not None
    assert "<svg" not in shown
    with pytest.raises(DataError, match="plane of incidence"):
        cells.plotted(None, [], semilog=False, normalise="mirror")
