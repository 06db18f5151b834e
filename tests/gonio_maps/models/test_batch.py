"""Very many small fits at once, against scipy's least squares on the plain formulas and against what was drawn."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from gonio_maps.models import batch
from scipy.optimize import least_squares

from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.models import build
from gonio.models.plain import cook_torrance as plain
from gonio.typing import Floats

pytestmark = pytest.mark.slow  # the engine compiles for a minute where it is not yet on the disk

POINTS = 60
DRAWN: dict[str, tuple[dict[str, tuple[float, float]], dict[str, float]]] = {
    "cook-torrance": ({"s": (0.1, 0.8), "m": (0.1, 0.5), "diffuse_albedo": (0.1, 0.8)}, {"ior": 1.5}),
    "ggx": ({"alpha": (0.1, 0.5), "diffuse_albedo": (0.1, 0.8), "ior": (1.4, 2.0)}, {}),
    "blinn": ({"k_s": (0.1, 1.0), "k_d": (0.1, 0.6), "c": (0.1, 0.5)}, {"ior": 1.5}),
    "oren-nayar": ({"albedo": (0.1, 0.9), "sigma_deg": (8.0, 40.0)}, {}),
    "he-torrance": ({"sigma0_um": (0.06, 0.2), "tau_um": (1.0, 3.0), "diffuse_albedo": (0.1, 0.5)}, {"ior": 1.5}),
}


def geometry(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Where source and camera stand [mm]: half of the points around the mirror direction."""
    theta_i = np.radians(rng.choice([5.0, 20.0, 40.0, 60.0, 72.0], POINTS))
    theta_r, phi = np.radians(rng.uniform(0.0, 75.0, POINTS)), rng.uniform(0.0, 2.0 * np.pi, POINTS)
    near = np.arange(POINTS) % 2 == 0
    theta_r[near] = np.clip(theta_i[near] + rng.normal(0.0, 0.2, near.sum()), 0.02, 1.4)
    phi[near] = np.pi + rng.normal(0.0, 0.3, near.sum())
    source = 500.0 * np.stack([np.sin(theta_i), 0.0 * theta_i, np.cos(theta_i)], axis=1)
    camera = 600.0 * np.stack([np.sin(theta_r) * np.cos(phi), np.sin(theta_r) * np.sin(phi), np.cos(theta_r)], axis=1)
    return source, camera


def directions(source: Floats, camera: Floats, x: float, y: float) -> Directions:
    spot = np.array([x, y, 0.0])
    return Directions.from_vectors(source - spot, camera - spot)


def drawn(name: str, pixels: int, seed: int, u_rel: float = 0.01) -> dict[str, Any]:
    """Pixels of drawn parameters, with noise."""
    rng = np.random.default_rng(seed)
    source, camera = geometry(rng)
    ranges, fixed = DRAWN[name]
    x, y = rng.uniform(-10.0, 10.0, (2, pixels))
    true = {one: rng.uniform(*limits, pixels) for one, limits in ranges.items()}
    values = np.array([
        build(name, {one: float(v[p]) for one, v in true.items()} | fixed).brdf(
            *directions(source, camera, x[p], y[p]).angles, wavelength_nm=550.0)
        for p in range(pixels)
    ])  # fmt: skip
    u = u_rel * values
    noisy = values + u * rng.standard_normal(values.shape)
    return {
        "at": (x, y, source, camera),
        "values": noisy,
        "u": u,
        "exact": values,
        "true": true,
        "fixed": fixed,
        "rng": rng,
    }


def fitted(name: str, d: dict[str, Any], **more: Any) -> batch.Fits:
    x, y, source, camera = d["at"]
    return batch.fit(name, x, y, source, camera, d["values"], d["u"], **({"fixed": d["fixed"]} | more))


@pytest.mark.parametrize("name", DRAWN)
def test_what_was_drawn_is_found_within_its_uncertainty(name: str) -> None:
    d = drawn(name, 60 if name == "he-torrance" else 400, 3)
    found = fitted(name, d)
    true = np.stack([d["true"][one] for one in found.free], axis=1)
    at = [found.names.index(one) for one in found.free]
    pulls = (found.values[:, at] - true) / found.u
    # 400 pulls have a standard deviation of 1 +- 0.035, 60 of 1 +- 0.09: four of these
    assert np.all(np.abs(pulls.std(axis=0) - 1.0) < (0.37 if name == "he-torrance" else 0.15))
    assert np.mean(np.abs(pulls) > 4.0) < 0.01  # a few are far from linear: narrow lobes that few values lie in
    misses = ((d["values"] - d["exact"]) / d["u"]) ** 2
    assert np.all(found.chi_square <= misses.sum(axis=1) + 1e-6)  # the truth is no better: no valley is a wrong one
    freedom = POINTS - len(found.free)
    assert abs(found.chi_square.mean() / freedom - 1.0) < 4.0 * np.sqrt(2.0 / freedom / len(pulls))


def test_minimum_and_covariance_are_those_of_least_squares_on_the_plain_formula() -> None:
    d = drawn("cook-torrance", 6, 5)
    found = fitted("cook-torrance", d)
    for p in range(6):
        at = directions(d["at"][2], d["at"][3], d["at"][0][p], d["at"][1][p])

        def residual(t: Floats, at: Directions = at, p: int = p) -> Floats:
            value = plain.brdf(*at.vectors, ((t[1], 1.0),), 1.5, t[0], 1.0 - t[0], t[2])
            return np.asarray((value - d["values"][p]) / d["u"][p])

        free = found.values[p, :3]
        least = least_squares(residual, free * 1.02, xtol=1e-14, ftol=1e-14, gtol=1e-14)
        spread = np.linalg.inv(least.jac.T @ least.jac)
        # a last step below 1e-4 u; scipy's derivatives by differences are good to 1e-7
        np.testing.assert_allclose(free, least.x, rtol=0, atol=2e-4 * np.sqrt(np.diag(spread)).min())
        np.testing.assert_allclose(found.chi_square[p], 2.0 * least.cost, rtol=1e-7)
        np.testing.assert_allclose(found.covariance[p], spread, rtol=1e-4)


@pytest.mark.parametrize("u_rel", [1e-2, 1e-6])
def test_values_lead_to_their_least_squares_with_any_noise(u_rel: float) -> None:
    d = drawn("oren-nayar", 6, 6, u_rel)
    found = fitted("oren-nayar", d)
    for p in range(6):
        angles = directions(d["at"][2], d["at"][3], d["at"][0][p], d["at"][1][p]).angles

        def residual(t: Floats, angles: Any = angles, p: int = p) -> Floats:
            return np.asarray((build("oren-nayar", {"albedo": t[0], "sigma_deg": t[1]}).brdf(*angles)
                               - d["values"][p]) / d["u"][p])  # fmt: skip

        least = least_squares(residual, found.values[p] * 1.001, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15)
        spread = np.linalg.inv(least.jac.T @ least.jac)
        # ours end where a step would lower chi-square by less than 1e-8, which is 1e-4 standard errors
        np.testing.assert_allclose((found.values[p] - least.x) / np.sqrt(np.diag(spread)), 0.0, atol=1e-4)
        np.testing.assert_allclose(found.chi_square[p], 2.0 * least.cost, rtol=1e-8)
        np.testing.assert_allclose(found.covariance[p], spread, rtol=1e-6)


@pytest.mark.parametrize("name", DRAWN)
def test_derivatives_by_formula_are_those_by_differences(name: str) -> None:
    """What the covariance is made of; with the index known, and free."""
    d = drawn(name, 2, 9)
    for fixed in ({}, d["fixed"]) if name in ("blinn", "cook-torrance") else (d["fixed"],):
        found = fitted(name, d, fixed=fixed)
        at = directions(d["at"][2], d["at"][3], d["at"][0][1], d["at"][1][1]).angles
        columns = []
        for one, value in zip(found.names, found.values[1], strict=True):
            if one not in found.free:
                continue
            ends = [
                build(name, {k: float(v) for k, v in zip(found.names, found.values[1], strict=True) if k != "k"}
                      | {one: float(value * (1.0 + h))}).brdf(*at) for h in (1e-5, -1e-5)
            ]  # fmt: skip
            columns.append((ends[0] - ends[1]) / (2e-5 * value) / d["u"][1])
        spread = np.linalg.inv(np.stack(columns) @ np.stack(columns, axis=1))
        u = np.sqrt(np.diag(spread))
        # differences of He-Torrance and of an index, by steps of 1e-6, are good to 1e-4 of what is added up
        np.testing.assert_allclose(found.covariance[1] / np.outer(u, u), spread / np.outer(u, u), atol=1e-3)


@pytest.mark.parametrize(("name", "ranges", "pixels"), [
    ("cook-torrance", {"s": (0.7, 0.95), "m": (0.03, 0.5), "diffuse_albedo": (0.1, 0.8), "ior": (1.3, 2.5)}, 400),
    ("he-torrance", {"sigma0_um": (0.1, 0.35), "tau_um": (1.0, 4.0), "diffuse_albedo": (0.05, 0.6)}, 60),
    ("he-torrance", {"sigma0_um": (0.3, 0.6), "tau_um": (12.0, 22.0), "diffuse_albedo": (0.02, 0.6)}, 200),
    ("he-torrance", {"sigma0_um": (0.03, 0.035), "tau_um": (0.12, 0.16), "diffuse_albedo": (0.05, 0.6)}, 400),
])  # fmt: skip
def test_no_pixel_ends_above_the_truth(
    name: str, ranges: dict[str, tuple[float, float]], pixels: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Much metal on a base that hardly shows (s and diffuse_albedo along a hyperbola); optically smooth and rough;
    lobes that few directions meet; and nearly smooth ones without much shape, where the model has two minima."""
    monkeypatch.setattr(sys.modules[__name__], "POINTS", 100)  # so many that some of them choose He-Torrance's start
    monkeypatch.setitem(DRAWN, name, (ranges, {} if "ior" in ranges else {"ior": 1.5}))
    d = drawn(name, pixels, 12)
    of_truth = np.sum(((d["values"] - d["exact"]) / d["u"]) ** 2, axis=1)
    # the truth is no minimum: where a fit ends above it, it lies in a wrong valley, or has not arrived
    assert (fitted(name, d).chi_square <= of_truth * (1.0 + 1e-6)).all()


def evenly(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Where source and camera stand [mm], whatever the mirror direction."""
    source, camera = (rng.uniform(np.radians([[2.0], [0.0]]), np.radians([[70.0], [360.0]]), (2, POINTS)) for _ in "ic")
    return tuple(  # type: ignore[return-value]
        500.0 * np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
        for theta, phi in (source, camera)
    )


@pytest.mark.parametrize("u_rel", [0.01, 0.0003])
def test_no_narrow_lobe_ends_above_the_truth(u_rel: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Met by few directions, it looks like one of an endless index; with little noise levels and index replace each
    other along a long, bent valley.
    """
    ranges = {"s": (0.6, 0.95), "m": (0.03, 0.07), "diffuse_albedo": (0.02, 0.8), "ior": (1.2, 2.6)}
    monkeypatch.setattr(sys.modules[__name__], "POINTS", 100)
    monkeypatch.setattr(sys.modules[__name__], "geometry", evenly)
    monkeypatch.setitem(DRAWN, "cook-torrance", (ranges, {}))
    d = drawn("cook-torrance", 400, 12, u_rel)
    of_truth = np.sum(((d["values"] - d["exact"]) / d["u"]) ** 2, axis=1)
    assert (fitted("cook-torrance", d).chi_square <= of_truth * (1.0 + 1e-6)).all()


@pytest.mark.parametrize("name", ["oren-nayar", "cook-torrance", "blinn"])
def test_a_parameter_that_a_bound_holds_stays_there_while_others_move_on(name: str) -> None:
    """A matt sample: its chi-square is at most that of the mean, which each of these models holds at a bound."""
    rng, (source, camera) = np.random.default_rng(0), geometry(np.random.default_rng(7))
    u = np.full((200, POINTS), 0.01 * 0.5 / np.pi)
    values = 0.5 / np.pi + u * rng.standard_normal(u.shape)
    fixed = {} if name == "oren-nayar" else {"ior": 1.5}
    found = batch.fit(name, np.zeros(200), np.zeros(200), source, camera, values, u, fixed=fixed)
    flat = (((values - values.mean(axis=1, keepdims=True)) / u) ** 2).sum(axis=1)
    assert (found.chi_square <= flat + 1e-6).all()  # a step that would lower it by 1e-8 is the last
    at = {"oren-nayar": "sigma_deg", "cook-torrance": "s", "blinn": "k_s"}[name]
    held = found.values[:, found.names.index(at)] == 0.0
    assert 0.2 < held.mean() < 0.8  # of half of them the noise asks for less than nothing
    assert (found.u[held, found.free.index(at)] == 0.0).all()


def test_common_causes_move_all_values_together() -> None:
    d = drawn("oren-nayar", 300, 7)
    common = np.stack([np.full(POINTS, 0.02), 0.01 * np.cos(np.arange(POINTS))])
    d["values"] *= 1.0 + d["rng"].standard_normal((300, 2)) @ common
    found = fitted("oren-nayar", d, common=common)
    inside = d["true"]["albedo"] < 0.8  # others may end at the bound, 1
    pulls = ((found.values[:, 0] - d["true"]["albedo"]) / found.u[:, 0])[inside]
    assert abs(pulls.std() - 1.0) < 0.2  # four standard errors of some 250
    plain = fitted("oren-nayar", d)
    assert np.median((found.u[:, 0] / plain.u[:, 0])[inside]) > 3.0  # 2 % of scale for a level known to 0.3 %


def test_values_without_uncertainty_are_left_out_and_too_few_are_said() -> None:
    d = drawn("oren-nayar", 3, 9)
    d["u"][0, 10:] = 0.0
    d["values"][1, 2:] = np.nan
    found = fitted("oren-nayar", d)
    assert found.used.tolist() == [10, 2, POINTS]
    assert np.isfinite(found.values[0]).all()
    assert np.isnan(found.values[1]).all()
    assert np.isnan(found.covariance[1]).all()


def test_arrays_that_may_not_be_written_are_taken() -> None:
    """As those of a pandas table."""
    d = drawn("oren-nayar", 3, 9)
    before = fitted("oren-nayar", d)
    for array in (*d["at"], d["values"], d["u"]):
        array.flags.writeable = False
    assert np.array_equal(fitted("oren-nayar", d).values, before.values)


def test_a_model_that_is_not_true_gets_a_misfit() -> None:
    d = drawn("cook-torrance", 50, 11)
    theta_i, _, theta_r, _ = directions(d["at"][2], d["at"][3], 0.0, 0.0).angles
    d["values"] *= np.exp(0.06 * np.sin(6.0 * theta_i + 3.0 * theta_r))
    found, first = fitted("cook-torrance", d), drawn("cook-torrance", 50, 11)
    # the wave has 0.042 as its standard deviation, of which a fit takes up a part
    assert np.all((found.tau > 0.01) & (found.tau < 0.05))
    plain = fitted("cook-torrance", first)
    assert np.median(found.u / plain.u) > 1.5


def test_the_same_pixels_give_the_same_bits_in_any_company() -> None:
    d = drawn("ggx", 40, 13)
    whole = fitted("ggx", d)
    x, y, source, camera = d["at"]
    part = batch.fit("ggx", x[17:29], y[17:29], source, camera, d["values"][17:29], d["u"][17:29])
    np.testing.assert_array_equal(part.values, whole.values[17:29])
    np.testing.assert_array_equal(part.covariance, whole.covariance[17:29])


@pytest.mark.parametrize("threads", [3, 8])
def test_the_number_of_threads_changes_no_bit(threads: int) -> None:
    d = drawn("cook-torrance", 8 * batch.WORTH, 15)
    d["values"][::7, 4] = np.nan
    one, many = fitted("cook-torrance", d, threads=1), fitted("cook-torrance", d, threads=threads)
    for name in ("values", "covariance", "chi_square", "tau", "used"):
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name), err_msg=name)


@pytest.mark.parametrize("folded", [False, True], ids=["free index", "known index"])
@pytest.mark.parametrize("name", [name for name in DRAWN if name != "he-torrance"])
def test_values_are_those_of_the_model_and_derivatives_by_formula_those_of_the_values(name: str, folded: bool) -> None:
    rng = np.random.default_rng(17)
    source, camera = geometry(rng)
    at = directions(source, camera, 0.0, 0.0)
    omega_i, omega_r = (np.ascontiguousarray(v, float).reshape(-1) for v in at.vectors)
    take, shade, derive, *_, count = batch._compiled(name, False, folded)
    columns, f, formula = np.empty(count * POINTS), np.empty(POINTS), np.empty(POINTS)
    ranges, fixed = DRAWN[name]
    for _ in range(20):
        values = {one: rng.uniform(*limits) for one, limits in ranges.items()} | fixed
        theta = np.array([(values | {"k": 0.0})[one] for one in batch.require(name).names])
        take(omega_i, omega_r, theta, columns)
        shade(columns, theta, 1, f)
        np.testing.assert_allclose(f, build(name, values).brdf(*at.angles), rtol=1e-12)  # other roundings
        for k, one in enumerate(batch.require(name).names):
            by_formula = one in ("s", "k_s", "k_d", "diffuse_albedo", "m", "alpha")
            assert derive(columns, theta, k, f, formula) == by_formula
            if not by_formula:  # by differences of the values
                continue
            step, ends = 1e-5 * theta[k], []
            for sign in (1.0, -1.0):
                moved, out = theta.copy(), np.empty(POINTS)
                moved[k] += sign * step
                shade(columns, moved, 1, out)
                ends.append(out)
            # central differences: 1e-10 of the third derivative, and rounding 1e-16/1e-5 of the values
            scale = np.abs(formula) + 1e-3 * f / theta[k]
            assert np.max(np.abs((ends[0] - ends[1]) / (2.0 * step) - formula) / scale) < 1e-6


@pytest.mark.parametrize("name", DRAWN)
def test_many_sets_at_once_give_what_each_gives_alone(name: str) -> None:
    rng = np.random.default_rng(18)
    source, camera = geometry(rng)
    at = directions(source, camera, 0.0, 0.0)
    omega_i, omega_r = (np.ascontiguousarray(v, float).reshape(-1) for v in at.vectors)
    model = batch.require(name)
    take, shade, *_, count = batch._compiled(name, False, "ior" in DRAWN[name][1])
    columns, sets = np.empty(count * POINTS), 30  # He-Torrance works 2048 values at a time
    ranges, fixed = DRAWN[name]
    drawn_sets = [{one: rng.uniform(*limits) for one, limits in ranges.items()} | fixed for _ in range(sets)]
    for one in drawn_sets[::2]:  # one slope: geometry, Fresnel and shadowing are taken from the set before
        one |= {"tau_um": 20.0 * one["sigma0_um"]} if "tau_um" in one else {}
    own = model.own(550.0)
    thetas = np.array([[*((one | {"k": 0.0})[n] for n in model.names), *own] for one in drawn_sets])
    take(omega_i, omega_r, thetas[0], columns)
    found = np.empty(sets * POINTS)
    shade(columns, thetas.ravel(), sets, found)
    for one, values in zip(drawn_sets, found.reshape(sets, POINTS), strict=True):
        np.testing.assert_allclose(values, build(name, one).brdf(*at.angles), rtol=1e-9)  # He-Torrance's second tier


def test_a_level_that_is_known_is_kept() -> None:
    d = drawn("cook-torrance", 40, 19)
    for p in range(40):
        true = {one: float(v[p]) for one, v in d["true"].items()} | {"s": 0.3, "ior": 1.5}
        x, y, source, camera = d["at"]
        d["values"][p] = build("cook-torrance", true).brdf(*directions(source, camera, x[p], y[p]).angles)
    found = fitted("cook-torrance", d, fixed={"ior": 1.5, "s": 0.3})
    assert found.free == ("m", "diffuse_albedo")
    np.testing.assert_array_equal(found.values[:, 0], 0.3)
    # values without noise; the search ends within 1e-4 u, which are some 1e-3 of a parameter
    np.testing.assert_allclose(found.values[:, 1], d["true"]["m"], rtol=1e-6)


def test_unknown_names_are_refused() -> None:
    d = drawn("oren-nayar", 1, 1)
    with pytest.raises(ConfigError, match='"phong": maps are fitted with one of cook-torrance'):
        fitted("phong", d)
    with pytest.raises(ConfigError, match='no parameter "roughness"; it has: albedo, sigma_deg'):
        fitted("oren-nayar", d, fixed={"roughness": 1.0})
