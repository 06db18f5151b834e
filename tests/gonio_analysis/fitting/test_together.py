"""Several tables of one sample in one fit: each with its own instrument, and its own common causes."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gonio_analysis import commands
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.observations import observations, together

from gonio import measurement
from gonio.errors import ConfigError, DataError
from gonio.models import Lambert, build
from tests.gonio_analysis.synthetic import known, measure


def flat(value: float, u: float, common: float, count: int = 40) -> pd.DataFrame:
    """Values of a Lambertian sample: all alike, with an independent and a common standard uncertainty."""
    table = measure(Lambert(albedo=0.5), noise=0.01, seed=1).iloc[:count].reset_index(drop=True)
    table["brdf"], table["u_random"] = value, u
    table = table[[c for c in table.columns if not c.startswith("s_")]].copy()
    table["s_scale"] = common
    table["u_brdf"] = math.hypot(u, common)
    return table


def test_each_table_has_its_own_scale_error() -> None:
    a, b = flat(0.20, 1e-4, 0.002), flat(0.21, 1e-4, 0.004)
    both = together({name: observations(table, name) for name, table in (("a", a), ("b", b))})
    assert known(both.covariance).causes == ("scale@a", "scale@b")
    # by hand: two estimates of variance u^2/n + s^2, weighted by it; the columns are scaled to where the search with
    # the independent parts alone ends, which is the mean, 0.205
    result = fit(both, "lambert")
    found = result.parameters["albedo"].value / math.pi
    weights = 1.0 / np.array([1e-8 / 40 + (0.002 * 0.205 / 0.20) ** 2, 1e-8 / 40 + (0.004 * 0.205 / 0.21) ** 2])
    assert found == pytest.approx(float(weights @ [0.20, 0.21] / weights.sum()), rel=1e-4)
    assert known(result.parameters["albedo"].u) / math.pi == pytest.approx(float(weights.sum() ** -0.5), rel=1e-3)
    assert [note for note in result.notes if note.startswith(("a: chi-square", "b: chi-square"))]


def test_each_table_is_seen_through_its_own_cones() -> None:
    model = build("he-torrance", {"sigma0_um": 0.2, "tau_um": 3.0, "ior": 0.77 + 6.08j, "diffuse_albedo": 0.1})
    wide = measure(model, noise=0.01, seed=3)
    narrow = wide.copy()
    narrow.attrs = wide.attrs | {"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0}
    wide.attrs |= {"source_solid_angle_sr": 3e-3, "receiver_solid_angle_sr": 1e-3}
    parts = {"wide": observations(wide), "narrow": observations(narrow)}
    one = np.concatenate([apparent(model, part) for part in parts.values()])
    np.testing.assert_allclose(apparent(model, together(parts)), one, rtol=1e-12)
    assert not np.allclose(one[: len(wide)], one[len(wide) :], rtol=1e-3)
    assert math.isnan(together(parts).source_solid_angle_sr)
    taken = together(parts).take(np.arange(len(wide), 2 * len(wide)))
    np.testing.assert_allclose(apparent(model, taken), one[len(wide) :], rtol=1e-12)


def test_a_table_without_uncertainties_or_at_another_wavelength_is_refused() -> None:
    a, b = flat(0.2, 1e-4, 0.002), flat(0.21, 1e-4, 0.004)
    silent = b.drop(columns="s_scale").assign(u_brdf=math.nan, u_random=math.nan)
    with pytest.raises(DataError, match="b: states no uncertainties"):
        together({"a": observations(a), "b": observations(silent)})
    red = b.assign(wavelength_nm=650.0)
    with pytest.raises(DataError, match="b: has no value at 550 nm"):
        fit(together({"a": observations(a), "b": observations(red)}), "lambert")


def test_an_offset_of_the_sensor_is_not_scaled_with_the_values() -> None:
    # values of 10 % noise: an offset's column, scaled by fitted / measured, would follow the noise and pull the level
    rng = np.random.default_rng(4)
    pulls = []
    for _ in range(30):
        table = flat(0.2, 0.02, 0.004, count=60).rename(columns={"s_scale": "s_black_level"})
        table["brdf"] = 0.2 + 0.02 * rng.standard_normal(60) + 0.004 * rng.standard_normal()
        albedo = fit(table, "lambert").parameters["albedo"]
        pulls.append((albedo.value - 0.2 * math.pi) / known(albedo.u))
    assert abs(np.mean(pulls)) < 3.0 / math.sqrt(30)
    assert fit(table, "lambert").parameters["albedo"].u == pytest.approx(
        math.pi * math.hypot(0.02 / math.sqrt(60), 0.004), rel=1e-3
    )


def test_the_command_takes_several_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = []
    for name, value in (("a", 0.20), ("b", 0.21)):
        measurement.write(flat(value, 1e-4, 0.002), tmp_path / f"{name}.csv")
        names.append(str(tmp_path / f"{name}.csv"))
    commands.fit("lambert", names[0], more=names[1:], as_json=True)
    out = json.loads(capsys.readouterr().out)
    assert out["table"] == names
    assert out["n_points"] == 80
    with pytest.raises(ConfigError, match="named twice"):
        commands.fit("lambert", names[0], more=names[:1])
