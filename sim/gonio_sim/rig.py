"""The simulated goniometer as a rig: `sim`, and `sim-ideal` without anything that disturbs."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from types import TracebackType
from typing import Self

from gonio.rig import Step, Target, ask_for
from gonio.rig.description import RigDescription, SampleDescription
from gonio_sim.arms import SimulatedArms
from gonio_sim.camera import SimulatedCamera
from gonio_sim.light import SimulatedLight
from gonio_sim.render import Renderer
from gonio_sim.world import World


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
        self.camera = SimulatedCamera(self.world, Renderer(self.world))
        self._confirm = confirm

    def begin(self, step: Step) -> None:
        """Stand at rest, with the clock and the random numbers of the step."""
        self.world.begin(step.index)
        self.arms.begin()

    def present(self, target: Target) -> None:
        """Put the sample or the white reference into the beam; asks the user where that is done by hand."""
        if target == self.world.target:
            return
        if self.description.reference.how == "swap" and self._confirm:
            ask_for(target)
        self.world.target = target

    def time_s(self) -> float:
        """Seconds of simulated time since the lamp was lit for the run."""
        return self.world.now_s()

    def __enter__(self) -> Self:
        self.world.open, self.world.lamp_on = True, False
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.light.off()
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
