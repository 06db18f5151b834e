"""Every error that a user can meet, as a tree under `GonioError`.

A message says what was asked (with its unit), what is allowed, where it came from (file and key, port, axis)
and what to do. Each class carries the exit code that the command line ends with.
"""

import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Literal


class GonioError(Exception):
    """Anything that the workbench reports to a person; the command line prints it without a traceback."""

    exit_code = 1


class DataError(GonioError):
    """A file or a table is unreadable, damaged, or does not hold what was asked of it (exit code 1)."""

    exit_code = 1


class Incomplete(DataError):
    """What was asked for is written, and parts of it are missing (exit code 1).

    Parameters
    ----------
    written
        What is there.
    message
        Says which parts are missing, and why.
    """

    def __init__(self, written: Path, message: str) -> None:
        super().__init__(message)
        self.written = written

    def __reduce__(self) -> tuple[type["Incomplete"], tuple[Path, str]]:
        return Incomplete, (self.written, str(self))


class DamagedFrame(DataError):
    """A raw frame of a run is missing, or is not the one that the journal names (exit code 1)."""


class ContradictoryFrame(DataError):
    """What a raw frame of a run says of itself is not what the journal or the rig file say (exit code 1)."""


class ConfigError(GonioError):
    """A wrong option, a wrong key or value in a configuration, or a missing input file (exit code 2)."""

    exit_code = 2


class ArgumentError(ConfigError, ValueError):
    """An argument of a function is outside its domain; the message names the argument (exit code 2)."""


class DeviceError(GonioError):
    """A device does not answer, refuses, or lands where it should not (exit code 3)."""

    exit_code = 3


class PassingFault(DeviceError):
    """A fault that often passes by itself: no frame came, a lamp gave no answer. What was exposed counts for nothing,
    and the step may be taken again after a while (exit code 3).

    Parameters
    ----------
    message
        What is wrong, after what the driver itself has tried.
    kind
        Which device: a key of `gonio.lab.acquisition.waits.WAITS_S`.
    """

    def __init__(self, message: str, kind: Literal["camera", "lamp"]) -> None:
        super().__init__(message)
        self.kind = kind


class Disturbed(DeviceError):
    """An axis was moved from its place by a little, or the lamp went dark by itself, and neither is out of order: what
    was exposed counts for nothing, and the step may be taken again (exit code 3).
    """


class EmergencyStop(DeviceError):
    """An interlock has stopped the rig: nothing is tried again before a person has acknowledged it (exit code 3)."""


class Interrupted(GonioError):
    """The run was stopped by the user, after the arms were parked and the lamp was dark (exit code 130)."""

    exit_code = 130


def did_you_mean(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """The end of a message on an unknown name: the known one that is nearest; `otherwise` where none is near."""
    import difflib

    near = difflib.get_close_matches(name, list(known), n=1)
    return f'did you mean "{near[0]}"?' if near else otherwise


def refuse_masked(name: str, value: object) -> None:
    """Raise `ArgumentError` for a masked array with masked elements, whose values numpy would use without a word."""
    if isinstance(value, list | tuple):
        for part in value:
            if isinstance(part, list | tuple) or hasattr(part, "filled"):
                refuse_masked(name, part)
        return
    if not hasattr(value, "filled"):
        return
    from numpy import ma

    if ma.is_masked(value):
        raise ArgumentError(f"{name} is a masked array: hidden values have no result; pass the others: .compressed()")


@contextlib.contextmanager
def os_error_as(error: type[GonioError], what: str) -> Iterator[None]:
    """Raise `error` where the system refuses: `what`, as in "a.csv: cannot be written", and the system's reason."""
    try:
        yield
    except OSError as refused:
        raise error(f"{what}: {refused.strerror or refused}") from None


EXTRAS = {
    **dict.fromkeys(("cv2", "rawpy", "serial", "dynamixel_sdk", "tomlkit"), "lab"),
    **dict.fromkeys(("openpyxl", "xlrd"), "workbooks"),
}
"""Modules that no installation needs to have -> the extra of this package that brings them."""


def missing_package(error: BaseException) -> str:
    """What to install where a module of `EXTRAS`, or an optional package of ours, is not there; "" of other errors."""
    name = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if name.startswith("gonio_"):
        return f"this needs the package {name}, which is not installed here"
    if name not in EXTRAS:
        return ""
    return f'this needs the package {name}, which is not installed: pip install "gonio[{EXTRAS[name]}]"'
