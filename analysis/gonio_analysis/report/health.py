"""The health of a run and its sessions.

Health: temperatures, currents and voltages against time, and for what the run waited. Sessions: when somebody measured,
how far it came, and what the white reference said each time.
"""

from collections.abc import Sequence
from datetime import datetime, timedelta
from functools import partial
from typing import Any

from gonio.run_facts import HealthSummary, PauseSummary, ReferenceLevel, RunFacts, SessionSummary
from gonio.shown import with_u
from gonio_analysis.plots.in_plane import clean, dashes, style
from gonio_analysis.plots.style import FAINT
from gonio_analysis.report.blocks import Block, Figures, Heading, Notes, Paragraph, table
from gonio_analysis.report.drawing import Drawing, Figure
from gonio_analysis.report.figures import LEGEND_ROW_IN, key
from gonio_analysis.report.section import Section
from gonio_analysis.report.text import counted, number

KIND = "health"
PANEL_IN = 1.35
FOOT_IN = 0.5
WORDS = {
    "current_max": "highest current", "voltage_min": "lowest voltage", "load_max": "highest load",
    "room_light": "room light",
}  # fmt: skip
BETTER = {"current": "current_max", "load": "load_max", "voltage": "voltage_min"}
"""What is drawn instead, where both were read: the extreme of every poll since the step before."""
UNITS = {"C": "°C"}
MOST_PAUSES = 20
"""Most pauses that are told one by one."""


def draw(run: RunFacts | None, slug: str) -> list[Drawing]:
    """The figure of a run; none where nothing was read."""
    panels = _panels(run)
    if run is None or not panels:
        return []
    devices = list(dict.fromkeys(h.device for group in panels for h in group))
    long = max(h.steps for group in panels for h in group)
    drawn = max(len(h.value) for group in panels for h in group)
    caption = "Health of the run: " + ", ".join(_words(group[0]) for group in panels) + " at every step, against time."
    if long > drawn:
        caption += f" Of {long} steps those are drawn that are lowest or highest among their neighbours."
    if run.pauses:
        caption += " Grey: the run waited."
    alt = " ".join(
        f"{h.device} {_words(h)}: {_with_unit(h.lowest, h)} to {_with_unit(h.highest, h)}."
        for group in panels
        for h in group
    )
    size = (5.6, PANEL_IN * len(panels) + FOOT_IN + LEGEND_ROW_IN)
    on = partial(_on_panels, panels=panels, pauses=run.pauses, devices=devices)
    return [Drawing(f"{slug}-health", KIND, "", caption, alt, size, on)]


def section(run: RunFacts | None, figures: Sequence[Figure]) -> list[Block]:
    """The extremes in words and the figure; nothing where nothing was read."""
    if run is None or not (run.health or run.pauses):
        return []
    rows = [
        [h.device, _words(h), *(_with_unit(value, h) for value in (h.lowest, h.median, h.highest)),
         f"{h.highest_h:.2f} h"]
        for h in run.health
    ]  # fmt: skip
    head = ["device", "quantity", "lowest", "median", "highest", "highest after"]
    waited = f"it waited {len(run.pauses)} times" if run.pauses else "it never waited"
    return [
        Heading(3, "The health of the run", f"{counted(len({h.device for h in run.health}), 'device')}; {waited}"),
        Paragraph(_extremes(run)),
        Notes(tuple(map(_pause, run.pauses[:MOST_PAUSES]))),
        *([table("Read after the frames of every step.", head, rows, right=(2, 3, 4, 5))] if rows else []),
        Figures(tuple(figures)),
    ]


def _panels(run: RunFacts | None) -> list[list[HealthSummary]]:
    """Series by quantity: those of one panel."""
    out: dict[str, list[HealthSummary]] = {}
    for h in run.health if run is not None else []:
        out.setdefault(h.quantity, []).append(h)
    return [group for quantity, group in out.items() if BETTER.get(quantity) not in out]


def _extremes(run: RunFacts) -> str:
    said = []
    for quantity in ("temperature", "current_max", "load_max", "voltage_min"):
        end = "lowest" if quantity == "voltage_min" else "highest"
        found = [(getattr(h, end), h) for h in run.health if h.quantity == quantity]
        if found:
            value, h = (min if end == "lowest" else max)(found, key=lambda one: one[0])
            said.append(f"The {end} {_words(h).removeprefix(end + ' ')} was {_with_unit(value, h)}, of the"
                        f" {h.device} servo, {getattr(h, end + '_h'):.2f} h after the start.")  # fmt: skip
    waited = sum(p.waited_s or 0.0 for p in run.pauses)
    pauses = f"{len(run.pauses)} time" + "s" * (len(run.pauses) != 1)
    said.append(f"It waited {pauses}, {number(waited / 60, 2)} min together." if run.pauses else "It never waited.")
    return " ".join(said)


def _pause(p: PauseSummary) -> str:
    how_long = "the run ended meanwhile" if p.waited_s is None else f"waited {p.waited_s:.0f} s"
    return f"{p.begun_h:.2f} h after the start: {p.message}; {how_long}."


def _words(h: HealthSummary) -> str:
    return WORDS.get(h.quantity, h.quantity)


def _with_unit(value: float, h: HealthSummary) -> str:
    return f"{value:.4g} {UNITS.get(h.unit, h.unit)}".strip()


def _on_panels(
    figure: Any, *, panels: list[list[HealthSummary]], pauses: list[PauseSummary], devices: list[str]
) -> None:
    from matplotlib.lines import Line2D

    high = PANEL_IN * len(panels) + FOOT_IN + LEGEND_ROW_IN
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    figure.subplots_adjust(0.13, (FOOT_IN + LEGEND_ROW_IN) / high, 0.975, 1 - 0.08 / high, hspace=0.14)
    looks: dict[str, Any] = {device: {"color": style(k)["color"], "ls": dashes(k)} for k, device in enumerate(devices)}
    for ax, group in zip(axes, panels, strict=True):
        clean(ax)
        for h in group:
            ax.plot(h.time_h, h.value, lw=0.9, **looks[h.device])
        for p in pauses:
            ax.axvspan(p.begun_h, p.begun_h + (p.waited_s or 0.0) / 3600, color=FAINT, lw=0.5)
        unit = f" [{UNITS.get(group[0].unit, group[0].unit)}]" if group[0].unit else ""
        ax.set_ylabel(_words(group[0]) + unit, fontsize=7.5)
        ax.tick_params(labelsize=7.5)
    axes[-1].set_xlabel("time from the first step [h]", fontsize=8)
    key(figure, [Line2D([], [], lw=1.2, label=d, **looks[d]) for d in devices], min(len(devices), 6), long=2.4)


MOST_BANDS = 4
"""Columns of the table; summary.json has all bands."""
MOST_SESSIONS = 40


def sessions_section(run: RunFacts | None) -> list[Block]:
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
        " them: values are relative to its measurements."
    )
    caption = (
        "Reference: mean signal of its measurements in a session, relative to the first one's, ± standard deviation."
    )
    if not shown:
        caption = "What the reference says stands here once the run is reduced."
    if len(bands) > len(shown) or len(run.sessions) > MOST_SESSIONS:
        caption += " summary.json has all bands and sessions."
    right = (2, *range(4, 4 + len(shown)))
    count = f"{len(run.sessions)} sessions"
    return [Heading(3, "The sessions of the run", count), Paragraph(words), table(caption, head, rows, right=right)]


def _level(session: SessionSummary, band: str) -> str:
    found: list[ReferenceLevel] = [level for level in session.levels if level.band == band]
    if not found:
        return "not measured"
    (level,) = found
    visits = f"{level.visits} measurement" + "s" * (level.visits != 1)
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


SECTIONS = (
    Section("sessions", lambda d, figures: sessions_section(d.run)),
    Section(
        "health", lambda d, figures: section(d.run, figures.get(KIND, ())), lambda d, facts: draw(facts.run, facts.slug)
    ),
)
