"""What every rig has to do, whoever wrote it (docs/writing_a_driver.md): `python -m pytest tests/contracts --rig R`."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gonio.errors import ConfigError, DeviceError
from gonio.rig import Frame, Pose, Rig, Step
from tests.contracts.conftest import Case

LANDED_DEG = 0.5
"""A landing as far off as this is another direction; drivers state tighter tolerances of their own."""
STANDS_DEG = 0.2
"""Between two readings at rest: two encoder steps of the coarsest common encoder (4096 a turn)."""
AS_ASKED = 0.05
"""What an exposure may differ from what was asked; the reduction uses what the frame says."""


class Stopped(Exception):
    """Something goes wrong while the rig is open."""


def home(case: Case) -> Pose:
    """A pose inside all limits, from which every axis can go a little both ways."""
    middle = {name: (low + high) / 2 for name, (low, high) in case.description.limits_deg().items()}
    apart = {"light": -20.0, "camera": 25.0}
    return Pose(**{name: math.radians(apart.get(name, deg)) for name, deg in middle.items()})


def exposure_s(case: Case) -> float:
    """Short, but inside the limits."""
    low, high = case.description.camera.exposure_limits_s
    return min(max(low, 0.05), high)


def start(rig: Rig, case: Case, index: int = 0) -> Pose:
    goal = home(case)
    rig.begin(Step(index=index, kind="point", point=0, pose=goal))
    rig.present("sample")
    rig.light.select(case.description.bands.all()[0])
    return rig.arms.move(goal)


def level(frame: Frame) -> float:
    return float(np.mean(frame.mosaic)) - frame.black_level_dn


def off_deg(a: Pose, b: Pose, case: Case) -> float:
    return max(abs(math.degrees(getattr(a, name) - getattr(b, name))) for name in case.description.axes())


# ---- lamp ----


def test_a_rig_is_dark_when_it_is_built_when_it_is_entered_and_when_it_is_left(case: Case) -> None:
    rig = case.build()
    with rig:
        if case.shines:
            assert not case.shines()
        start(rig, case)
        rig.light.on()
        if case.shines:
            assert case.shines()
    if case.shines:
        assert not case.shines()


@pytest.mark.parametrize("error", [Stopped, KeyboardInterrupt, DeviceError])
def test_a_rig_is_left_dark_whatever_ends_it(case: Case, error: type[BaseException]) -> None:

    def fail() -> None:
        with case.build() as rig:
            start(rig, case)
            rig.light.on()
            raise error("of the test")

    with pytest.raises(error, match="of the test"):
        fail()
    if case.shines:
        assert not case.shines()


def test_the_camera_sees_the_lamp_go_on_and_off(case: Case) -> None:
    with case.build() as rig:
        start(rig, case)
        dark = level(rig.camera.capture(exposure_s(case)))
        rig.light.on()
        lit = level(rig.camera.capture(exposure_s(case)))
        rig.light.off()
        again = level(rig.camera.capture(exposure_s(case)))
    assert lit > dark + 5, "the lamp adds less than 5 DN: longer exposures, or no light"
    assert abs(again - dark) < 0.1 * (lit - dark)


def test_every_band_can_be_selected(case: Case) -> None:
    bands = case.description.bands.all()
    with case.build() as rig:
        start(rig, case)
        for band in {bands[0], bands[len(bands) // 2], bands[-1]}:
            rig.light.select(band)


# ---- arms ----


def test_a_move_lands_inside_the_limits_and_read_says_where_it_stands(case: Case) -> None:
    with case.build() as rig:
        landed = start(rig, case)
        assert off_deg(landed, home(case), case) <= LANDED_DEG
        assert off_deg(rig.arms.read(), landed, case) <= STANDS_DEG


def test_a_landing_from_above_is_the_same_as_one_from_below(case: Case) -> None:
    """Every axis arrives from below, so that play in a gear is on the same side each time."""
    axes = case.description.axes()
    with case.build() as rig:
        goal = home(case)
        start(rig, case)
        landings = []
        for way in (-3.0, 3.0):
            rig.arms.move(replace(goal, **{name: getattr(goal, name) + math.radians(way) for name in movable(case)}))
            landings.append(rig.arms.move(goal))
    assert set(movable(case)) <= set(axes)
    assert off_deg(landings[0], landings[1], case) <= STANDS_DEG


def movable(case: Case) -> list[str]:
    """Axes that may go three degrees either way from home."""
    goal = home(case)
    limits = case.description.limits_deg()
    return [n for n, (low, high) in limits.items() if low + 3 <= math.degrees(getattr(goal, n)) <= high - 3]


def test_a_goal_outside_a_limit_is_refused_and_nothing_turns(case: Case) -> None:
    with case.build() as rig:
        before = start(rig, case)
        for name, (low, high) in case.description.limits_deg().items():
            for beyond in (low - 1.0, high + 1.0):
                with pytest.raises(ConfigError, match=name):
                    rig.arms.move(replace(home(case), **{name: math.radians(beyond)}))
        assert off_deg(rig.arms.read(), before, case) <= STANDS_DEG


def test_stop_never_raises_and_the_arms_go_on_after_it(case: Case) -> None:
    with case.build() as rig:
        rig.arms.stop()
        goal = start(rig, case)
        rig.arms.stop()
        rig.arms.stop()
        assert off_deg(rig.arms.move(home(case)), goal, case) <= STANDS_DEG
    rig.arms.stop()  # and after the rig was left


def test_park_ends_inside_the_limits(case: Case) -> None:
    with case.build() as rig:
        start(rig, case)
        rig.arms.park()
        parked = rig.arms.read()
    for name, (low, high) in case.description.limits_deg().items():
        assert low - LANDED_DEG <= math.degrees(getattr(parked, name)) <= high + LANDED_DEG


# ---- camera ----


def test_a_frame_is_what_the_rig_file_describes(case: Case) -> None:
    camera = case.description.camera
    with case.build() as rig:
        start(rig, case)
        frame = rig.camera.capture(exposure_s(case))
    assert frame.mosaic.shape == (camera.height, camera.width)
    assert frame.mosaic.dtype == np.uint16
    assert frame.pattern == camera.pattern
    assert 0 <= frame.black_level_dn < frame.white_level_dn
    assert frame.mosaic.max() <= frame.white_level_dn
    assert frame.exposure_s == pytest.approx(exposure_s(case), rel=AS_ASKED)


def test_frames_begin_after_the_call_and_their_times_grow(case: Case) -> None:
    with case.build() as rig:
        start(rig, case)
        times = [rig.time_s()]
        for _ in range(3):
            asked = rig.time_s()
            frame = rig.camera.capture(exposure_s(case))
            assert frame.time_s >= asked
            assert frame.time_s > times[-1] or len(times) == 1
            times.append(frame.time_s)
        assert times[0] >= 0
        assert rig.time_s() >= times[-1]


@pytest.mark.parametrize("end", [0, 1])
def test_an_exposure_outside_the_limits_is_refused(case: Case, end: int) -> None:
    beyond = case.description.camera.exposure_limits_s[end] * (0.5, 2.0)[end]
    with case.build() as rig:
        start(rig, case)
        with pytest.raises(ConfigError, match="exposure"):
            rig.camera.capture(beyond)


# ---- steps ----


def test_sample_and_reference_are_presented_in_turn(case: Case) -> None:
    with case.build() as rig:
        start(rig, case)
        for target in ("reference", "reference", "sample"):
            rig.present(target)


def test_what_is_repeatable_gives_the_same_step_again(case: Case) -> None:
    """Whatever was done before, in another sitting too; other rigs must not promise it."""

    def taken(*indices: int) -> Frame:
        with case.build() as rig:
            for index in indices:
                start(rig, case, index)
                rig.light.on()
                frame = rig.camera.capture(exposure_s(case))
        return frame

    if not case.build().repeatable:
        pytest.skip("it is no simulation: it promises nothing")
    alone, after = taken(7), taken(2, 7)
    np.testing.assert_array_equal(alone.mosaic, after.mosaic)
    assert alone.time_s == after.time_s


def test_a_rig_can_be_built_and_thrown_away(case: Case) -> None:
    """`--dry-run` and `gonio rig list` do: no device is touched before a rig is entered."""
    for _ in range(2):
        assert case.build().description == case.description
    with case.build() as rig:  # nothing is held by those that were thrown away
        assert rig.time_s() >= 0
