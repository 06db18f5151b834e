"""A whole laboratory of twins: servos, lamp and camera of a rig file, around one simulated world.

The lamp tells the world whether it shines, and in which band; the servos' shafts, through backlash and zero errors, are
where the axes really stand; and the camera renders what the world looks like when its shutter opens. A USB video camera
has a stand-in (`gonio_sim.wire.uvc`). A tethered camera stands in for other kinds, which another process could not
open; a sequence needs no twin, and is replayed as it is.
"""

import contextlib
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gonio.config import to_toml
from gonio.errors import ConfigError, os_error_as
from gonio.lab.rig import Frame, Pose
from gonio.lab.rig.calibration_files import uncalibrated
from gonio.lab.rig.description import Axis, RigDescription
from gonio.lab.rig.dng import encode_dng
from gonio.lab.rig.kinematics import encoder_error
from gonio.lab.rig.polarisers import Side
from gonio.samples.description import SampleDescription
from gonio_sim.camera import SimulatedCamera
from gonio_sim.render import Renderer
from gonio_sim.wire import faults as fault_names
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.kinesis import COUNTS_PER_DEG, KinesisTwin
from gonio_sim.wire.lamps import LAMPS, LampTwin, Shine
from gonio_sim.wire.peer import Clock, Device, SerialPeer, SocketPeer, scaled_clock
from gonio_sim.wire.servo import Mechanics, Servo
from gonio_sim.wire.tether import TetheredCamera
from gonio_sim.world import InHolder, World

COUNTS = 4096
FRICTION_COUNTS = 4.0
"""How far friction stops a servo before its goal."""
START_DEG = {"light": -40.0, "camera": 40.0}
"""Where the arms hang when the power comes."""
STAGE_BAUD = 115_200
TARGET_FILE = "target"
IN_HOLDER: tuple[InHolder, ...] = ("mirror", "empty", "trap", "edge")
"""What a person may put there besides sample and white reference."""
ROOM = 0.05
"""Light in the room, against a white sample under the lamp."""


class _Loose(BaseModel):
    """A part of the table `[devices]`: a twin reads only what it needs; the drivers check the whole."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class _Axis(_Loose):
    id: int
    model: str
    direction: Literal[1, -1] = 1
    gear_ratio: float = 1.0
    zero_count: int = 2048

    @property
    def per_turn(self) -> float:
        """Turns of the shaft for one of the axis."""
        return self.direction * self.gear_ratio

    def turned(self, counts: float) -> float:
        """Angle of the axis [rad] that a place of the shaft stands for."""
        return (counts - self.zero_count) / COUNTS / self.per_turn * math.tau


class _Changer(_Axis):
    sample_deg: float
    reference_deg: float


class _Servos(_Loose):
    baud: int = 57_600
    axes: dict[str, _Axis]
    changer: _Changer | None = None
    polarisers: dict[Side, _Axis] = Field(default_factory=dict)

    def everything(self) -> dict[str, _Axis]:
        """All servos, by the names of what they turn."""
        changer = {"changer": self.changer} if self.changer is not None else {}
        return {**self.axes, **changer, **{f"polariser_{side}": one for side, one in self.polarisers.items()}}


class _StageAxis(_Loose):
    direction: Literal[1, -1] = 1
    zero_deg: float = 0.0
    serial: int = 55000001

    def turned(self, counts: float) -> float:
        """Angle of the axis [rad] that the stage stands at."""
        return math.radians((counts / COUNTS_PER_DEG - self.zero_deg) * self.direction)


class _Stages(_Loose):
    driver: Literal["thorlabs"]
    axes: dict[str, _StageAxis]


class _Light(_Loose):
    dialect: str = "scpi"
    level: float = 1.0


class _Camera(_Loose):
    driver: str


class _Contact(_Loose):
    axis: str | None = None
    input: int = 1


class _Devices(_Loose):
    servos: _Servos = _Servos(axes={})
    stages: _Stages | None = None
    light: _Light
    camera: _Camera
    interlock: _Contact | None = None


def gamma() -> tuple[float, ...]:
    """`camera.response` of a camera whose values are coded as IEC 61966-2-1 (sRGB) has it."""
    coded = np.arange(256) / 255.0
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    return tuple((255.0 * linear).tolist())


class WireWorld(World):
    """A world whose clock runs by itself, and whose frames differ, and whose lamp cools in the dark."""

    def __init__(self, description: RigDescription, sample: SampleDescription | None, seed: int, clock: Clock) -> None:
        super().__init__(description, sample, seed)
        self._clock = clock
        self._cold, self._switched_s = 1.0, 0.0

    def switch(self, lit: bool) -> None:
        """Light the lamp, or darken it."""
        self._cold, self._switched_s = self.cold(), self._clock()
        self.lamp_on = lit

    def cold(self) -> float:
        """How much of its warm-up the lamp has before it; it cools as fast as it warms up."""
        left = math.exp((self._switched_s - self._clock()) / self.truth.lamp.warm_up_time_constant_s)
        return self._cold * left if self.lamp_on else 1.0 - (1.0 - self._cold) * left

    def now_s(self) -> float:
        """Seconds on the twins' clock."""
        return self.description.lamp.warm_up_s + self._clock()

    def spend(self, seconds: float) -> None:
        """Time passes without help."""


@dataclass(slots=True)
class TwinArm:
    """The arm behind a servo or on a stage: backlash, and a zero that is not quite where it was thought to be."""

    shaft: Callable[[], float]
    """Where the shaft stands [counts]."""
    turned: Callable[[float], float]
    """Angle of the axis [rad] that this stands for."""
    axis: Axis
    """The axis with the errors of its encoder within a turn."""
    zero_error: float
    from_above: bool = False
    """Whether the rig approaches its goals from above; the arm then has no backlash."""
    arm: float = math.nan

    def encoder(self) -> float:
        """Angle of the axis that the shaft stands for [rad]."""
        return self.turned(self.shaft())

    def follow(self) -> None:
        """Let the shaft push the arm along."""
        encoder, backlash = self.encoder(), math.radians(self.axis.backlash_deg)
        low, high = (-backlash, 0.0) if self.from_above else (0.0, backlash)
        arm = encoder + low + high if math.isnan(self.arm) else self.arm
        self.arm = min(max(arm, encoder + low), encoder + high)

    def true(self) -> float:
        """Where the arm is [rad]."""
        self.follow()
        offset = math.radians(self.axis.zero_offset_deg) + self.zero_error
        return self.arm - offset - encoder_error(self.axis, self.encoder() - offset)


class Twins:
    """The twins of one rig file; a context that serves them.

    Parameters
    ----------
    description
        The rig file of a laboratory rig, with its table `[devices]`.
    sample, seed
        As in `World`.
    folder
        Where links to the ports and the camera's folder are made.
    scale
        How many times faster than wall time motion, exposures and the lamp's drift run.
    tcp
        Serve at ports of the network in place of pseudo-terminals, which not every system has.

    Raises
    ------
    ConfigError
        The table `[devices]` has no twin, or the sample cannot be rendered.
    """

    def __init__(
        self,
        description: RigDescription,
        sample: SampleDescription | None,
        seed: int,
        *,
        folder: Path,
        scale: float = 50.0,
        tcp: bool = False,
    ) -> None:
        if not scale > 0:
            raise ConfigError(f"--time-scale {scale:g}: must be positive")
        self._devices = _parsed(description)
        self._folder, self.tcp = folder, tcp
        self.scale = scale
        self.faults = fault_names.Faults()
        self._clock = scaled_clock(scale)
        self._bright_until_s = -math.inf
        self.world = WireWorld(description, sample, seed, self._clock)
        truth = self.world.truth
        if self.video and not truth.camera.response:
            bent = truth.camera.model_copy(update={"response": gamma()})
            self.world.truth = truth.model_copy(update={"camera": bent})
        self._render = SimulatedCamera(self.world, Renderer(self.world))
        self._looking = threading.Lock()
        self.followers: dict[str, TwinArm] = {}
        self.servos = self._built_servos(np.random.default_rng([seed, 77]))
        self.stages = self._built_stages()
        self.bus = ServoBus(self.servos.values(), self.faults)
        self.lamp: LampTwin = LAMPS[self._devices.light.dialect](description.bands.all(), self._shine, self.faults)
        readout_s = description.camera.readout_s
        self.camera = TetheredCamera(
            self._expose, folder / "frames",
            scale=scale, faults=self.faults, readout_s=readout_s, says_done=self._says_done,
        )  # fmt: skip
        self.peers: dict[str, SerialPeer | SocketPeer] = {}
        self._stack = contextlib.ExitStack()

    def _built_servos(self, rng: np.random.Generator) -> dict[str, Servo]:
        """Servos by axis, changer of samples and polarisers among them, and the arms that follow them."""
        devices, out = self._devices.servos, {}
        for name, axis in devices.everything().items():
            start = axis.zero_count + self._start_deg(name) / 360 * COUNTS * axis.per_turn
            mechanics = Mechanics(short_counts=FRICTION_COUNTS, within=lambda: float(rng.uniform(-0.5, 0.5)))
            servo = out[name] = Servo(
                axis.id, self._clock, model=axis.model, baud=devices.baud, position=start, mechanics=mechanics
            )
            self._follow(name, servo, servo.travelled, axis.turned)
        contact = self._devices.interlock
        if contact is not None and contact.axis in out:
            out[contact.axis].contacts.add(contact.input)
        return out

    def _start_deg(self, name: str) -> float:
        """Where an axis hangs when the power comes: within its limits."""
        low, high = self.world.description.limits_deg().get(name, (-math.inf, math.inf))
        return min(max(START_DEG.get(name, 1.0), low), high)

    def _built_stages(self) -> dict[str, KinesisTwin]:
        """Stages by axis, and the arms that stand on them."""
        stages: dict[str, KinesisTwin] = {}
        for name, stage in self._devices.stages.axes.items() if self._devices.stages is not None else ():
            readout = stage.zero_deg + self._start_deg(name) * stage.direction
            twin = stages[name] = KinesisTwin(self._clock, position=readout * COUNTS_PER_DEG, serial=stage.serial)
            self._follow(name, twin, twin.shaft, stage.turned)
        return stages

    def _follow(
        self, name: str, twin: Servo | KinesisTwin, shaft: Callable[[], float], turned: Callable[[float], float]
    ) -> None:
        """Let the arm of the world follow a shaft, where it is an arm's."""
        known = self.world.truth.axes()
        if name in known:
            above = isinstance(twin, Servo) and self.world.description.approach_deg()[name] < 0
            arm = TwinArm(shaft, turned, known[name], float(self.world.zero_error[name]), above)
            self.followers[name], twin.leaving = arm, arm.follow

    def __enter__(self) -> Self:
        with os_error_as(ConfigError, f"{self._folder}: cannot be made"):
            (self._folder / "frames").mkdir(parents=True, exist_ok=True)
            (self._folder / TARGET_FILE).unlink(missing_ok=True)
        self.world.open = True
        self._warm_up()
        with contextlib.ExitStack() as stack:
            devices: dict[str, Device] = {"servos": self.bus, "lamp": self.lamp, "release": self.camera}
            devices |= {f"stage-{name}": stage for name, stage in self.stages.items()}
            for name, device in devices.items():
                self.peers[name] = self._peer(name, device)
                stack.enter_context(self.peers[name])
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *how: Any) -> None:
        try:
            self._stack.__exit__(*how)
        finally:
            self._render.close()
            self.world.open = False

    def _peer(self, name: str, device: Device) -> SerialPeer | SocketPeer:
        tells = name == "lamp" and self.lamp.resets_on_open
        if not self.tcp:
            return SerialPeer(device, self._folder / name, tells_opening=tells)
        speed = {"servos": self._devices.servos.baud, "lamp": self.lamp.bauds[0]}.get(name, STAGE_BAUD)
        return SocketPeer(device, speed, tells_opening=tells)

    @property
    def description(self) -> RigDescription:
        """The rig file with its cables plugged into the twins, and with waits that suit their clock."""
        original = self.world.description
        devices = {name: dict(table) for name, table in original.devices.items()}
        if self._devices.stages is not None:
            axes = devices["stages"]["axes"].items()
            devices["stages"]["axes"] = {n: dict(axis) | {"port": self._port(f"stage-{n}")} for n, axis in axes}
        arms = devices["servos" if "servos" in devices else "stages"]
        arms["settle_s"] = max(0.03, arms.get("settle_s", 0.1) / self.scale)
        if "servos" in devices:
            devices["servos"]["port"] = self._port("servos")
        devices["light"] |= {"port": self._port("lamp"), "settle_s": devices["light"].get("settle_s", 0.5) / self.scale}
        devices["holder"] = {"target_file": str(self._folder / TARGET_FILE)}
        if self.replays:
            devices["camera"]["folder"] = str(Path(devices["camera"]["folder"]).expanduser().absolute())
        elif self.video:
            devices["camera"].pop("response", None)  # the twin bends its values as it does
            served = {"driver": "uvc-twin", "device": self._port("release"), "folder": str(self._folder / "frames")}
            devices["camera"] |= served
        else:
            kept = devices["camera"] if self.driver == "folder" else {"driver": "folder"}
            trigger = {"how": "serial", "port": self._port("release")} | ({"done": True} if self._says_done else {})
            devices["camera"] = kept | {"folder": str(self._folder / "frames"), "trigger": trigger}
        lamp = original.lamp.model_copy(update={"warm_up_s": original.lamp.warm_up_s / self.scale})
        return original.model_copy(update={"devices": devices, "lamp": lamp})

    def _port(self, name: str) -> str:
        """Where a device is served; over TCP once this is entered."""
        return self.peers[name].port if name in self.peers else str(self._folder / name)

    @property
    def driver(self) -> str:
        """The camera that the rig file asks for."""
        return self._devices.camera.driver

    @property
    def video(self) -> bool:
        """Whether it is a USB camera of 8 bits, of which there is a stand-in."""
        return self.driver == "uvc" and self.world.description.camera.bits == 8

    @property
    def _says_done(self) -> bool:
        """Whether the camera tells that an exposure is over, as one with a read-out does."""
        return self.world.description.camera.readout_s > 0.0

    @property
    def replays(self) -> bool:
        """Whether the frames are there already, and nothing is rendered."""
        return self.driver == "sequence"

    def inject(self, fault: str, *, axis: str | None = None, times: int = 1, skip: int = 0) -> None:
        """Let a fault happen at its next `times` occasions, after `skip` others; of one axis, where `axis` names it.

        `faults.NAMES` has the names.

        Raises
        ------
        ConfigError
            There is no such fault or axis, or nothing that it could happen to.
        """
        if self.replays and fault in fault_names.CAMERA:
            raise ConfigError(f'the fault "{fault}" needs a tethered camera; devices.camera.driver = "{self.driver}"')
        if axis is not None and axis not in self.servos:
            raise ConfigError(f'the rig has no axis "{axis}"; it has {", ".join(self.servos)}')
        others = fault_names.LAMP + fault_names.CAMERA + fault_names.LIGHT
        servo = None if axis is None or fault in others else self.servos[axis].id
        self.faults.arm(fault, servo=servo, times=times, skip=skip)

    @property
    def quiet(self) -> bool:
        """Whether nothing turns and the lamp is dark."""
        turning = any(servo.powered and servo.moves() for servo in self.servos.values())
        return not (self.lamp.shine.lit or turning or any(stage.moves() for stage in self.stages.values()))

    def _stand(self) -> None:
        """Tell the world where the arms are."""
        self.world.pose = Pose(**{name: follower.true() for name, follower in self.followers.items()})
        for side, axis in self._devices.servos.polarisers.items():
            self.world.polarisers[side] = "linear", axis.turned(self.servos[f"polariser_{side}"].shaft()[0])

    def _warm_up(self) -> None:
        """Load the compiled code of dark frames, and of what may lie under the lamp: no frame is late for it."""
        world = self.world
        targets: list[InHolder] = ["reference"] if world.sample is None else ["reference", "sample"]
        self._stand()
        world.band = world.description.bands.all()[0]
        for world.target in targets:
            for world.lamp_on in (True, False):
                encode_dng(self._render.capture(world.description.camera.exposure_limits_s[0]))
        world.band = None

    # ---- what the devices tell the world ----

    def _shine(self, shine: Shine) -> None:
        with self._looking:
            self.world.switch(shine.lit and shine.level > 0 and shine.band is not None)
            self.world.band = shine.band
            self.world.brightness = shine.level / self._devices.light.level

    def _expose(self, exposure_s: float) -> Frame:
        with self._looking:
            self.world.target = self._target()
            self._stand()
            if self.faults.take("room-light"):
                self._bright_until_s = self._clock() + fault_names.LASTS_S
            room = ROOM * self.world.description.camera.responsivity_e_per_s
            self.world.ambient_e_per_s = room if self._clock() < self._bright_until_s else 0.0
            return self._render.capture(exposure_s)

    def _target(self) -> InHolder:
        """What lies in the beam: what a person has written into the file `target`, or where the changer stands."""
        changer, said = self._devices.servos.changer, ""
        with contextlib.suppress(OSError):
            said = (self._folder / TARGET_FILE).read_text().strip()
        for put in IN_HOLDER:
            if said == put:
                return put
        if changer is None:
            return "reference" if said == "reference" else "sample"
        at = math.degrees(changer.turned(self.servos["changer"].shaft()[0]))
        return "reference" if abs(at - changer.reference_deg) < abs(at - changer.sample_deg) else "sample"


def _parsed(description: RigDescription) -> _Devices:
    try:
        devices = _Devices.model_validate(description.devices)
    except ValidationError as error:
        item = error.errors()[0]
        where = ".".join(str(part) for part in item["loc"])
        raise ConfigError(f'rig "{description.name}": devices.{where}: {item["msg"]}') from None
    if devices.light.dialect not in LAMPS:
        raise ConfigError(
            f'devices.light.dialect = "{devices.light.dialect}" has no twin; twins speak {", ".join(LAMPS)}'
        )
    kind, arms = ("servo", devices.servos) if devices.stages is None else ("stage", devices.stages)
    missing = [name for name in description.axes() if name not in arms.axes]
    if missing:
        key = f"devices.{kind}s.axes.{missing[0]}"
        raise ConfigError(f"{key} is missing: the rig has this axis, and no {kind} turns it")
    return devices


def rig_file(description: RigDescription, folder: Path = Path()) -> str:
    """A rig file, as it is written to disk, with the calibrations of another one that lies in `folder`."""
    use = description.calibration
    tables = uncalibrated(description).model_dump(mode="json", exclude_none=True, exclude={"calibration"})
    if "certificate" in tables["reference"]:  # which says them again
        tables["reference"] = {k: v for k, v in tables["reference"].items() if k not in ("albedo", "u_rel", "spectrum")}
    if use.files:
        files = [str((folder / name).absolute()) for name in use.files]
        tables["calibration"] = {"files": files, "when_unfit": use.when_unfit}
    return to_toml(tables)
