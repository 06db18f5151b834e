"""Beams and apertures of glossmeters (ISO 2813, ASTM D523) and haze meters (ASTM E430), and what they see of a model.

Source and receiver are rectangles in the focal planes of two lenses: every point of one is a direction. The flux is
the same from every point of the source. See docs/appearance.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from gonio.geometry import Directions
from gonio.models import Model, fresnel
from gonio.models.corrected import evenly
from gonio.typing import Floats

STANDARD_INDEX = 1.567
"""Index of refraction of the glass that has 100 gloss units at every angle."""
SOURCE_DEG = (0.75, 2.5)
"""Angles of the source's image in the plane of incidence and across it."""
EDGES_DEG = (0.0, 0.02, 0.06, 0.2, 0.5, 1.0, 2.0, 4.0, 20.0)
"""Distances from the mirror direction where panels of the receiver end: lobes of any width down to 0.01 degrees."""


@dataclass(frozen=True)
class Glossmeter:
    """One angle of a glossmeter, or one receiver of a haze meter, all in degrees.

    Parameters
    ----------
    angle_deg
        Of incidence and of the receiver's axis.
    receiver_deg
        Full angles of the receiver's aperture in the plane of incidence and across it.
    offset_deg
        Of the receiver's axis from the mirror direction, away from the normal: not 0 for haze.
    source_deg
        Full angles of the source's image.
    """

    angle_deg: float
    receiver_deg: tuple[float, float]
    offset_deg: float = 0.0
    source_deg: tuple[float, float] = SOURCE_DEG

    @property
    def theta(self) -> float:
        """Angle of incidence [rad]."""
        return math.radians(self.angle_deg)

    @property
    def offset(self) -> float:
        """Angle of the receiver's axis from the mirror direction [rad]."""
        return math.radians(self.offset_deg)

    @property
    def where(self) -> str:
        """What the receiver looks at."""
        return f"direction {self.offset_deg:+g}° from the mirror direction" if self.offset else "mirror direction"

    @cached_property
    def reach(self) -> float:
        """How far from the receiver's axis, to either side, a value in the plane of incidence has to lie [rad].

        A haze is interpolated: half of its distance from the mirror direction counts, too.
        """
        return math.radians(0.5 * (self.receiver_deg[0] + self.source_deg[0] + abs(self.offset_deg)))

    def source(self, order: int) -> tuple[Floats, Floats]:
        """Directions toward the source (n, 3) and their share of the flux (n,), which add up to 1."""
        points, weights = _rectangle(_panels(self.source_deg[0]), _panels(self.source_deg[1]), order)
        omega, solid = _directions(points, self.theta, -1.0)
        share = weights * solid
        return omega, share / share.sum()

    def receiver(self, order: int, about: Floats | None = None) -> tuple[Floats, Floats]:
        """Directions inside of the receiver's aperture (n, 3) and their solid angles [sr] (n,).

        Parameters
        ----------
        order
            Gauss nodes of a panel, each way.
        about
            A direction (3,) that panels close in on; without it the aperture is one panel.
        """
        centre = (0.0, 0.0) if about is None else self.in_focal_plane(about)
        along, across = (
            _panels(width, None if about is None else c) for width, c in zip(self.receiver_deg, centre, strict=True)
        )
        points, weights = _rectangle(along, across, order)
        omega, solid = _directions(points, self.theta + self.offset, 1.0)
        return omega, weights * solid

    @cached_property
    def standard(self) -> float:
        """Share of the source's flux that the receiver sees of the standard glass, in the mirror direction.

        The beam reflected by glass is the source's image, cut by the receiver's aperture where that is smaller.
        """
        omega, share = self.source(16)
        widths = zip(self.receiver_deg, self.source_deg, strict=True)
        seen = math.prod(min(1.0, math.tan(math.radians(0.5 * r)) / math.tan(math.radians(0.5 * s))) for r, s in widths)
        return seen * float(share @ fresnel.reflectance(omega[:, 2], STANDARD_INDEX))

    def in_focal_plane(self, omega: Floats) -> Floats:
        """Where directions (n, 3) meet the receiver's focal plane: tangents in the plane of incidence, across."""
        sine, cosine = math.sin(self.theta + self.offset), math.cos(self.theta + self.offset)
        axis = sine * omega[..., 0] + cosine * omega[..., 2]
        return np.stack([cosine * omega[..., 0] - sine * omega[..., 2], omega[..., 1]], axis=-1) / axis[..., None]


GLOSSMETERS = (Glossmeter(20.0, (1.80, 3.6)), Glossmeter(60.0, (4.40, 11.7)), Glossmeter(85.0, (4.00, 6.0)))
HAZEMETERS = {
    "haze_e430_20": tuple(Glossmeter(20.0, (1.80, 3.6), sign * 1.9) for sign in (-1.0, 1.0)),
    "haze_e430_30": tuple(Glossmeter(30.0, (0.4, 3.0), sign * 2.0, (0.44, 5.0)) for sign in (-1.0, 1.0)),
}
"""Receivers of ASTM E430's narrow-angle reflection haze: method B (18.1 and 21.9 degrees, whose fluxes are added) and
method A (28 or 32 degrees, whose mean is taken). The angles have a source; of the apertures only the 1.8 degrees have
(docs/appearance.md)."""
PICKED = 40
"""Directions of an aperture at which a model's misfit is looked at; it is smooth over a few degrees."""
BOTH_COUNT = {"haze_e430_20": 1.0, "haze_e430_30": 0.5}


def gloss(model: Model, meter: Glossmeter, wavelength_nm: float) -> tuple[float, float]:
    """Gloss of a model [GU], spike and lobe, and the error of its quadrature.

    The light comes from phi_i = 180 degrees. The error is the difference between two rules, of which the better is
    returned.
    """
    seen = (_seen(model, meter, wavelength_nm, *orders) for orders in ((3, 4), (4, 6)))
    coarse, fine = (spike + float(solid @ f) for spike, _, _, solid, f in seen)
    scale = 100.0 / meter.standard
    return scale * fine, scale * abs(fine - coarse)


def parts(model: Model, meter: Glossmeter, wavelength_nm: float) -> tuple[Directions, Floats, Floats, float]:
    """Where the light comes from that makes a gloss: directions that stand for equal parts of the lobe's.

    Returns
    -------
    at
        Directions (n,).
    brdf : (n,) array [1/sr]
        The model there.
    share : (n,) array [GU sr]
        The gloss of the lobe is about share @ brdf.
    spike
        Gloss of the specular spike [GU].
    """
    spike, omega_i, omega_r, solid, f = _seen(model, meter, wavelength_nm, 1, 4)
    light = solid * f
    picked = evenly(light, PICKED)
    scale = 100.0 / meter.standard
    brdf = f[picked]
    share = scale * light.sum() / max(picked.size, 1) / brdf
    return Directions.from_vectors(omega_i[picked], omega_r[picked]), brdf, share, scale * spike


def _seen(
    model: Model, meter: Glossmeter, wavelength_nm: float, source_order: int, receiver_order: int
) -> tuple[float, Floats, Floats, Floats, Floats]:
    """Flux of the spike; pairs of directions toward source and receiver, their projected solid angle, and the BRDF."""
    omega_i, share = meter.source(source_order)
    spike = (
        0.0
        if meter.offset
        else float(share @ model.specular_reflectivity(np.arccos(omega_i[:, 2]), wavelength_nm=wavelength_nm))
    )
    panels = [meter.receiver(receiver_order, about) for about in omega_i * (-1.0, -1.0, 1.0)]
    omega_r = np.concatenate([omega for omega, _ in panels])
    counts = [len(omega) for omega, _ in panels]
    solid = np.concatenate([solid for _, solid in panels]) * np.repeat(share, counts) * omega_r[:, 2]
    omega_i = np.repeat(omega_i, counts, axis=0)
    return spike, omega_i, omega_r, solid, model.brdf_vectors(omega_i, omega_r, wavelength_nm=wavelength_nm)


def _directions(points: Floats, theta: float, side: float) -> tuple[Floats, Floats]:
    """Directions of points (tangents) in a focal plane whose axis is at `theta`, x positive on side +1; d(omega)/dA."""
    along, across = points.T
    sine, cosine = math.sin(theta), math.cos(theta)
    length = np.sqrt(1.0 + along**2 + across**2)
    omega = np.stack([side * (sine + cosine * along), across, cosine - sine * along], axis=1) / length[:, None]
    return omega, length**-3.0


def _panels(width_deg: float, about: float | None = None) -> Floats:
    """Edges of panels over an aperture, as tangents, closing in on one of its points."""
    end = math.tan(math.radians(0.5 * width_deg))
    if about is None:
        return np.array([-end, end])
    steps = np.tan(np.radians(EDGES_DEG))
    edges = np.concatenate([about - steps, about + steps, [-end, end]])
    return np.unique(edges[np.abs(edges) <= end])


@cache
def _gauss(order: int) -> tuple[Floats, Floats]:
    x, w = np.polynomial.legendre.leggauss(order)
    return x, w


def _rectangle(first: Floats, second: Floats, order: int) -> tuple[Floats, Floats]:
    """Gauss-Legendre nodes (n, 2) and weights (n,) over the panels between edges."""
    x, w = _gauss(order)
    axes = []
    for edges in (first, second):
        half = 0.5 * np.diff(edges)[:, None]
        middle = 0.5 * (edges[1:] + edges[:-1])[:, None]
        axes.append(((middle + half * x).ravel(), (half * w).ravel()))
    (a, wa), (b, wb) = axes
    return np.stack([np.repeat(a, b.size), np.tile(b, a.size)], axis=1), np.outer(wa, wb).ravel()
