"""Raw frames to BRDF with uncertainty: what `gonio reduce` does. The formulas are explained in docs/radiometry.md.

Every pixel of the region of interest is freed of its own bias and dark charge, and divided by the geometry that it
is known to see (docs/mechanics.md). The mean over the region is a rate in electrons
a second. Frames of one point are merged with the inverse of the variance that EMVA 1288 predicts for the *pooled*
signal. A rate over the signal per unit BRDF, which visits to the white reference tell, is the BRDF.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gonio.errors import ConfigError, DataError
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import angle_errors, light_and_lens, polarised, reference_table, white_reference
from gonio.lab.reduction.angle_errors import change_of_cosine, encoder_steps, is_behind, turned_over
from gonio.lab.reduction.count_rates import RunFrames
from gonio.lab.reduction.dark_signal import PATTERNS
from gonio.lab.reduction.merging import FALSE_ALARMS, noise_is_known
from gonio.lab.reduction.reference_table import brdf_of_reference, u_of_reference
from gonio.lab.reduction.step_rates import Reduced, Rejected
from gonio.lab.reduction.table import DARK, GEOMETRY, LAMP, POLARISATION, PRNU, assemble, assemble_budget, left_out
from gonio.lab.reduction.values import BandResult, Cause, MeasuredBand, Values, joined, share
from gonio.lab.rig import calibration_files
from gonio.lab.rig.light_and_camera import Band
from gonio.threads import in_threads
from gonio.typing import DataFrame, Floats, JsonObject


@dataclass(frozen=True, slots=True)
class Reduction:
    """A reduced run."""

    table: DataFrame
    """See `reduce`."""
    budget: DataFrame
    """The parts of each value's uncertainty (`gonio.lab.reduction.table.assemble_budget`), rows as in the table."""
    bands: list[BandResult]


def reduce(run: Run, *, progress: Callable[[int, int], None] | None = None) -> DataFrame:
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
        `s_dark_1` to `s_dark_3` (noise of the dark frames), `s_prnu_1` to `s_prnu_3` (responsivities of the pixels that
        points share, where they differ), `s_theta_i_zero`, `s_theta_r_zero` and, with those axes,
        `s_tilt_zero`, `s_azimuth_zero`, `s_spin_zero`; `s_geometry_1` to at most `s_geometry_4` (what a
        calibration leaves open of the rig's geometry); and where the rig file or a calibration tells of them
        `s_linearity`, `s_stray_light`, `s_black`, `s_beam`, `s_polarisation_1` to `_12`, `s_wavelength`, `s_bandwidth`;
        of polarised values `s_light_extinction`, `s_light_azimuth` and the same of the receiver. A plan with points
        behind the sample gives a column `side`.

    Raises
    ------
    DataError
        There are no dark frames or no usable visit to the white reference, or none of them is whole; or frames are the
        same picture although they have noise (`gonio.lab.acquisition.repeats`). Other frames that
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
    polarised.add_shared(frames.description, results)
    columns = (("dark", DARK), ("prnu", PRNU), ("geometry", GEOMETRY), ("visits", LAMP), ("polarisation", POLARISATION))
    for part, names in columns:
        if part in results[0].values.shared:
            share([result.values for result in results], part, names)
    table = assemble(frames, results)
    table.attrs["provenance"]["not_in_budget"] = left_out(run.description, table)
    return Reduction(table, assemble_budget(table, results), results)


def _reference(measured: MeasuredBand, values: Values) -> None:
    """Add the certificate's uncertainty, and what the visits' noise leaves open of the level."""
    values.common |= measured.fitted.changes(values.brdf, measured.times_s, measured.u_reference)


CAUSES: tuple[Cause, ...] = (_reference, *light_and_lens.CAUSES)
"""The causes of uncertainty that act on each band alone, beside noise, darks and angles (docs/budget.md). To add one:
write `mine.py` beside this module, and its cause here."""


def _reduce_band(frames: RunFrames, band: Band, steps: list[Reduced | Rejected]) -> BandResult:
    points = [step for step in steps if isinstance(step, Reduced) and step.point is not None]
    visits = [step for step in steps if isinstance(step, Reduced) and step.point is None]
    rejected = [step for step in steps if isinstance(step, Rejected)]
    measured = MeasuredBand(
        frames, band, points, visits, *level(frames.run, np.array([point.time_s for point in points]), visits, band)
    )
    # curves on the two sides of the sample are independent; lobes behind it follow the direction straight through, as
    # those before it follow the mirror direction
    behind = np.array([is_behind(point.directions) for point in points], dtype=bool)
    sides = [there for there in (False, True) if np.any(behind == there)] or [False]
    rows = [np.flatnonzero(behind == there) for there in sides]
    of_sides = []
    for there, at in zip(sides, rows, strict=True):
        group = [replace(points[k], directions=turned_over(points[k].directions, there)) for k in at]
        of_sides.append(_values(replace(measured, points=group)))
    merged = [step.merged for step in (*points, *visits)]
    freedom = sum(step.frames - 1 for step in merged)
    left_out = sum(step.left_out for step in steps)
    return BandResult(
        measured=measured,
        values=joined(of_sides, rows),
        flags=frames.flags | {step.point: step.flag for step in rejected if step.point is not None},
        unusable=frames.lost_visits + [step.flag for step in rejected if step.point is None],
        scatter=sum(step.chi_square for step in merged) / max(freedom, 1),
        freedom=freedom,
        frames=sum(step.frames for step in merged) + left_out,
        left_out=left_out,
        merged=_merged(measured),
    )


def _values(measured: MeasuredBand) -> Values:
    """BRDF and its uncertainties for the points of a band on one side (docs/radiometry.md, "The budget")."""
    points, fitted, k = measured.points, measured.fitted, measured.level
    brdf = np.array([point.rate for point in points]) / k
    noise = np.array([point.variance for point in points]) / k**2
    prnu, by_pixels = _responsivities(measured)
    wander = fitted.wander(measured.times_s)
    lamp = -(brdf / k)[:, None] * wander.shared
    visits = np.maximum((brdf * wander.u / k) ** 2 - np.sum(lamp**2, axis=1), 0.0)
    curves = angle_errors.curves_of(measured, brdf, np.sqrt(noise + (brdf * prnu) ** 2 + visits))
    values = Values(
        brdf=brdf + curves.spikes.correction,
        lobes=curves.facts(),
        bounded=~curves.spikes.told & (curves.spikes.variance > noise),
        coarse=np.zeros(len(points), bool),
        own={"noise": np.sqrt(noise), "prnu": abs(brdf) * _left(prnu, by_pixels), "visits": np.sqrt(visits)},
        shared={"dark": _darks(measured), "visits": lamp},
    )
    if measured.frames.prnu:
        values.shared["prnu"] = _of_channel(measured, brdf[:, None] * by_pixels)
    angle_errors.add(measured, values, curves)
    for cause in CAUSES:
        cause(measured, values)
    return values


def _darks(measured: MeasuredBand) -> Floats:
    """Change of each value [1/sr] by the noise of the dark frames."""
    darks = np.array([point.dark for point in measured.points]).reshape(-1, 2 * PATTERNS)
    return _of_channel(measured, darks / measured.level[:, None])


def _of_channel(measured: MeasuredBand, effects: Floats) -> Floats:
    """Effects of pixels, shape (points, causes), which the bands of one channel share, among those of all channels."""
    channels = list(dict.fromkeys(band.channel for band in measured.frames.run.bands))
    out = np.zeros((len(effects), len(channels), effects.shape[1]))
    out[:, channels.index(measured.band.channel)] = effects
    return out.reshape(len(effects), len(channels) * effects.shape[1])


def _merged(measured: MeasuredBand) -> JsonObject:
    """What merging by pixels left out, in a band; nothing where whole frames were merged."""
    if not measured.description.acquisition.by_pixels:
        return {}
    every = [step.merged for step in (*measured.points, *measured.visits)]
    return {
        "band": measured.band.name,
        "noise": "known" if noise_is_known(measured.description) else "poisson",
        "false_alarms_per_step": FALSE_ALARMS,
        "cosmic_hits": sum(step.hits for step in every),
        "cosmic_hits_in_darks": measured.frames.dark_hits,
        "cosmic_hits_of_points": {str(p.point): p.merged.hits for p in measured.points if p.merged.hits},
        "hot_pixels": max((step.hot for step in every), default=0),
        "saturated_fraction": max((step.saturated for step in every), default=0.0),
    }


def level(run: Run, wanted_s: Floats, visits: list[Reduced], band: Band) -> tuple[white_reference.Level, float, float]:
    """The signal per unit BRDF at some times; the reference's BRDF [1/sr], and its relative standard uncertainty.

    Errors are those of `reduce_in_parts`.
    """
    description, reference = run.description, run.description.reference
    if not visits:
        raise DataError(
            f"{run.path}: no usable measurement of the white reference in band {band.name}; see its frames: where they "
            "are full, dim the lamp, or lower acquisition.exposure_target and calibrate the camera"
        )
    rates, (albedo, u_rel) = np.array([visit.rate for visit in visits]), reference.at(band.centre_nm)
    if rates.min() <= 0:
        raise DataError(
            f"{run.path}: a measurement of the white reference in band {band.name} saw no light; see its frames"
        )
    if reference.how == "beam":
        known = np.ones(len(visits))
        variance = float(calibration_files.covariance_of(description, ["reference.attenuation"])[0, 0])
        u_rel = math.hypot(u_rel, math.sqrt(variance) / (reference.attenuation or 1.0))
    elif reference.table is not None:
        table = reference_table.read(reference.table)
        known = np.array([brdf_of_reference(table, visit.directions, band.centre_nm) for visit in visits])
        u_rel = math.hypot(u_rel, u_of_reference(table, visits[0].directions, band.centre_nm) / float(known[0]))
    elif albedo:
        known = np.full(len(visits), albedo / math.pi)
    else:
        raise ConfigError(
            f"{run.path / 'run.toml'}: the rig has neither reference.albedo (above 0) nor reference.table: "
            "nothing says how bright the white reference is"
        )
    known = known * polarised.of_white(band.polarisation)
    encoder = encoder_steps(description)
    landing = sum(change_of_cosine(description, visits[0], axis, u) ** 2 for axis, u in encoder.items())
    variances = np.array([visit.variance for visit in visits]) + landing * rates**2
    times = np.array([visit.time_s for visit in visits])
    fitted = white_reference.fit(times, rates / known, variances / known**2, wanted_s, run.lit_anew_s)
    return fitted, float(known.mean()), u_rel


def _responsivities(measured: MeasuredBand) -> tuple[Floats, Floats]:
    """What the pixels' responsivities do to each value, relative: standard deviation, and by `Reduced.by_pixels`.

    Those that point and reference both use cancel in part.
    """
    frames, points = measured.frames, measured.points
    n, shared = np.array([(point.pixels, point.shared) for point in points], dtype=float).reshape(-1, 2).T
    m = frames.reference[measured.band.channel].count
    by_pixels = np.array([point.by_pixels for point in points]).reshape(-1, 1 + PATTERNS)
    return frames.prnu * np.sqrt(np.maximum(1.0 / n + 1.0 / m - 2.0 * shared / (n * m), 0.0)), frames.prnu * by_pixels


def _left(u: Floats, columns: Floats) -> Floats:
    """What columns leave of a standard uncertainty."""
    return np.asarray(np.sqrt(np.maximum(u**2 - np.sum(columns**2, axis=1), 0.0)))
