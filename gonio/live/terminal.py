"""A run in the terminal, as the page shows it: a panel that is drawn again, or plain lines where nobody looks."""

from __future__ import annotations

import sys
import threading
from typing import TYPE_CHECKING

from gonio.live.event_log import BATCH
from gonio.live.run_status import ago
from gonio.shown import with_u
from gonio.typing import JsonObject

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gonio.live.watching import Watched

DRAWN_S = 0.5
LISTED = 6
"""Values, flags and events that are shown."""
LINES = 200
"""A log file gets about so many lines of a run."""


def show(watched: Watched) -> None:
    """Show a run until a signal ends it."""
    watched.wanted = True
    if sys.stdout.isatty():
        _panel(watched)
    else:
        _lines(watched)


def _panel(watched: Watched) -> None:
    from rich.console import Console
    from rich.live import Live

    with Live(get_renderable=lambda: render(watched), console=Console(), refresh_per_second=1.0 / DRAWN_S):
        threading.Event().wait()


def _lines(watched: Watched) -> None:
    told, number, steps = ("", ""), 0, 0
    while True:
        status = watched.stands
        while events := watched.events_after(number):
            for event in events:
                number += 1
                if event["event"] != "step":
                    print(f"{_clock(event)}  {event_line(event)}", flush=True)
                    continue
                steps += 1
                part = max(status["total"] // LINES, 1)
                if event.get("flag") or steps % part == 0:
                    print(f"{_clock(event)}  {step_line(event)}", flush=True)
            status = watched.stands
        if told != (status["state"], status["why"]):
            told = status["state"], status["why"]
            print(summary(status), flush=True)
        threading.Event().wait(DRAWN_S)


def _clock(event: JsonObject) -> str:
    return str(event.get("wall", ""))[11:19]


def summary(status: JsonObject) -> str:
    """How a run stands, in a line."""
    parts = [f"{status['state']}: step {status['done']} of {status['total'] or '?'}"]
    if status["left_s"] is not None:
        unsure = f" ± {ago(status['left_u_s'])}" if is_unsure(status["left_s"], status.get("left_u_s")) else ""
        parts.append(f"about {ago(status['left_s'])}{unsure} left")
    if status["flagged"]:
        parts.append(f"{status['flagged']} flagged")
    if status.get("free_bytes"):
        parts.append(f"{status['free_bytes'] / 1e9:.3g} GB free")
    return ", ".join(parts) + (f" ({status['why']})" if status["why"] else "")


def is_unsure(seconds: float, u_seconds: float | None) -> bool:
    """Whether the uncertainty of a duration is worth saying."""
    return u_seconds is not None and u_seconds >= max(0.02 * seconds, 1.0)


def step_line(event: JsonObject) -> str:
    """A step in a line."""
    what = f"step {event['step']}: {event['kind']}" + (f" {event['point']}" if event["point"] is not None else "")
    if "angles_deg" in event:
        theta_i, phi_i, theta_r, phi_r = event["angles_deg"]
        what += f", theta_i {theta_i:g}, theta_r {theta_r:g}, dphi {(phi_r - phi_i) % 360:g} deg"
    if event["kind"] != "dark" and not event.get("flag") and "level" in event:
        what += f"; {100 * event['level']:.0f} % of full scale in {event['exposure_s']:.3g} s"
    return what + (f"  [{event['flag']}]" if event.get("flag") else "")


def event_line(event: JsonObject) -> str:
    """What happened, and the reasons where there are some."""
    why = "; ".join(event.get("why", []))
    return f"{event['event'].replace('_', ' ')}: {event.get('text', '')}" + (f" ({why})" if why else "")


def values_lines(watched: Watched, most: int = LISTED) -> list[str]:
    """The newest provisional values, the newest last."""
    out = []
    for band in watched.values.bands:
        name = f"{band['name']}: " if len(watched.values.bands) > 1 else ""
        for theta_i, phi_i, theta_r, phi_r, brdf, u in band["values"][-most:]:
            where = f"theta_i {theta_i:g}, theta_r {theta_r:g}, dphi {(phi_r - phi_i) % 360:g} deg"
            out.append(f"{name}{where}: ({with_u(brdf, u)}) 1/sr")
    return out


def drift_line(watched: Watched) -> str:
    """How far the last visit to the reference lies from the first, in each band."""
    visits = ((band["name"], *band["visit"]) for band in watched.values.bands)
    return ", ".join(f"{name} ({with_u(100 * (ratio - 1), 100 * u)}) %" for name, ratio, u in visits)


def render(watched: Watched) -> RenderableType:
    """The panel."""
    from rich.console import Group
    from rich.panel import Panel
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    status, rows = watched.stands, Table.grid(padding=(0, 2))
    rows.add_column(style="dim", no_wrap=True)
    rows.add_column()
    events = watched.events_after(max(0, len(watched.log) - BATCH))
    step = next((event for event in reversed(events) if event["event"] == "step"), None)

    def row(name: str, text: str) -> None:
        rows.add_row(name, Text(text))  # brackets are no markup

    if step is not None:
        row("now", step_line(step))
        row("axes", "  ".join(f"{name} {value:.2f}°" for name, value in step["pose_deg"].items()))
        told = [f"{d} {q.replace('_', ' ')} {v}{u}" for d, q, v, u in step["health"] if u != "deg" and v is not None]
        if told:
            row("devices", "  ".join(told))
    if watched.values.bands:
        row("reference", f"{drift_line(watched)} since the first visit")
        row("values", "\n".join([*values_lines(watched), "provisional"]))
    flags = [event for event in events if event["event"] == "step" and event.get("flag")]
    if flags:
        row("flagged", "\n".join(step_line(event) for event in flags[-LISTED:]))
    others = [event for event in events if event["event"] != "step"]
    if others:
        told = [f"{_clock(event)} {event_line(event)}" for event in others[-LISTED:]]
        row("events", "\n".join(told))
    if status["sessions"]:
        began, last, _ = status["sessions"][-1]
        row("session", f"{len(status['sessions'])}., {ago(last - began)}")
    bar = Table.grid(expand=True)  # a bar alone does not end its line
    bar.add_row(ProgressBar(total=max(status["total"], 1), completed=status["done"]))
    name = watched.path.absolute().name
    return Panel(Group(Text(summary(status), style="bold"), bar, rows), title=name, title_align="left")
