"""What a calibration leaves open of a rig's geometry, and what that does to the directions of every step.

A calibration knows zeros, encoders, axes, holder, distances and lens with a covariance. Its independent directions are
the causes: along each of them the rig's description is moved by one standard deviation up and down. At the pose that
was read the moved rig shows other directions, and the light falls otherwise, at the place of the sensor that the region
of interest lies around.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gonio.config import numbers_in, with_numbers
from gonio.errors import ConfigError
from gonio.geometry import Directions, angles
from gonio.lab.rig import Pose, Target, imaging, kinematics
from gonio.lab.rig.calibration_files import covariance_of, known_parameters
from gonio.lab.rig.description import Axis, RigDescription
from gonio.lab.rig.regions import filling, straight_through_scale
from gonio.typing import Floats

ARMS = ("zero_offset_deg", "harmonics_deg", "axis_tilt_deg", "axis_offset_mm", "elevation_deg")
HOLDER = (
    "zero_offset_deg", "tilt_zero_offset_deg", "spin_zero_offset_deg", "surface_offset_mm", "surface_tilt_deg",
    "sample_offset_mm", "spin_axis_tilt_deg", "tilt_axis_offset_mm",
)  # fmt: skip
CAMERA = ("principal_point_px", "distortion", "roll_deg", "pointing_deg", "focal_length_mm", "pixel_um")
DISTANCES = ("light_distance_mm", "camera_distance_mm")
GEOMETRIC = tuple(
    [f"arms.{arm}.{key}" for arm in ("light", "camera", "azimuth") for key in ARMS]
    + [f"holder.{key}" for key in HOLDER]
    + [f"camera.{key}" for key in CAMERA]
    + [f"geometry.{key}" for key in DISTANCES]
)
"""Keys that directions and light at a pose depend on."""
NEGLIGIBLE = 1e-12
"""Eigenvalues of a correlation that are rounding."""


def zero_keys(description: RigDescription) -> dict[str, str]:
    """The key that holds the zero of each axis."""
    out = {name: f"arms.{name}.zero_offset_deg" for name in ("light", "camera", "azimuth")}
    for name in ("tilt", "spin"):
        own = getattr(description.holder, f"{name}_zero_offset_deg") is not None
        out[name] = f"holder.{name}_zero_offset_deg" if own else "holder.zero_offset_deg"
    return {name: out[name] for name in description.axes()}


def zero_u_deg(description: RigDescription, axes: Iterable[str]) -> dict[str, float]:
    """Standard uncertainty [deg] of the zeros of axes, as far as it is not in `parameters`.

    A calibration that knows a zero is believed, and not `zero_u_deg` of the rig file.
    """
    keys, known, common = zero_keys(description), known_parameters(description), parameters(description)
    out = {}
    for name in axes:
        axis: Axis = description.axes()[name]
        if keys[name] not in known:
            out[name] = axis.zero_u_deg
        else:
            alone = keys[name] not in common
            out[name] = math.sqrt(float(covariance_of(description, [keys[name]])[0, 0])) if alone else 0.0
    return out


def parameters(description: RigDescription) -> list[str]:
    """The numbers of a rig's geometry that its calibrations know as a whole, with a covariance.

    Zeros that are all that is known, each by itself, are not among them: they are causes of their own.
    """
    known = [name for name in known_parameters(description) if name.split("[")[0] in GEOMETRIC]
    covariance = covariance_of(description, known)
    apart = not np.any(covariance - np.diag(np.diag(covariance)))
    return [] if apart and set(known) <= set(zero_keys(description).values()) else known


@dataclass(frozen=True, slots=True)
class PatchSights:
    """What the middle of the region of interest sees at one pose that was read.

    Each as theta_i, phi_i, theta_r, phi_r [rad] and (d0 / d)^2, d being the distance from the lamp.
    """

    known: Floats
    """Values with the rig as it is known."""
    changed: Floats
    """Values with the rig one standard deviation of each cause up and down, shape (causes, 2, 5)."""

    underfilled: bool = False
    """The flux of the whole beam is known: it does not depend on where the place is, and spreads as cos(theta_r)."""

    @property
    def relative_light(self) -> Floats:
        """The signal of a white there, by causes up and down, over that with the rig as it is known."""
        which = 2 if self.underfilled else 0
        return np.asarray(np.cos(self.changed[..., which]) / np.cos(self.known[which]) * self.relative_distance_factor)

    @property
    def relative_distance_factor(self) -> Floats:
        """The same of (d0 / d)^2 alone."""
        if self.underfilled:
            return np.ones(self.changed.shape[:2])
        return np.asarray(self.changed[..., 4] / self.known[4])

    def directions(self) -> list[tuple[Directions, Directions]]:
        """For each cause up and down."""
        return [(Directions(*up[:4]), Directions(*down[:4])) for up, down in self.changed.tolist()]


class GeometryErrors:
    """The independent causes that a calibration's covariance of the geometry consists of.

    Raises
    ------
    ConfigError
        A calibration is uncertain of a number that the run's rig does not have.
    """

    def __init__(self, description: RigDescription) -> None:
        self._description = description
        names = parameters(description)
        covariance = covariance_of(description, names)
        u = np.sqrt(np.diag(covariance))
        known = u > 0.0
        names, u = [name for name, one in zip(names, known, strict=True) if one], u[known]
        correlation = covariance[np.ix_(known, known)] / np.outer(u, u)
        values, vectors = np.linalg.eigh(correlation) if names else (np.zeros(0), np.zeros((0, 0)))
        kept = values > NEGLIGIBLE * max(len(names), 1)
        self._tables = description.model_dump(mode="json", exclude={"calibration"}) if names else {}
        numbers = numbers_in(self._tables)
        if missing := [name for name in names if name not in numbers]:
            raise ConfigError(
                f'calibration.known: a calibration is uncertain of {missing[0]}, which the rig "{description.name}" '
                "has no number for; calibrate again"
            )
        steps = (vectors[:, kept] * np.sqrt(values[kept]) * u[:, None]).T
        self._rigs = [tuple(self._moved(names, numbers, sign * step) for sign in (1.0, -1.0)) for step in steps]
        self._seen: dict[tuple[Pose, Target], PatchSights] = {}

    @property
    def count(self) -> int:
        """How many causes there are."""
        return len(self._rigs)

    def _moved(
        self, names: list[str], numbers: dict[str, float], step: Floats
    ) -> tuple[RigDescription, dict[str, float]]:
        """A rig with other numbers, and what its encoders then read otherwise [rad]: its zeros have moved."""
        by = dict(zip(names, step.tolist(), strict=True))
        rig = RigDescription.model_validate(with_numbers(self._tables, {n: numbers[n] + v for n, v in by.items()}))
        axes = self._description.axes()
        shifts = {name: -math.radians(by.get(key, 0.0)) for name, key in zero_keys(self._description).items()}
        return rig, {name: shift for name, shift in shifts.items() if shift and axes[name].zero_offset_known}

    def straight_through(self, pose: Pose) -> Floats:
        """The signal of the lamp seen straight through, per unit BRDF, by causes up and down; shape (causes, 2).

        Over that with the rig as it is known. The lamp is seen whole wherever it stands, and distances count alone.
        """

        def scale(rig: RigDescription) -> float:
            return straight_through_scale(rig, kinematics.view(rig, pose))

        known, changed = scale(self._description), [[scale(rig) for rig, _ in rigs] for rigs in self._rigs]
        return np.array(changed).reshape(-1, 2) / known

    def at(self, pose: Pose, target: Target) -> PatchSights:
        """What is seen at a pose that was read; bands ask for the same."""
        if (pose, target) not in self._seen:
            place = imaging.place(self._description, kinematics.view(self._description, pose), target)
            known = _glance(self._description, {}, pose, place)
            changed = [[_glance(*moved, pose, place) for moved in rigs] for rigs in self._rigs]
            under = filling(self._description) == "under"
            self._seen[pose, target] = PatchSights(known, np.array(changed).reshape(-1, 2, 5), under)
        return self._seen[pose, target]


def _glance(rig: RigDescription, shifts: dict[str, float], pose: Pose, place: tuple[float, float]) -> Floats:
    """One row of `PatchSights`."""
    if shifts:
        pose = replace(pose, **{name: getattr(pose, name) + by for name, by in shifts.items()})
    view = kinematics.view(rig, pose)
    spot = np.append(imaging.spot(rig, view, *place), 0.0)
    ends = np.stack([view.source_mm, view.camera_mm]) - spot
    (theta_i, theta_r), (phi_i, phi_r) = angles(ends)
    factor = rig.geometry.light_distance_mm**2 / (ends[0] @ ends[0])
    return np.array([theta_i, phi_i, theta_r, phi_r, factor])
