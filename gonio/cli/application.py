"""What the command line does: the core's own commands, and those that other packages add by entry point.

Whatever goes wrong ends here as one message on stderr and an exit code (docs: gonio/errors.py). Nothing heavy is
imported before a command needs it, so that `gonio --help` answers at once; and the module of another package's command
is imported by that command and by the help alone.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from gonio import platform, plugins
from gonio.cli.signals import Ending, deafen
from gonio.errors import ConfigError, DataError, GonioError, Incomplete, missing_package
from gonio.shown import visible

if TYPE_CHECKING:
    import typer

ORDER = ("demo", "rig", "calibrate", "plan", "measure", "watch", "run", "reduce", "fit", "compare", "report")
"""The order of the help: that of the work."""

FORMER = {"wavelength": "wavelength-nm"}
"""Options by their earlier spelling, which stays good and is in no help."""


class _Remarks(io.FileIO):
    """Standard error that drops its text where nothing takes it (a full disk, a reader that has gone)."""

    def write(self, text: Any) -> int:
        try:
            return super().write(text) or 0
        except OSError:
            return len(text)


class _Results(io.FileIO):
    """Standard output: what cannot be written ends the command, as an error that names it."""

    def write(self, text: Any) -> int | None:  # type: ignore[override]
        try:
            return super().write(text)
        except BrokenPipeError:
            raise DataError("") from None  # the reader has gone: there is nothing more to say
        except OSError as error:
            raise DataError(f"the results cannot be written to standard output: {_reason(error)}") from None


class _Passing(Exception):
    """Carries past typer what that would end in words of its own, or in silence."""

    def __init__(self, cause: BaseException) -> None:
        super().__init__(str(cause))
        self.cause = cause


def run(ending: Ending) -> Any:
    """Run what the arguments of the process ask for; its exit code, after a message where something went wrong.

    Raises
    ------
    KeyboardInterrupt
        A signal ended it.
    """
    try:
        _open_streams()
        code = _command_line()
        deafen()
        sys.stdout.flush()
        return code
    except Exception as error:
        cause = error.cause if isinstance(error, _Passing) else error
        if isinstance(cause, GonioError):
            if isinstance(cause, Incomplete):
                print(cause.written)
            return _fail(str(cause), cause.exit_code)
        if ending.heard or isinstance(cause, KeyboardInterrupt):  # libraries make errors of their own of it
            raise KeyboardInterrupt from None
        if os.environ.get("GONIO_TRACEBACK"):
            raise
        return _fail(*_explain(cause))


def _command_line() -> Any:
    """The exit code that typer ends the process with."""
    _require_text(*sys.argv[1:])
    application = build()
    try:
        application(prog_name="gonio")
    except SystemExit as end:
        return end.code
    return 0


def _explain(error: BaseException) -> tuple[str, int]:
    """What to tell a person of an error, and the exit code."""
    if _no_memory(error):
        why = f": {error}" if str(error) else ""
        return f"there is too little memory{why}; free some, or give it less data", 1
    if missing_package(error):
        return missing_package(error), 2
    if isinstance(error, RecursionError):
        return "an input file is nested too deeply (brackets in brackets)", 1
    if isinstance(error, OSError):
        if error.filename is not None:
            return f"{error.filename}: {_reason(error)}", 2
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            return f"a file cannot be written: {_reason(error)}", 1
    return (
        f"an error that should not happen: {type(error).__name__}: {error}\n"
        "  GONIO_TRACEBACK=1 shows where; please report it with that"
    ), 1


def _no_memory(error: BaseException) -> bool:
    """Whether an error says that memory is short, in one of the ways that libraries say it."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    words = (
        "failed to map segment",
        "find/load shared object",
        "annot allocate memory",
        "can't start new thread",
        "ut of memory",
    )
    return isinstance(error, ImportError | RuntimeError | OSError) and any(word in str(error) for word in words)


def _reason(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__


def _open_streams() -> None:
    """Standard streams that are there, whatever the caller has closed, and that no character or full disk stops.

    A number that is free would be given to the next file that is opened, and take what is printed.
    """
    for name, number in (("stdin", 0), ("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            handle = platform.nowhere()
            if handle != number and not _is_open(number):
                os.dup2(handle, number)
            setattr(sys, name, open(handle, "r" if name == "stdin" else "w", encoding="utf-8"))  # noqa: SIM115
    if sys.stdout is sys.__stdout__ and not (sys.stdout and sys.stdout.isatty()):
        sys.stdout = _over(sys.stdout, _Results)
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal that knows no ± shows a question mark
        sys.stdout.reconfigure(errors="replace")
    if sys.stderr is sys.__stderr__:
        sys.stderr = _over(sys.stderr, _Remarks)


def _over(stream: Any, raw: type[io.FileIO]) -> io.TextIOWrapper:
    """A text stream like another one, over a raw stream of a class."""
    return io.TextIOWrapper(
        io.BufferedWriter(raw(stream.fileno(), "w", closefd=False)),
        encoding=stream.encoding, errors=stream.errors,
        line_buffering=stream.line_buffering, write_through=stream.write_through,
    )  # fmt: skip


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True


def _require_text(*names: str) -> None:
    """Runs and reports are text (UTF-8) and name the files that they come from: those have to have names in text."""
    try:
        here = os.getcwd()
    except OSError as error:
        raise ConfigError(f"the current folder cannot be used ({error.strerror}): change to another one") from None
    for name in (here, *names):
        try:
            name.encode("utf-8")
        except UnicodeEncodeError:
            shown = os.fsencode(name).decode("utf-8", "backslashreplace")
            raise ConfigError(f"{shown}: the name is not valid UTF-8; rename the file or folder") from None


def _fail(message: str, code: int) -> int:
    """Say what went wrong; from here on no signal changes anything."""
    deafen()
    try:
        sys.stdout.flush()
    except DataError:  # nobody takes the results: Python would complain once more at the end
        os.dup2(platform.nowhere(), sys.stdout.fileno())
    if message:
        print(f"gonio: {visible(message)}", file=sys.stderr)
    return code


@contextlib.contextmanager
def _past_typer() -> Iterator[None]:
    """Let through what typer would end in silence, or as "Aborted!"."""
    try:
        yield
    except (KeyboardInterrupt, EOFError, OSError) as error:
        raise _Passing(error) from error


def _in_order(points: Mapping[str, Any]) -> type[typer.core.TyperGroup]:
    """The group of commands: ours and plug-ins', in the order of `ORDER`, each loaded when it is asked for."""
    import typer

    class InOrder(typer.core.TyperGroup):
        def list_commands(self, ctx: Any) -> list[str]:
            names = {n for n in (*super().list_commands(ctx), *points) if not plugins.left_out("gonio.commands", n)}
            return [n for n in ORDER if n in names] + sorted(names.difference(ORDER))

        def get_command(self, ctx: Any, cmd_name: str) -> Any:
            missing = plugins.left_out("gonio.commands", cmd_name)
            if missing:
                raise ConfigError(missing)
            known = cmd_name in self.commands or cmd_name in points
            for name in [cmd_name] if known else points:  # all for an unknown name: one is suggested
                if name in points and name not in self.commands:
                    self.add_command(_command(name, points[name]), name)
            return super().get_command(ctx, cmd_name)

        def make_context(self, *args: Any, **kwargs: Any) -> Any:
            with _past_typer():
                return super().make_context(*args, **kwargs)

        def invoke(self, ctx: Any) -> Any:
            with _past_typer():
                return super().invoke(ctx)

    return InOrder


def build() -> typer.Typer:
    """The application with every command that is installed."""
    import typer

    from gonio.cli import options, tables

    app = typer.Typer(
        cls=_in_order(plugins.available("gonio.commands")),
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,  # plain help: a coloured one costs twice the time until it shows
        context_settings={
            "help_option_names": ["-h", "--help"],
            "max_content_width": 110,
            "token_normalize_func": lambda name: FORMER.get(name, name),
        },
    )
    app.callback()(options.options)
    app.command()(tables.convert)
    return app


def _command(name: str, point: Any) -> Any:
    """The command, or the group of commands, that an entry point names; a broken one says so when it is called."""
    import typer

    def made(command: Any, **settings: Any) -> Any:
        app = typer.Typer(add_completion=False, rich_markup_mode=None)
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name, **settings)(command)
        return typer.main.get_group(app).commands[name]

    try:
        return made(plugins.imported(point))
    except Exception as error:  # of the import, or of making a command of what was imported
        text = str(error) if isinstance(error, plugins.Broken) else f"{type(error).__name__}: {error}"
        anything = {"ignore_unknown_options": True, "allow_extra_args": True}
        return made(_broken(name, text, point.value), context_settings=anything)


def _broken(name: str, error: str, value: str) -> Any:
    def command() -> None:
        raise ConfigError(f'the command "{name}" ({value}) cannot be loaded: {error}')

    command.__doc__ = f"(cannot be loaded: {error})"
    return command
