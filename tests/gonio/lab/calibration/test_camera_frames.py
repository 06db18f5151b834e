"""Frames of a made sensor: flats too dim, the parts of the picture, pairs of a lamp that flickers, what all tell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from gonio.errors import DataError
from gonio.lab.calibration.camera import calibrate
from gonio.lab.calibration.camera_frames import Passes
from gonio.lab.calibration.camera_scan import contradictions
from gonio.lab.rig import Frame
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Camera, Lamp
from tests.gonio.lab.calibration.test_dark_unevenness import SHAPE, Dark
from tests.gonio.numpy_rig import describe

BLACK_DN, DARK_DN_PER_S, READ_DN, E_PER_DN = 100.0, 30.0, 3.0, 3.0
RANGE_DN = 4095.0 - BLACK_DN
DARK_S, FRAMES = (0.1, 2.0), 4
DSNU_DN, PRNU, DOUBLING_K = 4.0, 0.02, 8.0
RELATIVE = np.where(np.arange(SHAPE[1]) < 40, 1.0, 0.3)
"""The picture: five eighths of it are white, the rest is three tenths as bright."""


def frames(
    parts: Sequence[float], second: Sequence[float] = (), temperatures_c: Sequence[float] = (20.0,), uneven: float = 0.0
) -> list[Dark]:
    """Darks, and pairs of flats that reach parts of the range, the second frame of each times a factor.

    The pixels are uneven by so many times `DSNU_DN` and `PRNU`.
    """
    rng = np.random.default_rng(3)
    level = BLACK_DN + uneven * DSNU_DN * rng.standard_normal(SHAPE)
    relative = RELATIVE * (1.0 + uneven * PRNU * rng.standard_normal(SHAPE))

    def taken(kind: Literal["dark", "flat"], t: float, signal: float, temperature_c: float = 20.0) -> Dark:
        dark = DARK_DN_PER_S * 2 ** ((temperature_c - 20.0) / DOUBLING_K)
        charge = rng.poisson(E_PER_DN * (signal * relative + dark * t), SHAPE) / E_PER_DN
        image = np.rint(level + charge + READ_DN * rng.standard_normal(SHAPE)).clip(0, 4095)
        return Dark(Path(f"{kind}-{t:g}"), kind, t, temperature_c=temperature_c, image=image.astype(np.uint16))

    out = [taken("dark", t, 0.0, celsius) for celsius in temperatures_c for t in DARK_S for _ in range(FRAMES)]
    for part, factor in zip(parts, second or [1.0] * len(parts), strict=True):
        out += [taken("flat", part, part * RANGE_DN), taken("flat", part, factor * part * RANGE_DN)]
    return out


def rig(noise: float = 0.0) -> RigDescription:
    return describe(camera=Camera(height=SHAPE[0], width=SHAPE[1]), lamp=Lamp(noise=noise))


def passed(parts: Sequence[float], second: Sequence[float] = (), noise: float = 0.0) -> Passes:
    work = Passes(frames(parts, second), rig(noise), "mono")
    work.darks()
    work.flats()
    return work


def test_a_sensor_of_known_numbers_is_found() -> None:
    parts = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.85)
    done = calibrate(frames(parts, uneven=1.0), rig())
    true = {
        "electrons_per_dn": E_PER_DN, "black_level_dn": BLACK_DN, "read_noise_e": READ_DN * E_PER_DN,
        "dark_current_e_per_s": DARK_DN_PER_S * E_PER_DN, "dsnu_e": DSNU_DN * E_PER_DN, "prnu": PRNU,
    }  # fmt: skip
    u = dict(zip(done.names, np.sqrt(np.diag(done.covariance)), strict=True))
    for name, value in true.items():
        assert done.values[name] == pytest.approx(value, abs=4 * u[name]), name  # eight numbers, a fixed seed
        assert u[name] < 0.05 * value, name
    for k, c in enumerate(done.values["nonlinearity"]):
        assert c == pytest.approx(0.0, abs=4 * u[f"nonlinearity[{k}]"])
    assert any("no flat frame saturates" in note for note in done.notes)
    # the brightest flats in electrons, over their noise, and over the electrons that the dark noise comes to
    full = parts[-1] * RANGE_DN * E_PER_DN
    least = math.hypot(READ_DN, math.sqrt(1 / 12)) * E_PER_DN + 0.5
    for name, value in (
        ("gain_dn_per_e", 1 / E_PER_DN), ("saturation_capacity_e", full), ("snr_max", math.sqrt(full)),
        ("absolute_threshold_e", least), ("dynamic_range_db", 20 * math.log10(full / least)),
        ("dsnu1288_e", DSNU_DN * E_PER_DN),
    ):  # fmt: skip
        assert done.measured[name] == pytest.approx(value, rel=0.04), name
    assert "dark_doubling_c" not in done.measured, "one temperature"


def test_dark_frames_at_two_temperatures_tell_what_doubles_the_dark_current() -> None:
    done = calibrate(frames((0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.8), temperatures_c=(16.0, 28.0)), rig())
    assert done.measured["dark_at_c"] == pytest.approx(22.0)
    # means of 12 000 pixels tell each current to a few tenths of a per cent
    assert done.measured["dark_doubling_c"] == pytest.approx(DOUBLING_K, rel=0.01)
    ratio, kelvin = 2.0 ** (12.0 / DOUBLING_K), (16.0 + 273.15, 28.0 + 273.15)
    energy = 8.617333e-5 * math.log(ratio) / (1 / kelvin[0] - 1 / kelvin[1])
    assert done.measured["dark_energy_ev"] == pytest.approx(energy, rel=0.01)


def test_flats_must_reach_a_twentieth_of_the_range_below_seven_tenths_of_the_brightest() -> None:
    passed((0.01, 0.02, 0.03, 0.04, 0.06, 0.09))
    with pytest.raises(DataError, match=r"reach 7\.. % of full scale: light the white reference more"):
        passed((0.01, 0.02, 0.03, 0.04, 0.045, 0.07))
    with pytest.raises(DataError, match="every flat frame is full"):
        passed((0.95, 0.96, 0.97, 0.98, 0.99))


def test_parts_of_the_picture_and_their_levels_are_those_that_were_put_in() -> None:
    parts = (0.05, 0.1, 0.15, 0.25, 0.4, 0.6, 0.75, 0.85)
    work = passed(parts)
    bright, dim = work.masks
    assert np.array_equal(bright, work.bright)
    # the border is blurred over a few columns, and belongs to neither
    for part, columns in ((bright, slice(0, 37)), (dim, slice(44, 64))):
        assert part[:, columns].all()
    assert not bright[:, 40:].any() | dim[:, :40].any()
    true = np.repeat(parts, 2) * RANGE_DN
    variance = true / E_PER_DN + READ_DN**2 + 1 / 12 + DARK_DN_PER_S * np.repeat(parts, 2) / E_PER_DN
    # a variance of 2000 pixels is known to 3 %, so its root to 1.6 %: four of them
    assert work.u_dn[0] == pytest.approx(np.sqrt(variance / np.count_nonzero(bright)), rel=0.07)
    # a pixel's dark level is the intercept of its line through the dark frames, a weighted sum of them
    t = np.repeat(DARK_S, FRAMES)
    weights = np.linalg.pinv(np.stack([np.ones(t.size), t], axis=1))[0]
    of_line = float(weights**2 @ (READ_DN**2 + 1 / 12 + DARK_DN_PER_S * t / E_PER_DN))
    assert work.u_dark_dn[0] ** 2 * np.count_nonzero(bright) == pytest.approx(of_line, rel=0.07)
    for mask, level, share in ((bright, work.level_dn[0], 1.0), (dim, work.level_dn[1], 0.3)):
        assert np.all(np.abs(level - share * true) < 4 * np.sqrt((variance + of_line) / np.count_nonzero(mask)))
    middle = [part for part in parts if 0.2 * 0.85 <= part <= 0.8 * 0.85 for _ in range(2)]
    assert work.map_count == len(middle)
    assert work.map_exposure == pytest.approx(float(np.mean(middle)))
    assert work.map_sum[bright].mean() == pytest.approx(sum(middle) * RANGE_DN, rel=1e-3)  # 1000 times less noise


@pytest.mark.parametrize(("noise", "kept", "dropped"), [(0.0, 1.005, 1.01), (0.01, 1.073, 1.085)])
def test_a_pair_may_differ_by_five_standard_deviations_of_the_lamp_and_half_a_per_cent(
    noise: float, kept: float, dropped: float
) -> None:
    """The lamp's two frames differ by sqrt(2) of its noise; photon noise of the means adds 0.2 % here."""
    parts = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    work = passed(parts, [1.0, 1.0, 1.0, 1.0, kept, dropped], noise)
    assert {p.exposure_s for p in work.pairs} == set(parts[:-1])
    assert np.isnan(work.level_dn[:, -2:]).all()
    assert np.isfinite(work.level_dn[:, :-2]).all()
    (note,) = work.notes
    assert f"within {100 * (5 * math.sqrt(2) * noise + 0.005):.2g} %" in note


# ---- a quick look at a made camera that is what its rig file says, or is not in one number ----


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
