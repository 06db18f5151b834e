"""A value that says nothing changes nothing: neither a fit, nor its verdict, nor what models are ranked by."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting import energy
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.misfit import u_of_log_tau
from gonio_analysis.fitting.objective import metrics
from gonio_analysis.fitting.observations import observations
from gonio_analysis.result_records import as_json
from gonio_analysis.selection.choice import candidates, choose
from gonio_analysis.selection.regions import farthest

from gonio.geometry import Directions
from gonio.models import CookTorrance, Lambert

from ..synthetic import known, measure
from .test_misfit import of_facets

GLOSSY = CookTorrance(s=0.9, d=0.1, slopes=((0.12, 1.0),), ior=1.5, diffuse_albedo=0.1)
VIEWS = np.arange(-70.0, 71.0, 10.0)


def tables() -> dict[str, tuple[pd.DataFrame, str]]:
    """Tables of kinds that count values in other ways, each with a model: true, foreign, glossy, polarised, noise."""
    foreign, _ = of_facets(11, "in plane")
    scattered, _ = of_facets(12, "hemisphere")
    polarised = measure(GLOSSY, views=VIEWS, noise=0.004, floor=1e-6, reference=0.003, seed=5)
    shape = np.cos(np.radians(polarised["theta_r_deg"])) * polarised["brdf"]
    polarised.insert(list(polarised.columns).index("flag"), "s_polarisation", 0.02 * shape)
    dark = measure(Lambert(0.5), views=VIEWS, noise=0.01, seed=6)
    dark["brdf"] = np.random.default_rng(8).normal(0.0, 0.01, len(dark))
    dark[["u_brdf", "u_random"]] = 0.01
    return {
        "true": (measure(Lambert(0.6), views=VIEWS, noise=0.01, seed=3), "lambert"),
        "foreign": (foreign, "cook-torrance"),
        "foreign, scattered": (scattered, "blinn"),
        "glossy": (measure(GLOSSY, views=VIEWS, noise=0.004, floor=1e-6, reference=0.003, seed=5), "cook-torrance"),
        "polarised": (polarised, "cook-torrance"),
        "black": (dark, "lambert"),
    }


KINDS = tuple(tables())


def with_unknown(table: pd.DataFrame, seed: int) -> pd.DataFrame:
    """The same, with rows beside others of it whose u is 1e3 to 1e6 times the value."""
    rng = np.random.default_rng(seed)
    more = table.iloc[rng.integers(0, len(table), 5)].copy()
    more["theta_r_deg"] = np.clip(more["theta_r_deg"] + rng.uniform(-1.5, 1.5, 5), 0.1, 79.0)
    u = np.abs(more["brdf"]) * 10.0 ** rng.uniform(3.0, 6.0, 5)
    # most are near what others are; one is as far from it as its noise
    more["brdf"] = np.where(np.arange(5) < 4, more["brdf"], u * rng.normal())
    more["u_brdf"] = np.hypot(u, more["u_brdf"])
    more["u_random"] = u
    whole = pd.concat([table, more], ignore_index=True)
    whole = whole.iloc[rng.permutation(len(whole))] if seed % 2 else whole
    whole.attrs.update(table.attrs)
    return whole


def numbers(table: pd.DataFrame, model: str) -> dict[str, Any]:
    """What a page is made from."""
    result = fit(table, model)
    data = result.data
    told = {k: v for k, v in result.to_json().items() if k not in ("wall_s", "left_out", "notes")}
    choice = choose(observations(table), candidates(["lambert", model] if model != "lambert" else [model, "phong"]))
    return as_json({
        **told,
        "worst": farthest(result),
        "rho_dh": energy.of_model(result),
        "metrics": metrics(result.predicted, data.brdf, np.cos(data.directions.theta_i), data.u, result.whitened),
        "ranking": [(j.candidate.label, j.aic, j.bic, j.held_out, j.rejected, j.fails) for j in choice.judged],
        "near": choice.near,
        "words": choice.words,
    })  # fmt: skip


def differ(a: Any, b: Any, where: str = "") -> list[str]:
    """Where two trees differ by more than rounding: sums in another order, and searches that end by them."""
    if isinstance(a, dict):
        return [line for k in a for line in differ(a[k], b[k], f"{where}.{k}")]
    if isinstance(a, list):
        return [line for k, (x, y) in enumerate(zip(a, b, strict=True)) for line in differ(x, y, f"{where}[{k}]")]
    same = a == pytest.approx(b, rel=1e-5, abs=1e-9) if isinstance(a, float) and b is not None else a == b
    return [] if same else [f"{where}: {a} {b}"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", [k for k in KINDS if k != "black"])
def test_values_that_say_nothing_change_no_number(kind: str) -> None:
    table, model = tables()[kind]
    alone = numbers(table, model)
    for seed in (0, 2):
        assert differ(alone, numbers(with_unknown(table, seed), model)) == []


@pytest.mark.parametrize("kind", KINDS)
def test_what_says_nothing_is_left_out_and_counted_and_nothing_else_is(kind: str) -> None:
    table, _ = tables()[kind]
    assert observations(table).left_out == {}
    found = observations(with_unknown(table, 1))
    if kind == "black":  # of values that are all noise none tells what another one should be
        assert len(found) == len(table) + 5
        return
    assert found.left_out == {"with u beyond 30 times the values around": 5}
    np.testing.assert_array_equal(np.sort(found.brdf), np.sort(table["brdf"]))
    assert found.unused.directions.theta_i.size == 0, "it is as if it had not been measured"


def test_a_dark_direction_beside_bright_ones_says_something() -> None:
    """u is a thousand times the value, and yet far below what is around it: no constant is so dark."""
    table = measure(Lambert(0.6), views=VIEWS, noise=0.01, seed=3)
    table.loc[7, ["brdf", "u_brdf", "u_random"]] = 1e-6, 1e-3, 1e-3
    assert fit(table, "lambert").rejected
    assert len(observations(table)) == len(table)


def test_the_interval_of_tau_holds_beside_a_value_that_is_known_to_three_times_itself() -> None:
    """It was 4e-44 to 3e43 %."""
    table, _ = of_facets(11, "in plane")
    alone = known(fit(table, "cook-torrance").tau)
    table.loc[40, ["u_brdf", "u_random"]] = 3.0 * table["brdf"][40]
    beside = known(fit(table, "cook-torrance").tau)
    # one value of 93 less: tau moves by its part, and its interval's ends with it
    np.testing.assert_allclose([beside.value, *beside.interval], [alone.value, *alone.interval], rtol=0.15)


def test_the_uncertainty_of_tau_is_that_of_the_values_that_tell_it() -> None:
    """Independent misfits: ln tau of n values is known to 1/sqrt(2 n), however many others say nothing."""
    rng = np.random.default_rng(3)
    count = 240
    at = Directions.from_degrees(
        rng.uniform(5, 65, count), np.zeros(count), rng.uniform(0, 75, count), rng.uniform(0, 180, count)
    )
    noise = np.where(np.arange(count) < 120, 0.001, 1e3)
    found = [u_of_log_tau(0.05 * rng.normal(size=count), noise, 0.05, at, count - 3) for _ in range(20)]
    assert np.all(np.isfinite(found))
    # blocks are few: each u is known to a third or so, the mean of 20 to a tenth; the least is 1/sqrt(2 n)
    assert np.mean(found) == pytest.approx(1.0 / np.sqrt(240.0), rel=0.35)
