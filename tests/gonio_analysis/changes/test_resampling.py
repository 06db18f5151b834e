"""Values of one measurement in the directions of another."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.spatial
from gonio_analysis.changes import interpolation
from gonio_analysis.changes.interpolation import _located, _turns
from gonio_analysis.changes.resampling import AT_ONCE, carry, common_wavelengths, turned_in_plane
from gonio_analysis.fitting.observations import observations

from gonio.formats import reader
from gonio.geometry import Directions
from gonio.models import OrenNayar, build
from gonio.typing import Floats
from tests.gonio_analysis.synthetic import measure

MODEL = OrenNayar(0.6, 20.0)


def test_nothing_is_invented_outside_of_the_other_s_directions() -> None:
    a = observations(measure(MODEL, incidences=(30.0,), views=np.array([-80.0, 0.0, 80.0])))
    carried = carry(a, observations(measure(MODEL, incidences=(30.0,), views=np.arange(-40.0, 41.0, 5.0))))
    assert list(np.degrees(a.directions.theta_r[carried.rows])) == [0.0]
    assert sum(carried.missing.values()) == 2


def test_wavelengths_are_common_within_half_a_nanometre() -> None:
    a, b, c = (observations(measure(MODEL, wavelength_nm=nm)) for nm in (550.0, 550.4, 551.0))
    assert (common_wavelengths(a, b), common_wavelengths(a, c)) == ([(550.0, 550.4)], [])


def test_wavelengths_with_the_same_directions_share_one_triangulation(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    delaunay = scipy.spatial.Delaunay

    def counted(points: Floats) -> Any:
        made.append(len(points))
        return delaunay(points)

    monkeypatch.setattr(scipy.spatial, "Delaunay", counted)
    several = [
        pd.concat([_hemisphere(seed, nm) for nm in np.arange(400.0, 701.0, 50.0)], ignore_index=True) for seed in (0, 1)
    ]
    carried = carry(observations(several[0]), observations(several[1]))
    assert carried.interpolated > 300
    assert len(made) == 1
    apart = [carry(observations(a), observations(b)).value for a, b in zip(*map(_by_wavelength, several), strict=True)]
    np.testing.assert_allclose(carried.value, np.concatenate(apart), rtol=1e-12)  # sums in another order


def test_points_are_located_in_a_triangulation_as_scipy_locates_them() -> None:
    rng = np.random.default_rng(3)
    grid = np.array(np.meshgrid(np.arange(8.0), np.arange(9.0))).reshape(2, -1).T
    flat = np.column_stack([np.linspace(0, 8, 40), 1e-17 * rng.normal(size=40)])
    for nodes in (grid, rng.normal(size=(150, 2)), np.vstack([flat, [[3.0, 5.0], [4.0, -6.0]]])):
        mesh = scipy.spatial.Delaunay(nodes)
        goals = rng.uniform(nodes.min(axis=0) - 0.5, nodes.max(axis=0) + 0.5, size=(400, 2))
        found, weights = _located(interpolation._mesh(nodes), _turns(nodes[mesh.simplices]), goals)
        inside = found >= 0
        assert np.array_equal(inside, mesh.find_simplex(goals) >= 0)
        assert weights[inside].min() > -1e-9
        met = np.einsum("ni,nij->nj", weights[inside], nodes[mesh.simplices[found[inside]]])
        np.testing.assert_allclose(met, goals[inside], atol=1e-9)  # of nodes some units apart


def test_a_lobe_between_its_values_is_known_as_well_as_they_are() -> None:
    """Chords of a lobe were off by 3 % beside a noise of 0.3 %: noise twice the stated one was hidden below that."""
    model = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30})
    goal = observations(measure(model, noise=1e-3, floor=1e-9, views=np.arange(-77.5, 78.0, 5.0), seed=1))
    true = observations(measure(model, noise=0.0, floor=1e-9, views=np.arange(-77.5, 78.0, 5.0)))
    found = carry(goal, observations(measure(model, noise=0.0, floor=1e-9)))
    off = np.abs(found.value - true.brdf[found.rows])
    # it counts as a standard uncertainty: 68 % within once, 95 % within twice
    assert np.mean(off <= found.error) > 0.68
    assert np.mean(off <= 2.0 * found.error) > 0.95
    assert np.median(found.relative_error) < 1e-3


def test_noise_of_values_is_no_error_of_interpolation() -> None:
    """Parabolas told 0.2 % of it from noise of 0.5 %: understated noise was hidden below that."""
    views, flat = np.arange(-77.5, 78.0, 5.0), build("lambert", {"albedo": 0.5})
    goal = observations(measure(flat, noise=5e-3, floor=1e-9, views=views, seed=1))
    found = carry(goal, observations(measure(flat, noise=5e-3, floor=1e-9, seed=2)))
    # half of the parabolas' part is left: 0.5 * 0.28 of the noise, and more beside the ends
    assert np.median(found.relative_error) < 0.2 * 5e-3


def test_neighbours_between_the_same_values_have_noise_together() -> None:
    """Of their mean the noise is that of the values; sums of independent ones would have 0.8 of it."""
    views, flat = np.arange(-77.5, 78.0, 5.0), build("lambert", {"albedo": 0.5})
    goal = observations(measure(flat, incidences=(30.0,), noise=5e-3, floor=1e-9, views=views, seed=1))
    known = observations(measure(flat, incidences=(30.0,), noise=5e-3, floor=1e-9, seed=2))
    found, inner = carry(goal, known), slice(8, -8)
    np.testing.assert_allclose(found.together[inner], 5e-3 * found.value[inner], rtol=0.02)  # noise of u itself: 0.5 %
    # weights of a cubic halfway are 9/16 and -1/16: sqrt(2 (81 + 1)) / 16
    np.testing.assert_allclose(found.random[inner], 0.8004 * found.together[inner], rtol=0.02)


def _hemisphere(seed: int, wavelength_nm: float) -> pd.DataFrame:
    """Random receivers, the same for a seed, under one incidence."""
    rng = np.random.default_rng(seed)
    n = 500
    theta, phi = np.degrees(np.arccos(rng.uniform(0.3, 1.0, n))), rng.uniform(0.0, 360.0, n)
    true = MODEL.brdf(np.radians(30.0), 0.0, np.radians(theta), np.radians(phi)) * wavelength_nm
    return reader.table(
        theta_i_deg=np.full(n, 30.0), phi_i_deg=0.0, theta_r_deg=theta, phi_r_deg=phi, wavelength_nm=wavelength_nm,
        brdf=true, u_brdf=1e-3 * true, u_random=1e-3 * true, attrs={},
    )  # fmt: skip


def _by_wavelength(frame: pd.DataFrame) -> list[pd.DataFrame]:
    return [part for _, part in frame.groupby("wavelength_nm")]


@pytest.mark.parametrize("count", [0, 1, AT_ONCE + 1])
def test_directions_turn_in_the_plane_of_incidence_however_many_they_are(count: int) -> None:
    angles = np.radians([30.0, 0.0, 20.0, 180.0])
    turned, above = turned_in_plane(Directions(*np.repeat(angles[:, None], count, axis=1)), np.radians(5.0))
    # toward the mirror direction, at 30 degrees; 1e-9 rad: an angle is an arc cosine
    np.testing.assert_allclose(turned.theta_r, np.full(count, np.radians(25.0)), rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(above, np.ones(count, bool))


EDGED = (
    build("oren-nayar", {"albedo": 0.8, "sigma_deg": 35.0}),
    build("cook-torrance", {"s": 0.5, "d": 0.5, "m": 0.3, "diffuse_albedo": 0.3, "ior": 1.8}),
    build("blinn", {"k_d": 0.3, "k_s": 0.6, "c": 0.5, "ior": 3.0}),
)
"""Models whose slope jumps: at the normal, and where masking and shadowing begin."""


@pytest.mark.parametrize("step", [2.5, 5.0])
@pytest.mark.parametrize("model", EDGED, ids=lambda model: model.name)
def test_an_edge_of_the_curve_counts_as_error_of_interpolation(model: Any, step: float) -> None:
    """Polynomials of any degree agree beside an edge, and are off together: by 6.8 times what was stated."""
    exact: dict[str, Any] = {"incidences": (22.0, 41.0, 57.0, 66.0), "noise": 0.0, "floor": 1e-9}
    goal = observations(measure(model, views=np.arange(-77.5 + 0.5 * step, 77.5, step), **exact))
    found = carry(goal, observations(measure(model, views=np.arange(-77.5, 78.0, step), **exact)))
    off = np.abs(found.value - goal.brdf[found.rows])
    # of a noise of 0.05 %, or of the stated error: 3 of them is no change among 120 values
    assert np.max(off / np.hypot(found.error, 5e-4 * found.value)) < 3.0


def test_a_curve_without_an_edge_is_taken_for_one_without() -> None:
    """An edge that is seen where there is none hides noise that is understated."""
    views, lobe = np.arange(-77.5, 78.0, 5.0), build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 8})
    goal = observations(measure(lobe, noise=2e-3, floor=1e-9, views=views, seed=1))
    found = carry(goal, observations(measure(lobe, noise=2e-3, floor=1e-9, seed=2)))
    assert np.mean(found.relative_error > 2e-3) < 0.05


def test_gradients_are_those_of_least_squares_also_where_neighbours_lie_on_a_line() -> None:
    rng = np.random.default_rng(4)
    points = rng.uniform(size=(40, 2))
    mesh = interpolation._mesh(points)
    assert interpolation._mesh(points.copy()) is mesh  # what was triangulated is not again
    line = interpolation._Mesh(
        np.array([[0.0, 0.0], [1.0, 2.0], [2.0, 4.0]]),
        *(np.zeros((0, 3), np.int32),) * 2,
        np.full(3, -1, np.int32),
        np.array([0, 1, 3, 4], np.int32),
        np.array([1, 0, 2, 1], np.int32),
    )
    for one in (mesh, line):
        own, near, fit = interpolation._gradients(one, one.points)
        for node in range(len(one.points)):
            step = (one.points[near] - one.points[own])[own == node]
            # the inverse of two by two numbers against that by singular values: their rounding, times the condition
            assert pytest.approx(np.linalg.pinv(step), rel=1e-9, abs=1e-12) == fit[own == node].T
