"""`gonio plan show`."""

from __future__ import annotations

import io
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gonio import canvas
from gonio.cli import console
from gonio.errors import ConfigError, os_error_as
from gonio.progress import duration

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

    from gonio.lab.acquisition.measure import Prepared, RigChoice
    from gonio.lab.acquisition.plan import Assessed, Plan
    from gonio.lab.rig import Step
    from gonio.lab.rig.description import RigDescription

app = typer.Typer(help="Look at plans.", no_args_is_help=True)

SHOWN = 12
"""Angles that stand in one cell of a table."""
ROWS = 24
"""Angles of incidence that have a row of their own."""
PICTURES = (".png", ".svg", ".pdf")
INCIDENCES = 4
"""Angles of incidence that have a column in the table of what to expect."""
POSES = 5
"""Points of each that it rests on."""


@app.callback()
def _group() -> None:
    """Look at plans."""


@app.command()
def show(
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="A plan.toml.")],
    rig: Annotated[str | None, typer.Option(help="The rig that shall measure it: a name or a rig file.")] = None,
    left_out: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="Write the points that the rig leaves out, and why.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="OUT.png|svg", help="Draw the rig from the side and from above, and a map of the points."),
    ] = None,
    step: Annotated[
        int | None, typer.Option(help="Of the picture: number of the step; by default the most crowded one.")
    ] = None,
    separate: Annotated[
        tuple[Path, Path] | None,
        typer.Option(
            metavar="A.toml B.toml",
            help="How well the plan tells two samples apart, and by which points; --picture maps it.",
        ),
    ] = None,
) -> None:
    """Show the points of a plan. With a rig also what it cannot reach and why, and how long it takes."""
    from gonio.lab.acquisition.measure import assessed, find_rig
    from gonio.lab.acquisition.plan import load_plan

    if left_out is not None and rig is None:
        raise ConfigError("--left-out: what is left out depends on the rig; name one with --rig")
    if left_out is not None and (left_out.exists() or left_out.is_symlink()):
        raise ConfigError(f"--left-out: {left_out} is there already; name another file")
    if (picture is not None or step is not None) and (rig is None or picture is None):
        raise ConfigError("--picture shows a plan on a rig: give --rig too, and --step goes with --picture")
    loaded, chosen = load_plan(plan), find_rig(rig) if rig is not None else None
    if picture is not None and picture.suffix.lower() not in PICTURES:
        raise ConfigError(f"--picture {picture}: a picture ends in {' or '.join(PICTURES)}")
    if separate is not None and (chosen is None or step is not None):
        raise ConfigError("--separate: what a plan tells depends on the rig; name one with --rig, and leave --step out")
    seen = assessed(loaded, chosen) if chosen is not None else None
    if separate is not None and seen is not None:
        _separate(seen, separate, picture)
        return
    describe(loaded, seen, left_out=left_out)
    if seen is not None:
        _expect(seen)
    if picture is not None and seen is not None:
        _draw(seen, picture, step)


def _separate(seen: Prepared, samples: tuple[Path, Path], picture: Path | None) -> None:
    from gonio import plugins
    from gonio.samples.files import load_sample

    a, b = (load_sample(path, uniform=True) for path in samples)
    plugin = plugins.load("gonio.choosers", "models")
    found = plugin.separation(seen, a, b)
    said, rows = plugin.about(found)
    table = console.table(
        "theta_i_deg", "theta_r_deg", "dphi_deg", f"{a.name} / sr^-1", f"{b.name} / sr^-1", "chi-square of one",
        "five sigma after", title="points that tell most for their time",
    )  # fmt: skip
    for row in rows:
        table.add_row(*row)
    console.show(table, *said)
    if picture is not None:
        _saved(plugin.draw(found), picture)


def _draw(seen: Prepared, file: Path, step: int | None) -> None:
    from gonio.lab.acquisition import plan_picture

    plan, rig, points, _ = seen
    _saved(plan_picture.draw(plan, points, rig.schedule(plan, points), rig.description, step), file)


def _saved(figure: Figure, file: Path) -> None:
    with os_error_as(ConfigError, f"{file}: cannot be written"):
        canvas.save(figure, file, dpi=150)
    console.show(f"picture: {file}")


def describe(plan: Plan, seen: Prepared | None, *, out: Path | None = None, left_out: Path | None = None) -> None:
    """Print a plan, as a rig sees it if there is one.

    Parameters
    ----------
    plan
        As it was written.
    seen
        What `gonio.lab.acquisition.measure.assessed` made of it on a rig.
    out
        Where a run would go: what is free there is told.
    left_out
        A file for the points that the rig cannot measure.
    """
    from gonio.lab.acquisition.plan import Assessed, count_reasons, said_beside
    from gonio.lab.acquisition.sampling import about

    if plan.adaptive is not None and seen is None:
        how, hours = plan.adaptive.how, plan.adaptive.budget_h
        console.show(
            f"{plan.name}: points are chosen as the run grows ({how}, {hours:g} h of rig time); --rig says which"
        )
        if not plan.points:
            console.show(f"wavelengths: {', '.join(f'{w:g} nm' for w in plan.wavelength_nm)}")
            return
    written, rig, sampler = plan, None, None
    points = [Assessed(p, None) for p in plan.points]
    if seen is not None:
        plan, rig, points, sampler = seen
    console.show(_table(plan, points, with_rig=rig is not None))
    for number, count in sorted(Counter(Counter(plan.points).values()).items()):
        if number > 1:
            console.show(f"{count} points are measured {number} times each, spread over the run")
    if plan.repeated:
        console.show(f"{plan.repeated} points occur more than once; each is measured once")
    if plan.below_horizon:
        console.show(f"{plan.below_horizon} half vectors need a detector below the horizon; they are left out")
    if rig is None:
        states = f", each in {', '.join(plan.polarisation)}" if plan.polarisation else ""
        console.show(f"wavelengths: {', '.join(f'{w:g} nm' for w in plan.wavelength_nm)}{states}")
        return
    bands = plan.bands(rig.description)
    for (flag, cause), count in count_reasons(points):
        console.show(f"{count} {flag}: {cause}")
    console.show(*said_beside(points, rig.description))
    if left_out is not None:
        console.show(f"{left_out}: {_write_left_out(points, left_out)} points with their reasons")
    console.show(
        f"rig: {rig.description.name}",
        *calibrations(rig.description),
        *wrong_devices(rig),
        f"bands: {', '.join(f'{b.name} (centre {b.centre_nm:g} nm, width {b.fwhm_nm:g} nm)' for b in bands)}",
        *_effort(written, points, rig, rig.schedule(plan, points), out),
    )
    if sampler is not None:
        console.show("then points are chosen as the run grows:", *(f"  {line}" for line in about(sampler)))


def _expect(seen: Prepared) -> None:
    """Print the uncertainties that a matt sample will have, and which calibration changes them."""
    import numpy as np

    from gonio.lab.acquisition.duration import Durations
    from gonio.lab.acquisition.schedule import reference_pose
    from gonio.lab.calibration.expected_budget import advice, expected, total

    plan, rig, points, _ = seen
    description = rig.description
    groups: dict[float, list[Assessed]] = {}
    for a in points:
        if a.pose is not None and a.point.theta_r_deg < 90.0:
            groups.setdefault(round(a.point.theta_i_deg), []).append(a)
    if not groups or description.reference.how == "beam":
        return
    angles = sorted(groups)
    angles = [angles[k] for k in sorted({round(k) for k in np.linspace(0, len(angles) - 1, INCIDENCES)})]
    chosen = [[groups[i][k] for k in np.linspace(0, len(groups[i]) - 1, POSES).astype(int)] for i in angles]
    bands, steps = plan.bands(description), rig.schedule(plan, points)
    visits = max(sum(step.kind == "reference" for step in steps) - 1, 1)
    between_s = Durations(description, bands).parts(steps).total_s / visits
    poses = [a.pose for group in chosen for a in group if a.pose is not None]
    causes = expected(description, poses, reference_pose(description), bands[0], between_s)
    title = "what to expect of a matt sample: standard uncertainty / %, at theta_i / deg"
    table = console.table("cause", *(f"{i:g}" for i in angles), "to do, or known from", title=title)
    rows = [(cause.cause, cause.u_rel, advice(cause, causes)) for cause in causes]
    for name, u_rel, what in (*rows, ("u_brdf", total(causes), "without what is still to do")):
        by_angle = np.sqrt(np.mean(np.reshape(u_rel, (-1, POSES)) ** 2, axis=1))
        table.add_row(name, *("-" if np.isnan(u) else f"{100.0 * u:.2g}" if u > 5e-5 else "0" for u in by_angle), what)
    console.show(table)


def _effort(written: Plan, points: list[Assessed], rig: RigChoice, steps: list[Step], out: Path | None) -> list[str]:
    """What measuring takes: time by its parts, order, frames, bytes."""
    from gonio.lab.acquisition.duration import Durations
    from gonio.lab.acquisition.schedule import Schedule
    from gonio.lab.acquisition.waits import Bytes, free_bytes, size

    durations = Durations(rig.description, written.bands(rig.description))
    visits = sum(step.kind == "reference" for step in steps)
    parts = durations.parts(steps)
    named = [
        ("travel", parts.travel_s), ("frames", parts.frames_s), ("white reference", parts.reference_s),
        ("dark", parts.dark_s), ("warm-up", parts.warm_up_s),
    ]  # fmt: skip
    lines = [
        f"{len(steps)} steps with {visits} measurements of the white reference; about {duration(parts.total_s)} "
        "on the rig's clock, for a matt sample of albedo 0.5",
        "time: " + ", ".join(f"{name} {duration(seconds)}" for name, seconds in named if seconds),
    ]
    if rig.description.camera.readout_s:
        hidden_s = sum(map(durations.frames_s, steps)) - (parts.frames_s + parts.reference_s + parts.dark_s)
        lines.append(f"moves go on while frames are read out, which saves {duration(hidden_s)}")
    if written.order == "short":
        poses = {a.point: a.pose for a in points if a.pose is not None}
        as_written = [poses[point] for point in written.points if point in poses]
        before_s = durations.parts(Schedule(rig.description, range(len(as_written)), as_written.__getitem__)).travel_s
        lines.append(f"order: short; as written the travel would take {duration(before_s)}")
    frames = sum(map(durations.frames, steps))
    needed = frames * Bytes(rig.description, len(durations.bands)).frame
    lines.append(f"{frames} frames, about {size(needed)} on the disk")
    if out is not None:
        free = free_bytes(out)
        lines[-1] += f"; {size(free)} are free there"
        if free < needed:
            lines.append(f"warning: {out} has no room for that; free some, or choose another folder")
    return lines


def _write_left_out(points: list[Assessed], path: Path) -> int:
    """Write the points without a pose, with flag and reason; how many there are."""
    import csv

    from gonio.disk import write_whole
    from gonio.geometry import ANGLES_DEG

    lost = [a for a in points if a.pose is None]
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow([*ANGLES_DEG, "flag", "reason"])
    lines.writerows([*(repr(getattr(a.point, name)) for name in ANGLES_DEG), a.flag, a.reason] for a in lost)
    with os_error_as(ConfigError, f"--left-out: {path}: cannot be written"):
        write_whole(path, text.getvalue().encode())
    return len(lost)


def _table(plan: Plan, points: list[Assessed], *, with_rig: bool) -> Table:
    """The points by their angles of incidence."""

    by_incidence: dict[float, list[_Place]] = {}
    for place in _places(plan, points):
        by_incidence.setdefault(place.assessed.point.theta_i_deg, []).append(place)
    headings = ["theta_i", "theta_r\nin plane", "dphi\nout of plane", "points"]
    if with_rig:
        headings += ["measured", "not measured:\ntheta_r, or theta_r/dphi"]
    table = console.table(*headings, title=f"{plan.name}: {len(points)} points, angles in degrees")
    groups = [(f"{theta_i:g}", group) for theta_i, group in sorted(by_incidence.items())]
    if len(groups) > ROWS:
        rest = groups[ROWS - 1 :]
        named = f"{rest[0][0]} to {rest[-1][0]}\n({len(rest)} angles)"
        groups = [*groups[: ROWS - 1], (named, [place for _, group in rest for place in group])]
    for name, group in groups:
        signed = sorted(place.signed_deg for place in group if place.in_plane)
        dphi = sorted({place.dphi_deg for place in group if not place.in_plane})
        row = [name, _span(signed), _azimuths(dphi), str(len(group))]
        if with_rig:
            row += [str(sum(place.assessed.pose is not None for place in group)), _missing(group)]
        table.add_row(*row)
    return table


def wrong_devices(rig: RigChoice) -> list[str]:
    """What the driver refuses of the rig file's `[devices]`, of which it touches none for that."""
    if rig.description.devices:
        try:
            rig.open(by_hand=True)
        except ConfigError as error:
            return [f"this rig cannot be opened: {error}"]
    return []


def calibrations(description: RigDescription) -> list[str]:
    """The calibrations that a rig is used with, and a warning of each that is unfit."""
    files = [f"{known.file} ({known.kind}, made on {known.made})" for known in description.calibration.known]
    return [*([f"calibrations: {', '.join(files)}"] if files else []), *unfit(description)]


def unfit(description: RigDescription) -> list[str]:
    """A warning of each calibration that is used although it is unfit."""
    return [f"warning: calibration {remark}; it is used all the same" for remark in description.calibration.remarks]


def _missing(group: list[_Place]) -> str:
    """The points of a group that are not measured, by flag."""
    out: dict[str, list[str]] = {}
    for place in group:
        a = place.assessed
        if a.pose is None:
            angles = f"{place.signed_deg:.5g}" if place.in_plane else f"{a.point.theta_r_deg:.4g}/{place.dphi_deg:.4g}"
            out.setdefault(a.flag, []).append(angles)
    return "; ".join(f"{flag}: {_listed(list(dict.fromkeys(angles)))}" for flag, angles in out.items())


def _listed(angles: list[str]) -> str:
    """All angles where they are few; the first of them where they are many."""
    if len(angles) <= SHOWN:
        return ", ".join(angles)
    return f"{', '.join(angles[: SHOWN // 2])} and {len(angles) - SHOWN // 2} more"


def _azimuths(dphi: list[float]) -> str:
    """All azimuths where they are few; their range where they are many."""
    if len(dphi) <= SHOWN:
        return ", ".join(f"{d:.5g}" for d in dphi)
    return f"{dphi[0]:.4g} to {dphi[-1]:.4g}\n({len(dphi)} azimuths)"


@dataclass(frozen=True, slots=True)
class _Place:
    """Where the detector of a point is, as tables for people have it."""

    assessed: Assessed
    dphi_deg: float
    signed_deg: float

    @property
    def in_plane(self) -> bool:
        """Whether a plan asks for it in a half-plane of incidence: at the normal too an azimuth is what was asked."""
        return self.dphi_deg in (0.0, 180.0)


def _places(plan: Plan, points: list[Assessed]) -> list[_Place]:
    import numpy as np

    directions = plan.directions
    dphi, signed = np.round(np.degrees(directions.dphi), 6) % 360.0, np.degrees(directions.signed)
    return [_Place(*each) for each in zip(points, dphi.tolist(), signed.tolist(), strict=True)]


def _span(angles: list[float]) -> str:
    return "" if not angles else " to ".join(f"{angle:.4g}" for angle in dict.fromkeys((angles[0], angles[-1])))
