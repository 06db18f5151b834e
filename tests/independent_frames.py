"""A second goniometer in front of a second camera: frames by explicit rays, from docs/conventions.md's words alone.

Nothing here calls `gonio.lab.rig.kinematics`, `gonio.lab.rig.imaging`, `gonio.instrument` or `gonio_sim`. An error that
the simulated camera and the reduction share cancels between them; against these frames it does not.

- Axes are products of rotation matrices. The lab's y is the axis of both arms, z the untilted sample's normal.
- The lamp is a disc of point emitters that faces the sample's centre. Each lights a spot by cos(theta_i) / d^2.
- The lens is a disc of pupil points. A pixel is split into squares. A ray goes from each pupil point through the point
  that is in focus for the square, and on to the sample. So the pupil's cone, and a tilted sample that leaves the plane
  in focus, are in it by brute force.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

import numpy as np

from gonio.lab.rig import Frame, Pose, Step, Target
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band
from gonio.samples.description import SampleDescription
from gonio.typing import Floats
from tests.gonio.lab.rig.plain_rig import rotation

Brdf = Callable[[Floats, Floats, Floats, Floats], Floats]
"""f [1/sr] of unit vectors to lamp and lens, shape (..., 3), and of a spot's x and y [mm], in the sample's frame."""


@dataclass(frozen=True)
class Placed:
    """Lamp and camera in the sample's frame: the columns of each matrix are the body's own x, y and z.

    The z of either points away from the sample's centre. The columns of an image grow along the camera's -x, its rows
    along its y.
    """

    lamp: Floats
    camera: Floats

    @classmethod
    def at(cls, pose: Pose) -> Placed:
        """From the angles of the axes [rad]."""
        to_sample = (rotation("x", -pose.tilt) @ rotation("z", pose.spin)).T
        lamp = rotation("y", pose.light)
        camera = rotation("z", pose.azimuth) @ rotation("y", pose.camera)
        return cls(to_sample @ lamp, to_sample @ camera)

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """theta_i, theta_r and dphi in [0, 360) of the two bodies, as degrees."""
        towards = [self.lamp[:, 2], self.camera[:, 2]]
        theta = [np.degrees(np.arctan2(np.hypot(v[0], v[1]), v[2])) for v in towards]
        phi = [np.degrees(np.arctan2(v[1], v[0])) for v in towards]
        return float(theta[0]), float(theta[1]), float((phi[1] - phi[0]) % 360.0)


def disc(rings: int = 1, spokes: int = 6) -> Floats:
    """Points of equal weight in a disc of radius 1, shape (n, 2): rings of equal area, at the mean of their r^2.

    One ring of six points averages polynomials up to the third degree exactly. Of a disc of 0.5 degrees the rest is
    below 1e-7 of a lobe that is 20 degrees wide.
    """
    radius = np.sqrt((np.arange(rings)[:, None] + 0.5) / rings)
    turn = 2.0 * np.pi * (np.arange(spokes) + 0.5 * (np.arange(rings)[:, None] % 2)) / spokes
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=-1).reshape(-1, 2)


@dataclass
class Bench:
    """A rig (`gonio.lab.rig.Rig`) whose axes stand where they are sent, and whose frames are rays without noise."""

    description: RigDescription
    brdf: Brdf
    reference: Brdf
    splits: int = 2
    """A pixel is split into as many squares a side."""
    emitters: Floats = field(default_factory=disc)
    pupil: Floats = field(default_factory=disc)
    repeatable: bool = True
    pose: Pose = field(default_factory=Pose)
    target: Target = "sample"
    lit: bool = False
    _clock: itertools.count[int] = field(default_factory=itertools.count)
    _seen: dict[tuple[Pose, str], Floats] = field(default_factory=dict)

    @property
    def arms(self) -> Self:
        return self

    light = camera = arms

    def begin(self, step: Step) -> None:
        """Every step is like another."""

    def present(self, target: Target) -> None:
        self.target = target

    def time_s(self) -> float:
        return float(next(self._clock))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.off()

    def move(self, goal: Pose) -> Pose:
        self.pose = goal
        return goal

    def read(self) -> Pose:
        return self.pose

    def stop(self) -> None:
        """Nothing moves."""

    park = stop

    def select(self, band: Band) -> None:
        """All bands are alike."""

    def on(self) -> None:
        self.lit = True

    def off(self) -> None:
        self.lit = False

    def capture(self, exposure_s: float) -> Frame:
        camera = self.description.camera
        rate = self.rates() if self.lit else np.zeros((camera.height, camera.width))
        electrons = np.minimum(rate * exposure_s, camera.full_well_e)
        dn = np.clip(np.rint(electrons / camera.electrons_per_dn + camera.black_level_dn), 0, 2**camera.bits - 1)
        return Frame(
            dn.astype(np.uint16), exposure_s, camera.black_level_dn, 2.0**camera.bits - 1, time_s=self.time_s()
        )

    def rates(self) -> Floats:
        """Electrons a second of every pixel, at the pose and with the target of now."""
        if (self.pose, self.target) not in self._seen:
            self._seen[self.pose, self.target] = self._rates()
        return self._seen[self.pose, self.target]

    def _rates(self) -> Floats:
        rig, camera, at = self.description, self.description.camera, Placed.at(self.pose)
        far = rig.geometry.camera_distance_mm
        # thin lens: where a sensor point is in focus, in the plane through the sample's centre across the optical axis
        focused = camera.focal_length_mm * far / (far - camera.focal_length_mm)
        fine = (np.arange(self.splits) + 0.5) / self.splits - 0.5
        along_x, along_y = (
            (np.arange(n)[:, None] + fine - (n - 1) / 2).ravel() * camera.pixel_um / 1000.0
            for n in (camera.width, camera.height)
        )
        on_sensor = np.stack(np.meshgrid(along_x, along_y), axis=-1)  # rows, columns, (x, y) [mm]
        in_focus = -far / focused * on_sensor[..., 0, None] * at.camera[:, 0]
        in_focus = in_focus + far / focused * on_sensor[..., 1, None] * at.camera[:, 1]
        radius = far * np.tan(np.radians(camera.lens_half_angle_deg))
        total = np.zeros(on_sensor.shape[:2])
        pupil = self.pupil if radius else self.pupil[:1] * 0.0
        for point in pupil:
            eye = at.camera @ np.array([radius * point[0], radius * point[1], far])
            ray = in_focus - eye
            ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
            total += self._radiance(eye, ray, at) / len(pupil)
        off_axis = np.hypot(on_sensor[..., 0], on_sensor[..., 1])
        if camera.cos4:
            total *= np.cos(np.arctan(off_axis / focused)) ** 4
        corner = camera.pixel_um / 1000.0 * np.hypot(camera.width, camera.height) / 2.0
        total *= 1.0 - camera.vignetting * (off_axis / corner) ** 4
        square = total.reshape(camera.height, self.splits, camera.width, self.splits).mean(axis=(1, 3))
        return np.asarray(camera.responsivity_e_per_s * np.pi * square)

    def _radiance(self, eye: Floats, ray: Floats, at: Placed) -> Floats:
        """What comes along rays, over the irradiance at the sample's centre for light along its normal [1/sr]."""
        down = ray[..., 2] < 0.0
        length = np.where(down, -eye[2] / np.where(down, ray[..., 2], -1.0), np.nan)
        spot = eye + length[..., None] * ray
        spot[..., 2] = 0.0
        rig, out = self.description, np.zeros(ray.shape[:2])
        for centre, size, brdf in self._discs():
            inside = np.hypot(spot[..., 0] - centre[0], spot[..., 1] - centre[1]) <= size / 2.0
            out[inside] = self._lit_spots(spot[inside], -ray[inside], at, brdf, rig)
        return out

    def _discs(self) -> list[tuple[tuple[float, float], float, Brdf]]:
        holder, reference = self.description.holder, self.description.reference
        sample = ((0.0, 0.0), holder.sample_diameter_mm, self.brdf)
        if reference.how == "beside":
            return [sample, (reference.offset_mm, reference.diameter_mm, self.reference)]
        return [sample] if self.target == "sample" else [((0.0, 0.0), reference.diameter_mm, self.reference)]

    def _lit_spots(self, spot: Floats, to_lens: Floats, at: Placed, brdf: Brdf, rig: RigDescription) -> Floats:
        distance = rig.geometry.light_distance_mm
        radius = distance * np.tan(np.radians(rig.lamp.half_angle_deg))
        emitters = self.emitters if radius else self.emitters[:1] * 0.0
        out = np.zeros(len(spot))
        for point in emitters:
            source = at.lamp @ np.array([radius * point[0], radius * point[1], distance])
            way = source - spot
            apart = np.linalg.norm(way, axis=-1)
            to_lamp = way / apart[:, None]
            shines = np.maximum(to_lamp[:, 2], 0.0) * (distance / apart) ** 2
            if rig.lamp.radiation == "lambertian":
                shines = shines * (to_lamp @ at.lamp[:, 2])
            out += brdf(to_lamp, to_lens, spot[:, 0], spot[:, 1]) * shines / len(emitters)
        return out

    def averaged(self, pose: Pose) -> float:
        """f at the sample's centre, averaged over lamp and lens [1/sr]: what a table of this bench should say."""
        at = Placed.at(pose)
        lamp, lens = (
            [
                to @ np.array([np.tan(np.radians(half)) * x, np.tan(np.radians(half)) * y, 1.0])
                for x, y in (disc(8, 24) if half else [(0.0, 0.0)])
            ]
            for to, half in (
                (at.lamp, self.description.lamp.half_angle_deg),
                (at.camera, self.description.camera.lens_half_angle_deg),
            )
        )
        zero = np.zeros(1)
        to_lens = np.array(lens) / np.linalg.norm(lens, axis=1, keepdims=True)
        values, shares = [], []
        for towards in lamp:
            to_lamp = np.broadcast_to(towards / np.linalg.norm(towards), to_lens.shape)
            shares.append(max(float(to_lamp[0, 2]), 0.0))
            values.append(float(self.brdf(to_lamp, to_lens, zero, zero).mean()))
        return float(np.average(values, weights=shares))


@dataclass(frozen=True)
class Plugin:
    """Opens a bench that is there already (`gonio.lab.rig.RigPlugin`)."""

    bench: Bench
    toml: str = ""

    def open(self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool) -> Bench:
        return self.bench


def lambert(albedo: float) -> Brdf:
    """albedo / pi."""
    return lambda to_lamp, to_lens, x, y: np.full(np.shape(to_lens)[:-1], albedo / np.pi)


def lobe(diffuse: float, height: float, width: float) -> Brdf:
    """A smooth and reciprocal lobe of a formula that no model of gonio has.

    diffuse / pi + height exp(-|t|^2 / width^2), with t the sum of both directions' components in the surface.
    """

    def value(to_lamp: Floats, to_lens: Floats, x: Floats, y: Floats) -> Floats:
        across = to_lamp[..., :2] + to_lens[..., :2]
        return np.asarray(diffuse / np.pi + height * np.exp(-np.sum(across**2, axis=-1) / width**2))

    return value


def brushed(height: float, along_x: float, along_y: float) -> Brdf:
    """As `lobe`, of two widths: it tells a sample's x from its y, and (by `t_x t_y`) a turn to the left from one to the
    right."""

    def value(to_lamp: Floats, to_lens: Floats, x: Floats, y: Floats) -> Floats:
        t = to_lamp[..., :2] + to_lens[..., :2]
        exponent = (t[..., 0] / along_x) ** 2 + (t[..., 1] / along_y) ** 2 + 0.8 * t[..., 0] * t[..., 1] / along_x**2
        return np.asarray(height * np.exp(-exponent) + 0.05)

    return value
