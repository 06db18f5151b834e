"""Numbers in words: how a report prints them."""

import hashlib
import itertools
import math
import re
from collections.abc import Iterable, Sequence

from gonio import shown
from gonio_analysis.result_records import Reflectance

number = shown.number
with_u = shown.with_u

LONGEST_SLUG = 80
"""Characters: names of files are made with several, and have 255."""
SECTIONS = ("conventions", "provenance")
"""Parts of a page that are no sample."""
CAUSES = {
    "combined": "all of them together",
    "random (independent)": "noise, encoder steps: what differs from value to value",
    "reference": "certificate of the white reference",
    "reference noise": "noise of the measurements of the white reference",
    "lamp drift": "drift of the lamp from the first measurement of the reference to the last",
    "theta i zero": "zero of the light arm",
    "theta r zero": "zero of the camera arm",
    "tilt zero": "zero of the holder's tilt",
    "azimuth zero": "zero of the azimuth arm",
    "spin zero": "zero of the holder's spin, of a sample that has a direction",
    "noise": "photons, read noise, rounding and lamp, from frame to frame",
    "dark": "noise of the dark frames",
    "black": "noise that the camera cuts off at black, which small values lack",
    "prnu": "responsivities of the pixels that the reference does not share (photo response non-uniformity)",
    "encoder": "encoders read whole steps",
    "zeros even": "what an axis's zero does to a curved lobe, whichever its sign",
    "spike blur": "a specular spike blurred by errors of the angles",
    "coarse steps": "how steep a lobe may be between the plan's points",
    "region": "curvature of the lobe over the region of interest",
    "lamp wander": "what the lamp may do between measurements of the white reference",
    "visits": "what the lamp may do between measurements of the white reference: what differs from value to value",
    "stray light": "stray light in lens and room",
    "linearity": "departure of the sensor from a straight line",
    "polarisation": "what lamp and lens polarise",
    "wavelength": "centre of the band",
    "bandwidth": "width of the band",
    "beam": "profile of the beam over sample and reference",
    "geometry": "calibrated geometry: zeros, axes, distances, lens",
}
"""What the causes of an uncertainty are that our own reduction budgets (docs/radiometry.md), by their names."""
FILLING = {
    "over": "larger than the region of interest (overfilled)",
    "under": "smaller than the region of interest (underfilled)",
}
"""How large the beam is on the sample, by what the provenance of a table calls it."""
BOTH = ("beam", "dark", "geometry", "polarisation", "prnu")
"""Causes of which a part is common to all values, and each value has a part of its own."""
SHOWN = {
    "dark": "dark frames",
    "prnu": "pixel responsivities",
    "encoder": "encoder resolution",
    "zeros even": "axis zeros, second order",
    "spike blur": "blur of the spike",
    "coarse steps": "lobe between points",
    "region": "region of interest",
    "lamp wander": "lamp instability",
    "visits": "lamp instability",
    "beam": "beam profile",
}
"""How pages name causes where their columns' names would not be understood."""


def _pattern(name: str) -> tuple[str, str]:
    """A cause, and the number behind its name, which tells one independent pattern of an error from others."""
    stem, _, pattern = name.rpartition(" ")
    return (stem, pattern) if pattern.isdigit() and stem in CAUSES else (name, "")


def meaning(name: str, *, common: bool) -> str:
    """What a cause is, in words."""
    stem, pattern = _pattern(name.replace("_", " "))
    if pattern:
        return f"{CAUSES[stem]}: pattern {pattern} of those that values share, the strongest first"
    return CAUSES.get(stem, "") + (": what differs from value to value" if stem in BOTH and not common else "")


def cause(name: str) -> str:
    """The name of a cause as a page has it: that of its column without "s_", angles as Greek letters."""
    stem, pattern = _pattern(name.replace("_", " "))
    words = SHOWN.get(stem, stem).replace("theta i ", "θi ").replace("theta r ", "θr ")
    return f"{words} {pattern}" if pattern else words


def angle(deg: float) -> str:
    """An angle as a page has it, in tenths of a degree: what an encoder reads beside it is no other incidence."""
    return f"{round(deg, 1) + 0.0:g}°".replace("-", "−")


def reasons(what: str, found: Sequence[Reflectance]) -> list[str]:
    """Why reflectances are missing, or what was assumed, and at which angles of incidence, as sentences."""
    why: dict[str, dict[str, None]] = {}
    for r in found:
        if r.why:
            why.setdefault(r.why, {})[angle(r.theta_i_deg)] = None
    out = []
    for reason, at in why.items():
        where = f"θi = {', '.join(at)}" if len(at) <= 8 else f"{len(at)} incidences"
        out.append(f"{what} at {where}: {reason}.")
    return out


def unit(symbol: str) -> str:
    """A unit as a page has it."""
    return {"um": "µm", "deg": "°"}.get(symbol, symbol)


def quantity(value: str, symbol: str) -> str:
    """A printed value with its unit, which stands behind the whole of value ± u."""
    if not symbol or value == "–":
        return value
    return f"({value}) {unit(symbol)}" if "±" in value and not value.startswith("(") else f"{value} {unit(symbol)}"


def slug(name: str) -> str:
    """A name as file names and the identifiers of a page have it; "" of what has no letter of ASCII and no digit."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:LONGEST_SLUG].strip("-")


def model_slugs(names: Iterable[str]) -> dict[str, str]:
    """Models' or parameters' names as file names have them: no two are the same, in whatever script or punctuation."""
    out: dict[str, str] = {}
    for name in names:
        base = _model_slug(name)
        numbered = (f"{base}-{k}" for k in itertools.count(len(out) + 1))
        out[name] = next(one for one in itertools.chain([base], numbered) if one not in out.values())
    return out


def _model_slug(name: str) -> str:
    code = "" if name.isascii() and slug(name) else hashlib.sha256(name.encode()).hexdigest()[:6]
    return f"{slug(name)}-{code}".strip("-")


def slugs(names: Sequence[str]) -> list[str]:
    """Of each name one of its own, which no part of a page and no file of another name has either."""
    out: list[str] = []
    for name in names:
        base = slug(name) or "sample"
        base += "-1" if base in SECTIONS or base.endswith("-all") else ""
        numbered = (f"{base}-{k}" for k in itertools.count(len(out) + 1))
        out.append(next(one for one in itertools.chain([base], numbered) if one not in out))
    return out


def difference(rms_of_logarithm: float | None) -> str:
    """A typical relative difference: in percent, or as a factor where percent would mislead (of ln 0.2 it is 1.22)."""
    if rms_of_logarithm is None:
        return "–"
    if rms_of_logarithm < 0.2:
        return percent(rms_of_logarithm)
    factor = math.exp(min(rms_of_logarithm, 230.0))
    return f"factor {number(factor, 2)}"


def spoken_difference(rms_of_logarithm: float | None) -> str:
    """`difference` within a sentence: "a factor of ..."."""
    words = difference(rms_of_logarithm)
    return f"a {words}" if words.startswith("factor") else words


def cut(text: str, most: int) -> str:
    """A text of at most `most` characters, about; what is left out is said."""
    return text if len(text) <= most else f"{text[:most]} … ({len(text) - most} more characters in summary.json)"


def glued(text: str) -> str:
    """A text whose numbers stay on one line with what belongs to them: 1.2 ± 0.3, 4 × 10⁻⁷, 22 %, θi = 30°."""
    text = re.sub(r"(?<=[\d)]) (?=[±×%])|(?<=[±×<]) (?=[\d−])", "\u00a0", text)
    text = re.sub(r"(?<=\bp) (?=[<=])", "\u00a0", text)
    return re.sub(r"(?<=θ[ir]) = (?=\d)", "\u00a0=\u00a0", text)


def percent(value: float | None) -> str:
    """A fraction in percent, two significant digits."""
    return "–" if value is None else f"{number(100 * value, 2)} %"


def counted(many: int, one: str, more: str = "") -> str:
    """How many there are, in words: "1 value", "2 values"."""
    return f"{many} {one if many == 1 else more or one + 's'}"
