"""What uncertainty a plan will have on a rig, cause by cause, and what each calibration changes of it: before anything
is measured.

For a matt sample (brdf = 0.5/pi), whose values change with directions by the light that falls on it alone. What a
calibration has told counts with its covariance, as in the reduction. What none has told yet counts with what is usual
for a bench that was put together with care: of the geometry a part of the ranges that a calibration expects.
"""

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gonio.config import parse
from gonio.lab.acquisition import exposure
from gonio.lab.acquisition.schedule import reference_pose
from gonio.lab.calibration.geometry_problem import INK, Unknown, start_of, unknowns
from gonio.lab.reduction.angle_errors import angle_axes, encoder_steps
from gonio.lab.reduction.geometry_errors import GeometryErrors, parameters, zero_keys, zero_u_deg
from gonio.lab.reduction.light_and_lens import BEAM, monomials
from gonio.lab.rig import Pose, Target, kinematics
from gonio.lab.rig.calibration_files import covariance_of, known_parameters
from gonio.lab.rig.calibration_use import Calibrated, CalibrationUse
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.imaging import pixel_on_sample_mm
from gonio.lab.rig.light_and_camera import Band
from gonio.lab.rig.regions import filling
from gonio.typing import Floats

ALBEDO = 0.5
BY_EYE_DEG = 1.0
"""Standard uncertainty of a zero that nobody knows: it was set by eye."""
CAREFUL = 0.25
"""Standard uncertainty of the geometry over what `geometry_problem.unknowns` expects. By ruler, needle and the outlines
in the live picture: pointing 0.13 deg (2 mm at 1 m), axes 0.5 mm and 0.25 deg, distances 0.75 %, encoders 0.13 deg."""
BENT = 0.01
"""Usual departure of a sensor from a straight line at full scale: data sheets state up to 1 %."""
STRAY = 0.01
"""Usual part of a frame's mean that a lens spreads over it."""
SHAPE = np.diag([1e-3, 1e-3, 2e-4, 2e-4, 2e-4]) ** 2
"""Covariance of a beam's profile [1/mm, 1/mm^2]: 1 % of tilt and 2 % of curvature over 10 mm."""
WARM_UP = 0.05
"""Usual light that a lamp loses while it warms up, with the time constant `WARMS_S`."""
WARMS_S = 400.0
TINY = 1e-6
NAMED = 3
SMALL = 0.32
"""Of all others: what is below changes their root sum of squares by less than 5 %."""


@dataclass(frozen=True, slots=True)
class Expected:
    """What one cause will do to values."""

    cause: str
    u_rel: Floats
    """Relative standard uncertainty at each pose; NaN where nothing can be measured until it is calibrated."""
    command: str = ""
    """What would tell it better."""
    because: str = ""
    """What it comes from."""
    held: bool = True
    """Whether a run's budget will hold it as it is now."""


def expected(
    description: RigDescription, poses: Sequence[Pose], reference: Pose, band: Band, between_s: float
) -> list[Expected]:
    """The causes at some poses.

    Parameters
    ----------
    description
        The rig, with its calibrations.
    poses
        Of points.
    reference
        Where the white is looked at.
    band
        Of the light.
    between_s
        Seconds between two visits to the white.
    """
    rig, count = description, len(poses)
    encoder = [_turned(rig, poses, reference, axis, u) for axis, u in encoder_steps(rig).items()]
    return [
        Expected("white's certificate", np.full(count, rig.reference.u_rel)),
        Expected("noise of camera and lamp", _noise(rig, poses, reference)),
        Expected("encoder steps", _rss(encoder, count)),
        _zeros(rig, poses, reference),
        _geometry(rig, poses, reference),
        _camera(rig, poses, reference),
        _light(rig, poses, reference, band, between_s),
    ]


def total(causes: Sequence[Expected]) -> Floats:
    """Relative standard uncertainty by all causes that a run's budget will hold."""
    held = [cause.u_rel for cause in causes if cause.held]
    return _rss(held, held[0].size)


def advice(cause: Expected, causes: Sequence[Expected]) -> str:
    """What to do about a cause, beside all causes: a calibration, nothing; or the file that tells it."""
    if not cause.command:
        return cause.because
    if np.all(cause.u_rel < SMALL * total(causes)):
        return f"nothing to do ({cause.because})"
    return f"{cause.command}: {cause.because}"


def _rss(effects: Sequence[Floats], count: int) -> Floats:
    return np.asarray(np.sqrt(np.sum(np.square(np.reshape(effects, (-1, count))), axis=0)))


def _made(description: RigDescription, kind: str) -> str:
    """The file of a kind that the rig is used with; "" without one."""
    return next((known.file for known in description.calibration.known if known.kind == kind), "")


def _noise(description: RigDescription, poses: Sequence[Pose], reference: Pose) -> Floats:
    def variance(pose: Pose, albedo: float, frames: int) -> float:
        pixels = exposure.expected_pixels(description, pose)
        return 1.0 / exposure.expected_weight(description, pose, pixels, albedo, frames)

    white = variance(reference, 1.0, description.reference.frames)
    return np.sqrt([variance(pose, ALBEDO, description.acquisition.frames) + white for pose in poses])


def _turned(description: RigDescription, poses: Sequence[Pose], reference: Pose, axis: str, u: float) -> Floats:
    """Relative change of values when an axis stands u [rad] off: of the light at a point, less that at the white."""
    which = "theta_i" if filling(description) == "over" else "theta_r"

    def light(pose: Pose) -> float:
        moved = [replace(pose, **{axis: getattr(pose, axis) + by}) for by in (u, 0.0, -u)]
        up, here, down = (math.cos(float(getattr(kinematics.directions(description, m), which))) for m in moved)
        return 0.5 * (up - down) / here

    return np.array([light(pose) for pose in poses]) - light(reference)


def _zeros(description: RigDescription, poses: Sequence[Pose], reference: Pose) -> Expected:
    """Those that no calibration of the geometry holds, with what is by eye where nothing is known."""
    known, axes = parameters(description), angle_axes(description)
    u = {
        name: zero_u_deg(description, [name])[name] if axis.zero_offset_known else max(axis.zero_u_deg, BY_EYE_DEG)
        for name, axis in axes.items() if zero_keys(description)[name] not in known
    }  # fmt: skip
    unknown = [name for name, axis in axes.items() if not axis.zero_offset_known]
    effects = [_turned(description, poses, reference, name, math.radians(one)) for name, one in u.items()]
    if not u:
        return Expected("zeros of the axes", np.zeros(len(poses)), because=_made(description, "geometry"))
    said = f"{', '.join(unknown)} by eye, {BY_EYE_DEG:g} deg" if unknown else "the rig file's zero_u_deg"
    return Expected("zeros of the axes", _rss(effects, len(poses)), "gonio rig align", said, not unknown)


def _geometry(description: RigDescription, poses: Sequence[Pose], reference: Pose) -> Expected:
    """All but the zeros: tilts, offsets, encoders, distances."""
    if parameters(description):
        u_rel = _rss(list(_of_light(GeometryErrors(description), poses, reference).T), len(poses))
        return Expected("geometry", u_rel, because=_made(description, "geometry"))
    sought = [u for u in unknowns(description, []) if not u.path.endswith(("zero_offset_deg", "backlash_deg"))]
    effects = _of_unknowns(description, sought, poses, reference)
    u_rel = _rss(list(effects.T), len(poses))
    most = sought[int(np.argmax(np.abs(effects[int(np.argmax(u_rel))])))].words
    return Expected("geometry", u_rel, "gonio calibrate geometry", f"mostly {most}", held=False)


def _of_light(errors: GeometryErrors, poses: Sequence[Pose], reference: Pose) -> Floats:
    """Relative change of values by each cause, (poses, causes): of the light at a point, less that at the white."""

    def light(pose: Pose, target: Target) -> Floats:
        seen = errors.at(pose, target).relative_light
        return np.asarray(0.5 * (seen[:, 0] - seen[:, 1]))

    return np.array([light(pose, "sample") for pose in poses]) - light(reference, "reference")


def _of_unknowns(
    description: RigDescription, sought: Sequence[Unknown], poses: Sequence[Pose], reference: Pose
) -> Floats:
    """The same of numbers that nobody has measured, shape (poses, unknowns): each by what is usual of it."""
    axes = {path: description.axes()[name] for name, path in zero_keys(description).items()}
    u = [
        CAREFUL * each.within if (axis := axes.get(each.path)) is None
        else max(axis.zero_u_deg, 0.0 if axis.zero_offset_known else BY_EYE_DEG, TINY)
        for each in sought
    ]  # fmt: skip
    usual = Calibrated(
        parameters=[each.path for each in sought], u=u, correlation=np.eye(len(sought)).tolist(), kind="geometry",
        file="", sha256="", made=datetime.date.today(),
    )  # fmt: skip
    tables = start_of(description)
    for axis in (*filter(None, tables["arms"].values()), tables["holder"]):
        axis["zero_offset_known"] = True  # or nothing is taken out, and no reading would change
    rig = parse(RigDescription, tables, "rig file")
    use = CalibrationUse(known=(usual,))  # of a unit matrix each independent cause is one of its numbers
    return _of_light(GeometryErrors(rig.model_copy(update={"calibration": use})), poses, reference)


def what_stays_open(description: RigDescription, sought: Sequence[Unknown]) -> list[str]:
    """What numbers of the geometry that stay unknown do to a matt sample at theta_i = 60 deg, the strongest first."""
    sought = [u for u in sought if u.path != INK and not u.path.endswith("backlash_deg")]
    if not sought or description.reference.how == "beam":
        return []
    pose, reference = Pose(light=math.radians(60.0), camera=-math.radians(45.0)), reference_pose(description)
    effects = np.abs(_of_unknowns(description, sought, [pose], reference)[0])
    rest = math.hypot(description.reference.u_rel, float(_noise(description, [pose], reference)[0]))
    order = np.argsort(-effects).tolist()
    small = [k for k in order if float(np.sum(effects[order[order.index(k) :]] ** 2)) < (SMALL * rest) ** 2]
    said = [f"{sought[k].words} {100.0 * effects[k]:.2g} %" for k in order if k not in small]
    out = [f"open, and felt at theta_i = 60 deg of a matt sample: {', '.join(said)}"] if said else []
    if small:
        named = ", ".join(sought[k].words for k in small[:NAMED])
        named += f" and {len(small) - NAMED} more" if len(small) > NAMED else ""
        together = 100.0 * float(np.sqrt(np.sum(effects[small] ** 2)))
        out.append(
            f"open, and nothing to do: {named}; together {together:.2f} % there, "
            f"beside {100.0 * rest:.2g} % of the white and the noise"
        )
    return out


def _camera(description: RigDescription, poses: Sequence[Pose], reference: Pose) -> Expected:
    """Linearity and stray light: at the levels, and with the surroundings, of the point against those of the white."""
    camera, known = description.camera, known_parameters(description)

    def level(pose: Pose, albedo: float) -> float:
        exposure_s = exposure.expected_exposure_s(description, pose, albedo)
        charge = camera.responsivity_e_per_s * albedo * exposure.cosine_of_incidence(pose) * exposure_s
        return charge / camera.electrons_per_dn / camera.white_level_dn

    def around(pose: Pose, albedo: float, diameter_mm: float) -> float:
        """Mean of the frame over the patch."""
        seen = kinematics.view(description, pose)
        side = pixel_on_sample_mm(description, seen)
        slant = abs(float(seen.camera_mm[2])) / math.hypot(*seen.camera_mm)
        part = min(0.25 * math.pi * diameter_mm**2 * slant / (camera.width * camera.height * side**2), 1.0)
        return part + (1.0 - part) * description.holder.holder_albedo / albedo

    white, count = description.reference, max(len(camera.nonlinearity), 1)
    at_white = level(reference, 1.0), around(reference, 1.0, white.diameter_mm)
    bends = np.array([[level(p, ALBEDO) ** (k + 1) - at_white[0] ** (k + 1) for k in range(count)] for p in poses])
    strays = np.array([around(p, ALBEDO, description.holder.sample_diameter_mm) for p in poses]) - at_white[1]
    bent = covariance_of(description, [f"camera.nonlinearity[{k}]" for k in range(count)])
    stray = float(covariance_of(description, ["camera.stray_light"])[0, 0])
    told = "camera.nonlinearity[0]" in known, "camera.stray_light" in known
    bent, stray = bent if told[0] else np.diag([BENT**2] + [0.0] * (count - 1)), stray if told[1] else STRAY**2
    u_rel = np.sqrt(np.einsum("pk,kl,pl->p", bends, bent, bends) + stray * strays**2)
    if camera.bits == 8 and not camera.response:
        u_rel = np.full(len(poses), math.nan)
        return Expected(
            "camera", u_rel, "gonio calibrate camera --response", "until then its gamma bends values", held=False
        )
    if camera.response and not told[1]:
        said = ": ".join((_made(description, "camera") or "camera.response", "nothing tells the stray light of 8 bits"))
        return Expected("camera", u_rel, because=said)
    left = " and ".join(name for name, there in zip(("linearity", "stray light"), told, strict=True) if not there)
    return Expected(
        "camera", u_rel, "gonio calibrate camera" if left else "", left or _made(description, "camera"), not left
    )


def _light(
    description: RigDescription, poses: Sequence[Pose], reference: Pose, band: Band, between_s: float
) -> Expected:
    """The beam's profile over the patch, and a lamp that warms up between two visits to the white."""
    lamp, file = description.lamp, _made(description, "light")
    covariance = covariance_of(description, BEAM) if file else SHAPE
    at_white = monomials(description, reference, "reference", band)
    gradients = np.array([monomials(description, pose, "sample", band) for pose in poses]) - at_white
    loss, time_s = (lamp.warm_up_loss, lamp.warm_up_time_constant_s) if file else (WARM_UP, WARMS_S)
    bends = 0.5 * loss * math.exp(-lamp.warm_up_s / time_s) * -math.expm1(-between_s / time_s)
    u_rel = np.sqrt(np.einsum("pk,kl,pl->p", gradients, covariance, gradients) + bends**2)
    if file:
        return Expected("light", u_rel, because=file)
    warms = bends > 0.5 * float(np.median(u_rel))
    most = f"mostly the lamp's warm-up after lamp.warm_up_s = {lamp.warm_up_s:g}" if warms else "the beam's shape"
    return Expected("light", u_rel, "gonio calibrate light", most, held=False)
