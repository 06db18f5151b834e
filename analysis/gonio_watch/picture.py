"""A raw frame as a picture: grey with a soft curve, the region of interest outlined, saturated pixels painted."""

import numpy as np

from gonio.lab.acquisition.exposure import SATURATED, full_scale_dn
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.rig import Frame, kinematics, regions
from gonio.lab.rig.description import RigDescription
from gonio.typing import NDArray

WIDTH = 640
"""A picture is not much wider."""
OUTLINE, TOO_BRIGHT = (64, 200, 255), (255, 64, 48)


def levels(description: RigDescription, frame: Frame) -> NDArray[np.float32]:
    """A mosaic as levels: 0 at the black level, 1 where the sensor saturates."""
    full = full_scale_dn(description.camera, frame)
    return ((frame.mosaic.astype(np.float32) - frame.black_level_dn) / full).astype(np.float32)


def rgb(level: NDArray[np.float32]) -> tuple[NDArray[np.uint8], int]:
    """A grey picture of levels with saturated pixels painted, and by how much it is smaller.

    A picture's pixel is the brightest of those that it stands for: a small highlight must not get lost.
    """
    part = max(1, -(-level.shape[1] // WIDTH))
    rows, cols = (side // part * part for side in level.shape)
    small = level[:rows, :cols].reshape(rows // part, part, cols // part, part).max(axis=(1, 3))
    grey = np.round(255.0 * np.sqrt(np.clip(small, 0.0, 1.0))).astype(np.uint8)
    out = np.repeat(grey[:, :, None], 3, axis=2)
    out[small >= SATURATED] = TOO_BRIGHT
    return out, part


def png(description: RigDescription, frame: Frame, step: StepRecord | None = None) -> bytes:
    """A frame as a PNG, with the outline of what the step looks at."""
    import cv2

    out, part = rgb(levels(description, frame))
    if step is not None and step.kind != "dark":
        seen = kinematics.view(description, step.pose)
        straight = step.kind == "reference" and description.reference.how == "beam"
        if not straight:
            cols, rows = regions.outline(description, seen, "reference" if step.kind == "reference" else "sample")
            line = np.round(np.stack([cols, rows], axis=1) / part).astype(np.int32)
            if np.isfinite(line).all():
                cv2.polylines(out, [line.reshape(-1, 1, 2)], True, OUTLINE, 1, cv2.LINE_AA)
    done, data = cv2.imencode(".png", out[:, :, ::-1])
    assert done, "a picture of 8 bits can be written as PNG"
    return bytes(data)
