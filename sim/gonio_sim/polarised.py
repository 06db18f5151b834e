"""What polarisation changes of the light: of lamp and lens, and of the polarisers before them.

A lamp of degree P has the Stokes vector (1, P cos 2a, P sin 2a, 0), a camera the row (1, p cos 2b, p sin 2b, 0), on the
axes of `gonio.lab.rig.polariser_axes`. A polariser in between multiplies with its Mueller matrix. What enters the scene
is (I, ...) and what leaves it is weighed by (A, ...): a depolarising surface shows I A of its light, any other
row . matrix . vector, its matrix being that of `gonio.models.polarised`.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gonio.geometry import Directions
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.kinematics import View
from gonio.lab.rig.polariser_axes import axes, linear, on_rays
from gonio.lab.rig.polarisers import SIDES, PolariserMount, Side
from gonio.models import Model, SpectralModel
from gonio.models.polarised import Light
from gonio.typing import Floats


@dataclass(frozen=True)
class Ends:
    """The light before the sample, and what the camera takes of that behind it, as Stokes vectors (4,) on the axes of a
    polariser: azimuth 0 and 90 degrees.
    """

    light: Floats
    receiver: Floats

    @property
    def plain(self) -> bool:
        """Whether nothing is polarised at all."""
        return not (self.light[1:].any() or self.receiver[1:].any())

    @property
    def passed(self) -> float:
        """What is seen of a surface that depolarises, of what is seen without polarisers."""
        return float(self.light[0] * self.receiver[0])

    def at(self, scene: View, at: Directions) -> Light:
        """The same on the axes s and p of some directions (n,)."""
        light, receiver = self.light / self.light[0], self.receiver / self.receiver[0]
        return Light(
            at,
            on_rays(scene, "light", light, at.theta_i, at.phi_i),
            on_rays(scene, "receiver", receiver, at.theta_r, at.phi_r),
        )


NO_ERRORS = (0.0, 0.0, 0.0, 0.0)
OUT = {side: ("u", 0.0) for side in SIDES}
"""Polarisers that are out of the beam: state and azimuth [rad]."""


def ends(
    truth: RigDescription,
    standing: Mapping[Side, tuple[str, float]] = OUT,
    errors: Mapping[Side, tuple[float, float, float, float]] | None = None,
) -> Ends:
    """Those of a rig, by how its polarisers stand.

    `errors` are what nobody knows of each: of its extinction and its azimuth [rad], and how what passes follows cosine
    and sine of twice the azimuth.
    """
    found = []
    for side, of in zip(SIDES, (truth.lamp.polarisation, truth.camera.polarisation), strict=True):
        vector = linear(of.degree, math.radians(of.azimuth_deg or 0.0))
        mount, (state, azimuth) = truth.polarisers.on(side), standing[side]
        if mount is not None and state != "u":
            vector = _through(mount, state, azimuth, vector, errors[side] if errors else NO_ERRORS)
        found.append(vector)
    return Ends(*found)


def _through(
    mount: PolariserMount, state: str, azimuth: float, vector: Floats, drawn: tuple[float, float, float, float]
) -> Floats:
    """A vector, or a row, beyond a polariser: it has the faults of the rig file, and others."""
    extinction = abs(mount.extinction + drawn[0])
    turned = azimuth + math.radians(mount.azimuth_deg) + drawn[1]
    share = (1.0 - extinction) / (1.0 + extinction)
    axis = linear(1.0, turned)
    uneven = 1.0 + drawn[2] * axis[1] + drawn[3] * axis[2]
    passed = 0.5 * mount.transmittance * (1.0 + extinction) * uneven * (1.0 + share * float(axis[1:] @ vector[1:]))
    if state in "rl":
        return np.asarray(passed * np.array([1.0, 0.0, 0.0, share if state == "r" else -share]))
    return np.asarray(passed * np.array([1.0, share * axis[1], share * axis[2], 0.0]))


def of_lobe(of: Ends, model: Model, lobe: Callable[[Model], Floats], scene: View, at: Directions, nm: float) -> Floats:
    """What is seen of a model's lobe [1/sr], (n,), over `Ends.passed`; `lobe` gives that of a model in plain light."""
    return model.in_light(of.at(scene, at), lobe, nm)


def of_spike(of: Ends, model: Model, scene: View, at: Directions, nm: float) -> Floats:
    """Factor on the specular spike, which reflects as one facet, over `Ends.passed`."""
    light = of.at(scene, at)
    model = model.plain(nm) if isinstance(model, SpectralModel) else model
    if (jones := model.jones_at(at, nm)) is not None:
        return light.of_jones(jones)
    facets = model.facets(nm)
    return light.of_facets(facets.index) if facets is not None else light.depolarised


def straight(of: Ends, scene: View) -> float:
    """Factor on the light of a lamp that the camera looks into, beside that of a depolarising surface."""
    (lamp, _), (lens, _) = axes(scene, "light"), axes(scene, "receiver")
    light, receiver = of.light / of.light[0], of.receiver / of.receiver[0]
    across = axes(scene, "light")[1]
    turn = 2.0 * math.atan2(float(lens @ across), float(lens @ lamp))
    q = light[1] * math.cos(turn) + light[2] * math.sin(turn)
    u = light[2] * math.cos(turn) - light[1] * math.sin(turn)
    return float(1.0 + receiver[1] * q - receiver[2] * u + receiver[3] * light[3])
