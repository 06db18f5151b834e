"""Running a plan on any rig: the loop of docs/acquisition.md.

The loop knows rigs by their protocols alone. Whatever happens, the rig's context leaves with the lamp dark and the arms
parked; a step is in the journal if, and only if, all of its frames are on the disk.
"""

import contextlib
import logging
from collections.abc import Iterator, Sequence

from gonio import __version__
from gonio.errors import DeviceError, Interrupted
from gonio.lab.acquisition.progress import Progress, Stop
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.sampling import Sampler, keepable
from gonio.lab.acquisition.schedule import Batch
from gonio.lab.acquisition.session import _Numbers, _Session, log
from gonio.lab.acquisition.waits import Watch, alive
from gonio.lab.rig import Rig, Step

CHOOSING_S = 600.0
"""A sampler may take as long as this to choose, with the lamp lit."""


def measure(
    rig: Rig, run: Run, steps: Sequence[Step], progress: Progress, stop: Stop, sampler: Sampler | None = None
) -> None:
    """Take every step of a run that its journal does not hold yet; then what its sampler names, until it is enough.

    Parameters
    ----------
    rig : Rig
        Entered: its devices are open.
    run : Run
        Created or resumed, so that it can be written.
    steps : sequence of Step
        The schedule of the run's plan on this rig.
    progress, stop
        Who watches, and who may ask to stop.
    sampler : Sampler, optional
        Of an adaptive run.

    Raises
    ------
    Interrupted
        The user asked to stop; what was finished is in the journal.
    DeviceError
        A device failed; the journal says so.
    DataError
        The disk is full or fails.
    """
    done = set(run.steps().numbers)
    left = [steps[number] for number in range(len(steps)) if number not in done]
    grown = run.grown_steps()
    left += [step for step in grown if step.index not in done]
    if not left and (sampler is None or run.enough):
        progress.say(f"{run.path}: every step is done")
        return
    numbers = _Numbers(steps, [*done, *(step.index for step in grown)])
    if done and not rig.repeatable:
        left = [numbers.again(step) for step in (steps[0], steps[1]) if step.index in done] + left
    watch = Watch(rig)
    run.append({"event": "session", "gonio": __version__, "steps": len(steps), "left": len(left)} | run.identity)
    progress.start(len(done) + len(left), len(done))
    try:
        _take_all(rig, run, left, numbers, watch, progress, stop, sampler)
    except Interrupted as error:
        if stop.requested > 1:
            rig.arms.stop()
        taken = run.steps().numbers
        every = done.union(taken, (step.index for step in (*left, *run.grown_steps())))
        where = f"after {len(taken)} of {len(every)} steps" + (" so far" if sampler is not None else "")
        raise Interrupted(f"{error} {where}") from None
    run.append({"event": "end", "steps": len(run.steps())})


def _take_all(
    rig: Rig,
    run: Run,
    left: list[Step],
    numbers: _Numbers,
    watch: Watch,
    progress: Progress,
    stop: Stop,
    sampler: Sampler | None,
) -> None:
    """Take steps; whatever ends that early, those that were taken whole are in the journal, and what it was."""
    with _Session(rig, run, numbers, watch, progress, stop) as session, _remarks(run, progress):
        try:
            begun = False
            while left or (left := _chosen(rig, run, numbers, progress, stop, sampler)):
                if not begun:
                    session.begin(left[0])
                    begun = True
                for step in left:
                    if stop.requested:
                        raise Interrupted("stopped")
                    session.take(step)
                session.finish()
                left = []
        except (Interrupted, DeviceError) as error:
            with stop.held():
                if isinstance(error, DeviceError) or stop.requested > 1:
                    rig.arms.stop()
                session.leave()
                kind = "interrupted" if isinstance(error, Interrupted) else "device_error"
                run.append({"event": kind, "message": str(error)})
            raise


def _chosen(
    rig: Rig, run: Run, numbers: _Numbers, progress: Progress, stop: Stop, sampler: Sampler | None
) -> list[Step]:
    """The steps of the batch that a sampler names, which the journal has now; none where it is enough."""
    if sampler is None or run.enough:
        return []
    if stop.requested:
        raise Interrupted("stopped")
    alive(rig, CHOOSING_S)
    choice = sampler.next(run)
    adaptive = run.settings.adaptive
    why = keepable(choice.why, adaptive.how if adaptive is not None else type(sampler).__name__)
    if choice.message:
        progress.say(choice.message)
    if not choice.points:
        run.append({"event": "enough", "met": bool(choice.met), "message": choice.message, "why": why})
        return []
    batch = Batch(numbers.following, len(run.points.flags), choice.points)
    steps = batch.steps(rig.description)
    numbers.following += len(steps)
    run.grow(batch, why)
    progress.more(len(steps))
    return steps


@contextlib.contextmanager
def _remarks(run: Run, progress: Progress) -> Iterator[None]:
    """Keep in the journal what drivers log on `gonio.devices` of their devices: a repetition, a recovery."""

    def emit(record: logging.LogRecord) -> None:
        message = record.getMessage()
        run.append({"event": "remark", "message": message})
        progress.say(message)

    handler = logging.Handler(logging.WARNING)
    handler.emit = emit  # type: ignore[method-assign]
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
