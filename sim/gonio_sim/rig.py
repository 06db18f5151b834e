"""The simulated goniometer as a rig: `sim`, `sim-metrology` with finer parts, `sim-ideal` without disturbances.

`sim-uncalibrated` has a hidden truth, for `gonio calibrate`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Self

from gonio.errors import ConfigError
from gonio.lab.rig import Device, Health, Reading, Step, Target, ask_for
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band
from gonio.lab.rig.polarisers import SIDES, PolariserMount, Side
from gonio.samples.description import SampleDescription
from gonio_sim.arms import SimulatedArms
from gonio_sim.camera import SimulatedCamera, SlowCamera
from gonio_sim.render import Renderer
from gonio_sim.world import InHolder, Stream, World


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


class SimulatedPolariser:
    """A polariser of the simulated rig, as a `PolariserDevice`; out of the beam when it is made, where it can be."""

    def __init__(self, world: World, side: Side, mount: PolariserMount) -> None:
        self._world, self._side, self._mount = world, side, mount
        self.begin()

    def begin(self) -> None:
        """Stand as every step begins."""
        self._world.polarisers[self._side] = ("u" if self._mount.empty else "linear", 0.0)

    def select(self, state: str, azimuth: float = 0.0) -> None:
        """Take a state; see `gonio.lab.rig.protocols.PolariserDevice`."""
        self._world.require_open(f"polariser of the {self._side}")
        if why := self._mount.refusal(state) if state != "linear" else "":
            raise ConfigError(f'[polarisers.{self._side}] cannot do "{state}": {why}')
        if self._world.polarisers[self._side] != (state, azimuth):
            self._world.polarisers[self._side] = state, azimuth
            self._world.spend(self._mount.turn_s)


class SimulatedRig:
    """A goniometer of arms, lamp and camera that share one `World`.

    Parameters
    ----------
    description, sample, seed
        As in `World`. The parameters of the sample's model are checked here, before anything moves.
    confirm
        Ask on the terminal at a swap of sample and reference, as a rig without a swapping axis does.

    Raises
    ------
    ConfigError
        Description, sample or seed cannot be simulated.
    """

    repeatable = True

    def __init__(
        self, description: RigDescription, sample: SampleDescription | None, seed: int, *, confirm: bool
    ) -> None:
        self.description = description
        self.world = World(description, sample, seed)
        self.arms = SimulatedArms(self.world)
        self.light = SimulatedLight(self.world)
        camera = SlowCamera if self.world.truth.camera.readout_s else SimulatedCamera
        self.camera = camera(self.world, Renderer(self.world))
        mounts = ((side, description.polarisers.on(side)) for side in SIDES)
        self.polarisers = {side: SimulatedPolariser(self.world, side, mount) for side, mount in mounts if mount}
        self._confirm = confirm
        self._stays = False

    def begin(self, step: Step) -> None:
        """Stand at rest, with the clock and the random numbers of the step."""
        self.world.begin(step.index)
        self.arms.begin()
        for polariser in self.polarisers.values():
            polariser.begin()

    def present(self, target: Target) -> None:
        """Put the sample or the white reference into the beam; asks the user where that is done by hand."""
        if target == self.world.target:
            return
        how = self.description.reference.how
        if how in ("swap", "beam") and self._confirm:
            ask_for(target, beam=how == "beam")
        self.world.target = target

    def put(self, what: InHolder) -> bool:
        """Put a mirror, a trap, an edge or nothing into the holder, or the sample back: no person is needed."""
        self.world.target = what
        return True

    # ---- ByHand: nothing is ever missing here, and nothing outlives the process ----

    def only(self, *devices: Device) -> None:
        """Everything is there, and opens with the rest."""

    def hold(self) -> None:
        """On leaving, the arms stay where they stand."""
        self._stays = True

    def jog(self, goals: Mapping[str, float]) -> dict[str, float]:
        """Drive some axes [rad], and leave the others; the readback of those that moved."""
        landed = self.arms.jog(goals)
        return {name: getattr(landed, name) for name in goals}

    def health(self) -> Health:
        """Angles and lamp; simulated servos have neither temperature nor current."""
        pose, limits = self.arms.read(), self.description.limits_deg()
        angles = [Reading(n, "angle", math.degrees(getattr(pose, n)), "deg", limits[n]) for n in limits]
        lamp = Reading("lamp", "state", "lit" if self.world.lamp_on else "dark")
        level = Reading("lamp", "level", self.light.level, "", (0.0, 1.0))
        return Health((*angles, lamp, level, Reading("frames", "state", "ready (simulated)")))

    def survey(self, *devices: Device) -> Health:
        """The same before the rig is entered: it stands as it was made, or left."""
        was_open, self.world.open = self.world.open, True
        try:
            return self.health()
        finally:
            self.world.open = was_open

    def time_s(self) -> float:
        """Seconds of simulated time since the lamp was lit for the run."""
        return self.world.now_s()

    def __enter__(self) -> Self:
        self.world.open, self.world.lamp_on, self._stays = True, False, False
        return self

    def __exit__(self, *_: object) -> None:
        self.light.off()
        if not self._stays:
            self.arms.park()
        self.camera.close()
        self.world.open = False


@dataclass(frozen=True, slots=True)
class SimulatedRigPlugin:
    """An entry point of the group `gonio.rigs`, with the rig file of that name in `rigs/`."""

    name: str

    @property
    def toml(self) -> str:
        """The shipped rig file."""
        return (files("gonio_sim") / "rigs" / f"{self.name}.toml").read_text(encoding="utf-8")

    def open(
        self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool
    ) -> SimulatedRig:
        """Build the rig; see `SimulatedRig`."""
        return SimulatedRig(description, sample, seed, confirm=confirm)


SIM = SimulatedRigPlugin("sim")
SIM_IDEAL = SimulatedRigPlugin("sim-ideal")
SIM_METROLOGY = SimulatedRigPlugin("sim-metrology")
SIM_UNCALIBRATED = SimulatedRigPlugin("sim-uncalibrated")
