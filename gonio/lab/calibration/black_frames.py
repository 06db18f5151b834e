"""Stray light from frames in which something is black: a trap in the holder, a knife edge before the white reference.

What a black part reads above the dark frames was spread there by lens and sensor. It is fitted with an even share of
the frame's mean, and with a Gaussian halo around bright parts where an edge shows one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gonio.lab.reduction.stray_light import spread
from gonio.lab.rig.imaging import Channel, of_channel
from gonio.lab.rig.light_and_camera import Camera
from gonio.typing import Floats

SIGNIFICANT = 5.0
"""Standard deviations from which a halo is one."""
ROUNDS = 6
SMALLEST_PX = 6.0
BINNED = 3e-3
"""Relative standard uncertainty of the fractions: a halo is computed in bins of a quarter of its width."""


@dataclass(frozen=True, slots=True)
class BlackFrame:
    """A mean frame, with its dark signal taken out, and where it sees nothing but black. Defects are NaN."""

    signal_dn: Floats
    black: tuple[slice, slice]
    variance_dn2: float
    """Temporal, of a pixel of the mean frame in the black part."""


@dataclass(frozen=True, slots=True)
class StrayLight:
    """Fractions of `camera.stray_light`, `camera.stray_halo`, and the halo's standard deviation [pixels]."""

    uniform: float
    halo: float
    halo_px: float
    covariance: Floats
    """Of the two fractions."""
    chi_square: float
    """Reduced, of the black pixels; uncertainties are scaled by it where it is above 1."""


def fit(frames: Sequence[BlackFrame], camera: Camera, channel: Channel = "mono") -> StrayLight:
    """The even share, and the halo where one shows."""
    even, _ = _with_halo(frames, camera, channel, None)
    radii = np.geomspace(SMALLEST_PX, max(0.7 * max(camera.width, camera.height), 2 * SMALLEST_PX), 12)
    found = [_with_halo(frames, camera, channel, float(radius)) for radius in radii]
    best = int(np.argmin([chi for _, chi in found]))
    if 0 < best < len(radii) - 1:
        from scipy.optimize import minimize_scalar

        inner = minimize_scalar(
            lambda log: _with_halo(frames, camera, channel, math.exp(log))[1],
            bounds=(math.log(radii[best - 1]), math.log(radii[best + 1])), method="bounded", options={"xatol": 0.01},
        )  # fmt: skip
        one, _ = _with_halo(frames, camera, channel, math.exp(float(inner.x)))
    else:
        one = found[best][0]
    significant = one.halo > SIGNIFICANT * math.sqrt(max(one.covariance[1, 1], 1e-30))
    # a halo as wide as the frame is an even share
    found_halo = significant and 0 < best < len(radii) - 1
    out = replace(one, covariance=_covariance(frames, camera, channel, one)) if found_halo else even
    fractions = np.array([out.uniform, out.halo])
    return replace(out, covariance=out.covariance + np.diag((BINNED * fractions) ** 2))


def _covariance(frames: Sequence[BlackFrame], camera: Camera, channel: Channel, found: StrayLight) -> Floats:
    """Covariance of the two fractions, with the radius as a third unknown."""
    normal = np.zeros((3, 3))
    for frame in frames:
        rows, cols = frame.black
        here = of_channel(camera.pattern, channel, rows, cols) & np.isfinite(frame.signal_dn[rows, cols])
        i, j = np.nonzero(here)
        added = []
        for factor in (0.98, 1.0, 1.02):
            known = camera.model_copy(
                update={
                    "stray_light": max(found.uniform, 0.0),
                    "stray_halo": found.halo,
                    "stray_halo_px": factor * found.halo_px,
                }
            )
            by = spread(known, np.nan_to_num(frame.signal_dn), 0.0, channel).at(i + rows.start, j + cols.start)[1]
            added.append(by)
        design = np.vstack([added[1], found.halo * (added[2][1] - added[0][1]) / 0.04])
        normal += design @ design.T / frame.variance_dn2
    return np.asarray(np.linalg.inv(normal)[:2, :2] * max(found.chi_square, 1.0))


def _with_halo(
    frames: Sequence[BlackFrame], camera: Camera, channel: Channel, radius: float | None
) -> tuple[StrayLight, float]:
    """The fractions for one radius, and chi-square."""
    fractions = np.zeros(2)
    count = 1 if radius is None else 2
    for _ in range(ROUNDS):
        normal, right, squares, pixels = np.zeros((count, count)), np.zeros(count), 0.0, 0
        known = camera.model_copy(
            update={
                "stray_light": min(max(fractions[0], 0.0), 0.4),
                "stray_halo": 0.0 if radius is None else min(max(fractions[1], 1e-9), 0.4),
                "stray_halo_px": radius or camera.stray_halo_px,
            }
        )
        for frame in frames:
            rows, cols = frame.black
            scene = np.nan_to_num(frame.signal_dn)
            here = of_channel(camera.pattern, channel, rows, cols) & np.isfinite(frame.signal_dn[rows, cols])
            i, j = np.nonzero(here)
            y = frame.signal_dn[rows, cols][here]
            by = spread(known, scene, 0.0, channel).at(i + rows.start, j + cols.start)[1][:count]
            normal += by @ by.T / frame.variance_dn2
            right += by @ y / frame.variance_dn2
            squares += float(y @ y) / frame.variance_dn2
            pixels += y.size
        solution = np.linalg.lstsq(normal, right, rcond=None)[0]
        before, fractions = fractions, np.zeros(2)
        fractions[:count] = solution
        if np.max(np.abs(fractions - before)) < 1e-8:
            break
    chi = squares - float(solution @ right)
    reduced = chi / max(pixels - count, 1)
    covariance = np.zeros((2, 2))
    covariance[:count, :count] = np.linalg.pinv(normal) * max(reduced, 1.0)
    out = StrayLight(float(fractions[0]), float(fractions[1]), radius or camera.stray_halo_px, covariance, reduced)
    return out, chi
