"""Machine code on disk: what was cut, garbled, exchanged or outdated is compiled again, and never run."""

import functools
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest

from gonio import compiled


def _half(x: float) -> float:
    return x / 2.0


def _third(x: float) -> float:
    return x / 3.0


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the cache; each test may give one notice."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiled, "_told", False)
    return tmp_path


def make(function: Callable[[float], float] = _half) -> Any:
    """The function as a fresh process would get it."""
    return compiled.njit(numba.float64, nogil=True)(function)


def loaded(dispatcher: Any) -> bool:
    """Whether its machine code came from the disk."""
    return bool(dispatcher.stats.cache_hits)


def only(folder: Path, ending: str) -> Path:
    (found,) = folder.rglob(f"*{ending}")
    return found


def test_code_is_kept_and_loaded_without_a_word(cache: Path, capfd: pytest.CaptureFixture[str]) -> None:
    first = make()
    assert not loaded(first)
    again = make()
    assert loaded(again)
    assert first(3.0) == again(3.0) == 1.5
    assert compiled.njit(nogil=True)(_third)(6.0) == 2.0
    assert compiled.njit(nogil=True)(_third)(6.0) == 2.0
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("other", "same"), [(_half, True), (_third, False)])
def test_a_closure_is_kept_by_the_names_of_compiled_functions_in_it(
    cache: Path, other: Callable[[float], float], same: bool
) -> None:
    def twice(function: Callable[[float], float]) -> Any:
        inner = numba.njit(numba.float64(numba.float64))(function)  # in each process another object

        def outer(x: float) -> float:
            return 2.0 * inner(x)

        return make(outer)

    assert not loaded(twice(_half))
    again = twice(other)
    assert loaded(again) == same
    assert again(3.0) == (3.0 if same else 2.0)


def _cut(size: int, path: Path) -> None:
    path.write_bytes(path.read_bytes()[:size])


def _flip(place: float, path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[int(place * (len(content) - 1))] ^= 0x10
    path.write_bytes(content)


DAMAGE: dict[str, Callable[[Path], object]] = {
    **{f"cut to {size}": functools.partial(_cut, size) for size in (0, 1, 33, 100, -64, -1)},
    **{f"a bit at {place}": functools.partial(_flip, place) for place in (0, 0.2, 0.8, 1)},
    "zeros": lambda path: path.write_bytes(bytes(path.stat().st_size)),
    "more": lambda path: path.write_bytes(path.read_bytes() * 2),
    "text": lambda path: path.write_text("not compiled code\n"),
    "a pickle that ends the process": lambda path: path.write_bytes(b"cposix\n_exit\n(I7\ntR."),
}


@pytest.mark.parametrize("ending", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_file_is_made_again(
    cache: Path, capfd: pytest.CaptureFixture[str], damage: Callable[[Path], None], ending: str
) -> None:
    make()
    damage(only(cache, ending))
    again = make()
    assert not loaded(again)
    assert again(3.0) == 1.5
    (line,) = capfd.readouterr().err.splitlines()
    assert str(only(cache, ending)) in line
    assert "damaged" in line
    assert loaded(make())


def test_a_folder_in_the_place_of_a_file_costs_only_time(cache: Path, capfd: pytest.CaptureFixture[str]) -> None:
    make()
    index = only(cache, ".nbi")
    index.unlink()
    index.mkdir()
    again = make()
    assert not loaded(again)
    assert again(3.0) == 1.5
    assert len(capfd.readouterr().err.splitlines()) == 1


def test_an_index_without_its_code_is_no_damage(cache: Path, capfd: pytest.CaptureFixture[str]) -> None:
    make()
    only(cache, ".nbc").unlink()
    assert not loaded(make())
    assert loaded(make())
    assert capfd.readouterr().err == ""


def test_the_code_of_another_function_is_not_run(cache: Path) -> None:
    make(_half)
    half = only(cache, ".nbc")
    shutil.copy(half, half.with_suffix(".kept"))
    make(_third)
    (third,) = set(cache.rglob("*.nbc")) - {half}
    shutil.copy(half, third)
    assert make(_third)(6.0) == 2.0


def test_an_index_that_was_written_before_its_code_does_not_run_the_code_of_before(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A power cut between the two: the index is of the new version of the source file, the code of the old one."""
    locator = numba.core.caching.UserProvidedCacheLocator
    make()
    code = only(cache, ".nbc")
    before = code.read_bytes()
    monkeypatch.setattr(locator, "get_source_stamp", lambda self: "another version")
    assert not loaded(make())
    code.write_bytes(before)
    assert not loaded(make())
    assert loaded(make())


def test_a_folder_that_takes_no_files_is_said_once(
    cache: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def full(*names: Any) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(compiled._Files, "_open_for_write", full)
    assert make(_half)(3.0) == 1.5
    assert make(_third)(6.0) == 2.0
    (line,) = capfd.readouterr().err.splitlines()
    assert "cannot be kept (No space left on device)" in line


def test_a_compiled_function_is_an_argument_while_another_thread_brings_new_types() -> None:
    """As the first function that a process compiles does: of thousands of calls some failed each time."""
    program = """
import sys, threading
import numba
from numba.core.typing.typeof import typeof_impl
from gonio.compiled import njit

def bring():
    for k in range(2000):
        typeof_impl.register(type(f"Type{k}", (), {}), typeof_impl.dispatch(object))

sys.setswitchinterval(1e-6)
kernel = njit()(lambda x: x)
other = threading.Thread(target=bring)
other.start()
while other.is_alive():
    numba.typeof(kernel)
"""
    subprocess.run([sys.executable, "-c", program], check=True)


def test_where_numba_s_names_have_gone_its_plain_cache_serves(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "FunctionCache", None)
    assert make()(3.0) == 1.5
    assert loaded(make())
    assert compiled.njit(nogil=True)(_third)(6.0) == 2.0


def test_kernels_of_models_are_kept_so(cache: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from gonio.models import Lambert, _compile, _loops

    kernel, constants = Lambert(0.5)._evaluation(550.0)

    def fresh() -> Any:
        return _compile._loop(_loops.over_angles, kernel, len(constants))

    fresh()
    assert loaded(fresh())
    _cut(200, only(cache, ".nbc"))
    assert not loaded(fresh())
    assert "damaged" in capfd.readouterr().err
