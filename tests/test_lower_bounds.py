"""The lower bounds of the dependencies are the versions that `make test-oldest` tests with."""

from __future__ import annotations

import re
import tomllib

from tests.places import ROOT


def _numbers(version: str) -> list[int]:
    found = [int(part) for part in version.split(".")]
    while found and found[-1] == 0:
        found.pop()
    return found


def test_the_oldest_versions_are_the_lower_bounds() -> None:
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    bounds = [re.match(r"([\w-]+)>=([\d.]+)", line) for line in stated]
    tested = dict(
        line.split("==") for line in (ROOT / "constraints-oldest.txt").read_text().splitlines() if "==" in line
    )
    assert all(bounds)
    assert {m[1].lower(): _numbers(m[2]) for m in bounds if m} == {n: _numbers(v) for n, v in tested.items()}
