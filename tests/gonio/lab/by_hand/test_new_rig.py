"""The wizard of rig files, with a driver that finds what the test says."""

import math
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from gonio_drivers.lab import LAB

from gonio.errors import ConfigError
from gonio.lab.by_hand.new_rig import Answers, DriverPlugin, Person, make
from gonio.lab.rig import FoundServo
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import SampleDescription

NEEDED = {"light_distance_mm": 800, "camera_distance_mm": 900}


class ManualRig:
    """The driver of the laboratory rig, at ports that do not exist."""

    toml = LAB.toml

    def __init__(self, servos: int = 4) -> None:
        self.wiggled: list[int] = []
        self._servos = [FoundServo("null", 1_000_000, n, "xm430-w350", 46) for n in range(1, servos + 1)]

    def ports(self, description: RigDescription | None = None) -> list[str]:
        return ["/dev/null", "/dev/zero", "/dev/full"]

    def servos(self, port: str, say: Callable[[str], None]) -> list[FoundServo]:
        return self._servos if port == "/dev/full" else []

    def lamp_on(self, port: str) -> tuple[str, str] | None:
        return ("mightex", "Mightex LED") if port == "/dev/zero" else None

    def is_release(self, port: str) -> bool:
        return port == "/dev/null"

    def wiggle(self, servo: FoundServo) -> None:
        self.wiggled.append(servo.id)

    def count_of(self, servo: FoundServo) -> int:
        return 2000 + servo.id

    def open(self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool) -> Any:
        return LAB.open(description, sample=sample, seed=seed, confirm=confirm)


def made(values: dict[str, Any], manual: ManualRig | None = None) -> str:
    answers = Answers(Path("answers.toml"), NEEDED | values)
    return make(cast("DriverPlugin", manual or ManualRig()), answers, lambda text: None)[0]


def test_what_is_found_is_written_with_the_comments_of_the_form() -> None:
    manual = ManualRig()
    text = made({"zero_2": "here", "forward_2": "no", "servo_3": "spin", "servo_4": "none"}, manual)
    tables = tomllib.loads(text)
    assert manual.wiggled == [1, 2, 3, 4]
    assert tables["devices"]["light"] | {"settle_s": 0} == {
        "port": "/dev/zero", "dialect": "mightex", "level": 0.8, "settle_s": 0,
    }  # fmt: skip
    assert tables["devices"]["camera"]["trigger"] == {"how": "serial", "port": "/dev/null"}
    axes = tables["devices"]["servos"]["axes"]
    assert set(axes) == {"light", "camera", "spin"}
    assert (axes["camera"]["direction"], axes["camera"]["zero_count"]) == (-1, 2002)
    assert tables["holder"]["axes"] == ["spin"]
    assert "changer" not in tables["devices"]["servos"]
    assert tables["reference"]["how"] == "swap"
    # of discs of 17.5 mm that are 800 and 900 mm away, in ten-thousandths of a degree
    assert tables["lamp"]["half_angle_deg"] == pytest.approx(math.degrees(math.atan2(8.75, 800)), abs=5.1e-5)
    assert tables["camera"]["lens_half_angle_deg"] == pytest.approx(math.degrees(math.atan2(8.75, 900)), abs=5.1e-5)
    assert tables["arms"]["light"]["zero_offset_known"] is False
    without = [line for line in text.splitlines() if " = " in line and "#" not in line]
    assert len(without) < 12, without  # those that are explained where they stand the first time


def test_nothing_turns_where_it_may_not() -> None:
    manual = ManualRig()
    made({"wiggle": False}, manual)
    assert manual.wiggled == []


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"light_distance_mm": "far"}, 'answers.toml: light_distance_mm = "far" is no number'),
        ({"camera_distance_mm": -1}, 'camera_distance_mm = "-1.*must be a number above 0'),
        ({"light_distance_mm": "nan"}, "must be a number above 0"),
        ({"servo_2": "light"}, 'servo_2 = "light" has a servo already; left: camera'),
        (
            {"servo_1": "tilt", "servo_2": "camera", "servo_3": "spin", "servo_4": "none"},
            "no servo turns the axis light",
        ),
        ({"lamp_port": "nowhere"}, 'lamp_port = "nowhere" is no port that is there'),
        ({"light_limits_deg": "90 -90"}, "two angles with the lower one first"),
        ({"bands": "red"}, 'bands = "red" must be "tunable", or centre and width'),
        ({"zero_1": 5000}, "a whole number from 0 to 4095"),
        ({"collor": "red"}, "collor: nothing of that name is asked"),
        ({"lamp_dialect": "klingon"}, "shipped are scpi, mightex, arduino"),
    ],
)
def test_rubbish_in_a_file_of_answers_is_named(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        made(values)


def test_an_answer_that_is_missing_is_named() -> None:
    with pytest.raises(ConfigError, match="light_distance_mm is missing"):
        make(cast("DriverPlugin", ManualRig()), Answers(Path("a.toml"), {}), lambda text: None)


def test_a_bench_without_servos_says_what_to_look_at() -> None:
    with pytest.raises(ConfigError, match="no servo answers on any port"):
        made({}, ManualRig(servos=0))


def test_a_person_is_asked_again_after_rubbish() -> None:
    said: list[str] = []
    lines: Iterator[str] = iter(["far", "-2", "800"])

    def typed(prompt: str) -> str:
        if not prompt.startswith("Distance from the sample's centre to the lamp"):
            return "900" if "to the lens" in prompt else ""
        return next(lines)

    text, description = make(cast("DriverPlugin", ManualRig()), Person(typed, said.append), said.append)
    assert description.geometry.light_distance_mm == 800
    assert '  "far" is no number; write it like 1000 or 0.5' in said
    assert '  "-2" must be a number above 0' in said
    assert text.startswith("# Written by `gonio rig new`")


def test_the_end_of_the_input_writes_nothing() -> None:
    def typed(prompt: str) -> str:
        raise EOFError

    with pytest.raises(ConfigError, match="name: no answer came; nothing is written"):
        make(cast("DriverPlugin", ManualRig()), Person(typed, lambda text: None), lambda text: None)
