"""The stage of docs/writing_a_driver.md, as it stands there, against a peer written from Newport's SMC100 manual."""

import math
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from gonio_drivers import settings, stages
from gonio_drivers.stages import StageArms
from gonio_sim.wire import motion
from gonio_sim.wire.peer import Device, SerialPeer, scaled_clock

from gonio import plugins
from gonio.config import parse
from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig import Pose
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band, Bands
from tests.contracts.rigs import imported
from tests.places import ROOT, example, fenced

block = partial(fenced, ROOT / "docs" / "writing_a_driver.md")
TOLERANCE_DEG = 0.05
"""Of a landing, as the rig file has it by default."""


class Newport(Device):
    """An SMC100: "SMC100CC & SMC100PP User's Manual", chapter "Command set"."""

    def __init__(self, position: float, referenced: bool) -> None:
        self.clock = scaled_clock(50.0)
        self.way = motion.rest(self.clock(), position)
        self.values = {"VA": 1.0, "AC": 4.0}
        self.referenced, self.homing = referenced, False
        self.error, self.errors = "@", "0000"
        self._buffer = b""

    @property
    def position(self) -> float:
        return self.way.at(self.clock())[0]

    @property
    def state(self) -> str:
        if self.clock() < self.way.end_s:
            return "1E" if self.homing else "28"
        if self.homing:
            self.homing, self.referenced = False, True
        return "33" if self.referenced else "0A"

    def opened(self, send: Callable[[bytes], None]) -> None: ...

    def receive(self, data: bytes, baud: int, send: Callable[[bytes], None]) -> None:
        *lines, self._buffer = (self._buffer + data).split(b"\r\n")
        for line in lines:
            found = re.fullmatch(r"1([A-Z]{2})(.*)", line.decode())
            if found is None or baud != 57600:
                continue
            answer = self.answer(*found.groups())
            if answer is not None:
                send(f"1{found[1]}{answer}\r\n".encode())

    def answer(self, name: str, value: str) -> str | None:
        state = self.state
        if name == "TS":
            return self.errors + state
        if name == "TP":
            return f"{self.position:.6f}"
        if name == "TE":
            error, self.error = self.error, "@"
            return error
        if name in self.values and value == "?":
            return f"{self.values[name]:g}"
        allowed = state in ("32", "33") or (name == "OR" and state == "0A") or (name == "ST" and state in ("28", "1E"))
        if not allowed:
            self.error = "H" if state == "0A" else "M"  # not allowed in this state
        elif name in self.values:
            self.values[name] = float(value)
        elif name in ("PA", "OR"):
            self.homing = name == "OR"
            goal = 0.0 if self.homing else float(value)
            speed = 20.0 if self.homing else self.values["VA"]
            self.way = motion.to_position(self.clock(), self.position, 0.0, goal, speed, self.values["AC"])
        elif name == "ST":
            self.way = motion.rest(self.clock(), self.position)
        return None


@pytest.fixture
def peers() -> Iterator[dict[str, SerialPeer]]:
    with ExitStack() as stack:
        devices = {"light": Newport(12.0, referenced=False), "camera": Newport(170.0, referenced=True)}
        yield {name: stack.enter_context(SerialPeer(device)) for name, device in devices.items()}


@pytest.fixture
def arms(peers: dict[str, SerialPeer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StageArms:
    """Built of the guide's code and the guide's rig file, with the ports of the peers."""
    module = imported("guide_stage", example("newport_stage.py"), tmp_path)
    monkeypatch.setitem(sys.modules, "guide_stage", module)
    (name, target), *_ = tomllib.loads(block("toml", "gonio.stages"))["project"]["entry-points"]["gonio.stages"].items()
    point = EntryPoint(name, target.replace("my_package.stage", "guide_stage"), "gonio.stages")
    monkeypatch.setitem(plugins._added, ("gonio.stages", name), point)
    table = tomllib.loads(block("toml", "[devices.stages]"))["devices"]["stages"]
    for axis, peer in peers.items():
        table["axes"][axis]["port"] = peer.port
    rig = RigDescription(rig="lab", name="r", bands=Bands(list=(Band(name="green", centre_nm=550, fwhm_nm=10),)))
    return StageArms(rig, parse(settings.Stages, table, "devices.stages"))


def newport(peers: dict[str, SerialPeer], name: str) -> Newport:
    device = peers[name].device
    assert isinstance(device, Newport)
    return device


def test_it_is_short() -> None:
    assert example("newport_stage.py").count("\n") < 100


def test_it_homes_moves_reads_and_parks(arms: StageArms, peers: dict[str, SerialPeer]) -> None:
    with arms:
        assert newport(peers, "light").values == {"VA": 30.0, "AC": 20.0}
        landed = arms.move(Pose(light=math.radians(-30), camera=math.radians(40)))
        assert math.degrees(landed.light) == pytest.approx(-30, abs=TOLERANCE_DEG)
        assert newport(peers, "light").position == pytest.approx(-30, abs=TOLERANCE_DEG)
        assert newport(peers, "camera").position == pytest.approx(140, abs=TOLERANCE_DEG)  # 180 - 40
        with pytest.raises(ConfigError, match="light = 91 deg is outside this axis's limits"):
            arms.move(Pose(light=math.radians(91)))
        arms.park()
        assert newport(peers, "light").position == pytest.approx(-90, abs=TOLERANCE_DEG)


def test_errors_and_refusals_stop_every_axis(
    arms: StageArms, peers: dict[str, SerialPeer], monkeypatch: pytest.MonkeyPatch
) -> None:
    with arms:
        newport(peers, "camera").errors = "0020"
        with pytest.raises(DeviceError, match=r"axis camera: Newport controller on .* reports: error 0020"):
            arms.move(Pose())
    newport(peers, "camera").errors = "0000"
    monkeypatch.setattr(stages, "IDLE_S", 0.05)
    with arms:
        newport(peers, "light").referenced = False  # a power dip
        with pytest.raises(DeviceError, match=r"axis light: .* has not found its home since it was switched on"):
            arms.move(Pose())
