"""Entry points: rigs, cameras, models and commands, ours and a stranger's alike."""

from __future__ import annotations

import contextlib
import difflib
import functools
import sys
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from gonio.errors import ConfigError, GonioError

Group = Literal["gonio.rigs", "gonio.cameras", "gonio.models", "gonio.commands"]


def available(group: Group) -> dict[str, EntryPoint]:
    """The entry points of a group by name, not yet imported."""
    return dict(_installed(group, tuple(sys.path)))


@functools.lru_cache(maxsize=32)
def _installed(group: Group, path: tuple[str, ...]) -> dict[str, EntryPoint]:
    """Found once for a search path: the metadata of all packages are read for it, some 20 ms."""
    return {point.name: point for point in sorted(entry_points(group=group), key=lambda p: p.name)}


def load(group: Group, name: str) -> Any:
    """What an entry point names.

    Raises
    ------
    ConfigError
        Nothing of that name is installed (with the nearest name), or its import fails (with its error).
    """
    points = available(group)
    kind = group.removeprefix("gonio.").removesuffix("s")
    if name not in points:
        near = difflib.get_close_matches(name, points, n=1)
        hint = f'did you mean "{near[0]}"?' if near else f"installed: {', '.join(points) or 'none'}"
        raise ConfigError(f'there is no {kind} named "{name}"; {hint}')
    try:
        return imported(points[name])
    except Broken as error:
        raise ConfigError(f'the {kind} "{name}" ({points[name].value}) cannot be loaded: {error}') from error


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
        raise Broken(" ".join(f"{type(error).__name__}: {error}".split())) from error
