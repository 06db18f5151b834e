"""A run made by hand: frames from the measurement equation, written out independently of the simulated rig."""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from gonio.geometry import Directions
from gonio.lab.acquisition.records import FrameRecord, Kind, StepRecord
from gonio.lab.rig import Frame, Pose, Step
from gonio.lab.rig.description import Acquisition, Arms, Reference, RigDescription
from gonio.lab.rig.dng import write_dng
from gonio.lab.rig.inverse_kinematics import reach
from gonio.lab.rig.kinematics import directions
from gonio.lab.rig.light_and_camera import Band, Bands, Camera, Lamp
from gonio.typing import Floats

ANGLES = ("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg")
BAND = Band(name="550 nm", centre_nm=550.0, fwhm_nm=10.0)
Brdf = Callable[[Directions], float]


def describe(**tables: Any) -> RigDescription:
    """A rig without any effect: 64 x 64 pixels of 0.225 mm on the sample, 16 bits, one e- a DN."""
    camera = {
        "width": 64, "height": 64, "pixel_um": 25.0, "bits": 16, "electrons_per_dn": 1.0, "black_level_dn": 1000.0,
        "full_well_e": 60_000.0, "responsivity_e_per_s": 40_000.0,
    }  # fmt: skip
    return RigDescription(
        rig="by-hand",
        name="run made by hand",
        bands=Bands(list=(BAND,)),
        camera=Camera(**(camera | tables.pop("camera", {}))),
        acquisition=Acquisition(**({"roi_radius_mm": 3.0} | tables.pop("acquisition", {}))),
        reference=Reference(**({"albedo": 0.99} | tables.pop("reference", {}))),
        **tables,
    )


def in_plane(theta_i_deg: float, signed_theta_r_deg: float) -> tuple[float, float, float, float]:
    return (theta_i_deg, 0.0, abs(signed_theta_r_deg), 180.0 if signed_theta_r_deg >= 0 else 0.0)


class Taken(list[StepRecord]):
    """Steps that are said to be all that were planned."""

    numbers: ClassVar = range(100_000)


@dataclass
class MadeRun:
    """Has what `reduce` reads of a `gonio.lab.acquisition.run.Run`."""

    path: Path
    description: RigDescription
    plan: pd.DataFrame
    bands: tuple[Band, ...] = (BAND,)
    sample: None = None
    seed: int = 0
    laboratory: dict[str, Any] = field(default_factory=dict)
    taken: list[StepRecord] = field(default_factory=list)
    lit_anew_s: list[float] = field(default_factory=list)
    batches: tuple[()] = ()

    settings: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(adaptive=None))

    def steps(self) -> Taken:
        return Taken(self.taken)

    @property
    def planned(self) -> SimpleNamespace:
        return SimpleNamespace(flags=self.plan["flag"].tolist())

    points = planned

    def grown_steps(self) -> list[Step]:
        return []

    def frame_path(self, name: str) -> Path:
        return self.path / name


@dataclass
class Maker:
    """Takes the frames of a run, pixel by pixel, from vectors."""

    path: Path
    description: RigDescription
    brdf: Brdf
    rng: np.random.Generator | None = None
    lamp: Callable[[float], float] = lambda time_s: 1.0
    time_s: float = 0.0
    number: int = 0

    def make(
        self, points: list[tuple[float, float, float, float]], exposures: tuple[float, ...], every: int = 10
    ) -> MadeRun:
        plan = pd.DataFrame(points, columns=list(ANGLES)).assign(flag="", reason="")
        run = MadeRun(self.path, self.description, plan)
        steps = [self.darks(), self.visit()]
        for row, point in enumerate(points):
            goal = reach(self.description, Directions(*np.radians(point)))
            steps.append(self.step("point", goal, exposures, row))
            if (row + 1) % every == 0 or row + 1 == len(points):
                steps.append(self.visit())
        run.taken = steps
        return run

    def visit(self) -> StepRecord:
        reference = self.description.reference
        goal = reach(self.description, Directions(*np.radians(in_plane(reference.theta_i_deg, reference.theta_r_deg))))
        return self.step("reference", goal, (0.5,) * reference.frames)

    def darks(self) -> StepRecord:
        count = self.description.acquisition.dark_frames
        frames = [self.frame(None, "dark", t) for t in (0.001, 2.0) for _ in range(count)]
        return self.record("dark", None, Pose(), frames)

    def step(self, kind: Kind, read: Pose, exposures: tuple[float, ...], row: int | None = None) -> StepRecord:
        """The encoders read `read`; the axes may stand elsewhere (`stand`)."""
        return self.record(kind, row, read, [self.frame(self.stand(read), kind, t) for t in exposures])

    def stand(self, read: Pose) -> Pose:
        return read

    def record(self, kind: Kind, row: int | None, pose: Pose, frames: list[FrameRecord]) -> StepRecord:
        self.number += 1
        return StepRecord(
            step=self.number - 1, kind=kind, point=row, time_s=self.time_s, goal=pose, pose=pose, flag="",
            frames=tuple(frames),
        )  # fmt: skip

    def frame(self, pose: Pose | None, kind: str, exposure_s: float) -> FrameRecord:
        camera = self.description.camera
        electrons = np.zeros((camera.height, camera.width))
        if pose is not None:
            electrons = self.rate(pose, kind) * exposure_s * self.lamp(self.time_s)
        dn = self.sensor(electrons + camera.dark_current_e_per_s * exposure_s)
        name = f"{self.number:06d}-{self.time_s:.3f}.dng"
        levels = camera.black_level_dn, camera.white_level_dn
        write_dng(Frame(dn, exposure_s, *levels, camera.pattern, time_s=self.time_s), self.path / name)
        digest = hashlib.sha256((self.path / name).read_bytes()).hexdigest()
        record = FrameRecord(name, BAND.name, exposure_s, self.time_s, pose is not None, digest)
        self.time_s += exposure_s + 1.0
        return record

    def rate(self, pose: Pose, kind: str) -> Floats:
        """Electrons a second of each pixel; rays and angles written out one vector at a time."""
        d, geometry, camera = directions(self.description, pose), self.description.geometry, self.description.camera
        value = float(self.description.reference.albedo or 0.0) / math.pi if kind == "reference" else self.brdf(d)
        source, eye = (
            distance * np.array([math.sin(t) * math.cos(p), math.sin(t) * math.sin(p), math.cos(t)])
            for distance, t, p in (
                (geometry.light_distance_mm, d.theta_i, d.phi_i),
                (geometry.camera_distance_mm, d.theta_r, d.phi_r),
            )
        )
        to_source = source - self.spots(eye)
        distance = np.linalg.norm(to_source, axis=-1)
        geometry_factor = to_source[..., 2] / distance * (geometry.light_distance_mm / distance) ** 2
        return camera.responsivity_e_per_s * math.pi * value * geometry_factor

    def spots(self, eye: Floats) -> Floats:
        """In plane: the image's rows run along y, and its columns across it."""
        camera = self.description.camera
        focus = 1.0 / (1.0 / camera.focal_length_mm - 1.0 / self.description.geometry.camera_distance_mm)
        axis = -eye / np.linalg.norm(eye)
        rows = np.array([0.0, 1.0, 0.0])
        columns = np.cross(rows, axis)
        i, j = np.mgrid[: camera.height, : camera.width].astype(float)
        u = (j - (camera.width - 1) / 2) * camera.pixel_um / 1000 / focus
        v = (i - (camera.height - 1) / 2) * camera.pixel_um / 1000 / focus
        ray = axis + u[..., None] * columns + v[..., None] * rows
        return eye + ray * (-eye[2] / ray[..., 2])[..., None]

    def sensor(self, electrons: Floats) -> npt.NDArray[np.uint16]:
        camera = self.description.camera
        if self.rng is not None:
            if camera.photon_noise:
                electrons = self.rng.poisson(electrons).astype(float)
            electrons = np.minimum(electrons, camera.full_well_e)
            electrons = electrons + self.rng.normal(0.0, camera.read_noise_e, electrons.shape)
        dn = np.floor(electrons / camera.electrons_per_dn + camera.black_level_dn + 0.5)
        return np.clip(dn, 0, camera.white_level_dn).astype(np.uint16)


__all__ = ["ANGLES", "BAND", "Arms", "Lamp", "MadeRun", "Maker", "describe", "in_plane"]
