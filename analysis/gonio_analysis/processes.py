"""Processes that work beside this one: the only pool of the analysis, for fits, tables and figures alike.

A job is sent as a pickle, and its result comes back as one: only this process writes files. The others read from a
pipe, and end when it closes, however this process ends. They import what they are sent and nothing of the program that
runs here: a script needs no guard around its main part, and such a process may have processes of its own.

What cannot travel (a function or a class of the script itself or of a notebook, a lambda) is done here.

Most processes that die do so for want of memory. Therefore none takes the place of one that has died while the others
work. Its job is done once more at the end, alone, in a new process; one that ends that process too is lost, and is
never done here, where it would take everything along.
"""

from __future__ import annotations

import importlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import IO, Any, BinaryIO, Generic, Literal, TypeVar

from gonio import platform, plugins
from gonio.errors import DataError
from gonio.progress import Pace, Say, silent

In = TypeVar("In")
Out = TypeVar("Out")
Job = Callable[[Say], Out]
"""Called with what takes lines of progress; to travel, it is a function of a module with its arguments
(`functools.partial`)."""
TRIES = 2
"""Processes that a job may end."""
HEAD = 8
"""Bytes that say how long a message is."""
LATE_S = 5.0
"""Longest wait for the exit code of a process that has closed its pipe."""


class Died(DataError):
    """A job ended every process that it was given to."""


class Elsewhere(Exception):
    """The traceback of an error in another process, as text; it stands before that of this one."""


@dataclass(frozen=True)
class Outcome(Generic[Out]):
    """What came of a job."""

    kind: Literal["done", "raised", "died", "here"]
    """"here": it could not be sent, or there was no process: it is to be done in this one."""
    value: Out | None = None
    error: BaseException | None = None

    def result(self) -> Out:
        """The value, or the error raised."""
        if self.error is not None:
            raise self.error
        return self.value  # type: ignore[return-value]


class OtherProcess:
    """One of the other processes."""

    def __init__(self, modules: Sequence[str] = ()) -> None:
        self.ready = False
        where = [folder or os.getcwd() for folder in sys.path]
        code = f"import sys; sys.path[:] = {where!r}; from gonio_analysis.processes import serve; serve()"
        command = [sys.executable, "-P", "-c", code]
        with platform.deaf_children():
            if os.name != "posix":
                self.process = subprocess.Popen(
                    [*command, "-", *modules], stdin=subprocess.PIPE, stdout=subprocess.PIPE
                )
                assert self.process.stdout is not None
                self._answers: IO[bytes] = self.process.stdout
                return
            mine, theirs = os.pipe()  # what a job prints goes where this process prints
            try:
                self.process = subprocess.Popen(
                    [*command, str(theirs), *modules], stdin=subprocess.PIPE, pass_fds=[theirs]
                )
            except BaseException:
                os.close(mine)
                raise
            finally:
                os.close(theirs)
            self._answers = os.fdopen(mine, "rb")

    def do(self, job: Job[Out], say: Say) -> Outcome[Out]:
        """Have a job done there."""
        try:
            sent = pickle.dumps(plugins.carried()), pickle.dumps(job)
        except MemoryError:
            raise
        except Exception:  # pickle raises what it likes
            return Outcome("here")
        try:
            if not self.ready:
                _read(self._answers)
                self.ready = True
        except (OSError, EOFError):  # it never came to work: no job is to blame
            return Outcome("here")
        try:
            assert self.process.stdin is not None
            for part in sent:
                _write(part, self.process.stdin)
            while True:
                kind, content = _loaded(_read(self._answers))
                if kind == "raised":
                    error, where = content
                    error.__cause__ = Elsewhere(where)
                    return Outcome(kind, error=error)
                if kind != "says":
                    return Outcome(kind, content)
                say(content)
        except (OSError, EOFError):
            return Outcome("died", error=Died(self._how()))

    def _how(self) -> str:
        """How it died, in words."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(LATE_S)
        code = self.process.returncode
        how = f"by {signal.Signals(-code).name}" if code is not None and code < 0 else f"with exit code {code}"
        return (
            f"a process that worked on a part of this has died, and the one that took its place ended {how}: most often"
            " for want of memory; free some, or give less at once"
        )

    def end(self) -> None:
        """Kill the process, and forget it."""
        self.process.kill()
        with suppress(OSError):  # what it was being sent
            self.process.communicate()
        self._answers.close()


class Processes:
    """Some processes, which may be none, and what is shared out among them."""

    def __init__(self, modules: Sequence[str] = ()) -> None:
        self._workers, self._modules = list[OtherProcess](), modules

    @property
    def _processes(self) -> list[subprocess.Popen[bytes]]:
        return [worker.process for worker in self._workers]

    def grow(self, count: int) -> None:
        """Start processes until there are so many, or no more can be."""
        while len(self._workers) < count and sys.executable:
            try:
                self._workers.append(OtherProcess(self._modules))
            except OSError:  # no process or no memory for one: those that there are do the work
                return

    def stop(self) -> None:
        """Kill the processes."""
        for worker in self._workers:
            worker.process.kill()

    def end(self) -> None:
        """Kill the processes, and wait until they have gone."""
        self.stop()
        for worker in self._workers:
            worker.end()

    def each(self, function: Callable[[In], Out], jobs: Sequence[In]) -> Iterator[tuple[int, Out]]:
        """The number of every job and the function's result for it, as they become ready; this process only waits.

        The first error of a job ends all.
        """
        tasks: list[Job[Out]] = [partial(_of, function, job) for job in jobs]
        deaths = dict.fromkeys(range(len(tasks)), 0)
        with self._at_work(tasks, len(self._workers), silent) as work:
            while (one := work.next()) is not None:
                k, outcome = one
                if outcome.kind == "died":
                    deaths[k] += 1
                    continue
                del deaths[k]
                yield k, tasks[k](silent) if outcome.kind == "here" else outcome.result()
        for k, outcome in self._afterwards(tasks, deaths, silent):
            yield k, outcome.result()

    def outcomes(
        self,
        jobs: Sequence[Job[Out]],
        what: str = "",
        say: Say = silent,
        meanwhile: Callable[[], object] = lambda: None,
    ) -> list[Outcome[Out]]:
        """What came of every job, in their order: it is done, or has ended its processes. An error of one ends all.

        Parameters
        ----------
        jobs
            What to do; this process works, too.
        what, say
            What they are is said with how many are done.
        meanwhile
            Done here, while the others begin.
        """
        pace, made = Pace(what, len(jobs), say), dict[int, Outcome[Out]]()
        with self._at_work(jobs, max(len(jobs) - 1, 0), say) as work:
            meanwhile()
            for k in _taken(work.waiting):
                made[k] = Outcome("done", jobs[k](say))
                pace.step(len(made) + work.found.qsize())
            while (one := work.next()) is not None:
                made[one[0]] = one[1]
                pace.step(len(made))
        for outcome in made.values():
            if outcome.kind == "raised":
                outcome.result()
        died = {k: int(k in made) for k in range(len(jobs)) if k not in made or made[k].kind == "died"}
        made |= dict(self._afterwards(jobs, died, say))
        return [Outcome("done", jobs[k](say)) if made[k].kind == "here" else made[k] for k in range(len(jobs))]

    def share(self, jobs: Sequence[Job[Out]], what: str = "", say: Say = silent) -> list[Out]:
        """See `gonio_analysis.selection.parallel.Share`."""
        return [outcome.result() for outcome in self.outcomes(jobs, what, say)]

    @contextmanager
    def _at_work(self, jobs: Sequence[Job[Out]], most: int, say: Say) -> Iterator[_Work[Out]]:
        """At most so many processes take jobs meanwhile; what ends the block ends them at once."""
        work = _Work(jobs, self._workers[:most], say)
        try:
            work.start()
            yield work
        except BaseException:
            self.stop()
            raise
        finally:
            work.join()

    def _afterwards(
        self, jobs: Sequence[Job[Out]], deaths: dict[int, int], say: Say
    ) -> Iterator[tuple[int, Outcome[Out]]]:
        """What is left, one job after another in one process; by number, with how many processes each has ended."""
        if deaths:
            self.end()
            self._workers = []
        for k in sorted(deaths, key=lambda k: -deaths[k]):
            outcome, count = Outcome[Out]("here"), deaths[k]
            while count < TRIES:
                self.grow(1)
                outcome = self._workers[0].do(jobs[k], say) if self._workers else Outcome("here")
                if outcome.kind != "died":
                    break
                count += 1
                self._workers.pop().end()
            if outcome.kind == "here" and deaths[k]:
                outcome = Outcome("died", error=Died("a process has died, and none can be started in its place"))
            elif outcome.kind == "here":
                outcome = Outcome("done", jobs[k](say))
            yield k, outcome


class _Work(Generic[Out]):
    """Jobs that some processes are at, each through a thread that hands them over."""

    def __init__(self, jobs: Sequence[Job[Out]], workers: Sequence[OtherProcess], say: Say) -> None:
        self.waiting, self.found = queue.SimpleQueue[int](), queue.SimpleQueue[tuple[int, Outcome[Out]] | None]()
        for k in range(len(jobs)):
            self.waiting.put(k)
        self._jobs, self._say = jobs, say
        self._hands = [threading.Thread(target=self._hand_over, args=(w,), daemon=True) for w in workers]
        self._busy = 0

    def start(self) -> None:
        for hand in self._hands:
            hand.start()
            self._busy += 1

    def join(self) -> None:
        for hand in self._hands[: self._busy]:
            hand.join()

    def next(self) -> tuple[int, Outcome[Out]] | None:
        """What is ready next; None where all processes have ended their work."""
        while self._busy:
            if (one := self.found.get()) is not None:
                return one
            self._busy -= 1
        return None

    def _hand_over(self, worker: OtherProcess) -> None:
        """Have a process do what is waiting, until there is nothing, or it has died, or a job has failed."""
        try:
            for k in _taken(self.waiting):
                try:
                    outcome = worker.do(self._jobs[k], self._say)
                except BaseException as error:
                    outcome = Outcome("raised", error=error)
                self.found.put((k, outcome))
                if outcome.kind == "raised":
                    list(_taken(self.waiting))
                if outcome.kind in ("died", "raised") or not worker.ready:
                    return
        finally:
            self.found.put(None)


@contextmanager
def processes(count: int) -> Iterator[Processes]:
    """Some processes, which end with the block."""
    pool = Processes()
    try:
        pool.grow(count)
        yield pool
    finally:
        pool.end()


def _taken(waiting: queue.SimpleQueue[int]) -> Iterator[int]:
    while True:
        try:
            yield waiting.get_nowait()
        except queue.Empty:
            return


def _of(function: Callable[[In], Out], job: In, say: Say) -> Out:
    return function(job)


# ---- what goes over the pipes ----------------------------------------------------------------------------------------


def _write(content: bytes, sink: Any) -> None:
    sink.write(len(content).to_bytes(HEAD))
    sink.write(content)
    sink.flush()


def _read(source: IO[bytes]) -> bytes:
    """One message; raises `EOFError` where the other side has gone."""
    head = source.read(HEAD)
    content = source.read(int.from_bytes(head)) if len(head) == HEAD else b""
    if len(head) < HEAD or len(content) < int.from_bytes(head):
        raise EOFError
    return content


def _loaded(answer: bytes) -> tuple[Any, Any]:
    try:
        kind, content = pickle.loads(answer)
    except MemoryError:
        raise
    except Exception:  # a result whose class is not to be found here
        return "here", None
    return kind, content


def serve() -> None:
    """Do the jobs that stand on standard input until it ends.

    The first argument is the handle that answers go to ("-" for standard output); the others are modules that will be
    needed.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that started this one decides
    source, nowhere = os.fdopen(os.dup(0), "rb"), platform.nowhere()
    os.dup2(nowhere, 0)  # a job that asks for input gets none
    if sys.argv[1] == "-":
        sink = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)  # what a library prints is no answer
    else:
        sink = os.fdopen(int(sys.argv[1]), "wb")
    os.close(nowhere)
    came: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(source, came), daemon=True).start()
    for module in sys.argv[2:]:
        importlib.import_module(module)
    _write(b"ready", sink)
    while True:
        carried, job = came.get(), came.get()
        _write(_answer(carried, job, sink), sink)


def _receive(source: BinaryIO, came: queue.SimpleQueue[bytes]) -> None:
    """Take jobs in; when the other process has gone, in whatever way, end this one in the midst of its work."""
    with suppress(OSError, EOFError):
        while True:
            came.put(_read(source))
    os._exit(1)


def _answer(carried: bytes, job: bytes, sink: BinaryIO) -> bytes:
    """What is said of a job, as a pickle."""
    try:
        plugins.carry(pickle.loads(carried))
        call: Job[object] = pickle.loads(job)
    except MemoryError as error:
        return _raised(error)
    except Exception:  # of the main script, or of a notebook: the process that knows it does it
        return pickle.dumps(("here", None))
    try:
        value = call(lambda text: _write(pickle.dumps(("says", text)), sink))
    except BaseException as error:
        return _raised(error)
    try:
        return pickle.dumps(("done", value))
    except MemoryError as error:
        return _raised(error)
    except Exception:
        return pickle.dumps(("here", None))


def _raised(error: BaseException) -> bytes:
    """An error with the place where it was raised; as text, where it cannot be sent itself."""
    where = "".join(traceback.format_exception(error)).rstrip()
    try:
        sent = pickle.dumps(("raised", (error, where)))
        pickle.loads(sent)
    except Exception:
        return pickle.dumps(("raised", (RuntimeError(f"{type(error).__name__}: {error}"), where)))
    return sent
