"""The simulated lamp: a band, on or off. Its level, drift and noise are the world's."""

from __future__ import annotations

from gonio.errors import ConfigError
from gonio.rig.bands import Band
from gonio_sim.world import Stream, World


class SimulatedLight:
    """The lamp of the simulated rig, as a `LightDevice`; dark when it is made."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._bands = world.description.bands.all()
        self.level = 1.0
        """Output while it is on, as a fraction of its largest."""

    def dim(self, level: float | None) -> None:
        """Shine at another level (above 0, at most 1), from the next `on`; None: the largest."""
        self.level = 1.0 if level is None else level

    def select(self, band: Band) -> None:
        """Put a band of the rig into the beam."""
        self._world.require_open("lamp")
        if band not in self._bands:
            raise ConfigError(
                f'the rig "{self._world.description.name}" has no band "{band.name}" ({band.centre_nm:g} nm)'
            )
        self._world.band = band

    def on(self) -> None:
        """Light up; the simulated lamp settles at once."""
        self._world.require_open("lamp")
        self._world.lamp_on, self._world.brightness = True, self.level

    def monitor(self) -> float | None:
        """Reading of a photodiode during the last frame, relative to a fresh lamp; None where the rig has none."""
        world = self._world
        if not world.truth.lamp.monitor:
            return None
        level = world.last_level if world.lamp_on else 0.0
        noise = world.truth.lamp.monitor_noise
        return level * (1.0 + noise * world.normal(Stream.MONITOR, world.step, world.frame)) if noise else level

    def off(self) -> None:
        """Darken; allowed at any time."""
        self._world.lamp_on = False
