"""What the pages of all benches have: a head, parts with a note, verdicts, and the machine they were made on."""

from collections.abc import Iterable, Sequence
from typing import Literal

from gonio_analysis.report.blocks import (
    Block,
    Contents,
    Group,
    Heading,
    Paragraph,
    Text,
    facts,
    header,
    section,
    strong,
)

from gonio_validation.bench.coverage_results import Coverage
from gonio_validation.bench.results import SpeedAndError
from gonio_validation.bench.scene_results import SceneBench
from gonio_validation.bench.sweeps_results import Sweeps

Results = Coverage | SceneBench | SpeedAndError | Sweeps


def head(s: Results, what: str, links: Iterable[tuple[str, str]] = ()) -> Group:
    """Title, day and version, `what` was done, and links to parts by their names."""
    contents = tuple((f"#{anchor}", name) for anchor, name in links)
    made = f"{s.created[:10]}, gonio {s.machine.versions['gonio']}{what}"
    return header(s.title, made, *([Contents(contents)] if contents else []))


def part(title: str, slug: str, words: str, *blocks: Block, level: Literal[2, 3] = 2) -> Group:
    """A heading, what is to know before reading, and what was found."""
    return section([Heading(level, title), Paragraph(words, "note"), *blocks], slug)


def verdict(holds: bool) -> Text:
    """Yes, or a loud no."""
    return "yes" if holds else strong("no")


def method(s: Results, rows: Sequence[tuple[str, str]]) -> Group:
    """How it was done, and on what."""
    m = s.machine
    system = f"{m.system}, Python {m.python}, " + ", ".join(f"{k} {v}" for k, v in m.versions.items())
    shown = facts([*rows, ("system", system), ("command", s.command or "–")])
    return section([Heading(2, "Method and machine"), shown], "method")
