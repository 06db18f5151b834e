"""Scans on a bench of numbers: arms land where they are sent, and frames are as bright as the lamp looks there."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gonio.by_hand.alignment_scans import DIMMED, LONGEST_S, Scans
from gonio.rig import Frame, Pose
from gonio.rig.description import RigDescription
from tests.gonio.numpy_rig import describe

SUM_DEG = 2.3
"""Of both angles as they are read, where the lamp is seen in a mirror."""


@dataclass
class Bench:
    """What `Scans` asks of a rig that is moved by hand."""

    description: RigDescription
    fwhm_deg: float = 1.4
    level_per_s: float = 50.0
    at: Pose = field(default_factory=Pose)
    dimmed: float = 1.0
    light = SimpleNamespace(dim=None)

    @property
    def camera(self) -> Bench:
        return self

    def lamp(self, level: float | bool) -> None:
        self.dimmed = float(level)

    def pose(self) -> Pose:
        return self.at

    def move(self, **goals: float) -> Any:
        self.at = replace(self.at, **goals)
        return SimpleNamespace(landed=goals)

    def capture(self, exposure_s: float) -> Frame:
        camera, off_deg = self.description.camera, math.degrees(self.at.camera + self.at.light) - SUM_DEG
        width = self.fwhm_deg / 2.0 / math.log(2.0) ** (1 / 3)
        level = exposure_s * self.dimmed * self.level_per_s * math.exp(-(abs(off_deg / width) ** 3))
        full = camera.saturation_e / camera.electrons_per_dn
        dn = np.full((camera.height, camera.width), camera.black_level_dn + min(level, 1.0) * full)
        return Frame(
            np.rint(dn).astype(np.uint16), exposure_s, camera.black_level_dn, camera.white_level_dn, time_s=0.0
        )


def scans(bench: Bench) -> Scans:
    return Scans(bench, search_deg=8.0, say=lambda text: None)  # type: ignore[arg-type]


@pytest.mark.parametrize("fwhm_deg", np.geomspace(0.4, 4.0, 6))
@pytest.mark.parametrize("beside", [0.0, 0.5, -0.8])
def test_a_scan_that_is_kept_holds_the_spot_whole_and_in_its_middle(fwhm_deg: float, beside: float) -> None:
    bench = Bench(describe(), fwhm_deg)
    work = scans(bench)
    work._half["camera"] = 1.5
    bench.move(light=math.radians(30.0), camera=math.radians(SUM_DEG - 30.0))
    work._meter()
    bench.move(camera=math.radians(SUM_DEG - 30.0 + beside))
    found = work._fine("mirror", "camera")
    assert found.centre == pytest.approx(SUM_DEG - 30.0, abs=0.01 * fwhm_deg)
    x, y = work.table["camera_encoder_deg"].to_numpy(), work.table["signal"].to_numpy()
    half = (x[-1] - x[0]) / 2
    assert max(y[0], y[-1]) < 0.11 * y.max()  # a tenth of a fitted height
    assert abs(found.centre - (x[0] + x[-1]) / 2) < 0.41 * half
    assert fwhm_deg > 0.34 * half, "at least five of fifteen points in its upper half"


@pytest.mark.parametrize("level_per_s", [1e-2, 0.3, 1.0, 30.0, 1e3, 6e3])
@pytest.mark.parametrize("begin_s", [0.0, 0.01, 1.0])
def test_metering_ends_between_a_quarter_and_what_is_aimed_at(level_per_s: float, begin_s: float) -> None:
    """Or with the longest exposure, or with the shortest and a lamp that is dimmed until it does not saturate."""
    bench = Bench(describe(), level_per_s=level_per_s)
    bench.move(camera=math.radians(SUM_DEG))
    work, target = scans(bench), bench.description.acquisition.exposure_target
    work._exposure_s = begin_s
    work._meter()
    level = work._exposure_s * bench.dimmed * level_per_s
    assert bench.dimmed in (1.0, *DIMMED)
    if level_per_s * LONGEST_S < 0.25:
        assert work._exposure_s == LONGEST_S
    else:
        assert 0.24 < level < 1.02 * target
    assert (bench.dimmed < 1.0) == (level_per_s * bench.description.camera.exposure_limits_s[0] >= 0.9)
