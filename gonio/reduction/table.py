"""The measurement table of a run's reduced bands, and the notes that a reader of it needs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

import gonio
from gonio import geometry
from gonio.acquisition.plan import ANGLES
from gonio.geometry import Directions
from gonio.reduction import white_reference
from gonio.reduction.count_rates import RETAKE, RunFrames
from gonio.reduction.dark_signal import COLUMNS
from gonio.reduction.geometry_errors import zero_u_deg
from gonio.rig import kinematics
from gonio.rig.description import Axis, Band, RigDescription
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
GEOMETRY = tuple(f"s_geometry_{k + 1}" for k in range(4))
CAUSES = {"light": "s_theta_i_zero", "camera": "s_theta_r_zero", "tilt": "s_tilt_zero", "azimuth": "s_azimuth_zero"}
"""Axes whose zeros are common causes. A spin turns both directions alike: an isotropic surface does not notice it."""


@dataclass(frozen=True, slots=True)
class BandResult:
    """One band of a run: its rows by point, why others have none, and what the attributes say of it."""

    band: Band
    points: npt.NDArray[np.intp]
    """Those that have a value."""
    columns: dict[str, Floats]
    """Of the table, a number for each of them."""
    darks: Floats
    """Change of each value [1/sr] by the noise of the dark frames, see `Reduced.dark`; shape (points, 2, n)."""
    geometry: Floats
    """Change of each value [1/sr] by the causes of `GeometryErrors`, shape (points, causes)."""
    flags: dict[int, str]
    level: white_reference.Level
    reference_brdf: float
    visits: int
    unusable: list[str]
    """The flags of the other visits."""
    scatter: float
    """Reduced chi-square of the frames around the means of their steps."""
    freedom: int
    untold: Directions
    """Nominal directions of points that may see a spike of which only a bound is known."""
    coarse: Directions
    """Nominal directions of points beside a lobe that is narrower than the plan's steps."""


def angle_axes(description: RigDescription) -> dict[str, Axis]:
    """The axes whose angles a value depends on."""
    return {name: axis for name, axis in description.axes().items() if name in CAUSES}


def zero_uncertainties(description: RigDescription) -> dict[str, float]:
    """Standard uncertainty [rad] of each zero; both arms are always there, so that tables have the same columns.

    0 where the zero is one of the numbers that `s_geometry_1` and its neighbours hold.
    """
    axes = {name: math.radians(u) for name, u in zero_u_deg(description, angle_axes(description)).items()}
    return {name: u for name, u in axes.items() if u > 0 or name in ("light", "camera")}


def assemble(run: Run, results: list[BandResult], notes: list[str]) -> pd.DataFrame:
    """One row for every point of the plan and every band, and the attributes."""
    import pandas as pd

    description, plan = run.description, run.plan
    causes = [*COMMON, *DARK, *(CAUSES[axis] for axis in zero_uncertainties(description))]
    causes += GEOMETRY[: results[0].geometry.shape[1]]
    numbers = [*ANGLES, "brdf", "u_brdf", "u_random", *causes]
    values = np.full((len(numbers), len(plan), len(results)), math.nan)
    values[: len(ANGLES)] = plan[list(ANGLES)].to_numpy(dtype=float).T[..., None]
    flags = np.empty((len(plan), len(results)), dtype=object)
    planned = plan["flag"].tolist()
    for k, result in enumerate(results):
        measured = set(result.points.tolist())
        flags[:, k] = [
            flag or result.flags.get(point, "") or ("" if point in measured else "not_measured")
            for point, flag in enumerate(planned)
        ]
        good = np.array([not flags[point, k] for point in result.points], dtype=bool)
        if good.any():
            for column, name in zip(values, numbers, strict=True):
                column[result.points[good], k] = result.columns[name][good]
    frame = pd.DataFrame(dict(zip(numbers, values.reshape(len(numbers), -1), strict=True)))
    frame.insert(len(ANGLES), "wavelength_nm", np.tile([result.band.centre_nm for result in results], len(plan)))
    frame.insert(len(ANGLES) + 1, "polarisation", "unpolarised")
    behind = np.repeat(plan["theta_r_deg"].to_numpy(dtype=float) > 90.0, len(results))
    if behind.any():
        frame.insert(len(ANGLES) + 2, "side", np.where(behind, "transmission", "reflection").astype(object))
        notes = [
            *notes,
            "transmission is measured against the white reference in reflection: its BTDF is that of the sample as it "
            "lies, seen from behind",
        ]
    frame["flag"] = pd.Series(flags.ravel().tolist(), dtype=str)
    lamp, camera = description.lamp, description.camera
    cones = (math.radians(lamp.half_angle_deg), math.radians(camera.lens_half_angle_deg))
    frame.attrs.update(
        quantity="brdf" if not behind.any() else "btdf" if behind.all() else "bsdf",
        source_solid_angle_sr=float(geometry.solid_angle_of_cone(cones[0])),
        receiver_solid_angle_sr=float(geometry.solid_angle_of_cone(cones[1])),
        bands=[result.band.model_dump() for result in results],
        polarisation="unpolarised",
        source_file=str(run.path),
        sample=run.sample.name if run.sample is not None else None,
        provenance={
            "reduced_by": f"gonio {gonio.__version__}",
            "rig": description.name,
            "simulated": run.sample is not None,
            "seed": run.seed,
            "reference": [_account(result) for result in results],
        },
        notes=notes + _notes_on_zeros(description) + [note for result in results for note in _notes(result)],
    )
    return frame


def _account(result: BandResult) -> dict[str, float | str | None]:
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
        for name, axis in angle_axes(description).items()
        if not axis.zero_offset_known
    ]


def notes_on_damage(frames: RunFrames) -> list[str]:
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


def notes_on_darks(frames: RunFrames) -> list[str]:
    # all at 0 is a camera without noise; some at 0 is one whose noise is cut off there
    if not CLIPPED < frames.clipped < 1.0:
        return []
    return [
        f"{100.0 * frames.clipped:.2g} % of the pixels of the dark frames read 0 DN: what lies below is cut off, and "
        "values are too low by more than u_brdf says where the signal is small; raise the camera's black level"
    ]


def _notes(result: BandResult) -> list[str]:
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
            f"{name}: values change much from step to step at {_listed(result.coarse)}: u_brdf there rests on "
            "what neighbouring points leave open, and may be too small; measure in finer steps there"
        )
    # three standard deviations of a reduced chi-square, and enough to matter: uncertainties 20 % too small
    if result.scatter > max(1.44, 1.0 + 3.0 * math.sqrt(2.0 / max(result.freedom, 1))):
        out.append(
            f"{name}: frames of one step scatter {math.sqrt(result.scatter):.1f} times as much as the rig file's noise "
            "says (see lamp.noise and the camera's noise there): u_random is too small"
        )
    return out


def _listed(points: Directions) -> str:
    """The first points of a list, for people, in degrees."""
    first = ", ".join(
        f"({', '.join(f'{math.degrees(a):g}' for a in (d.theta_i, d.theta_r, d.dphi))})" for d in points[:3]
    )
    return f"(theta_i, theta_r, dphi) = {first} deg" + (f" and {len(points) - 3} more" if len(points) > 3 else "")
