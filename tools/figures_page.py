"""Writes into docs/figures.md what the commands say of the papers' claims.

gonio figures all --out ALL; gonio figures pictures --out PICTURES; python tools/figures_page.py ALL PICTURES
"""

import json
import sys
import textwrap
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

PAGE = Path(__file__).resolve().parents[1] / "docs" / "figures.md"
LONGEST = 150
"""Characters of what was found, whole words."""


class Judged(NamedTuple):
    """A claim of a figure, as `summary.json` has it."""

    figure: str
    claim: str
    verdict: str
    found: str


def judged(folder: Path) -> list[Judged]:
    """The claims in a folder of `gonio figures all` or `gonio figures pictures`."""
    read = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    each = ((figure["figure"], c) for figure in read["figures"] for c in figure["claims"])
    return [Judged(name, c["claim"], c["verdict"], c["found"]) for name, c in each]


def words(claims: list[Judged]) -> str:
    """How many hold, and a table of those that do not, or have no verdict."""
    count = Counter(c.verdict for c in claims)
    fail = "does" if count["does not hold"] == 1 else "do"
    get = "gets" if count["no verdict"] == 1 else "get"
    total = (
        f"Of {len(claims)} claims {count['holds']} hold, {count['does not hold']} {fail} not, and "
        f"{count['no verdict']} {get} no verdict."
    )
    rows = [f"| {c.figure} | {_cell(c.claim)}: *{c.verdict}* | {_cell(c.found)} |" for c in _open(claims)]
    return "\n".join([*textwrap.wrap(total, 100), "", "| figure | claim | found |", "|---|---|---|", *rows])


def _open(claims: Iterable[Judged]) -> list[Judged]:
    return [c for c in claims if c.verdict != "holds"]


def _cell(text: str) -> str:
    return textwrap.shorten(text.replace("|", "\\|"), LONGEST, placeholder=" …")


def written(page: str, parts: dict[str, str]) -> str:
    """The page with other words between `<!-- NAME -->` and `<!-- end -->`."""
    for name, text in parts.items():
        begin, end = f"<!-- {name} -->\n", "\n<!-- end -->"
        before, found, rest = page.partition(begin)
        if not found or end not in rest:
            raise ValueError(f"{PAGE.name}: <!-- {name} --> or its <!-- end --> is missing")
        page = before + begin + text + rest[rest.index(end) :]
    return page


if __name__ == "__main__":
    drawn, pictures = (words(judged(Path(folder))) for folder in sys.argv[1:3])
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(written(page, {"drawn": drawn, "pictures": pictures}), encoding="utf-8", newline="\n")
