"""Rigs that a command opens by hand: which devices, what lies in the holder, and what is said where it ends early.

Also the options that several of its commands take.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gonio import disk
from gonio.cli import console
from gonio.errors import ConfigError, DeviceError, Interrupted

if TYPE_CHECKING:
    from gonio.lab.acquisition.measure import RigChoice
    from gonio.lab.by_hand.manual_rig import ManualRig
    from gonio.lab.rig import Device


def choice_of(rig: str, *, without: str = "") -> RigChoice:
    """The rig, without calibrations of one kind; a lamp is used by hand without its warm-up."""
    from gonio.lab.acquisition.measure import find_rig

    choice = find_rig(rig, without=without)
    description = choice.description
    cold = description.lamp.model_copy(update={"warm_up_s": 0.0})
    return replace(choice, description=description.model_copy(update={"lamp": cold}))


def manual_rig_of(rig: str, *only: Device, sample: Path | None = None, seed: int = 0, without: str = "") -> ManualRig:
    """The rig with those devices to open (all, without names), and not entered yet; see `choice_of`."""
    from gonio.lab.by_hand.manual_rig import ManualRig
    from gonio.samples.files import load_sample

    choice = choice_of(rig, without=without)
    described = load_sample(sample) if sample is not None else None
    return ManualRig(choice.open(sample=described, seed=seed, by_hand=True), choice.source, only)


# ---- files ----


def require_rig_file(rig: str) -> None:
    """Raise `ConfigError` where a rig is named that is none of a file: nothing could be written for it."""
    if not Path(rig).is_file():
        raise ConfigError(f'"{rig}" is no rig file: gonio rig show {rig} > my.toml, then --rig my.toml')


def require_new(out: Path, *beside: Path) -> None:
    """Raise `ConfigError` where OUT is no name for a new .toml, or it, or what is written beside it, is there or cannot
    be written.
    """
    for name in (out, *beside):
        if name.exists():
            raise ConfigError(f"{name}: is there already; name another file with --out")
    if out.suffix != ".toml" or not out.absolute().parent.is_dir():
        raise ConfigError(f"--out {out}: must end with .toml, and lie in a folder that is there")
    disk.check_writable(out)  # an hour's data would have no place


def free_name(out: Path, what: str, suffix: str) -> Path:
    """A name beside OUT that is not taken: a command that was cut short, or refused, has left its data."""
    return disk.free_name(out.with_name(f"{out.stem}-{what}{suffix}"))


# ---- the holder ----


def put(manual: ManualRig, what: str, prompt: str, *, yes: bool, itself: bool = False) -> None:
    """Have the holder hold what is needed: by the rig (which may have done it `itself`), or by the person."""
    from gonio.lab.rig.protocols import Puts

    if not (isinstance(manual.rig, Puts) and manual.rig.put(what)) and not itself:
        confirm(prompt, "what lies in the holder", yes=yes)


def confirm(prompt: str, what: str, *, yes: bool) -> None:
    """Have the person do something and press Enter; with `yes` it is taken as done."""
    if yes:
        console.note(f"{prompt} (--yes: taken as done)")
        return
    print(f"{prompt}, then press Enter (Ctrl-C stops): ", end="", file=sys.stderr, flush=True)
    if not sys.stdin.readline():
        raise DeviceError(f"there is no terminal to confirm {what}; --yes asks for none")


# ---- how a rig was left ----


@contextlib.contextmanager
def told_dark(manual: ManualRig) -> Iterator[None]:
    """Say at an interruption whether the lamp is dark; for commands that end with a dark lamp."""
    try:
        yield
    except (KeyboardInterrupt, Interrupted):
        dark = getattr(manual.light, "known_dark", True)
        now = "the lamp is dark" if dark else "whether the lamp is dark is not known: look at it"
        raise Interrupted(f"interrupted; {now}") from None


@contextlib.contextmanager
def told_where(manual: ManualRig) -> Iterator[None]:
    """Whatever ends a motion early: say where every axis stands now, and whether it holds."""
    try:
        yield
    except (KeyboardInterrupt, Interrupted):
        raise Interrupted(f"interrupted; {_where(manual)}") from None
    except DeviceError:
        if manual.entered:
            console.note(_where(manual))
        raise


def _where(manual: ManualRig) -> str:
    from gonio.lab.rig.protocols import Surveys
    from gonio.lab.rig.whereabouts import axes_stand

    if manual.entered and hasattr(manual, "left"):
        return str(manual.left())
    if not isinstance(manual.rig, Surveys):
        return "where the axes stand is not known: look at them"
    return axes_stand(manual.read_arms, manual.description.axes())


def holding(manual: ManualRig) -> str:
    """What is true after a command that lit the lamp, and told the axes to hold."""
    holds = manual.can_hold and not manual.repeatable
    return "the lamp is dark" + ("; the axes hold, until gonio rig park" if holds else "")


Axis = Annotated[str, typer.Argument(help="light, camera, tilt, spin or azimuth.")]
RigOption = Annotated[str, typer.Option("--rig", help="A rig's name, or a rig file.")]
SampleOption = Annotated[Path | None, typer.Option("--sample", help="What a simulated rig looks at: a sample.toml.")]
WavelengthOption = Annotated[float | None, typer.Option("--wavelength-nm", help="The band that contains it [nm].")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of a simulated rig.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Ask nobody: what has to lie in the holder does.")]
Search = Annotated[float, typer.Option("--search", min=1, max=30, help="How far to look for the lamp [deg].")]
