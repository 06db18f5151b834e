"""What sweeps are compared on: a rig that measures points without frames, samples, plans, and curves of points.

A run of thousands of frames takes an hour of processor time, and the study `sweeps` needs hundreds of them. So the
camera is left out; values, noise and times are as the simulated rig `sim` has them. A value is that of the true
sample through the cones of lamp and lens, in the direction where the axes truly stand: within a step of what their
encoders read, with zeros that are wrong alike for a whole run. It has the noise that the EMVA 1288 model of the
camera and the lamp's own predict for the frames of the point, and a scale that is wrong by the reference's and by the
mean of its visits. `tests/studies/test_sweeps.py` holds it against runs of the simulated rig with its
frames.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from gonio_sweeps import expected
from gonio_sweeps.candidates import snake
from gonio_sweeps.curve import CurveSampler
from gonio_sweeps.online import GrowingValues

from gonio import models
from gonio.geometry import Directions, direction, solid_angle_of_cone
from gonio.instrument import apparent_brdf
from gonio.lab.acquisition.duration import Durations
from gonio.lab.acquisition.plan import Adaptive, Assessed, Plan, Point, assess, canonical
from gonio.lab.acquisition.plan_tables import HalfVector, Hemisphere
from gonio.lab.rig import Pose, Step, kinematics
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band
from gonio.models import Model
from gonio.typing import Floats

BEYOND = math.radians(89.9)
"""Errors of an angle turn no direction below the horizon: theta ends here."""


@dataclass
class MeasuredSweep:
    """What a run has so far."""

    values: GrowingValues
    seconds: float
    """Rig time."""


class FrameFreeRig:
    """Measures points of one sample, in one run.

    Parameters
    ----------
    description
        A rig without errors of alignment.
    band
        The one band of the run.
    model
        The true sample.
    seed
        What is wrong in this run: zeros, and the scale.
    noise
        What its noise is, and where motors stop within an encoder's step.
    """

    def __init__(self, description: RigDescription, band: Band, model: Model, seed: Sequence[int], noise: int) -> None:
        self.description, self.band, self.model = description, band, model
        self.durations = Durations(description, (band,))
        systematic = np.random.default_rng([*seed, 0])
        self._rng = np.random.default_rng([*seed, 1, noise])
        axes = description.axes()
        self._zero = {name: math.radians(a.zero_u_deg) * systematic.standard_normal() for name, a in axes.items()}
        self._step = {name: math.radians(axis.encoder_step_deg) for name, axis in axes.items()}
        reference = description.reference
        of_visits = description.lamp.frame_noise / math.sqrt(reference.frames)
        self._u_scale = {"s_reference": reference.u_rel, "s_reference_noise": of_visits / math.sqrt(2.0)}
        drawn = {"s_reference": reference.error == "drawn", "s_reference_noise": True}
        errors = [u * systematic.standard_normal() * drawn[name] for name, u in self._u_scale.items()]
        self._scale = 1.0 + math.fsum(errors)

    def truth(self, d: Directions) -> Floats:
        """The sample through the cones of lamp and lens [1/sr]."""
        cones = [solid_angle_of_cone(math.radians(a)) for a in self._cones]
        theta_i, theta_r = np.minimum(d.theta_i, BEYOND), np.minimum(d.theta_r, BEYOND)
        return np.asarray(
            apparent_brdf(
                self.model, theta_i, d.phi_i, theta_r, d.phi_r, wavelength_nm=self.band.centre_nm,
                source_solid_angle_sr=float(cones[0]), receiver_solid_angle_sr=float(cones[1]), spike="exact",
            )
        )  # fmt: skip

    @property
    def _cones(self) -> tuple[float, float]:
        return self.description.lamp.half_angle_deg, self.description.camera.lens_half_angle_deg

    def measure(self, poses: Sequence[Pose], before: MeasuredSweep | None = None) -> MeasuredSweep:
        """Visit poses, with the visits to the reference that belong to them; all values so far."""
        read = [self._read(pose) for pose in poses]
        at = Directions.stack([kinematics.directions(self.description, pose) for pose in read])
        truly = Directions.stack([kinematics.directions(self.description, self._landed(pose)) for pose in read])
        true = self.truth(truly)
        seen = expected.Expected(self.durations, read).visits(true)
        u = np.where(np.isfinite(seen.u_rel), seen.u_rel, 1.0) * np.abs(true)
        values = true * self._scale + u * self._rng.standard_normal(u.size)
        here = Pose() if before is None else before.values.poses[-1]
        seconds = expected.batch_s(self.durations, read, [float(s) for s in seen.seconds], here)
        if before is None:
            seconds += self.description.lamp.warm_up_s + self.durations.frames_s(Step(0, "dark"))
        none = np.zeros(u.size)
        new = GrowingValues(
            rows=np.arange(u.size), directions=at, poses=tuple(read), brdf=values, u_noise=u,
            common={name: values * s for name, s in self._u_scale.items()}, time_s=none,
        )  # fmt: skip
        return (
            MeasuredSweep(new, seconds)
            if before is None
            else MeasuredSweep(joined(before.values, new), before.seconds + seconds)
        )

    def _read(self, pose: Pose) -> Pose:
        """What the encoders read where the motors stop."""
        return replace(
            pose, **{n: round(getattr(pose, n) / step) * step for n, step in self._step.items() if step > 0.0}
        )

    def _landed(self, pose: Pose) -> Pose:
        """Where the axes stand."""
        within = {n: (self._rng.random() - 0.5) * step + self._zero[n] for n, step in self._step.items()}
        return replace(pose, **{n: getattr(pose, n) + error for n, error in within.items()})


def joined(a: GrowingValues, b: GrowingValues) -> GrowingValues:
    """Values of one run, one after the other."""

    def both(x: Any, y: Any) -> Any:
        return np.concatenate([x, y])

    angles = [both(x, y) for x, y in zip(a.directions.angles, b.directions.angles, strict=True)]
    return GrowingValues(
        rows=np.arange(len(a) + len(b)), directions=Directions(*angles), poses=a.poses + b.poses,
        brdf=both(a.brdf, b.brdf), u_noise=both(a.u_noise, b.u_noise),
        common={name: both(a.common[name], b.common[name]) for name in a.common}, time_s=both(a.time_s, b.time_s),
    )  # fmt: skip


def in_order(points: Sequence[Point], poses: Sequence[Pose]) -> list[Pose]:
    """Poses of points in an order that saves travel."""
    return [poses[k] for k in snake(list(points))]


# --- samples, plans, and how a curve is made of their points ------------------------------------------------------


Geometry = Literal["in plane", "hemisphere"]
WAVELENGTH_NM = 500.0
INCIDENCES: dict[Geometry, tuple[float, ...]] = {"in plane": (30.0, 60.0), "hemisphere": (45.0,)}
LARGEST_DEG = 80.0
"""theta_r goes so far."""
SIZES: dict[Geometry, tuple[int, ...]] = {"in plane": (20, 35, 60), "hemisphere": (50, 100)}
"""Points of the fixed plans, for each angle of incidence."""
AROUND_DEG = 12.0
"""Half-width about the mirror direction in which a mirror-dense plan has the other half of its points."""
FLOOR = 1e-3
"""Part of the largest value: errors of values below it count relative to this value."""

SAMPLES: dict[str, tuple[str, dict[str, object]]] = {
    "rough aluminium": ("he-torrance", {"sigma0_um": 0.28, "tau_um": 1.77, "ior": "Al"}),
    "aluminium": ("he-torrance", {"sigma0_um": 0.16, "tau_um": 1.5, "ior": "Al"}),
    "matte": ("oren-nayar", {"albedo": 0.8, "sigma_deg": 25.0}),
    "satin": ("cook-torrance", {"s": 0.3, "m": 0.2, "diffuse_albedo": 0.5, "ior": 1.5}),
    "semi-gloss": ("blinn", {"k_d": 0.4, "k_s": 0.3, "c": 0.12, "ior": 1.5}),
    "glossy paint": ("cook-torrance", {"s": 0.4, "m": 0.05, "diffuse_albedo": 0.5, "ior": 1.5}),
    "retroreflecting": ("retroreflecting", {"returned": 0.1, "width_deg": 4.0, "diffuse_albedo": 0.4}),
    "brushed metal": ("anisotropic", {"alpha_along": 0.08, "alpha_across": 0.25, "ior": "Al"}),
}


def sample(name: str) -> Model:
    """A sample of `SAMPLES`."""
    return models.build(*SAMPLES[name])


@dataclass(frozen=True)
class Places:
    """Directions in which curves are judged: those of the rig that the blocked cone leaves."""

    directions: Directions
    weight: Floats
    """Their share of the angle, or of the hemisphere."""


def judged(geometry: Geometry, description: RigDescription) -> Places:
    """Between the points that plans have, too."""
    incidences = INCIDENCES[geometry]
    if geometry == "in plane":
        # finer than any plan
        signed = np.arange(-LARGEST_DEG, LARGEST_DEG + 0.01, 0.5)
        points = [canonical(i, 0.0, r, 180.0) for i in incidences for r in signed]
    else:
        points = [
            canonical(i, 0.0, r, d) for i in incidences for d in np.arange(0.0, 360.0, 11.0)
            for r in np.arange(2.5, LARGEST_DEG - 4.0, 2.5)
        ]  # fmt: skip
    reached = [a.point for a in assess(_plan(points), description) if a.pose is not None]
    d = Plan("", (WAVELENGTH_NM,), tuple(reached), 0, "").directions
    weight = np.ones(d.shape) if geometry == "in plane" else np.sin(d.theta_r)
    return Places(d, weight / weight.sum())


def _plan(points: Sequence[Point], adaptive: Adaptive | None = None) -> Plan:
    return Plan("bench", (WAVELENGTH_NM,), tuple(points), 0, "bench", adaptive)


def fixed(name: str, geometry: Geometry, size: int, description: RigDescription) -> list[Assessed]:
    """The points of a plan of `size` for each incidence, as far as the rig can reach them.

    Parameters
    ----------
    name
        "uniform", "mirror-dense" or "half-vector".
    """
    rows: list[tuple[float, float, float, float]] = []
    for i in INCIDENCES[geometry]:
        rows += (_in_plane if geometry == "in plane" else _hemisphere)(name, i, size)
    points = tuple(dict.fromkeys(canonical(*row) for row in rows))
    return [a for a in assess(_plan(points), description) if a.pose is not None]


Rows = list[tuple[float, float, float, float]]


def _in_plane(name: str, theta_i: float, size: int) -> Rows:
    if name == "half-vector":
        found: Rows = []
        extra = 0
        while len(found) < size:  # some half vectors lie beyond the largest theta_r
            grid = _half_vectors(theta_i, _spaced(size // 2 + extra, 0.5 * (LARGEST_DEG + theta_i)))
            found = [row for row in grid.rows() if row[2] <= LARGEST_DEG + 1e-9]
            extra += 1
        return found
    even = np.linspace(-LARGEST_DEG, LARGEST_DEG, size if name == "uniform" else size - size // 2)
    near = np.linspace(max(theta_i - AROUND_DEG, -LARGEST_DEG), min(theta_i + AROUND_DEG, LARGEST_DEG), size // 2)
    signed = even if name == "uniform" else np.union1d(even, near)
    return [(theta_i, 0.0, float(r), 180.0) for r in signed]


def _hemisphere(name: str, theta_i: float, size: int) -> Rows:
    count = size if name == "uniform" else size - size // 2
    even = Hemisphere.model_validate({"theta_i_deg": [theta_i], "count": count, "theta_r_max_deg": LARGEST_DEG})
    if name == "uniform":
        return list(even.rows())
    azimuths = max(4, 2 * round(math.sqrt(size) / 2.0))
    phi = tuple(float(x) for x in np.linspace(0.0, 360.0, azimuths, endpoint=False))
    if name == "mirror-dense":
        theta_h = np.linspace(0.0, 0.5 * AROUND_DEG, max(2, size // 2 // azimuths + 1)).tolist()
        near = _half_vectors(theta_i, theta_h, phi)
        return [*even.rows(), *near.rows()]
    theta_h = _spaced(max(3, round(1.5 * size / azimuths)), 80.0)
    return [row for row in _half_vectors(theta_i, theta_h, phi).rows() if row[2] <= LARGEST_DEG + 1e-9]


def _half_vectors(theta_i: float, theta_h: Sequence[float], phi_h: Sequence[float] = (0.0, 180.0)) -> HalfVector:
    keys = {"theta_i_deg": [theta_i], "theta_h_deg": list(theta_h), "phi_h_deg": list(phi_h)}
    return HalfVector.model_validate(keys)


def _spaced(count: int, largest: float, narrow: float = 4.0) -> list[float]:
    """Angles from 0, even in asinh(theta/narrow): dense at 0."""
    return [float(x) for x in narrow * np.sinh(np.linspace(0.0, math.asinh(largest / narrow), count))]


def sampler(geometry: Geometry, description: RigDescription, most_points: int | None) -> CurveSampler:
    """The adaptive plan: by rig time, or where a number of points is given by points."""
    keys: dict[str, object] = {
        "theta_i_deg": list(INCIDENCES[geometry]),
        "theta_r_deg": {"start": -LARGEST_DEG, "stop": LARGEST_DEG, "step": 1.0 if geometry == "in plane" else 5.0},
    }
    if geometry == "hemisphere":
        keys["dphi_deg"] = [float(x) for x in range(15, 180, 15)]
    if most_points is not None:
        keys["most_points"] = most_points
    return CurveSampler(_plan([], Adaptive(how="curve", budget_h=1000.0, **keys)), description)


def interpolated(values: GrowingValues, at: Directions) -> Floats:
    """The usual way: in plane monotone cubics through logarithms, out of it linear ones over Delaunay's triangles.

    Values that are not above zero are replaced by the smallest that is. Beyond the outermost triangles the nearest
    value counts.
    """
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator, PchipInterpolator

    d = values.directions
    logs = np.log(np.maximum(values.brdf, values.brdf[values.brdf > 0].min()))
    out = np.empty(at.shape)
    nominal = np.round(np.degrees(at.theta_i))
    for i in np.unique(nominal):
        own = np.flatnonzero(np.abs(np.degrees(d.theta_i) - i) < 0.5)
        here = np.flatnonzero(nominal == i)
        if bool(d[own].in_plane.all()) and bool(at[here].in_plane.all()):
            x, inverse = np.unique(d.signed[own], return_inverse=True)
            out[here] = PchipInterpolator(x, np.bincount(inverse, logs[own]) / np.bincount(inverse))(at.signed[here])
            continue
        flat = direction(d.theta_r, d.phi_r - d.phi_i)[own, :2]
        where = direction(at.theta_r, at.phi_r - at.phi_i)[here, :2]
        linear = LinearNDInterpolator(flat, logs[own])(where)
        near = NearestNDInterpolator(flat, logs[own])(where)
        out[here] = np.where(np.isfinite(linear), linear, near)
    return np.asarray(np.exp(out))
