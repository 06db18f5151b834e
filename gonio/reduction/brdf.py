"""Raw frames to BRDF with uncertainty: what `gonio reduce` does. The formulas are explained in docs/radiometry.md.

Every pixel of the region of interest is freed of its own bias and dark charge and divided by the geometry that it
is known to see (docs/architecture.md, "The measurement equation"); the mean over the region is a rate in electrons
a second. Frames of one point are merged with the inverse of the variance that EMVA 1288 predicts for the *pooled*
signal. A rate over the signal per unit BRDF, which visits to the white reference tell, is the BRDF.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

import gonio
from gonio import geometry
from gonio.acquisition.plan import ANGLES
from gonio.errors import ConfigError, DataError
from gonio.reduction import angle_sensitivity, spikes, white_reference
from gonio.reduction.count_rates import RETAKE, Reduced, Rejected, RunFrames, in_threads
from gonio.reduction.dark_signal import COLUMNS, PATTERNS, strongest
from gonio.reduction.reference_table import brdf_of_reference
from gonio.rig import Pose, imaging, kinematics
from gonio.rig.description import Axis, Band, RigDescription
from gonio.rig.kinematics import Directions
from gonio.typing import Floats

if TYPE_CHECKING:
    import pandas as pd

    from gonio.acquisition.run import Run


CLIPPED = 1e-3
"""Dark frames with a larger part of their pixels at 0 DN are cut off there."""
DAMAGED = "missing or damaged and are left out"
NAMED = 10
"""At most so many damaged frames are named in a note."""
COMMON = ("s_reference", "s_reference_noise", "s_lamp_drift")
DARK = tuple(f"s_dark_{k + 1}" for k in range(COLUMNS))
CAUSES = {"light": "s_theta_i_zero", "camera": "s_theta_r_zero", "tilt": "s_tilt_zero", "azimuth": "s_azimuth_zero"}
"""Axes whose zeros are common causes. A spin turns both directions alike: an isotropic surface does not notice it."""


def reduce(run: Run, *, progress: Callable[[int, int], None] | None = None) -> pd.DataFrame:
    """The measurement table of a run: BRDF [1/sr] with uncertainty for every point of its plan and every band.

    Parameters
    ----------
    run
        A run, complete or not. Frames are checked against the journal's checksums while they are read, a few at a
        time.
    progress
        Told after every step of every band how many are done, and how many there are.

    Returns
    -------
    pandas.DataFrame
        As `gonio.measurement` describes it, in the order of the plan. Angles are what the encoders read. `brdf` is NaN
        where `flag` says why: "blocked", "unreachable" and the plan's other reasons, "saturated" (in every frame),
        "below_horizon" (at the pose that was read), "moved" (an axis did not stand still), "damaged" (a frame of the
        point is missing or was changed), "not_measured" (the run ended before).
        Causes: `s_reference` (the certificate), `s_reference_noise` (mean level of the visits), `s_lamp_drift`,
        `s_dark_1` to `s_dark_3` (noise of the dark frames), `s_theta_i_zero`, `s_theta_r_zero` and, with those axes,
        `s_tilt_zero`, `s_azimuth_zero`.

    Raises
    ------
    DataError
        There are no dark frames or no usable visit to the white reference, or none of them is whole. Other frames that
        are missing, or not those that the journal names, are left out, with a note.
    ConfigError
        The reference's table is missing, or neither a table nor an albedo is given.
    """
    frames = RunFrames(run)
    count = len(frames.steps)
    results = []
    for k, band in enumerate(run.bands):
        steps = []
        for step in in_threads(partial(frames.reduce, band=band), frames.steps):
            steps.append(step)
            if progress is not None:
                progress(k * count + len(steps), len(run.bands) * count)
        results.append(_reduce_band(frames, band, steps))
    _share_darks(results)
    return _assemble(run, results, _notes_on_damage(frames) + _notes_on_darks(frames))


@dataclass(frozen=True, slots=True)
class _BandResult:
    """One band of a run: its rows by point, why others have none, and what the attributes say of it."""

    band: Band
    rows: dict[int, dict[str, float]]
    darks: dict[int, Floats]
    """By point: change of its value [1/sr] by the noise of the dark frames, see `Reduced.dark`."""
    flags: dict[int, str]
    level: white_reference.Level
    reference_brdf: float
    visits: int
    unusable: list[str]
    """The flags of the other visits."""
    scatter: float
    """Reduced chi-square of the frames around the means of their steps."""
    freedom: int
    untold: list[Directions]
    """Nominal directions of points that may see a spike of which only a bound is known."""
    coarse: list[Directions]
    """Nominal directions of points beside a lobe that is narrower than the plan's steps."""


def _reduce_band(frames: RunFrames, band: Band, steps: list[Reduced | Rejected]) -> _BandResult:
    points = [step for step in steps if isinstance(step, Reduced) and step.point is not None]
    visits = [step for step in steps if isinstance(step, Reduced) and step.point is None]
    rejected = [step for step in steps if isinstance(step, Rejected)]
    fitted, reference_brdf = _level(frames, points, visits, band)
    columns, untold, coarse = _columns(frames, points, visits[0], fitted, band)
    levels = fitted.at(np.array([point.time_s for point in points]))
    rows = {
        point.point: _angle_columns(point.directions) | {name: float(c[k]) for name, c in columns.items()}
        for k, point in enumerate(points)
        if point.point is not None
    }
    freedom = sum(step.frames - 1 for step in (*points, *visits))
    return _BandResult(
        band=band,
        rows=rows,
        darks={p.point: p.dark / float(k) for p, k in zip(points, levels, strict=True) if p.point is not None},
        flags=frames.flags | {step.point: step.flag for step in rejected if step.point is not None},
        level=fitted,
        reference_brdf=reference_brdf,
        visits=len(visits),
        unusable=frames.lost_visits + [step.flag for step in rejected if step.point is None],
        scatter=sum(step.chi_square for step in (*points, *visits)) / max(freedom, 1),
        freedom=freedom,
        untold=untold,
        coarse=coarse,
    )


def _level(
    frames: RunFrames, points: list[Reduced], visits: list[Reduced], band: Band
) -> tuple[white_reference.Level, float]:
    """The signal per unit BRDF over time, and the reference's BRDF [1/sr], mean over the visits."""
    run, description, reference = frames.run, frames.description, frames.description.reference
    if not visits:
        raise DataError(f"{run.path}: no usable visit to the white reference in band {band.name}; see its frames")
    rates = np.array([visit.rate for visit in visits])
    if rates.min() <= 0:
        raise DataError(f"{run.path}: a visit to the white reference in band {band.name} saw no light; see its frames")
    if reference.table is not None:
        from gonio import measurement

        table = measurement.read(reference.table)
        known = np.array([brdf_of_reference(table, visit.directions, band.centre_nm) for visit in visits])
    elif reference.albedo:
        known = np.full(len(visits), reference.albedo / math.pi)
    else:
        raise ConfigError(
            f"{run.path / 'run.toml'}: the rig has neither reference.albedo (above 0) nor reference.table: "
            "nothing says how bright the white reference is"
        )
    encoder = _encoder_steps(description)
    landing = sum(_change_of_cosine(description, visits[0], axis, u) ** 2 for axis, u in encoder.items())
    variances = np.array([visit.variance for visit in visits]) + landing * rates**2
    times = np.array([visit.time_s for visit in visits])
    wanted = np.array([point.time_s for point in points])
    return white_reference.fit(times, rates / known, variances / known**2, wanted), float(known.mean())


def _columns(
    frames: RunFrames, points: list[Reduced], visit: Reduced, fitted: white_reference.Level, band: Band
) -> tuple[dict[str, Floats], list[Directions], list[Directions]]:
    """BRDF and its uncertainties for the measured points of a band (docs/radiometry.md, "The budget").

    And the nominal directions of points whose blur by the angles' errors is only bounded, and of those whose slope the
    plan's steps are too coarse to tell.
    """
    description = frames.description
    encoder, zeros = _encoder_steps(description), _zeros(description)
    times = np.array([point.time_s for point in points])
    k = fitted.at(times)
    brdf = np.array([point.rate for point in points]) / k
    noise = np.array([point.variance for point in points]) / k**2
    prnu = np.array([_prnu(description, point, frames.reference[band.channel].count) for point in points])
    independent = noise + (brdf * prnu) ** 2 + (brdf * fitted.extra(times) / k) ** 2
    nominal = np.radians(frames.run.plan[list(ANGLES)].to_numpy(dtype=float))
    goals = [Directions(*nominal[point.point].tolist()) for point in points if point.point is not None]
    cones = math.radians(description.lamp.half_angle_deg), math.radians(description.camera.lens_half_angle_deg)
    shares = _shares(description, points, [*encoder.items(), *zeros.items()], cones, band)
    read = [point.directions for point in points]
    curves = angle_sensitivity.Curves(goals, read, brdf, np.sqrt(independent), cones, shares)
    brdf = brdf + curves.spikes.correction
    common = {
        "s_reference": brdf * description.reference.u_rel,
        "s_reference_noise": -brdf * fitted.noise(times) / k,
        "s_lamp_drift": -brdf * fitted.drift(times) / k,
    }
    said, even_parts, unresolved = np.zeros((3, len(points)))
    for axis, u in encoder.items():
        odd, even = _effects(description, curves, points, axis, u)
        said, even_parts, independent = said + odd**2, even_parts + even**2, independent + odd**2
        unresolved = unresolved + _doubts(description, curves, points, axis, u) ** 2
    for axis, u in zeros.items():
        odd, even = _effects(description, curves, points, axis, u)
        said, even_parts = said + odd**2, even_parts + even**2
        unresolved = unresolved + _doubts(description, curves, points, axis, u) ** 2
        common[CAUSES[axis]] = odd - brdf * _change_of_cosine(description, visit, axis, u)
    blur = curves.spikes.variance
    independent = (
        independent + np.where(curves.spike != 0, np.maximum(blur - said, 0.0), blur + even_parts) + unresolved
    )
    darks = np.array([np.sum(point.dark**2) for point in points]) / k**2
    combined = np.sqrt(independent + darks + sum(column**2 for column in common.values()))
    bounded = ~curves.spikes.told & (blur > noise)
    untold = [goal for goal, bound in zip(goals, bounded, strict=True) if bound]
    steep = curves.coarse | (unresolved > noise)
    coarse = [goal for goal, narrow in zip(goals, steep, strict=True) if narrow]
    return {"brdf": brdf, "u_brdf": combined, "u_random": np.sqrt(independent)} | common, untold, coarse


def _share_darks(results: list[_BandResult]) -> None:
    """Give all rows the columns of the dark frames' noise, which bands of one channel share; the rest to `u_random`."""
    channels = list(dict.fromkeys(result.band.channel for result in results))
    rows = [row for result in results for row in result.rows.values()]
    if not rows:
        return
    effects = np.zeros((len(rows), len(channels), 2 * PATTERNS))
    place = 0
    for result in results:
        for dark in result.darks.values():
            effects[place, channels.index(result.band.channel)] = dark.ravel()
            place += 1
    columns, rest = strongest(effects.reshape(len(rows), -1), np.array([row["u_random"] for row in rows]))
    for row, column, more in zip(rows, columns, rest, strict=True):
        row |= dict(zip(DARK, column.tolist(), strict=True))
        row["u_random"] = math.hypot(row["u_random"], math.sqrt(more))


def _axes(description: RigDescription) -> dict[str, Axis]:
    """The axes whose angles a value depends on."""
    return {name: axis for name, axis in description.axes().items() if name in CAUSES}


def _encoder_steps(description: RigDescription) -> dict[str, float]:
    """Standard uncertainty [rad] of a reading in whole steps: uniform over one step."""
    axes = {name: math.radians(axis.encoder_step_deg) / math.sqrt(12.0) for name, axis in _axes(description).items()}
    return {name: u for name, u in axes.items() if u > 0}


def _zeros(description: RigDescription) -> dict[str, float]:
    """Standard uncertainty [rad] of each zero; both arms are always there, so that tables have the same columns."""
    axes = {name: math.radians(axis.zero_u_deg) for name, axis in _axes(description).items()}
    return {name: u for name, u in axes.items() if u > 0 or name in ("light", "camera")}


def _moved(description: RigDescription, pose: Pose, axis: str, by: float) -> Directions:
    return kinematics.directions(description, replace(pose, **{axis: getattr(pose, axis) + by}))


def _effects(
    description: RigDescription, curves: angle_sensitivity.Curves, points: list[Reduced], axis: str, u: float
) -> tuple[Floats, Floats]:
    """Odd and even change [1/sr] of every value when an axis truly stands +-u [rad] from where it is read."""
    out = np.zeros((2, len(points)))
    if u > 0:
        for k, point in enumerate(points):
            plus, minus = (_moved(description, point.pose, axis, by) for by in (u, -u))
            out[:, k] = curves.effects(k, point.directions, plus, minus)
    return out[0], out[1]


def _doubts(
    description: RigDescription, curves: angle_sensitivity.Curves, points: list[Reduced], axis: str, u: float
) -> Floats:
    """How uncertain [1/sr] the odd changes of `_effects` are, because steps are coarser than the lobe is wide."""
    return np.array([curves.doubt(k, _moved(description, p.pose, axis, u)) for k, p in enumerate(points)])


def _shares(
    description: RigDescription,
    points: list[Reduced],
    errors: list[tuple[str, float]],
    cones: tuple[float, float],
    band: Band,
) -> list[spikes.Share]:
    """What each point sees of a specular spike."""
    g, radius = description.geometry, description.acquisition.roi_radius_mm
    # beyond six standard deviations of the errors nothing of the mirror image is seen
    blur = 6.0 * sum(u for _, u in errors) + 2.0 * radius * (1.0 / g.light_distance_mm + 1.0 / g.camera_distance_mm)
    out = []
    for point in points:
        d = point.directions
        if spikes.mirror_offset(d) >= sum(cones) + blur:
            out.append(spikes.Share())
            continue
        moved = [_moved(description, point.pose, axis, u) for axis, u in errors]
        patch = spikes.over_patch(d, radius, g.light_distance_mm, g.camera_distance_mm)
        out.append(spikes.blurred_overlap(d, moved, cones, patch, _over_pixels(description, point, band)))
    return out


def _over_pixels(description: RigDescription, point: Reduced, band: Band) -> Floats:
    """What `spikes.from_mirror` changes by at the pixels that a point's value is the mean of, shape (n, 3)."""
    view = kinematics.view(description, point.pose)
    region = imaging.roi(description, view, "sample", band.channel)
    seen = imaging.pixel_map(description, view, region.rows, region.cols)
    there = seen.omega_r[region.mask] - seen.omega_i[region.mask] * (-1.0, -1.0, 1.0)
    return np.asarray(there - spikes.from_mirror(point.directions))


def _change_of_cosine(description: RigDescription, visit: Reduced, axis: str, u: float) -> float:
    """Relative change (odd part) of the light on the reference when an axis truly stands u [rad] off."""
    up, down = (math.cos(_moved(description, visit.pose, axis, by).theta_i) for by in (u, -u))
    return 0.5 * (up - down) / math.cos(visit.directions.theta_i)


def _prnu(description: RigDescription, point: Reduced, reference_pixels: int) -> float:
    """Relative standard deviation from the pixels' responsivities; those that both regions use cancel in part."""
    if not description.camera.prnu:
        return 0.0
    n, m = point.pixels, reference_pixels
    return description.camera.prnu * math.sqrt(max(1.0 / n + 1.0 / m - 2.0 * point.shared / (n * m), 0.0))


def _angle_columns(directions: Directions) -> dict[str, float]:
    """The four angles [deg] as tables have them."""
    theta = [min(round(math.degrees(t), 9), 90.0) for t in (directions.theta_i, directions.theta_r)]
    phi = [round(math.degrees(p), 9) % 360.0 for p in (directions.phi_i, directions.phi_r)]
    return dict(zip(ANGLES, (theta[0], phi[0], theta[1], phi[1]), strict=True))


def _assemble(run: Run, results: list[_BandResult], notes: list[str]) -> pd.DataFrame:
    """One row for every point of the plan and every band, and the attributes."""
    import pandas as pd

    description, plan = run.description, run.plan
    causes = [*COMMON, *DARK, *(CAUSES[axis] for axis in _zeros(description))]
    nothing = dict.fromkeys(["brdf", "u_brdf", "u_random", *causes], math.nan)
    rows = []
    for point, goal in zip(plan.index.astype(int).tolist(), plan.to_dict("records"), strict=True):
        for result in results:
            values = {name: goal[name] for name in ANGLES} | nothing
            flag = goal["flag"] or result.flags.get(point, "")
            if not flag and point in result.rows:
                values = result.rows[point]
            elif not flag:
                flag = "not_measured"
            rows.append({**values, "wavelength_nm": result.band.centre_nm, "polarisation": "unpolarised", "flag": flag})
    columns = [*ANGLES, "wavelength_nm", "polarisation", "brdf", "u_brdf", "u_random", *causes, "flag"]
    frame = pd.DataFrame(rows, columns=columns)
    lamp, camera = description.lamp, description.camera
    cones = (math.radians(lamp.half_angle_deg), math.radians(camera.lens_half_angle_deg))
    frame.attrs.update(
        quantity="brdf",
        source_solid_angle_sr=float(geometry.solid_angle_of_cone(cones[0])),
        receiver_solid_angle_sr=float(geometry.solid_angle_of_cone(cones[1])),
        bands=[result.band.model_dump() for result in results],
        polarisation="unpolarised",
        source_file=str(run.path),
        sample=run.sample.name if run.sample is not None else None,
        provenance={
            "reduced_by": f"gonio {gonio.__version__}",
            "rig": description.name,
            "seed": run.seed,
            "reference": [_account(result) for result in results],
        },
        notes=notes + _notes_on_zeros(description) + [note for result in results for note in _notes(result)],
    )
    return frame


def _account(result: _BandResult) -> dict[str, float | str | None]:
    """What the visits to the reference said."""
    fitted = result.level
    known = not fitted.unknown
    return {
        "band": result.band.name,
        "brdf": result.reference_brdf,
        "visits": result.visits,
        "level_e_per_s_sr": fitted.level,
        "u_level_rel": fitted.u_level / fitted.level,
        "drift_per_hour": fitted.slope / fitted.level * 3600.0 if known else None,
        "u_drift_per_hour": fitted.u_slope / fitted.level * 3600.0 if known else None,
        "chi_square": fitted.chi_square,
        "straight": fitted.straight,
        "frame_scatter": result.scatter,
    }


def _notes_on_zeros(description: RigDescription) -> list[str]:
    return [
        f"the zero of the {kinematics.NAMES[name]} is not known (zero_offset_known = false): its error is not in u_brdf"
        for name, axis in _axes(description).items()
        if not axis.zero_offset_known
    ]


def _notes_on_damage(frames: RunFrames) -> list[str]:
    if not frames.damaged:
        return []
    names = sorted(frames.damaged)
    shown = ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
    out = [f'{len(names)} frames are {DAMAGED} ({shown}); points that lack one are flagged "damaged", and {RETAKE}']
    if frames.darks_taken > 1 and frames.darks_used == 1:
        out.append(
            "the dark frames of one exposure alone are left: the dark current is that of the rig file, and its "
            "uncertainty is not in u_brdf"
        )
    return out


def _notes_on_darks(frames: RunFrames) -> list[str]:
    # all at 0 is a camera without noise; some at 0 is one whose noise is cut off there
    if not CLIPPED < frames.clipped < 1.0:
        return []
    return [
        f"{100.0 * frames.clipped:.2g} % of the pixels of the dark frames read 0 DN: what lies below is cut off, and "
        "values are too low by more than u_brdf says where the signal is small; raise the camera's black level"
    ]


def _notes(result: _BandResult) -> list[str]:
    name = result.band.name
    out = white_reference.notes(result.level, result.visits, result.unusable, name)
    if result.untold:
        out.append(
            f"{name}: nothing tells whether a specular spike stands at {_listed(result.untold)}: what "
            "errors of the angles would do to one is in u_brdf, which is large; measure the mirror direction too, and "
            "points on both sides of it that the spike does not reach"
        )
    if result.coarse:
        out.append(
            f"{name}: the plan's steps are too coarse for the lobe at {_listed(result.coarse)}: u_brdf there rests on "
            "what neighbouring points leave open, and may be too small; measure in finer steps around the mirror "
            "direction"
        )
    # three standard deviations of a reduced chi-square, and enough to matter: uncertainties 20 % too small
    if result.scatter > max(1.44, 1.0 + 3.0 * math.sqrt(2.0 / max(result.freedom, 1))):
        out.append(
            f"{name}: frames of one step scatter {math.sqrt(result.scatter):.1f} times as much as the rig file's noise "
            "says (see lamp.noise and the camera's noise there): u_random is too small"
        )
    return out


def _listed(points: list[Directions]) -> str:
    """The first points of a list, for people, in degrees."""
    first = ", ".join(
        f"({', '.join(f'{math.degrees(a):g}' for a in (d.theta_i, d.theta_r, (d.phi_r - d.phi_i) % (2 * math.pi)))})"
        for d in points[:3]
    )
    return f"(theta_i, theta_r, dphi) = {first} deg" + (f" and {len(points) - 3} more" if len(points) > 3 else "")
