"""One number, one truth: what a page says twice, it says alike."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_analysis import commands
from gonio_analysis.changes.point_by_point import change
from gonio_analysis.changes.sides import Side
from gonio_analysis.changes.verdict import judge
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.profile_likelihood import Interval
from gonio_analysis.fitting.value_covariance import independent
from gonio_analysis.report.model_tables import fitted_words
from gonio_analysis.selection.compare import examine

from gonio.errors import ConfigError
from gonio.models import build
from tests.command_line import some
from tests.gonio_analysis.synthetic import facts_of, joined, measure

MATTE = build("lambert", {"albedo": 0.5})
GLOSS = build("phong", {"k_d": 0.3, "k_s": 0.4, "exponent": 40.0})


def interval(low: float, high: float, *, open_low: bool = False, open_high: bool = False) -> Interval:
    return Interval("s", low, high, open_low, open_high, 0.95, np.array([low, high]), np.array([4.0, 4.0]))


def test_the_page_shows_the_interval_alone_where_linearisation_fails() -> None:
    facts = facts_of(examine(measure(GLOSS, noise=0.01), ["phong"], name="x"))
    wrong = replace(facts.choice.intervals["k_s"], low=0.01, high=9.0)
    facts = replace(facts, choice=replace(facts.choice, intervals=facts.choice.intervals | {"k_s": wrong}))
    words = fitted_words(facts, "phong", facts.models["phong"])
    assert "95 % interval 0.01 to 9.00" in words
    assert "±" not in words.partition("k_s")[2].partition("exponent")[0]
    assert "±" in words.partition("exponent")[2]


def test_where_nothing_changed_no_value_has_changed() -> None:
    """The verdict is at 1 % for all values together, the marks at 5 %: one value could stand out of no change."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        n = 60
        b = 1.0 + 0.01 * rng.normal(size=n)
        b[0] += 0.033  # beyond 3 standard deviations: sometimes marked, seldom a verdict
        v = judge(np.ones(n), b, independent(np.full(n, 0.01)))
        assert v.changed or not v.marked.any()


def spectral(seed: int, colours: dict[float, float]) -> pd.DataFrame:
    parts = [
        measure(build("lambert", {"albedo": a}), wavelength_nm=nm, noise=0.01, seed=seed + k, incidences=(30.0,))
        for k, (nm, a) in enumerate(colours.items())
    ]
    return joined(*parts)


def test_change_heeds_the_wavelength() -> None:
    """They differ at 450 nm alone; at 650 nm nothing changed."""
    tables = spectral(1, {450.0: 0.2, 650.0: 0.5}), spectral(7, {450.0: 0.4, 650.0: 0.5})
    a, b = (Side(n, n, t, observations(t, n)) for n, t in zip("ab", tables, strict=True))
    both, blue, red = change(a, b), change(a, b, wavelength_nm=450), change(a, b, wavelength_nm=640)
    assert both.at.wavelengths == [450.0, 650.0]
    assert blue.at.wavelengths == [450.0]
    assert red.at.wavelengths == [650.0]
    assert some(blue.verdict).changed
    assert not some(red.verdict).changed
    assert any("650 nm alone is compared" in n for n in red.notes)
    model = Side("m", "m.toml", model=build("lambert", {"albedo": 0.2}))
    assert change(a, model, wavelength_nm=450).at.wavelengths == [450.0]


def test_every_curve_without_its_mirror_direction_is_listed() -> None:
    """Of eight curves six are drawn; the note named those alone."""
    thetas = tuple(float(t) for t in range(6, 83, 11))
    views = np.arange(-80.0, 81.0, 20.0)  # none of these is within 0.6 degrees of a mirror direction
    facts = facts_of(examine(measure(MATTE, incidences=thetas, views=views), ["lambert"], name="x"))
    (note,) = [n for n in facts.notes if n.startswith("The mirror direction was not measured")]
    assert all(f"θi = {t:g}°" in note for t in thetas)
    assert [np.degrees(at) for at, _ in facts.without_mirror] == pytest.approx(thetas)


def test_a_table_without_a_wavelength_is_not_said_to_hold_a_broad_band() -> None:
    frame = measure(MATTE, wavelength_nm=math.nan)
    with pytest.raises(ConfigError, match="has no single wavelength"):
        fit(frame, "he-torrance", ior=1.5)
    assert not any("broad" in n.lower() for n in fit(frame, "he-torrance", ior=1.5, wavelength_nm=600).notes)


def test_a_series_that_starts_in_another_valley_is_brought_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """A neighbour's start that ends elsewhere, at the same cost, gives way to a search that does not jump."""
    parts = [measure(GLOSS, noise=0.01, wavelength_nm=nm, seed=int(nm)) for nm in (540.0, 550.0, 560.0)]
    table = joined(*parts)

    def astray(data: Any, asked: Any, **options: Any) -> Any:
        found = fit(data, asked, **options)
        if asked.start is None or data.wavelengths != [560.0]:
            return found
        lost = {**found.parameters, "exponent": replace(found.parameters["exponent"], value=4000.0, u=1.0)}
        return replace(found, parameters=lost)

    monkeypatch.setattr("gonio_analysis.selection.compare.fit", astray)
    series = examine(table, ["phong"], name="x", separate=True).models["phong"].series
    assert [round(r.parameters["exponent"].value, -1) for r in series] == [40.0] * 3


def test_options_reach_the_command(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    import json

    from gonio import measurement

    frame = measure(MATTE, noise=0.03)
    frame[["u_brdf", "u_random"]] = np.nan
    measurement.write(frame, tmp_path / "t.csv")
    commands.fit("lambert", str(tmp_path / "t.csv"), u_rel=0.03, metric="weighted", as_json=True)
    out = json.loads(capsys.readouterr().out)
    assert (out["u_rel_assumed"], out["metric"]) == (0.03, "weighted")
    assert "assumed uncertainty of 3 %" in out["verdict"]
    commands.fit("lambert", str(tmp_path / "t.csv"), metric="ngan", as_json=True)
    assert json.loads(capsys.readouterr().out)["metric"] == "ngan"


def test_a_fit_says_what_its_model_reflects(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    import json

    from gonio import measurement

    bright = build("phong", {"k_d": 0.4, "k_s": 40.0, "exponent": 60.0})
    measurement.write(measure(bright, noise=0.01, floor=0.0, incidences=(10.0, 30.0)), tmp_path / "t.csv")
    commands.fit("phong", str(tmp_path / "t.csv"))
    assert "reflects more than it receives" in " ".join(capsys.readouterr().err.split())
    commands.fit("phong", str(tmp_path / "t.csv"), as_json=True)
    found = json.loads(capsys.readouterr().out)["rho_dh"]
    assert [round(r["theta_i_deg"]) for r in found] == [8, 10, 30]
    assert all(r["u"] > 0 for r in found)
