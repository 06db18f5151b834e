"""Raw frames to BRDF with uncertainty: what `gonio reduce` does. The formulas are explained in docs/radiometry.md.

Every pixel of the region of interest is freed of its own bias and dark charge, and divided by the geometry that it
is known to see (docs/pose_to_pixel.md). The mean over the region is a rate in electrons
a second. Frames of one point are merged with the inverse of the variance that EMVA 1288 predicts for the *pooled*
signal. A rate over the signal per unit BRDF, which visits to the white reference tell, is the BRDF.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.acquisition.plan import ANGLES
from gonio.errors import ConfigError, DataError
from gonio.geometry import Directions, mirrored
from gonio.reduction import angle_sensitivity, budget, light_and_lens, spike_overlap, white_reference
from gonio.reduction.band_result import BandResult, Inputs
from gonio.reduction.count_rates import Reduced, Rejected, RunFrames, in_threads
from gonio.reduction.dark_signal import PATTERNS, strongest
from gonio.reduction.merging import FALSE_ALARMS, noise_is_known
from gonio.reduction.reference_table import brdf_of_reference, u_of_reference
from gonio.reduction.table import (
    CAUSES,
    DARK,
    GEOMETRY,
    LAMP,
    assemble,
    camera_causes,
    encoder_steps,
    notes_on_camera,
    notes_on_damage,
    notes_on_darks,
    zero_uncertainties,
)
from gonio.rig import Pose, calibrated, imaging, kinematics
from gonio.rig.beam_size import filling
from gonio.rig.description import Band, RigDescription
from gonio.typing import Floats

if TYPE_CHECKING:
    import pandas as pd

    from gonio.acquisition.run import Run


@dataclass(frozen=True, slots=True)
class Reduction:
    """A reduced run."""

    table: pd.DataFrame
    """See `reduce`."""
    budget: pd.DataFrame
    """The parts of each value's uncertainty (`gonio.reduction.budget.assemble`), rows as in the table."""
    bands: list[BandResult]


def reduce(run: Run, *, progress: Callable[[int, int], None] | None = None) -> pd.DataFrame:
    """The measurement table of a run; see `reduce_in_parts`."""
    return reduce_in_parts(run, progress=progress).table


def reduce_in_parts(run: Run, *, progress: Callable[[int, int], None] | None = None) -> Reduction:
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
    Reduction
        Its table is as `gonio.measurement` describes it, in the order of the plan. Angles are what the encoders read.
        `brdf` is NaN where `flag` says why: "blocked", "unreachable" and the plan's other reasons, "saturated" (in
        every frame), "below_horizon" (at the pose that was read), "moved" (an axis did not stand still), "unsteady"
        (its encoder trembles), "damaged" (a frame of the point is missing or was changed), "contradictory" (one says
        of itself what cannot be), "unmonitored" (one has no reading of the lamp's monitor), "partly_filled" (the
        beam's edge cuts through the region), "not_measured" (the run
        ended before).
        Causes: `s_reference` (the certificate), `s_reference_noise` (mean level of the visits), `s_lamp_drift`, from
        three visits on `s_lamp_wander_1` to at most `s_lamp_wander_4` (what the lamp may do between visits),
        `s_dark_1` to `s_dark_3` (noise of the dark frames), `s_theta_i_zero`, `s_theta_r_zero` and, with those axes,
        `s_tilt_zero`, `s_azimuth_zero`, `s_spin_zero`; `s_geometry_1` to at most `s_geometry_4` (what a calibration
        leaves open of the rig's geometry); and where the rig file or a calibration tells of them `s_linearity`,
        `s_stray_light`, `s_beam`, `s_polarisation`, `s_wavelength`, `s_bandwidth`. A plan with points behind the
        sample gives a column `side`.

    Raises
    ------
    DataError
        There are no dark frames or no usable visit to the white reference, or none of them is whole; or frames are the
        same picture although they have noise (`gonio.acquisition.repeats`). Other frames that
        are missing, or not those that the journal names, are left out, with a note.
    ConfigError
        The reference's table is missing, or neither a table nor an albedo is given.
    """
    frames = RunFrames(run)
    count = len(frames.points)
    reduced: list[list[Reduced | Rejected]] = []
    for k, band in enumerate(run.bands):
        steps = []
        for step in in_threads(partial(frames.reduce, band=band), frames.steps()):
            steps.append(step)
            if progress is not None:
                progress(k * count + len(steps), len(run.bands) * count)
        reduced.append(steps)
    frames.require_no_repeats()
    results = [_reduce_band(frames, band, steps) for band, steps in zip(run.bands, reduced, strict=True)]
    light_and_lens.add_wavelength(frames.description, results)
    _share_darks(results)
    _share(results, [result.geometry for result in results], GEOMETRY, "geometry")
    _share(results, [result.lamp for result in results], LAMP, "visits")
    notes = notes_on_damage(frames) + notes_on_darks(frames) + notes_on_camera(frames)
    table = assemble(run, results, notes, frames.clipped)
    table.attrs["provenance"]["not_in_budget"] = budget.left_out(run.description, table)
    return Reduction(table, budget.assemble(table, results), results)


def _reduce_band(frames: RunFrames, band: Band, steps: list[Reduced | Rejected]) -> BandResult:
    points = [step for step in steps if isinstance(step, Reduced) and step.point is not None]
    visits = [step for step in steps if isinstance(step, Reduced) and step.point is None]
    rejected = [step for step in steps if isinstance(step, Rejected)]
    fitted, reference = level(frames.run, np.array([point.time_s for point in points]), visits, band)
    columns, undetermined, coarse = _columns_of_sides(frames, points, visits[0], fitted, reference.u_rel, band)
    geometry, lamp = columns.pop("geometry_causes"), columns.pop("lamp_causes")
    light_and_lens.add(frames.description, columns, [point.pose for point in points], visits[0].pose, band)
    levels = fitted.at(np.array([point.time_s for point in points]))
    angles = np.array([_angles_deg(point.directions) for point in points]).reshape(-1, len(ANGLES))
    darks = np.array([point.dark for point in points]).reshape(len(points), 2, PATTERNS)
    freedom = sum(step.frames - 1 for step in (*points, *visits))
    return BandResult(
        band=band,
        points=np.array([point.point for point in points], dtype=np.intp),
        columns=dict(zip(ANGLES, angles.T, strict=True)) | columns,
        darks=darks / levels[:, None, None],
        geometry=geometry,
        lamp=lamp,
        flags=frames.flags | {step.point: step.flag for step in rejected if step.point is not None},
        level=fitted,
        reference_brdf=reference.brdf,
        u_reference_rel=reference.u_rel,
        visits=len(visits),
        unusable=frames.lost_visits + [step.flag for step in rejected if step.point is None],
        scatter=sum(step.chi_square for step in (*points, *visits)) / max(freedom, 1),
        freedom=freedom,
        frames=sum(step.frames + step.left_out for step in (*points, *visits)) + sum(r.left_out for r in rejected),
        left_out=sum(s.left_out for s in (*points, *visits)) + sum(r.left_out for r in rejected),
        undetermined=undetermined,
        coarse=coarse,
        merged=_merged(frames, band, points, visits),
        inputs=Inputs(points, visits, frames.prnu),
    )


@dataclass(frozen=True, slots=True)
class Reference:
    """What is known of the reference in one band."""

    brdf: float
    """Mean over the visits [1/sr]; 1 where the lamp itself is the reference."""
    u_rel: float
    """Relative standard uncertainty of that."""


def _merged(frames: RunFrames, band: Band, points: list[Reduced], visits: list[Reduced]) -> dict[str, Any]:
    """What merging by pixels left out, in a band; nothing where whole frames were merged."""
    if not frames.description.acquisition.by_pixels:
        return {}
    every = [*points, *visits]
    return {
        "band": band.name,
        "noise": "known" if noise_is_known(frames.description) else "poisson",
        "false_alarms_per_step": FALSE_ALARMS,
        "cosmic_hits": sum(step.hits for step in every),
        "cosmic_hits_in_darks": frames.dark_hits,
        "cosmic_hits_of_points": {str(point.point): point.hits for point in points if point.hits},
        "hot_pixels": max((step.hot for step in every), default=0),
        "saturated_fraction": max((step.saturated for step in every), default=0.0),
    }


def level(run: Run, wanted_s: Floats, visits: list[Reduced], band: Band) -> tuple[white_reference.Level, Reference]:
    """The signal per unit BRDF at some times, and the reference's BRDF; see `reduce_in_parts` for what raises."""
    description, reference = run.description, run.description.reference
    if not visits:
        raise DataError(
            f"{run.path}: no usable visit to the white reference in band {band.name}; see its frames: where they are "
            "full, lower acquisition.exposure_target, and calibrate the camera"
        )
    rates, u_rel = np.array([visit.rate for visit in visits]), reference.u_rel
    if rates.min() <= 0:
        raise DataError(f"{run.path}: a visit to the white reference in band {band.name} saw no light; see its frames")
    if reference.how == "beam":
        known = np.ones(len(visits))
        variance = float(calibrated.covariance_of(description, ["reference.attenuation"])[0, 0])
        u_rel = math.hypot(u_rel, math.sqrt(variance) / (reference.attenuation or 1.0))
    elif reference.table is not None:
        from gonio import measurement

        table = measurement.read(reference.table)
        table.attrs.setdefault("source_file", reference.table)
        known = np.array([brdf_of_reference(table, visit.directions, band.centre_nm) for visit in visits])
        u_rel = math.hypot(u_rel, u_of_reference(table, visits[0].directions, band.centre_nm) / float(known[0]))
    elif reference.albedo:
        known = np.full(len(visits), reference.albedo / math.pi)
    else:
        raise ConfigError(
            f"{run.path / 'run.toml'}: the rig has neither reference.albedo (above 0) nor reference.table: "
            "nothing says how bright the white reference is"
        )
    encoder = encoder_steps(description)
    landing = sum(_change_of_cosine(description, visits[0], axis, u) ** 2 for axis, u in encoder.items())
    variances = np.array([visit.variance for visit in visits]) + landing * rates**2
    times = np.array([visit.time_s for visit in visits])
    fitted = white_reference.fit(times, rates / known, variances / known**2, wanted_s, run.lit_anew_s)
    return fitted, Reference(float(known.mean()), u_rel)


def _columns_of_sides(
    frames: RunFrames,
    points: list[Reduced],
    visit: Reduced,
    fitted: white_reference.Level,
    u_reference: float,
    band: Band,
) -> tuple[dict[str, Floats], Directions, Directions]:
    """`_columns` of the points on each side of the sample, whose curves have nothing to do with each other."""
    behind = np.array([_behind(point.directions) for point in points], dtype=bool)
    if not behind.any():
        return _columns(frames, points, visit, fitted, u_reference, band)
    columns: dict[str, Floats] = {}
    undetermined, coarse = [], []
    for there in (False, True):
        rows = np.flatnonzero(behind == there)
        if not rows.size:
            continue
        # behind the sample lobes move with the straight direction as they do before it with the mirror's
        group = [replace(points[k], directions=_turned_over(points[k].directions, there)) for k in rows]
        found, first, second = _columns(frames, group, visit, fitted, u_reference, band)
        for name, values in found.items():
            columns.setdefault(name, np.zeros((len(points), *values.shape[1:])))[rows] = values
        undetermined += list(_turned_over(first, there))
        coarse += list(_turned_over(second, there))
    return columns, Directions.stack(undetermined), Directions.stack(coarse)


def _behind(d: Directions) -> bool:
    """Whether the detector of one pair of directions is behind the sample."""
    return bool(d.theta_r > 0.5 * math.pi)


def _turned_over(d: Directions, behind: bool) -> Directions:
    """Directions of transmission as those of reflection: the detector mirrored at the sample's plane."""
    return Directions(d.theta_i, d.phi_i, math.pi - d.theta_r, d.phi_r) if behind else d


def _columns(
    frames: RunFrames,
    points: list[Reduced],
    visit: Reduced,
    fitted: white_reference.Level,
    u_reference: float,
    band: Band,
) -> tuple[dict[str, Floats], Directions, Directions]:
    """BRDF and its uncertainties for the measured points of a band (docs/radiometry.md, "The budget").

    The columns "geometry_causes" and "lamp_causes" have a number for every cause of `GeometryErrors` and of `Wander`.
    And the nominal directions of points
    whose blur by the angles' errors is only bounded, and of those whose slope the plan's steps are too coarse to tell.
    """
    description = frames.description
    encoder, zeros = encoder_steps(description), zero_uncertainties(description)
    times = np.array([point.time_s for point in points])
    k = fitted.at(times)
    brdf = np.array([point.rate for point in points]) / k
    noise = np.array([point.variance for point in points]) / k**2
    prnu = np.array([_prnu(frames.prnu, point, frames.reference[band.channel].count) for point in points])
    wander = fitted.wander(times)
    lamp = -(brdf / k)[:, None] * wander.shared
    visits = np.maximum((brdf * wander.u / k) ** 2 - np.sum(lamp**2, axis=1), 0.0)
    parts = {"noise": noise, "prnu": (brdf * prnu) ** 2, "visits": visits}
    independent = sum(parts.values())
    goals = Directions.from_table(frames.run.plan)[[point.point for point in points]]
    goals = _turned_over(goals, bool(len(goals)) and _behind(goals[0]))
    cones = math.radians(description.lamp.half_angle_deg), math.radians(description.camera.lens_half_angle_deg)
    # a spin turns the lamp's mirror image and the lens alike
    errors = [(axis, u) for axis, u in (*encoder.items(), *zeros.items()) if axis != "spin"]
    shares = _shares(frames, points, errors, cones, band)
    read = Directions.stack([point.directions for point in points])
    curves = angle_sensitivity.Curves(
        goals, read, brdf, np.sqrt(independent), cones, shares, filling(description) == "under"
    )
    brdf = brdf + curves.spikes.correction
    common = {
        "s_reference": brdf * u_reference,
        "s_reference_noise": -brdf * fitted.noise(times) / k,
        "s_lamp_drift": -brdf * fitted.drift(times) / k,
    }
    of_angles = _errors_of_angles(frames, curves, points, visit, brdf)
    common |= of_angles.zeros | _camera_columns(description, points, visit, brdf, k)
    parts |= _parts_of_angles(of_angles, curves) | {"region": _over_region(description, curves, points, band) ** 2}
    independent = sum(parts.values())
    darks = np.array([np.sum(point.dark**2) for point in points]) / k**2
    shared = darks + np.sum(of_angles.geometry**2, axis=1) + np.sum(lamp**2, axis=1)
    combined = np.sqrt(independent + shared + sum(column**2 for column in common.values()))
    bounded = ~curves.spikes.told & (curves.spikes.variance > noise)
    known, unresolved, u_slopes = curves.facts(), of_angles.unresolved, of_angles.of_geometry
    # the steps along a curve, and not those between angles of incidence
    steep = (unresolved > independent - unresolved) & (known["u_slope"] > known["u_slope_theta_i"])
    columns = {"brdf": brdf, "u_brdf": combined, "u_random": np.sqrt(independent)}
    columns |= {"geometry_causes": of_angles.geometry, "lamp_causes": lamp} | common
    columns |= {name: np.sqrt(part) for name, part in parts.items()} | known
    columns["geometry_slopes"] = np.sqrt(u_slopes)
    of_readings = sum(parts[name] for name in ("encoder", "zeros_even", "spike_blur", "coarse_steps")) - u_slopes
    columns["u_angles"] = np.sqrt(np.maximum(of_readings, 0.0))
    columns["coarse"] = steep.astype(float)
    return columns, goals[bounded], goals[steep]


@dataclass(frozen=True, slots=True)
class _OfAngles:
    """What errors of the axes and of a calibrated geometry do to the values of a band; variances in 1/sr^2."""

    zeros: dict[str, Floats]
    """Columns of the table [1/sr]."""
    geometry: Floats
    """Odd change [1/sr] by every cause of `GeometryErrors`, shape (points, causes)."""
    odd: Floats
    """Variance of all odd changes together."""
    steps: Floats
    """That of the odd changes by the encoders' steps alone."""
    even_steps: Floats
    """Squares of the even changes: by the encoders' steps, by the zeros, by the geometry."""
    even_zeros: Floats
    even_geometry: Floats
    unresolved: Floats
    """Of the odd changes, because the plan's steps are coarser than a lobe may be wide."""
    of_geometry: Floats
    """The part of `unresolved` that is the geometry's."""


def _errors_of_angles(
    frames: RunFrames, curves: angle_sensitivity.Curves, points: list[Reduced], visit: Reduced, brdf: Floats
) -> _OfAngles:
    """The changes by every axis's reading and zero, and by what a calibration leaves open of the geometry."""
    description, columns = frames.description, {}
    odd_all, steps, even_steps, even_zeros, unresolved = np.zeros((5, len(points)))
    for axis, u in encoder_steps(description).items():
        odd, even, u_slope = _effects(description, curves, points, axis, u)
        odd_all, steps, even_steps = odd_all + odd**2, steps + odd**2, even_steps + even**2
        unresolved = unresolved + u_slope**2
    for axis, u in zero_uncertainties(description).items():
        odd, even, u_slope = _effects(description, curves, points, axis, u)
        odd_all, even_zeros, unresolved = odd_all + odd**2, even_zeros + even**2, unresolved + u_slope**2
        columns[CAUSES[axis]] = odd - brdf * _change_of_cosine(description, visit, axis, u)
    geometry, even_geometry, u_slopes = _effects_of_geometry(frames, curves, points, visit, brdf)
    odd_all, unresolved = odd_all + np.sum(geometry**2, axis=1), unresolved + u_slopes
    return _OfAngles(columns, geometry, odd_all, steps, even_steps, even_zeros, even_geometry, unresolved, u_slopes)


def _parts_of_angles(found: _OfAngles, curves: angle_sensitivity.Curves) -> dict[str, Floats]:
    """The parts of `u_random` that errors of the angles make, as variances.

    Of a spike the blur holds what these errors do evenly.
    """
    blur, spiked = curves.spikes.variance, curves.spike != 0
    return {
        "encoder": found.steps + np.where(spiked, 0.0, found.even_steps),
        "zeros_even": np.where(spiked, 0.0, found.even_zeros),
        "geometry": np.where(spiked, 0.0, found.even_geometry),
        "spike_blur": np.where(spiked, np.maximum(blur - found.odd, 0.0), blur),
        "coarse_steps": found.unresolved,
    }


def _camera_columns(
    description: RigDescription, points: list[Reduced], visit: Reduced, brdf: Floats, level: Floats
) -> dict[str, Floats]:
    """What the calibration's uncertainty of the camera's linearity and stray light does to the values [1/sr].

    A point's change is that of its own rate less that of the reference's, to which it is compared.
    """
    by = np.array([point.by_camera for point in points]).reshape(len(points), visit.by_camera.size)
    change = by / level[:, None] - brdf[:, None] * visit.by_camera / visit.rate
    return {column: change @ direction for column, direction in camera_causes(description).items()}


def _share_darks(results: list[BandResult]) -> None:
    """Give all rows the columns of the dark frames' noise, which bands of one channel share; the rest to `u_random`."""
    channels = list(dict.fromkeys(result.band.channel for result in results))
    ends = np.cumsum([result.points.size for result in results])
    if not ends[-1]:
        return
    effects = np.zeros((ends[-1], len(channels), 2 * PATTERNS))
    for result, end in zip(results, ends, strict=True):
        rows = slice(end - result.points.size, end)
        effects[rows, channels.index(result.band.channel)] = result.darks.reshape(result.points.size, -1)
    u = np.concatenate([result.columns["u_random"] for result in results])
    columns, rest = strongest(effects.reshape(ends[-1], -1), u)
    for result, end in zip(results, ends, strict=True):
        rows = slice(end - result.points.size, end)
        result.columns.update(zip(DARK, columns[rows].T, strict=True))
        result.columns["dark"] = np.sqrt(rest[rows])
        more = [math.hypot(random, left) for random, left in zip(u[rows], result.columns["dark"], strict=True)]
        result.columns["u_random"] = np.array(more)


def _share(results: list[BandResult], of_bands: list[Floats], names: Sequence[str], part: str) -> None:
    """Give all rows the columns of causes that they share; what these leave goes to a part of `u_random`.

    `of_bands` are the effects of the causes on the rows of each band, shape (points, causes): of all bands alike, or
    none.
    """
    wide = max(effects.shape[1] for effects in of_bands)
    effects = np.concatenate([np.pad(each, ((0, 0), (0, wide - each.shape[1]))) for each in of_bands])
    if not effects.size:
        return
    u = np.concatenate([result.columns["u_random"] for result in results])
    columns, rest = strongest(effects, u, min(len(names), wide))
    ends = np.cumsum([result.points.size for result in results])
    for result, end in zip(results, ends, strict=True):
        rows = slice(end - result.points.size, end)
        result.columns.update(zip(names[: columns.shape[1]], columns[rows].T, strict=True))
        result.columns[part] = np.sqrt(result.columns[part] ** 2 + rest[rows])
        result.columns["u_random"] = np.sqrt(u[rows] ** 2 + rest[rows])


def _moved(description: RigDescription, pose: Pose, axis: str, by: float) -> Directions:
    """The directions when an axis stands elsewhere; of transmission `_turned_over`."""
    moved = kinematics.directions(description, replace(pose, **{axis: getattr(pose, axis) + by}))
    return _turned_over(moved, _behind(kinematics.directions(description, pose)))


def _effects(
    description: RigDescription, curves: angle_sensitivity.Curves, points: list[Reduced], axis: str, u: float
) -> tuple[Floats, Floats, Floats]:
    """Odd and even change [1/sr] of every value when an axis truly stands +-u [rad] from where it is read.

    And how uncertain [1/sr] the odd ones are, because steps are coarser than the lobe is wide.
    """
    out = np.zeros((3, len(points)))
    if u > 0 and (axis != "spin" or curves.directed):
        for k, point in enumerate(points):
            plus, minus = (_moved(description, point.pose, axis, by) for by in (u, -u))
            out[:, k] = *curves.effects(k, point.directions, plus, minus), curves.slope_uncertainty(k, plus)
    return out[0], out[1], out[2]


def _effects_of_geometry(
    frames: RunFrames, curves: angle_sensitivity.Curves, points: list[Reduced], visit: Reduced, brdf: Floats
) -> tuple[Floats, Floats, Floats]:
    """Odd change [1/sr] of every value by every cause of `GeometryErrors`, shape (points, causes).

    And the sums over the causes of the squares of the even changes and of what the plan's steps leave open of them.
    """
    errors = frames.geometry
    odd, even, u_slope = np.zeros((3, len(points), errors.count))
    if not errors.count:
        return odd, np.zeros(len(points)), np.zeros(len(points))
    if frames.description.reference.how == "beam":
        light = errors.straight_through(visit.pose)
    else:
        light = errors.at(visit.pose, "reference").relative_light
    for k, point in enumerate(points):
        factor = errors.at(point.pose, "sample").relative_distance_factor
        for j, (up, down) in enumerate(_changed(frames, point)):
            odd[k, j], even[k, j] = curves.effects(k, point.directions, up, down)
            u_slope[k, j] = curves.slope_uncertainty(k, up)
        odd[k] += brdf[k] * 0.5 * (factor[:, 0] - factor[:, 1] - light[:, 0] + light[:, 1])
    return odd, np.sum(even**2, axis=1), np.sum(u_slope**2, axis=1)


def _shares(
    frames: RunFrames,
    points: list[Reduced],
    errors: list[tuple[str, float]],
    cones: tuple[float, float],
    band: Band,
) -> list[spike_overlap.OverlapFraction]:
    """What each point sees of a specular spike."""
    description = frames.description
    g, radius = description.geometry, description.acquisition.roi_radius_mm
    # beyond six standard deviations of the errors nothing of the mirror image is seen
    blur = 6.0 * sum(u for _, u in errors) + 2.0 * radius * (1.0 / g.light_distance_mm + 1.0 / g.camera_distance_mm)
    out = []
    for point in points:
        d = point.directions
        changed = [up for up, _ in _changed(frames, point)]
        turned = sum(float(np.linalg.norm(change.from_mirror - d.from_mirror)) for change in changed)
        if float(d.mirror_offset) >= sum(cones) + blur + 6.0 * turned:
            out.append(spike_overlap.OverlapFraction())
            continue
        moved = Directions.stack([*(_moved(description, point.pose, axis, u) for axis, u in errors), *changed])
        patch = spike_overlap.over_patch(d, radius, g.light_distance_mm, g.camera_distance_mm)
        out.append(spike_overlap.blurred_overlap(d, moved, cones, patch, _over_pixels(description, point, band)))
    return out


def _changed(frames: RunFrames, point: Reduced) -> list[tuple[Directions, Directions]]:
    """The directions of a point for one standard deviation of each cause of `GeometryErrors`, up and down."""
    if not frames.geometry.count:
        return []
    sights = frames.geometry.at(point.pose, "sample")
    behind = bool(sights.known[2] > 0.5 * math.pi)
    return [(_turned_over(up, behind), _turned_over(down, behind)) for up, down in sights.directions()]


def _over_region(
    description: RigDescription, curves: angle_sensitivity.Curves, points: list[Reduced], band: Band
) -> Floats:
    """What the lobes' slopes and curvatures over the region of interest change every value by, at most [1/sr]."""
    return np.array([curves.over_region(k, p.directions, *_pixels(description, p, band)) for k, p in enumerate(points)])


def _over_pixels(description: RigDescription, point: Reduced, band: Band) -> Floats:
    """What `Directions.from_mirror` changes by at the pixels that a point's value is the mean of, shape (n, 3)."""
    omega_i, omega_r = _pixels(description, point, band)
    return np.asarray(omega_r - mirrored(omega_i) - point.directions.from_mirror)


def _pixels(description: RigDescription, point: Reduced, band: Band) -> tuple[Floats, Floats]:
    """Unit vectors to source and detector from the pixels that a point's value is the mean of, shape (n, 3)."""
    view = kinematics.view(description, point.pose)
    region = imaging.roi(description, view, "sample", band.channel)
    seen = imaging.pixel_map(description, view, region.rows, region.cols)
    omega_r = seen.omega_r[region.mask]
    omega_i = seen.omega_i[region.mask]
    omega_r = omega_r * (1.0, 1.0, -1.0) if view.camera_mm[2] < 0.0 else omega_r
    if filling(description) == "over":
        return omega_i, omega_r
    lit = seen.lit[region.mask] > 0.5
    return (omega_i[lit], omega_r[lit]) if lit.any() else (omega_i, omega_r)


def _change_of_cosine(description: RigDescription, visit: Reduced, axis: str, u: float) -> float:
    """Relative change (odd part) of the signal of the reference when an axis truly stands u [rad] off.

    The lamp itself, seen whole, is as bright wherever in the frame it stands.
    """
    if description.reference.how == "beam":
        return 0.0
    which = "theta_i" if filling(description) == "over" else "theta_r"
    up, down = (math.cos(getattr(_moved(description, visit.pose, axis, by), which)) for by in (u, -u))
    return 0.5 * (up - down) / math.cos(getattr(visit.directions, which))


def _prnu(prnu: float, point: Reduced, reference_pixels: int) -> float:
    """Relative standard deviation from the pixels' responsivities; those that both regions use cancel in part."""
    if not prnu:
        return 0.0
    n, m = point.pixels, reference_pixels
    return prnu * math.sqrt(max(1.0 / n + 1.0 / m - 2.0 * point.shared / (n * m), 0.0))


def _angles_deg(directions: Directions) -> tuple[float, float, float, float]:
    """The four angles [deg] as tables have them."""
    most = (90.0, 180.0 if _behind(directions) else 90.0)
    theta = [
        min(round(math.degrees(t), 9), m) for t, m in zip((directions.theta_i, directions.theta_r), most, strict=True)
    ]
    phi = [round(math.degrees(p), 9) % 360.0 for p in (directions.phi_i, directions.phi_r)]
    return theta[0], phi[0], theta[1], phi[1]
