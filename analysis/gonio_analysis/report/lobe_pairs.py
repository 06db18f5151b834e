"""The lobes of two samples at their common incidences, and what they differ by over all of them."""

import math
from dataclasses import dataclass

import numpy as np

from gonio.geometry import SAME_ANGLE, SAME_AZIMUTH
from gonio.typing import Floats
from gonio_analysis.curves.in_plane import Curve, curves, evenly
from gonio_analysis.curves.lobes import CurveLobe, lobe
from gonio_analysis.fitting.observations import Observations

MOST_CURVES = 12
"""Curves whose lobes are measured; also incidences and wavelengths that have a factor of their own."""
STANDS = 3.0
"""Standard uncertainties from which on a part differs from the rest."""


@dataclass(frozen=True)
class LobeDifference:
    """A difference of the lobes, B - A, over all curves in which both are known."""

    value: float
    u: float
    stands: bool
    """Whether it is beyond its uncertainty, and worth words."""


@dataclass(frozen=True)
class LobePair:
    """The lobes of both samples at one incidence."""

    theta_i_deg: float
    width_a_deg: float
    width_b_deg: float
    u_width_a_deg: float
    u_width_b_deg: float
    height_ratio: float
    contrast_a: float
    """Height over what stands beside the lobe."""
    contrast_b: float


@dataclass(frozen=True)
class Lobes:
    """The lobes of both samples at their common incidences."""

    pairs: list[tuple[CurveLobe, CurveLobe]]

    @classmethod
    def of(cls, a: Observations, b: Observations) -> "Lobes":
        """Of both at one wavelength."""
        ones, others = curves(a), curves(b)
        if {c.scanned for c in (*ones, *others)} != {"theta_r"}:
            return cls([])
        matched = [(one, other) for one in ones for other in others if same_incidence(one, other)]
        some = (matched[k] for k in evenly(len(matched), MOST_CURVES))
        found = [(lobe(one, a), lobe(other, b)) for one, other in some]
        # of few values nobody tells a lobe from what stands beside it
        return cls([(x, y) for x, y in found if x and y and not math.isnan(x.base + y.base)])

    @property
    def widest(self) -> float:
        """The largest width [rad]; 0 where none is known."""
        return max((x.width for both in self.pairs for x in both if x.resolved), default=0.0)

    @property
    def exist(self) -> tuple[bool, bool]:
        """Whether most curves of each sample have a lobe."""
        share = [np.mean([both[k].exists for both in self.pairs]) if self.pairs else 0.0 for k in (0, 1)]
        return bool(share[0] > 0.5), bool(share[1] > 0.5)

    @property
    def contrasts(self) -> tuple[float, float]:
        """The median of each sample's contrasts."""
        both = [[x.contrast for x in of] for of in zip(*self.pairs, strict=True)] or [[], []]
        first, second = (float(np.median(v)) if (v := [x for x in of if math.isfinite(x)]) else math.nan for of in both)
        return first, second

    @property
    def each(self) -> list[LobePair]:
        """Each incidence in numbers."""
        out = []
        for x, y in self.pairs:
            numbers = (x.parameter, x.width, y.width, x.u_width, y.u_width)
            at, one, other, u_one, u_other = (math.degrees(v) for v in numbers)
            ratio = y.height / x.height if x.height > 0.0 else math.nan
            out.append(LobePair(at, one, other, u_one, u_other, ratio, x.contrast, y.contrast))
        return out

    def differences(self, name: str) -> tuple[Floats, Floats]:
        """B - A of one number of each pair, and its standard uncertainty; where both are known."""
        known = [(x, y) for x, y in self.pairs if x.exists and y.exists]
        if name == "height":
            rows = [(math.log(y.height / x.height), math.hypot(x.u_height_rel, y.u_height_rel)) for x, y in known]
        else:
            rows = [(getattr(y, name) - getattr(x, name), math.hypot(getattr(x, f"u_{name}"), getattr(y, f"u_{name}")))
                    for x, y in known if x.resolved and y.resolved]  # fmt: skip
        value, u = np.array(rows).reshape(-1, 2).T
        return value, u

    def found(self, name: str, least: float, beside: tuple[float, float] = (0.0, 0.0)) -> LobeDifference | None:
        """Their mean; `beside`: what it is expected to be, and the uncertainty of that."""
        value, u = self.differences(name)
        if not value.size:
            return None
        if np.isfinite(u).all() and (u > 0).all():
            weight = 1.0 / u**2
            mean, of_mean = float(weight @ value / weight.sum()), float(weight.sum() ** -0.5)
            spread = float(weight @ (value - mean) ** 2) / max(value.size - 1, 1)
            of_mean *= math.sqrt(max(spread, 1.0))
        else:
            mean, of_mean = float(value.mean()), math.nan
            if value.size > 1:
                of_mean = float(value.std(ddof=1)) / math.sqrt(value.size)
        return LobeDifference(
            mean, of_mean, stands(mean - beside[0], math.hypot(np.nan_to_num(of_mean), beside[1]), least)
        )


def same_incidence(one: Curve, other: Curve) -> bool:
    """Whether two curves in the plane are of one incidence, or of one detector that stands still."""
    if one.scanned != other.scanned or abs(one.parameter - other.parameter) > SAME_ANGLE:
        return False
    return one.parameter < SAME_ANGLE or math.cos(one.phi_i - other.phi_i) > math.cos(SAME_AZIMUTH)


def stands(off: float, u: float, least: float) -> bool:
    """Whether a difference is worth words, and beyond its uncertainty where there is one."""
    return abs(off) > least and abs(off) > STANDS * (0.0 if math.isnan(u) else u)
