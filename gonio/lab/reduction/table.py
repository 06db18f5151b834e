"""The measurement table of a run's reduced bands, and the notes that a reader of it needs.

Also here is the uncertainty of each value in its parts, and what no part of it holds (docs/budget.md).

What is known of a cause's shape: a column says that errors of two values go together as its numbers do. Where only a
bound is known, that would be more than is known: such a cause is spread over several columns, and the rest goes into
`u_random`.

- `s_reference`, `s_reference_noise`: one factor of all values of a band. The certificate's error is taken for the same
  in all bands, and so is the visits' noise, which is not.
- `s_lamp_drift`: a line in time, exact. `s_lamp_wander_1` ...: a random function of time, known by its covariance;
  four columns and `visits`.
- `s_dark_1` ...: from the regions of pixels; three columns and `dark`. `s_prnu_1` ...: from the pixels that regions
  share with each other and with the reference's; three columns and `prnu`, taken for the same in all bands of a
  channel.
- `s_..._zero`, `s_geometry_1` ...: the values' own slopes; how uncertain these are is `coarse_steps`.
- `s_linearity`, `s_stray_light`: derivatives of the calibration's model at each value, exact if the model is (a
  polynomial; an even part and a halo).
- `s_black`: what is missing of signals well above the noise that is cut off at black; smaller ones lack less.
- `s_beam`: moments of each region; the strongest pattern is the column, the rest is `beam`.
- `s_polarisation_1` ...: a bound whose shape is not known: a random function of the directions; twelve columns and
  `polarisation`.
- `s_wavelength`, `s_bandwidth`: slopes and curvatures over the run's own bands. Errors of two bands are taken for the
  same one.
- `coarse_steps`, a bounded `spike_blur`: a bound, independent from value to value.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import gonio
from gonio.checks.values import CLIPPED, values_of
from gonio.checks.verdicts import Check, FramesTaken, VisitsOfBand, of_run, of_values
from gonio.geometry import ANGLES_DEG, SAME_AZIMUTH, Directions, half_angle_of_cone, solid_angle_of_cone
from gonio.lab.acquisition.resuming import unfinished
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import light_and_lens, polarised, reference_table, white_reference
from gonio.lab.reduction.angle_errors import CAUSES, angle_axes, encoder_steps, zero_uncertainties
from gonio.lab.reduction.count_rates import FULL, RETAKE, RunFrames
from gonio.lab.reduction.dark_signal import COLUMNS
from gonio.lab.reduction.values import BandResult
from gonio.lab.rig import kinematics
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.regions import filling
from gonio.measurement import unpolarised
from gonio.polarisation import UNPOLARISED
from gonio.typing import Bools, DataFrame, Floats, NDArray

DAMAGED = "missing or damaged and are left out"
MIRROR = math.radians(0.1)
"""A nominal direction that is nearer to the mirror's is it: plans are rounded to hundredths of a degree [rad]."""
NAMED = 10
"""Damaged frames, or bands, that are named in a note, at most."""
NUMBERS = re.compile(r"\([-\d., ]+\)(, \([-\d., ]+\))*( deg( and \d+ more)?)?|-?\d[\d.]*(e[-+]\d+)?")
"""Numbers in a note, and lists of directions."""
COMMON = ("s_reference", "s_reference_noise", "s_lamp_drift")
LIGHT = ("s_beam", "s_wavelength", "s_bandwidth")
"""Causes that are there where the rig file or a calibration tells of them (`gonio.lab.reduction.light_and_lens`)."""
DARK = tuple(f"s_dark_{k + 1}" for k in range(COLUMNS))
PRNU = tuple(f"s_prnu_{k + 1}" for k in range(COLUMNS))
GEOMETRY = tuple(f"s_geometry_{k + 1}" for k in range(4))
LAMP = tuple(f"s_lamp_wander_{k + 1}" for k in range(4))
POLARISATION = tuple(f"s_polarisation_{k + 1}" for k in range(12))


def assemble(frames: RunFrames, results: list[BandResult]) -> DataFrame:
    """One row for every point of the plan and every band, and the attributes."""
    run, description, notes = frames.run, frames.description, notes_on_frames(frames)
    nominal, chosen = Directions.from_table(frames.plan), _angles_of_chosen(run)
    frame, flags = _rows(frames, results, of_angles=bool(chosen))
    behind = np.repeat(frames.plan["theta_r_deg"].to_numpy(dtype=float) > 90.0, len(results))
    if behind.any():
        frame.insert(len(ANGLES_DEG) + 2, "side", np.where(behind, "transmission", "reflection").astype(object))
        notes = [
            *notes,
            "transmission is measured against the white reference in reflection: its BTDF is that of the sample as it "
            "lies, seen from behind",
        ]
    lamp, camera = description.lamp, description.camera
    cones = (math.radians(lamp.half_angle_deg), math.radians(camera.lens_half_angle_deg))
    frame.attrs.update(
        quantity="brdf" if not behind.any() else "btdf" if behind.all() else "bsdf",
        source_solid_angle_sr=float(solid_angle_of_cone(cones[0])),
        receiver_solid_angle_sr=float(solid_angle_of_cone(cones[1])),
        bands=[result.band.model_dump() for result in results],
        polarisation=words[0] if len(words := list(dict.fromkeys(frame["polarisation"]))) == 1 else ", ".join(words),
        **({"polarisers": stated} if (stated := polarised.stated(description)) and words != [UNPOLARISED] else {}),
        source_file=str(run.path),
        sample=run.laboratory.get("sample", {}).get("name") or (run.sample.name if run.sample is not None else None),
        provenance={
            "reduced_by": f"gonio {gonio.__version__}",
            "rig": description.name,
            "simulated": run.sample is not None,
            "seed": run.seed,
            "reference": [_account(result) for result in results],
            "filling": filling(description),
            **chosen,
            **({"white": description.reference.name} if description.reference.name else {}),
            **({"laboratory": run.laboratory} if run.laboratory else {}),
            **({"calibrations": used} if (used := _calibrations(description)) else {}),
            **({"merge": [result.merged for result in results]} if description.acquisition.by_pixels else {}),
        },
        notes=[f"calibration {remark}; it was used all the same" for remark in description.calibration.remarks]
        + notes
        + (reference_table.notes(white) if (white := description.reference.table) else [])
        + _notes_on_zeros(description)
        + light_and_lens.notes(description, results)
        + said_once([(result.band.name, _notes(result, nominal[result.rows])) for result in results]),
    )
    frame.attrs["provenance"]["checks"] = [one.to_json() for one in _checks(frames, frame, results, flags)]
    return frame


def _rows(frames: RunFrames, results: list[BandResult], *, of_angles: bool) -> tuple[DataFrame, NDArray[np.object_]]:
    """Angles, numbers and flags of every point of the plan and every band; and the flags, shape (points, bands)."""
    import pandas as pd

    plan = frames.plan
    zeros = (CAUSES[axis] for axis in zero_uncertainties(frames.description))
    added = dict.fromkeys(name for result in results for name in result.values.common)
    causes = [
        name for name in (*COMMON, *DARK, *PRNU, *zeros, *GEOMETRY, *LAMP, *POLARISATION, *LIGHT) if name in added
    ]
    causes += [name for name in added if name not in causes]
    numbers = [*ANGLES_DEG, "brdf", "u_brdf", "u_random", *causes, *(["u_angles"] if of_angles else [])]
    values = np.full((len(numbers), len(plan), len(results)), math.nan)
    values[: len(ANGLES_DEG)] = plan[list(ANGLES_DEG)].to_numpy(dtype=float).T[..., None]
    flags = np.empty((len(plan), len(results)), dtype=object)
    planned = plan["flag"].tolist()
    for k, result in enumerate(results):
        rows, columns = result.rows, result.values.columns()
        angles = angles_deg([point.directions for point in result.measured.points])
        columns |= dict(zip(ANGLES_DEG, angles, strict=True))
        measured = set(rows.tolist())
        flags[:, k] = [
            flag or result.flags.get(point, "") or ("" if point in measured else "not_measured")
            for point, flag in enumerate(planned)
        ]
        good = np.array([not flags[point, k] for point in rows], dtype=bool)
        if good.any():
            for column, name in zip(values, numbers, strict=True):
                column[rows[good], k] = columns[name][good]
    frame = pd.DataFrame(dict(zip(numbers, values.reshape(len(numbers), -1), strict=True)))
    frame.insert(len(ANGLES_DEG), "wavelength_nm", np.tile([result.band.centre_nm for result in results], len(plan)))
    words = np.array([result.band.polarisation for result in results], dtype=object)
    frame.insert(len(ANGLES_DEG) + 1, "polarisation", np.tile(words, len(plan)))
    frame["flag"] = pd.Series(flags.ravel().tolist(), dtype=str)
    return frame, flags


def _checks(frames: RunFrames, frame: DataFrame, results: list[BandResult], flags: NDArray[np.object_]) -> list[Check]:
    """What is judged of frames, visits, points and values."""
    reachable = [not flag for flag in frames.plan["flag"]]
    found = [
        one
        for k, result in enumerate(results)
        for one in _of_band(result, [f for f, use in zip(flags[:, k], reachable, strict=True) if use], frames.clipped)
    ]
    for nm, measured_values in values_of(unpolarised(frame).query(f"polarisation == '{UNPOLARISED}'")).items():
        band = next((result.band.alone.name for result in results if result.band.centre_nm == nm), "")
        found += [replace(one, band=band) for one in of_values(measured_values)]
    return found


def angles_deg(points: Sequence[Directions]) -> Floats:
    """The four angles [deg] of points as tables have them, shape (4, points)."""
    d = Directions.stack(points)
    theta = np.degrees([d.theta_i, d.theta_r]).round(9)
    theta = np.minimum(theta, [np.full(len(d), 90.0), np.where(d.theta_r > 0.5 * math.pi, 180.0, 90.0)])
    phi = np.degrees([d.phi_i, d.phi_r]).round(9) % 360.0
    return np.array([theta[0], phi[0], theta[1], phi[1]])


def _angles_of_chosen(run: Run) -> dict[str, dict[str, float]]:
    """Of a run that chose its points: uncertainties of the arms' zeros, and of their readings [rad], by causes.

    Its points are too few and too irregular to tell all slopes: a fitted model tells what errors of the angles do.
    """
    if not run.batches or filling(run.description) == "under":
        return {}
    zeros = zero_uncertainties(run.description)
    names = {axis: CAUSES[axis].removeprefix("s_") for axis in ("light", "camera")}
    steps = encoder_steps(run.description)
    return {
        "zeros_rad": {name: zeros[axis] for axis, name in names.items() if zeros[axis] > 0.0},
        "readings_rad": {name: steps[axis] for axis, name in names.items() if axis in steps},
    }


def _of_band(result: BandResult, flags: list[str], clipped: float) -> list[Check]:
    """The checks of a band's frames, visits and points."""
    level = result.measured.fitted
    mean = float(np.mean(level.values))
    visits = VisitsOfBand(
        used=len(result.measured.visits),
        lost=result.unusable,
        unknown=level.unknown,
        straight=level.straight,
        chi_square=level.chi_square,
        drift_per_hour=level.slope / level.level * 3600.0,
        u_drift_per_hour=level.u_slope / level.level * 3600.0,
        peak_to_peak=float(np.ptp(level.values)) / mean,
    )
    taken = FramesTaken(result.frames, result.left_out, result.scatter, result.freedom, clipped, flags)
    return of_run(taken, visits, result.band.name)


def _calibrations(description: RigDescription) -> list[dict[str, str | None]]:
    """The calibration files whose values the run was measured and is reduced with."""
    return [
        {
            "kind": known.kind,
            "file": known.file,
            "sha256": known.sha256,
            "made": str(known.made),
            "valid_until": str(known.valid_until) if known.valid_until is not None else None,
        }
        for known in description.calibration.known
    ]


def _account(result: BandResult) -> dict[str, float | str | list[float] | None]:
    """What the visits to the reference said."""
    fitted = result.measured.fitted
    known = not fitted.unknown
    return {
        "band": result.band.name,
        "brdf": result.measured.reference_brdf,
        "u_brdf_rel": result.measured.u_reference,
        "visits": len(result.measured.visits),
        "level_e_per_s_sr": fitted.level,
        "u_level_rel": fitted.u_level / fitted.level,
        "drift_per_hour": fitted.slope / fitted.level * 3600.0 if known else None,
        "u_drift_per_hour": fitted.u_slope / fitted.level * 3600.0 if known else None,
        "chi_square": fitted.chi_square,
        "straight": fitted.straight,
        "times_s": fitted.times_s.tolist(),
        "signals": fitted.values.tolist(),
        "frame_scatter": result.scatter,
    }


def _notes_on_zeros(description: RigDescription) -> list[str]:
    return [
        f"the zero of the {kinematics.NAMES[name]} is not known (zero_offset_known = false): its error is not in u_brdf"
        for name, axis in angle_axes(description).items()
        if not axis.zero_offset_known
    ]


def notes_on_frames(frames: RunFrames) -> list[str]:
    """What is missing of a run, and what is wrong with its frames, and with its camera."""
    camera = frames.description.camera
    out = [left] if (left := unfinished(frames.run)) else []
    if wrong := frames.contradictory:
        more = f", and {len(wrong) - 1} more frames" if len(wrong) > 1 else ""
        out.append(
            f'{wrong[min(wrong)]}{more}: left out; points that lack one are flagged "contradictory". Make the rig file '
            "say what the camera does, or measure these points again"
        )
    if names := sorted(frames.damaged):
        out.append(
            f'{len(names)} frames are {DAMAGED} ({_first(names, "")}); points that lack one are flagged "damaged", and '
            + RETAKE
        )
    if names and frames.darks_taken > 1 and frames.darks_used == 1:
        out.append(
            "the dark frames of one exposure alone are left: the dark current is that of the rig file, and its "
            "uncertainty is not in u_brdf"
        )
    # all at 0 is a camera without noise; some at 0 is one whose noise is cut off there
    if CLIPPED < frames.clipped < 1.0:
        out.append(
            f"{100.0 * frames.clipped:.2g} % of the pixels of the dark frames read 0 DN: what lies below is cut off, "
            "and small values come out too low, by about s_black; raise the camera's black level"
        )
    if frames.full > FULL:
        out.append(
            f"up to {100.0 * frames.full:.2g} % of the pixels of a frame are full: the light that they spread over "
            "the frame is more than what was taken out (camera.stray_light)"
        )
    if camera.bits == 8 and not camera.response:
        out.append(
            "the camera has 8 bits and no camera.response: its values are taken for linear, which those of a video "
            "camera with a gamma are not; `gonio calibrate camera --response` measures the curve"
        )
    return out


def said_once(bands: list[tuple[str, list[str]]]) -> list[str]:
    """Notes of bands, each said once: with the names of all that say the same, else as the first has it.

    Notes are alike where they differ in numbers alone; their order is that of their first band.
    """
    kinds: dict[str, list[tuple[str, str]]] = {}
    for name, notes in bands:
        for text in notes:
            kinds.setdefault(NUMBERS.sub("#", text), []).append((name, text))
    out = []
    for alike in kinds.values():
        (first, text), *rest = alike
        if all(other == text for _, other in rest):
            out.append(f"{_first([name for name, _ in alike], ' bands')}: {text}")
        else:
            others = _first([name for name, _ in rest], " bands")
            out.append(f"{first}: {text}; the like, with numbers of its own, holds at {others}")
    return out


def _first(names: list[str], kind: str) -> str:
    """Some names, and how many more of their kind there are."""
    return ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more{kind}" if len(names) > NAMED else "")


def _beside(goals: Directions, unknown: Bools) -> str:
    """What to measure where nothing tells a spike: without the mirror directions that are measured already."""
    off = np.hypot(goals.theta_r * np.cos(goals.dphi) + goals.theta_i, goals.theta_r * np.sin(goals.dphi))
    there = goals.theta_i[off < MIRROR]
    known = all((abs(there - theta_i) < MIRROR).any() for theta_i in goals.theta_i[unknown])
    where = "points within 10 degrees on both sides of {} that the spike does not reach"
    if known:
        return "measure " + where.format("the mirror direction")
    return "measure the mirror direction too, and " + where.format("it")


def _notes(result: BandResult, goals: Directions) -> list[str]:
    """What a band has to say, without its name (`said_once`); `goals` are the points' nominal directions."""
    out = white_reference.notes(result.measured.fitted, len(result.measured.visits), result.unusable)
    values = result.values
    if values.bounded.any():
        out.append(
            f"nothing tells whether a specular spike stands at {_listed(goals[values.bounded])}: what "
            f"errors of the angles would do to one is in u_brdf, which is large; {_beside(goals, values.bounded)}"
        )
    if values.coarse.any():
        out.append(
            f"the points do not tell how steep the lobe is at {_listed(goals[values.coarse])}: u_brdf there rests on "
            "how steep lobes may be; measure more points there, in finer steps"
        )
    if result.merged.get("noise") == "poisson":
        out.append(
            "the noise of the camera is not known (camera.read_noise_e = 0, and no calibration of the "
            "camera): frames are weighted as photons alone would have it"
        )
    # three standard deviations of a reduced chi-square, and enough to matter: uncertainties 20 % too small
    if result.scatter > max(1.44, 1.0 + 3.0 * math.sqrt(2.0 / max(result.freedom, 1))):
        out.append(
            f"frames of one step scatter {math.sqrt(result.scatter):.1f} times as much as the rig file's noise "
            "says (see lamp.noise and the camera's noise there): u_random is "
            + ("made wider by it" if result.measured.description.camera.response else "too small")
        )
    return out


def _listed(points: Directions) -> str:
    """The first points of a list, for people, in degrees."""
    first = ", ".join(
        f"({', '.join(f'{math.degrees(a):g}' for a in (d.theta_i, d.theta_r, d.dphi))})" for d in points[:3]
    )
    return f"(theta_i, theta_r, dphi) = {first} deg" + (f" and {len(points) - 3} more" if len(points) > 3 else "")


COMPONENTS = (
    "noise", "dark", "prnu", "encoder", "zeros_even", "geometry", "beam", "spike_blur", "coarse_steps", "region",
    "visits",
)  # fmt: skip
"""The parts of `u_random`, standard uncertainties [1/sr]; their squares add up to its square."""
OPEN = {
    "stray_light": "stray light and inter-reflections were not measured (gonio calibrate camera)",
    "linearity": "the sensor's departure from a straight line was not measured (gonio calibrate camera)",
    "polarisation": "how far lamp and lens polarise was not measured (gonio calibrate light)",
    "wavelength": "the band's true centre and width were not measured (gonio calibrate light)",
    "geometry": "distances, and the axes' tilts and displacements, were not measured (gonio calibrate geometry)",
}
"""Causes that a run knows only where a calibration says so, by how the names of their columns begin after "s_"."""


WANDERS = 3
"""Visits to the white reference from which on they tell something of a lamp that wanders."""


def assemble_budget(table: DataFrame, bands: list[BandResult]) -> DataFrame:
    """The budget of every row of a table.

    Parameters
    ----------
    table
        Of the run (`gonio.lab.reduction.brdf.reduce`), in its own order: rows by point, and by band within a point.
    bands
        What it was made from.

    Returns
    -------
    pandas.DataFrame
        The angles, wavelength, `brdf` and `u_brdf` of the table; `COMPONENTS` and the table's `s_` columns, whose
        squares add up to `u_brdf` squared; `nu_eff`, effective degrees of freedom (inf where no part rests on a
        scatter); `coarse`, whether steps leave a slope open by more than the noise; `cone_difference`, how far the
        value (a mean over the cones of lamp and lens) may depart from that of a pair of directions, for information
        alone; and `flag`. All [1/sr], NaN in rows that have a flag.
    """
    import pandas as pd

    causes = [name for name in table.columns if name.startswith("s_")]
    kept = [*ANGLES_DEG, "wavelength_nm", *(["side"] if "side" in table.columns else []), "brdf", "u_brdf"]
    if (table["polarisation"] != UNPOLARISED).any():
        kept.insert(len(ANGLES_DEG) + 1, "polarisation")
    parts = list(dict.fromkeys([*COMPONENTS, *(name for band in bands for name in band.values.own)]))
    rows, numbers = len(table), [*parts, "nu_eff", "coarse", "cone_difference"]
    values = np.full((len(numbers), rows), math.nan)
    cones = [half_angle_of_cone(table.attrs[f"{name}_solid_angle_sr"]) for name in ("source", "receiver")]
    # each disc has the variance of a quarter of its squared radius in each direction
    variance = 0.25 * sum(float(cone) ** 2 for cone in cones)
    for k, band in enumerate(bands):
        at, of, measured = band.rows * len(bands) + k, band.values, band.measured
        if not at.size:
            continue
        none = np.zeros(at.size)
        of_scatter = of.own["visits"] if measured.fitted.scatter else none
        with np.errstate(divide="ignore", invalid="ignore"):
            freedom = np.where(
                of_scatter > 0, max(len(measured.visits) - 1, 1) * (of.u_brdf / of_scatter) ** 4, math.inf
            )
        of_cones = 0.5 * variance * of.lobes.curvature.sum(axis=1)
        values[:, at] = [*(of.own.get(name, none) for name in parts), freedom, of.coarse, of_cones]
    values[:, table["flag"].to_numpy() != ""] = math.nan
    found = dict(zip(numbers, values, strict=True))
    more = pd.DataFrame({name: found[name] for name in numbers[len(parts) :]})
    more["coarse"] = more["coarse"] > 0
    own = pd.DataFrame({name: found[name] for name in parts})
    out: DataFrame = pd.concat([table[kept], own, table[causes], more, table[["flag"]]], axis=1)
    out.attrs = {}
    return out


def left_out(description: RigDescription, table: DataFrame) -> list[dict[str, str]]:
    """Causes of uncertainty that are not in a table's budget, each with the reason; for provenance and reports."""
    out = [
        {"cause": name, "why": why}
        for name, why in OPEN.items()
        if not any(column.startswith(f"s_{name}") for column in table.columns)
    ]
    out += [
        {"cause": f"zero of the {kinematics.NAMES[name]}", "why": "zero_offset_known = false: nothing is known of it"}
        for name, axis in description.axes().items()
        if not axis.zero_offset_known
    ]
    if any(account["visits"] < WANDERS for account in table.attrs["provenance"]["reference"]):
        out.append({
            "cause": "lamp_wander",
            "why": f"fewer than {WANDERS} measurements of the white reference do not tell how steady the lamp is",
        })  # fmt: skip
    azimuth = np.radians(table["phi_i_deg"].to_numpy(dtype=float))
    turned = np.abs(np.sin(azimuth - azimuth[:1])) > math.sin(SAME_AZIMUTH)
    if "spin" in description.axes() and not turned.any():
        out.append({
            "cause": "direction",
            "why": "the sample was measured at one azimuth of incidence: whether it has a direction, and what an error "
            "of the spin does to its values then, is not known (measure it at three azimuths or more)",
        })  # fmt: skip
    out.append({
        "cause": "solid_angle",
        "why": "values are means over the cones of lamp and lens, and are stated as such; budget.csv has "
        "cone_difference, how far they may depart from the value of a pair of directions",
    })  # fmt: skip
    return out
