"""A rig with errors of alignment written down plainly: rotation matrices of SciPy, one body after the other.

It shares nothing with `gonio.lab.rig.kinematics` but the meaning of the keys.
"""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gonio.lab.rig import Pose
from gonio.lab.rig.description import ArmAxis, RigDescription
from gonio.typing import Floats


def turn(axes: str, *angles_deg: float) -> Any:
    """The product of rotations about axes, the last one acting first: `turn("xz", a, b)` is Rx(a) Rz(b)."""
    return Rotation.from_euler(axes.upper(), angles_deg, degrees=True)  # capital letters: about the turned axes


def rotation(axis: str, angle: Floats | float) -> Floats:
    """The matrix of a right-handed rotation about x, y or z [rad]; of n angles shape (n, 3, 3)."""
    return np.asarray(Rotation.from_rotvec(np.multiply.outer(angle, np.eye(3)["xyz".index(axis)])).as_matrix())


def true_deg(axis: ArmAxis, read_deg: float) -> float:
    """The angle of an arm whose encoder reads an angle."""
    error = 0.0
    for order, cosine, sine in axis.harmonics_deg:
        error += cosine * np.cos(np.radians(order * read_deg)) + sine * np.sin(np.radians(order * read_deg))
    return read_deg - error


def place(rig: RigDescription, pose: Pose) -> dict[str, Floats]:
    """Lamp, lens [mm], image_x, image_y and optical axis in the frame of the sample."""
    light, camera, azimuth = rig.arms.light, rig.arms.camera, rig.arms.azimuth
    read = {name: float(np.degrees(getattr(pose, name))) for name in ("light", "camera", "tilt", "spin", "azimuth")}
    # the arms
    stands = turn("xz", *light.axis_tilt_deg) * turn("yx", true_deg(light, read["light"]), -light.elevation_deg)
    lamp = stands.apply([0.0, 0.0, rig.geometry.light_distance_mm])
    lamp[[0, 2]] += light.axis_offset_mm
    stands = turn("xz", *camera.axis_tilt_deg) * turn("yx", true_deg(camera, read["camera"]), -camera.elevation_deg)
    lens = stands.apply([0.0, 0.0, rig.geometry.camera_distance_mm])
    lens[[0, 2]] += camera.axis_offset_mm
    # the camera looks down its arm: half a turn about y, and its own errors
    looks = stands * turn("y", 180.0) * turn("yxz", rig.camera.pointing_deg[0], -rig.camera.pointing_deg[1],
                                             rig.camera.roll_deg)  # fmt: skip
    if azimuth is not None:
        about = turn("xy", *azimuth.axis_tilt_deg)
        swing = about * turn("z", true_deg(azimuth, read["azimuth"])) * about.inv()
        foot = np.array([*azimuth.axis_offset_mm, 0.0])
        lens, looks = foot + swing.apply(lens - foot), swing * looks
    # the holder carries the sample; each step takes a point of the lab one body further in
    holder = rig.holder

    def inward(vector: Floats, where: float) -> Floats:
        """A place (`where` = 1) or a direction (0) of the lab, in the frame of the sample."""
        beside = where * np.array([0.0, holder.tilt_axis_offset_mm, 0.0])
        out = turn("x", -read["tilt"]).inv().apply(vector - beside) + beside
        out = turn("y", holder.spin_axis_tilt_deg).inv().apply(out)
        out = turn("z", read["spin"]).inv().apply(out)
        out = turn("xy", *holder.surface_tilt_deg).inv().apply(out)
        return np.asarray(out - where * np.array([*holder.sample_offset_mm, holder.surface_offset_mm]))

    x, y, z = looks.as_matrix().T
    return {"lamp": inward(lamp, 1), "lens": inward(lens, 1), "image_x": inward(x, 0), "image_y": inward(y, 0),
            "sight": inward(z, 0)}  # fmt: skip


def imaged(rig: RigDescription, seen: dict[str, Floats], point: Floats) -> tuple[float, float]:
    """Column and row on which a pinhole without distortion images a place in the frame of the sample."""
    ray = point - seen["lens"]
    focal, distance = rig.camera.focal_length_mm, rig.geometry.camera_distance_mm
    pixels = (1.0 / (1.0 / focal - 1.0 / distance)) / (1e-3 * rig.camera.pixel_um)
    depth = ray @ seen["sight"]
    return (
        float((rig.camera.width - 1) / 2 + rig.camera.principal_point_px[0] + pixels * (ray @ seen["image_x"]) / depth),
        float(
            (rig.camera.height - 1) / 2 + rig.camera.principal_point_px[1] + pixels * (ray @ seen["image_y"]) / depth
        ),
    )
