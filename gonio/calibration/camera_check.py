"""A quick look at a camera before something else is calibrated with it: gain, black level, and where charge clips.

Pairs of frames of whatever is lit, at ten exposures, make a photon transfer of some per cent. That is enough to tell a
rig file of another camera, or of another setting of its gain. `gonio calibrate camera` measures.
"""

import math

import numpy as np

from gonio.acquisition import exposure
from gonio.by_hand.alignment_scans import LONGEST_S
from gonio.by_hand.manual_rig import ManualRig
from gonio.calibration import photon_transfer
from gonio.errors import DataError
from gonio.rig import Frame
from gonio.rig.calibrated import covariance_of
from gonio.rig.light_and_camera import Camera
from gonio.typing import Bools, Floats

LIGHT_DEG, CAMERA_DEG = 30.0, 0.0
"""Where a mirror in the holder shows no lamp, and the holder around it is lit."""
LEVEL = 0.7
EXPOSURES = 10
LEAST_DN = 100.0
"""Of the brightest hundredth over the black level, below which nothing is concluded."""
PART = 0.2
"""Of the brightness of the brightest hundredth: pixels that are darker say little of the gain."""
NONLINEAR = 0.03
"""Relative: what a departure from linearity, which nobody has taken out yet, does to a gain."""
BLACK_DN = 2.0
DOUBT = 3.0
"""Standard uncertainties."""


def contradictions(manual: ManualRig) -> str:
    """What the frames of a rig say against its rig file's camera; "" where they say nothing.

    The rig is open, and a mirror lies in its holder. The lamp is lit afterwards.
    """
    description, camera = manual.description, manual.description.camera
    if not camera.photon_noise or camera.response:
        return ""
    shortest, longest = camera.exposure_limits_s
    limits = manual.description.limits_deg()
    goals = {"light": LIGHT_DEG, "camera": CAMERA_DEG}
    manual.move(**{n: math.radians(float(np.clip(a, *limits[n]))) for n, a in goals.items()})
    manual.lamp(True)
    t = min(max(LONGEST_S, shortest), longest)
    frame = manual.camera.capture(t)
    while (level := _level(camera, frame)) > LEVEL and t > shortest:
        t = max(round(t * min(LEVEL / level, 0.9) if level < exposure.SATURATED else t / 4.0, 6), shortest)
        frame = manual.camera.capture(t)
    full = exposure.full_scale_dn(camera, frame)
    bright = np.asarray(frame.mosaic, float) - frame.black_level_dn
    if level * full < LEAST_DN or level >= exposure.SATURATED:
        return ""
    region = (bright > PART * level * full) & (bright < 0.9 * full)
    times = [max(round(t * (k + 1) / EXPOSURES, 6), shortest) for k in range(EXPOSURES)]
    lit = [(s, _values(manual.camera.capture(s), region), _values(manual.camera.capture(s), region)) for s in times]
    over = manual.camera.capture(round(min(4.0 * t, longest), 6))
    clips = exposure.clipped_dn(camera, over)
    manual.lamp(False)
    dark = [(s, _values(manual.camera.capture(s), region), _values(manual.camera.capture(s), region))
            for s in (shortest, shortest, t, t)]  # fmt: skip
    manual.lamp(True)
    said = []
    levels = [float(np.mean([a.mean(), b.mean()])) for _, a, b in dark]
    black = 0.5 * (levels[0] + levels[1])
    slope = (0.5 * (levels[2] + levels[3]) - black) / (t - shortest) if t > shortest else 0.0
    if abs(black - camera.black_level_dn) > BLACK_DN:
        said.append(f"dark frames read {black:.1f} DN (camera.black_level_dn = {camera.black_level_dn:g})")
    try:
        found = photon_transfer.photon_transfer(
            [photon_transfer.pair(*_alike(a, b, black), s) for s, a, b in lit],
            [photon_transfer.pair(a, b, s) for s, a, b in dark],
            (black, slope), camera.model_copy(update={"nonlinearity": ()}),
        )  # fmt: skip
    except DataError:
        found = None
    if found is not None:
        gain, stated = found.electrons_per_dn, camera.electrons_per_dn
        known = float(covariance_of(description, ["camera.electrons_per_dn"])[0, 0])
        u = math.sqrt(found.u_electrons_per_dn**2 + known)
        if abs(gain - stated) > math.hypot(DOUBT * u, NONLINEAR * gain):
            said.append(f"a DN is {gain:.3g} electrons, u = {u:.2g} (camera.electrons_per_dn = {stated:g})")
    expected = min(over.white_level_dn, over.black_level_dn + camera.full_well_e / camera.electrons_per_dn)
    if clips < exposure.SATURATED * expected:
        said.append(f"charge clips at {clips:.0f} DN (where the rig file leads to expect {expected:.0f})")
    if not said:
        return ""
    return (
        f"a quick look at the camera contradicts the rig file: {'; '.join(said)}. Zeros do not rest on it, and what is "
        "reduced does: `gonio calibrate camera` next, and name its file in the rig file"
    )


def _level(camera: Camera, frame: Frame) -> float:
    bright = float(np.percentile(frame.mosaic, 99.0)) - frame.black_level_dn
    return bright / exposure.full_scale_dn(camera, frame)


def _values(frame: Frame, region: Bools) -> Floats:
    return np.asarray(frame.mosaic[region], float)


def _alike(a: Floats, b: Floats, black: float) -> tuple[Floats, Floats]:
    """Two frames with what the lamp's level changed between them taken out."""
    first, second = float(a.mean()) - black, float(b.mean()) - black
    middle = 0.5 * (first + second)
    return black + (a - black) * (middle / first), black + (b - black) * (middle / second)
