"""The fit of a rig's geometry: sightings of a rig that is known, and what each missing ingredient leaves open."""

import math
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gonio_sim.rig import SIM

from gonio.config import numbers_in, parse
from gonio.errors import DataError
from gonio.lab.calibration import geometry
from gonio.lab.calibration.geometry_problem import CORNER_FLOOR_PX, INK, Predictor, Sighting, start_values, unknowns
from gonio.lab.rig.calibration_files import with_keys
from gonio.lab.rig.description import RigDescription
from tests.command_line import says

STEP_DEG = 0.088
NOISE_PX = 0.1


def tables() -> dict[str, Any]:
    out = tomllib.loads(SIM.toml)
    out["camera"] |= {"focal_length_mm": 50.0}
    out["holder"] |= {"fiducials": {"count": 4, "marker_mm": 8.0, "ring_mm": 18.0}, "zero_offset_deg": 0.0}
    out["holder"]["zero_u_deg"] = 0.0  # nobody says to know a zero
    for arm in ("light", "camera"):
        out["arms"][arm] |= {"limits_deg": [-95.0, 95.0], "zero_offset_deg": 0.0, "zero_u_deg": 0.0}
    return out


@pytest.fixture(scope="module")
def filed() -> RigDescription:
    """What the rig file says: nothing is wrong."""
    return parse(RigDescription, tables(), "filed")


@pytest.fixture(scope="module")
def true() -> RigDescription:
    """What is the case: zeros of several degrees, harmonics, tilted axes."""
    out = tables()
    out["arms"]["light"] |= {
        "zero_offset_deg": 3.2, "harmonics_deg": [[1, 0.2, -0.3]], "axis_tilt_deg": [0.3, -0.2], "elevation_deg": 0.2,
    }  # fmt: skip
    out["arms"]["camera"] |= {
        "zero_offset_deg": -2.1, "harmonics_deg": [[2, -0.1, 0.15]], "axis_tilt_deg": [0.0, 0.25],
        "elevation_deg": -0.3,
    }  # fmt: skip
    out["holder"] |= {"tilt_zero_offset_deg": 0.7, "spin_zero_offset_deg": -1.1, "surface_tilt_deg": [0.2, -0.1]}
    out["camera"] |= {"pointing_deg": [0.2, -0.1], "roll_deg": 0.4}
    return parse(RigDescription, out, "true")


@pytest.fixture(scope="module")
def sighted(true: RigDescription) -> Callable[..., list[Sighting]]:
    """Sightings of the true rig, with the errors of encoder steps and of what is read from frames."""

    def made(*, mirror: int = 0, straight: int = 0, markers: int = 0, seen: bool = True) -> list[Sighting]:
        rng, see = np.random.default_rng(3), Predictor(true)
        zero = {name: axis.zero_offset_deg for name, axis in true.axes().items()}
        out = []

        def one(holder: str, angles: tuple[float, ...], *, lamp: bool, marks: bool) -> None:
            counts = {
                n: round((a + zero[n]) / STEP_DEG) * STEP_DEG
                for n, a in zip(("light", "camera", "tilt", "spin"), angles, strict=True)
            }
            corners = tuple(range(16)) if marks and seen else ()
            nowhere = (0.0, 0.0) if lamp else None
            s = Sighting(holder, counts, (), nowhere, NOISE_PX, corners, ((0.0, 0.0),) * len(corners), NOISE_PX)
            at = see(s, {n: float(rng.uniform(-0.5, 0.5)) * STEP_DEG for n in counts})
            where = [(float(c), float(r)) for c, r in at + rng.normal(0.0, NOISE_PX, at.shape)]
            out.append(
                replace(s, spot_px=where[0] if lamp else None, u_spot_px=NOISE_PX, corners_px=tuple(where[lamp:]))
            )

        for light in np.linspace(-70.0, 70.0, mirror) if mirror else ():
            one("mirror", (light, -light + rng.uniform(-1, 1), rng.uniform(-0.4, 0.4), rng.uniform(-170, 170)),
                lamp=True, marks=True)  # fmt: skip
        for k in range(straight):
            light = (90.0 + rng.uniform(-4, 4)) * (-1) ** k
            one(
                "empty",
                (light, light - math.copysign(180.0, light) + rng.uniform(-1, 1), 0.0, 0.0),
                lamp=True,
                marks=False,
            )
        for _ in range(markers):
            one("mirror", (rng.uniform(-70, 70), rng.uniform(-65, 65), rng.uniform(-45, 45), rng.uniform(-170, 170)),
                lamp=False, marks=True)  # fmt: skip
        return out

    return made


@pytest.fixture(scope="module")
def whole(filed: RigDescription, sighted: Callable[..., list[Sighting]]) -> geometry.Fit:
    return geometry.solve(filed, sighted(mirror=20, straight=6, markers=12))


def test_all_together_find_the_rig_within_their_uncertainties(whole: geometry.Fit, true: RigDescription) -> None:
    """34 numbers: the mean square of errors over u is 1 within 0.5, three standard deviations of a chi-square's."""
    there = start_values(true, [u.path for u in whole.unknowns if "harmonics" not in u.path])
    at = [k for k, u in enumerate(whole.unknowns) if "harmonics" not in u.path]
    pulls = (whole.values[at] - there) / np.sqrt(np.diag(whole.covariance)[at])
    assert np.mean(pulls**2) < 1.8
    assert np.abs(pulls).max() < 4.0
    assert whole.u("arms.light.axis_tilt_deg[0]") < 0.03
    assert 0.5 < whole.misfit < 1.5


@pytest.mark.slow
def test_what_corners_are_off_alike_in_all_pictures_is_in_the_distance(
    filed: RigDescription, sighted: Callable[..., list[Sighting]]
) -> None:
    """A hundredth of a pixel outward, as edges of squares are blurred: it does not average over sightings."""
    exact, stretched = [], []
    for s in sighted(mirror=20, straight=6, markers=12):
        corners = np.array(s.corners_px).reshape(-1, 2)
        away = corners - corners.mean(axis=0) if len(corners) else corners
        size = math.sqrt(np.mean((away**2).sum(axis=1))) if len(corners) else 1.0
        out = corners + away * CORNER_FLOOR_PX / size
        exact.append(s)
        stretched.append(replace(s, corners_px=tuple((float(c), float(r)) for c, r in out)))
    plain, other = (geometry.solve(filed, sightings) for sightings in (exact, stretched))
    k = [u.path for u in plain.unknowns].index("geometry.camera_distance_mm")
    moved = abs(float(other.values[k] - plain.values[k]))
    assert moved > 0.05  # mm of 1000: the picture is larger by 1e-4
    assert plain.u("geometry.camera_distance_mm") >= 0.95 * moved


def test_arms_are_known_over_their_range_though_zero_and_cosine_look_alike(
    whole: geometry.Fit, true: RigDescription
) -> None:
    """0.03 deg: 38 poses with steps of 0.088 deg, sqrt(5 / 38) 0.025 deg of each arm, twice that for both together."""
    read = np.linspace(-65.0, 65.0, 50)
    for arm in ("light", "camera"):
        errors = []
        for rig in (whole.description, true):
            axis = getattr(rig.arms, arm)
            turn = np.radians(read - axis.zero_offset_deg)
            errors.append(
                axis.zero_offset_deg
                + sum(c * np.cos(k * turn) + s * np.sin(k * turn) for k, c, s in axis.harmonics_deg)
            )
        assert math.sqrt(float(np.mean((errors[0] - errors[1]) ** 2))) < 0.03


def test_what_is_written_reads_as_a_rig(whole: geometry.Fit, filed: RigDescription) -> None:
    tables, paths, covariance = geometry.values_of(whole, filed)
    assert set(paths) <= set(numbers_in(tables))
    assert covariance.shape == (len(paths), len(paths))
    assert INK not in paths
    rig = with_keys(filed, tables, "calibration")
    assert rig.arms.light.zero_offset_known
    assert rig.arms.light.zero_offset_deg == pytest.approx(whole.value("arms.light.zero_offset_deg"))


@pytest.mark.parametrize(
    ("ingredients", "said"),
    [
        (
            {"mirror": 12, "seen": False},
            "their sum is .* their difference camera - light is not known: no straight-through",
        ),
        ({"straight": 8}, "their difference camera - light is .* their sum is not known: no mirror frames"),
    ],
)
def test_one_ingredient_alone_names_what_is_open_and_does_not_write_it(
    filed: RigDescription, sighted: Callable[..., list[Sighting]], ingredients: dict[str, Any], said: str
) -> None:
    fit = geometry.solve(filed, sighted(**ingredients))
    assert any(re.search(said, sentence) for sentence in fit.open)
    _, paths, _ = geometry.values_of(fit, filed)
    assert not [p for p in paths if p.endswith("zero_offset_deg") and p.startswith("arms")]
    assert fit.rank < len(fit.unknowns)


def test_without_fiducials_the_zeros_are_known_as_well_as_pointing_is_expected(
    filed: RigDescription, true: RigDescription, sighted: Callable[..., list[Sighting]]
) -> None:
    fit = geometry.solve(filed, sighted(mirror=12, straight=6, seen=False))
    assert any("no frames of fiducials" in sentence for sentence in fit.open)
    for arm in ("light", "camera"):
        path = f"arms.{arm}.zero_offset_deg"
        assert abs(fit.value(path) - getattr(true.arms, arm).zero_offset_deg) < 3 * fit.u(path)
        assert 0.5 < fit.u(path) < 1.5  # pointing of 0.5 deg, seen at half its size


def test_nothing_seen_is_refused(filed: RigDescription) -> None:
    with pytest.raises(DataError, match="nothing was seen"):
        geometry.solve(filed, [Sighting("mirror", dict.fromkeys(filed.axes(), 0.0))])


ZERO = "arms.light.zero_offset_deg"


def claiming(filed: RigDescription, zero_deg: float, u_deg: float) -> RigDescription:
    """The rig file, with a zero of the light arm that somebody says to know."""
    light = filed.arms.light.model_copy(update={"zero_offset_deg": zero_deg, "zero_u_deg": u_deg})
    return filed.model_copy(update={"arms": filed.arms.model_copy(update={"light": light})})


@pytest.mark.parametrize("off", [0.0, 1.5])
def test_what_the_rig_file_knows_better_is_not_replaced(filed: RigDescription, whole: geometry.Fit, off: float) -> None:
    alone = whole
    u = 0.3 * alone.u(ZERO)
    claimed = alone.value(ZERO) + off * math.hypot(u, alone.u(ZERO))
    fit = geometry.weighed(alone, claiming(filed, claimed, u))
    (said,) = fit.warnings
    assert said.startswith(f"{ZERO}: measured")
    assert "The rig file knows it better" in said
    # the weighted mean of two; what the file says counts with 1.5 times its u where it lies 1.5 combined ones off
    weight = (u * max(off, 1.0)) ** 2 + alone.u(ZERO) ** 2
    assert fit.value(ZERO) == pytest.approx(
        alone.value(ZERO) + (claimed - alone.value(ZERO)) * alone.u(ZERO) ** 2 / weight, abs=1e-9
    )
    assert u * 0.9 < fit.u(ZERO) < u * max(off, 1.0)
    # a cosine that is correlated with the zero follows it
    cosine = "arms.light.harmonics_deg[0][1]"
    assert fit.u(cosine) < alone.u(cosine)
    assert np.linalg.eigvalsh(fit.covariance).min() > -1e-12


def test_a_rig_file_that_is_wrong_is_contradicted_aloud_and_not_believed(
    whole: geometry.Fit, filed: RigDescription
) -> None:
    fit = geometry.weighed(whole, claiming(filed, whole.value(ZERO) - 0.5, 0.02))
    (said,) = fit.warnings
    says(said, "They contradict each other by", "the measured one is taken")
    assert (fit.value(ZERO), fit.u(ZERO)) == (whole.value(ZERO), whole.u(ZERO))


def test_a_zero_that_is_not_determined_stays_as_filed_and_is_named(
    filed: RigDescription, sighted: Callable[..., list[Sighting]]
) -> None:
    fit = geometry.solve(claiming(filed, 3.0, 0.02), sighted(mirror=12, seen=False))
    (said,) = fit.warnings
    assert "is not replaced, and it was not checked" in said
    assert ZERO not in geometry.values_of(fit, filed)[1]
    says(fit.open[-1], "printed markers", "face each other")


def test_a_measured_zero_counts_alone_where_nothing_is_claimed(whole: geometry.Fit) -> None:
    assert whole.warnings == ()


@pytest.mark.parametrize("wrong", [1, 7])
def test_a_sighting_that_is_far_off_is_left_out_but_not_a_third_of_them(
    true: RigDescription, sighted: Callable[..., list[Sighting]], wrong: int
) -> None:
    sightings = sighted(mirror=16, straight=4)
    for k in range(0, 2 * wrong, 2):
        column, row = sightings[k].spot_px or (math.nan, math.nan)
        sightings[k] = replace(sightings[k], spot_px=(column + 60.0 + 20.0 * k, row))
    zeros = [u for u in unknowns(true, sightings) if u.path.endswith("zero_offset_deg")]
    *_, kept, dropped = geometry._solved(true, sightings, zeros, None)
    assert len(dropped) == (1 if wrong == 1 else 0)
    assert kept == sightings[len(dropped) :]
