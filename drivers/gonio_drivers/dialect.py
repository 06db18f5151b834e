"""The language of a lamp controller, as data: shipped ones in `dialects/`, others from a file of the user's."""

import re
from importlib.resources import files
from pathlib import Path

from pydantic import ValidationInfo, field_validator, model_validator

from gonio import config
from gonio.config import Strict
from gonio.errors import ConfigError
from gonio.rig.ranges import NonNegative, Positive

DIALECTS = ("scpi", "mightex", "arduino")
FILLS = {"set": ("value", "channel"), "select": ("wavelength_nm", "channel")}
"""What is filled into a command; the channel into any other."""


class Dialect(Strict):
    """How a lamp controller is spoken to. Patterns are regular expressions for a whole reply."""

    name: str
    baud: Positive
    send_ending: str = "\n"
    reply_ending: str = "\n"
    timeout_s: Positive = 0.5
    prompt: str | None = None
    """What the controller writes when it awaits a command, without an ending; taken off the beginning of a reply."""
    banner: str | None = None
    """What the controller says when it has started; some restart whenever their port is opened."""
    banner_s: Positive = 4.0
    start: tuple[str, ...] = ()
    """Commands that put the line into its usual state; their replies are not looked at."""
    identify: str
    identity: str
    on: str
    off: str
    state: str
    state_on: str
    state_off: str
    set: str
    get: str
    got: str
    """With one group: the number."""
    full_scale: Positive
    """Setting for level 1."""
    resolution: NonNegative
    """Step of the setting, in its own unit: a readback within one step is the same."""
    acknowledge: str | None = None
    refuse: str | None = None
    error_query: str | None = None
    no_error: str = "0.*"
    select: str | None = None
    """Choose a wavelength, for tunable sources."""
    selected: str | None = None
    selected_got: str = r"([-+.\deE]+)"
    monitor: str | None = None
    """Ask a monitor photodiode; its reading is proportional to the output."""
    monitor_got: str = r"([-+.\deE]+)"

    lock: str | None = None
    """Ask whether the source is in lock, or stabilised."""
    lock_good: str = "1|LOCKED"
    lock_lost: str = "0|UNLOCKED"

    @field_validator(
        "banner", "identity", "state_on", "state_off", "got", "acknowledge", "refuse", "no_error", "selected_got",
        "monitor_got", "lock_good", "lock_lost",
    )  # fmt: skip
    @classmethod
    def _pattern(cls, pattern: str | None) -> str | None:
        if pattern is not None:
            try:
                re.compile(pattern)
            except re.error as error:
                raise ValueError(f"is not a regular expression: {error}") from None
        return pattern

    @field_validator("got", "selected_got", "monitor_got")
    @classmethod
    def _number(cls, pattern: str) -> str:
        if re.compile(pattern).groups < 1:
            raise ValueError("needs a group, in round brackets, around the number")
        return pattern

    @field_validator("on", "off", "state", "set", "get", "select", "monitor", "lock")
    @classmethod
    def _template(cls, command: str | None, info: ValidationInfo) -> str | None:
        fills = FILLS.get(str(info.field_name), ("channel",))
        try:
            (command or "").format(**dict.fromkeys(fills, 1.0))
        except (KeyError, IndexError, ValueError):
            known = " and ".join(f"{{{name}}}" for name in fills)
            raise ValueError(f"only {known} can be filled in; write {{{{ and }}}} for braces") from None
        return command

    @model_validator(mode="after")
    def _read_back(self) -> "Dialect":
        if (self.select is None) != (self.selected is None):
            raise ValueError("select and selected go together: a wavelength that is set must be read back")
        return self


def dialect(name: str) -> Dialect:
    """A shipped dialect by name, or one from a TOML file.

    Raises
    ------
    ConfigError
        There is neither, or the file is wrong.
    """
    if name in DIALECTS:
        text = files("gonio_drivers") / "dialects" / f"{name}.toml"
        return config.load(Dialect, Path(str(text)))
    if name.endswith(".toml"):
        return config.load(Dialect, name)
    raise ConfigError(
        f'devices.light.dialect = "{name}": shipped are {", ".join(DIALECTS)}; or give the path of a .toml file'
    )
