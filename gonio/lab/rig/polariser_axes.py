"""Where the axes of a rig's polarisers stand for a state of polarisation, and what that makes of lamp and lens.

A polariser turns with the arm that carries it. Its azimuth is counted from the axis that the arms turn about (before
the camera: from `image_y`), counterclockwise for who looks from the sample to the lamp, or to the camera, as that of
`gonio.lab.rig.light_and_camera.Polarisation`. The states s, p, d and a (docs/conventions.md) belong to the plane of a
ray and the sample's normal: out of the plane of the arms that is turned from pose to pose, and the axis with it.
"""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from gonio.errors import ConfigError
from gonio.geometry import angles
from gonio.lab.rig import kinematics
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.kinematics import View
from gonio.lab.rig.light_and_camera import Polarisation
from gonio.lab.rig.polarisers import SIDES, Side, letters
from gonio.lab.rig.protocols import PolariserDevice, Polarises, Pose, Rig
from gonio.polarisation import ray_axes
from gonio.typing import Floats

AXES = {"s": 0.0, "p": 0.5 * math.pi, "d": 0.25 * math.pi, "a": -0.25 * math.pi}
"""Azimuth of a linear state's axis [rad], from s toward p."""
TOWARD_P = {"light": -1.0, "receiver": 1.0}
"""The sense from s toward p over that of a polariser's azimuth."""


def azimuth(scene: View, side: Side, letter: str) -> float:
    """Azimuth of a polariser [rad], within half a turn, that has its axis where a linear state has it at a view."""
    place = scene.source_mm if side == "light" else scene.camera_mm
    theta, phi = angles(place)
    _, s, p = ray_axes(theta, phi, incident=side == "light")
    axis = math.cos(AXES[letter]) * s + math.sin(AXES[letter]) * p
    along, across = axes(scene, side)
    return _within_half_a_turn(math.atan2(float(axis @ across), float(axis @ along)))


def settings(description: RigDescription, scene: View, target: str, word: str) -> Iterator[tuple[Side, str, float]]:
    """What each polariser of a rig is set to for a state at a view: side, state, and azimuth [rad]."""
    there = standing(description, scene, target, word)
    for side, letter in zip(SIDES, letters(word), strict=True):
        mount = description.polarisers.on(side)
        if mount is not None and letter in AXES:
            yield side, "linear", _within_half_a_turn(there[side] - math.radians(mount.azimuth_deg))
        elif mount is not None:
            yield side, letter, 0.0


def standing(description: RigDescription, scene: View, target: str, word: str) -> dict[Side, float]:
    """Azimuths of the axes of the linear polarisers in the beam [rad], of a state at a view.

    Before the white reference, which depolarises, axes stand as for a sample in the plane of the arms.
    """
    linear = [(side, letter) for side, letter in zip(SIDES, letters(word), strict=True) if letter in AXES]
    if target == "reference":
        return {side: AXES[letter] * TOWARD_P[side] for side, letter in linear}
    return {side: azimuth(scene, side, letter) for side, letter in linear}


def _within_half_a_turn(azimuth: float) -> float:
    return azimuth - math.pi * round(azimuth / math.pi)


def own(description: RigDescription, side: Side) -> Polarisation:
    """How far the lamp, or the camera with its lens, polarises by itself."""
    return description.lamp.polarisation if side == "light" else description.camera.polarisation


def throughput(description: RigDescription, pose: Pose, target: str, word: str) -> float:
    """What passes in a state at a pose by what is known of lamp and lens, over its mean over azimuths."""
    out = 1.0
    if description.polarisers.sides():
        for side, turned in standing(description, kinematics.view(description, pose), target, word).items():
            of = own(description, side)
            if of.azimuth_deg is not None:
                out *= 1.0 + of.degree * math.cos(2.0 * (turned - math.radians(of.azimuth_deg)))
    return out


def opened(rig: Rig) -> Mapping[Side, PolariserDevice]:
    """The polarisers that the file of a rig names.

    Raises
    ------
    ConfigError
        The rig's program does not drive one of them.
    """
    found = rig.polarisers if isinstance(rig, Polarises) else {}
    for side in rig.description.polarisers.sides():
        if side not in found:
            raise ConfigError(
                f'[polarisers.{side}]: the program of the rig "{rig.description.name}" drives no polariser there; '
                "leave the table out of the rig file"
            )
    return found


def on_rays(scene: View, side: Side, stokes: Floats, theta: Floats, phi: Floats) -> Floats:
    """A Stokes vector (4,) on the axes of a polariser as (n, 4) on the axes s and p of some directions (n,) [rad]."""
    _, s, p = ray_axes(theta, phi, incident=side == "light")
    first, _ = axes(scene, side)
    turn = 2.0 * np.arctan2(p @ first, s @ first)  # of azimuth 0, from s toward p
    i, q, u, v = stokes
    u = u * TOWARD_P[side]
    cos, sin, one = np.cos(turn), np.sin(turn), np.ones(turn.shape)
    return np.stack([i * one, q * cos - u * sin, q * sin + u * cos, v * one], axis=-1)


def linear(degree: float, azimuth: float) -> Floats:
    """The Stokes vector of partly polarised light, on the axes of a polariser; `azimuth` [rad]."""
    return np.array([1.0, degree * math.cos(2.0 * azimuth), degree * math.sin(2.0 * azimuth), 0.0])


def axes(scene: View, side: Side) -> tuple[Floats, Floats]:
    """The directions of azimuth 0 and 90 degrees of a polariser, as unit vectors of the sample's frame."""
    place = scene.source_mm if side == "light" else scene.camera_mm
    y = scene.image_y if side == "receiver" or scene.beam_y is None else scene.beam_y
    toward = place / np.linalg.norm(place)
    y = y - (y @ toward) * toward
    y = y / np.linalg.norm(y)
    return y, np.cross(y, toward)
