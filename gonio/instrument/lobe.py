"""The average of a model's lobe over the cones of source and receiver; see `gonio.instrument.apparent`.

How a geometry is averaged, its *rule*, is found once for one model (`Lobe.choose`) and can then be applied to others
(`Lobe.by_rules`): what a fit does with hundreds of nearly equal ones, and what makes its derivatives smooth. Most rules
are pairs of directions with weights; those are made once.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gonio import geometry
from gonio.instrument import spherical_caps
from gonio.models import Model
from gonio.models.engine import Geometry
from gonio.typing import Floats, Ints, NDArray

EXPANSION, NARROW_LOBE, CUT, FOCUSED = -1, -2, -3, -4
NODES = {NARROW_LOBE: (4, 16, 9, 10), FOCUSED: (3, 12, 7, 7)}
"""Of both rules that crowd nodes: level of the disc rule, and what `spherical_caps.focused_nodes` takes."""

TOLERANCE = 1e-7
"""Relative difference of two successive cubatures at which a lobe's average is taken."""
LOBE_TOLERANCE = 1e-5
"""The same where values are measured, rendered or fitted: a hundredth of the uncertainty of the best values."""
NARROW = 1e-4
"""Relative difference of the two finest cubatures above which a lobe counts as narrower than the cones."""
NOTHING = 1e-60
"""1/sr: where a lobe's largest value in the cones is below it, the second-order expansion is taken."""
PAIRS = 1 << 14  # pairs of directions evaluated at a time: they stay in the cache
KEPT = 1 << 19  # pairs that rules keep, at most: room for one geometry of the finest product, some 40 MB
CUT_ORDERS = (6, 10, 16)
RING = 6  # directions of the ring of the coarsest disc rule


@dataclass(frozen=True)
class Weighted:
    """Pairs of directions whose weighted values add up to the averages of some geometries."""

    rows: Ints
    """Which geometries."""
    at: Geometry
    weights: Floats
    first: Ints
    """Where the pairs of each of them begin."""


@dataclass(frozen=True)
class Rules:
    """How each geometry is averaged."""

    numbers: NDArray[np.int8]
    """0 to `spherical_caps.LEVELS` - 1: the product rule of that level; or `EXPANSION`, a key of `NODES`, `CUT`."""
    _kept: list[Weighted] = field(default_factory=list, repr=False, compare=False)
    """Of the geometries that the rules were found for, made when they are first asked for."""

    def __reduce__(self) -> tuple[Any, ...]:
        return Rules, (self.numbers,)


@dataclass(frozen=True)
class Lobe:
    """A model's lobe through caps about the directions toward a source and a receiver."""

    model: Model
    wavelength_nm: float
    source: float
    """Half-angle of the source's cap [rad]; 0 is a direction."""
    receiver: float
    tolerance: float

    def brdf(self, omega_i: Floats, omega_r: Floats) -> Floats:
        """Values at unit vectors (..., 3)."""
        return np.asarray(self.model.brdf_vectors(omega_i, omega_r, wavelength_nm=self.wavelength_nm))

    @property
    def is_of_directions(self) -> bool:
        """Whether neither cap has a width."""
        return self.source == 0.0 and self.receiver == 0.0

    def choose(self, omega_i: Floats, omega_r: Floats) -> tuple[Floats, NDArray[np.int8]]:
        """Averages over both caps, (n,), and the numbers of the `Rules` that hold `tolerance` there."""
        out, rules = np.empty(len(omega_i)), np.full(len(omega_i), EXPANSION, np.int8)
        if self.is_of_directions:
            return self.brdf(omega_i, omega_r).reshape(-1), rules
        cut = (omega_i[:, 2] < math.sin(self.source)) | (omega_r[:, 2] < math.sin(self.receiver))
        rules[cut] = CUT
        for index in np.flatnonzero(cut):
            out[index] = self._cut_lobe(omega_i[index], omega_r[index])
        left = np.flatnonzero(~cut)
        if not left.size:
            return out, rules
        peak = self._largest(omega_i[left], omega_r[left])
        now, error = self._second_order(omega_i[left], omega_r[left])
        out[left] = now
        rough = ~((error <= self.tolerance) & (peak <= 3.0 * now)) & (peak > NOTHING)
        left, peak = left[rough], peak[rough]
        before = np.full(left.size, np.inf)
        for level in range(spherical_caps.LEVELS):
            if not left.size:
                return out, rules
            now = self._product_rule(omega_i[left], omega_r[left], level)
            out[left], rules[left] = now, level
            # the average of a lobe that this many rings resolve is not so far below its peak
            seen = peak <= 3.0 * spherical_caps.RINGS[level] ** 2 * now
            apart = np.abs(now - before)
            # the one before holds it, at a fifth of the cost
            rules[left[apart <= self.tolerance * np.abs(now)]] = level - 1
            allowed = max(self.tolerance, NARROW) if level == spherical_caps.LEVELS - 1 else self.tolerance
            rough = ~((apart <= allowed * np.abs(now)) & seen)
            left, before, peak = left[rough], now[rough], peak[rough]
        for index, product in zip(left.tolist(), before, strict=True):
            out[index] = self._narrow_lobe(omega_i[index], omega_r[index])
            # what takes a fifth of the time is mostly as good, if it does not show by itself
            faster = {level: product, FOCUSED: self._narrow_lobe(omega_i[index], omega_r[index], FOCUSED)}
            good = [k for k, value in faster.items() if abs(value - out[index]) <= allowed * abs(out[index])]
            rules[index] = min(good, default=NARROW_LOBE, key=lambda k: abs(faster[k] - out[index]))
        return out, rules

    def by_rules(self, omega_i: Floats, omega_r: Floats, rules: Rules) -> Floats:
        """Averages over both caps, (n,), by rules that were found for these geometries before."""
        if self.is_of_directions:
            return self.brdf(omega_i, omega_r).reshape(-1)
        out = np.empty(len(omega_i))
        if not rules._kept:
            rules._kept.append(self._weighted(omega_i, omega_r, rules.numbers))
        kept = rules._kept[0]
        if kept.rows.size:
            values = self.model.at(kept.at, wavelength_nm=self.wavelength_nm)
            out[kept.rows] = np.add.reduceat(values * kept.weights, kept.first)
        left = np.delete(np.arange(len(out)), kept.rows)
        for rule in np.unique(rules.numbers[left]).tolist():
            here = left[rules.numbers[left] == rule]
            l, v = omega_i[here], omega_r[here]  # noqa: E741
            if rule >= EXPANSION:
                out[here] = self._product_rule(l, v, rule)
            else:
                each = zip(l, v, strict=True)
                out[here] = [self._cut_lobe(*pair) if rule == CUT else self._narrow_lobe(*pair, rule) for pair in each]
        return out

    def _weighted(self, omega_i: Floats, omega_r: Floats, numbers: NDArray[np.int8]) -> Weighted:
        """The pairs of as many geometries as `KEPT` has room for, those with few pairs first."""
        parts, left = [], KEPT
        for rule in range(EXPANSION, spherical_caps.LEVELS):
            rows = np.flatnonzero(numbers == rule)[: left // self._count(rule)]
            left -= rows.size * self._count(rule)
            parts += [(rows[part], *pairs) for part, *pairs in self._pairs(omega_i[rows], omega_r[rows], rule)]
        count = np.array([k for rows, _, _, weights in parts for k in [weights.shape[1]] * rows.size], np.intp)
        at = (np.concatenate([part[side].reshape(-1) for part in parts] or [np.zeros(0)]) for side in (1, 2, 3))
        lit, seen, weights = at
        rows = np.concatenate([part[0] for part in parts] or [np.zeros(0, np.intp)])
        return Weighted(rows, Geometry(lit, seen, weights.shape), weights, np.cumsum(count) - count)

    def _largest(self, omega_i: Floats, omega_r: Floats) -> Floats:
        """The BRDF between the directions of the caps that come nearest to mirroring each other: a lobe's peak."""
        mirror = geometry.mirrored(omega_i)
        chord, apart = mirror - omega_r, geometry.angle_between(mirror, omega_r)
        toward = chord - np.einsum("nk,nk->n", chord, omega_r)[:, None] * omega_r
        size = np.linalg.norm(toward, axis=1)[:, None]
        toward = np.where(size > 1e-12, toward / np.maximum(size, 1e-300), 0.0)
        share = apart * self.receiver / (self.source + self.receiver)

        def at(angle: Floats) -> Floats:
            turned = np.cos(angle)[:, None] * omega_r + np.sin(angle)[:, None] * toward
            return np.where(size > 1e-12, turned, omega_r)

        seen = at(np.minimum(self.receiver, share))
        lit = at(np.maximum(apart - self.source, share)) * (-1.0, -1.0, 1.0)
        return self.brdf(lit, seen).reshape(-1)

    def _narrow_lobe(self, omega_i: Floats, omega_r: Floats, rule: int = NARROW_LOBE) -> float:
        """One geometry whose lobe is far narrower than the wider cone: nodes there crowd about the mirror direction."""
        wide_source = self.source > self.receiver
        sides = (omega_i, self.source), (omega_r, self.receiver)
        (wide_axis, wide), (axis, half) = sides if wide_source else sides[::-1]
        one, (level, *orders) = (np.zeros(1), np.zeros(1), np.ones(1)), NODES[rule]
        square, psi, weight = spherical_caps.disc_rule(level) if half > 0.0 else one
        outer = spherical_caps.nodes(axis, half, square, psi)
        total = 0.0
        for first in range(0, len(outer), 8):
            part = slice(first, first + 8)
            inner, solid = spherical_caps.focused_nodes(wide_axis, wide, outer[part] * (-1.0, -1.0, 1.0), *orders)
            fixed = np.repeat(outer[part], inner.shape[1], axis=0).reshape(inner.shape)
            pair = (inner, fixed) if wide_source else (fixed, inner)
            total += float(weight[part] @ np.einsum("kn,kn,kn->k", self.brdf(*pair), pair[0][..., 2], solid))
        if wide_source:
            return total / (math.pi * math.sin(self.source) ** 2 * float(omega_i[2]))
        return total / (4.0 * math.pi * math.sin(self.receiver / 2.0) ** 2 * float(weight @ outer[:, 2]))

    def _second_order(self, omega_i: Floats, omega_r: Floats) -> tuple[Floats, Floats]:
        """f + the second-order terms of each cone alone, and the estimated size of what is left out, from 13 values.

        With v the largest change of f over either ring and d the second-order terms, all relative to f, the next terms
        are of order v^4 and d^2.
        """
        total, error = np.empty(len(omega_i)), np.empty(len(omega_i))
        for part, lit, seen, weights in self._pairs(omega_i, omega_r, EXPANSION):
            values = self.brdf(lit, seen)
            centre, terms = values[:, 0], weights * (values - values[:, :1])
            scale = np.where(centre > 0.0, centre, 1.0)
            total[part] = centre + np.sum(terms, axis=1)
            rings = [slice(k, k + RING) for k in range(1, values.shape[1], RING)]
            change = sum(np.max(np.abs(values[:, k] - values[:, :1]), axis=1) for k in rings) / scale
            change2 = sum(np.abs(np.sum(terms[:, k], axis=1)) for k in rings) / scale
            with np.errstate(over="ignore"):
                error[part] = np.where(centre > 0.0, change**4 + 4.0 * change2**2, np.inf)
        return total, error

    def _product_rule(self, omega_i: Floats, omega_r: Floats, level: int) -> Floats:
        out = np.empty(len(omega_i))
        for part, lit, seen, weights in self._pairs(omega_i, omega_r, level):
            out[part] = np.einsum("gk,gk->g", self.brdf(lit, seen), weights)
        return out

    def _count(self, rule: int) -> int:
        """Pairs of a geometry."""
        if rule == EXPANSION:
            return 1 + RING * ((self.source > 0.0) + (self.receiver > 0.0))
        nodes = spherical_caps.disc_rule(rule)[0].size
        return int((nodes if self.source > 0.0 else 1) * (nodes if self.receiver > 0.0 else 1))

    def _pairs(self, omega_i: Floats, omega_r: Floats, rule: int) -> Iterator[tuple[slice, Floats, Floats, Floats]]:
        """Some geometries at a time: which, their pairs of directions (g, k, 3), and the weights of these (g, k)."""
        step = max(1, PAIRS // self._count(rule))
        for first in range(0, len(omega_i), step):
            part = slice(first, first + step)
            made = self._expanded if rule == EXPANSION else self._product
            yield part, *made(omega_i[part], omega_r[part], max(rule, 0))

    def _expanded(self, omega_i: Floats, omega_r: Floats, level: int) -> tuple[Floats, Floats, Floats]:
        """The axes, and the ring about either with the other axis."""
        square, psi, _ = spherical_caps.disc_rule(level)
        lit, seen, weights = [omega_i[:, None]], [omega_r[:, None]], []
        for axis, half, moved, still in ((omega_i, self.source, lit, seen), (omega_r, self.receiver, seen, lit)):
            if half > 0.0:
                moved.append(spherical_caps.nodes(axis, half, square[1:], psi[1:]))
                still.append(np.repeat(still[0], RING, axis=1))
                # a source's are weighted by cos(theta_s), whose mean over the ring is that of the axis times cos(rho)
                light = moved[-1][..., 2] if moved is lit else np.ones((len(axis), RING))
                weights.append(0.75 * light / np.sum(light, axis=1, keepdims=True))
        rings = np.concatenate(weights, axis=1)
        whole = np.concatenate([1.0 - np.sum(rings, axis=1, keepdims=True), rings], axis=1)
        return np.concatenate(lit, axis=1), np.concatenate(seen, axis=1), whole

    def _product(self, omega_i: Floats, omega_r: Floats, level: int) -> tuple[Floats, Floats, Floats]:
        """Each node of the source's cap with each of the receiver's."""
        rule, one = spherical_caps.disc_rule(level), (np.zeros(1), np.zeros(1), np.ones(1))
        s_square, s_psi, s_weight = rule if self.source > 0.0 else one
        r_square, r_psi, r_weight = rule if self.receiver > 0.0 else one
        lit = spherical_caps.nodes(omega_i, self.source, s_square, s_psi)
        seen = spherical_caps.nodes(omega_r, self.receiver, r_square, r_psi)
        light = s_weight * lit[..., 2]
        light /= np.sum(light, axis=1, keepdims=True)
        weights = (light[:, :, None] * r_weight).reshape(len(omega_i), -1)
        return np.repeat(lit, r_weight.size, axis=1), np.tile(seen, (1, s_weight.size, 1)), weights

    def _cut_lobe(self, omega_i: Floats, omega_r: Floats) -> float:
        """One geometry in which the horizon cuts a cap."""
        before, now = math.inf, 0.0
        for order in CUT_ORDERS:
            s, s_weight = cap_nodes(omega_i, self.source, order)
            r, r_weight = cap_nodes(omega_r, self.receiver, order)
            light = s_weight * s[:, 2]
            total = 0.0
            step = max(1, PAIRS // len(s))
            for first in range(0, len(r), step):
                part = slice(first, first + step)
                total += float(light @ self.brdf(s[:, None, :], r[None, part, :]) @ r_weight[part])
            now = total / (float(np.sum(light)) * float(np.sum(r_weight))) if np.sum(light) > 0.0 else 0.0
            if abs(now - before) <= 10.0 * self.tolerance * abs(now):
                break
            before = now
        return now


def cap_nodes(omega: Floats, half: float, order: int) -> tuple[Floats, Floats]:
    """Nodes and solid angles [sr] of what lies above the horizon of the cap about one axis."""
    if half == 0.0:
        return omega[None, :], np.ones(1)
    if omega[2] < math.sin(half):
        return spherical_caps.cut_nodes(omega, half, order)
    square, psi, weight = spherical_caps.disc_rule(CUT_ORDERS.index(order) + 2)
    return spherical_caps.nodes(omega, half, square, psi), weight * (4.0 * math.pi * math.sin(half / 2.0) ** 2)
