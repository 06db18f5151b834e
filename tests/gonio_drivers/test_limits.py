"""Soft limits and sides of approach: no goal that a servo is given lies beyond a limit, on the way either."""

import math

import pytest
from gonio_drivers.any_arms import AnyJoint
from gonio_drivers.arms import ServoArms
from gonio_drivers.joints import COUNTS
from gonio_sim.wire.servo import Mechanics, Servo

from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig.description import ArmAxis, Body, Geometry, Holder, RigDescription
from tests.gonio_drivers.conftest import Line
from tests.gonio_drivers.servo_arms import TOLERANCE_DEG, degrees, describe, pose, servos

COUNT_DEG = 360 / COUNTS
FENCE = Body(name="fence", on="bench", centre_mm=(0, 0, 400), size_mm=(10, 300, 200))
LIMITS = ArmAxis(limits_deg=(-80.0, 80.0), backlash_deg=0.1)


def with_body(body: Body) -> RigDescription:
    """A rig whose arms may touch something."""
    geometry = Geometry(light_distance_mm=400.0, camera_distance_mm=430.0)
    return describe(light=LIMITS, camera=LIMITS).model_copy(update={"geometry": geometry, "bodies": (body,)})


def goals_of(servo: Servo) -> list[float]:
    """Every goal that a servo is given from now on [deg]."""
    given: list[float] = []
    put = servo.registers.put

    def noted(name: str, value: int) -> None:
        if name == "Goal Position":
            given.append((value - 2048) * COUNT_DEG)
        put(name, value)

    servo.registers.put = noted  # type: ignore[method-assign]
    return given


def test_park_never_leaves_the_limits(line: Line) -> None:
    """Default park: light on its lower limit, where an approach from below would begin beyond it."""
    with ServoArms(describe(light=LIMITS, camera=LIMITS), servos(line.port)) as arms:
        given = [goals_of(line.servos[k]) for k in (1, 2)]
        arms.park()
        assert degrees(arms.read())[:2] == pytest.approx((-80, 80), abs=TOLERANCE_DEG)
    for goals in given:
        assert goals
        assert all(-80.0 <= goal <= 80.0 for goal in goals)


@pytest.mark.slow
@pytest.mark.parametrize("approach", [1.0, -1.0])
def test_corrections_for_friction_never_leave_the_limits(line: Line, approach: float) -> None:
    for servo in line.servos.values():
        servo.mechanics = Mechanics(short_counts=6)  # 0.53 deg, more than the tolerance
    axis = LIMITS.model_copy(update={"approach_deg": approach})
    with ServoArms(describe(light=axis, camera=axis), servos(line.port)) as arms:
        given = [goals_of(line.servos[k]) for k in (1, 2)]
        for target in (-80.0, 80.0, -79.8, 79.7, 0.0):
            read = degrees(arms.move(pose(target, target)))
            assert read[:2] == pytest.approx((target, target), abs=TOLERANCE_DEG)
            assert max(map(abs, read[:2])) <= 80.0 + 1.5 * COUNT_DEG  # the shaft itself, within a landing
    # a goal is beyond a limit by the friction alone, which was seen before
    assert all(abs(goal) <= 80.0 + 7.5 * COUNT_DEG for goals in given for goal in goals)


def test_an_axis_arrives_from_its_configured_side(line: Line) -> None:
    above = LIMITS.model_copy(update={"approach_deg": -2.0})
    holder = Holder(axes=("tilt",), tilt_approach_deg=-0.5)
    with ServoArms(describe(light=above, camera=LIMITS, holder=holder), servos(line.port)) as arms:
        for before in (-20.0, 60.0):
            arms.move(pose(before, before, before))
            light, camera, tilt = (goals_of(line.servos[k]) for k in (1, 2, 3))
            arms.move(pose(10.0, 10.0, 10.0))
            assert max(light) == pytest.approx(12.0 if before < 0 else 10.0, abs=2 * COUNT_DEG)
            assert min(camera) == pytest.approx(10.0 if before < 0 else 9.0, abs=2 * COUNT_DEG)
            assert max(tilt) == pytest.approx(10.5 if before < 0 else 10.0, abs=2 * COUNT_DEG)


class Joint(AnyJoint):
    """An axis that nothing turns, with a quarter of a degree of way to any goal."""

    key, park_deg = "devices.none.axes.light", None

    def run_up_deg(self, goal_deg: float) -> float:
        return 0.25


@pytest.mark.parametrize(
    ("backlash_deg", "approach_deg", "rounding_deg", "told"),
    [(0.24, 2.0, 0.0, False), (0.26, 2.0, 0.0, True), (0.26, 2.0, 0.02, False), (0.26, -0.2, 0.0, False)],
)
def test_play_is_taken_up_by_a_way_that_is_longer(
    caplog: pytest.LogCaptureFixture, backlash_deg: float, approach_deg: float, rounding_deg: float, told: bool
) -> None:
    axis = LIMITS.model_copy(update={"backlash_deg": backlash_deg})
    Joint("light", axis, (-80.0, 80.0), approach_deg, None).warn_of_backlash(80.0, rounding_deg)
    assert len(caplog.records) == told


def test_an_axis_may_lean_two_degrees_beyond_a_hard_stop() -> None:
    joint = Joint("light", LIMITS, (-80.0, 80.0), 2.0, (-84.0, 86.0))
    for good in (-85.9, 87.9):
        joint.require_between_stops(good, "zero_count")
        Joint("light", LIMITS, (-80.0, 80.0), 2.0, None).require_between_stops(10.0 * good, "zero_count")
    for bad in (-86.1, 88.1):
        with pytest.raises(DeviceError, match=r"beyond its hard stops at -84 and 86 deg.*axes\.light\.zero_count"):
            joint.require_between_stops(bad, "zero_count")


def test_a_reading_beyond_a_hard_stop_is_a_wrong_zero(line: Line) -> None:
    """Light stands at count 1500, -48.2 deg."""
    stops = ArmAxis(limits_deg=(-30.0, 80.0), hard_stops_deg=(-40.0, 85.0))
    with pytest.raises(DeviceError, match=r"axis light reads -48\.\d+ deg, beyond its hard stops at -40 and 85 deg"):
        ServoArms(describe(light=stops), servos(line.port)).__enter__()
    assert not line.servos[1].torque


def test_parking_goes_by_a_free_way(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    """The light has to make room before the camera may go to where the light was."""
    post = Body(name="post", on="bench", from_mm=(0, 0, -300), to_mm=(0, 0, -200), radius_mm=10.0)
    with ServoArms(with_body(post), servos(line.port, light={"park_deg": -10.0}, camera={"park_deg": 10.0})) as arms:
        arms.move(pose(20.0, 60.0))
        legs: list[dict[str, float]] = []
        jog = arms._jog

        def noted(goals: dict[str, float], *, parking: bool) -> dict[str, float]:
            legs.append({name: round(math.degrees(angle)) for name, angle in goals.items()})
            return jog(goals, parking=parking)

        monkeypatch.setattr(arms, "_jog", noted)
        arms.park()
        assert [(leg["light"], leg["camera"]) for leg in legs] == [(-10, 60), (-10, 10)]
        assert degrees(arms.read())[:2] == pytest.approx((-10, 10), abs=TOLERANCE_DEG)


def test_a_place_to_park_that_bodies_close_is_refused_before_a_run(line: Line) -> None:
    """Points are planned from the rest position and back to it: parking elsewhere has to be as free."""
    rig = with_body(FENCE)
    with pytest.raises(ConfigError, match=r"^devices.servos.axes.light.park_deg = 20: .* source head and fence"):
        ServoArms(rig, servos(line.port, light={"park_deg": 20.0}))
    ServoArms(rig, servos(line.port, light={"park_deg": -40.0}))


def test_a_park_that_is_blocked_is_refused_and_nothing_turns(line: Line) -> None:
    with ServoArms(with_body(FENCE), servos(line.port)) as arms:
        arms.move(pose(40.0, 70.0))
        with pytest.raises(ConfigError, match="would touch: source head and fence"):
            arms.park()
        assert degrees(arms.read())[:2] == pytest.approx((40, 70), abs=TOLERANCE_DEG)
