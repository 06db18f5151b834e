"""Numbers in words: their digits follow from the uncertainty, wherever they are said."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from gonio.shown import apart, interval, with_u

ROOT = Path(__file__).parents[2]
HOMES = ("gonio", "analysis", "sim", "drivers")
OF_ITS_OWN = re.compile(r"\{[^{}]*:[^{}]*\} ?(±|\+-)|(±|\+-) ?\{[^{}]*:[.][^{}]*\} ?(?!/|;|,)")
"""A value or an uncertainty beside ± with a number of digits that somebody chose there."""


def _read(words: str) -> tuple[float, float, int]:
    """Value, uncertainty, and significant digits of the uncertainty."""
    words = words.replace("−", "-").replace("\u00a0", "")
    power = re.search(r" × 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)$", words)
    scale = 10.0 ** int(power[1].translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))) if power else 1.0
    first, second = (words[: power.start()] if power else words).strip("()").split(" ± ")
    own = len(second.replace(".", "").lstrip("0")) if "." in second or int(second) < 100 else 2
    assert ("." in first) == ("." in second)
    if "." in first:
        assert len(first.split(".")[1]) == len(second.split(".")[1])
    return float(first) * scale, float(second) * scale, own


def test_both_numbers_end_at_the_second_digit_of_the_uncertainty() -> None:
    rng = np.random.default_rng(7)
    for _ in range(2000):
        u = 10.0 ** rng.uniform(-9, 7) * rng.choice([1.0, 0.9951, 0.9999])
        value = u * 10.0 ** rng.uniform(-2, 6) * rng.choice([-1.0, 1.0])
        shown, own, digits = _read(with_u(value, u))
        assert digits == 2, (value, u)
        # half of the second digit; the roundings of the numbers that are read back are far below
        half = 0.501 * 10.0 ** (math.floor(math.log10(float(f"{u:.1e}"))) - 1)
        assert abs(shown - value) <= half, (value, u)
        assert abs(own - u) <= half, (value, u)
        assert apart(value, u)[0].split(" × ")[0] in with_u(value, u)


@pytest.mark.parametrize(
    ("low", "high", "value", "words"),
    [
        (0.12296, 0.12304, 0.123, ("0.122960", "0.123040", "0.123000")),
        (0.00996, 0.0124, 0.0121, ("0.00996", "0.01240", "0.01210")),
        (0.987, 1.0, 1.0, ("0.987", "1.000", "1.000")),  # the upper end is a bound
        (0.0, 6.1e-7, 0.0, ("0", "6.1 × 10⁻⁷", "0")),
        (4.644, 15.39, 6.9, ("4.6", "15.4", "6.9")),
        (0.004, 9.0, 0.4, ("0.004", "9.000", "0.400")),  # the lower end is above 0
        (1234.0, 1236.0, 1235.1, ("1\u00a0234.00", "1\u00a0236.00", "1\u00a0235.10")),
    ],
)
def test_the_digits_of_an_interval_follow_its_width(
    low: float, high: float, value: float, words: tuple[str, str, str]
) -> None:
    assert interval(low, high, value) == words


def test_an_interval_that_has_a_width_shows_one() -> None:
    rng = np.random.default_rng(8)
    for _ in range(2000):
        value = 10.0 ** rng.uniform(-8, 5)
        below, above = value * 10.0 ** rng.uniform(-9, 0, 2)
        first, second, middle = interval(value - below, value + above, value)
        assert first != second
        # an end that is a hundred times nearer than the other may fall on the value
        assert (first != middle and middle != second) or not 0.01 < below / above < 100


def test_nobody_chooses_digits_of_his_own() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for home in HOMES
        for path in (ROOT / home).rglob("*.py")
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if OF_ITS_OWN.search(line) and "band: ±2" not in line and "_search_deg" not in line
    ]
    assert found == []
