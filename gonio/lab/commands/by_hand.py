"""`gonio rig move | read | lamp | snap | scan | align | park | dark`: one device at a time.

And `acknowledge`, after an emergency stop.

Each command opens the devices that it names and no other, and tells how it left them.
"""

from __future__ import annotations

import contextlib
import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gonio.cli import console
from gonio.cli.signals import undisturbed
from gonio.disk import check_writable
from gonio.errors import ConfigError, DeviceError, Disturbed, GonioError, Interrupted
from gonio.lab.commands.opened import (
    AsJson,
    Axis,
    RigOption,
    SampleOption,
    Search,
    Seed,
    WavelengthOption,
    Yes,
    choice_of,
    holding,
    manual_rig_of,
    told_dark,
    told_where,
)
from gonio.lab.commands.rigs import app
from gonio.progress import Pace

if TYPE_CHECKING:
    import pandas as pd

    from gonio.lab.by_hand.manual_rig import ManualRig
    from gonio.lab.rig import Device, Health
    from gonio.typing import JsonObject

__all__ = ["app"]

OVERDUE_S = 10.0
"""Time for opening the lamp, and for a command that stands still: after it the guard darkens the lamp."""
LOOK_S = 1.0
"""How often a lamp that is lit is looked at."""


# ---- arms ----


@app.command()
def move(
    goals: Annotated[
        list[str],
        typer.Argument(
            metavar="AXIS=DEG...",
            help="light, camera, tilt, spin, azimuth; or theta_i and theta_r (signed in plane), phi_i, phi_r.",
        ),
    ],
    rig: RigOption,
) -> None:  # fmt: skip
    """Move axes, or all of them to directions. They hold where they landed, until `gonio rig park`."""
    wanted = _angles(goals)
    manual = manual_rig_of(rig, "arms")
    manual.goals(**wanted)  # whatever is wrong with them is said before anything is opened
    if manual.repeatable:
        console.note("a simulated rig exists for the length of one command, and starts parked")
    with told_where(manual), manual:
        if manual.can_hold:
            manual.hold()
        moved = manual.move(**wanted)
    if moved.branch:
        print(moved.branch)
    for name, angle in moved.landed.items():
        asked = round(math.degrees(moved.asked[name]), 6) + 0.0
        console.show(f"{name} {math.degrees(angle):.3f} deg (asked for {asked:g})")
    if manual.repeatable:
        return
    if manual.can_hold:
        console.note("the axes hold with torque on; gonio rig park ends that")
    else:
        console.note("this rig's driver cannot hold: its arms have parked again")


@app.command()
def park(rig: RigOption) -> None:
    """Darken the lamp, and drive every axis to its rest position; each whatever the other does."""

    from gonio.lab.rig.protocols import OpensSome

    name = choice_of(rig).description.name
    done, failures = [], []
    for device, text in (("light", "lamp dark"), ("arms", "arms parked")):
        try:
            manual = manual_rig_of(rig, device)  # type: ignore[arg-type]
            if device == "light" and (said := _darkened_elsewhere(manual)):
                done.append(said)
                continue
            with told_where(manual) if device == "arms" else told_dark(manual):
                _leave_in_order(manual, device)
            done.append(text)
        except DeviceError as failure:
            failures.append(f"{'the lamp could not be darkened' if device == 'light' else 'the arms'}: {failure}")
        except GonioError:
            if failures:
                console.note(f"{name}: {'; '.join(failures)}")
            raise
        if not isinstance(manual.rig, OpensSome):
            done = [] if failures else ["lamp dark", "arms parked"]
            break  # it opens everything, and was left in order
    if failures:
        raise DeviceError(f"{name}: {'; '.join([*done, *failures])}")
    console.note(f"{name}: {', '.join(done)}")


def _leave_in_order(manual: ManualRig, device: str) -> None:
    """Entering darkens, and leaving parks; arms that are stopped on the way hold, and do not fall."""

    failure: DeviceError | None = None
    with manual:
        if device == "arms" and manual.can_hold:
            try:
                manual.arms.park()
            except DeviceError as stuck:
                failure = stuck  # what can be parked is; leaving says the same where it fails again
            except (KeyboardInterrupt, Interrupted):
                manual.hold()
                raise
    if failure is not None:
        raise failure


@app.command()
def acknowledge(rig: RigOption) -> None:
    """After an emergency stop: you have removed its cause. Nothing moves or lights up before."""

    choice = choice_of(rig)
    said = getattr(choice.plugin, "acknowledge", None)
    if said is None:
        raise ConfigError(f'{rig}: the driver of rig = "{choice.description.rig}" has no interlock')
    with choice.naming():
        was = said(choice.description)
    console.note(f"acknowledged: {was}" if was else "there was nothing to acknowledge; the contact is closed")


# ---- lamp ----


@app.command()
def dark(rig: RigOption) -> None:
    """Darken the lamp; needs nothing else. Where another program has its port, that program's guard darkens it."""

    from gonio.lab.rig.protocols import OpensSome

    manual = manual_rig_of(rig, "light")
    if said := _darkened_elsewhere(manual):
        console.note(f"{manual.description.name}: {said}")
        return
    with told_dark(manual), manual:
        manual.lamp(False)
    console.note(
        f"{manual.description.name}: lamp dark" + ("" if isinstance(manual.rig, OpensSome) else ", arms parked")
    )


def _darkened_elsewhere(manual: ManualRig) -> str:
    """What was done to darken the lamp of another program, which holds its port; "" where there is none."""
    darken: Callable[[], str] | None = getattr(manual.light, "darken_elsewhere", None)
    return "" if darken is None else darken()


@app.command()
def lamp(
    level: Annotated[str, typer.Argument(metavar="on|off|LEVEL", help="LEVEL: 0 to 1.")],
    rig: RigOption,
    seconds: Annotated[float, typer.Option("--for", min=0, help="Dark after so many seconds.")] = 60.0,
    wavelength: WavelengthOption = None,
) -> None:
    """Light the lamp for a while. It is dark at the end of the time, on Ctrl-C, and when this program is killed."""

    if level == "off":
        return dark(rig)
    try:
        wanted = True if level == "on" else float(level)
    except ValueError:
        raise ConfigError(f'"{level}": say on, off, or a level from 0 to 1') from None
    if not 0 <= wanted <= 1:
        raise ConfigError(f"level {level}: the lamp's level is a fraction from 0 to 1")
    if not wanted:
        return dark(rig)
    if not math.isfinite(seconds):
        raise ConfigError(f"--for {seconds:g}: must be a number of seconds")
    manual = manual_rig_of(rig, "light")
    if hasattr(manual.light, "limit_s"):
        manual.light.limit_s = seconds + OVERDUE_S
    with told_dark(manual):
        with manual:
            end = time.monotonic() + seconds
            manual.lamp(wanted, wavelength_nm=wavelength)
            at = "" if wanted is True else f" at level {wanted:g}"
            console.note(f"lamp lit{at}, band {manual.band.name}; dark in {seconds:g} s, or on Ctrl-C")
            _count_down(manual, end)
        console.note(f"{manual.description.name}: lamp dark")


def _count_down(manual: ManualRig, end: float) -> None:
    """Wait for the end, and look at the lamp meanwhile, where its driver can."""
    from gonio.lab.acquisition.waits import wait

    terminal = sys.stderr.isatty()
    while (left := end - time.monotonic()) > 0:
        if terminal:
            print(f"\r{left:4.0f} s until dark ", end="", file=sys.stderr, flush=True)
        wait(manual, min(left, LOOK_S))
        if hasattr(manual.light, "check") and time.monotonic() < end:
            try:
                manual.light.check()
            except Disturbed as reset:
                console.note(str(reset))  # it was not as it should be, and is again
    if terminal:
        print("\r" + " " * 24 + "\r", end="", file=sys.stderr, flush=True)


# ---- looking ----


@app.command()
def read(rig: RigOption, as_json: AsJson = False) -> None:
    """Read angles, temperatures, currents, voltages, lamp and camera; changes nothing. Exit 3 if one says nothing."""
    from rich.text import Text

    from gonio.lab.rig.protocols import Surveys

    manual = manual_rig_of(rig)
    if not isinstance(manual.rig, Surveys):
        console.note("this rig's driver has no `survey`: it is opened for this, and parks when it is left")
    health = manual.read()
    if as_json:
        print(json.dumps(_record(manual.description.name, health), indent=2))
    else:
        table = console.table("device", "says", "", title=manual.description.name)
        for device in dict.fromkeys(reading.device for reading in health.readings):
            mine = [reading for reading in health.readings if reading.device == device]
            words = ("error", "settings")
            bad = [r.quantity for r in mine if not r.good or (r.quantity in words and r.value != "none")]
            text = Text(f"BAD: {', '.join(bad)}", style="bold red") if bad else "good"
            table.add_row(device, ", ".join(_said(r.quantity, r.value, r.unit) for r in mine), text)
        for device, why in health.silent.items():
            table.add_row(device, why, Text("SILENT", style="bold red"))
        console.show(table)
    if health.silent:
        raise DeviceError(f"{manual.description.name}: nothing could be read of {', '.join(health.silent)}")


def _said(quantity: str, value: float | str, unit: str) -> str:
    if isinstance(value, str):
        return {"torque": f"torque {value}", "error": f"error: {value}"}.get(quantity, value)
    if quantity == "angle_spread":
        return f"readings {value:.2f} deg apart"
    value = round(value, 9) + 0.0  # no -0
    digits = {"deg": ".2f", "V": ".1f", "C": ".0f", "mA": ".0f"}.get(unit, ".4g")
    named = "" if unit else f"{quantity} "
    return f"{named}{value:{digits}} {unit}".strip()


def _record(name: str, health: Health) -> JsonObject:
    devices: dict[str, JsonObject] = {}
    for r in health.readings:
        limit = r.limit and [x if math.isfinite(x) else None for x in r.limit]
        devices.setdefault(r.device, {})[r.quantity] = {
            "value": r.value, "unit": r.unit, "limit": limit, "good": r.good,
        }  # fmt: skip
    return {"rig": name, "devices": devices, "silent": health.silent}


@app.command()
def snap(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Ends with .dng, .tif or .png.")],
    rig: RigOption,
    exposure: Annotated[
        float | None, typer.Option(help="Seconds; by default what a matt white needs with the lamp on.")
    ] = None,
    lit: Annotated[bool, typer.Option("--lamp", help="With the lamp on; without it, as it is.")] = False,
    wavelength: WavelengthOption = None,
    sample: SampleOption = None,
    as_json: AsJson = False,
) -> None:
    """Take a frame. Beside it FILE-view.png: the frame with the patch that a measurement would use, and a histogram."""
    from gonio.lab.by_hand.snapshot import require_free

    if wavelength is not None and not lit:
        raise ConfigError("--wavelength-nm chooses the band of the lamp, which stays as it is: give --lamp as well")
    require_free(file)
    devices: tuple[Device, ...] = ("camera", "light") if lit else ("camera",)
    manual = manual_rig_of(rig, *devices, sample=sample)
    with told_dark(manual) if lit else contextlib.nullcontext(), manual:
        if manual.can_hold:
            manual.hold()
        if lit:
            manual.lamp(True, wavelength_nm=wavelength)
        shot = manual.snap(file, exposure_s=exposure)
    numbers = shot.numbers()
    if as_json:
        print(json.dumps({"rig": manual.description.name, "files": [str(f) for f in shot.files]} | numbers, indent=2))
    else:
        console.show(*(f"{name} {value:.6g}" for name, value in numbers.items()))
        console.show(*(str(name) for name in shot.files))
    for remark in shot.remarks(lit=True if lit else None):
        console.note(remark)
    if shot.without:
        console.note(f"no patch of the sample is drawn: {shot.without}")


def _show_scan(table: pd.DataFrame, axis: str) -> None:
    good = table[table["flag"] == ""]
    if len(good):
        signals, places = good["signal_dn_per_s"].to_numpy(), good["angle_deg"].to_numpy()
        top = int(signals.argmax())
        console.show(f"largest signal {signals[top]:.5g} DN/s at {axis} {places[top]:.3f} deg")
    if len(good) < len(table):
        console.show(f"{len(table) - len(good)} angles saturated")


@app.command()
def scan(
    axis: Axis,
    rig: RigOption,
    start: Annotated[float, typer.Option("--from", help="First angle [deg].")],
    stop: Annotated[float, typer.Option("--to", help="Last angle [deg].")],
    step: Annotated[float, typer.Option(help="Degrees.")],
    frames: Annotated[int, typer.Option(min=1, help="At each angle.")] = 2,
    exposure: Annotated[
        float | None, typer.Option(help="Seconds; by default each angle is metered.")
    ] = None,
    at: Annotated[
        list[str] | None, typer.Option(metavar="AXIS=DEG", help="Move other axes there first.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="A CSV; by default scan-AXIS.csv.")
    ] = None,
    wavelength: WavelengthOption = None,
    sample: SampleOption = None,
    seed: Seed = 0,
) -> None:  # fmt: skip
    """Scan an axis with the lamp on: a table of signal against angle, and its plot. The lamp is dark afterwards."""
    from gonio.lab.by_hand.scan import angles_between
    from gonio.lab.by_hand.scan import write as write_scan

    file = _scan_file(axis, out)
    angles = [math.radians(angle) for angle in angles_between(start, stop, step)]
    others = _angles(at or [])
    if axis in others:
        raise ConfigError(f"--at {axis}=...: this axis is scanned; --at is for the other ones")
    manual = manual_rig_of(rig, "arms", "light", "camera", sample=sample, seed=seed)
    for angle in angles:
        manual.check({axis: angle})
    if others:
        manual.goals(**others)
    if wavelength is not None:
        manual.choose_band(wavelength)
    taken: list[pd.DataFrame] = []
    try:
        with told_where(manual), manual, _progress() as progress:

            def keep(table: pd.DataFrame, total: int) -> None:
                taken[:] = [table]
                progress(len(table), total)

            if manual.can_hold:
                manual.hold()
            if others:
                manual.move(**others)
            manual.scan(axis, angles, frames=frames, exposure_s=exposure, progress=keep)
    finally:
        if taken:  # of a scan that was cut short, what was measured
            with undisturbed():
                picture = write_scan(taken[0], file)
            console.note(f"{file}, {picture.name}: {len(taken[0])} of {len(angles)} angles")
    _show_scan(taken[0], axis)
    console.note(holding(manual))


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    if sys.stderr.isatty():
        with console.counter("scanning") as progress:
            yield progress
        return
    pace: list[Pace] = []

    def lines(done: int, total: int) -> None:
        pace[:] = pace or [Pace("scanning: angles", total, console.note)]
        pace[0].step(done)

    yield lines


def _scan_file(axis: str, out: Path | None) -> Path:
    file, number = out or Path(f"scan-{axis}.csv"), 1
    while file.exists() or file.with_suffix(".png").exists():
        if out is not None:
            raise ConfigError(f"{file}: it, or its plot, is there already; name another file")
        number += 1
        file = Path(f"scan-{axis}-{number}.csv")
    if file.suffix != ".csv":
        raise ConfigError(f"--out {file}: must end with .csv")
    if not file.absolute().parent.is_dir():
        raise ConfigError(f"--out {file}: there is no folder {file.parent}")
    check_writable(file)
    return file


@app.command()
def align(
    rig: RigOption,
    out: Annotated[Path, typer.Option(help="The copy of the rig file, with the zeros in it.")] = Path("aligned.toml"),
    only: Annotated[
        Literal["both", "mirror", "straight"], typer.Option(help="Which scans; each alone leaves something open.")
    ] = "both",
    search: Search = 5.0,
    again: Annotated[
        list[Path] | None, typer.Option("--from", help="Scans of an earlier alignment: fit these; moves nothing.")
    ] = None,
    seed: Seed = 0,
    yes: Yes = False,
    live: Annotated[
        bool, typer.Option("--live", help="No scans: a live picture on a page, and a prompt to jog and set zeros.")
    ] = False,
    keep: Annotated[float, typer.Option(min=1, max=3600, help="--live: dark so long after a key [s].")] = 60.0,
    port: Annotated[int, typer.Option(min=0, max=65535, help="--live: of the page; 0 takes any that is free.")] = 0,
    host: Annotated[str, typer.Option(help="--live: serve the page there; by default, here alone.")] = "127.0.0.1",
    wavelength: WavelengthOption = None,
    sample: SampleOption = None,
) -> None:
    """Find the zeros of light, camera, tilt and azimuth, and write them into a copy of the rig file.

    Beside OUT: OUT-scans.csv, to fit again, and OUT-residuals.png. The lamp is dark and the arms parked afterwards.
    With --live a person aligns: the first line is the address of a page with the camera's picture.
    """
    from gonio.lab.commands import align as work

    if not live:
        work.align(rig, out, only, again or (), search_deg=search, seed=seed, yes=yes)
    elif again:
        raise ConfigError("--from belongs to scans, and --live makes none: leave one of them away")
    else:
        work.live(rig, out, sample, seed=seed, host=host, port=port, keep_s=keep, wavelength=wavelength)


# ---- inside ----


def _angles(texts: list[str]) -> dict[str, float]:
    """`light=30` as {"light": 30 degrees in radians}."""

    out: dict[str, float] = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            angle = math.radians(float(number))
        except ValueError:
            raise ConfigError(f'"{text}": write AXIS=DEG, as in light=30') from None
        if not math.isfinite(angle):
            raise ConfigError(f'"{text}": must be a finite angle')
        if name in out:
            raise ConfigError(f"{name} is given twice")
        out[name] = angle
    return out
