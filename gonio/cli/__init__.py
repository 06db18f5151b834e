"""The command line `gonio`: the core's own commands, and those that other packages add by entry point.

Whatever goes wrong ends here as one message on stderr and an exit code (docs: gonio/errors.py). Nothing heavy is
imported before a command needs it, so that `gonio --help` answers at once.
"""

from __future__ import annotations

import io
import os
import signal
import sys
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import typer

ORDER = ("demo", "rig", "plan", "measure", "reduce", "fit", "compare", "report")
"""The order of the help: that of the work."""


TOGETHER_S = 1.0
"""Ctrl-C, pressed again and again within so long, is one: what it ends has the time to be left in order."""


class _CtrlC:
    """What SIGINT does in the command line."""

    def __init__(self) -> None:
        self._last_s = -TOGETHER_S

    def __call__(self, number: int, frame: object) -> None:
        before_s, self._last_s = self._last_s, time.monotonic()
        if self._last_s - before_s > TOGETHER_S:
            raise KeyboardInterrupt


def main() -> None:
    """Run the command line, and end the process with its exit code."""
    from gonio.errors import GonioError

    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal that knows no ± shows a question mark
        sys.stdout.reconfigure(errors="replace")
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _CtrlC())
    try:
        _require_text(*sys.argv[1:])
        build()(prog_name="gonio")
    except GonioError as error:
        fail(str(error), error.exit_code)
    except KeyboardInterrupt:
        fail("interrupted", 130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader has gone: nothing more to say
        sys.exit(1)
    except Exception as error:
        if os.environ.get("GONIO_TRACEBACK"):
            raise
        fail(
            f"an error that should not happen: {type(error).__name__}: {error}\n"
            "  GONIO_TRACEBACK=1 shows where; please report it with that",
            1,
        )


def _require_text(*names: str) -> None:
    """Runs and reports are text (UTF-8) and name the files that they come from: those have to have names in text."""
    from gonio.errors import ConfigError

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


def fail(message: str, code: int) -> None:
    """End the process with a message on stderr; from here on Ctrl-C changes nothing."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.stdout.flush()
    print(f"gonio: {message}", file=sys.stderr)
    sys.exit(code)


def build() -> typer.Typer:
    """The application with every command that is installed."""
    import typer

    from gonio import plugins
    from gonio.cli import measuring, options, plans, rigs, runs, tables

    class InOrder(typer.core.TyperGroup):
        def list_commands(self, ctx: Any) -> list[str]:
            names = super().list_commands(ctx)
            return [n for n in ORDER if n in names] + sorted(set(names).difference(ORDER))

    app = typer.Typer(
        cls=InOrder,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,  # plain help: a coloured one costs twice the time until it shows
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    )
    app.callback()(options.options)
    app.add_typer(rigs.app, name="rig")
    app.add_typer(plans.app, name="plan")
    app.command()(measuring.measure)
    app.command()(measuring.reduce)
    app.add_typer(runs.app, name="run")
    for name, point in plugins.available("gonio.commands").items():
        _add(app, name, point)
    app.command()(tables.convert)
    return app


def _add(app: typer.Typer, name: str, point: Any) -> None:
    """Add a command, or a group of commands, that an entry point names; a broken one says so when it is called."""
    import typer

    try:
        command = point.load()
    except Exception as error:
        command = _broken(name, f"{type(error).__name__}: {error}", point.value)
    if isinstance(command, typer.Typer):
        app.add_typer(command, name=name)
    else:
        app.command(name)(command)


def _broken(name: str, error: str, value: str) -> Any:
    def command() -> None:
        from gonio.errors import ConfigError

        raise ConfigError(f'the command "{name}" ({value}) cannot be loaded: {error}')

    command.__doc__ = f"(cannot be loaded: {error})"
    return command
