"""One measurement from its files to its folder: find the rig, check everything, then measure or go on measuring."""

from __future__ import annotations

import contextlib
import math
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from gonio import plugins
from gonio.config import Table, load, parse
from gonio.disk import check_writable
from gonio.errors import ConfigError, DeviceError, GonioError, Interrupted
from gonio.lab.acquisition.duration import Durations, as_begun, ordered
from gonio.lab.acquisition.plan import Assessed, Plan, assess, said_beside
from gonio.lab.acquisition.progress import Pause, Progress, Remaining, Silent, Stop
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.run_folder import begun, check_new
from gonio.lab.acquisition.run_settings import RunRequest
from gonio.lab.acquisition.schedule import going_on, reference_pose, schedule
from gonio.lab.rig import Pose, Rig, RigPlugin, Step, Target, kinematics, regions
from gonio.lab.rig.calibration_files import with_calibrations
from gonio.lab.rig.description import Reference, RigDescription
from gonio.lab.rig.motion_planning import Blocked, route
from gonio.lab.rig.polariser_axes import opened
from gonio.samples.description import SampleDescription
from gonio.samples.files import load_sample as load_sample

if TYPE_CHECKING:
    from gonio.lab.acquisition.resuming import Resumed
    from gonio.lab.acquisition.sampling import Sampler

    Prepared = tuple[Plan, "RigChoice", list[Assessed], Sampler | None]

SHOWN = 20
"""Frames that are named on the terminal, at most."""


@dataclass(frozen=True, slots=True)
class RigChoice:
    """A rig that was asked for: the program that drives it, its description, and where that came from."""

    plugin: RigPlugin
    description: RigDescription
    source: str

    def open(
        self, *, sample: SampleDescription | None = None, seed: int = 0, confirm: bool = False, by_hand: bool = False
    ) -> Rig:
        """The rig, built but not entered; see `RigPlugin.open`. Messages name the rig file.

        For work `by_hand` a plugin may have a method `open_by_hand(description, confirm=)`, which refuses less.
        """
        try:
            opened: Callable[..., Rig] | None = getattr(self.plugin, "open_by_hand", None)
            if by_hand and opened is not None:
                return opened(self.description, confirm=confirm)
            return self.plugin.open(self.description, sample=sample, seed=seed, confirm=confirm)
        except ConfigError as error:
            if Path(self.source).is_file():
                raise ConfigError(f"{self.source}: {error}") from None
            raise

    def schedule(self, plan: Plan, points: list[Assessed] | None = None) -> list[Step]:
        """The steps of a run, see `gonio.lab.acquisition.schedule.schedule`, of which every patch that is measured lies
        in the frame.

        Raises
        ------
        ConfigError
            No point or not the reference can be reached, or the frame does not hold a patch.
        """
        steps = schedule(plan, self.description, points)
        _check_frame(self, steps)
        return steps

    @contextlib.contextmanager
    def naming(self) -> Iterator[None]:
        """Let messages about a key of the rig file, which devices raise when they are opened, name the file too."""
        try:
            yield
        except (ConfigError, DeviceError) as error:
            if Path(self.source).is_file() and str(error).startswith("devices."):
                error.args = (f"{self.source}: {error}",)
            raise


def _certified(reference: Reference, rig_file: Path) -> Reference:
    """The reference with what its certificate says."""
    from gonio.formats.certificate import reflectance

    given = {"albedo", "u_rel", "spectrum", "table"} & reference.model_fields_set
    if given:
        raise ConfigError(
            f"{rig_file}: reference.certificate and reference.{min(given)} both say how bright the reference is; "
            "leave one out"
        )
    assert reference.certificate is not None
    path = (rig_file.parent / reference.certificate).absolute()
    known = reflectance(path, reference.certificate_quantity)
    u_rel = [u / value for u, value in zip(known.u, known.values, strict=True)]
    return reference.model_copy(
        update={
            "certificate": str(path),
            "albedo": known.values[len(known.values) // 2],
            "u_rel": max(u_rel),
            "spectrum": tuple(zip(known.wavelengths_nm, known.values, u_rel, strict=True)) if u_rel[1:] else (),
        }
    )


def _with_path(table: Table, key: str, rig_file: Path) -> Table:
    """A table of a rig file with the path of a file that a key names beside it, made whole."""
    name = getattr(table, key)
    return table if name is None else table.model_copy(update={key: str((rig_file.parent / name).absolute())})


def find_rig(name: str, *, without: str = "") -> RigChoice:
    """A rig by the name of its entry point, or by the path of a rig file whose key `rig` names the entry point.

    `without` is the kind of calibrations to pass over: those that are about to be made again.

    Raises
    ------
    ConfigError
        There is no such rig or file, the file is wrong, or a calibration that it names is not to be used.
    """
    path = Path(name)
    if path.suffix == ".toml" or len(path.parts) > 1 or path.is_file():
        description = load(RigDescription, path)
        if description.reference.scale != 1.0:
            raise ConfigError(
                f"{path}: reference.scale = {description.reference.scale:g} says what is true of a simulated rig, "
                "which nobody who measures there knows: write it into the file that `truth` names"
            )
        reference = _with_path(description.reference, "table", path)
        if reference.certificate is not None:
            reference = _certified(reference, path)
        tables = {"reference": reference, "camera": _with_path(description.camera, "maps", path)}
        description = _with_path(description.model_copy(update=tables), "truth", path)
        description = with_calibrations(description, path.parent, without=without)
        try:
            return RigChoice(plugins.load("gonio.rigs", description.rig), description, name)
        except ConfigError as error:
            raise ConfigError(f"{path}: rig = {description.rig!r}: {error}") from None
    plugin: RigPlugin = plugins.load("gonio.rigs", name)
    if not plugin.toml:
        raise ConfigError(f'the rig "{name}" needs a rig file: --rig my-{name}.toml, with rig = "{name}" in it')

    return RigChoice(plugin, parse(RigDescription, tomllib.loads(plugin.toml), f'rig file of "{name}"'), name)


def carry_out(
    plan: Plan,
    rig: RigChoice,
    out: str | Path,
    *,
    sample: SampleDescription | None = None,
    seed: int = 0,
    resume: bool = False,
    yes: bool = False,
    command: str = "",
    progress: Progress | None = None,
    last: bool = False,
    pause: Pause | None = None,
) -> Run:
    """Measure a plan on a rig into a folder. Everything that can be wrong is checked before the folder is made.

    Parameters
    ----------
    sample, seed
        For a simulated rig.
    resume
        Go on with a run that has begun.
    yes
        Ask for no confirmation when sample and reference are swapped by hand.
    command
        The command line, for the record.
    progress
        Who watches; nobody by default.
    last
        The process ends where this is left by an error: Ctrl-C is not heard any more then.
    pause
        Who may ask the run to wait between two steps, beside SIGTSTP and SIGCONT.

    Returns
    -------
    Run
        Closed for writing; it can be reduced.

    Raises
    ------
    GonioError
        See `gonio.lab.acquisition.loop.measure`, `Run.create`, `Run.resume` and the rig's own documentation.
    """
    out, progress = Path(out), progress or Silent()
    before = resume and begun(out)
    plan, rig, points, sampler = prepared(plan, rig, out if before else None)
    request = RunRequest(plan, rig.description, sample, seed, command, points)
    check_patches(rig, sample)
    steps = None if before else rig.schedule(plan, request.points)
    device = _open(rig, out, sample, seed, resume, yes)
    if steps is not None:
        _check_room(out, rig, plan, len(steps), progress, yes)
    with Stop(progress, last=last, pause=pause) as stop:
        return _measured(request, rig, device, out, steps, progress, stop, sampler, yes=yes)


def _measured(
    request: RunRequest, rig: RigChoice, device: Rig, out: Path, steps: Sequence[Step] | None, progress: Progress,
    stop: Stop, sampler: Sampler | None, *, yes: bool,
) -> Run:  # fmt: skip
    """A new run of these steps; without steps, one that has begun is gone on with. Errors say how the rig was left."""
    from gonio.lab.acquisition.loop import measure
    from gonio.lab.acquisition.repair import ASIDE
    from gonio.lab.acquisition.resuming import reopened

    resumed, entered = None, False
    try:
        with contextlib.ExitStack() as stack:
            if steps is None:
                resumed = reopened(out, request)
                run = stack.enter_context(resumed.run)
                _say_what_was_found(resumed, progress)
                steps = going_on(request.plan, rig.description, run.planned.flags)
                more = len(steps) - len(run.steps()) + len(resumed.found.damaged)
                _check_room(out, rig, request.plan, more, progress, yes)
            with rig.naming():
                stack.enter_context(device)
            entered = True
            _require_way(device, steps[1].pose)
            if resumed is None:
                run = stack.enter_context(Run.create(out, request))
                for line in said_beside(request.points, rig.description):
                    progress.say(line)
            elif aside := resumed.set_right():
                progress.say(f"{out}: {len(aside)} files of steps that were cut short are now in {out / ASIDE}")
            progress.expects(Remaining.of_run(run, steps, simulated=device.repeatable))
            measure(device, run, steps, progress, stop, sampler)
    except GonioError as error:
        if entered or isinstance(error, Interrupted):
            with stop.held():
                error.args = (_with_state(error, device, stop, entered=entered),)
        raise
    return run


def prepared(
    plan: Plan, rig: RigChoice, begun: Path | None = None
) -> tuple[Plan, RigChoice, list[Assessed] | None, Sampler | None]:
    """What a plan asks of a run on a rig: the plan in its order, the rig with the plan's visits to the reference.

    With them come its points as the rig sees them, where they had to be looked at for the order, and the sampler of an
    adaptive plan. `begun` is the folder of a run that is gone on with: its order is taken.

    Raises
    ------
    ConfigError
        A wavelength lies in no band of the rig, the reference cannot be reached, or the sampler is wrong.
    DataError
        The points of the run are damaged.
    """
    from gonio.lab.acquisition.sampling import sampler_of

    for band in plan.bands(rig.description):
        rig.description.reference.at(band.centre_nm)
    if plan.reference_every is not None:
        reference = rig.description.reference.model_copy(update={"every": plan.reference_every})
        rig = replace(rig, description=rig.description.model_copy(update={"reference": reference}))
    plan, sampler = sampler_of(plan, rig.description)
    if plan.order == "as-written":
        return plan, rig, None, sampler

    if begun is not None and (begun / "plan.csv").is_file():
        return as_begun(plan, Run.open(begun).planned.angles_deg.tolist()), rig, None, sampler
    description = rig.description
    durations = Durations(description, plan.bands(description))
    points = assess(plan, description)
    plan, points = ordered(plan, points, durations, reference_pose(description), description.reference.every)
    return plan, rig, points, sampler


def assessed(plan: Plan, rig: RigChoice) -> Prepared:
    """As `prepared` for a run that has not begun, with its points as the rig sees them in any case; raises the same."""

    plan, rig, points, sampler = prepared(plan, rig)
    return plan, rig, assess(plan, rig.description) if points is None else points, sampler


def _require_way(device: Rig, reference: Pose) -> None:
    """Raise where no way leads from where the axes stand to the first pose: planning knows all ways but this one."""

    if not device.description.looks_ahead:
        return
    try:
        route(device.description, device.arms.read(), reference)
    except Blocked as blocked:
        raise ConfigError(
            f"no way leads from where the axes stand now to the white reference: {blocked}. Bring them out of each "
            "other's way by hand, one axis at a time (gonio rig move), then measure"
        ) from None


def _with_state(error: GonioError, device: Rig, stop: Stop, *, entered: bool) -> str:
    """A message, with what is true of the rig now that it has been left."""
    from gonio.lab.rig.whereabouts import left

    promised = f"{'axes stopped' if stop.requested > 1 else 'arms parked'}, lamp dark"
    stopped = isinstance(error, Interrupted)
    state = left(device, promised if stopped and entered else "")
    again = (stopped or isinstance(error, DeviceError)) and "--resume" not in str(error)
    return "; ".join(filter(None, (str(error), state, "go on with --resume" if again else "")))


def _say_what_was_found(resumed: Resumed, progress: Progress) -> None:
    path, lost, unchecked = resumed.run.path, resumed.lost, resumed.found.unchecked
    if lost:
        progress.say(f"{path}: {len(lost)} frames are missing or damaged; their steps are taken again:")
        for text in lost[:SHOWN]:
            progress.say(f"  {text}")
        if len(lost) > SHOWN:
            progress.say(f'  and {len(lost) - SHOWN} more; the journal names all (event "lost")')
    if unchecked:
        progress.say(f"{path}: of {unchecked} frames only the size was compared; `gonio run check {path}` reads all")


def check(
    plan: Plan, rig: RigChoice, out: Path, *, sample: SampleDescription | None, seed: int, resume: bool, yes: bool
) -> Prepared:
    """Raise what `carry_out` would raise before it touches a device; its parameters. What `assessed` found."""
    plan, rig, points, _ = seen = assessed(plan, rig)
    check_patches(rig, sample)
    steps = rig.schedule(plan, points)
    _open(rig, out, sample, seed, resume, yes)
    if not (resume and begun(out)):
        _check_room(out, rig, plan, len(steps), Silent(), yes)
    return seen


def _open(rig: RigChoice, out: Path, sample: SampleDescription | None, seed: int, resume: bool, yes: bool) -> Rig:
    """The rig, built but not entered, after every check that needs no device."""
    attended = sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()
    device = rig.open(sample=sample, seed=seed, confirm=attended and not yes)
    opened(device)
    if sample is None and device.repeatable:
        raise ConfigError(f'the rig "{rig.source}" simulates its sample: name one with --sample S.toml')
    if rig.description.reference.how in ("swap", "beam") and not (device.repeatable or attended or yes):
        raise ConfigError(
            f'the rig "{rig.source}" has its white reference swapped by hand ([reference] how), and there is no '
            "terminal to ask for it; --yes measures without asking"
        )
    if resume and begun(out):
        check_writable(out)
    else:
        check_new(out)
    return device


def _check_room(out: Path, rig: RigChoice, plan: Plan, steps: int, progress: Progress, yes: bool) -> None:
    """Raise `ConfigError` where the disk has no room for `steps` steps; with `yes` that is only said."""
    from gonio.lab.acquisition.waits import Bytes, free_bytes, size

    needed, free = Bytes(rig.description, len(plan.bands(rig.description))).of_run(steps), free_bytes(out)
    if needed <= free:
        return
    text = f"{out}: {steps} steps need about {size(needed)} on the disk, and {size(free)} are free"
    if not yes:
        raise ConfigError(
            f"{text}: make room, choose a folder on another disk, or measure fewer points or frames; --yes measures "
            "all the same, and waits where the disk is full"
        )
    progress.say(f"{text}; the run waits where it is full (--yes)")


def check_patches(rig: RigChoice, sample: SampleDescription | None) -> None:
    """Raise `ConfigError` where the measured patch does not lie on the sample, or that of the reference on it alone."""
    description = rig.description
    reference, patch = description.reference, description.acquisition.roi_radius_mm
    diameter = (sample and sample.diameter_mm) or description.holder.sample_diameter_mm
    for name, size in (("sample", diameter), ("white reference", reference.diameter_mm)):
        if size < 2 * patch and not (name != "sample" and reference.how == "beam"):
            raise ConfigError(
                f"{rig.source}: the measured patch ([acquisition] roi_radius_mm = {patch:g}) is larger than the {name} "
                f"({size:g} mm in diameter): the plate around it would count as {name}"
            )
    distance = math.hypot(*reference.offset_mm)
    if reference.how == "beside" and distance < diameter / 2 + patch:
        x, y = reference.offset_mm
        raise ConfigError(
            f"{rig.source}: [reference] offset_mm = [{x:g}, {y:g}] puts the patch of the reference on the sample: "
            f"beside a sample of {diameter:g} mm its centre lies at least {diameter / 2 + patch:g} mm from the "
            "sample's centre (and the frame must hold both)"
        )


def _check_frame(rig: RigChoice, steps: list[Step]) -> None:
    """The frame must hold the measured patch of sample and reference whole, in every pose that they are looked at."""

    description = rig.description
    reference, patch, camera = description.reference, description.acquisition.roi_radius_mm, description.camera
    looks: dict[tuple[Target, Pose], None] = {}
    for step in steps:
        if step.kind == "reference" and reference.how == "beam":
            try:
                regions.straight_through(description, kinematics.view(description, step.pose))
            except ConfigError as error:
                raise ConfigError(f"{rig.source}: {error}") from None
        elif step.kind == "reference":
            looks["reference", step.pose] = None
        elif step.kind == "point" and not regions.always_holds_sample(description):
            looks["sample", step.pose] = None
    for target, pose in looks:
        extent = regions.patch_extent(description, kinematics.view(description, pose), target)
        if regions.frame_holds(description, extent):
            continue
        at, (left, right, top, bottom) = kinematics.directions(description, pose), extent
        radius, remedy = f"[acquisition] roi_radius_mm = {patch:g}", "measure a smaller patch"
        key = f"{radius} makes the patch of the {'white reference' if target == 'reference' else target} cover"
        if target == "reference" and reference.how == "beside":
            x, y = reference.offset_mm
            key = f"[reference] offset_mm = [{x:g}, {y:g}] puts the patch of the reference ({radius}) on"
            remedy = "bring the reference nearer to the sample"
        raise ConfigError(
            f"{rig.source}: {key} columns {left:.0f} to {right:.0f} and rows {top:.0f} to {bottom:.0f}, seen at "
            f"theta_i = {math.degrees(at.theta_i):g}, theta_r = {math.degrees(at.theta_r):g} deg; the frame has "
            f"{camera.width} columns and {camera.height} rows, counted from 0: {remedy}, or let the frame hold "
            "more (a shorter [camera] focal_length_mm, or a longer [geometry] camera_distance_mm)"
        )
