"""`gonio sim serve`: the twins of a laboratory rig, for rehearsal without hardware.

What `gonio measure` would refuse is refused before anything is served.
"""

from __future__ import annotations

import io
import shlex
import signal
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gonio.errors import ConfigError

if TYPE_CHECKING:
    from gonio.lab.rig.description import RigDescription
    from gonio.samples.description import SampleDescription
    from gonio_sim.wire.twins import Twins

app = typer.Typer(help="Twins of laboratory devices.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Twins of laboratory devices."""


@app.command()
def serve(
    rig: Annotated[str, typer.Option(help="A laboratory rig's file, or its name.")],
    sample: Annotated[Path | None, typer.Option(help="What lies in the holder: a sample.toml.")] = None,
    time_scale: Annotated[float, typer.Option(help="How many times faster than real motion and exposures run.")] = 1.0,
    out: Annotated[Path, typer.Option(help="Folder for ports, frames and the rig file to use.")] = Path("twin"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of what is drawn at random.")] = 0,
    fault: Annotated[
        list[str] | None, typer.Option(help='Inject a fault by name, or "NAME:AXIS"; "list" names them.')
    ] = None,
    tcp: Annotated[
        bool, typer.Option("--tcp", help="Serve at TCP ports of this computer; pseudo-terminals otherwise.")
    ] = False,
    after: Annotated[float, typer.Option(min=0.0, help="Seconds from the start until the faults happen.")] = 0.0,
) -> None:
    """Serve twins of a rig file's devices on pseudo-terminals, or over TCP. They run until Ctrl-C."""

    from gonio import platform
    from gonio.disk import require_own, write_own
    from gonio.lab.acquisition.measure import find_rig
    from gonio.samples.files import load_sample
    from gonio_sim.wire import faults
    from gonio_sim.wire.twins import Twins, rig_file

    wanted = fault or []
    if "list" in wanted:
        print("\n".join(faults.NAMES))
        return
    for name in wanted:
        if name.partition(":")[0] not in faults.NAMES:
            raise ConfigError(f"--fault {name}: there is no such fault; known: {', '.join(faults.NAMES)}")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)  # a file that is read meanwhile
    choice = find_rig(rig)
    described = load_sample(sample) if sample is not None else None
    if not choice.description.devices:
        raise ConfigError(f"{rig}: has no table [devices]: twins stand for a laboratory's devices (gonio rig show lab)")
    require_own(out, ["rig.toml"])
    stop = threading.Event()
    for number in platform.ENDING:
        signal.signal(number, lambda *_: stop.set())
    _require_twins(choice.description)
    with Twins(choice.description, described, seed, folder=out.absolute(), scale=time_scale, tcp=tcp) as twins:
        twins.world.step = time.time_ns() // 10**9  # no noise of an earlier serve again: a run may go on with this one
        path = out / "rig.toml"
        write_own(out, {path.name: rig_file(twins.description, Path(rig).parent).encode()})
        _require_measurable(rig, path, described)
        _announce(rig, path, twins)
        if not stop.wait(after):
            for name in wanted:
                what, _, axis = name.partition(":")
                twins.inject(what, axis=axis or None)
                print(f"fault armed: {name}")
            stop.wait()


def _announce(rig: str, path: Path, twins: Twins) -> None:
    """What to type next, and what runs."""
    from gonio_sim.wire.twins import TARGET_FILE

    mine, folder = shlex.quote(str(path)), path.parent
    print(f"twins of {rig} are running, {twins.scale:g} times as fast; Ctrl-C ends them. Next, in another terminal:")
    if twins.video and not twins.description.camera.response:
        print(
            f"  gonio calibrate camera --rig {mine} --response --out {shlex.quote(str(folder / 'camera.toml'))} --yes"
        )
        print(f"  printf '[calibration]\\nfiles = [\"camera.toml\"]\\n' >> {mine}")
    print(f"  gonio rig check --rig {mine}")
    print(f"  gonio measure PLAN --rig {mine} --out RUN --yes")
    target = shlex.quote(str(folder / TARGET_FILE))
    print(f"the twins swap what lies in the holder by themselves; another thing: echo mirror > {target}")
    if twins.tcp:
        print("\n".join(f"  {name}: {peer.port}" for name, peer in twins.peers.items()))
    if twins.replays:
        print(f"the camera has no twin: the images in {twins.description.devices['camera']['folder']} are replayed")
    elif twins.video:
        print(
            "the USB camera has a stand-in behind OpenCV's interface, in the process that measures: 8 bits, coded as "
            "sRGB has it; its exposures take their real time (v4l2loopback passes no exposure on, and is not used)"
        )
    elif twins.driver != "folder":
        print(f'a tethered camera with RAW files stands in for driver = "{twins.driver}", which has no twin')
    if twins.scale != 1.0:
        print(f"what is estimated by the rig file alone is the real rig's time, {twins.scale:g} times as long")


def _require_twins(description: RigDescription) -> None:
    """Raise `ConfigError` where a device would be silent, which `measure` asks for."""
    if "interlock" in description.devices and "axis" not in description.devices["interlock"]:
        raise ConfigError(
            "devices.interlock.port: a contact on a serial line has no twin; leave the table out of the file, or name "
            "a servo's port (devices.interlock.axis)"
        )
    if description.lamp.monitor:
        raise ConfigError("lamp.monitor = true: the lamp's twin has no monitor; leave the key out of the file")


def _require_measurable(rig: str, path: Path, sample: SampleDescription | None) -> None:
    """Raise `ConfigError`, which names the rig that was asked for, where `measure` refuses that of its twins."""
    from gonio.lab.acquisition.measure import check_patches, find_rig
    from gonio.lab.acquisition.schedule import reference_pose

    try:
        choice = find_rig(str(path))
        uncalibrated = choice.description.devices["camera"]["driver"] == "uvc-twin"  # as a webcam is at first
        if choice.open(by_hand=uncalibrated).repeatable:
            raise ConfigError(
                f'rig = "{choice.description.rig}" simulates all by itself and drives no device; rig = "lab" drives '
                "those of the table [devices]"
            )
        check_patches(choice, sample)
        reference_pose(choice.description)
    except ConfigError as error:
        text = str(error).removeprefix(f"{path}: ")
        raise ConfigError(f"{rig}: gonio measure would refuse its twins: {text}") from None
