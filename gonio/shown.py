"""Numbers in words, with their uncertainties, and how results show themselves at a prompt and in a notebook."""

import math
import re
from collections.abc import Sequence
from html import escape

SMALL = 1e-4
"""Numbers below this have a power of ten."""
SHARPEST = 1e-12
"""An uncertainty below this share of its value is rounding; with it nobody wants all digits of the value."""


_UNSEEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]")
"""What no page, terminal or drawing shows as a character: control characters, signs that turn the direction of the
text that follows, halves of characters, and no characters. Tabs and ends of lines are none of them."""


def visible(text: str) -> str:
    """A text where people read it: what would act on the page or the terminal, or end it, stands there as its code."""
    return _UNSEEN.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def one_line(error: Exception, most: int = 80) -> str:
    """What a library says of a file that it cannot read, in one line of at most so many characters."""
    return visible(" ".join(str(error).split())[:most])


def marked(name: str, simulated: bool) -> str:
    """A sample's name where people read it: simulated values are called so wherever they are named."""
    return name + " (simulated)" * simulated


def number(value: float | None, digits: int = 3) -> str:
    """A number to a few significant digits, without needless zeros of an exponent; a dash for None."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if 1e-4 <= abs(value) < 10**6:
        return _plain(value, max(0, digits - 1 - math.floor(math.log10(abs(value)))))
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return _minus(f"{mantissa} × 10{_superscript(int(exponent))}")


def with_u(value: float | None, u: float | None) -> str:
    """value ± u, both rounded to the second significant digit of u: the one way in which the program says them."""
    if value is None or not math.isfinite(value):
        return "–"
    if u is None or not math.isfinite(u):
        return f"{number(value)} (not determined)"
    if u <= 0 or u < SHARPEST * abs(value):
        return number(value, 5) + (f" ± {number(u, 2)}" if u > 0 else "")
    if value == 0 and u < SMALL:
        return f"0 ± {number(u, 2)}"
    (first, second), power = _alike((value, u), u)
    return f"({first} ± {second}){power}" if power else f"{first} ± {second}"


def apart(value: float, u: float | None) -> tuple[str, str]:
    """The two numbers of `with_u`, for columns of a table; without an uncertainty five digits and nothing."""
    if not u or not math.isfinite(u) or not math.isfinite(value) or u < SHARPEST * abs(value):
        return number(value, 5), ""
    (first, second), power = _alike((value, u), u)
    return first + power, second + power


def interval(low: float, high: float, value: float) -> tuple[str, str, str]:
    """The ends of an interval and the value in it, to the second digit of the nearer end's distance from the value.

    An end that lies on the value (a bound) has no distance of its own; one that lies very near to it counts as a
    hundredth of the interval.
    """
    width = high - low
    if not math.isfinite(width) or width <= SHARPEST * max(abs(low), abs(high)):
        return number(low, 5), number(high, 5), number(value, 5)
    nearer = min((end for end in (value - low, high - value) if end > width * SHARPEST), default=width)
    first_digits = (10.0 * abs(end) for end in (low, high) if abs(end) > 1e-4 * width)  # an end above 0 looks so
    words, power = _alike((low, high, value), min(max(nearer, width / 100), *first_digits))
    first, second, third = (word + power if one else "0" for word, one in zip(words, (low, high, value), strict=True))
    return first, second, third


def value(number: float, u: float | None = None, unit: str = "") -> str:
    """A value with its standard uncertainty, if it has one, and its unit."""
    text = with_u(number, u) if u and math.isfinite(u) and math.isfinite(number) else f"{number:.5g}"
    return f"{text} {'µm' if unit == 'um' else unit}".strip()


def _alike(values: Sequence[float], resolution: float) -> tuple[list[str], str]:
    """Numbers to the second significant digit of a resolution, and the power of ten that belongs behind all of them."""
    digit = int(f"{resolution:.1e}".split("e")[1])  # after rounding: 0.0996 has its first digit where 0.1 has it
    top = max(map(abs, (*values, resolution)))
    power = math.floor(math.log10(top))
    power = 0 if SMALL <= top < 10**6 else power
    decimals = 1 - digit + power
    words = [_plain(round(one / 10.0**power, decimals) + 0.0, max(decimals, 0)) for one in values]
    return words, f" × 10{_superscript(power)}" if power else ""


def _plain(value: float, decimals: int) -> str:
    return _minus(f"{value:,.{decimals}f}".replace(",", "\u00a0"))


def _minus(text: str) -> str:
    return text.replace("-", "−")


def _superscript(power: int) -> str:
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def html(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], words: Sequence[str]) -> str:
    """A heading, a table and sentences, for a notebook."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    said = "".join(f"<p>{escape(text)}</p>" for text in words)
    return f"<p><b>{escape(title)}</b></p><table><tr>{head}</tr>{body}</table>{said}"


def finite(value: float | None) -> float | None:
    """A number as JSON has it: None for what is not finite."""
    return None if value is None or not math.isfinite(value) else float(value)
