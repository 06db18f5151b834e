"""What the devices of a rig say of themselves: angles, temperatures, currents, voltages, lamp and camera."""

from dataclasses import dataclass, field

LANDING_DEG = 0.25
"""An axis that was sent to its limit stands within this of it: a servo's backlash, as its maker advertises it."""


@dataclass(frozen=True, slots=True)
class Reading:
    """One quantity of one device, as it was read."""

    device: str
    """An axis ("light", "camera", "tilt", "spin", "azimuth", "changer"), "lamp", "frames" (the camera itself), or
    "interlock"."""
    quantity: str
    """angle, temperature, current, load, voltage, torque, motion, home, error, settings (that change what it reads);
    of the lamp state, level, monitor, lock; of the interlock contact, error.

    current_max and voltage_min are the extremes of all polls since the last reading of the rig's health."""
    value: float | str
    unit: str = ""
    """"deg", "C", "mA", "%", "V"; "" for words and ratios."""
    limit: tuple[float, float] | None = None
    """Lowest and highest value that the device, or the rig file, allows."""

    @property
    def good(self) -> bool:
        """Whether a number lies within its limits; what has none is good. An axis may have landed just beyond one."""
        if self.limit is None or isinstance(self.value, str):
            return True
        beyond = LANDING_DEG if self.unit == "deg" else 0.0
        return self.limit[0] - beyond <= self.value <= self.limit[1] + beyond


@dataclass(frozen=True, slots=True)
class Health:
    """What was read of a rig's devices, and which of them said nothing."""

    readings: tuple[Reading, ...] = ()
    silent: dict[str, str] = field(default_factory=dict)
    """By device, why nothing could be read of it: missing, mute, or not understood."""

    def of(self, device: str, quantity: str) -> float | str | None:
        """A value, or None where it was not read."""
        return next((r.value for r in self.readings if (r.device, r.quantity) == (device, quantity)), None)

    def __add__(self, other: "Health") -> "Health":
        return Health(self.readings + other.readings, self.silent | other.silent)
