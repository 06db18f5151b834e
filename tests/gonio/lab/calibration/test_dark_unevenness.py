"""The unevenness of dark frames against the truth, where the frames' own noise is larger than it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from gonio.lab.calibration.camera_frames import CameraFrame, Passes
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Camera, Lamp

SHAPE = 48, 64
EXPOSURES_S = (0.001, 15.0, 30.0, 60.0)
FRAMES = 8
"""At each exposure, as a scan takes them."""


@dataclass(frozen=True)
class Dark(CameraFrame):
    """A frame that no file holds."""

    image: npt.NDArray[np.uint16] | None = None

    def read(self, camera: Camera) -> npt.NDArray[np.uint16]:
        """Its values [DN]."""
        assert self.image is not None
        return self.image


def darks(dsnu_dn: float, read_noise_dn: float, dark_dn_per_s: float, seed: int) -> list[Dark]:
    """Frames of 1 e-/DN."""
    rng = np.random.default_rng(seed)
    level = 100.0 + dsnu_dn * rng.standard_normal(SHAPE)
    out = []
    for t in EXPOSURES_S:
        for _ in range(FRAMES):
            charge = rng.poisson(dark_dn_per_s * t, SHAPE)
            image = np.round(level + charge + read_noise_dn * rng.standard_normal(SHAPE))
            out.append(Dark(Path("dark"), "dark", t, image=image.astype(np.uint16)))
    return out


@pytest.mark.parametrize(
    ("dsnu_dn", "read_noise_dn", "dark_dn_per_s"), [(0.5, 6.0, 5.0), (0.6, 2.5, 17.0), (4.0, 2.0, 5.0)]
)
def test_its_uncertainty_holds_below_the_noise_of_the_frames(
    rig_description: RigDescription, dsnu_dn: float, read_noise_dn: float, dark_dn_per_s: float
) -> None:
    pulls = []
    for seed in range(60):
        work = Passes(darks(dsnu_dn, read_noise_dn, dark_dn_per_s, seed), rig_description, "mono")
        work.darks()
        uneven, u, _ = work.uneven_darks()
        pulls.append((uneven.total - dsnu_dn) / u)
    # of 60 numbers a standard deviation is known to 9 %, and a mean to 0.13: three of them
    assert 0.7 < np.std(pulls) < 1.3
    assert abs(np.mean(pulls)) < 0.4


@pytest.fixture
def rig_description() -> RigDescription:
    from gonio.lab.acquisition.measure import find_rig

    known = find_rig("sim").description
    camera = known.camera.model_copy(update={"height": SHAPE[0], "width": SHAPE[1]})
    return known.model_copy(update={"camera": camera, "lamp": Lamp()})
