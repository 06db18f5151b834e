"""What samples beside each other differ by, in plain sentences: at most two for the verdict, and more for details."""

import math
from collections.abc import Sequence

from gonio.shown import number, with_u
from gonio_analysis.curves.lobes import GRAZING, RISE
from gonio_analysis.report.across import ALL, AWAY, GRAZE, MIRROR, SOURCE, Across, SampleFactor, SamplePair
from gonio_analysis.report.lobe_pairs import LobeDifference

ALIKE = 0.005
"""A factor within so much of 1 is said as "as bright as"."""
DARKEST, BRIGHTEST = 0.1, 2.0
"""Between these factors a difference is said in percent."""
MOST = 1000.0
"""Contrasts beyond it say how dark the rest is, and no more."""
MIRRORS, MATT = 100.0, 2.0
"""Contrasts of a lobe from which on, and below which, a sample is called mirror-like, and matt."""
FEW = 10
"""Common values that are so few that their number is said."""
WHERE = {
    AWAY: "away from the mirror direction",
    SOURCE: "toward the source (the retro side)",
    MIRROR: "near the mirror direction",
    GRAZE: f"at grazing angles (θr above {math.degrees(GRAZING):g}°)",
}
BEYOND = "they differ beyond their uncertainties"


def verdict(found: Across) -> list[str]:
    """What tells the samples apart, in at most two sentences."""
    pairs = found.pairs
    if len(pairs) == 1:
        return [(f"{_difference(pairs[0])}{_significance(pairs[0])}."), *_of_colour(pairs[0])][:2]
    if len(pairs) == 2:
        return [(f"{_difference(pair)}{_significance(pair)}.") for pair in pairs]
    beyond = [pair.b for pair in pairs if pair.beyond]
    far = [pair for pair in pairs if not pair.missing]
    if not far:
        return [f"None of {len(pairs)} samples can be compared with {pairs[0].a}: {pairs[0].missing}."]
    worst = max(far, key=lambda pair: abs(pair.common.log) if pair.common else 0.0)
    if all(pair.beyond is None for pair in far):
        return [f"{_difference(worst)}{_significance(worst)}.", f"The other samples lie nearer to {worst.a}."]
    head = f"Of {len(pairs)} samples {len(beyond)} differ from {worst.a} beyond their uncertainties"
    return [f"{head}{': ' * bool(beyond)}{', '.join(beyond)}.", (f"{_difference(worst)}.")]


def details(found: Across) -> list[str]:
    """What the verdict rests on, and what it leaves out, in sentences."""
    out = [text for pair in found.pairs for text in _details(pair)]
    if found.left_out:
        out.append(f"{found.left_out} further samples are not compared with the first one.")
    return out


def _difference(p: SamplePair) -> str:
    """The difference as a clause, without its significance."""
    if p.missing or p.common is None:
        return f"{p.a} and {p.b} cannot be compared: {p.missing}"
    if p.kinds:
        said = ", and ".join(f"{name} is {_kind(x)}" for name, x in zip((p.a, p.b), p.kinds, strict=True))
        return f"{p.a} and {p.b} are samples of different kinds: {said}; neither a factor nor a width compares the two"
    if p.beyond is False:
        return f"{p.b} does not differ from {p.a} beyond their uncertainties"
    apart = [one for one in p.levels if one.apart]
    parts = [_level(p, apart)] if p.common.where != MIRROR or p.height is None else []
    parts += _of_lobe(p)
    parts += [f"{WHERE[one.where]} it is {_against_one(one)}" for one in apart]
    if not apart and any(one.apart for one in p.incidences):
        ends = p.incidences[0], p.incidences[-1]
        parts.append(f"that goes from {' to '.join(f'{_plain(x.factor)} at {x.where}' for x in ends)}")
    if p.zero_deg is not None and p.shift_deg is not None:
        way = "farther from" if p.shift_deg.value > 0 else "nearer to"
        parts.append(f"its lobe lies {_degrees(p.shift_deg)} {way} the normal")
    elif p.zero_deg is not None and len(parts) == 1:
        parts.append(f"its angles read {_degrees(p.zero_deg)} {'larger' if p.zero_deg.value > 0 else 'smaller'}")
    if len(parts) == 1 and p.beyond and not _stands(p.common) and not any(one.apart for one in p.colour):
        return f"{parts[0]}, but single directions differ, most at {p.worst}"
    at = f"At {p.wavelength_nm:g} nm " if any(one.apart for one in p.colour) else ""
    return at + _joined(parts)


def _level(p: SamplePair, apart: Sequence[SampleFactor]) -> str:
    """The common factor, and where it holds."""
    assert p.common is not None
    if p.values < FEW:
        where = f"in the {p.values} directions that both have"
    elif p.everywhere:
        where = "at all angles"
    elif p.lobe_of and p.common.where == AWAY:
        where = "away from the lobe"
    else:
        where = "at most angles" if apart else "on the average"
    return f"{p.b} is {_against_one(p.common, p.a)} {where}"


def _against_one(one: SampleFactor, than: str = "") -> str:
    """A factor in words, where it is one."""
    return brighter(one.factor if _stands(one) else 1.0, than)


def _stands(one: SampleFactor) -> bool:
    return math.isnan(one.u) or abs(one.factor - 1.0) > 2.0 * one.u


def _of_lobe(p: SamplePair) -> list[str]:
    """What is said of the lobe."""
    if len(p.lobe_of) == 1:
        with_lobe = p.lobe_of[0]
        times = max((x.contrast_b if with_lobe == p.b else x.contrast_a) for x in p.lobes)
        said = f"a lobe in the mirror direction, up to {number(times, 2)} times as bright as the rest"
        return [f"it has {said}, which {p.a} has not" if with_lobe == p.b else f"it lacks what {p.a} has, {said}"]
    wide = p.width_deg if p.width_deg is not None and p.width_deg.stands else None
    said = f"{_degrees(wide)} {'wider' if wide.value > 0 else 'narrower'}" if wide else ""
    whose = f"{p.b}'s lobe is" if p.common is not None and p.common.where == MIRROR else "its lobe is"
    if p.height is None or not p.height.stands:
        return [f"{whose} {said}"] if wide else []
    ratio = math.exp(p.height.value)
    if p.conserved:
        return [f"{whose} {said}, and its maximum therefore {_high(ratio)}"]
    return [f"{whose} {_high(ratio)}" + (f" and {said}" if wide else "")]


def _high(ratio: float) -> str:
    if ratio >= BRIGHTEST or ratio < DARKEST:
        return f"{number(ratio, 2)} times as high"
    return f"{number(100 * abs(ratio - 1.0), 2)} % {'higher' if ratio > 1.0 else 'lower'}"


def brighter(factor: float, than: str = "") -> str:
    """A factor in words, as "12 % darker than A" or "3.1 times as bright as A"."""
    if abs(math.log(max(factor, 1e-12))) < ALIKE:
        return f"as bright{f' as {than}' * bool(than)}"
    if factor >= BRIGHTEST or factor < DARKEST:
        return f"{number(factor, 2)} times as bright{f' as {than}' * bool(than)}"
    return f"{_plain(factor)}{f' than {than}' * bool(than)}"


def _plain(factor: float) -> str:
    """A factor without whom it is against."""
    if factor >= BRIGHTEST or factor < DARKEST:
        return f"{number(factor, 2)} times as bright"
    return f"{number(100 * abs(factor - 1.0), 2)} % {'brighter' if factor > 1.0 else 'darker'}"


def _degrees(x: LobeDifference) -> str:
    """A difference of angles, to a digit that its uncertainty leaves."""
    digits = 2 if abs(x.value) < 10 else 3
    return f"{number(abs(x.value), digits)}°"


def _kind(contrast: float) -> str:
    if contrast < max(MATT, RISE):
        return "matt"
    many = f"over {MOST:g}" if contrast > MOST else number(contrast, 2)
    kind = "mirror-like" if contrast >= MIRRORS else "glossy"
    return f"{kind} (its lobe is {many} times as bright as the rest)"


def _joined(parts: Sequence[str]) -> str:
    if len(parts) < 3:
        return " and ".join(parts)
    return f"{', '.join(parts[:-1])} and {parts[-1]}"


def _significance(p: SamplePair) -> str:
    """The end of the sentence: whether that is beyond the uncertainties."""
    if p.missing:
        return ""
    if p.beyond is None:
        return "; no uncertainties are stated, so nothing says whether that is more than noise"
    assumed = f" (of which {100 * p.assumed:g} % is assumed)" if p.assumed is not None else ""
    if p.beyond:
        exact = f"; {p.unstated[0]} states none, and counts as exact" if p.unstated else ""
        return f"; {BEYOND}{assumed}{exact}"
    limit = p.detectable
    seen = f"; a common factor that is off by {number(100 * limit, 2)} % would be seen" if limit < 1.0 else ""
    few = f" in the {p.values} directions that both have" if p.values < FEW else ""
    return f"{assumed}{few}{seen}"


def _of_colour(p: SamplePair) -> list[str]:
    """How the factor goes with the wavelength, where it does."""
    if not any(one.apart for one in p.colour):
        return []
    low, high = p.colour[0], p.colour[-1]
    ends = " to ".join(f"{_said_level(one)} at {one.where}" for one in (low, high))
    middle = max(p.colour, key=lambda one: abs(one.log - 0.5 * (low.log + high.log)))
    more = "" if middle in (low, high) else f", with {_said_level(middle)} at {middle.where}"
    return [f"Over the wavelengths {p.b} goes from {ends}{more}."]


def _said_level(one: SampleFactor) -> str:
    return "as bright" if abs(one.log) < ALIKE else _plain(one.factor)


def _details(p: SamplePair) -> list[str]:
    if p.missing or p.common is None:
        return []
    both = f"{p.b} over {p.a}"
    at = "" if math.isnan(p.wavelength_nm) else f" at {p.wavelength_nm:g} nm"
    between = f", {p.interpolated} of them by interpolation" if p.interpolated else ""
    out = [f"{both}: {p.values} common values{between}."]
    if p.found_by:
        out.append(f"They differ by {' and '.join(p.found_by)}; the largest difference is at {p.worst}.")
    out.append(f"The factor of {both}{at} is {_factors([p.common, *p.levels])}.")
    if any(one.apart for one in p.incidences):
        out.append(f"By incidence it is {_factors(p.incidences)}.")
    if len(p.colour) > 1:
        out.append(f"By wavelength it is {_factors(p.colour)}.")
    resolved = [x for x in p.lobes if math.isfinite(x.width_a_deg) and math.isfinite(x.width_b_deg)]
    if resolved and p.width_deg is not None:
        shown = ", ".join(
            f"{_width(x.width_a_deg, x.u_width_a_deg)} and {_width(x.width_b_deg, x.u_width_b_deg)} at θi ="
            f" {x.theta_i_deg:.3g}°"
            for x in resolved[:4]
        )
        out.append(
            f"Full widths of the lobes at half of their height above the rest, {p.a} and {p.b}: {shown}; the"
            f" difference is {_with(p.width_deg)}°."
        )
    elif p.unresolved:
        out.append(f"The widths of the lobes are not compared: {p.unresolved}.")
    if p.height is not None:
        out.append(f"The ratio of the lobes' maxima is {number(math.exp(p.height.value), 3)}.")
    if p.shift_deg is not None:
        out.append(f"The lobe's maximum moves by {_with(p.shift_deg)}°.")
    if p.beyond is None:
        out.append("--u-rel 0.03 assumes an uncertainty of 3 % of each value.")
    return out


def _factors(levels: Sequence[SampleFactor]) -> str:
    named = WHERE | {AWAY: "away from the lobe", ALL: "over all values"}
    once = {named.get(one.where, f"at {one.where}"): one for one in levels}
    return ", ".join(f"{_with_u(one.factor, one.u)} {where}" for where, one in once.items())


def _with_u(value: float, u: float) -> str:
    return number(value, 3) if math.isnan(u) else with_u(value, u)


def _with(x: LobeDifference) -> str:
    return _with_u(x.value, x.u)


def _width(value: float, u: float) -> str:
    return f"{number(value, 3)}°" if math.isnan(u) else f"({with_u(value, u)})°"
