"""What a table says of its sample's symmetry: reciprocity, left and right, and the azimuth of incidence.

Pairs of values that a reciprocal, symmetric, isotropic sample would give alike are compared as logarithms of their
ratio.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from gonio.geometry import SAME_AZIMUTH, Directions, wrap
from gonio.typing import Floats
from gonio_analysis.fitting.incidences import incidences
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.surrogate import Rows
from gonio_analysis.result_records import SymmetrySummary

NEAR = float(np.radians(0.1))
"""Two directions count as one: readbacks scatter by hundredths of a degree."""
DIFFERENT = 0.10
"""Typical difference beyond which a symmetry is called broken where no uncertainty is known."""
SIGNIFICANCE = 0.01
FEWEST = 3
MOST_VALUES = 50_000
"""Values that are compared, evenly taken."""


def symmetries(data: Observations) -> list[SymmetrySummary]:
    """What could be compared: nothing is listed that has fewer than three pairs."""
    data = data if len(data) <= MOST_VALUES else data.take(np.arange(0, len(data), -(-len(data) // MOST_VALUES)))
    at = data.directions
    azimuths = _azimuths(data)
    spun = len({round(a, 3) for a in azimuths.tolist()}) > 1
    out = []
    swapped = Directions(at.theta_r, at.phi_r, at.theta_i, at.phi_i)
    flat = at.theta_i < NEAR  # a source at the normal has no azimuth
    found = _pairs(_fixed(at), _fixed(swapped)) if spun else _pairs(_turned(at), _turned(swapped))
    found = found[np.abs(at.theta_i - at.theta_r)[found[:, 0]] > NEAR] if found.size else found
    out.append(_judged(data, found, "reciprocity", "source and detector exchanged"))
    other = Directions(at.theta_i, at.phi_i, at.theta_r, at.phi_i - at.dphi)
    found = _pairs(_fixed(at), _fixed(other))
    found = found[np.abs(np.sin(at.dphi) * np.sin(at.theta_r))[found[:, 0]] > NEAR] if found.size else found
    out.append(_judged(data, found, "left and right", "the other side of the plane of incidence"))
    if spun:
        found = _across(_turned(at), azimuths, ~flat)
        out.append(_judged(data, found, "azimuth of incidence", "equal θi, θr and φr − φi at another φi"))
    return [s for s in out if s is not None]


def _azimuths(data: Observations) -> Floats:
    """The azimuth of incidence of each value [rad], those within 2 degrees alike."""
    out = np.zeros(len(data))
    seen: list[float] = []
    for i in incidences(data):
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


def _pairs(here: Floats, there: Floats) -> Rows:
    """Rows (i, j), i < j, where value j lies where the image of value i does."""
    from scipy.spatial import cKDTree

    distance, j = cKDTree(here).query(there, distance_upper_bound=NEAR)
    i = np.flatnonzero(np.isfinite(distance))
    both = np.sort(np.stack([i, j[i]], axis=1), axis=1)
    return np.asarray(np.unique(both[both[:, 0] != both[:, 1]], axis=0))


def _across(turned: Floats, azimuths: Floats, use: npt.NDArray[np.bool_]) -> Rows:
    """Pairs of equal turned directions between each azimuth of incidence and the next."""
    from scipy.spatial import cKDTree

    known = np.unique(azimuths[use])
    found = [np.empty((0, 2), dtype=np.intp)]
    for a, b in zip(known, np.roll(known, -1), strict=True):
        one, two = (np.flatnonzero(use & (azimuths == x)) for x in (a, b))
        distance, j = cKDTree(turned[two]).query(turned[one], distance_upper_bound=NEAR)
        hit = np.isfinite(distance)
        found.append(np.stack([one[hit], two[j[hit]]], axis=1))
    pairs = np.sort(np.concatenate(found), axis=1)
    return np.asarray(np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0))


def _judged(data: Observations, pairs: Rows, kind: str, words: str) -> SymmetrySummary | None:
    from scipy.special import chdtrc

    known = data.covariance is not None
    use = data.brdf > (3 * data.u if known else 0.0)
    pairs = pairs[use[pairs].all(axis=1)] if pairs.size else pairs
    if len(pairs) < FEWEST:
        return None
    logs = np.diff(np.log(data.brdf[pairs]), axis=1)[:, 0]
    typical, largest = float(np.sqrt(np.mean(logs**2))), float(np.abs(logs).max())
    chi = None
    broken = typical > DIFFERENT
    if known:
        # the whole uncertainty of either value, as if nothing were common: what is common makes it smaller
        total = float((logs**2 / ((data.u / np.abs(data.brdf))[pairs] ** 2).sum(axis=1)).sum())
        chi = total / len(pairs)
        broken = bool(chdtrc(len(pairs), total) < SIGNIFICANCE)
    return SymmetrySummary(kind, words, len(pairs), typical, largest, chi, broken)
