"""Light that goes back where it came from: the lobe of tape and sheeting about the direction of incidence."""

import math
from dataclasses import dataclass, replace
from itertools import product
from math import pi
from typing import ClassVar

import numpy as np

from gonio.geometry import Directions
from gonio.models import hemispherical
from gonio.models._compile import device, of_columns
from gonio.models._math import _LOG2_E, GRAZING, HALF_PI, exp2, log
from gonio.models.engine import Constants, Kernel
from gonio.models.model import Model
from gonio.models.parameters import Declaration, Ior, Levels, Values, parameter, plain
from gonio.typing import Floats

NEAR_RETRO_DEG = 10.0
"""A lobe about the direction of incidence is looked for where a value lies this near to it."""


@device
def observation(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """(|V - L|^2, product, sum) of the directions' difference and of their cosines."""
    lz = max(lz, GRAZING)
    vz = max(vz, GRAZING)
    x, y, z = vx - lx, vy - ly, vz - lz
    return x * x + y * y + z * z, lz * vz, lz + vz


@of_columns(observation, 3, single_range=(math.inf, 0.0))
def retroreflecting(apart2, product, total, constants):  # type: ignore[no-untyped-def]
    """(product)^p (1 + |V - L|^2/w^2)^-t over (sum - product), and a diffuse base; infinite where it is beyond 1e60."""
    diffuse, scale, per_w2, tail, entrance = constants
    lobe = exp2(_LOG2_E * (entrance * log(product) - tail * log(1.0 + apart2 * per_w2)))
    value = diffuse + scale * lobe / (total - product)
    return value if value < 1e60 else math.inf


@dataclass(frozen=True, repr=False)
class Retroreflecting(Model):
    """A lobe about the direction of incidence over a diffuse base: returned R + (1 - returned) albedo/pi [1/sr].

    R = D (cos_i cos_r)^entrance / (cos_i + cos_r - cos_i cos_r). D is a function of the observation angle d between the
    two directions: (1 + (2 sin(d/2)/w)^2)^-tail, of integral 1 over all directions (the shape of Burley 2012, about the
    light in place of the normal). The denominator is that of Ashikhmin and Premoze 2007: the form is reciprocal, and
    reflects at most `returned` of what it receives.
    """

    returned: float = parameter(
        0.3,
        "[0, 1]",
        "The share of the lobe: what it sends back at normal incidence, but for what a wide lobe sends below the"
        " horizon. 1 - returned is the share of the diffuse base.",
        scale="linear",
    )
    width_deg: float = parameter(
        1.0,
        "[1e-6, 90]",
        "w: the observation angle at which D has fallen by the factor 2^tail.",
        "deg",
        scale="log",
        bounds=(0.01, 60.0),
    )
    tail: float = parameter(
        1.5, "[0.5, 100]", "How fast D falls beyond the width: as d^(-2 tail).", scale="log", bounds=(0.5, 30.0)
    )
    entrance: float = parameter(
        0.0,
        "[0, 20]",
        "How the lobe loses with the entrance angle: seen straight back, by cos^(2 entrance). At 0 the value at the"
        " peak goes as 1/(cos (2 - cos)), and R_A = f cos^2 as cos/(2 - cos).",
        scale="linear",
    )
    diffuse_albedo: float = parameter(0.0, "[0, 1]", "The diffuse base's reflectance.", scale="linear")
    name: ClassVar[str] = "retroreflecting"
    rank: ClassVar[int] = 8
    in_sums: ClassVar[str] = "base gloss"
    hides_index: ClassVar[bool] = True

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:

        def starts(levels: Levels) -> list[Values]:
            grid = product((0.01, 0.1, 0.5), (0.2, 1.0, 4.0, 15.0), (1.0, 2.0), (0.0, 1.0))
            return [
                dict(zip(cls.fitted, (s, *rest, min(levels.diffuse / (1 - s), 1.0)), strict=True)) for s, *rest in grid
            ]

        def base_starts(albedo: float) -> list[Values]:
            lobe = {"returned": 0.1, "tail": 1.2, "entrance": 0.0, "diffuse_albedo": albedo}
            return [{**lobe, "width_deg": width} for width in (0.5, 2.0, 8.0)]

        return replace(
            plain(cls.name, cls.fitted),
            starts=starts,
            flat=lambda v: {"diffuse_albedo": (1.0 - v["returned"]) / math.pi},
            base_starts=base_starts,
        )

    @classmethod
    def undetermined_by(cls, directions: Directions) -> str:
        omega_i, omega_r = directions.vectors
        squares = np.sum((omega_i - omega_r) ** 2, axis=-1)
        if np.any(squares < (2.0 * math.sin(math.radians(NEAR_RETRO_DEG) / 2.0)) ** 2):
            return ""
        return f"no value lies within {NEAR_RETRO_DEG:g} degrees of the direction of incidence"

    @property
    def convention(self) -> str:
        return (
            "A retroreflected lobe (1 + |V - L|^2/w^2)^-tail about the light, normalised over all directions, over "
            "Ashikhmin and Premoze's 2007 cos_i + cos_r - cos_i cos_r; `returned` is its share."
        )

    def _normalised(self) -> tuple[float, float, float]:
        """w^2, and e = tail - 1 and c of D's share within x = |V - L|^2: (1 - (1 + x/w^2)^-e)/c."""
        w2 = math.radians(self.width_deg) ** 2
        e = self.tail - 1.0
        full = math.log1p(4.0 / w2)
        return w2, e, -math.expm1(-e * full) if e else full

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        w2, e, c = self._normalised()
        peak = (e or 1.0) / (pi * w2 * c)  # solid angle is pi d(x)
        diffuse = (1.0 - self.returned) * self.diffuse_albedo / pi
        return retroreflecting, (diffuse, self.returned * peak, 1.0 / w2, self.tail, self.entrance)

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        """The same for both sides, as the model is reciprocal."""
        base = (1.0 - self.returned) * self.diffuse_albedo
        if self.returned == 0.0:
            return np.full(theta.size, base)
        return self.returned * np.array([self._lobe(t, tolerance) for t in theta]) + base

    def _lobe(self, theta: float, tolerance: float) -> float:
        """The integral of R cos over V, by the share of D within the observation angle and the azimuth about L."""
        w2, e, c = self._normalised()
        lz, lx = max(math.cos(theta) if theta < HALF_PI else 0.0, GRAZING), math.sin(theta)

        def integrand(place: Floats, turn: Floats) -> Floats:
            part = np.floor(place).astype(int)
            t = place - part
            share = shares[part] + (shares[part + 1] - shares[part]) * t * t * (3.0 - 2.0 * t)
            slope = (shares[part + 1] - shares[part]) * 6.0 * t * (1.0 - t)
            with np.errstate(divide="ignore"):  # the last share of a steep tail rounds to 1: the whole sphere
                grown = -np.log1p(-share * c) / e if e else share * c  # ln(1 + x/w^2)
            x = np.minimum(w2 * np.expm1(grown), 4.0)
            cosine, sine = 1.0 - 0.5 * x, np.sqrt(x * (1.0 - 0.25 * x))  # of the observation angle
            level, swing = cosine * lz, sine * lx
            with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
                horizon = np.arccos(np.fmin(np.fmax(-level / swing, -1.0), 1.0))
            rest = (1.0 - turn) ** 4  # V_z may enter with a broken power at the horizon
            vz = np.maximum(level + swing * np.cos(horizon * (1.0 - rest)), 0.0)
            return np.asarray(
                vz * (lz * vz) ** self.entrance / (lz + vz - lz * vz) * slope * (4.0 * (1.0 - turn) ** 3) * horizon / pi
            )

        # where the lobe first meets the horizon, and where it is all below it
        at = [2.0 - 2.0 * lx, 2.0 + 2.0 * lx]  # |V - L|^2
        kinks = [(-math.expm1(-e * math.log1p(x / w2)) if e else math.log1p(x / w2)) / c for x in at]
        shares = np.unique(np.clip([0.0, *kinks, 1.0], 0.0, 1.0))
        # the first variable is a part's number and t in it, which runs quadratically into roots at both ends
        boxes = hemispherical.boxes(np.arange(float(shares.size)), (0.0, 0.5, 1.0))
        return hemispherical.adaptive(integrand, boxes, tolerance, f"{self.name}: {math.degrees(theta):.6g} deg")
