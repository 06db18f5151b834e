"""Frames whose contents are known: a scene of photo-electrons through a sensor of numpy."""

import numpy as np
import numpy.typing as npt

from gonio.lab.rig import Frame
from gonio.lab.rig.light_and_camera import Camera

HEIGHT, WIDTH = 240, 320
READ_E = 5.0


def camera(pattern: str = "mono", **changes: object) -> Camera:
    """A camera of 12 bits with 4095 - 64 DN of 3 electrons."""
    numbers = {
        "width": WIDTH, "height": HEIGHT, "pattern": pattern, "photon_noise": True, "read_noise_e": READ_E,
        "full_well_e": 13_000.0, "electrons_per_dn": 3.0, "black_level_dn": 64.0,
    }  # fmt: skip
    return Camera.model_validate(numbers | changes)


def expose(
    of: Camera,
    scene: npt.NDArray[np.float64],
    seed: int,
    exposure_s: float = 1.0,
    gain: npt.NDArray[np.float64] | float = 1.0,
) -> Frame:
    """A frame of a scene [e-/s]; `gain`: of each pixel."""
    rng = np.random.default_rng(seed)
    charge = rng.poisson(scene * exposure_s * gain).clip(max=of.full_well_e) + of.read_noise_e * rng.standard_normal(
        scene.shape
    )
    dn = np.clip(np.rint(charge / of.electrons_per_dn + of.black_level_dn), 0, of.white_level_dn)
    return Frame(dn.astype(np.uint16), exposure_s, of.black_level_dn, of.white_level_dn, of.pattern, time_s=float(seed))


def texture(blur_px: float, level: float = 3000.0) -> npt.NDArray[np.float64]:
    """A rough surface, seen through a lens that blurs it by a Gaussian of this standard deviation [e-/s]."""
    import cv2

    rough = cv2.GaussianBlur(np.random.default_rng(7).random((HEIGHT, WIDTH)), (0, 0), 1.0)
    rough = 1.0 + 0.15 * (rough - rough.mean()) / rough.std()
    out: npt.NDArray[np.float64] = level * np.clip(cv2.GaussianBlur(rough, (0, 0), blur_px) if blur_px else rough, 0, 2)
    return out


def ellipse(
    column: float, row: float, a: float, b: float, angle: float, *, peak: float = 6000.0, soft: bool = False
) -> npt.NDArray[np.float64]:
    """A spot with half-axes a and b [pixels] at half of its height, integrated over each pixel [e-/s]."""
    fine = 4
    rows, cols = np.mgrid[: HEIGHT * fine, : WIDTH * fine]
    y, x = (rows + 0.5) / fine - 0.5 - row, (cols + 0.5) / fine - 0.5 - column
    c, s = np.cos(angle), np.sin(angle)
    squared = ((x * c + y * s) / a) ** 2 + ((-x * s + y * c) / b) ** 2
    light = np.exp(-squared * np.log(2.0)) if soft else (squared < 1.0).astype(float)
    out: npt.NDArray[np.float64] = peak * light.reshape(HEIGHT, fine, WIDTH, fine).mean((1, 3))
    return out
