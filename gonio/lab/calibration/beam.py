"""Profile of the beam over the sample, from flats of a matt white at several angles (docs/calibration.md).

What the lens takes away stays with the pixel; the beam's profile stays with the sample, which the pixels see shorter
the more obliquely the camera looks. So flats at several camera angles tell the two apart:

    ln(signal / geometry) = level of the flat + ln(beam at x, y) + k2 r^2 + k4 r^4     r: of the pixel, 1 at the corner

The lens is taken for round. Across the plane of the arms all flats look alike, and only that tells lens and beam apart.

Also here is the lens's vignetting, from the beam's profile and the white reference seen from several directions.

Vignetting stays with the pixels, beam and reference stay with the sample. Seen more obliquely, the same spots fall on
other pixels. So ln(signal / known geometry) = level of the direction + ln(1 - v rho^4) + polynomial in x and y.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.lab.calibration.tables import read_numbers
from gonio.lab.rig import Pose, kinematics
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.imaging import Channel, of_channel, pixel_map
from gonio.lab.rig.light_and_camera import Beam
from gonio.typing import DataFrame, Figure, Floats

COLUMNS = (
    "flat",
    "block",
    "light_deg",
    "camera_deg",
    "x_mm",
    "y_mm",
    "radius",
    "geometry",
    "signal_dn_per_s",
    "u_signal_dn_per_s",
    "u_pixels",
)
"""`u_signal_dn_per_s` is noise; `u_pixels` what the responsivity of the block's pixels departs by, in every flat."""
BLOCKS = 24
"""Blocks of pixels along the longer side of the frame; each is one value."""
INSIDE = 0.9
"""Part of the white's radius whose spots count: its edge is not as white."""
ZERO_STEP_DEG = 0.1
"""Step of a numerical slope."""
FORESHORTENED = 1.3
"""Least ratio of the cosines of the steepest camera angle and of the most oblique one."""


@dataclass(frozen=True, slots=True)
class Profile:
    """What flats tell of the beam."""

    beam: Beam
    covariance: Floats
    """Of the five numbers of `beam`, in their order."""
    lens: tuple[float, float]
    """k2 and k4: what the lens takes beyond what the rig file says."""
    reduced_chi_square: float
    across_mm: float
    """Largest distance from the centre that a flat shows [mm]."""


def blocks(description: RigDescription, pose: Pose, mean: Floats, noise: Floats, number: int) -> DataFrame:
    """One flat as means over blocks of pixels that see the white.

    Parameters
    ----------
    description
        The rig.
    pose
        Where the axes stood.
    mean, noise
        Signal of every pixel [DN/s], dark subtracted, and its standard uncertainty.
    number
        Of the flat.
    """
    import pandas as pd

    camera = description.camera
    even = description.model_copy(update={"lamp": description.lamp.model_copy(update={"beam": None})})
    seen = pixel_map(even, kinematics.view(description, pose))
    x, y = seen.beam_xy_mm
    cx, cy = description.reference.offset_mm if description.reference.how == "beside" else (0.0, 0.0)
    reach = INSIDE * 0.5 * description.reference.diameter_mm
    white = (seen.x_mm - cx) ** 2 + (seen.y_mm - cy) ** 2 <= reach**2
    rows, cols = np.indices((camera.height, camera.width))
    half = 0.5 * np.hypot(camera.width, camera.height)
    radius = np.hypot(rows - 0.5 * (camera.height - 1), cols - 0.5 * (camera.width - 1)) / half
    side = max(2, -(-max(camera.width, camera.height) // BLOCKS))
    side += side % 2  # whole cells of a mosaic
    out = []
    degrees = {"light_deg": float(np.degrees(pose.light)), "camera_deg": float(np.degrees(pose.camera))}
    for top in range(0, camera.height - side + 1, side):
        for left in range(0, camera.width - side + 1, side):
            at = (slice(top, top + side), slice(left, left + side))
            if white[at].all():
                scatter = float(np.sqrt(np.mean(noise[at] ** 2))) / side
                out.append(
                    {"flat": number, "block": top * camera.width + left, **degrees,
                     "x_mm": float(x[at].mean()), "y_mm": float(y[at].mean()),
                     "radius": float(np.sqrt(np.mean(radius[at] ** 2))), "geometry": float(seen.weight[at].mean()),
                     "signal_dn_per_s": float(mean[at].mean()),
                     "u_signal_dn_per_s": scatter, "u_pixels": camera.prnu / side}
                )  # fmt: skip
    return pd.DataFrame(out, columns=list(COLUMNS))


def read_flats(path: str | Path) -> DataFrame:
    """Flats from a CSV with the columns of `COLUMNS`; raises `DataError` where it is damaged."""
    table = read_numbers(path, COLUMNS)
    for name in ("geometry", "signal_dn_per_s", "u_signal_dn_per_s"):
        if (table[name] <= 0).any():
            row = int(np.argmax(table[name] <= 0)) + 1
            raise DataError(f"{path}: row {row}: {name} = {table[name].iloc[row - 1]:g}: must be above 0")
    return table


def fit(table: DataFrame) -> Profile:
    """Fit beam and lens to flats.

    Raises
    ------
    DataError
        The flats do not tell the beam from the lens: they are too few, or were all taken at one camera angle.
    """
    x, y, r = (table[name].to_numpy() for name in ("x_mm", "y_mm", "radius"))
    flats = np.unique(table["flat"])
    target = np.log((table["signal_dn_per_s"] / table["geometry"]).to_numpy())
    levels = (table["flat"].to_numpy()[:, None] == flats).astype(float)
    if len(table) < levels.shape[1] + 14:
        raise DataError(
            f"the flats hold {len(table)} blocks of pixels that see the white: too few to tell a beam from a lens; is "
            "the white (reference.diameter_mm) in the frame"
        )
    design = np.column_stack([x, y, x * x, x * y, y * y, r**2, r**4, levels])
    scaled, target = _whitened(table, design, target)
    length = np.linalg.norm(scaled, axis=0)
    # flats at one camera angle show x^2 and y^2 in step with r^2
    cosines = np.cos(np.radians(table["camera_deg"].to_numpy()))
    if cosines.max() < FORESHORTENED * cosines.min():
        angles = np.unique(np.round(abs(table["camera_deg"]), 1))
        raise DataError(
            f"the flats do not tell the beam from the lens: they were taken at {len(angles)} angle(s) of the camera "
            "from the normal; take some near the normal, and some beyond 45 deg"
        )
    found, *_ = np.linalg.lstsq(scaled / length, target, rcond=None)
    covariance = np.linalg.inv((scaled / length).T @ (scaled / length)) / np.outer(length, length)
    reduced = float(np.sum((target - scaled @ (found / length)) ** 2)) / (len(table) - design.shape[1])
    parameters = (found / length).tolist()
    return Profile(
        beam=Beam(**dict(zip(Beam.model_fields, parameters[:5], strict=True))),
        covariance=covariance[:5, :5] * max(reduced, 1.0),
        lens=(parameters[5], parameters[6]),
        reduced_chi_square=reduced,
        across_mm=float(np.hypot(x, y).max()),
    )


def by_zero(description: RigDescription, table: DataFrame, found: Profile, axis: str) -> Floats:
    """How much each of the five numbers changes where the zero of an axis is larger by 1 deg.

    Light that falls obliquely is brighter on the nearer side of the white, as a tilted beam is.
    """
    width = description.camera.width
    moved = table.copy()
    for _, rows in table.groupby("flat").groups.items():
        first = table.loc[rows[0]]
        pose = Pose(light=float(np.radians(first["light_deg"])), camera=float(np.radians(first["camera_deg"])))
        other = replace(pose, **{axis: getattr(pose, axis) - float(np.radians(ZERO_STEP_DEG))})
        seen, then = (pixel_map(description, kinematics.view(description, p)) for p in (pose, other))
        block = table.loc[rows, "block"].to_numpy(int)
        at = block // width, block % width
        moved.loc[rows, "geometry"] *= (then.weight / seen.weight)[at]
        for k, name in enumerate(("x_mm", "y_mm")):
            moved.loc[rows, name] += (then.beam_xy_mm[k] - seen.beam_xy_mm[k])[at]
    return (np.array(fit(moved).beam.terms()) - found.beam.terms()) / ZERO_STEP_DEG


def _whitened(table: DataFrame, design: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Rows of independent unit variance: a block of pixels responds alike in every flat, whatever that is."""
    noise = (table["u_signal_dn_per_s"] / table["signal_dn_per_s"]).to_numpy()
    pixels, block = table["u_pixels"].to_numpy(), table["block"].to_numpy()
    both = np.column_stack([design, target])
    for one in np.unique(block):
        rows = np.flatnonzero(block == one)
        covariance = np.diag(noise[rows] ** 2) + np.outer(pixels[rows], pixels[rows])
        both[rows] = np.linalg.solve(np.linalg.cholesky(covariance), both[rows])
    return both[:, :-1], both[:, -1]


def camera_angles(description: RigDescription) -> list[tuple[float, float]]:
    """Angles [deg] of light and camera for flats: the light as at the reference, the camera from near it to oblique."""
    light = description.reference.theta_i_deg
    near = float(np.degrees(kinematics.blocked_cone(description))) + 2.0
    return [(light, light + sign * angle) for angle in (max(near, 12.0), 35.0, 50.0, 62.0) for sign in (1.0, -1.0)]


def draw(table: DataFrame, found: Profile) -> Figure:
    """The beam along x and along y, and the flats with lens and levels taken off."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    terms = found.beam.terms()
    x, y = table["x_mm"].to_numpy(), table["y_mm"].to_numpy()
    log = np.log((table["signal_dn_per_s"] / table["geometry"]).to_numpy())
    log -= found.lens[0] * table["radius"].to_numpy() ** 2 + found.lens[1] * table["radius"].to_numpy() ** 4
    model = terms[0] * x + terms[1] * y + terms[2] * x * x + terms[3] * x * y + terms[4] * y * y
    for number in np.unique(table["flat"]):
        of = (table["flat"] == number).to_numpy()
        log[of] -= np.mean(log[of] - model[of])
    for axes, along, other, name in zip(figure.subplots(1, 2), (x, y), (y, x), ("x", "y"), strict=True):
        near = abs(other) < 0.3 * abs(other).max()
        line = np.linspace(along.min(), along.max(), 100)
        first, second = (0, 2) if name == "x" else (1, 4)
        axes.plot(along[near], np.exp(log[near]), ".", ms=3, color="0.6", label="blocks of pixels")
        axes.plot(line, np.exp(terms[first] * line + terms[second] * line**2), color="tab:blue", label="beam")
        axes.set(xlabel=f"{name} on the plane that faces the lamp [mm]", ylabel="irradiance over that at the centre")
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    return figure


RIM = 0.9
"""Part of the reference's radius: what lies inside is used."""
MOST = 20_000
"""Pixels used of each direction."""
BEAM = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (4, 0), (2, 2), (0, 4))
"""Powers of x and y in the beam's profile."""


@dataclass(frozen=True, slots=True)
class Vignetting:
    """`camera.vignetting` and its standard uncertainty, and how far pixels lie from the fit (relative)."""

    value: float
    u: float
    residual: float


def fit_vignetting(
    pictures: Sequence[tuple[Floats, Pose]], description: RigDescription, channel: Channel = "mono"
) -> Vignetting:
    """From mean flats, with their dark signals taken out (NaN where a pixel is not to be used), and their poses.

    Raises
    ------
    DataError
        All are seen from one direction, from which vignetting and beam look alike; or the reference is not in view.
    """
    angles = {round(math.degrees(pose.camera), 1) for _, pose in pictures}
    if max(angles) - min(angles) < 10.0:
        raise DataError(
            "the frames of the field are seen from one direction, from which vignetting and the beam's profile "
            "look alike: "
            "take them from directions that are 10 degrees apart or more"
        )
    camera = description.camera
    plain = description.model_copy(update={"camera": camera.model_copy(update={"vignetting": 0.0})})
    reference = description.reference
    centre = reference.offset_mm if reference.how == "beside" else (0.0, 0.0)
    corner = 0.5 * math.hypot(camera.width, camera.height)
    rows, values = [], []
    for number, (signal, pose) in enumerate(pictures):
        seen = pixel_map(plain, kinematics.view(plain, pose))
        x, y = seen.x_mm - centre[0], seen.y_mm - centre[1]
        radius = 0.5 * reference.diameter_mm
        good = (x**2 + y**2 <= (RIM * radius) ** 2) & np.isfinite(signal) & (seen.weight > 0)
        good &= of_channel(camera.pattern, channel, seen.rows, seen.cols)
        if good.any():
            good &= np.nan_to_num(signal) > 0.2 * np.median(signal[good])
        at = np.flatnonzero(good)[:: max(np.count_nonzero(good) // MOST, 1)]
        if at.size < 100:
            raise DataError(
                "the frames of the field do not hold the white reference where the rig file says that it lies"
            )
        i, j = np.unravel_index(at, signal.shape)
        rho = np.hypot(i - 0.5 * (camera.height - 1), j - 0.5 * (camera.width - 1)) / corner
        u, v = x.ravel()[at] / radius, y.ravel()[at] / radius
        level = np.zeros((len(pictures), at.size))
        level[number] = 1.0
        rows.append(np.vstack([rho**4, level, [u**p * v**q for p, q in BEAM]]).T)
        values.append(np.log(signal.ravel()[at] / seen.weight.ravel()[at]))
    design, value, found = np.vstack(rows), np.concatenate(values), 0.0
    for _ in range(4):  # ln(1 - v rho^4) about the last v
        loss = 1.0 - found * design[:, 0]
        now = design.copy()
        now[:, 0] = -design[:, 0] / loss
        solution, *_ = np.linalg.lstsq(now, value - np.log(loss) + now[:, 0] * found, rcond=None)
        found = float(np.clip(solution[0], -0.5, 0.9))
    left = value - np.log(loss) + now[:, 0] * found - now @ solution
    residual = float(np.sqrt(np.sum(left**2) / max(left.size - solution.size, 1)))
    # pixels keep their responsivities from direction to direction: as many are independent as one picture has
    covariance = np.linalg.inv(now.T @ now) * residual**2 * len(pictures)
    return Vignetting(found, math.sqrt(float(covariance[0, 0])), residual)
