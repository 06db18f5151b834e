"""`gonio rig move | read | lamp | snap | scan | set-zero | ids | reboot | home | park | dark`: one device at a time.

Each command opens the devices that it names and no other, and tells how it left them.
"""

from __future__ import annotations

import contextlib
import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gonio.cli.rigs import app

if TYPE_CHECKING:
    import pandas as pd

    from gonio.acquisition.measure import RigChoice
    from gonio.by_hand.bench import Bench
    from gonio.rig import Device, FoundServo, Health, Homed

__all__ = ["app"]

RigOption = Annotated[str, typer.Option(help="A rig's name, or a rig file.", show_default=False)]
SampleOption = Annotated[Path | None, typer.Option(help="What a simulated rig looks at: a sample.toml.")]
WavelengthOption = Annotated[
    float | None, typer.Option("--wavelength", help="The band that contains it [nm].", show_default=False)
]
OVERDUE_S = 10.0
"""A lamp is late by so much where the command that should have darkened it stands still; opening it is in that."""
AT_REST_S = 4.0
"""A stopped axis stands still by then."""
LOOK_S = 1.0
"""How often a lamp that is lit is looked at."""


# ---- arms ----


@app.command()
def move(
    goals: Annotated[
        list[str],
        typer.Argument(
            metavar="AXIS=DEG...", show_default=False,
            help="light, camera, tilt, spin, azimuth; or theta_i and theta_r (signed in plane), phi_i, phi_r.",
        ),
    ],
    rig: RigOption,
) -> None:  # fmt: skip
    """Move axes, or all of them to directions. They hold where they landed, until `gonio rig park`."""
    from gonio.cli import console

    wanted = _angles(goals)
    bench = _bench(rig, "arms")
    bench.goals(**wanted)  # whatever is wrong with them is said before anything is opened
    if bench.repeatable:
        console.note("a simulated rig exists for the length of one command, and starts parked")
    with _told_where(bench), bench:
        if bench.can_hold:
            bench.hold()
        moved = bench.move(**wanted)
    if moved.branch:
        print(moved.branch)
    for name, angle in moved.landed.items():
        asked = round(math.degrees(moved.asked[name]), 6) + 0.0
        console.show(f"{name} {math.degrees(angle):.3f} deg (asked for {asked:g})")
    if bench.repeatable:
        return
    if bench.can_hold:
        console.note("the axes hold with torque on; gonio rig park ends that")
    else:
        console.note("this rig's driver cannot hold: its arms have parked again")


@app.command()
def park(rig: RigOption) -> None:
    """Darken the lamp, and drive every axis to its rest position; each whatever the other does."""
    from gonio.cli import console
    from gonio.errors import DeviceError, GonioError

    name = _choice(rig).description.name
    done, failures = [], []
    for device, text in (("light", "lamp dark"), ("arms", "arms parked")):
        try:
            bench = _bench(rig, device)  # type: ignore[arg-type]
            with _told_where(bench, device), bench:
                pass  # entering darkens, and leaving parks
            done.append(text)
        except DeviceError as failure:
            failures.append(f"{'the lamp could not be darkened' if device == 'light' else 'the arms'}: {failure}")
        except GonioError:
            if failures:
                console.note(f"{name}: {'; '.join(failures)}")
            raise
        if not hasattr(bench, "only"):
            done = [] if failures else ["lamp dark", "arms parked"]
            break  # it opens everything, and was left in order
    if failures:
        raise DeviceError(f"{name}: {'; '.join([*done, *failures])}")
    console.note(f"{name}: {', '.join(done)}")


# ---- lamp ----


@app.command()
def dark(rig: RigOption) -> None:
    """Darken the lamp; needs nothing else."""
    from gonio.cli import console

    bench = _bench(rig, "light")
    with _told_dark(), bench:
        bench.lamp(False)
    console.note(f"{bench.description.name}: lamp dark" + ("" if hasattr(bench, "only") else ", arms parked"))


@app.command()
def lamp(
    level: Annotated[str, typer.Argument(metavar="on|off|LEVEL", help="LEVEL: 0 to 1.", show_default=False)],
    rig: RigOption,
    seconds: Annotated[float, typer.Option("--for", min=0, help="Dark after so many seconds.")] = 60.0,
    wavelength: WavelengthOption = None,
) -> None:
    """Light the lamp for a while. It is dark at the end of the time, on Ctrl-C, and when this program is killed."""
    from gonio.cli import console
    from gonio.errors import ConfigError

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
    bench = _bench(rig, "light")
    if hasattr(bench.light, "limit_s"):
        bench.light.limit_s = seconds + OVERDUE_S
    with _told_dark():
        with bench:
            end = time.monotonic() + seconds
            bench.lamp(wanted, wavelength_nm=wavelength)
            at = "" if wanted is True else f" at level {wanted:g}"
            console.note(f"lamp lit{at}, band {bench.band.name}; dark in {seconds:g} s, or on Ctrl-C")
            _count_down(bench, end)
        console.note(f"{bench.description.name}: lamp dark")


def _count_down(bench: Bench, end: float) -> None:
    """Wait for the end, and look at the lamp meanwhile, where its driver can."""
    from gonio.cli import console
    from gonio.errors import DeviceError

    terminal = sys.stderr.isatty()
    while (left := end - time.monotonic()) > 0:
        if terminal:
            print(f"\r{left:4.0f} s until dark ", end="", file=sys.stderr, flush=True)
        time.sleep(min(left, LOOK_S))
        if hasattr(bench.light, "check") and time.monotonic() < end:
            try:
                bench.light.check()
            except DeviceError as failure:
                if type(failure) is DeviceError:
                    raise
                console.note(str(failure))  # it was not as it should be, and is again
    if terminal:
        print("\r" + " " * 24 + "\r", end="", file=sys.stderr, flush=True)


# ---- looking ----


@app.command()
def read(
    rig: RigOption,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Read angles, temperatures, currents, voltages, lamp and camera; changes nothing. Exit 3 if one says nothing."""
    from rich.text import Text

    from gonio.cli import console
    from gonio.errors import DeviceError

    bench = _bench(rig)
    if not hasattr(bench, "survey"):
        console.note("this rig's driver has no `survey`: it is opened for this, and parks when it is left")
    health = bench.read()
    if as_json:
        print(json.dumps(_record(bench.description.name, health), indent=2))
    else:
        table = console.table("device", "says", "", title=bench.description.name)
        for device in dict.fromkeys(reading.device for reading in health.readings):
            mine = [reading for reading in health.readings if reading.device == device]
            bad = [r.quantity for r in mine if not r.good or (r.quantity == "error" and r.value != "none")]
            text = Text(f"BAD: {', '.join(bad)}", style="bold red") if bad else "good"
            table.add_row(device, ", ".join(_said(r.quantity, r.value, r.unit) for r in mine), text)
        for device, why in health.silent.items():
            table.add_row(device, why, Text("SILENT", style="bold red"))
        console.show(table)
    if health.silent:
        raise DeviceError(f"{bench.description.name}: nothing could be read of {', '.join(health.silent)}")


def _said(quantity: str, value: float | str, unit: str) -> str:
    if isinstance(value, str):
        return {"torque": f"torque {value}", "error": f"error: {value}"}.get(quantity, value)
    value = round(value, 9) + 0.0  # no -0
    digits = {"deg": ".2f", "V": ".1f", "C": ".0f", "mA": ".0f"}.get(unit, ".4g")
    named = "" if unit else f"{quantity} "
    return f"{named}{value:{digits}} {unit}".strip()


def _record(name: str, health: Health) -> dict[str, Any]:
    devices: dict[str, dict[str, Any]] = {}
    for r in health.readings:
        limit = r.limit and [x if math.isfinite(x) else None for x in r.limit]
        devices.setdefault(r.device, {})[r.quantity] = {
            "value": r.value, "unit": r.unit, "limit": limit, "good": r.good,
        }  # fmt: skip
    return {"rig": name, "devices": devices, "silent": health.silent}


@app.command()
def snap(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Ends with .dng, .tif or .png.", show_default=False)],
    rig: RigOption,
    exposure: Annotated[
        float | None,
        typer.Option(help="Seconds; by default what a matt white needs with the lamp on.", show_default=False),
    ] = None,
    lit: Annotated[bool, typer.Option("--lamp", help="With the lamp on; without it, as it is.")] = False,
    wavelength: WavelengthOption = None,
    sample: SampleOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Take a frame. Beside it FILE-view.png: the frame with the patch that a measurement would use, and a histogram."""
    from gonio.by_hand.snapshot import require_free
    from gonio.cli import console

    require_free(file)
    devices: tuple[Device, ...] = ("camera", "light") if lit else ("camera",)
    bench = _bench(rig, *devices, sample=sample)
    with _told_dark() if lit else contextlib.nullcontext(), bench:
        if bench.can_hold:
            bench.hold()
        if lit:
            bench.lamp(True, wavelength_nm=wavelength)
        shot = bench.snap(file, exposure_s=exposure)
    numbers = shot.numbers()
    if as_json:
        print(json.dumps({"rig": bench.description.name, "files": [str(f) for f in shot.files]} | numbers, indent=2))
    else:
        console.show(*(f"{name} {value:.6g}" for name, value in numbers.items()))
        console.show(*(str(name) for name in shot.files))
    if shot.without:
        console.note(f"no patch of the sample is drawn: {shot.without}")


@app.command()
def scan(
    axis: Annotated[str, typer.Argument(help="light, camera, tilt, spin or azimuth.", show_default=False)],
    rig: RigOption,
    start: Annotated[float, typer.Option("--from", help="First angle [deg].", show_default=False)],
    stop: Annotated[float, typer.Option("--to", help="Last angle [deg].", show_default=False)],
    step: Annotated[float, typer.Option(help="Degrees.", show_default=False)],
    frames: Annotated[int, typer.Option(min=1, help="At each angle.")] = 2,
    exposure: Annotated[
        float | None, typer.Option(help="Seconds; by default each angle is metered.", show_default=False)
    ] = None,
    at: Annotated[
        list[str] | None, typer.Option(metavar="AXIS=DEG", help="Move other axes there first.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="A CSV; by default scan-AXIS.csv.", show_default=False)
    ] = None,
    wavelength: WavelengthOption = None,
    sample: SampleOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of a simulated rig.")] = 0,
) -> None:  # fmt: skip
    """Scan an axis with the lamp on: a table of signal against angle, and its plot. The lamp is dark afterwards."""
    from gonio.by_hand.scan import angles_between
    from gonio.by_hand.scan import write as write_scan
    from gonio.cli import console

    file = _scan_file(axis, out)
    angles = [math.radians(angle) for angle in angles_between(start, stop, step)]
    others = _angles(at or [])
    bench = _bench(rig, "arms", "light", "camera", sample=sample, seed=seed)
    for angle in angles:
        bench.check({axis: angle})
    if others:
        bench.goals(**others)
    if wavelength is not None:
        bench.choose_band(wavelength)
    taken: list[pd.DataFrame] = []
    try:
        with _told_where(bench), bench, _progress() as told:

            def keep(table: pd.DataFrame, total: int) -> None:
                taken[:] = [table]
                told(len(table), total)

            if bench.can_hold:
                bench.hold()
            if others:
                bench.move(**others)
            bench.scan(axis, angles, frames=frames, exposure_s=exposure, told=keep)
    finally:
        if taken:  # of a scan that was cut short, what was measured
            picture = write_scan(taken[0], file)
            console.note(f"{file}, {picture.name}: {len(taken[0])} of {len(angles)} angles")
    good = taken[0][taken[0]["flag"] == ""]
    if len(good):
        signals, places = good["signal_dn_per_s"].to_numpy(), good["angle_deg"].to_numpy()
        top = int(signals.argmax())
        console.show(f"largest signal {signals[top]:.5g} DN/s at {axis} {places[top]:.3f} deg")
    if len(good) < len(taken[0]):
        console.show(f"{len(taken[0]) - len(good)} angles saturated")
    holds = bench.can_hold and not bench.repeatable
    console.note("the lamp is dark" + ("; the axes hold, until gonio rig park" if holds else ""))


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    from gonio.cli import console
    from gonio.cli.pace import Pace

    if sys.stderr.isatty():
        with console.counter("scanning") as told:
            yield told
        return
    pace: list[Pace] = []

    def lines(done: int, total: int) -> None:
        pace[:] = pace or [Pace("scanning: angles", total, console.note)]
        pace[0].step(done)

    yield lines


def _scan_file(axis: str, out: Path | None) -> Path:
    from gonio.errors import ConfigError

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
    return file


# ---- zeros ----


@app.command("set-zero")
def set_zero(
    axis: Annotated[str, typer.Argument(help="light, camera, tilt, spin or azimuth.", show_default=False)],
    rig: RigOption,
    at: Annotated[float, typer.Option(help="Where the axis truly stands now [deg].")] = 0.0,
    out: Annotated[
        Path | None, typer.Option(help="Write a changed copy, and leave the rig file as it is.", show_default=False)
    ] = None,
) -> None:
    """Write an axis's zero into the rig file: it stands at this angle now. The file as it was is kept as .bak."""
    from gonio.by_hand.rig_file import write_values, zero_values
    from gonio.cli import console
    from gonio.errors import ConfigError, DeviceError

    if not Path(rig).is_file():
        raise ConfigError(f'"{rig}" is no rig file to write into: gonio rig show {rig} > my.toml, then --rig my.toml')
    if not math.isfinite(at):
        raise ConfigError(f"--at {at:g}: must be a finite angle")
    bench = _bench(rig, "arms")
    bench.check({axis: 0.5 * math.radians(sum(bench.description.limits_deg().get(axis, (0.0, 0.0))))})
    health = bench.read_arms()
    read = health.of(axis, "angle")
    if not isinstance(read, float):
        raise DeviceError(f"axis {axis}: {health.silent.get(axis, 'its angle is not known')}")
    values, offset = zero_values(bench.description, axis, read_deg=read, true_deg=at)
    kept = write_values(rig, values, out=out)
    console.show(
        f"{axis} reads {read:.3f} deg and stands at {at:g} deg: zero_offset_deg = {offset:.3f} in {out or rig}"
        + (f" (as it was: {kept})" if kept else "")
    )


# ---- servos ----


@app.command()
def ids(
    rig: RigOption,
    port: Annotated[
        str | None, typer.Option(help="Another port than the rig file's.", show_default=False)
    ] = None,
    set_id: Annotated[
        tuple[int, int] | None, typer.Option(metavar="OLD NEW", help="Give a servo another id.", show_default=False)
    ] = None,
    set_baud: Annotated[
        tuple[int, int] | None,
        typer.Option(metavar="ID BAUD", help="Give a servo another line speed.", show_default=False),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask for no confirmation.")] = False,
) -> None:  # fmt: skip
    """List the servos on a port, at every line speed; or give one another id or speed, for good."""
    from gonio.cli import console
    from gonio.errors import DeviceError

    choice = _choice(rig)
    service: Any = _service(choice, "servos")
    where = port or service.ports(choice.description)[0]
    with choice.naming():
        found: list[FoundServo] = service.servos(where, console.note)
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


def _assigned(service: Any, found: list[FoundServo], old: int, yes: bool, **new: int) -> list[FoundServo]:
    """One of the servos that were found, changed."""
    from gonio.cli import console
    from gonio.errors import ConfigError, DeviceError

    mine = [servo for servo in found if servo.id == old]
    if not mine:
        raise DeviceError(f"no servo with id {old} was found; there are {', '.join(str(s.id) for s in found)}")
    if len(mine) > 1 or not mine[0].alone:
        raise DeviceError(f"more than one servo answers to id {old}: connect the one that is meant, alone")
    servo, identity = mine[0], new.get("identity")
    if identity is not None and any(other.id == identity for other in found if other != servo):
        raise DeviceError(f"id {identity} is taken by another servo on this port")
    what = f"id {identity}" if identity is not None else f"{new['baud']} baud"
    said = f"servo id {servo.id} ({servo.model}, {servo.baud} baud) becomes {what}, for good; its torque goes off"
    if not yes:
        if not (sys.stdin is not None and sys.stdin.isatty()):
            raise ConfigError(f"{said}: there is no terminal to confirm it; --yes asks for none")
        if not typer.confirm(f"{said}. Go on?", err=True):
            raise ConfigError("nothing was changed")
    changed: FoundServo = service.assign(servo, **new)
    console.show(f"servo id {changed.id} ({changed.model}) answers at {changed.baud} baud")
    return [changed if other == servo else other for other in found]


@app.command()
def reboot(
    rig: RigOption,
    axes: Annotated[list[str] | None, typer.Argument(metavar="[AXIS]...", show_default=False)] = None,
) -> None:
    """Restart servos (all, or those of some axes), as after an overload. Their torque goes off: support the arms."""
    from gonio.cli import console
    from gonio.errors import DeviceError

    choice = _choice(rig)
    service: Any = _service(choice, "reboot")
    with choice.naming():
        done: dict[str, str] = service.reboot(choice.description, axes or ())
    for name, failure in done.items():
        console.show(f"{name}: {failure or 'restarted, torque off'}")
    bad = [name for name, failure in done.items() if failure]
    if bad:
        raise DeviceError(f"{choice.description.name}: not restarted, or unwell: {', '.join(bad)}")


@app.command()
def home(
    rig: RigOption,
    axes: Annotated[list[str] | None, typer.Argument(metavar="[AXIS]...", show_default=False)] = None,
) -> None:
    """Find the turn of axes that turn further than their servos count: without AXIS, of those that need it."""
    from gonio.cli import console
    from gonio.errors import DeviceError, Interrupted

    choice = _choice(rig)
    service: Any = _service(choice, "home")
    try:
        with choice.naming():
            done: dict[str, Homed | str] = service.home(choice.description, axes or (), console.note)
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


# ---- inside ----


def _choice(rig: str) -> RigChoice:
    """The rig; a lamp is used by hand without its warm-up."""
    from gonio.acquisition.measure import find_rig

    choice = find_rig(rig)
    description = choice.description
    cold = description.lamp.model_copy(update={"warm_up_s": 0.0})
    return replace(choice, description=description.model_copy(update={"lamp": cold}))


def _bench(rig: str, *only: Device, sample: Path | None = None, seed: int = 0) -> Bench:
    from gonio.acquisition.measure import load_sample
    from gonio.by_hand.bench import Bench

    choice = _choice(rig)
    described = load_sample(sample) if sample is not None else None
    return Bench(choice.open(sample=described, seed=seed), choice.source, only)


def _service(choice: RigChoice, method: str) -> object:
    """The plugin, where it has a service for servos."""
    from gonio.errors import ConfigError

    if not hasattr(choice.plugin, method):
        raise ConfigError(f'the rig "{choice.source}" has no servos that can be reached by this')
    return choice.plugin


def _angles(texts: list[str]) -> dict[str, float]:
    """`light=30` as {"light": 30 degrees in radians}."""
    from gonio.errors import ConfigError

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


@contextlib.contextmanager
def _told_dark() -> Iterator[None]:
    """A command that lights nothing for longer: a lamp that could not be darkened has raised an error of its own."""
    from gonio.errors import Interrupted

    try:
        yield
    except (KeyboardInterrupt, Interrupted):
        raise Interrupted("interrupted; the lamp is dark") from None


@contextlib.contextmanager
def _told_where(bench: Bench, device: str = "arms") -> Iterator[None]:
    """Whatever ends a motion early: say where every axis stands now, and whether it holds."""
    from gonio.cli import console
    from gonio.errors import DeviceError, Interrupted

    if device != "arms":
        with _told_dark():
            yield
        return
    try:
        yield
    except (KeyboardInterrupt, Interrupted):
        raise Interrupted(f"interrupted; {_where(bench)}") from None
    except DeviceError:
        if bench.entered:
            console.note(_where(bench))
        raise


def _where(bench: Bench) -> str:
    if not hasattr(bench, "survey"):
        return "where the axes stand is not known: look at them"
    health, before, end = bench.read_arms(), None, time.monotonic() + AT_REST_S
    while time.monotonic() < end and (_moves(health) or _angles_of(health) != before):
        before = _angles_of(health)  # a servo that was stopped at speed overshoots, and comes back
        time.sleep(LOOK_S / 10)
        health = bench.read_arms()
    said = []
    for name in bench.description.axes():
        angle, torque = health.of(name, "angle"), health.of(name, "torque")
        if isinstance(angle, float):
            held = "" if torque is None else ", holds" if torque == "holds" else ", torque off"
            held += ", and moves still" if health.of(name, "motion") == "moves" else ""
            said.append(f"{name} {angle:.2f} deg{held}")
        else:
            said.append(f"{name} not known ({health.silent.get(name, 'no answer')})")
    return "the axes stand now: " + "; ".join(said)


def _moves(health: Health) -> bool:
    return any(r.quantity == "motion" and r.value == "moves" for r in health.readings)


def _angles_of(health: Health) -> dict[str, int]:
    """Angles in tenths of a degree, so that a flickering encoder stands still."""
    found = (r for r in health.readings if r.quantity == "angle")
    return {r.device: round(10 * float(r.value)) for r in found}
