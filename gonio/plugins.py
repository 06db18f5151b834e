"""Entry points: rigs, cameras, models, formats, commands, sections of reports, exports; ours and others' alike."""

import contextlib
import functools
import os
import sys
import traceback
import zlib
from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from gonio.errors import ConfigError, DataError, GonioError, did_you_mean, missing_package

Group = Literal[
    "gonio.rigs",
    "gonio.cameras",
    "gonio.stages",
    "gonio.models",
    "gonio.formats",
    "gonio.choosers",
    "gonio.exports",
    "gonio.records",
    "gonio.rooms",
    "gonio.sections",
    "gonio.commands",
]

ROOMS: dict[Group, dict[str, str]] = {
    "gonio.commands": {"watch": "gonio_watch", "render": "gonio_scenes", "photograph": "gonio_scenes"},
    "gonio.choosers": dict.fromkeys(("curve", "models", "parameters"), "gonio_sweeps"),
    "gonio.exports": {"bluesky": "gonio_bluesky"},
    "gonio.rooms": {"maps": "gonio_maps"},
}
"""What comes with packages that may be left out."""

_added: dict[tuple[Group, str], EntryPoint] = {}
"""What this process brings itself, beside what is installed."""


def available(group: Group) -> dict[str, EntryPoint]:
    """The entry points of a group by name, not yet imported."""
    here = {name: point for (of, name), point in _added.items() if of == group}
    return {**_installed(group, tuple(sys.path)), **here}


def add(group: Group, name: str, kind: type) -> None:
    """Let a class be found under a name in this process, as if an installed package had brought it.

    It is looked up where it was defined: a cell of a notebook that is run again replaces it.

    Raises
    ------
    ConfigError
        Something else of that name is installed, or the class is not to be found in its module (a class inside a
        function).
    """
    point = EntryPoint(name, f"{kind.__module__}:{kind.__qualname__}", group)
    what = kind_of(group)
    installed = _installed(group, tuple(sys.path)).get(name)
    if installed is not None:
        if load(group, name) is not kind:
            raise ConfigError(
                f'the {what} "{name}" ({point.value}): {installed.value} has that name already; give it another'
            )
        return
    if getattr(sys.modules.get(kind.__module__), kind.__qualname__, None) is not kind:
        raise ConfigError(
            f'the {what} "{name}" ({point.value}) is not found under that name in its module: define the class outside'
            " of functions, and run its cell again if it was replaced"
        )
    _added[group, name] = point


def _installed(group: Group, path: tuple[str, ...]) -> dict[str, EntryPoint]:
    """The first of each name: ours, where several packages bring one."""
    found: dict[str, EntryPoint] = {}
    for point in _every(group, path):
        found.setdefault(point.name, point)
    return found


@functools.lru_cache(maxsize=32)
def _every(group: Group, path: tuple[str, ...]) -> list[EntryPoint]:
    """Found once for a search path: the metadata of all packages are read for it, some 20 ms."""
    return sorted(entry_points(group=group), key=lambda point: (point.name, _package(point) != "gonio"))


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else "an unnamed package"


def passed_over(group: Group) -> list[str]:
    """What is not found because another package has brought something of the same name, a sentence each."""
    taken = _installed(group, tuple(sys.path))
    return [
        f'the {kind_of(group)} "{point.name}" ({point.value}) of {_package(point)} is passed over: '
        f"{_package(taken[point.name])} has brought that name; give it another"
        for point in _every(group, tuple(sys.path))
        if point is not taken[point.name]
    ]


def kind_of(group: Group) -> str:
    """What a group has, in the singular, for messages."""
    return "sampler" if group == "gonio.choosers" else group.removeprefix("gonio.").removesuffix("s")


def load(group: Group, name: str) -> Any:
    """What an entry point names.

    Raises
    ------
    ConfigError
        Nothing of that name is installed (with the nearest name), or its import fails (with its error).
    """
    points = available(group)
    kind = kind_of(group)
    if in_file(name):
        return _of_file(kind, name)
    missing = left_out(group, name)
    if missing:
        raise ConfigError(missing)
    if name not in points:
        hint = did_you_mean(name, points, f"installed: {', '.join(points) or 'none'}")
        raise ConfigError(f'there is no {kind} named "{name}"; {hint}')
    try:
        return imported(points[name])
    except Broken as error:
        raise ConfigError(f'the {kind} "{name}" ({points[name].value}) cannot be loaded: {error}') from error


def room(name: Literal["maps"]) -> Any:
    """What an optional package does for the commands of others; raises `ConfigError` where it is not installed."""
    return load("gonio.rooms", name)


def left_out(group: Group, name: str) -> str:
    """Why something that comes with an optional package is not there, in words; "" where that is not the reason."""
    package = ROOMS.get(group, {}).get(name)
    if package is None or find_spec(package) is not None:
        return ""
    return f'the {kind_of(group)} "{name}" comes with the package {package}, which is not installed here'


def in_file(name: str) -> bool:
    """Whether a name is that of a class in a Python file, as "./mine.py:Ward"."""
    return ".py:" in name


def _of_file(kind: str, name: str) -> Any:
    """A class in a file that is no package: the file is run once."""
    path, _, wanted = name.rpartition(":")
    if not Path(path).is_file():
        raise ConfigError(f"{path}: there is no such file, in which the {kind} {wanted} would be")
    module = _run(str(Path(path).absolute()), path)
    if not isinstance(getattr(module, wanted, None), type):
        classes = [n for n, v in vars(module).items() if isinstance(v, type) and v.__module__ == module.__name__]
        raise ConfigError(f'{path}: has no class "{wanted}"; it has: {", ".join(classes) or "none"}')
    return getattr(module, wanted)


_files: dict[str, ModuleType] = {}
"""Files that were run, by their whole path."""


def _run(file: str, shown: str) -> ModuleType:
    """A file as a module, whose name tells files of one name in different folders apart."""
    if file in _files:
        return _files[file]
    spec = spec_from_file_location(f"_gonio_file_{Path(file).stem}_{zlib.crc32(file.encode()):08x}", file)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    try:
        with contextlib.redirect_stdout(sys.stderr):
            spec.loader.exec_module(module)
    except (KeyboardInterrupt, MemoryError, GonioError):
        raise
    except BaseException as error:
        raise ConfigError(f"{shown}: cannot be run: {' '.join(f'{type(error).__name__}: {error}'.split())}") from error
    _files[file] = module
    return module


Carried = tuple[list[str], list[tuple[Group, str, str]]]


def carried() -> Carried:
    """What this process has beside what is installed, for another one that works for it: see `carry`.

    Raises
    ------
    ConfigError
        Something was defined in the main program, which no other process can import.
    """
    for (group, name), point in _added.items():
        if point.module == "__main__":
            raise ConfigError(f'the {kind_of(group)} "{name}" is of the main program, and of no module')
    return list(_files), [(group, name, point.value) for (group, name), point in _added.items()]


def carry(there: Carried) -> None:
    """Have what another process has: run its files, and know its names."""
    for file in there[0]:
        _run(file, file)
    for group, name, value in there[1]:
        _added[group, name] = EntryPoint(name, value, group)


@contextlib.contextmanager
def blamed(what: str) -> Iterator[None]:
    """Raise a `DataError` that begins with `what` where another's code in the block fails in any way but ours.

    `GONIO_TRACEBACK=1` shows where.
    """
    try:
        yield
    except (GonioError, OSError, MemoryError):
        raise
    except Exception as error:
        if os.environ.get("GONIO_TRACEBACK"):
            traceback.print_exception(error)
        said = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise DataError(f"{what} has failed ({said}); GONIO_TRACEBACK=1 shows where") from error


class Broken(Exception):
    """What an entry point names cannot be imported; the text is one line."""


def imported(point: EntryPoint) -> Any:
    """What an entry point names, whatever its module does while it is imported (but for `os._exit`).

    What the module prints goes to standard error: standard output is for results.

    Raises
    ------
    Broken
        The import fails, or ends the program (`sys.exit`), or the module lacks the name.
    """
    try:
        with contextlib.redirect_stdout(sys.stderr):
            return point.load()
    except (KeyboardInterrupt, MemoryError, GonioError):
        raise
    except SystemExit as end:
        raise Broken(f"its module ends the program on import (sys.exit({end.code!r}))") from end
    except BaseException as error:
        raise Broken(missing_package(error) or " ".join(f"{type(error).__name__}: {error}".split())) from error
