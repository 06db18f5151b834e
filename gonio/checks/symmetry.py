"""What values say of their sample's symmetry: reciprocity, left and right, the azimuth of incidence; and of repeats.

Pairs of values that a reciprocal, symmetric, isotropic sample would give alike, and pairs of one direction, are
compared as logarithms of their ratio.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio.checks.values import SIGNIFICANCE, CheckedValues, Rows, incidences
from gonio.geometry import SAME_ANGLE, SAME_AZIMUTH, SAME_DIRECTION, Directions, wrap
from gonio.typing import Bools, Floats

NEAR = float(np.radians(0.1))
"""Two directions count as one: readbacks scatter by hundredths of a degree."""
DIFFERENT = 0.10
"""Typical difference beyond which a symmetry is called broken where no uncertainty is known."""
FEWEST = 3
VISITS = 9
"""Neighbours by which values in one direction are found."""
MOST_VALUES = 50_000
"""Values that are compared, evenly taken."""


STEEP = math.radians(5.0)
"""Distance from the mirror direction within which lobes are steep."""
LOW = math.radians(75.0)
"""Polar angle from which footprints are four times as long as they are wide, and more."""
FAINT = 0.01
"""Part of the largest value at the same incidence below which stray light and background matter."""
PLACES = {
    f"within {math.degrees(STEEP):.0f}° of the mirror direction": "the lobe is narrow there: errors of the angles, the"
    " sizes of source and receiver, and the steps of the plan move values",
    f"fainter than {100 * FAINT:.0f} % of the brightest value at the incidence": "what reaches the detector beside the"
    " sample's light, background or stray light, is not small there",
    f"at polar angles from {math.degrees(LOW):.0f}° on": "the footprints of source and receiver outgrow the sample or"
    " each other there",
    "elsewhere": "the sample is not the same in both: moved, textured, or measured against a level that drifted",
}
"""Where a pair lies, the first that fits; and what makes pairs differ there."""


@dataclass(frozen=True)
class Place:
    """The pairs in one of `PLACES`."""

    words: str
    pairs: int
    typical: float
    """rms of ln(one / other)."""


@dataclass(frozen=True)
class Pairs:
    """Pairs of values that should be alike."""

    kind: str
    """ "reciprocity", "left and right", "azimuth of incidence" or "repeats"."""
    words: str
    pairs: int
    typical: float
    """rms of ln(one / other)."""
    largest: float
    chi_square: float | None
    """Chi-square with the covariance of the values; None where no uncertainty is known."""
    freedom: float
    """Independent numbers that scatter as much as it does: fewer than pairs where values stand in several."""
    logs: list[float]
    """ln(one / other) of every pair."""
    places: list[Place]
    """Where they lie, in the order of `PLACES`, without those that hold no pair."""

    @property
    def reduced_chi_square(self) -> float | None:
        """A pair."""
        return None if self.chi_square is None else self.chi_square / self.pairs

    @property
    def broken(self) -> bool:
        """Whether they differ by more than their uncertainty (by more than 10 %, where none is known)."""
        from scipy.special import chdtrc

        if self.chi_square is None:
            return self.typical > DIFFERENT
        return bool(chdtrc(self.freedom, self.freedom * self.chi_square / self.pairs) < SIGNIFICANCE)

    def summary(self) -> dict[str, object]:
        """Plain numbers and words."""
        names = "kind", "words", "pairs", "typical", "largest", "reduced_chi_square", "broken"
        return {name: getattr(self, name) for name in names}


def symmetries(data: CheckedValues) -> list[Pairs]:
    """What could be compared: nothing is listed that has fewer than three pairs."""
    data = data if len(data) <= MOST_VALUES else data.take(np.arange(0, len(data), -(-len(data) // MOST_VALUES)))
    at = data.directions
    flat = at.theta_i < NEAR  # a source at the normal has no azimuth
    at = at.seen_from(np.where(flat, at.settled_at_normal().phi_i, at.phi_i))
    azimuths = _azimuths(at)
    spun = len({round(a, 3) for a in azimuths[~flat].tolist()}) > 1
    out = []
    swapped = at.swapped
    found = _pairs(_fixed(at), _fixed(swapped)) if spun else _pairs(_turned(at), _turned(swapped))
    found = found[np.abs(at.theta_i - at.theta_r)[found[:, 0]] > NEAR] if found.size else found
    out.append(_compared(data, found, "reciprocity", "source and detector exchanged"))
    other = Directions(at.theta_i, at.phi_i, at.theta_r, at.phi_i - at.dphi)
    found = _pairs(_fixed(at), _fixed(other))
    found = found[np.abs(np.sin(at.dphi) * np.sin(at.theta_r))[found[:, 0]] > NEAR] if found.size else found
    out.append(_compared(data, found, "left and right", "the other side of the plane of incidence"))
    if spun:
        found = _across(_turned(at), azimuths, ~flat)
        out.append(_compared(data, found, "azimuth of incidence", "equal θi, θr and φr − φi at another φi"))
    return [s for s in out if s is not None]


def repeats(data: CheckedValues) -> Pairs | None:
    """Values measured in one direction (within 0.02 degrees); None for fewer than three pairs.

    Of many visits to one direction the first two make a pair, the next two another: no value is in two of them.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    count = len(data)
    if count < 2:
        return None
    here = _fixed(data.directions)
    distance, near = cKDTree(here).query(here, k=min(VISITS, count), distance_upper_bound=SAME_DIRECTION)
    i, at = np.nonzero(np.isfinite(distance))
    joined = coo_array((np.ones(i.size, dtype=bool), (i, near[i, at])), shape=(count, count))
    _, group = connected_components(joined, directed=False)
    order = np.argsort(group, kind="stable")
    begins = np.flatnonzero(np.diff(group[order], prepend=-1))
    place = np.arange(count) - np.repeat(begins, np.diff(begins, append=count))
    first = np.flatnonzero((place[:-1] % 2 == 0) & (place[1:] == place[:-1] + 1))
    pairs = np.stack([order[first], order[first + 1]], axis=1)
    close = np.linalg.norm(here[pairs[:, 0]] - here[pairs[:, 1]], axis=1) <= SAME_DIRECTION
    return _compared(data, np.asarray(pairs[close]), "repeats", "measured again in the same direction")


def _azimuths(at: Directions) -> Floats:
    """The azimuth of incidence of each value [rad], those within 2 degrees alike."""
    out = np.zeros(at.theta_i.size)
    seen: list[float] = []
    for i in incidences(at):
        near = [a for a in seen if abs(wrap(a - i.phi_i + math.pi) - math.pi) < SAME_AZIMUTH]
        if i.theta_i >= NEAR and not near:
            seen.append(i.phi_i)
        out[i.rows] = near[0] if near else i.phi_i
    return out


def _turned(at: Directions) -> Floats:
    """Both directions as the source sees them: turned about the normal until it stands at azimuth 0."""
    zero = np.zeros_like(at.dphi)
    return np.concatenate(Directions(at.theta_i, zero, at.theta_r, at.dphi).vectors, axis=1)


def _fixed(at: Directions) -> Floats:
    return np.concatenate(at.vectors, axis=1)


def _matches(here: Floats, there: Floats) -> tuple[Rows, Rows]:
    """Places i of `there`, and j of `here`, that lie together."""
    from scipy.spatial import cKDTree

    distance, j = cKDTree(here).query(there, distance_upper_bound=NEAR)
    i = np.flatnonzero(np.isfinite(distance))
    return i, j[i]


def _distinct(pairs: Sequence[tuple[Rows, Rows]]) -> Rows:
    """Rows (i, j), i < j, each once."""
    both = np.sort(np.concatenate([np.stack(one, axis=1) for one in pairs]), axis=1)
    return np.asarray(np.unique(both[both[:, 0] != both[:, 1]], axis=0))


def _pairs(here: Floats, there: Floats) -> Rows:
    """Rows (i, j), i < j, where value j lies where the image of value i does."""
    return _distinct([_matches(here, there)])


def _across(turned: Floats, azimuths: Floats, use: Bools) -> Rows:
    """Pairs of equal turned directions between each azimuth of incidence and the next."""
    known = np.unique(azimuths[use])
    rings = [np.flatnonzero(use & (azimuths == a)) for a in known]
    found = []
    for one, two in zip(rings, [*rings[1:], *rings[:1]], strict=True):
        i, j = _matches(turned[two], turned[one])
        found.append((one[i], two[j]))
    return _distinct(found)


def _compared(data: CheckedValues, pairs: Rows, kind: str, words: str) -> Pairs | None:
    known = data.random is not None
    use = data.brdf > (3 * data.u if known else 0.0)
    pairs = pairs[use[pairs].all(axis=1)] if pairs.size else pairs
    if len(pairs) < FEWEST:
        return None
    logs = np.diff(np.log(data.brdf[pairs]), axis=1)[:, 0]
    typical, largest = float(np.sqrt(np.mean(logs**2))), float(np.abs(logs).max())
    chi_square = data.chi_square(pairs) if known else None
    freedom = data.freedom(pairs) if known else len(pairs)
    places = _places(data, pairs, logs)
    return Pairs(kind, words, len(pairs), typical, largest, chi_square, freedom, logs.tolist(), places)


def _places(data: CheckedValues, pairs: Rows, logs: Floats) -> list[Place]:
    at, brightest = data.directions, np.empty(len(data))
    for one in incidences(at):
        brightest[one.rows] = data.brdf[one.rows].max()
    faint = data.brdf < FAINT * brightest
    steep = np.asarray(at.mirror_offset) <= STEEP + SAME_ANGLE
    low = np.maximum(at.theta_i, at.theta_r) >= LOW
    left, out = np.ones(len(pairs), dtype=bool), []
    for words, here in zip(PLACES, (steep, faint, low, np.ones(len(data), dtype=bool)), strict=True):
        chosen = left & here[pairs].any(axis=1)
        left &= ~chosen
        if chosen.any():
            out.append(Place(words, int(chosen.sum()), float(np.sqrt(np.mean(logs[chosen] ** 2)))))
    return out
