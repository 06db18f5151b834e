"""What one check found."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """A check: what was found, and what is right."""

    name: str
    passed: bool
    found: str
    expected: str
    tolerance: str = ""


def near(name: str, found: float, right: float, *, rel: float = 0.0, digits: int = 12) -> Finding:
    """A number that has to be another, but for a relative tolerance."""
    passed = abs(found - right) <= rel * abs(right)
    return Finding(name, passed, f"{found:.{digits}g}", f"{right:.{digits}g}", f"{rel:.0e}, relative")


def most(name: str, found: float, limit: float, what: str) -> Finding:
    """A number that may not exceed a limit."""
    return Finding(name, found <= limit, f"{found:.2g}", what, f"{limit:.2g}")
