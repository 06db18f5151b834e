"""A quick look at a made camera that is what its rig file says, or is not in one number."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from gonio.calibration.camera_check import contradictions
from gonio.rig import Frame
from gonio.rig.description import RigDescription
from gonio.rig.light_and_camera import Camera
from tests.gonio.numpy_rig import describe

FILED = Camera(
    width=96, height=72, photon_noise=True, read_noise_e=6.0, electrons_per_dn=3.0, black_level_dn=64.0,
    full_well_e=9000.0, exposure_limits_s=(1e-3, 10.0),
)  # fmt: skip


@dataclass
class Looked:
    """What the look asks of a rig; light falls evenly, and the lamp flickers by two per cent."""

    true: Camera
    rate_e_per_s: float
    description: RigDescription = field(default_factory=lambda: describe(camera=FILED))
    lit: bool = True
    frame: int = 0

    @property
    def camera(self) -> Looked:
        return self

    def lamp(self, on: bool) -> None:
        self.lit = on

    def move(self, **goals: float) -> None:
        assert all(abs(angle) <= math.pi / 2 for angle in goals.values())

    def capture(self, exposure_s: float) -> Frame:
        self.frame += 1
        rng, camera = np.random.default_rng(self.frame), self.true
        rate = self.rate_e_per_s * rng.normal(1.0, 0.02) * self.lit + camera.dark_current_e_per_s
        charge = rng.poisson(rate * exposure_s, (72, 96)).clip(max=camera.full_well_e) + rng.normal(0, 6.0, (72, 96))
        dn = np.rint(charge / camera.electrons_per_dn + camera.black_level_dn).clip(0, 4095)
        return Frame(dn.astype(np.uint16), exposure_s, FILED.black_level_dn, FILED.white_level_dn, time_s=0.0)


@pytest.mark.parametrize("rate_e_per_s", [2e3, 2e4, 3e5])
@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({}, ()),
        # a nonlinearity that nobody has taken out yet may be 3 %, and the look itself is good to 1 %
        ({"electrons_per_dn": 3.05}, ()),
        ({"electrons_per_dn": 3.6}, ("a DN is 3.6", "clips at 2564 DN (where the rig file leads to expect 3064)")),
        ({"electrons_per_dn": 2.5}, ("a DN is 2.5",)),
        ({"black_level_dn": 65.0}, ()),
        ({"black_level_dn": 68.0}, ("dark frames read 68.",)),
        ({"dark_current_e_per_s": 200.0}, ()),
        ({"full_well_e": 8900.0}, ()),
        ({"full_well_e": 6600.0}, ("charge clips at 2264 DN (where the rig file leads to expect 3064)",)),
    ],
)
def test_what_contradicts_the_rig_file_is_said_and_nothing_else(
    wrong: dict[str, Any], said: tuple[str, ...], rate_e_per_s: float
) -> None:
    found = contradictions(Looked(FILED.model_copy(update=wrong), rate_e_per_s))  # type: ignore[arg-type]
    assert found.count(" (") == len(said), found
    assert all(each in found for each in said), found


def test_too_little_light_says_nothing() -> None:
    assert contradictions(Looked(FILED.model_copy(update={"electrons_per_dn": 9.0}), 20.0)) == ""  # type: ignore[arg-type]
