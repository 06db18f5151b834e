"""The control tables of Dynamixel servos, from the SDK's own files: which item lies where, and how it is coded."""

import difflib
from dataclasses import dataclass
from functools import cache

from dynamixel_easy_sdk.control_table import ControlTable

from gonio.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Item:
    """One entry of a control table."""

    name: str
    address: int
    size: int

    def decode(self, data: bytes, start: int = 0) -> int:
        """The value in a block of bytes that begins at the address `start`; the SDK's own readers forget the sign."""
        raw = data[self.address - start : self.address - start + self.size]
        return int.from_bytes(raw, "little", signed=self.name in SIGNED)

    def encode(self, value: int) -> bytes:
        """The bytes of a value, two's complement where it is negative."""
        return (value % (1 << 8 * self.size)).to_bytes(self.size, "little")


SIGNED = frozenset(
    {
        "Homing Offset", "Goal PWM", "Goal Current", "Goal Velocity", "Goal Position", "Present PWM", "Present Current",
        "Present Load", "Present Velocity", "Present Position", "Velocity Trajectory", "Position Trajectory",
    }
)  # fmt: skip


_HIGHEST_CURRENT = {
    "xl330": 1750, "xc330-m": 2352, "xc330-t": 910, "xm430": 1193, "xh430": 648, "xd430": 648, "xh430-v": 689,
    "xh540-v": 1188, "x": 2047,
}  # fmt: skip
"""Largest Current Limit by the beginning of a model's name; the longest that fits holds (ROBOTIS e-Manual)."""


def highest_current(model: str) -> int:
    """The largest Current Limit that servos of a model take, in their own unit."""
    return _HIGHEST_CURRENT[max((b for b in _HIGHEST_CURRENT if model.lower().startswith(b)), key=len)]


def current_unit_ma(model: str) -> float:
    """The unit of currents in a model's control table [mA] (ROBOTIS e-Manual, "Present Current(126)")."""
    return 1.0 if model.lower().startswith(("xl330", "xc330")) else 2.69


@cache
def models() -> dict[int, str]:
    """Model names by model number, as "xm430-w350", from the SDK's list."""
    return {n: file.removesuffix(".model").replace("_", "-") for n, file in ControlTable.parsingModelList().items()}


@cache
def of_model(model: str, key: str = "model") -> dict[str, Item]:
    """The control table of a model, from the SDK's own file; `key` is where the model was written.

    Raises
    ------
    ConfigError
        The SDK does not know the model, or its table is not that of the X series (4096 counts a turn).
    """
    for number, name in models().items():
        if name == model.lower():
            table = {n: Item(n, e.address, e.size) for n, e in ControlTable.getControlTable(number).items()}
            if table.get("Profile Acceleration") != Item("Profile Acceleration", 108, 4):
                raise ConfigError(f'{key} = "{model}" is no servo of the X series')
            return table
    near = difflib.get_close_matches(model.lower(), models().values(), n=3)
    hint = f"did you mean {' or '.join(near)}?" if near else 'write it as it is printed on the servo, "xm430-w350"'
    raise ConfigError(f'{key} = "{model}" is not known to the Dynamixel SDK; {hint}')
