"""Several laboratories' measurements of one sample: a scale, a zero and a scatter each, and who is off.

docs/laboratories.md says how it is judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtrc

from gonio.cli.pace import Pace, Say, silent
from gonio.errors import ConfigError, DataError
from gonio.typing import Floats
from gonio_analysis.changes.consensus import (
    METHODS,
    Consensus,
    Equivalence,
    Method,
    consensus,
    consistency,
    equivalence,
)
from gonio_analysis.changes.point_by_point import Side, laid_on, require_alike
from gonio_analysis.changes.resampling import Carried, carry, slope_in_plane, turned_in_plane
from gonio_analysis.curves.in_plane import Rows
from gonio_analysis.fitting.observations import Observations, describe_left_out
from gonio_analysis.fitting.value_covariance import Covariance

if TYPE_CHECKING:
    import pandas as pd

LEVEL = 0.01
"""Probability that somebody is accused where all are honest."""
TESTS = 3
"""Of scales, of zeros and of scatters: they share `LEVEL`."""
UNDETERMINED = float(np.radians(1.0))
"""A zero that is known no better than this [rad] says nothing."""
ROUNDS, AGAIN = 100, 5
"""Rounds of scales, weights and scatters; and how often laboratories that are off are turned back and carried again."""
SETTLED = 1e-10
"""Scales that change by less in a round have settled."""
CLOSE = 0.05
"""A zero has settled when a round changes it by less than this share of its uncertainty."""
FACTOR = 3.0
"""A stated uncertainty is carried over to a value at most so many times as large, or as small."""
OF_CALIBRATIONS = {
    "geometry": ("geometry",),
    "camera": ("linearity", "stray_light"),
    "light": ("beam", "polarisation", "wavelength", "bandwidth"),
}
"""What the names of the causes of a kind of calibration begin with."""


@dataclass(frozen=True)
class Laboratory:
    """What a laboratory's values say of it, against all laboratories together."""

    name: str
    source: str
    scale: float
    """Its values over the consensus."""
    u_scale: float
    """By everything that it states."""
    degree: float
    """Of equivalence: its scale less 1."""
    u_degree: float
    scale_consistent: bool
    zero: float | None
    """By how much its angle reads too large [rad]; None where the sample does not show it."""
    u_zero: float | None
    zero_consistent: bool
    scatter: float | None
    """How many times as much its values scatter as it states; None of two laboratories, which share what they show."""
    scatter_consistent: bool

    @property
    def e_n(self) -> float:
        """Degree of equivalence over its expanded uncertainty (k = 2)."""
        return self.degree / (2.0 * self.u_degree)

    @property
    def consistent(self) -> bool:
        """Whether nothing sets it apart."""
        return self.scale_consistent and self.zero_consistent and self.scatter_consistent


@dataclass(frozen=True)
class Comparison:
    """Laboratories compared in the directions that all of them have."""

    laboratories: tuple[Laboratory, ...]
    sides: tuple[Side, ...]
    at: Observations
    """The common directions; `brdf` is the consensus [1/sr] to which the degrees of equivalence refer."""
    values: Floats
    """(K, n) what each measured, carried there [1/sr]."""
    u: Floats
    """(K, n) their standard uncertainties [1/sr]."""
    onto: str
    """Whose directions they are."""
    interpolated: tuple[int, ...]
    """How many values of each are interpolated."""
    scales: Equivalence
    """Of the scales about 1."""
    methods: Mapping[Method, Consensus]
    """The scales of all laboratories by each method."""
    chi_square: float
    p_value: float
    """Of the weighted mean of all scales."""
    alone: tuple[Equivalence, ...]
    """Of each direction [1/sr]."""
    alone_by_method: Mapping[Method, tuple[Consensus, ...]]
    p_alone: Floats
    """(n,) probability by chance of each direction's chi-square."""
    shared: tuple[str, ...]
    """The causes that laboratories share, in words."""
    notes: tuple[str, ...]

    @property
    def mean(self) -> float:
        """Mean of the consensus over the common directions [1/sr]."""
        return float(np.mean(self.at.brdf))

    @property
    def agree(self) -> bool:
        """Whether every laboratory is consistent."""
        return all(x.consistent for x in self.laboratories)


@dataclass(frozen=True)
class _Found:
    """One laboratory's values in the common directions."""

    value: Floats
    covariance: Covariance
    interpolated: int


@dataclass(frozen=True)
class _Solution:
    """Scales, zeros and scatters about one shape."""

    shape: Floats
    scales: Floats
    v_scales: Floats
    zeros: Floats
    """[rad], NaN where the shape does not show it."""
    v_zeros: Floats
    scatter: Floats
    p_scatter: Floats


def compared(
    sides: Sequence[Side],
    shared: Mapping[str, Sequence[str] | None],
    *,
    wavelength_nm: float | None = None,
    say: Say = silent,
) -> Comparison:
    """Compare laboratories.

    Parameters
    ----------
    sides
        Two or more measurements of one sample, with uncertainties, each called by its laboratory's name.
    shared
        Causes that are one and the same in some laboratories -> their names; None for all.
    wavelength_nm
        Of several wavelengths, the nearest of each side is compared alone.
    say
        Called with a line now and then, where it takes long.

    Raises
    ------
    ConfigError
        `shared` names what is not there, or a side is a model.
    DataError
        A table states no uncertainties, or there is no direction that all of them have.
    """
    sides, notes = _ready(sides, wavelength_nm)
    keys, in_words = _keys(sides, shared)
    base, rows, found = _common(sides, say)
    say(f"comparing: {len(sides)} laboratories in {rows.size} common directions")
    of_base = sides[base].data
    assert of_base is not None
    at = of_base.take(rows)
    first = found
    turned = np.zeros(len(sides))
    for _ in range(AGAIN):
        solved = _solved(at, found, keys)
        zeros, zeros_consistent = _zeros(solved, turned)
        wanted = np.where(zeros_consistent, 0.0, zeros)
        u = np.sqrt(np.diag(solved.v_zeros))
        if np.all(np.abs(wanted - turned) <= CLOSE * np.where(np.isfinite(u), u, 1.0)):
            break
        again = [_turned_back(at, side, by) for side, by in zip(sides, wanted, strict=True)]
        if min(kept.size for kept, _ in again) < len(at):  # what a turned laboratory has no longer goes for all
            some = np.flatnonzero(np.bincount(np.concatenate([kept for kept, _ in again])) == len(sides))
            if some.size < 3:
                break
            again = [(some, _some(one, np.searchsorted(kept, some))) for kept, one in again]
            at, first = at.take(some), [_some(one, some) for one in first]
        turned, found = wanted, [one for _, one in again]
    scales = equivalence(solved.scales, solved.v_scales, LEVEL / TESTS)
    by = scales.reference.value
    relative = _relative(scales, by)
    likely = solved.p_scatter >= LEVEL / TESTS / len(sides)
    u_zeros = np.sqrt(np.diag(solved.v_zeros))
    laboratories = tuple(
        Laboratory(
            name=side.name,
            source=side.source,
            scale=float(solved.scales[k] / by),
            u_scale=float(np.sqrt(solved.v_scales[k, k]) / by),
            degree=float(relative.degrees[k]),
            u_degree=float(relative.u[k]),
            scale_consistent=bool(scales.consistent[k]),
            zero=float(zeros[k]) if np.isfinite(zeros[k]) else None,
            u_zero=float(u_zeros[k]) if np.isfinite(zeros[k]) else None,
            zero_consistent=bool(zeros_consistent[k]),
            scatter=float(solved.scatter[k]) if len(sides) > 2 else None,
            scatter_consistent=bool(likely[k]) or solved.scatter[k] <= 1.0,
        )
        for k, side in enumerate(sides)
    )
    every = [_everywhere(first, keys, i) for i in range(len(at))]
    pace = Pace("comparing: directions", len(every), say)
    alone, by_method, p_alone = [], dict[Method, list[Consensus]](), np.empty(len(at))
    for i, (x, v) in enumerate(every):
        pace.step(i)
        alone.append(equivalence(x, v, LEVEL))
        p_alone[i] = consistency(x, v)[1]
        for m in METHODS:
            by_method.setdefault(m, []).append(consensus(x, v, m))
    chi_square, p = consistency(solved.scales, solved.v_scales)
    methods = {m: consensus(solved.scales / by, solved.v_scales / by**2, m) for m in METHODS}
    return Comparison(
        laboratories=laboratories,
        sides=tuple(sides),
        at=replace(at, brdf=solved.shape * by),
        values=np.array([one.value for one in first]),
        u=np.array([one.covariance.total for one in first]),
        onto=sides[base].name,
        interpolated=tuple(one.interpolated for one in first),
        scales=relative,
        methods=methods,
        chi_square=chi_square,
        p_value=p,
        alone=tuple(alone),
        alone_by_method={m: tuple(c) for m, c in by_method.items()},
        p_alone=p_alone,
        shared=in_words,
        notes=notes,
    )


# ---- what comes in ----


def _ready(sides: Sequence[Side], wavelength_nm: float | None) -> tuple[list[Side], tuple[str, ...]]:
    """The sides with their planes of incidence laid on the first one's, and what is to be said."""
    out, notes = list[Side](), list[str]()
    for side in sides:
        if side.data is None:
            raise ConfigError(f"{side.source}: is a model; --laboratories compares measurements")
        if side.data.covariance is None:
            raise DataError(
                f"{side.source}: states no uncertainties, so that nothing says what agreement is; give it a column "
                "u_brdf, or assume one for all that state none: --u-rel 0.02"
            )
        if side.through is not None:
            notes.append(f"{side.name} holds transmission too: it is left out.")
        if wavelength_nm is not None:
            side = replace(side, data=side.data.nearest(wavelength_nm)[0])
        if out:
            require_alike(out[0], side)
            assert out[0].data is not None
            data, table, told = laid_on(out[0].data, side)
            notes += [f"{side.name}: {text}" for text in told]
            side = replace(side, data=data, table=table)
        out.append(side)
    notes += [f"{side.name}: {text}" for side in out if side.data is not None for text in side.data.notes]
    return out, tuple(notes)


def _keys(sides: Sequence[Side], shared: Mapping[str, Sequence[str] | None]) -> tuple[list[list[Any]], tuple[str, ...]]:
    """What tells each laboratory's causes apart: causes with one key are one and the same; and the shared in words."""
    names = [side.name for side in sides]
    known = [side.data.covariance if side.data is not None else None for side in sides]
    causes = [c.causes if c is not None else () for c in known]
    for cause, which in shared.items():
        unknown = [name for name in which or () if name not in names]
        if unknown:
            raise ConfigError(f"--shared {cause}: there is no laboratory {unknown[0]}; there are {', '.join(names)}")
        for k in (k for k, name in enumerate(names) if name in (which or names) and cause not in causes[k]):
            listed = ", ".join(causes[k]) or "none"
            raise ConfigError(f"--shared {cause}: {sides[k].source} states no such cause; it states {listed}")
    keys = [[(names[k], cause) for cause in causes[k]] for k in range(len(sides))]
    for k, side in enumerate(sides):
        same = _same_things(side.table)
        for c, cause in enumerate(causes[k]):
            which = shared.get(cause, ())
            if which is None or names[k] in which:
                keys[k][c] = ("shared", cause)
            elif cause in same:
                keys[k][c] = (same[cause], cause)
    words = dict[Any, list[str]]()
    for name, of_one in zip(names, keys, strict=True):
        for key in of_one:
            words.setdefault(key, []).append(name)
    return keys, tuple(f"{key[1]} ({', '.join(who)})" for key, who in words.items() if len(who) > 1)


def _same_things(table: pd.DataFrame | None) -> dict[str, str]:
    """Causes of a table -> what they stem from: the name of the white, or a calibration's checksum."""
    provenance = table.attrs.get("provenance") if table is not None else None
    if not isinstance(provenance, Mapping) or table is None:
        return {}
    out = {}
    if provenance.get("white"):
        out["reference"] = str(provenance["white"])
    for known in provenance.get("calibrations") or ():
        for start in OF_CALIBRATIONS.get(known.get("kind"), ()):
            causes = [name.removeprefix("s_") for name in table.columns if name.startswith(f"s_{start}")]
            out |= {cause: str(known.get("sha256")) for cause in causes}
    return out


def _common(sides: Sequence[Side], say: Say) -> tuple[int, Rows, list[_Found]]:
    """In whose directions the most values are shared, which of them, and every laboratory's values there."""
    best: tuple[tuple[int, float], int, Rows, list[tuple[Rows, _Found]]] | None = None
    least = (np.inf, "", "", "")
    for base, still in enumerate(sides):
        assert still.data is not None
        each = list[tuple[Rows, _Found]]()
        rough = 0.0
        for side in sides:
            if side is still:
                assert still.data.covariance is not None
                each.append((np.arange(len(still.data)), _Found(still.data.brdf, still.data.covariance, 0)))
                continue
            carried = _carried(still.data, side, 0.0, say)
            each.append((carried.rows, _found(carried, side)))
            rough += float(np.sum(carried.error / np.maximum(np.abs(carried.value), 1e-300)))
            if carried.rows.size < least[0]:
                why = describe_left_out(carried.missing)
                least = (carried.rows.size, still.source, side.source, why)
        counts = np.bincount(np.concatenate([rows for rows, _ in each]), minlength=len(still.data))
        rows = np.flatnonzero(counts == len(sides))
        rank = (rows.size, -rough)
        if best is None or rank > best[0]:
            best = (rank, base, rows, each)
    assert best is not None
    _, base, rows, each = best
    if not rows.size:
        raise DataError(
            f"there is no direction that all {len(sides)} laboratories have; {least[1]} and {least[2]} share the "
            f"fewest: of the values of {least[1]}, {least[3] or 'none is in a direction of all others'}"
        )
    return base, rows, [_some(one, np.searchsorted(kept, rows)) for kept, one in each]


def _carried(at: Observations, side: Side, turn: float, say: Say = silent) -> Carried:
    """A laboratory's values in other directions, its angles reading too large by `turn` [rad]."""
    assert side.data is not None and side.table is not None  # noqa: PT018
    data = side.data
    table = side.table
    if turn:
        directions, above = turned_in_plane(data.directions, -turn)
        kept = np.flatnonzero(above)
        data = replace(data.take(kept), directions=directions[kept], rows=np.arange(kept.size))
        table = table.iloc[side.data.rows[kept]]
    return carry(at, data, table, say)


def _found(carried: Carried, side: Side) -> _Found:
    assert side.data is not None and side.data.covariance is not None  # noqa: PT018
    random = np.hypot(carried.random, carried.error)
    covariance = Covariance(random, carried.common, side.data.covariance.causes)
    return _Found(carried.value, covariance, carried.interpolated)


def _turned_back(at: Observations, side: Side, turn: float) -> tuple[Rows, _Found]:
    carried = _carried(at, side, turn)
    return carried.rows, _found(carried, side)


def _some(one: _Found, rows: Rows) -> _Found:
    return _Found(one.value[rows], one.covariance.take(rows), one.interpolated)


# ---- scales, zeros and scatters ----


def _solved(at: Observations, found: Sequence[_Found], keys: Sequence[Sequence[Any]]) -> _Solution:
    """Scales, zeros and scatters of all laboratories about a shape that they make together."""
    y = np.array([one.value for one in found])
    k, n = y.shape
    scales = np.array([_ratio(row, np.median(y, axis=0)) for row in y])
    shape, scatter = np.mean(y / scales[:, None], axis=0), np.ones(k)
    slope = np.zeros(n)
    for again in range(2):
        for _ in range(ROUNDS):
            before = scales
            covariances = [_at_the_shape(one, s * shape) for one, s in zip(found, scales, strict=True)]
            weights = np.array([s / (f * c.random) for s, f, c in zip(scales, scatter, covariances, strict=True)]) ** 2
            shape = np.sum(weights * y / scales[:, None], axis=0) / weights.sum(axis=0)
            fits = [
                _fitted(values, replace(c, random=c.random * max(f, 1.0)), shape, slope)
                for values, c, f in zip(y, covariances, scatter, strict=True)
            ]
            scales = np.array([fit.scale for fit in fits])
            off = [v - fit.scale * shape + fit.tilt * slope for v, fit in zip(y, fits, strict=True)]
            scatter, p_scatter = _scatters(off, covariances, weights / weights.sum(axis=0), bool(slope.any()))
            if np.all(np.abs(scales / before - 1.0) < SETTLED):
                break
        if again == 0:
            slope = slope_in_plane(replace(at, brdf=shape))
    v_scales, v_zeros = np.zeros((k, k)), np.zeros((k, k))
    for a in range(k):
        for b in range(k):
            v_scales[a, b], v_zeros[a, b] = _between(fits[a], fits[b], keys[a], keys[b], same=a == b)
    tilts = np.array([fit.tilt / fit.scale if np.isfinite(fit.variance[1]) else np.nan for fit in fits])
    v_zeros /= np.outer(scales, scales)
    return _Solution(shape, scales, v_scales, tilts, v_zeros, scatter, p_scatter)


def _ratio(values: Floats, shape: Floats) -> float:
    """A first guess of a scale; above 0."""
    used = (values > 0.0) & (shape > 0.0)
    return float(np.median(values[used] / shape[used])) if used.any() else 1.0


def _at_the_shape(one: _Found, expected: Floats) -> Covariance:
    """The covariance that a laboratory would state of the expected values.

    What it states of measured ones goes with their noise, and would give low values more weight. How uncertainties go
    with values the table shows.
    """
    c, y = one.covariance, one.value
    used = (y > 0.0) & (expected > 0.0)
    factor = np.where(used, np.clip(expected / np.where(used, y, 1.0), 1.0 / FACTOR, FACTOR), 1.0)
    power = 0.0
    if np.count_nonzero(used) > 2:
        x, r = np.log(expected[used]), np.log(c.random[used])
        spread = float(np.var(x))
        power = float(np.clip(np.mean((x - x.mean()) * (r - r.mean())) / spread, 0.0, 1.0)) if spread > 1e-4 else 1.0
    scaled = c.scaled(factor)
    return Covariance(c.random * factor**power, scaled.common, c.causes)


@dataclass(frozen=True)
class _Fit:
    """A laboratory's values by a shape and its slope."""

    scale: float
    tilt: float
    """The scale times the zero [rad]."""
    variance: Floats
    """Of both; infinite of a tilt that is undetermined."""
    of_causes: Floats
    """(2, causes) what one standard deviation of each cause does to both."""


def _fitted(values: Floats, covariance: Covariance, shape: Floats, slope: Floats) -> _Fit:
    columns = np.column_stack([shape, -slope])
    causes = covariance.whiten(covariance.common) if covariance.causes else np.zeros((values.size, 0))
    target = covariance.whiten(values)
    for used in (2, 1):
        if used == 2 and (values.size < 4 or not slope.any()):
            continue
        white = covariance.whiten(columns[:, :used])
        size = np.linalg.norm(white, axis=0)
        if used == 2 and np.linalg.cond(white / size) > 1e6:
            continue
        solver = np.linalg.pinv(white)
        variance = np.sum(solver**2, axis=1)
        if used == 2 and np.sqrt(variance[1]) > UNDETERMINED * abs(float((solver @ target)[0])):
            continue
        found = np.zeros(2)
        found[:used] = solver @ target
        of_causes, of_both = np.zeros((2, causes.shape[1])), np.full(2, np.inf)
        of_causes[:used], of_both[:used] = solver @ causes, variance
        return _Fit(float(found[0]), float(found[1]), of_both, of_causes)
    raise AssertionError  # one column alone always goes


def _between(a: _Fit, b: _Fit, keys_a: Sequence[Any], keys_b: Sequence[Any], *, same: bool) -> tuple[float, float]:
    """Covariances of two laboratories' scales, and of their tilts."""
    if same:
        return float(a.variance[0]), float(a.variance[1])
    pairs = [(i, keys_b.index(key)) for i, key in enumerate(keys_a) if key in keys_b]
    both = [sum(a.of_causes[p, i] * b.of_causes[p, j] for i, j in pairs) for p in (0, 1)]
    return float(both[0]), float(both[1])


def _scatters(
    off: Sequence[Floats], covariances: Sequence[Covariance], shares: Floats, with_slope: bool
) -> tuple[Floats, Floats]:
    """How many times as much each laboratory scatters as it states, and the probability of as much by chance."""
    k, n = shares.shape
    scatter, p = np.ones(k), np.ones(k)
    if k < 3:
        return scatter, p
    for i, (residual, c) in enumerate(zip(off, covariances, strict=True)):
        free = np.maximum(1.0 - shares[i], 1e-6)
        freedom = float(free.sum()) - (2.0 if with_slope else 1.0) * float(free.mean())
        if freedom < 1.0:
            continue
        squares = Covariance(c.random * np.sqrt(free), c.common, c.causes).chi_square(residual)
        of_all = squares / max(n - (2.0 if with_slope else 1.0), 1.0)
        scatter[i], p[i] = np.sqrt(of_all), float(chdtrc(freedom, freedom * of_all))
    return scatter, p


def _zeros(solved: _Solution, turned: Floats) -> tuple[Floats, Any]:
    """Each laboratory's zero [rad] from that of the consistent ones, NaN where undetermined; which are consistent."""
    total, fine = solved.zeros + turned, np.ones(turned.size, dtype=bool)
    known = np.flatnonzero(np.isfinite(total))
    if known.size < 2:
        return np.full(turned.size, np.nan), fine
    found = equivalence(total[known], solved.v_zeros[np.ix_(known, known)], LEVEL / TESTS)
    fine[known] = found.consistent
    out = np.full(turned.size, np.nan)
    out[known] = found.degrees
    return out, fine


def _relative(found: Equivalence, by: float) -> Equivalence:
    value, u, tau = found.reference
    reference = Consensus(value / by, u / by, tau / by)
    return Equivalence(reference, found.method, found.consistent, found.degrees / by, found.u / by)


def _everywhere(found: Sequence[_Found], keys: Sequence[Sequence[Any]], i: int) -> tuple[Floats, Floats]:
    """The laboratories' values in one direction, and their covariance."""
    x = np.array([one.value[i] for one in found])
    v = np.diag([one.covariance.total[i] ** 2 for one in found])
    for a in range(x.size):
        for b in range(a):
            pairs = [(p, keys[b].index(key)) for p, key in enumerate(keys[a]) if key in keys[b]]
            both = sum(found[a].covariance.common[i, p] * found[b].covariance.common[i, q] for p, q in pairs)
            v[a, b] = v[b, a] = both
    return x, v
