"""`gonio rig list | show | check | new | set-zero | ids | reboot | home`: rigs, a rig's file, and its servos.

What a person does with single devices is in `by_hand.py`.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from gonio import plugins
from gonio.cli import console
from gonio.disk import put
from gonio.errors import ConfigError, DeviceError, GonioError, Interrupted
from gonio.lab.commands.opened import Axis, RigOption, choice_of, manual_rig_of, require_new

if TYPE_CHECKING:
    from gonio.lab.acquisition.measure import RigChoice
    from gonio.lab.by_hand.new_rig import DriverPlugin
    from gonio.lab.rig import FoundServo, Rig
    from gonio.lab.rig.protocols import RigService


app = typer.Typer(help="List, show and check rigs, and work on them by hand.", no_args_is_help=True)

Row = tuple[str, str, bool]
LITTLE_DEG = 2.0


@app.command("list")
def list_rigs() -> None:
    """List the rigs that are installed; a broken one with its error."""

    table = console.table("rig", "from", "")
    for name, point in plugins.available("gonio.rigs").items():
        try:
            shipped = plugins.load("gonio.rigs", name).toml
            remark = "ready" if shipped else f'needs a rig file with rig = "{name}"'
        except GonioError as error:
            remark = str(error)
        table.add_row(name, point.dist.name if point.dist is not None else point.value, remark)
    console.show(table)


@app.command()
def show(rig: Annotated[str, typer.Argument(metavar="RIG", help="A rig's name, or a rig file.")]) -> None:
    """Print a rig's file, to copy and to change."""
    from gonio.lab.acquisition.measure import find_rig

    choice = find_rig(rig)
    path = Path(rig)
    print(path.read_text(encoding="utf-8") if path.is_file() else choice.plugin.toml, end="")


@app.command()
def check(
    rig: Annotated[str, typer.Option(help="A rig's name, or a rig file.")],
    move: Annotated[bool, typer.Option(help="Move the axes a little, and light the lamp.")] = True,
) -> None:
    """Open a rig, and try every device. Moves each axis a little, takes a dark and a lit frame; exit 3 if any fails."""
    from rich.text import Text

    from gonio.lab.acquisition.measure import find_rig
    from gonio.lab.commands.plans import calibrations

    choice = find_rig(rig)
    for line in calibrations(choice.description):
        console.note(line)
    rows = checks(choice, move=move)
    table = console.table("check", "found", "verdict", title=choice.description.name)
    for what, found, good in rows:
        table.add_row(what, found, "good" if good else Text("BAD", style="bold red"))
    console.show(table)
    bad = [what for what, _, good in rows if not good]
    if bad:
        raise DeviceError(
            f'rig "{choice.description.name}": {len(bad)} of {len(rows)} checks are bad: {"; ".join(bad)}'
        )


def checks(choice: RigChoice, *, move: bool = True) -> list[Row]:
    """What is checked, what was found, and whether that is good; stops at the first device that fails."""
    from gonio.lab.rig.whereabouts import left

    rig: Any = choice.open()
    rows: list[Row] = []
    can_leave = hasattr(rig, "leave_as_found")
    if not move and can_leave:
        rig.leave_as_found()
    try:
        with choice.naming(), rig:
            rows.append(("devices open, lamp dark", "yes", True))
            if hasattr(rig, "diagnose"):  # what a rig knows of its own devices, if it tells
                rows.extend(rig.diagnose(move=move))
            if move:
                _check_devices(rig, rows)
            elif not can_leave:
                rig.arms.stop()  # a rig whose arms were stopped does not park them
        rows.append(("arms parked, lamp dark" if move else "lamp dark", "yes", True))
    except (KeyboardInterrupt, Interrupted) as stop:
        said = str(stop) or "interrupted"
        raise Interrupted(f"{said}; {left(rig, 'the lamp is dark, and every axis stands still')}") from None
    except DeviceError as error:
        state = left(rig, "") if rows else ""
        rows.append(("device", f"{error}; {state}" if state else str(error), False))
    return rows


def _check_devices(rig: Rig, rows: list[Row]) -> None:
    import numpy as np

    from gonio.lab.acquisition import exposure
    from gonio.lab.acquisition.schedule import reference_pose
    from gonio.lab.by_hand.frame_analysis import is_black
    from gonio.lab.rig import Step

    description = rig.description
    at_reference = reference_pose(description)
    rig.begin(Step(0, "reference", pose=at_reference))
    for name, landed, tolerance in _small_moves(rig):
        rows.append((f"{name} axis moves {LITTLE_DEG:g} deg", f"lands within {landed:.3f} deg", landed <= tolerance))
    camera = description.camera
    short, _ = exposure.dark_exposures_s(description)
    dark = rig.camera.capture(short)
    offset = float(np.median(dark.mosaic)) - dark.black_level_dn
    scale = exposure.full_scale_dn(camera, dark)
    found = f"{dark.mosaic.shape[1]} x {dark.mosaic.shape[0]}, median {offset:+.1f} DN from the black level"
    rows.append(("dark frame", found, abs(offset) < 0.02 * scale))
    rig.present("reference")
    rig.arms.move(at_reference)
    rig.light.select(description.bands.all()[0])
    rig.light.on()
    exposure_s = exposure.expected_exposure_s(description, at_reference, 1.0)
    lit = rig.camera.capture(exposure_s)
    rig.light.off()
    apart_s = lit.time_s - dark.time_s
    rows.append(("times of two frames", f"the later one is stamped {apart_s:.3f} s after the first", apart_s > 0))
    level = (float(np.percentile(lit.mosaic, 99)) - lit.black_level_dn) / scale
    found = f"bright pixels at {100 * level:.0f} % of full scale after {exposure_s:.3g} s"
    if is_black(camera, lit):
        found = (
            f"black after {exposure_s:.3g} s, though the lamp says that it is lit: is the lens cap on, or its way shut?"
        )
    elif level >= exposure.SATURATED:
        found += ": saturated; dim the lamp, or close the aperture"
    elif level <= 0.02:
        found += ": hardly any light; is the lamp aligned, and the aperture open?"
    rows.append(("lit frame", found, 0.02 < level < exposure.SATURATED))


def _small_moves(rig: Rig) -> list[tuple[str, float, float]]:
    """For every axis of the rig: how far from its goal it lands [deg], and how far it may."""
    out = []
    limits_deg = rig.description.limits_deg()
    for name, axis in rig.description.axes().items():
        here = rig.arms.read()
        # at rest on a limit an encoder may read a step beyond it
        inside = {
            of: min(max(getattr(here, of), math.radians(a)), math.radians(b)) for of, (a, b) in limits_deg.items()
        }
        here = replace(here, **inside)
        at = getattr(here, name)
        goal = replace(here, **{name: at - math.copysign(math.radians(LITTLE_DEG), at)})
        landed = math.degrees(abs(getattr(rig.arms.move(goal), name) - getattr(goal, name)))
        out.append((name, landed, max(2.0 * axis.encoder_step_deg, 0.02)))
    return out


__all__ = ["app"]

Axes = Annotated[list[str] | None, typer.Argument(metavar="[AXIS]...")]


# ---- the rig file ----


@app.command("new")
def new_rig(
    out: Annotated[Path, typer.Option(help="The rig file to write.")] = Path("my.toml"),
    port: Annotated[list[str] | None, typer.Option(help="Look at this port; by default at all there are.")] = None,
    answers: Annotated[Path | None, typer.Option(help="A TOML file with the answers: nobody is asked.")] = None,
    like: Annotated[str, typer.Option(help="The shipped rig whose file is filled in: lab, three-servos.")] = "lab",
) -> None:
    """Ask what a rig file needs, find ports, servos and lamp, and write the file, with a comment on each value."""
    from gonio.config import read_toml
    from gonio.lab.by_hand.new_rig import Answers, Person, make

    require_new(out)
    plugin = plugins.load("gonio.rigs", like)
    if not hasattr(plugin, "lamp_on"):
        raise ConfigError(f"--like {like}: looks for no devices; there are lab and three-servos")
    person: Person | Answers = (
        Answers(answers, read_toml(answers)) if answers is not None else Person(_line, console.note)
    )
    text, _ = make(cast("DriverPlugin", plugin), person, console.note, ports=port or ())
    put(out, text.encode())
    console.show(f"{out} is written; next: gonio rig check --rig {out}, then gonio rig align --rig {out}")


def _line(prompt: str) -> str:
    print(prompt, end="", file=sys.stderr, flush=True)
    line = sys.stdin.readline() if sys.stdin is not None else ""
    if not line:
        raise EOFError
    return line


@app.command("set-zero")
def set_zero(
    axis: Axis,
    rig: RigOption,
    at: Annotated[float, typer.Option(help="Where the axis truly stands now [deg].")] = 0.0,
    out: Annotated[Path | None, typer.Option(help="Write a changed copy, and leave the rig file as it is.")] = None,
) -> None:
    """Write an axis's zero into the rig file: it stands at this angle now. The file as it was is kept as .bak."""
    from gonio.lab.by_hand.rig_file import read_zero, write_values

    if not Path(rig).is_file():
        raise ConfigError(f'"{rig}" is no rig file to write into: gonio rig show {rig} > my.toml, then --rig my.toml')
    if not abs(at) <= 360.0:
        raise ConfigError(f"--at {at:g}: an axis stands at an angle from -360 to 360 deg")
    manual = manual_rig_of(rig, "arms")
    hint = ": look for a loose magnet, a loose cable, or a servo near its end; nothing is written"
    zero = read_zero(manual, axis, at, manual.read_arms, hint=hint)
    kept = write_values(rig, zero.values, out=out)
    console.show(f"{zero} in {out or rig}" + (f" (as it was: {kept})" if kept else ""))
    if zero.remark:
        console.note(zero.remark)


# ---- servos ----


@app.command()
def ids(
    rig: RigOption,
    port: Annotated[
        str | None, typer.Option(help="Another port than the rig file's.")
    ] = None,
    set_id: Annotated[
        tuple[int, int] | None, typer.Option(metavar="OLD NEW", help="Give a servo another id.")
    ] = None,
    set_baud: Annotated[
        tuple[int, int] | None,
        typer.Option(metavar="ID BAUD", help="Give a servo another line speed."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask for no confirmation.")] = False,
) -> None:  # fmt: skip
    """List the servos on a port, at every line speed; or give one another id or speed, for good."""

    choice = choice_of(rig)
    service = _service(choice)
    where = port or service.ports(choice.description)[0]
    with choice.naming():
        found = service.servos(where, console.note)
    table = console.table("id", "baud", "model", "firmware", "", title=where)
    for servo in found:
        remark = "" if servo.alone else "two servos with this id, or damaged answers: connect one at a time"
        table.add_row(str(servo.id), str(servo.baud), servo.model, str(servo.firmware), remark)
    console.show(table)
    if not found:
        raise DeviceError(f"no servo answers on {where} at any line speed; is its power on, and the cable in?")
    if set_id is not None:
        found = _assigned(service, found, set_id[0], yes, identity=set_id[1])
    if set_baud is not None:
        _assigned(service, found, set_baud[0], yes, baud=set_baud[1])


def _assigned(service: RigService, found: list[FoundServo], old: int, yes: bool, **new: int) -> list[FoundServo]:
    """One of the servos that were found, changed."""

    mine = [servo for servo in found if servo.id == old]
    if not mine:
        raise DeviceError(f"no servo with id {old} was found; there are {', '.join(str(s.id) for s in found)}")
    if len(mine) > 1 or not mine[0].alone:
        raise DeviceError(f"more than one servo answers to id {old}: connect the one that is meant, alone")
    servo, identity = mine[0], new.get("identity")
    if identity is not None and any(other.id == identity for other in found if other != servo):
        raise DeviceError(f"id {identity} is taken by another servo on this port: connect one servo at a time")
    what = f"id {identity}" if identity is not None else f"{new['baud']} baud"
    said = f"servo id {servo.id} ({servo.model}, {servo.baud} baud) becomes {what}, for good; its torque goes off"
    if not yes:
        if not (sys.stdin is not None and sys.stdin.isatty()):
            raise ConfigError(f"{said}: there is no terminal to confirm it; --yes asks for none")
        if not typer.confirm(f"{said}. Go on?", err=True):
            raise ConfigError("nothing was changed")
    changed = service.assign(servo, **new)
    console.show(f"servo id {changed.id} ({changed.model}) answers at {changed.baud} baud")
    return [changed if other == servo else other for other in found]


@app.command()
def reboot(rig: RigOption, axes: Axes = None) -> None:
    """Restart servos (all, or those of some axes), as after an overload. Their torque goes off: support the arms."""

    choice = choice_of(rig)
    service = _service(choice)
    with choice.naming():
        done = service.reboot(choice.description, axes or ())
    for name, failure in done.items():
        console.show(f"{name}: {failure or 'restarted, torque off'}")
    bad = [name for name, failure in done.items() if failure]
    if bad:
        raise DeviceError(f"{choice.description.name}: not restarted, or unwell: {', '.join(bad)}")


# ---- inside ----


@app.command()
def home(rig: RigOption, axes: Axes = None) -> None:
    """Find the turn of axes that turn further than their servos count: without AXIS, of those that need it."""

    choice = choice_of(rig)
    service = _service(choice)
    try:
        with choice.naming():
            done = service.home(choice.description, axes or (), console.note)
    except KeyboardInterrupt:
        raise Interrupted("interrupted; the axis is stopped, and not homed") from None
    for name, found in done.items():
        if isinstance(found, str):
            console.show(f"{name}: {found}")
            continue
        console.show(
            f"{name}: homed at {found.at_deg:g} deg, found {found.found} times within {found.spread_deg:.3f} deg, "
            f"{found.off_deg:+.3f} deg from there; it holds"
        )
    if not done:
        console.show("every axis knows its turn")
    bad = [name for name, found in done.items() if isinstance(found, str)]
    if bad:
        raise DeviceError(f"{choice.description.name}: not homed: {', '.join(bad)}")


def _service(choice: RigChoice) -> RigService:
    """The plugin, where it has a service for servos."""
    from gonio.lab.rig.protocols import RigService

    if not isinstance(choice.plugin, RigService):
        raise ConfigError(f'the rig "{choice.source}" has no servos that can be reached by this')
    return choice.plugin
