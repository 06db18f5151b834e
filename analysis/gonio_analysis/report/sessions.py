"""The sessions of a run: when somebody measured, how far it came, and what the white reference said each time."""

from datetime import datetime, timedelta

from gonio.shown import with_u
from gonio_analysis.report.blocks import Block, Heading, Paragraph, table
from gonio_analysis.report.section import Section
from gonio_analysis.result_records import ReferenceLevel, RunFacts, SessionSummary

MOST_BANDS = 4
"""Columns of the table; summary.json has all bands."""
MOST_SESSIONS = 40


def section(run: RunFacts | None) -> list[Block]:
    """The table of sessions; nothing for a run that was measured in one."""
    if run is None or len(run.sessions) < 2:
        return []
    bands = list(dict.fromkeys(level.band for one in run.sessions for level in one.levels))
    shown = bands[:MOST_BANDS]
    rows = [
        [f"{k}, {_day(one.began)}", f"{_clock(one.began)} – {_clock(one.ended, one.began)}", str(one.steps), one.ending,
         *(_level(one, band) for band in shown)]
        for k, one in enumerate(run.sessions[:MOST_SESSIONS], 1)
    ]  # fmt: skip
    head = ["session", "from, to (UTC)", "steps", "its end", *(f"reference, {band}" for band in shown)]
    words = (
        f"It was measured in {len(run.sessions)} sessions, and the lamp was dark in between. The white reference joins"
        " them: values are relative to its visits."
    )
    caption = "Reference: mean signal of the visits of a session, relative to the first one's, ± standard deviation."
    if not shown:
        caption = "What the reference says stands here once the run is reduced."
    if len(bands) > len(shown) or len(run.sessions) > MOST_SESSIONS:
        caption += " summary.json has all bands and sessions."
    right = (2, *range(4, 4 + len(shown)))
    return [Heading(3, "The sessions of the run"), Paragraph(words), table(caption, head, rows, right=right)]


def _level(session: SessionSummary, band: str) -> str:
    found: list[ReferenceLevel] = [level for level in session.levels if level.band == band]
    if not found:
        return "no visit"
    (level,) = found
    visits = f"{level.visits} visit" + "s" * (level.visits != 1)
    if level.scatter is None:
        return f"{level.relative:.5f} ({visits})"
    return f"{with_u(level.relative, level.scatter)} ({visits})"


def _time(wall: str) -> datetime:
    return datetime.fromisoformat(wall)


def _day(wall: str) -> str:
    return f"{_time(wall):%Y-%m-%d}"


def _clock(wall: str, began: str = "") -> str:
    """The time of day; with the days that went by since it began."""
    days = (_time(wall).date() - _time(began).date()) // timedelta(days=1) if began else 0
    return f"{_time(wall):%H:%M}" + (f" (+{days} d)" if days else "")


SECTION = Section("sessions", lambda d, figures: section(d.run))
