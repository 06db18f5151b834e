"""Control tables of the X series: addresses from the SDK's own model files, access and values from the e-Manual."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from dynamixel_easy_sdk.control_table import ControlTable

from gonio.errors import ConfigError

EEPROM_END = 64
COUNTS = 4096
RPM = COUNTS * 0.229 / 60
"""Counts a second of one unit of velocity (0.229 rpm)."""
RPM2 = COUNTS * 214.577 / 3600
"""Counts a second squared of one unit of acceleration (214.577 rev/min^2)."""

READ_ONLY = frozenset(
    {
        "Model Number", "Model Information", "Firmware Version", "Registered Instruction", "Hardware Error Status",
        "Realtime Tick", "Moving", "Moving Status", "Present PWM", "Present Current", "Present Load",
        "Present Velocity", "Present Position", "Velocity Trajectory", "Position Trajectory", "Present Input Voltage",
        "Present Temperature",
    }
)  # fmt: skip

SIGNED = frozenset(
    {
        "Homing Offset", "Goal PWM", "Goal Current", "Goal Velocity", "Goal Position", "Present PWM", "Present Current",
        "Present Load", "Present Velocity", "Present Position", "Velocity Trajectory", "Position Trajectory",
        "Bus Watchdog",
    }
)  # fmt: skip

RANGES = {  # smallest and largest value that an item takes at all (Data Range Error beyond)
    "ID": (0, 252), "Baud Rate": (0, 7), "Return Delay Time": (0, 254), "Secondary(Shadow) ID": (0, 255),
    "Homing Offset": (-1_044_479, 1_044_479), "Moving Threshold": (0, 1023), "Protocol Type": (2, 2),
    "Temperature Limit": (0, 100), "PWM Limit": (0, 885), "Velocity Limit": (0, 1023),
    "Current Limit": (0, 2047), "Max Position Limit": (0, 4095), "Min Position Limit": (0, 4095),
    "Torque Enable": (0, 1),
    "LED": (0, 1), "Status Return Level": (0, 2), "Velocity I Gain": (0, 16383), "Velocity P Gain": (0, 16383),
    "Position D Gain": (0, 16383), "Position I Gain": (0, 16383), "Position P Gain": (0, 16383),
    "Feedforward 2nd Gain": (0, 16383), "Feedforward 1st Gain": (0, 16383), "Bus Watchdog": (0, 127),
    "Profile Acceleration": (0, 32767), "Profile Velocity": (0, 32767), "Drive Mode": (0, 0x0D),
    "Goal Position": (-1_048_575, 1_048_575),
}  # fmt: skip
MODES = (0, 1, 3, 4, 5, 16)

BAUD_CODES = {0: 9600, 1: 57600, 2: 115200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000, 7: 4_500_000}

_FACTORY = {
    "ID": 1, "Baud Rate": 1, "Return Delay Time": 250, "Operating Mode": 3, "Secondary(Shadow) ID": 255,
    "Protocol Type": 2, "Moving Threshold": 10, "Temperature Limit": 80, "PWM Limit": 885, "Current Limit": 1193,
    "Velocity Limit": 200, "Max Position Limit": 4095, "Shutdown": 52, "Status Return Level": 2,
    "Velocity I Gain": 1920, "Velocity P Gain": 100, "Position P Gain": 800, "Firmware Version": 46,
}  # fmt: skip
_FACTORY_BY_FAMILY = {
    "xl330": {"Current Limit": 1750, "Velocity Limit": 445, "Temperature Limit": 70, "Position P Gain": 400,
              "Velocity I Gain": 1600, "Velocity P Gain": 180, "Shutdown": 53},
    "xc330": {"Current Limit": 1750, "Velocity Limit": 445, "Temperature Limit": 70},
    "xl430": {"Velocity Limit": 265, "Temperature Limit": 72, "Position P Gain": 640, "Position D Gain": 4000,
              "Velocity I Gain": 1000},
    "xc430": {"Velocity Limit": 310, "Temperature Limit": 72},
    "xh430": {"Current Limit": 648, "Velocity Limit": 230},
    "xm540": {"Current Limit": 2047, "Velocity Limit": 128},
    "xh540": {"Current Limit": 1188, "Velocity Limit": 167},
}  # fmt: skip

_VOLTAGES = {  # lowest, nominal, highest [0.1 V]; the beginning of a model's name
    "xl330": (35, 50, 70), "xc330-m": (35, 50, 70), "xc330-t": (55, 120, 140), "xl430": (60, 120, 140),
    "xc430": (60, 120, 140), "xh430-v": (110, 240, 300), "xh540-v": (110, 240, 300), "xw540-h": (110, 240, 300),
    "x": (95, 120, 160),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Item:
    """One entry of a control table."""

    name: str
    address: int
    size: int

    @property
    def writable(self) -> bool:
        return self.name not in READ_ONLY

    @property
    def signed(self) -> bool:
        return self.name in SIGNED


@dataclass(frozen=True, slots=True)
class Table:
    """A model's control table with its factory values."""

    model: str
    number: int
    items: dict[str, Item]
    factory: dict[str, int]

    size: int
    defined: frozenset[int]
    """Addresses at which there is something."""
    supply_dv: int
    """Nominal supply [0.1 V]."""


@cache
def table(model: str) -> Table:
    """The control table of a model, as "xm430-w350".

    Raises
    ------
    ConfigError
        The SDK has no file for it, or it is not of the X series.
    """
    names = ControlTable.parsingModelList()
    known = {name.removesuffix(".model").replace("_", "-"): number for number, name in names.items()}
    x_series = sorted(name for name in known if name[0] == "x" and name != "xl320")
    if model.lower() not in x_series:
        raise ConfigError(f'"{model}" is no servo of the X series that the SDK knows: {", ".join(x_series)}')
    number = known[model.lower()]
    items: dict[str, Item] = {}
    for name, entry in ControlTable.getControlTable(number).items():
        if not name.startswith("Indirect"):
            items[name] = Item(name, entry.address, entry.size)
    if model[:5].lower() in ("xm430", "xh430", "xd430", "xm540", "xh540", "xd540", "xl430", "xc430", "xw430", "xw540"):
        for first, address, data in ((1, 168, 224), (29, 578, 634)):
            for k in range(28):
                items[f"Indirect Address {first + k}"] = Item(f"Indirect Address {first + k}", address + 2 * k, 2)
                items[f"Indirect Data {first + k}"] = Item(f"Indirect Data {first + k}", data + k, 1)
    factory = {k: v for k, v in (_FACTORY | _FACTORY_BY_FAMILY.get(model[:5].lower(), {})).items() if k in items}
    lowest, supply, highest = next(v for k, v in _VOLTAGES.items() if model.lower().startswith(k))
    factory |= {"Min Voltage Limit": lowest, "Max Voltage Limit": highest}
    factory["Model Number"] = number
    for name in items:
        if name.startswith("Indirect Address"):
            factory[name] = items[name.replace("Address", "Data")].address
    defined = frozenset(item.address + k for item in items.values() for k in range(item.size))
    return Table(model.lower(), number, items, factory, max(defined) + 1, defined, supply)
