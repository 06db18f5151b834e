"""Samples beside each other, without models: how much brighter one is, in which directions, and whose lobe is wider.

The first sample is held against every other one, point by point (`gonio_analysis.changes.point_by_point`): whether
they differ beyond their uncertainties is what that says. What they differ by is looked for in this order. Lobes are
measured in each sample's own curves (`gonio_analysis.curves.lobes`). Outside the lobes one generalised least-squares
fit has a factor for each region of directions, beside the zeros of the arms that were found: toward the source, around
the mirror direction where there is no lobe, at grazing angles, and away from all of these. A lobe that is wider and
lower, and holds as much light, is no region of its own.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gonio.errors import DataError
from gonio.geometry import AROUND_MIRROR, SAME_ANGLE, angle_between, groups
from gonio.progress import Say, silent
from gonio.typing import Floats, Ints
from gonio_analysis.changes.point_by_point import Change, change, laid_on
from gonio_analysis.changes.resampling import RowsAt, common_wavelengths
from gonio_analysis.changes.sides import Side
from gonio_analysis.curves.in_plane import evenly
from gonio_analysis.curves.lobes import GRAZING, NEAR_SOURCE
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.value_covariance import Covariance
from gonio_analysis.report.lobe_pairs import MOST_CURVES, LobeDifference, LobePair, Lobes, stands

MOST_PAIRS = 8
"""Samples that the first one is held against."""
MOST_VALUES = 200_000
"""Values of both, above which the wavelength that is shown is compared alone."""
FEWEST = 3
"""Values that a factor of its own is made of."""
LEAST, SHARE = 0.03, 0.25
"""A region is named where its factor is off by so much of its logarithm, and by so much of the common one's."""
LEAST_WIDTH, LEAST_HEIGHT = 0.04, 0.05
"""Shares of a lobe's width and height that are worth words."""
LEAST_SHIFT_DEG = 0.05
AS_MUCH = 0.2
"""ln of height times width squared, within which a lobe that is wider holds as much light as the factor says: lobes of
microfacets have tails beside their width."""
KINDS, BASES, OPPOSITE = math.log(30.0), math.log(2.0), math.log(3.0)
"""Samples are of different kinds where their lobes' contrasts differ by the first, and their levels away from the lobe
by the second; or where one is brighter in the lobe and darker elsewhere, by the third each."""
BRIGHT = 2.0
"""Beyond this factor differences over means no longer tell it."""
RETRO = math.radians(6.0)
"""A retro lobe is sought so near to the source: most are a few degrees wide; farther off where few values are there."""
CLEAR = 2.0
"""Values have a logarithm where they are above so many standard uncertainties."""
WIDEST = math.radians(45.0)
"""A lobe takes no more than this around the mirror direction from the other directions."""
ALL, AWAY, SOURCE, MIRROR, GRAZE = "all", "away", "source", "mirror", "grazing"


@dataclass(frozen=True)
class SampleFactor:
    """A factor, B over A, of some of the directions or of a wavelength."""

    where: str
    """`ALL`, `AWAY`, `SOURCE`, `MIRROR`, `GRAZE`, or in words."""
    values: int
    factor: float
    u: float
    """Standard uncertainty, with what its values scatter by beyond what they state."""
    noise: float
    """The part of it that is stated; `u` where nothing is."""
    apart: bool = False
    """Whether it differs from the common factor."""

    @property
    def log(self) -> float:
        """ln of the factor."""
        return math.log(max(self.factor, 1e-12))


@dataclass(frozen=True)
class SamplePair:
    """One sample, B, held against the first, A."""

    a: str
    b: str
    missing: str = ""
    """Why nothing is compared, in words; all that follows is then empty."""
    values: int = 0
    """Values that both have, at all wavelengths."""
    interpolated: int = 0
    wavelength_nm: float = math.nan
    """At which factors and lobes are told; NaN in a broad band."""
    beyond: bool | None = None
    """Whether they differ beyond their uncertainties; None where none are stated."""
    found_by: list[str] = field(default_factory=list)
    unstated: list[str] = field(default_factory=list)
    """Samples that state no uncertainties."""
    assumed: float | None = None
    """Relative uncertainty that somebody assumes."""
    agree_within: float = 0.0
    """Relative standard deviation of the differences beyond what is stated."""
    detectable: float = math.nan
    """A common factor that would be found in 9 of 10 cases, less 1."""
    common: SampleFactor | None = None
    """The common factor: of all directions, or of those away from the lobe and from what stands apart."""
    everywhere: bool = False
    """Whether it holds at all angles that were measured."""
    levels: list[SampleFactor] = field(default_factory=list)
    incidences: list[SampleFactor] = field(default_factory=list)
    colour: list[SampleFactor] = field(default_factory=list)
    """By wavelength, where there are several."""
    lobes: list[LobePair] = field(default_factory=list)
    lobe_of: list[str] = field(default_factory=list)
    """Which of the two have a lobe."""
    unresolved: str = ""
    """Why the lobes' widths are not compared, in words."""
    width_deg: LobeDifference | None = None
    """Full width at half height."""
    height: LobeDifference | None = None
    """ln of the ratio of the largest values near the mirror direction."""
    conserved: bool = False
    """Whether a wider lobe is lower by what its width asks for."""
    shift_deg: LobeDifference | None = None
    """Of the maximum; positive away from the normal."""
    zero_deg: LobeDifference | None = None
    """By how much B's angle reads larger, as `--change` finds it."""
    kinds: list[float] = field(default_factory=list)
    """Contrasts of both, where they are of different kinds; else empty."""
    worst: str = ""
    """Where the largest difference is, in words."""
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Across:
    """What is said of several samples without models."""

    pairs: list[SamplePair]
    left_out: int = 0
    """Samples that were not compared: `MOST_PAIRS` are."""


def across(sides: Sequence[Side], *, wavelength_nm: float | None = None, say: Say = silent) -> Across:
    """Hold the first of several measurements against every other one.

    Parameters
    ----------
    sides
        See `gonio_analysis.changes.sides.of_table`.
    wavelength_nm
        The nearest common wavelength is the one that factors and lobes are told at (550 nm if none is given).
    say
        Called with a line now and then, where it takes long.
    """
    first, others = sides[0], sides[1 : MOST_PAIRS + 1]
    return Across([_pair(first, b, wavelength_nm, say) for b in others], len(sides) - 1 - len(others))


def _pair(a: Side, b: Side, wavelength_nm: float | None, say: Say) -> SamplePair:
    both = a.measured, b.measured
    if why := _nothing_common(a, b):
        return SamplePair(a.title, b.title, missing=why)
    alone = wavelength_nm or 550.0 if len(both[0]) + len(both[1]) > MOST_VALUES else None
    try:
        c = change(a, b, wavelength_nm=alone, say=say)
    except DataError as error:
        return SamplePair(a.title, b.title, missing=str(error))
    shown = c.at.nearest(wavelength_nm)[1]
    here = narrowed(c, RowsAt(c.at.wavelength_nm).at(shown))
    lobes = Lobes.of(*(_nearest(x, shown) for x in (both[0], laid_on(*both)[0])))
    verdict = c.verdict
    assumed = {x.u_rel_assumed for x in both if x.u_rel_assumed is not None}
    out = SamplePair(
        a.title, b.title, values=len(c.at), interpolated=int(np.count_nonzero(c.error)), wavelength_nm=shown,
        beyond=None if verdict is None else verdict.changed and not c.identical,
        found_by=[] if verdict is None else verdict.found_by,
        unstated=[side.title for side in (a, b) if side.measured.covariance is None],
        assumed=min(assumed, default=None), agree_within=c.within.as_they_are,
        detectable=math.nan if verdict is None else verdict.factor.detectable, notes=list(c.notes),
        worst=_worst(c),
    )  # fmt: skip
    return _kinds(_shapes(replace(out, colour=_colour(c), lobes=lobes.each), here, lobes), lobes)


def _nothing_common(a: Side, b: Side) -> str:
    """What is missing for a comparison, in words; "" where wavelength and incidence are common."""
    one, other = a.measured, b.measured
    if not common_wavelengths(one, other):
        have = (f"{x.title} has {_listed(x.measured.wavelengths)}" for x in (a, b))
        return f"they have no wavelength in common: {', '.join(have)}"
    tilts = [np.unique(np.round(np.degrees(x.directions.theta_i), 1)).astype(np.float64) for x in (one, other)]
    if np.abs(tilts[0][:, None] - tilts[1]).min() > np.degrees(SAME_ANGLE):
        have = (f"{x.title} has θi = {_some(t)}" for x, t in zip((a, b), tilts, strict=True))
        return f"they have no angle of incidence in common: {', '.join(have)}"
    return ""


def _listed(waves: Sequence[float]) -> str:
    named = [f"{w:g}" for w in waves if not math.isnan(w)]
    shown = named if len(named) <= 4 else [*named[:2], "…", named[-1]]
    return f"{', '.join(shown)} nm" if named else "a broad band without a wavelength"


def _some(tilts: Floats) -> str:
    shown = [f"{t:g}°" for t in tilts]
    return ", ".join(shown if len(shown) <= 4 else [*shown[:2], "…", shown[-1]])


def narrowed(c: Change, rows: Ints) -> Change:
    """A comparison in some of its directions."""
    known = c.covariance
    if known is not None:
        known = Covariance(known.random[rows], known.common[rows], known.causes)
    values = {name: getattr(c, name)[rows] for name in ("value_a", "value_b", "u_a", "u_b", "error")}
    return replace(c, at=c.at.take(rows), covariance=known, **values)


def _nearest(data: Observations, shown: float) -> Observations:
    return data if math.isnan(shown) else data.nearest(shown)[0]


def _shapes(out: SamplePair, c: Change, lobes: Lobes) -> SamplePair:
    """A pair with what both differ by at one wavelength."""
    exist, one_alone = lobes.exist, sum(lobes.exist) == 1
    shift = lobes.found("at", math.radians(LEAST_SHIFT_DEG))
    zeros = {angle: zero for angle, zero in (c.verdict.zeros if c.verdict else {}).items() if zero.found}
    if one_alone or (shift is not None and not shift.stands):
        zeros = {}  # what a lobe of another shape looks like to them
    regions = _regions(c.at, min(max(AROUND_MIRROR, 1.25 * lobes.widest), WIDEST))
    if one_alone or lobes.differences("height")[0].size:
        regions.pop(MIRROR, None)
    levels = _levels(c, regions, [c.zeros[angle] for angle in zeros])
    unknown = SampleFactor(MIRROR, 0, 1.0, math.nan, math.nan)
    common = max(levels, key=lambda one: (one.where == AWAY, one.values), default=unknown)
    levels = [replace(one, apart=_apart(one, common)) for one in levels]
    known = common.log, 0.0 if math.isnan(common.u) else common.u / common.factor
    height, width = lobes.found("height", LEAST_HEIGHT, known), lobes.found("width", LEAST_WIDTH * lobes.widest)
    if not levels and height is not None:
        ratio = math.exp(height.value)
        common = SampleFactor(MIRROR, len(lobes.pairs), ratio, ratio * height.u, ratio * height.u)
    elif not levels:
        if not (few := _levels(c, {ALL: np.arange(len(c.at))}, fewest=1)):
            return replace(out, missing="their common values are lost in noise")
        return replace(out, common=few[0])
    rest = [regions[one.where] for one in levels if not one.apart]
    incidences = _apart_each(_levels(c, _by_incidence(c.at, np.concatenate(rest)))) if rest else []
    conserved = bool(width and height and width.stands and height.stands and _holds_as_much(lobes, common))
    everywhere = bool(levels) and not one_alone and not any(one.apart for one in (*levels, *incidences))
    everywhere &= height is None or not height.stands or conserved
    if everywhere and not any(x is not None and x.stands for x in (height, width)):
        common = _whole(c, common)
    why = next((x.why for pair in lobes.pairs for x in pair if x.exists and x.why), "")
    return replace(
        out, common=common, levels=levels, incidences=incidences, everywhere=everywhere, conserved=conserved,
        lobe_of=[name for name, there in zip((out.a, out.b), exist, strict=True) if there],
        unresolved=why if any(exist) and width is None else "",
        height=height, width_deg=_in_degrees(width), shift_deg=_in_degrees(shift),
        zero_deg=next((LobeDifference(math.degrees(x.value), math.degrees(x.u), True) for x in zeros.values()), None),
    )  # fmt: skip


def _in_degrees(x: LobeDifference | None) -> LobeDifference | None:
    return None if x is None else LobeDifference(math.degrees(x.value), math.degrees(x.u), x.stands)


def _whole(c: Change, common: SampleFactor) -> SampleFactor:
    """The common factor of all values, as `--change` has it."""
    v = c.verdict
    if v is not None and v.u_scale < BRIGHT and 1.0 / BRIGHT < 1.0 + v.scale < BRIGHT:
        return SampleFactor(ALL, len(c.at), 1.0 + v.scale, v.u_scale, v.u_scale)
    return common


def _regions(at: Observations, around: float) -> dict[str, Ints]:
    """Rows by region: what lies near the mirror direction, the source, the horizon, and away from all of them.

    Where mirror direction and source lie too near to each other, the mirror direction comes first.
    """
    d = at.directions
    source, receiver = d.vectors
    from_mirror, from_source = d.mirror_offset, angle_between(source, receiver)
    mirror = from_mirror <= around
    around_source = ~mirror & (from_source <= NEAR_SOURCE)
    toward = around_source & (from_source <= RETRO)
    if np.count_nonzero(toward) < FEWEST:
        toward = around_source
    graze = ~mirror & ~around_source & (d.theta_r >= GRAZING)
    found = {AWAY: ~(mirror | around_source | graze), SOURCE: toward, GRAZE: graze, MIRROR: mirror}
    return {name: rows for name, some in found.items() if (rows := np.flatnonzero(some)).size >= FEWEST}


def _by_incidence(at: Observations, rows: Ints) -> dict[str, Ints]:
    d = at.directions
    tilts = np.round(np.degrees(d.theta_i), 1)
    every = [rows[tilts[rows] == t] for t in np.unique(tilts[rows])]
    if len(every) > 1 and np.diff(np.unique(tilts[rows])).min() < np.degrees(SAME_ANGLE):  # readings of an encoder
        every = [np.intersect1d(g, rows) for g in groups(d.theta_i, np.zeros(len(at)), rows)]
    kept = [g for g in every if g.size >= FEWEST]
    chosen = [kept[k] for k in evenly(len(kept), MOST_CURVES)] if len(kept) > 1 else []
    return {f"θi = {float(np.median(tilts[g])):g}°": g for g in chosen}


def _levels(
    c: Change, regions: Mapping[str, Ints], beside: Sequence[Floats] = (), fewest: int = FEWEST
) -> list[SampleFactor]:
    """A factor for each group of rows, by one generalised least-squares fit of ln(B/A); columns beside are free too.

    Values that are lost in their noise have no logarithm, and groups with few others no factor. Where values of a group
    scatter more than they state, or state nothing, that counts.
    """
    a, b = c.value_a, c.value_b
    u_a, u_b = (np.nan_to_num(u) for u in (c.u_a, c.u_b))
    clear = (a > CLEAR * u_a) & (b > CLEAR * u_b)
    kept = {name: rows[clear[rows]] for name, rows in regions.items()}
    kept = {name: rows for name, rows in kept.items() if rows.size >= fewest}
    if not kept:
        return []
    rows = np.concatenate(list(kept.values()))
    goal, middle = np.log(b[rows] / a[rows]), 0.5 * (a + b)[rows]
    known, stated = Covariance(np.ones(rows.size), np.zeros((rows.size, 0))), np.zeros(rows.size)
    if c.covariance is not None:
        common = c.covariance.common[rows] / middle[:, None]
        total = (u_a / a)[rows] ** 2 + (u_b / b)[rows] ** 2 + (c.error / np.minimum(a, b))[rows] ** 2
        random = np.sqrt(np.maximum(total - (common**2).sum(axis=1), 0.01 * total + 1e-12))
        known, stated = Covariance(random, common, c.covariance.causes), random**2
    ends = np.cumsum([0, *(one.size for one in kept.values())])
    columns = np.repeat(np.eye(len(kept)), [one.size for one in kept.values()], axis=0)
    whole = np.column_stack([columns, *(column[rows] / middle for column in beside)])
    white = known.whiten(whole)
    found = np.linalg.lstsq(white, known.whiten(goal), rcond=None)[0]
    inverse = np.linalg.pinv(white.T @ white)
    rest, out = goal - whole @ found, []
    for k, name in enumerate(kept):
        some, n = slice(ends[k], ends[k + 1]), int(ends[k + 1] - ends[k])
        excess = max(float(rest[some] @ rest[some]) / max(n - 1, 1) - float(stated[some].mean()), 0.0)
        noise = math.sqrt(float(inverse[k, k]))
        u = math.sqrt(excess / n + (0.0 if c.covariance is None else float(inverse[k, k])))
        factor = math.exp(float(np.clip(found[k], -30.0, 30.0)))
        out.append(SampleFactor(name, n, factor, factor * u, factor * (u if c.covariance is None else noise)))
    return out


def _apart(one: SampleFactor, common: SampleFactor) -> bool:
    """Whether the factor of a region differs from the common one. Causes that both share make this cautious."""
    if one is common:
        return False
    u = math.hypot(one.noise / one.factor, common.noise / common.factor)
    return stands(one.log - common.log, u, max(LEAST, SHARE * abs(common.log)))


def _apart_each(levels: Sequence[SampleFactor]) -> list[SampleFactor]:
    """Factors of which some differ from their middle one."""
    if len(levels) < 2:
        return list(levels)
    middle = sorted(levels, key=lambda one: one.factor)[len(levels) // 2]
    return [replace(one, apart=_apart(one, middle)) for one in levels]


def _holds_as_much(lobes: Lobes, common: SampleFactor) -> bool:
    """Whether height times width squared, above what stands beside, is in the common factor."""
    ratios = [
        math.log((y.height - y.base) / (x.height - x.base)) + 2.0 * math.log(y.width / x.width)
        for x, y in lobes.pairs
        if x.exists and y.exists and x.resolved and y.resolved
    ]
    return bool(ratios) and abs(float(np.mean(ratios)) - common.log) <= AS_MUCH


def _colour(c: Change) -> list[SampleFactor]:
    """The factor at each wavelength, of at most `MOST_CURVES`."""
    rows = RowsAt(c.at.wavelength_nm)
    known = [w for w in c.at.wavelengths if not math.isnan(w)]
    waves = [known[k] for k in evenly(len(known), MOST_CURVES)] if len(known) > 1 else []
    regions = {f"{w:g} nm": here for w in waves if (here := rows.at(w)).size >= FEWEST}
    return _apart_each(_levels(c, regions))


def _kinds(out: SamplePair, lobes: Lobes) -> SamplePair:
    """A pair that is told as of different kinds where a factor and a width say nothing of both."""
    if out.missing or not lobes.pairs or not any(lobes.exist):
        return out
    one, other = lobes.contrasts
    heights = [y.height / x.height for x, y in lobes.pairs if x.height > 0.0 and y.height > 0.0]
    if not heights or not (one > 0.0 and other > 0.0):
        return out
    in_lobe, contrast = math.log(float(np.median(heights))), math.log(other / one)
    elsewhere = in_lobe - contrast
    far = abs(contrast) >= KINDS and abs(elsewhere) >= BASES
    opposite = in_lobe * elsewhere < 0.0 and min(abs(in_lobe), abs(elsewhere)) >= OPPOSITE
    return replace(out, kinds=[one, other]) if far or opposite else out


def _worst(c: Change) -> str:
    """Where the largest difference is, as B over A, in words."""
    size = np.abs(c.difference) / c.u if c.covariance is not None else np.abs(c.difference)
    k = int(np.argmax(size))
    theta_i, _, theta_r, _ = (float(np.degrees(x[k])) for x in c.at.directions.angles)
    side = "" if not c.at.directions[k : k + 1].in_plane[0] else (
        " on the mirror side" if c.at.directions.signed[k] > 0 else " on the side of the source")  # fmt: skip
    return f"θi = {theta_i:.3g}°, θr = {theta_r:.3g}°{side}"
