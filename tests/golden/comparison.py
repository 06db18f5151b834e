"""Whether two texts are the same: words to the letter, numbers to a tolerance, and what changes from run to run not."""

import math
import re

NUMBER = re.compile(r"(?<![\w.])[-+−]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
CHANGES = [
    (re.compile(r"\d{4}-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?(?:Z|[+-]\d\d:?\d\d)?)?"), "<when>"),
    (re.compile(r'("(?:wall_s|seconds|fit_s|draw_s|search_s)": )[-\d.e+]+'), r"\1<time>"),
    (re.compile(r'("(?:python|gonio|numpy|scipy|numba|pandas|matplotlib)": ?)"[^"]*"'), r"\1<version>"),
    (re.compile(r'("version": |\bgonio )"?\d+\.\d+\.\d+\b"?'), r"\1<version>"),
    (re.compile(r'"crc": ?"[0-9a-f]{8}"'), '"crc":"<of the line>"'),
    (re.compile(r'"run": ?"[0-9a-f]{32}"'), '"run":"<id>"'),
    (re.compile(r"(?:/[\w.+-]+)+/(?=[\w.-]+)"), "<folder>/"),
]
"""Times, versions, the id of a run, and folders."""
SHA256 = re.compile(r"\b[0-9a-f]{64}\b")
"""Of frames: the same to the byte on one processor, and not from one kind of processor to another."""
TINY = 1e-14
"""Below it a number is the rounding of others: of radians, and of BRDF values of 1e-6 and more."""


def same_for_all(text: str) -> str:
    """A text without what changes from run to run."""
    for pattern, instead in CHANGES:
        text = pattern.sub(instead, text)
    return text


def difference(golden: str, now: str, tolerance: float) -> str:
    """What differs, in words; "" where nothing does.

    Parameters
    ----------
    golden, now
        Texts.
    tolerance
        Relative, of numbers that are written in full; a difference of the last printed digit counts as none.
    """
    golden, now = same_for_all(golden), same_for_all(now)
    if golden == now:
        return ""
    if len(golden.splitlines()) != len(now.splitlines()):
        return f"{len(golden.splitlines())} lines before, {len(now.splitlines())} now"
    for number, (before, after) in enumerate(zip(golden.splitlines(), now.splitlines(), strict=True), 1):
        if before == after:
            continue
        before, after = SHA256.sub("<sha256>", before), SHA256.sub("<sha256>", after)
        if NUMBER.sub("#", before) != NUMBER.sub("#", after):
            return f"line {number}: {_short(before)} | now: {_short(after)}"
        for old, new in zip(NUMBER.findall(before), NUMBER.findall(after), strict=True):
            if not _close(old, new, tolerance):
                return f"line {number}: {old} | now: {new} in {_short(after)}"
    return ""


def _close(old: str, new: str, tolerance: float) -> bool:
    a, b = (float(x.replace("−", "-")) for x in (old, new))
    digits = old.lower().partition("e")[0].replace(".", "").lstrip("+-−0")
    printed = 10.0 ** -max(len(digits) - 1, 0)  # of the last digit
    return a == b or math.isclose(
        a, b, rel_tol=max(tolerance, 1.01 * printed if len(digits) >= 3 else 0.0), abs_tol=TINY
    )


def _short(line: str) -> str:
    return line.strip()[:160]
