"""The control tables of Dynamixel servos, from the SDK's own files: which item lies where, and how it is coded."""

from __future__ import annotations

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
