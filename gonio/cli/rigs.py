"""`gonio rig list | show | check`; what a person does with single devices is in `by_hand.py`."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gonio.cli import console
from gonio.errors import DeviceError, GonioError, Interrupted

if TYPE_CHECKING:
    from gonio.acquisition.measure import RigChoice
    from gonio.rig import Rig

app = typer.Typer(help="List, show and check rigs, and work on them by hand.", no_args_is_help=True)

Row = tuple[str, str, bool]
LITTLE_DEG = 2.0


@app.command("list")
def list_rigs() -> None:
    """List the rigs that are installed; a broken one with its error."""
    from gonio import plugins

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
    from gonio.acquisition.measure import find_rig

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

    from gonio.acquisition.measure import find_rig
    from gonio.cli.plans import calibrations

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
    from gonio.rig.whereabouts import left

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

    from gonio.acquisition import exposure
    from gonio.acquisition.schedule import reference_pose
    from gonio.by_hand.frame_analysis import is_black
    from gonio.rig import Step

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
    elif level >= 0.98:
        found += ": saturated; dim the lamp, or close the aperture"
    elif level <= 0.02:
        found += ": hardly any light; is the lamp aligned, and the aperture open?"
    rows.append(("lit frame", found, 0.02 < level < 0.98))


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
