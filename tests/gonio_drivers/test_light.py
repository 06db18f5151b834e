"""The lamp driver against a twin in each dialect: exchanges, readback, faults, and darkness whatever happens."""

import fcntl
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from gonio_drivers import guard, settings
from gonio_drivers.lamp_line import DIALECTS, dialect
from gonio_drivers.light import LampReset, SerialLight
from gonio_sim.wire import lamps
from gonio_sim.wire.faults import Faults
from gonio_sim.wire.peer import SerialPeer

from gonio.errors import ConfigError, DeviceError, EmergencyStop
from gonio.lab.rig import clock
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band, Bands, Lamp
from tests.command_line import some
from tests.places import ROOT

BANDS = (Band(name="blue", centre_nm=460, fwhm_nm=20), Band(name="red", centre_nm=630, fwhm_nm=20))
DESCRIPTION = RigDescription(rig="lab", name="bench", bands=Bands(list=BANDS), lamp=Lamp())
PATIENCE_S = 60.0
"""For answers that come: a busy machine may take seconds for any of them."""
SHORT_S = 0.25
"""For answers that do not come."""


def speak(light: SerialLight, **changes: object) -> None:
    """Let a driver speak its dialect with some keys changed."""
    light._dialect = light._line._dialect = light._dialect.model_copy(update=changes)


@dataclass
class Plugged:
    """A lamp at the end of a cable, and everything that was said on the cable."""

    name: str
    twin: lamps.LampTwin
    port: str
    heard: list[str]

    def driver(self, *, timeout_s: float = PATIENCE_S, **changes: object) -> SerialLight:
        channels = {} if self.name == "scpi" else {"blue": 1, "red": 2}
        table = {"port": self.port, "dialect": self.name, "level": 0.8, "settle_s": 0.0, "channels": channels}
        light = SerialLight(DESCRIPTION, settings.Light.model_validate(table | changes))
        speak(light, timeout_s=timeout_s, banner_s=PATIENCE_S)
        return light

    def goes_dark(self) -> None:
        """Wait until the twin is dark."""
        end = time.monotonic() + PATIENCE_S
        while self.twin.shine.lit:
            assert time.monotonic() < end
            time.sleep(0.01)

    def shines(self, band: Band = BANDS[1]) -> bool:
        """Whether the twin shines as it was asked to."""
        shine = self.twin.shine
        return (shine.lit, shine.level, shine.band) == (True, 0.8, band)


@pytest.fixture(params=DIALECTS)
def lamp(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Plugged]:
    if "real_time" not in request.fixturenames:
        request.getfixturevalue("hours")
    monkeypatch.setattr(lamps, "RESET_S", 0.05)
    twin = lamps.LAMPS[request.param](BANDS, faults=Faults())
    heard: list[str] = []
    real = twin.command

    def command(line: str) -> str | None:
        heard.append(line)
        return real(line)

    monkeypatch.setattr(twin, "command", command)
    with SerialPeer(twin, tells_opening=twin.resets_on_open) as peer:
        yield Plugged(request.param, twin, peer.port, heard)


EXCHANGES = {
    "scpi": ["OUTP OFF", "SOUR:WAV 630.0", "SOUR:LEV 80.00", "OUTP ON", "OUTP OFF"],
    "mightex": ["ECHOOFF", "MODE 1 0", "MODE 2 0", "NORMAL 2 1000 800", "MODE 2 1", "MODE 1 0", "MODE 2 0"],
    "arduino": ["OFF", "SET 2 0.8000", "ON 2", "OFF"],
}


def test_dark_at_construction_lit_when_asked_dark_on_leaving(lamp: Plugged) -> None:
    lamp.twin.shine.lit = True
    with lamp.driver() as light:
        assert not lamp.twin.shine.lit
        light.select(BANDS[1])
        assert not lamp.twin.shine.lit
        light.on()
        assert lamp.shines()
        light.check()
    assert not lamp.twin.shine.lit
    orders = [line for line in lamp.heard if "?" not in line and not line.startswith(("GET", "STATE", "ID", "DEVICE"))]
    assert orders == EXCHANGES[lamp.name]


@pytest.mark.usefixtures("real_time")
def test_dark_after_kill_9(lamp: Plugged, tmp_path: Path) -> None:
    table = {"port": lamp.port, "dialect": lamp.name, "settle_s": 0.0}
    program = (
        "import os, signal\n"
        "from tests.gonio_drivers.test_light import DESCRIPTION, PATIENCE_S, SerialLight, settings, speak\n"
        f"light = SerialLight(DESCRIPTION, settings.Light.model_validate({table}))\n"
        "speak(light, timeout_s=PATIENCE_S, banner_s=PATIENCE_S)\n"
        "light.__enter__()\nlight.on()\nprint('lit', flush=True)\ninput()\n"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT) as killed:
        assert some(killed.stdout).readline() == "lit\n"
        assert lamp.twin.shine.lit
        killed.kill()
    lamp.goes_dark()


@pytest.mark.usefixtures("real_time")
@pytest.mark.parametrize("told", [False, True])
def test_the_guard_darkens_what_an_interruption_has_left_lit(
    lamp: Plugged, monkeypatch: pytest.MonkeyPatch, told: bool
) -> None:
    """Whether it was told of life before, or not."""

    def pressed() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), lamp.driver() as light:  # noqa: PT012
        light.on()
        if told:
            light.keep(1000.0)
        monkeypatch.setattr(light, "off", pressed)
    lamp.goes_dark()


@pytest.mark.usefixtures("real_time")
def test_the_guard_waits_for_a_port_that_the_dead_program_still_holds(
    lamp: Plugged, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel may close the pipe to the guard before the port: 5 lamps of 36 stayed lit after a kill -9."""
    dead = os.open(lamp.port, os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(dead, fcntl.LOCK_EX)
    unlocks = SimpleNamespace(monotonic=time.monotonic, sleep=lambda _: fcntl.flock(dead, fcntl.LOCK_UN))
    monkeypatch.setattr(guard, "time", unlocks)
    lamp.twin.shine.lit = True
    guard._darken(lamp.port, lamp.twin.bauds[0], lamp.driver()._orders_to_darken(), alone=True)
    lamp.goes_dark()
    os.close(dead)


def test_a_band_changes_while_the_lamp_is_lit(lamp: Plugged) -> None:
    with lamp.driver() as light:
        for band in (*BANDS, BANDS[0]):
            light.select(band)
            light.on()
            light.check()
            assert lamp.shines(band)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["lamp-nak", "lamp-silent", "lamp-reset"])
@pytest.mark.parametrize("when", range(0, 9, 3))
def test_a_fault_at_any_exchange_is_mended_or_told(lamp: Plugged, fault: str, when: int) -> None:
    """Whichever exchange it hits: afterwards the lamp shines as asked, or an error says that it does not."""
    with lamp.driver(timeout_s=SHORT_S) as light:
        lamp.twin.faults = Later(when, fault)
        light.select(BANDS[1])
        light.on()
        try:
            light.check()
        except LampReset:
            light.check()  # it has been lit again
        assert lamp.shines() or not light.lit
    assert not lamp.twin.shine.lit


class Later(Faults):
    """A fault that waits for the n-th exchange."""

    def __init__(self, when: int, fault: str) -> None:
        super().__init__()
        self._when, self._fault = when, fault

    def take(self, *names: str, servo: int | None = None) -> str | None:
        self._when -= 1
        return self._fault if self._when == -1 else None


def test_a_lamp_that_resets_while_it_shines_is_lit_again_and_told(lamp: Plugged) -> None:
    with lamp.driver() as light:
        light.select(BANDS[1])
        light.on()
        lamp.twin.reset(lambda data: None)
        with pytest.raises(LampReset):
            light.check()
        light.check()
        assert lamp.shines()


def test_a_lamp_that_stays_silent(lamp: Plugged) -> None:
    lamp.twin.faults.arm("lamp-silent", times=10_000)
    silent = lamp.driver(timeout_s=SHORT_S)
    with pytest.raises(DeviceError, match=r"does not answer .*is it on, is this its port, is devices\.light\.dialect"):
        silent.__enter__()


@pytest.mark.slow
def test_a_lamp_that_falls_silent_while_lit_is_an_error_that_says_to_switch_it_off(lamp: Plugged) -> None:
    light = lamp.driver()
    light.__enter__()
    light.select(BANDS[0])
    light.on()
    some(light._line._port).timeout = SHORT_S
    lamp.twin.faults.arm("lamp-silent", times=10_000)
    with pytest.raises(DeviceError, match="switch it off by hand"):
        light.__exit__(None, None, None)


@pytest.mark.slow
def test_another_language(lamp: Plugged) -> None:
    other = "mightex" if lamp.name != "mightex" else "scpi"
    wrong = lamp.driver(timeout_s=SHORT_S, dialect=other, channels={}, baud=lamp.twin.bauds[0])
    with pytest.raises(DeviceError, match=rf"devices\.light\.dialect|is no {other} controller"):
        wrong.__enter__()


def test_monitor(lamp: Plugged) -> None:
    with lamp.driver(monitor_tolerance=0.01) as light:
        light.select(BANDS[0])
        dark = light.monitor()
        light.on()
        lit = light.monitor()
        light.check()
        assert (dark is None) == (lamp.name == "mightex")
        if lit is not None and dark is not None:
            assert lit > dark == 0


def test_settings_are_refused_with_their_key(lamp: Plugged) -> None:
    with pytest.raises(ConfigError, match=r'devices\.light\.channels\."green"'):
        lamp.driver(channels={"green": 3})
    with pytest.raises(ConfigError, match=r'devices\.light\.dialect = "klingon": shipped are'):
        lamp.driver(dialect="klingon")


def test_missing_port() -> None:
    light = SerialLight(DESCRIPTION, settings.Light(port="/dev/no-lamp-here"))
    with pytest.raises(DeviceError, match=r'devices\.light\.port = "/dev/no-lamp-here": there is no such port'):
        light.__enter__()


def shipped(name: str) -> str:
    """The file of a shipped dialect."""
    return files("gonio_drivers").joinpath("dialects", f"{name}.toml").read_text()


def test_a_dialect_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(shipped("arduino").replace('name = "arduino"', 'name = "mine"'))
    assert dialect(str(path)).name == "mine"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ('colour = "green"', "mine.toml: unknown key colour"),
        ("acknowledge = '(OK'", r"mine\.toml: acknowledge = .*regular expression"),
        ('select = "WAV {wavelength_nm}"', "select and selected go together"),
        ('selected = "WAV?"', "select and selected go together"),
        ("got = '[.0-9]+'", r"got = .*needs a group"),
        ('set = "SET {level}"', r"set = .*only \{value\} and \{channel\} can be filled in"),
        ('on = "{}"', r"on = .*only \{channel\} can be filled in; write \{\{ and \}\} for braces"),
        ('state = \'{"ask": "state"}\'', r"state = .*only \{channel\} can be filled in"),
    ],
)
def test_a_dialect_that_cannot_work_is_refused_when_it_is_read(tmp_path: Path, wrong: str, message: str) -> None:
    key = wrong.split(" = ")[0]
    kept = [line for line in shipped("arduino").splitlines() if not line.startswith(f"{key} = ")]
    (tmp_path / "mine.toml").write_text("\n".join([*kept, wrong]))
    with pytest.raises(ConfigError, match=rf"mine\.toml: .*{message}|{message}"):
        dialect(str(tmp_path / "mine.toml"))


def test_a_device_that_never_stops_talking_is_no_lamp(lamp: Plugged, monkeypatch: pytest.MonkeyPatch) -> None:
    light = lamp.driver()
    speak(light, timeout_s=0.01, banner="READY.*", banner_s=0.01)
    monkeypatch.setattr(light._line, "next", lambda: "TEMP 31.2")
    with pytest.raises(DeviceError, match=r'says it is "TEMP 31\.2", which is no'):
        light.__enter__()


def test_a_line_of_blanks_ends_in_time(lamp: Plugged, monkeypatch: pytest.MonkeyPatch) -> None:
    with lamp.driver() as light:
        speak(light, prompt="> ")
        with monkeypatch.context() as patch:
            patch.setattr(light._line._port, "timeout", 0.01)
            patch.setattr(light._line._port, "read_until", lambda ending: b"> \r\n")
            assert light._line.next() == ""


def answers_first(light: SerialLight, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """The next question is answered by this, whatever it was."""
    real, answers = light._line.ask, iter([text])
    monkeypatch.setattr(light._line, "ask", lambda *asked: next(answers, None) or real(*asked))


def test_a_number_is_asked_for_again_where_something_else_comes(lamp: Plugged, monkeypatch: pytest.MonkeyPatch) -> None:
    with lamp.driver() as light:
        answers_first(light, monkeypatch, "TEMP is 31.2")
        assert light._line.number(light._dialect.get.format(channel=1), light._dialect.got) == 0


def test_a_lamp_counts_as_dark_only_where_it_says_so(lamp: Plugged, monkeypatch: pytest.MonkeyPatch) -> None:
    with lamp.driver() as light:
        light.check()
        answers_first(light, monkeypatch, "who knows")
        with pytest.raises(LampReset):
            light.check()


def test_a_monitor_that_sees_nothing_of_a_lit_lamp_is_an_error(lamp: Plugged, monkeypatch: pytest.MonkeyPatch) -> None:
    with lamp.driver(monitor_tolerance=0.02) as light:
        monkeypatch.setattr(light, "monitor", lambda: 0.0)
        light.select(BANDS[0])
        light.on()
        with pytest.raises(DeviceError, match="the lamp's monitor reads 0 while the lamp is lit"):
            light.check()


@pytest.mark.slow
@pytest.mark.parametrize("habit", ["echo", "prompt", "slow", "bytewise", "chatter"])
def test_habits_of_controllers(lamp: Plugged, tmp_path: Path, habit: str, caplog: pytest.LogCaptureFixture) -> None:
    """An echo, a prompt, answers after the timeout (0.25 s), single bytes, lines that nobody asked for: the lamp shines
    as asked, and gets dark."""
    (tmp_path / "mine.toml").write_text(shipped(lamp.name) + ('prompt = "> "\n' if habit == "prompt" else ""))
    receive = lamp.twin.receive

    def with_habit(data: bytes, baud: int, send: Callable[[bytes], None]) -> None:
        def bytewise(answer: bytes) -> None:
            for byte in answer:
                send(bytes([byte]))

        if habit == "echo":
            send(data)
            clock.sleep(0.05)  # the echo comes at once, the answer when the command has been carried out
        if habit == "chatter":
            send(b"\r\n\nTEMP 31.2\r\n\r")
        if habit == "slow" and b"?" in data:
            clock.sleep(0.3)  # on the twin's side
        receive(data, baud, bytewise if habit == "bytewise" else send)
        if habit == "prompt":
            send(b"\r\n> ")

    lamp.twin.receive = with_habit  # type: ignore[method-assign]
    light = lamp.driver(timeout_s=SHORT_S if habit == "slow" else PATIENCE_S, dialect=str(tmp_path / "mine.toml"))
    with light:
        light.select(BANDS[1])
        light.on()
        light.check()
        assert lamp.shines()
    assert not lamp.twin.shine.lit
    assert habit == "slow" or not caplog.records  # nothing had to be repeated


@pytest.mark.parametrize("ending", [b"\r", b"\n", b"\n\r", b"\r\n"])
def test_lines_may_end_otherwise_than_the_dialect_says(lamp: Plugged, ending: bytes) -> None:
    """And an echo may end otherwise than the answer that follows it."""
    receive = lamp.twin.receive

    def echoing(data: bytes, baud: int, send: Callable[[bytes], None]) -> None:
        send(data.strip() + b"\r")
        receive(data, baud, send)

    lamp.twin.receive = echoing  # type: ignore[method-assign]
    lamp.twin.ending = ending
    with lamp.driver(timeout_s=1.0) as light:
        light.select(BANDS[1])
        light.on()
        light.check()
        assert lamp.shines()
    assert not lamp.twin.shine.lit


@pytest.mark.parametrize("answer", ["0", "+0", '-0,"No error"', "0 No error"])
def test_no_error_is_said_in_several_ways(answer: str) -> None:
    assert re.fullmatch(dialect("scpi").no_error, answer)
    assert not re.fullmatch(dialect("scpi").no_error, f"-10{answer}")


def test_half_a_number_is_none(lamp: Plugged, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wait may end in the middle of a line, where the computer or the adapter is held up."""
    with lamp.driver() as light:
        light.on()
        assert light._line._port is not None
        whole = light._line._port.read_until
        rest: list[bytes] = []

        def halves(ending: bytes) -> bytes:
            if rest:
                return rest.pop()
            line = whole(ending)
            rest.append(line[1:])
            return line[:1]

        monkeypatch.setattr(light._line._port, "read_until", halves)
        assert light.monitor() == {"scpi": 8e-4, "arduino": 0.8}.get(lamp.name)


def test_warm_up_is_waited_for_once_and_told(
    lamp: Plugged, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    waits: list[float] = []
    noting = SimpleNamespace(sleep=waits.append, monotonic=time.monotonic)
    monkeypatch.setattr("gonio_drivers.light.clock", noting)  # the twin sleeps as it likes
    light = SerialLight(
        DESCRIPTION.model_copy(update={"lamp": Lamp(warm_up_s=900.0)}),
        settings.Light.model_validate({"port": lamp.port, "dialect": lamp.name, "settle_s": 0.25}),
    )
    with light:
        for wait_s in (900.0, 0.25):
            waits.clear()
            light.on()
            assert sum(waits) == pytest.approx(wait_s, abs=0.1)  # and what the controller is given after a command
            light.off()
    assert caplog.messages.count("the lamp warms up for 900 s (lamp.warm_up_s)") == 1


def test_an_interlock_that_opens_while_the_lamp_warms_up_ends_the_wait(
    lamp: Plugged, monkeypatch: pytest.MonkeyPatch
) -> None:
    light = SerialLight(
        DESCRIPTION.model_copy(update={"lamp": Lamp(warm_up_s=900.0)}),
        settings.Light.model_validate({"port": lamp.port, "dialect": lamp.name}),
    )
    naps: list[float] = []

    def nap(seconds: float) -> None:
        naps.append(seconds)
        assert sum(naps) < 30.0, "it waits on"

    def opens() -> None:
        if sum(naps) > 20.0:
            raise EmergencyStop("the contact is open")

    with light:
        light.allowed = opens
        monkeypatch.setattr("gonio_drivers.light.clock", SimpleNamespace(sleep=nap, monotonic=time.monotonic))
        with pytest.raises(EmergencyStop):
            light.on()
        assert not lamp.twin.shine.lit


@pytest.mark.parametrize(("answer", "locked"), [("IN", True), ("OUT", False)])
def test_a_source_says_in_its_own_words_whether_it_is_in_lock(answer: str, locked: bool) -> None:
    """`lock_good` and `lock_lost` of a dialect: both are replies that the line takes for whole."""
    said: list[str] = []
    lamp: Any = object.__new__(SerialLight)
    lamp._channel, lamp._dialect = (
        1,
        dialect("scpi").model_copy(update={"lock": "LOCK?", "lock_good": "IN", "lock_lost": "OUT"}),
    )

    def ask(query: str, expected: str) -> str:
        said.append(expected)
        return answer

    lamp._line = SimpleNamespace(ask=ask)
    assert lamp.locked() is locked
    assert re.fullmatch(said[0], answer)
