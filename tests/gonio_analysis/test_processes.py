"""One pool for tables and figures: what travels, what is done here, and what becomes of a job that ends its process."""

import os
import subprocess
import sys
import traceback
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from gonio_analysis.processes import Died, Processes, processes
from gonio_analysis.selection import parallel

from gonio import plugins
from gonio.errors import DataError
from gonio.progress import Say


def _whose(job: object) -> int:
    return os.getpid()


def _refuses(job: int) -> int:
    if job == 2:
        raise DataError(f"table {job} is empty")
    return job


class _Awkward(Exception):
    """One that pickle makes no copy of."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}")


def _awkward(job: int) -> int:
    raise _Awkward(job, job)


def _answers_with_a_lambda(job: int) -> Any:
    return lambda: job


def _ends_once(marker: str) -> str:
    """Ends the first process that it is given to."""
    try:
        os.close(os.open(marker, os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return marker
    os._exit(9)


def _reads(job: int) -> str:
    return sys.stdin.read()


def test_an_error_of_another_process_is_the_same_error_and_says_where() -> None:
    with processes(2) as pool, pytest.raises(DataError, match=r"^table 2 is empty$") as raised:
        list(pool.each(_refuses, range(4)))
    assert "_refuses" in "".join(traceback.format_exception(raised.value))


def test_an_error_that_cannot_travel_is_told_in_words() -> None:
    with processes(2) as pool, pytest.raises(RuntimeError, match="_Awkward: "):
        list(pool.each(_awkward, range(4)))


def test_what_cannot_travel_is_done_here() -> None:
    """There and back: neither a function that pickle does not take, nor a result."""
    with processes(2) as pool:
        assert sorted(pool.each(lambda job: os.getpid() + job, range(4))) == [(k, os.getpid() + k) for k in range(4)]
        assert sorted(made() for _, made in pool.each(_answers_with_a_lambda, range(4))) == [0, 1, 2, 3]
        assert os.getpid() not in {pid for _, pid in pool.each(_whose, range(4))}


def test_a_job_whose_process_was_killed_is_done_once_more_elsewhere(tmp_path: Path) -> None:
    markers = [str(tmp_path / name) for name in "abcd"]
    assert dict(parallel.each(_ends_once, markers, workers=2)) == dict(enumerate(markers))


def test_the_others_are_done_before_a_job_that_ends_every_process() -> None:
    done = dict[int, int]()
    with pytest.raises(Died, match=r"want of memory"):
        _keep(parallel.each(_deadly, [0, 1, 2, 3, 4], workers=2), done)
    assert sorted(done) == [0, 2, 3, 4]


def _keep(found: Iterable[tuple[int, int]], done: dict[int, int]) -> None:
    for k, value in found:
        done[k] = value


def _deadly(job: int) -> int:
    if job == 1:
        os._exit(7)
    return job


def test_a_job_that_asks_for_input_gets_none() -> None:
    assert dict(parallel.each(_reads, range(4), workers=2)) == dict.fromkeys(range(4), "")


@pytest.mark.parametrize("executable", ["", "false"])
def test_without_another_process_all_is_done_here(executable: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that embeds Python has none, or one that does something else."""
    monkeypatch.setattr(sys, "executable", executable)
    assert dict(parallel.each(_whose, range(4), workers=2)) == dict.fromkeys(range(4), os.getpid())


WARD = """
import gonio.models
class Half(gonio.models.Lambert):
    pass
class Double(gonio.models.Lambert):
    pass
"""


def _class_of(job: Any) -> tuple[str, int]:
    return type(job).__name__, os.getpid()


def test_objects_of_a_class_in_a_file_travel(tmp_path: Path) -> None:
    """As of `--model ./mine.py:Ward`; two classes of a file, and files of one name in two folders."""
    found = []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mine.py").write_text(WARD)
        found += [plugins.load("gonio.models", f"{tmp_path / folder}/mine.py:{name}") for name in ("Half", "Double")]
    assert len(set(found)) == 4
    jobs = [kind(0.5) for kind in found]
    got = dict(parallel.each(_class_of, jobs, workers=2))
    assert [got[k][0] for k in range(4)] == ["Half", "Double"] * 2
    assert os.getpid() not in {pid for _, pid in got.values()}


SCRIPT = """
import sys
from gonio_analysis import report
from gonio_analysis.selection import parallel

def double(job):
    return 2 * job

class Kept:
    def __init__(self, value):
        self.value = value

def kept(job):
    return Kept(job)

count = int(sys.argv[2])
assert dict(parallel.each(double, range(count), workers=2)) == {k: 2 * k for k in range(count)}
assert [one.value for _, one in sorted(parallel.each(kept, range(count)), key=lambda p: p[0])] == list(range(count))
tables = [f"{sys.argv[1]}/t{k}.csv" for k in range(count)]
print(report.make(tables, sys.argv[1] + "/page", models=["lambert"]))
"""


@pytest.mark.slow
def test_a_script_needs_no_guard(tmp_path: Path) -> None:
    """Functions and classes of the script itself, and a report of more tables than processes."""
    from gonio import measurement  # here: each process of the other tests imports this module
    from gonio.models import build
    from tests.gonio_analysis.synthetic import measure

    count = 3
    for k in range(count):
        frame = measure(build("lambert", {"albedo": 0.5}), incidences=(30.0,), name=f"m{k}", seed=k)
        measurement.write(frame, tmp_path / f"t{k}.csv")
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "-W", "error", tmp_path / "script.py", tmp_path, str(count)],
        capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    assert done.stderr == ""
    assert done.stdout == f"{tmp_path / 'page' / 'index.html'}\n"


def _told(k: int, say: Say) -> int:
    say(f"job {k}")
    return k


def test_shared_jobs_keep_their_order_whoever_is_lost(tmp_path: Path) -> None:
    words: list[str] = []
    with processes(2) as pool:
        pool._processes[0].kill()
        assert pool.share([partial(_told, k) for k in range(20)], say=words.append) == list(range(20))
    assert sorted(words) == sorted(f"job {k}" for k in range(20))
    assert Processes().share([partial(_told, 0)]) == [0]
