"""Control tables of the X series: addresses from the SDK's own model files, access and values from the e-Manual.

And the table as it lies in a servo's memory: bytes, items, indirect addresses. Written from the device's side; what a
value means, and whether it is allowed, the servo knows.
"""

from dataclasses import dataclass
from functools import cache

from dynamixel_easy_sdk.control_table import ControlTable

from gonio.errors import ConfigError
from gonio_sim.wire import protocol2 as p2

EEPROM_END = 64
COUNTS = 4096
RPM = COUNTS * 0.229 / 60
"""Counts a second of one unit of velocity (0.229 rpm)."""
RPM2 = COUNTS * 214.577 / 3600
"""Counts a second squared of one unit of acceleration (214.577 rev/min^2)."""
FULL_PWM = 885

READ_ONLY = frozenset(
    {
        "Model Number", "Model Information", "Firmware Version", "Registered Instruction", "Hardware Error Status",
        "Realtime Tick", "Moving", "Moving Status", "Present PWM", "Present Current", "Present Load",
        "Present Velocity", "Present Position", "Velocity Trajectory", "Position Trajectory", "Present Input Voltage",
        "Present Temperature", "Backup Ready",
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
    "Temperature Limit": (0, 100), "PWM Limit": (0, 885), "Velocity Limit": (0, 1023), "Max Position Limit": (0, 4095),
    "Min Position Limit": (0, 4095), "External Port Mode 1": (0, 3), "External Port Mode 2": (0, 3),
    "External Port Mode 3": (0, 3), "Startup Configuration": (0, 3), "PWM Slope": (1, 255), "Torque Enable": (0, 1),
    "LED": (0, 1), "Status Return Level": (0, 2), "Velocity I Gain": (0, 16383), "Velocity P Gain": (0, 16383),
    "Position D Gain": (0, 16383), "Position I Gain": (0, 16383), "Position P Gain": (0, 16383),
    "Feedforward 2nd Gain": (0, 16383), "Feedforward 1st Gain": (0, 16383), "Bus Watchdog": (0, 127),
    "Profile Acceleration": (0, 32767), "Profile Velocity": (0, 32767), "Goal Position": (-1_048_575, 1_048_575),
}  # fmt: skip
LONGEST_MS = 32737
"""Largest value of a profile item that is a time."""
MODES = (0, 1, 3, 4, 5, 16)
MODES_WITHOUT_CURRENT = (1, 3, 4, 16)

BAUD_CODES = {0: 9600, 1: 57600, 2: 115200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000, 7: 4_500_000}

_FACTORY = {
    "ID": 1, "Baud Rate": 1, "Return Delay Time": 250, "Operating Mode": 3, "Secondary(Shadow) ID": 255,
    "Protocol Type": 2, "Moving Threshold": 10, "Temperature Limit": 80, "PWM Limit": 885, "Current Limit": 2047,
    "Max Position Limit": 4095, "External Port Mode 1": 3, "External Port Mode 2": 3, "External Port Mode 3": 3,
    "Shutdown": 52, "Status Return Level": 2, "Velocity I Gain": 1920, "Velocity P Gain": 100, "Position P Gain": 800,
    "Firmware Version": 46,
}  # fmt: skip
_X330 = {"Temperature Limit": 70, "Firmware Version": 52}
_FACTORY_BY_FAMILY = {  # by the beginnings of models' names, the longest last
    "xl330": _X330 | {"Current Limit": 1750, "Position P Gain": 400, "PWM Slope": 140, "Shutdown": 53},
    "xc330-m": _X330 | {"Current Limit": 2352, "PWM Slope": 140, "Position D Gain": 500},
    "xc330-t": _X330 | {"Current Limit": 910, "PWM Slope": 255, "Position P Gain": 900, "Velocity I Gain": 1200,
                        "Velocity P Gain": 40},
    "xl430": {"Temperature Limit": 72, "Position P Gain": 640, "Position D Gain": 4000, "Velocity I Gain": 1000},
    "xm430": {"Current Limit": 1193},
    "xh430": {"Current Limit": 648, "Position P Gain": 900},
    "xd430": {"Current Limit": 648, "Position P Gain": 900},
    "xw430": {"Position P Gain": 900},
    "xh430-v": {"Current Limit": 689, "Position P Gain": 800},
    "xh540-v": {"Current Limit": 1188},
    "xl330-m077": {"Velocity I Gain": 400, "Velocity P Gain": 40, "Position I Gain": 400},
    "xl330-m288": {"Velocity I Gain": 1600, "Velocity P Gain": 180},
    "xc330-m181": {"Velocity I Gain": 1400, "Position P Gain": 1200},
    "xc330-m288": {"Velocity I Gain": 1600, "Velocity P Gain": 50, "Position P Gain": 1100},
    "xc430-w150": {"Moving Threshold": 20, "Position P Gain": 460},
    "xc430-w240": {"Position P Gain": 700},
}  # fmt: skip
_VELOCITY_LIMITS = {  # [0.229 rpm]; tests/gonio_sim/wire/readme.md says which were read in the e-Manual
    "xl330-m077": 1620, "xl330-m288": 445, "xc330-m181": 545, "xc330-m288": 350, "xc330-t181": 510, "xc330-t288": 320,
    "xl430-w250": 265, "xc430-w150": 460, "xc430-w240": 306, "xm430-w210": 330, "xm430-w350": 200,
    "xh430-w210": 210, "xh430-w350": 130, "xh430-v210": 230, "xh430-v350": 135, "xd430-t210": 210, "xd430-t350": 130,
    "xw430-t200": 230, "xw430-t333": 139, "xm540-w150": 230, "xm540-w270": 128, "xh540-w150": 300, "xh540-w270": 167,
    "xh540-v150": 300, "xh540-v270": 167, "xd540-t150": 300, "xd540-t270": 167, "xw540-t140": 304, "xw540-t260": 167,
    "xw540-h260": 167,
}  # fmt: skip

_VOLTAGES = {  # lowest that a limit may be, factory's lower limit, nominal, highest [0.1 V]; by the beginning of a name
    "xl330": (31, 35, 50, 70), "xc330-m": (31, 35, 50, 70), "xc330-t": (55, 55, 120, 140), "xl430": (60, 60, 120, 140),
    "xc430": (60, 60, 120, 160), "xh430-v": (110, 110, 240, 300), "xh540-v": (110, 110, 240, 300),
    "xw540-h": (110, 110, 240, 300), "x": (95, 95, 120, 160),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class TableItem:
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
class FactoryTable:
    """A model's control table with its factory values."""

    model: str
    number: int
    items: dict[str, TableItem]
    factory: dict[str, int]

    size: int
    defined: frozenset[int]
    """Addresses at which there is something."""
    supply_dv: int
    """Nominal supply [0.1 V]."""
    ranges: dict[str, tuple[int, int]]
    """Smallest and largest value that an item takes at all."""
    modes: tuple[int, ...]
    """Values of the Operating Mode."""
    drive_bits: int
    """Bits of the Drive Mode that mean something."""


@cache
def table(model: str) -> FactoryTable:
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
    listed = ControlTable.getControlTable(number).items()
    items = {n: TableItem(n, entry.address, entry.size) for n, entry in listed if not n.startswith("Indirect")}
    items["Startup Configuration"] = TableItem("Startup Configuration", 60, 1)  # the SDK's files lack these two
    items["Backup Ready"] = TableItem("Backup Ready", 147, 1)
    small = model[:5].lower() in ("xl330", "xc330")
    for first, number_of, address, data in ((1, 20, 168, 208),) if small else ((1, 28, 168, 224), (29, 28, 578, 634)):
        for k in range(number_of):
            items[f"Indirect Address {first + k}"] = TableItem(f"Indirect Address {first + k}", address + 2 * k, 2)
            items[f"Indirect Data {first + k}"] = TableItem(f"Indirect Data {first + k}", data + k, 1)
    defined = frozenset(item.address + k for item in items.values() for k in range(item.size))
    factory = _FACTORY | {"Velocity Limit": _VELOCITY_LIMITS[model.lower()]}
    for beginning, values in _FACTORY_BY_FAMILY.items():
        if model.lower().startswith(beginning):
            factory |= values
    factory = {name: value for name, value in factory.items() if name in items}
    floor, lowest, supply, highest = next(v for k, v in _VOLTAGES.items() if model.lower().startswith(k))
    factory |= {"Min Voltage Limit": lowest, "Max Voltage Limit": highest, "Model Number": number}
    ranges = RANGES | {name: (floor, highest) for name in ("Min Voltage Limit", "Max Voltage Limit")}
    if "Current Limit" in items:
        ranges["Current Limit"] = (0, factory["Current Limit"])
    if small:
        ranges |= {"Velocity Limit": (0, 2047), "Baud Rate": (0, 6)}
    for name in items:
        if name.startswith("Indirect Address"):
            factory[name] = items[name.replace("Address", "Data")].address
            ranges[name] = EEPROM_END, max(defined)
    modes = MODES if "Current Limit" in items else MODES_WITHOUT_CURRENT
    bits = 0x0F if model[:5].lower() in ("xm540", "xh540", "xd540") else 0x0D  # these have a cable for a second servo
    return FactoryTable(model.lower(), number, items, factory, max(defined) + 1, defined, supply, ranges, modes, bits)


class Refused(Exception):
    """An instruction ends with an error number in its status packet."""

    def __init__(self, error: int) -> None:
        super().__init__(error)
        self.error = error


class Registers:
    """The memory of one servo, with its factory values.

    Parameters
    ----------
    table
        The items of its model.
    """

    def __init__(self, table: FactoryTable) -> None:
        self.table = table
        self._bytes = bytearray(table.size)
        self._at = {item.address: item for item in table.items.values()}
        self._pointers = {
            item.address: table.items[name.replace("Data", "Address")].address
            for name, item in table.items.items()
            if name.startswith("Indirect Data")
        }
        for name, value in table.factory.items():
            self.put(name, value)

    def get(self, name: str) -> int:
        """The value of an item, as its owner means it (signed where it is)."""
        item = self.table.items[name]
        return int.from_bytes(self._bytes[item.address : item.address + item.size], "little", signed=item.signed)

    def put(self, name: str, value: int) -> None:
        """Write an item, whoever may write it."""
        item = self.table.items[name]
        raw = (value % (1 << 8 * item.size)).to_bytes(item.size, "little")
        self._bytes[item.address : item.address + item.size] = raw

    def identity(self) -> bytes:
        """Model number and firmware version."""
        return bytes(self._bytes[0:2] + self._bytes[6:7])

    def read(self, address: int, length: int) -> bytes:
        """Bytes from an address on, through the indirect data.

        Raises
        ------
        Refused
            There is no such item, or the run of bytes ends beyond the table.
        """
        if length < 1 or address not in self.table.defined or address + length > self.table.size:
            raise Refused(p2.ACCESS_ERROR)
        return bytes(self._bytes[self._indirect(address + k)] for k in range(length))

    def _indirect(self, address: int) -> int:
        """Where an indirect data byte points to; any other address is itself."""
        pointer = self._pointers.get(address)
        return address if pointer is None else int.from_bytes(self._bytes[pointer : pointer + 2], "little")

    def items(self, address: int, data: bytes) -> list[tuple[TableItem, int]]:
        """The items that a write covers, each wholly and each writable, with the values that they are to take.

        Indirect data may mean items that are not adjacent, in any order; the bytes of each are together.
        """
        meant = [self._indirect(address + k) for k in range(len(data))]
        out, position = [], 0
        if not data:
            raise Refused(p2.LENGTH_ERROR)
        while position < len(data):
            item = self._at.get(meant[position])
            if item is None or not item.writable:
                raise Refused(p2.ACCESS_ERROR)
            end = position + item.size
            if meant[position:end] != list(range(item.address, item.address + item.size)):
                raise Refused(p2.LENGTH_ERROR)
            out.append((item, int.from_bytes(data[position:end], "little", signed=item.signed)))
            position = end
        return out
