"""The `[devices]` table of a laboratory rig's file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from gonio.config import NonNegative, Positive, Strict
from gonio.errors import ConfigError
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.polarisers import SIDES, Side
from gonio.typing import TomlTable

AxisName = Literal["light", "camera", "tilt", "spin", "azimuth"]


class SerialInput(Strict):
    """An input of a serial adapter, with a switch between it and the adapter's own output."""

    port: str
    signal: Literal["cts", "dsr", "cd", "ri"] = "cts"


class Homing(Strict):
    """How an axis finds its turn after its servo was switched on. An axis with this table may turn beyond one turn."""

    how: Literal["stall", "switch", "index"]
    """Against its hard stop; to where a switch closes; or over a mark, whose two edges a switch sees."""
    toward: Literal[1, -1] = -1
    """1: toward positive angles of the axis."""
    at_deg: float | None = None
    """Where the axis stands there; for a stall its hard stop, where the axis has one."""
    speed_deg_per_s: Positive = 5.0
    current: Annotated[int, Field(ge=1)] | None = None
    """Largest current at a stall, in the servo's own units: what it may push with."""
    external_port: Literal[1, 2, 3] | None = None
    """The servo's external port that the switch is wired to."""
    line: SerialInput | None = None
    """Instead of an external port: an input of a serial adapter."""
    closed_reads: Literal[0, 1] = 1
    """What the input reads where the switch is closed."""
    repeats: Annotated[int, Field(ge=2, le=20)] = 3
    spread_deg: Positive = 0.5
    """The places that are found lie within this, or the homing has failed."""

    @model_validator(mode="after")
    def _complete(self) -> Homing:
        if self.how == "stall" and self.current is None:
            raise ValueError('how = "stall" needs `current`: what the servo may push with against its stop')
        if self.how != "stall" and (self.external_port is None) == (self.line is None):
            raise ValueError(f'how = "{self.how}" needs the switch: either `external_port` or `line`')
        if self.how != "stall" and self.at_deg is None:
            raise ValueError(f'how = "{self.how}" needs `at_deg`: where the axis stands there')
        return self


class ServoAxis(Strict):
    """One servo and how it is built in."""

    id: Annotated[int, Field(ge=0, le=252)]
    model: str
    """As printed on the servo: "xm430-w350"."""
    direction: Literal[1, -1] = 1
    """1: the axis turns toward positive angles when the servo's count grows."""
    gear_ratio: Positive = 1.0
    """Turns of the servo for one turn of the axis."""
    zero_count: Annotated[int, Field(ge=0, le=4095)] = 2048
    """Count that is called 0 deg; what remains is `zero_offset_deg` of the axis."""
    park_deg: float | None = None
    """Where the axis rests; by default light on its lower limit, camera on its upper limit, the others at 0."""
    current_limit: Annotated[int, Field(ge=1)] | None = None
    """In the servo's own units (2.69 mA for the 430 models); None leaves what is in the servo."""
    homing: Homing | None = None
    """With it the servo counts turns, and has to be homed whenever its power came back; without it, it has one turn."""


class Changer(ServoAxis):
    """The servo of a sample changer, and where it stands for what."""

    sample_deg: float
    reference_deg: float
    speed_deg_per_s: Positive = 30.0


class PolariserServo(ServoAxis):
    """The servo that turns a polariser: at 0 deg its axis lies along the axis of the arms."""

    speed_deg_per_s: Positive = 90.0


class Servos(Strict):
    """The servos of all axes, on one port."""

    port: str
    baud: int = 57_600
    axes: dict[AxisName, ServoAxis]
    acceleration_deg_per_s2: Positive = 90.0
    tolerance_deg: Positive = 0.15
    """A landing is good within this distance of the goal, or within 1.5 counts of the servo where that is more."""
    settle_s: NonNegative = 0.1
    """How long an axis must stand still before it has landed."""
    changer: Changer | None = None
    """A servo that puts sample or white reference into the beam (`reference.how = "axis"`)."""
    polarisers: dict[Side, PolariserServo] = Field(default_factory=dict)
    """Those that turn the rig's polarisers."""
    on_exit: Literal["torque-off", "hold"] = "torque-off"

    def everything(self) -> dict[str, ServoAxis]:
        """All servos, by the names of their joints."""
        out: dict[str, ServoAxis] = {str(name): axis for name, axis in self.axes.items()}
        out |= {"changer": self.changer} if self.changer is not None else {}
        return out | {f"polariser_{side}": one for side, one in self.polarisers.items()}

    @model_validator(mode="after")
    def _distinct(self) -> Servos:
        ids = {name: axis.id for name, axis in self.everything().items()}
        if len(set(ids.values())) < len(ids):
            given = ", ".join(f"{name} {number}" for name, number in ids.items())
            raise ValueError(f"two servos have the same id ({given}); gonio rig ids shows who answers")
        return self


class StageAxis(Strict):
    """How a motorised stage is built in: what the table of an axis has with every driver."""

    direction: Literal[1, -1] = 1
    """1: the axis turns toward positive angles when the stage's readout grows."""
    zero_deg: float = 0.0
    """Readout that is called 0 deg; what remains is `zero_offset_deg` of the axis."""
    park_deg: float | None = None
    """Where the axis rests; by default light on its lower limit, camera on its upper limit, the others at 0."""
    home: Literal["never", "on-opening"] = "never"
    """Whether a stage that has no home may look for it when the rig is opened: it may turn once round for that."""


class Stages(Strict):
    """The motorised stages of all axes."""

    driver: str
    """Its name: "thorlabs", or an entry point of the group `gonio.stages`."""
    axes: dict[AxisName, TomlTable]
    """The keys of `StageAxis`, and the driver's own."""
    acceleration_deg_per_s2: Positive = 20.0
    tolerance_deg: Positive = 0.05
    """A landing is good within this distance of the goal."""
    settle_s: NonNegative = 0.1
    """How long an axis must stand still before it has landed."""


class Light(Strict):
    """A lamp controller on a serial port."""

    port: str
    dialect: str = "scpi"
    """A shipped dialect ("scpi", "mightex", "arduino"), or the path of a TOML file, from where gonio is started."""
    baud: Positive | None = None
    """Instead of the dialect's own line speed."""
    level: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Output while it is on, as a fraction of the dialect's largest setting."""
    channel: Annotated[int, Field(ge=0)] = 1
    channels: dict[str, int] = Field(default_factory=dict)
    """Controller channel by band name, for a lamp with one emitter a band; other bands use `channel`."""
    settle_s: NonNegative = 0.5
    monitor_tolerance: Annotated[float, Field(gt=0)] | None = None
    """Largest relative deviation of the monitor photodiode from its first reading after the lamp was lit."""


class Trigger(Strict):
    """How the tethered camera is made to expose."""

    how: Literal["none", "command", "serial"] = "none"
    command: tuple[str, ...] = ()
    """Program and arguments; {exposure_s} and {folder} are filled in."""
    fetch: tuple[str, ...] = ()
    """Program and arguments that bring the file, where `command` ends when the exposure is over: it runs while the arms
    move on. {folder} is filled in."""
    port: str = ""
    baud: Positive = 115_200
    done: bool = False
    """The release box says DONE when it has closed the shutter: the arms move on then, before the file comes."""

    @model_validator(mode="after")
    def _complete(self) -> Trigger:
        if self.fetch and self.how != "command":
            raise ValueError('`fetch` needs how = "command", whose program ends when the exposure is over')
        if self.done and self.how != "serial":
            raise ValueError('done = true needs how = "serial": a release box that says DONE')
        if self.how == "command" and not self.command:
            raise ValueError('how = "command" needs `command`, a list: program and arguments')
        if self.how == "serial" and not self.port:
            raise ValueError('how = "serial" needs `port`')
        return self


class FolderCameraSettings(Strict):
    """RAW files that a tethering program puts into a folder."""

    folder: str
    suffixes: tuple[str, ...] = (".dng", ".cr2", ".nef", ".arw")
    trigger: Trigger = Trigger()
    timeout_s: Positive = 20.0
    """How long after the end of the exposure a file may take."""
    exposure_tolerance: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """Largest relative deviation of the exposure in the file from what was asked."""
    keep: bool = False
    """Never delete the files that were used; without it they are deleted once the run has its copies."""


class UvcCameraSettings(Strict):
    """A USB video camera."""

    device: str = "/dev/video0"
    response: str | None = None
    """CSV of a response calibration (dn, relative exposure); without it, and without
    `camera.response`, the camera refuses quantitative work."""
    gain: float | None = None
    drop: Annotated[int, Field(ge=0)] = 4
    """Frames that are queued in the driver and thrown away before a frame is used."""


class SequenceCameraSettings(Strict):
    """Images from a folder, in order: replay without a camera."""

    folder: str


class InterlockSettings(Strict):
    """A contact that has to be closed, or the lamp is dark and nothing moves."""

    port: str = ""
    """A serial port, whose line is asserted while the contact is closed."""
    line: Literal["CTS", "DSR", "DCD", "RI"] = "CTS"
    axis: AxisName | None = None
    """Instead of a port: the servo of this axis has an external port, which reads 1 while the contact is closed."""
    input: Annotated[int, Field(ge=1, le=3)] = 1
    """Which external port of that servo."""

    @model_validator(mode="after")
    def _one_place(self) -> InterlockSettings:
        if bool(self.port) == (self.axis is not None):
            raise ValueError("needs either port (a serial line) or axis (a servo's external port)")
        return self


class ServedHolder(Strict):
    """Somebody who changes what lies in the holder and is no person: a robot, or the twins."""

    target_file: str
    """Takes a word for what has to lie there: "mirror", "empty", "sample", or a "reference" that is swapped. Nobody is
    asked then."""


class DeviceSettings(Strict):
    """The whole table; what stands under `camera` is checked by the camera's driver."""

    servos: Servos | None = None
    """Dynamixel servos; or"""
    stages: Stages | None = None
    """motorised stages. One of the two."""
    light: Light
    camera: TomlTable
    """`driver` ("folder", "uvc", "sequence", or an entry point of the group `gonio.cameras`) and that driver's keys."""
    interlock: InterlockSettings | None = None
    holder: ServedHolder | None = None

    @model_validator(mode="after")
    def _belong_together(self) -> DeviceSettings:
        if (self.servos is None) == (self.stages is None):
            raise ValueError("a rig needs arms: give one of the tables devices.servos and devices.stages")
        if self.interlock is not None and self.interlock.axis is not None and self.servos is None:
            raise ValueError("interlock.axis names a servo, and the rig has stages; give interlock.port")
        ports = {"servos.port": self.servos.port} if self.servos is not None else {}
        for name, table in self.stages.axes.items() if self.stages is not None else ():
            if isinstance(port := table.get("port"), str):
                ports[f"stages.axes.{name}.port"] = port
        ports["light.port"] = self.light.port
        if self.interlock is not None and self.interlock.port:
            ports["interlock.port"] = self.interlock.port
        seen: dict[Path, str] = {}
        for key, port in ports.items():
            other = seen.setdefault(Path(port).resolve(), key)
            if other != key:
                raise ValueError(f'{other} and {key} are the same port, "{port}"')
        return self


def check_axes(arms: Servos | Stages, description: RigDescription) -> None:
    """Raise `ConfigError` where servos, or stages, and axes of the rig do not belong together."""
    known, how = description.axes(), description.reference.how
    table, what = ("devices.servos", "servo") if isinstance(arms, Servos) else ("devices.stages", "stage")
    for name in known:
        if name not in arms.axes:
            raise ConfigError(f"{table}.axes.{name} is missing: the rig has this axis, and no {what} turns it")
    if isinstance(arms, Servos) and (how == "axis") != (arms.changer is not None):
        raise ConfigError(
            f'reference.how = "{how}": "axis" needs a table devices.servos.changer, and no other way of reaching the '
            "reference has one"
        )
    turned = arms.polarisers if isinstance(arms, Servos) else {}
    for side in SIDES:
        mount = description.polarisers.on(side)
        if (mount is not None) != (side in turned):
            raise ConfigError(
                f"[polarisers.{side}] says what a polariser is, and devices.servos.polarisers.{side} which servo turns "
                "it: the rig file needs both tables, or none"
            )
        if mount is not None and (mount.empty or mount.retarder):
            raise ConfigError(
                f"[polarisers.{side}]: a servo turns a polariser, and neither takes it out of the beam nor has a "
                "retarder; leave `empty` and `retarder` out"
            )
    for name in arms.axes:
        if name not in known:
            raise ConfigError(f"{table}.axes.{name}: the rig has no axis {name}; it has {', '.join(known)}")
    if isinstance(arms, Stages) and how == "axis":
        raise ConfigError('reference.how = "axis" needs a changer, which devices.stages does not have; take "swap"')
