"""Several laboratories' measurements of one sample: a scale, a zero and a scatter each, and who is off.

docs/laboratories.md says how it is judged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gonio.checks.values import Rows
from gonio.errors import ConfigError, DataError
from gonio.progress import Pace, Say, silent
from gonio.typing import DataFrame, Floats
from gonio_analysis.changes.consensus import (
    METHODS,
    CommonShape,
    Consensus,
    Equivalence,
    LaboratoryValues,
    Method,
    common_shape,
    consensus,
    consistency,
    equivalence,
    joint,
)
from gonio_analysis.changes.point_by_point import instead, laid_on
from gonio_analysis.changes.resampling import Carried, carry, turned_in_plane
from gonio_analysis.changes.sides import Side, require_alike
from gonio_analysis.fitting.observations import Observations, Unused, describe_left_out
from gonio_analysis.fitting.value_covariance import Covariance

LEVEL = 0.01
"""Probability that somebody is accused where all are honest."""
TESTS = 3
"""Tests of scales, of zeros and of scatters: they share `LEVEL`."""
AGAIN = 5
"""How often laboratories that are off are turned back and carried again."""
CLOSE = 0.05
"""A zero has settled when a round changes it by less than this share of its uncertainty."""
OF_CALIBRATIONS = {
    "geometry": ("geometry",),
    "camera": ("linearity", "stray_light"),
    "light": ("beam", "wavelength", "bandwidth"),
}
"""What the names of the causes of a kind of calibration begin with. Of polarisation it gives a bound alone: its columns
are patterns of one run."""


@dataclass(frozen=True)
class LaboratoryVerdict:
    """What a laboratory's values say of it, against all laboratories together."""

    name: str
    source: str
    scale: float
    """Its values over the consensus."""
    u_scale: float
    """Standard uncertainty of its scale by everything that it states."""
    degree: float
    """Degree of equivalence: its scale less 1."""
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
class LaboratoryComparison:
    """Laboratories compared in the directions that all of them have."""

    laboratories: tuple[LaboratoryVerdict, ...]
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


def compared(
    sides: Sequence[Side],
    shared: Mapping[str, Sequence[str] | None],
    *,
    wavelength_nm: float | None = None,
    say: Say = silent,
) -> LaboratoryComparison:
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
    sides, notes = _ready(sides, wavelength_nm, say)
    keys, in_words = _keys(sides, shared)
    base, rows, first = _common(sides, say)
    for side, one in zip(sides, first, strict=True):
        if not one.value.sum() > 0.0:
            raise DataError(f"{side.source}: its {rows.size} common values are not above 0: they tell no scale")
    say(f"comparing: {len(sides)} laboratories in {rows.size} common directions")
    at, first, solved, turned = _settled(sides, sides[base].measured.take(rows), first, keys)
    scales = equivalence(solved.scales, solved.v_scales, LEVEL / TESTS)
    by, relative = scales.reference.value, scales.relative
    alone, by_method, p_alone = _by_directions(first, keys, say)
    chi_square, p = consistency(solved.scales, solved.v_scales)
    return LaboratoryComparison(
        laboratories=_judged(sides, solved, turned, scales, relative),
        sides=tuple(sides),
        at=replace(at, brdf=solved.shape * by),
        values=np.array([one.value for one in first]),
        u=np.array([one.covariance.total for one in first]),
        onto=sides[base].name,
        interpolated=tuple(int(np.count_nonzero(one.error)) for one in first),
        scales=relative,
        methods={m: consensus(solved.scales / by, solved.v_scales / by**2, m) for m in METHODS},
        chi_square=chi_square,
        p_value=p,
        alone=alone,
        alone_by_method=by_method,
        p_alone=p_alone,
        shared=in_words,
        notes=notes,
    )


def _settled(
    sides: Sequence[Side], at: Observations, first: list[LaboratoryValues], keys: Sequence[Sequence[Any]]
) -> tuple[Observations, list[LaboratoryValues], CommonShape, Floats]:
    """Scales, zeros and scatters, with laboratories that are off turned back and carried again until nobody moves.

    What comes out: the common directions, every laboratory's values there as they are, the solution, and by how much
    each was turned [rad].
    """
    found, turned = first, np.zeros(len(sides))
    for _ in range(AGAIN):
        solved = common_shape(at, found, keys)
        zeros, consistent = _zeros(solved, turned)
        wanted = np.where(consistent, 0.0, zeros)
        u = np.sqrt(np.diag(solved.v_zeros))
        if np.all(np.abs(wanted - turned) <= CLOSE * np.where(np.isfinite(u), u, 1.0)):
            break
        again = [_carried(at, side, by)[:2] for side, by in zip(sides, wanted, strict=True)]
        if min(kept.size for kept, _ in again) < len(at):  # what a turned laboratory has no longer goes for all
            some = np.flatnonzero(np.bincount(np.concatenate([kept for kept, _ in again])) == len(sides))
            if some.size < 3:
                break
            again = [(some, one.take(np.searchsorted(kept, some))) for kept, one in again]
            at, first = at.take(some), [one.take(some) for one in first]
        turned, found = wanted, [one for _, one in again]
    return at, first, solved, turned


def _judged(
    sides: Sequence[Side], solved: CommonShape, turned: Floats, scales: Equivalence, relative: Equivalence
) -> tuple[LaboratoryVerdict, ...]:
    """What is said of each laboratory."""
    zeros, zeros_consistent = _zeros(solved, turned)
    likely = solved.p_scatter >= LEVEL / TESTS / len(sides)
    u_scales, u_zeros = (np.sqrt(np.diag(v)) for v in (solved.v_scales, solved.v_zeros))
    return tuple(
        LaboratoryVerdict(
            name=side.name,
            source=side.source,
            scale=float(solved.scales[k] / scales.reference.value),
            u_scale=float(u_scales[k] / scales.reference.value),
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


# ---- what comes in ----


def _ready(sides: Sequence[Side], wavelength_nm: float | None, say: Say) -> tuple[list[Side], tuple[str, ...]]:
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
            data, own = side.data.nearest(wavelength_nm)
            side = replace(side, data=data)
            if abs(own - wavelength_nm) > 1 and (note := instead(own, wavelength_nm)) not in notes:
                notes.append(note)
                say(note)
        if out:
            require_alike(out[0], side)
            data, told = laid_on(out[0].measured, side.measured)
            notes += [f"{side.name}: {text}" for text in told]
            side = replace(side, data=data)
        out.append(side)
    return out, (*notes, *(f"{side.name}: {text}" for side in out for text in side.measured.notes))


def _covariance(side: Side) -> Covariance:
    """The covariance of a side that states one."""
    known = side.measured.covariance
    assert known is not None
    return known


def _keys(sides: Sequence[Side], shared: Mapping[str, Sequence[str] | None]) -> tuple[list[list[Any]], tuple[str, ...]]:
    """What tells each laboratory's causes apart: causes with one key are one and the same; and the shared in words."""
    names, causes = [side.name for side in sides], [_covariance(side).causes for side in sides]
    for cause, which in shared.items():
        unknown = [name for name in which or () if name not in names]
        if unknown:
            raise ConfigError(f"--shared {cause}: there is no laboratory {unknown[0]}; there are {', '.join(names)}")
        for k in (k for k, name in enumerate(names) if name in (which or names) and cause not in causes[k]):
            listed = ", ".join(causes[k]) or "none"
            raise ConfigError(f"--shared {cause}: {sides[k].source} states no such cause; it states {listed}")

    def key(side: Side, cause: str, same: Mapping[str, str]) -> tuple[str, str]:
        which = shared.get(cause, ())
        return ("shared" if which is None or side.name in which else same.get(cause, side.name)), cause

    stems = [_same_things(side.table) for side in sides]
    keys = [[key(side, c, same) for c in known] for side, known, same in zip(sides, causes, stems, strict=True)]
    words = dict[Any, list[str]]()
    for name, of_one in zip(names, keys, strict=True):
        for one in of_one:
            words.setdefault(one, []).append(name)
    return keys, tuple(f"{one[1]} ({', '.join(who)})" for one, who in words.items() if len(who) > 1)


def _same_things(table: DataFrame | None) -> dict[str, str]:
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


def _common(sides: Sequence[Side], say: Say) -> tuple[int, Rows, list[LaboratoryValues]]:
    """In whose directions the most values are shared, which of them, and every laboratory's values there.

    Values that are interpolated from fewer count as those: they share their noise.
    """
    best: tuple[tuple[int, float], int, Rows, list[tuple[Rows, LaboratoryValues]]] | None = None
    least = (np.inf, "", "", "")
    for base, still in enumerate(sides):
        of_all, rough, sources = still.measured, 0.0, len(still.measured)
        each = list[tuple[Rows, LaboratoryValues]]()
        for side in sides:
            if side is still:
                each.append(
                    (np.arange(len(of_all)), LaboratoryValues(of_all.brdf, _covariance(still), np.zeros(len(of_all))))
                )
                continue
            rows, found, carried = _carried(of_all, side, 0.0, say)
            each.append((rows, found))
            rough += float(np.sum(carried.relative_error))
            sources = min(sources, carried.sources)
            if rows.size < least[0]:
                least = (rows.size, still.source, side.source, describe_left_out(carried.missing))
        counts = np.bincount(np.concatenate([rows for rows, _ in each]), minlength=len(of_all))
        rows = np.flatnonzero(counts == len(sides))
        score = min(rows.size, sources), -rough
        if best is None or score > best[0]:
            best = (score, base, rows, each)
    assert best is not None
    _, base, rows, each = best
    if not rows.size:
        raise DataError(
            f"there is no direction that all {len(sides)} laboratories have; {least[1]} and {least[2]} share the "
            f"fewest: of the values of {least[1]}, {least[3] or 'none is in a direction of all others'}"
        )
    return base, rows, [one.take(np.searchsorted(kept, rows)) for kept, one in each]


def _carried(at: Observations, side: Side, turn: float, say: Say = silent) -> tuple[Rows, LaboratoryValues, Carried]:
    """A laboratory's values in other directions, its angles reading too large by `turn` [rad]; and which these are."""
    data = side.measured
    if turn:
        directions, above = turned_in_plane(data.directions, -turn)
        data = replace(data, directions=directions, unused=Unused()).take(above)
    found = carry(at, data, say)
    covariance = Covariance(np.hypot(found.random, found.error), found.common, _covariance(side).causes)
    return found.rows, LaboratoryValues(found.value, covariance, found.error), found


def _zeros(solved: CommonShape, turned: Floats) -> tuple[Floats, Any]:
    """Each laboratory's zero [rad] from that of the consistent ones, NaN where undetermined; which are consistent."""
    total = solved.zeros + turned
    out, fine = np.full(turned.size, np.nan), np.ones(turned.size, dtype=bool)
    known = np.flatnonzero(np.isfinite(total))
    if known.size > 1:
        found = equivalence(total[known], solved.v_zeros[np.ix_(known, known)], LEVEL / TESTS)
        out[known], fine[known] = found.degrees, found.consistent
    return out, fine


def _by_directions(
    found: Sequence[LaboratoryValues], keys: Sequence[Sequence[Any]], say: Say
) -> tuple[tuple[Equivalence, ...], dict[Method, tuple[Consensus, ...]], Floats]:
    """`LaboratoryComparison.alone`, `alone_by_method` and `p_alone`: each direction for itself."""
    values, pace = np.array([one.value for one in found]).T, Pace("comparing: directions", found[0].value.size, say)
    alone, by_method, p = list[Equivalence](), list[tuple[Consensus, ...]](), list[float]()
    for i, x in enumerate(values):
        pace.step(i)
        v = joint([one.covariance.common[i] for one in found], [one.covariance.total[i] ** 2 for one in found], keys)
        alone.append(equivalence(x, v, LEVEL))
        by_method.append(tuple(consensus(x, v, m) for m in METHODS))
        p.append(consistency(x, v)[1])
    return tuple(alone), dict(zip(METHODS, zip(*by_method, strict=True), strict=True)), np.array(p)
