"""A small goniometer made of numpy: what the core's own tests measure with."""

import itertools
import math
import signal
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from gonio.errors import DeviceError
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.plan import Plan, load_plan
from gonio.lab.acquisition.progress import Live, Silent
from gonio.lab.acquisition.run import Run
from gonio.lab.rig import Frame, Pose, Step, Target
from gonio.lab.rig.description import Acquisition, Arms, Holder, Reference, RigDescription
from gonio.lab.rig.light_and_camera import Band, Bands, Camera
from gonio.samples.description import SampleDescription

BANDS = (Band(name="green, 550", centre_nm=550, fwhm_nm=20), Band(name="red 650", centre_nm=650, fwhm_nm=20))


def describe(**changes: object) -> RigDescription:
    """A rig with every axis, a camera of 64 x 48 pixels, and few frames."""
    tables: dict[str, object] = {
        "rig": "numpy",
        "name": "bench of numpy",
        "holder": Holder(axes=("tilt", "spin")),
        "arms": Arms(),
        "bands": Bands(list=BANDS),
        "camera": Camera(width=64, height=48, pixel_um=40, exposure_limits_s=(1e-4, 10.0)),
        "reference": Reference(every=3, frames=2),
        "acquisition": Acquisition(frames=2, dark_frames=2, roi_radius_mm=3.0),
    }
    return RigDescription.model_validate(tables | changes)


_CLOCK = itertools.count(1.9e9)
"""Of the benches on which time goes by, from one session to the next."""


@dataclass
class NumpyRig:
    """The rig: its own arms, light and camera. A Lambertian sample; noise follows (seed, step, frame)."""

    description: RigDescription
    seed: int = 0
    albedo: float = 0.5
    repeatable: bool = True
    fails_at: int | None = None
    """The step in which the camera fails."""
    pushes: dict[int, int] = field(default_factory=dict)
    """How often the camera arm is pushed during the frames of a step, by its number."""
    stamps: Callable[[float], float] | None = None
    """What the camera makes of the rig's time."""
    log: list[str] = field(default_factory=list)
    pose: Pose = field(default_factory=Pose)
    lit: bool = False
    inside: bool = False
    target: Target = "sample"
    band: Band | None = None
    step: int = 0
    frame: int = 0

    @property
    def arms(self) -> Self:
        return self

    @property
    def light(self) -> Self:
        return self

    @property
    def camera(self) -> Self:
        return self

    def begin(self, step: Step) -> None:
        self.step, self.frame = step.index, 0

    def present(self, target: Target) -> None:
        self.log.append(f"present {target}")
        self.target = target

    def time_s(self) -> float:
        return 100.0 * self.step + self.frame if self.repeatable else next(_CLOCK)

    def __enter__(self) -> Self:
        self.inside = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.off()
        self.park()
        self.inside = False

    def move(self, goal: Pose) -> Pose:
        self.log.append("move")
        self.frame = 0
        self.pose = goal
        return goal

    def read(self) -> Pose:
        return self.pose

    def stop(self) -> None:
        self.log.append("stop")

    def park(self) -> None:
        self.log.append("park")
        self.pose = Pose()

    def select(self, band: Band) -> None:
        self.band = band

    def on(self) -> None:
        self.log.append("on")
        self.lit = True

    def off(self) -> None:
        self.log.append("off")
        self.lit = False

    def capture(self, exposure_s: float) -> Frame:
        assert self.inside, "a frame was asked of a rig that is not open"
        if self.step == self.fails_at:
            raise DeviceError("camera: no frame came within 5 s")
        camera = self.description.camera
        rng = np.random.default_rng([self.seed, self.step, self.frame])
        albedo = 0.99 if self.target == "reference" else self.albedo
        cosine = math.cos(self.pose.light) * math.cos(self.pose.tilt)
        electrons = camera.responsivity_e_per_s * albedo * max(cosine, 0.0) * exposure_s if self.lit else 0.0
        level = rng.poisson(electrons, (camera.height, camera.width)).clip(max=camera.full_well_e)
        dn = np.clip(np.rint(level / camera.electrons_per_dn + camera.black_level_dn), 0, camera.white_level_dn)
        time_s = self.time_s() if self.stamps is None else self.stamps(self.time_s())
        self.frame += 1
        if self.pushes.get(self.step, 0) and self.frame == 3:
            self.pushes[self.step] -= 1
            self.pose = replace(self.pose, camera=self.pose.camera + math.radians(0.3))
        return Frame(dn.astype(np.uint16), exposure_s, camera.black_level_dn, camera.white_level_dn, time_s=time_s)


@dataclass(frozen=True)
class Plugin:
    """An entry point whose rigs can be looked at afterwards."""

    opened: list[Any] = field(default_factory=list)
    options: dict[str, object] = field(default_factory=dict)
    toml: str = ""
    kind: type[NumpyRig] = NumpyRig

    def open(
        self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool
    ) -> NumpyRig:
        self.opened.append(self.kind(description, seed, **self.options))  # type: ignore[arg-type]
        return self.opened[-1]


class StopAfter(Silent):
    """A user who presses Ctrl-C after so many steps (and again after so many more)."""

    def __init__(self, *steps: int) -> None:
        self.count, self.steps = 0, steps

    def step(self, live: Live) -> None:
        """Count."""
        self.count += 1
        if self.count in self.steps:
            signal.raise_signal(signal.SIGINT)


SAMPLE = SampleDescription(name="matte", model="lambert", parameters={"albedo": 0.5})
PLAN = """name = "small"
wavelength_nm = [550, 650]
[[sweep]]
theta_i_deg = [20]
theta_r_deg = [-60, -20, 0, 30, 70]
[[sweep]]
theta_i_deg = [40]
theta_r_deg = [30]
dphi_deg = [90]
"""


def plan_in(folder: Path, text: str = PLAN) -> Plan:
    """A plan, from the file `plan.toml` that is written into a folder."""
    (folder / "plan.toml").write_text(text)
    return load_plan(folder / "plan.toml")


def measured(
    plan: Plan, out: Path, rig: Any = None, *, description: RigDescription | None = None, **changes: Any
) -> Run:
    """A run on the rig of numpy, or on that of another plugin."""
    choice = RigChoice(rig or Plugin(), description or describe(), "numpy")
    given: dict[str, Any] = {"sample": SAMPLE, "seed": 1} | changes
    return carry_out(plan, choice, out, **given)
