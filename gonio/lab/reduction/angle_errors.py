"""What errors of the axes, and of a calibrated geometry, do to the values of a band (docs/radiometry.md, section 4)."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gonio.geometry import Directions, mirrored
from gonio.lab.reduction import spikes
from gonio.lab.reduction.angle_sensitivity import BandCurves
from gonio.lab.reduction.geometry_errors import zero_u_deg
from gonio.lab.reduction.step_rates import Reduced
from gonio.lab.reduction.values import MeasuredBand, Values
from gonio.lab.rig import Pose, imaging, kinematics
from gonio.lab.rig.description import Axis, RigDescription
from gonio.lab.rig.regions import filling, roi
from gonio.typing import Floats

CAUSES = {
    "light": "s_theta_i_zero",
    "camera": "s_theta_r_zero",
    "tilt": "s_tilt_zero",
    "azimuth": "s_azimuth_zero",
    "spin": "s_spin_zero",
}
"""Axes whose zeros are common causes. A spin turns both directions alike: its column is 0 of an isotropic surface."""


def angle_axes(description: RigDescription) -> dict[str, Axis]:
    """The axes whose angles a value depends on."""
    return {name: axis for name, axis in description.axes().items() if name in CAUSES}


def zero_uncertainties(description: RigDescription) -> dict[str, float]:
    """Standard uncertainty [rad] of each zero; both arms are always there, so that tables have the same columns.

    0 where the zero is one of the numbers that `s_geometry_1` and its neighbours hold.
    """
    axes = {name: math.radians(u) for name, u in zero_u_deg(description, angle_axes(description)).items()}
    return {name: u for name, u in axes.items() if u > 0 or name in ("light", "camera")}


def encoder_steps(description: RigDescription) -> dict[str, float]:
    """Standard uncertainty [rad] of a reading: in whole steps, uniform over one step, and with the encoder's noise."""
    axes = {
        name: math.hypot(math.radians(axis.encoder_step_deg) / math.sqrt(12.0), math.radians(axis.encoder_noise_deg))
        for name, axis in angle_axes(description).items()
    }
    return {name: u for name, u in axes.items() if u > 0}


def is_behind(d: Directions) -> bool:
    """Whether the detector of one pair of directions is behind the sample."""
    return bool(d.theta_r > 0.5 * math.pi)


def turned_over(d: Directions, behind: bool) -> Directions:
    """Directions of transmission as those of reflection: the detector mirrored at the sample's plane."""
    return Directions(d.theta_i, d.phi_i, math.pi - d.theta_r, d.phi_r) if behind else d


def curves_of(measured: MeasuredBand, brdf: Floats, u: Floats) -> BandCurves:
    """How the values of a band, with their independent standard uncertainties [1/sr], follow the angles."""
    description = measured.description
    cones = math.radians(description.lamp.half_angle_deg), math.radians(description.camera.lens_half_angle_deg)
    goals = Directions.from_table(measured.frames.plan)[[point.point for point in measured.points]]
    goals = turned_over(goals, bool(len(goals)) and is_behind(goals[0]))
    read = Directions.stack([point.directions for point in measured.points])
    return BandCurves(goals, read, brdf, u, cones, _overlaps(measured, cones), filling(description) == "under")


def add(measured: MeasuredBand, values: Values, curves: BandCurves) -> None:
    """The changes by every axis's reading and zero, by the geometry, and by the lobes over the region of interest.

    Of a spike the blur holds what errors of the angles do evenly.
    """
    description, points = measured.description, measured.points
    odd_all, steps, even_steps, even_zeros, unresolved = np.zeros((5, len(points)))
    for axis, u in encoder_steps(description).items():
        odd, even, u_slope = _effects(description, curves, points, axis, u)
        odd_all, steps, even_steps = odd_all + odd**2, steps + odd**2, even_steps + even**2
        unresolved = unresolved + u_slope**2
    for axis, u in zero_uncertainties(description).items():
        odd, even, u_slope = _effects(description, curves, points, axis, u)
        odd_all, even_zeros, unresolved = odd_all + odd**2, even_zeros + even**2, unresolved + u_slope**2
        values.common[CAUSES[axis]] = odd - values.brdf * change_of_cosine(description, measured.visit, axis, u)
    geometry, even_geometry, u_slopes = _effects_of_geometry(measured, curves, values.brdf)
    odd_all, unresolved = odd_all + np.sum(geometry**2, axis=1), unresolved + u_slopes
    values.shared["geometry"] = geometry
    blur, spiked = curves.spikes.variance, values.lobes.spike != 0
    variances = {
        "encoder": steps + np.where(spiked, 0.0, even_steps),
        "zeros_even": np.where(spiked, 0.0, even_zeros),
        "geometry": np.where(spiked, 0.0, even_geometry),
        "spike_blur": np.where(spiked, np.maximum(blur - odd_all, 0.0), blur),
        "coarse_steps": unresolved,
    }
    others = sum(u**2 for u in values.own.values()) + sum(variances.values()) - unresolved
    values.own |= {name: np.sqrt(variance) for name, variance in variances.items()}
    pixels = [_pixels(measured, point) for point in points]
    region = np.array([curves.over_region(k, p.directions, *pixels[k]) for k, p in enumerate(points)])
    values.own["region"] = abs(region)
    # the steps along a curve, and not those between angles of incidence
    values.coarse = (unresolved > others + region**2) & (values.lobes.u_slope > values.lobes.u_slope_theta_i)
    of_readings = sum(variances[name] for name in ("encoder", "zeros_even", "spike_blur", "coarse_steps")) - u_slopes
    values.of_readings = {"geometry_slopes": np.sqrt(u_slopes), "u_angles": np.sqrt(np.maximum(of_readings, 0.0))}


def coarse_steps(
    description: RigDescription, poses: Sequence[Pose], goals: Directions, brdf: Floats, u: Floats
) -> Floats:
    """Standard uncertainties [1/sr] that a plan's steps will leave where they are coarser than a lobe is wide.

    Parameters
    ----------
    description, poses, goals
        Where the points of the plan are, and the directions that were asked for.
    brdf, u : (n,) arrays [1/sr]
        The values that are expected there, and their independent standard uncertainties.
    """
    behind = bool(len(goals)) and is_behind(goals[0])
    read = Directions.stack([turned_over(kinematics.directions(description, pose), behind) for pose in poses])
    cones = math.radians(description.lamp.half_angle_deg), math.radians(description.camera.lens_half_angle_deg)
    none = [spikes.OverlapFraction()] * len(poses)
    under = filling(description) == "under"
    curves, variance = BandCurves(turned_over(goals, behind), read, brdf, u, cones, none, under), np.zeros(len(poses))
    for axis, error in (*encoder_steps(description).items(), *zero_uncertainties(description).items()):
        if error > 0 and (axis != "spin" or curves.directed):
            moved = [_moved(description, pose, axis, error) for pose in poses]
            variance += np.array([curves.slope_uncertainty(k, there) for k, there in enumerate(moved)]) ** 2
    return np.sqrt(variance)


def change_of_cosine(description: RigDescription, visit: Reduced, axis: str, u: float) -> float:
    """Relative change (odd part) of the signal of the reference when an axis truly stands u [rad] off.

    The lamp itself, seen whole, is as bright wherever in the frame it stands.
    """
    if description.reference.how == "beam":
        return 0.0
    which = "theta_i" if filling(description) == "over" else "theta_r"
    up, down = (math.cos(getattr(_moved(description, visit.pose, axis, by), which)) for by in (u, -u))
    return 0.5 * (up - down) / math.cos(getattr(visit.directions, which))


def _moved(description: RigDescription, pose: Pose, axis: str, by: float) -> Directions:
    """The directions when an axis stands elsewhere; of transmission `turned_over`."""
    moved = kinematics.directions(description, replace(pose, **{axis: getattr(pose, axis) + by}))
    return turned_over(moved, is_behind(kinematics.directions(description, pose)))


def _effects(
    description: RigDescription, curves: BandCurves, points: list[Reduced], axis: str, u: float
) -> tuple[Floats, Floats, Floats]:
    """Odd and even change [1/sr] of every value when an axis truly stands +-u [rad] from where it is read.

    And how uncertain [1/sr] the odd ones are, because steps are coarser than the lobe is wide.
    """
    out = np.zeros((3, len(points)))
    if u > 0 and (axis != "spin" or curves.directed):
        for k, point in enumerate(points):
            plus, minus = (_moved(description, point.pose, axis, by) for by in (u, -u))
            out[:, k] = *curves.effects(k, point.directions, plus, minus), curves.slope_uncertainty(k, plus)
    return out[0], out[1], out[2]


def _effects_of_geometry(measured: MeasuredBand, curves: BandCurves, brdf: Floats) -> tuple[Floats, Floats, Floats]:
    """Odd change [1/sr] of every value by every cause of `GeometryErrors`, shape (points, causes).

    And the sums over the causes of the squares of the even changes and of what the plan's steps leave open of them.
    """
    errors, points = measured.frames.geometry, measured.points
    odd, even, u_slope = np.zeros((3, len(points), errors.count))
    if not errors.count:
        return odd, np.zeros(len(points)), np.zeros(len(points))
    if measured.description.reference.how == "beam":
        light = errors.straight_through(measured.visit.pose)
    else:
        light = errors.at(measured.visit.pose, "reference").relative_light
    for k, point in enumerate(points):
        factor = errors.at(point.pose, "sample").relative_distance_factor
        for j, (up, down) in enumerate(_changed(measured, point)):
            odd[k, j], even[k, j] = curves.effects(k, point.directions, up, down)
            u_slope[k, j] = curves.slope_uncertainty(k, up)
        odd[k] += brdf[k] * 0.5 * (factor[:, 0] - factor[:, 1] - light[:, 0] + light[:, 1])
    return odd, np.sum(even**2, axis=1), np.sum(u_slope**2, axis=1)


def _changed(measured: MeasuredBand, point: Reduced) -> list[tuple[Directions, Directions]]:
    """The directions of a point for one standard deviation of each cause of `GeometryErrors`, up and down."""
    if not measured.frames.geometry.count:
        return []
    sights = measured.frames.geometry.at(point.pose, "sample")
    behind = bool(sights.known[2] > 0.5 * math.pi)
    return [(turned_over(up, behind), turned_over(down, behind)) for up, down in sights.directions()]


def _overlaps(measured: MeasuredBand, cones: tuple[float, float]) -> list[spikes.OverlapFraction]:
    """What each point sees of a specular spike."""
    description = measured.description
    # a spin turns the lamp's mirror image and the lens alike
    each = (*encoder_steps(description).items(), *zero_uncertainties(description).items())
    errors = [(axis, u) for axis, u in each if axis != "spin"]
    g, radius = description.geometry, description.acquisition.roi_radius_mm
    # beyond six standard deviations of the errors nothing of the mirror image is seen
    blur = 6.0 * sum(u for _, u in errors) + 2.0 * radius * (1.0 / g.light_distance_mm + 1.0 / g.camera_distance_mm)
    out = []
    for point in measured.points:
        d = point.directions
        changed = [up for up, _ in _changed(measured, point)]
        turned = sum(float(np.linalg.norm(change.from_mirror - d.from_mirror)) for change in changed)
        if float(d.mirror_offset) >= sum(cones) + blur + 6.0 * turned:
            out.append(spikes.OverlapFraction())
            continue
        moved = Directions.stack([*(_moved(description, point.pose, axis, u) for axis, u in errors), *changed])
        patch = spikes.over_patch(d, radius, g.light_distance_mm, g.camera_distance_mm)
        omega_i, omega_r = _pixels(measured, point)
        by_pixels = np.asarray(omega_r - mirrored(omega_i) - d.from_mirror)
        out.append(spikes.blurred_overlap(d, moved, cones, patch, by_pixels))
    return out


def _pixels(measured: MeasuredBand, point: Reduced) -> tuple[Floats, Floats]:
    """Unit vectors to source and detector from the pixels that a point's value is the mean of, shape (n, 3)."""
    description = measured.description
    view = kinematics.view(description, point.pose)
    region = roi(description, view, "sample", measured.band.channel)
    seen = imaging.pixel_map(description, view, region.rows, region.cols)
    omega_i, omega_r = seen.omega_i[region.mask], seen.omega_r[region.mask]
    omega_r = omega_r * (1.0, 1.0, -1.0) if view.camera_mm[2] < 0.0 else omega_r
    if filling(description) == "over":
        return omega_i, omega_r
    lit = seen.lit[region.mask] > 0.5
    return (omega_i[lit], omega_r[lit]) if lit.any() else (omega_i, omega_r)
