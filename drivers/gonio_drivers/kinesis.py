"""Thorlabs stages through pylablib: an optional extra (`pip install gonio[thorlabs]`), and a model for other drivers.

One controller with one motor for each axis, behind a USB port of its own: K10CR1 and HDR50 rotation stages, KDC101 with
a PRM1-Z8, KBD101 with a DDR100, KST101. The Kinesis software's setting of the stage stays; speed and acceleration are
set here.
"""

import contextlib
import errno
import struct
import time
import warnings
from collections.abc import Callable
from typing import Any, Self, TypeVar

from gonio.config import Positive, parse
from gonio.errors import ConfigError, DeviceError
from gonio.typing import TomlTable
from gonio_drivers import ports, settings
from gonio_drivers.stages import StageState

T = TypeVar("T")

TRIES = 3
ANSWER_S = 0.5
"""A controller answers within some milliseconds."""
SPEED_TOLERANCE = 0.02
"""Controllers count speeds in units of their own."""
MOVES = {"moving_fw", "moving_bk", "jogging_fw", "jogging_bk", "active", "homing"}
FAULTS = {
    "motion_error": "its motor does not follow",
    "instr_error": "it refuses a command",
    "interlock": "its interlock is open",
    "overtemp": "too hot",
    "volt_supply_fault": "its supply voltage is too low",
    "commutation_error": "its motor's phases are lost",
    "encoder_fault": "its encoder fails",
    "overcurrent": "too much current",
    "curr_supply_fault": "it draws too much current",
    "error": "an error",
}
"""Status bits of the APT protocol, by pylablib's names; "current_limit" is a motor that works hard, and no fault."""


class KinesisAxis(settings.StageAxis):
    """The keys of a table `[devices.stages.axes.NAME]` with `driver = "thorlabs"`."""

    port: str
    serial: int | None = None
    """Eight digits on the controller: it is checked that this one is at the port."""
    stage: str | None = None
    """"K10CR1", "PRM1-Z8", "DDR100", "HDR50", "NR360" ...: whose steps for a degree pylablib knows; without it and
    `counts_per_deg` the controller is asked."""
    counts_per_deg: Positive | None = None
    """Of another stage: steps of the motor, or counts of its encoder, for one degree."""


class KinesisStage:
    """A motor controller of Thorlabs, as a `gonio_drivers.stages.Stage`."""

    def __init__(self, wanted: KinesisAxis, key: str) -> None:
        if wanted.stage is not None and wanted.counts_per_deg is not None:
            raise ConfigError(f"{key}: give stage or counts_per_deg, and not both")
        self.axis = wanted
        self._key = key
        self._motor: Any = None
        self._failures: tuple[type[Exception], ...] = ()
        self._who = f"Thorlabs controller on {wanted.port}"

    def __str__(self) -> str:
        return self._who

    def __enter__(self) -> Self:
        motor_class, error = _library()
        # what a damaged or a late answer becomes in pylablib, beside its own errors
        self._failures = (error, *ports.FAILURES, struct.error, AttributeError, IndexError, UnicodeDecodeError)
        port = self.axis.port
        ports.require_free(port, f"{self._key}.port")
        for _ in range(2):  # the first answer may be the rest of another program's
            begun = time.monotonic()
            try:
                with warnings.catch_warnings():  # of stages that it does not know: asked for below
                    warnings.simplefilter("ignore")
                    self._motor = motor_class(("serial", {"port": port}), scale=self._scale())
                self._identify()
                self._motor.instr.set_timeout(ANSWER_S)
                return self
            except self._failures as caught:
                self._close()
                failure = caught
                if _number(caught) is not None or time.monotonic() - begun > ANSWER_S:
                    break  # there is no port, or nobody says anything: pylablib waits for 3 s
            except BaseException:
                self._close()
                raise
        if _number(failure) is not None:
            cause = failure.__cause__ if isinstance(failure.__cause__, Exception) else failure
            raise ports.unopened(port, cause, f"{self._key}.port")
        raise DeviceError(
            f'{self._key}.port = "{port}": no Thorlabs controller answers there ({_said(failure)}); is it switched on, '
            "and is this its port?"
        )

    def __exit__(self, *_: object) -> None:
        self._close()

    def prepare(self, speed_deg_per_s: float, acceleration_deg_per_s2: float) -> None:
        """Speed and acceleration, read back; no backlash correction of the controller's own, which arrives from its own
        side."""

        def set_up() -> tuple[float, float]:
            got = self._motor.setup_velocity(acceleration=acceleration_deg_per_s2, max_velocity=speed_deg_per_s)
            self._motor.setup_gen_move(backlash_distance=0)
            return got.max_velocity, got.acceleration

        for what, asked, got in zip(
            ("speed_deg_per_s", "acceleration_deg_per_s2"),
            (speed_deg_per_s, acceleration_deg_per_s2),
            self._asked(set_up),
            strict=True,
        ):
            if abs(got / asked - 1) > SPEED_TOLERANCE:
                raise DeviceError(f"{self._key}: {self} does not take {what} = {asked:g}: it stays at {got:g}")

    def state(self) -> StageState:
        """Position and status bits, now."""

        def ask() -> tuple[list[str], float]:
            self._motor.flush_comm()  # an answer that came too late is none to the next question
            return self._motor.get_status(), self._motor.get_position()

        status, position = self._asked(ask)
        faults = [words for name, words in FAULTS.items() if name in status]
        return StageState(position, bool(MOVES & set(status)), "homed" in status, ", ".join(faults))

    def go(self, position_deg: float) -> None:
        """Start a move to a position."""
        self._asked(lambda: self._motor.move_to(position_deg))

    def home(self) -> None:
        """Start the search for the home switch, in the way that the controller is set to."""
        self._asked(lambda: self._motor.home(sync=False, force=True))

    def stop(self) -> None:
        """Stop at once, without a ramp."""
        if self._motor is not None:
            self._asked(lambda: self._motor.stop(immediate=True, sync=False))

    # ---- inside ----

    def _scale(self) -> str | float:
        return self.axis.counts_per_deg or self.axis.stage or "stage"

    def _identify(self) -> None:
        info = self._motor.get_device_info()
        self._who = f"Thorlabs {info.model_no} {info.serial_no} on {self.axis.port}"
        if self.axis.serial is not None and info.serial_no != self.axis.serial:
            raise DeviceError(
                f"{self._key}.serial = {self.axis.serial}, but the controller on {self.axis.port} is {info.serial_no}; "
                "correct the serial number, or the port"
            )
        units = self._motor.get_scale_units()
        if units != "deg" and not (units == "user_step" and self.axis.counts_per_deg is not None):
            stage = "its stage" if self.axis.stage is None else f'the stage "{self.axis.stage}"'
            raise DeviceError(
                f"{self._key}: {self} cannot say how many steps {stage} has for a degree; give counts_per_deg (and the "
                "controller must be one that pylablib knows)"
            )

    def _asked(self, ask: Callable[[], T]) -> T:
        """What the controller answers; asked again where the answer is damaged, or does not come."""
        if self._motor is None:
            raise DeviceError(f"the {self} is not open: enter the rig first")
        for _ in range(TRIES):
            try:
                return ask()
            except self._failures as caught:
                failure = caught
                with contextlib.suppress(*self._failures):
                    self._motor.flush_comm()
        if _number(failure) is not None:
            raise ports.lost(self.axis.port, failure, f"{self._key}.port")
        raise DeviceError(f"{self._key}: {self} does not answer ({_said(failure)}); check power and cable")

    def _close(self) -> None:
        motor, self._motor = self._motor, None
        if motor is not None:
            with contextlib.suppress(*self._failures):
                motor.close()


def _number(error: Exception) -> int | None:
    """The system's number of an error of the port itself; None where the port is well."""
    for each in (error, error.__cause__):
        number = getattr(each, "errno", None)
        if isinstance(each, OSError) and number is not None:
            return int(number)
    return None


def _said(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _library() -> tuple[Any, type[Exception]]:
    """pylablib's class of motors and its error, imported where they are needed: it takes a second or two."""
    try:
        from pylablib.devices import Thorlabs
    except ImportError:
        raise ConfigError('devices.stages.driver = "thorlabs" needs pylablib: pip install "gonio[thorlabs]"') from None

    class Motor(Thorlabs.KinesisMotor):  # type: ignore[misc]
        @staticmethod
        def _cycle_rts(instr: Any) -> None:
            """A line without modem wires (a server of serial ports, a pseudo-terminal) has no RTS to cycle."""
            try:
                Thorlabs.KinesisMotor._cycle_rts(instr)
            except OSError as error:
                if error.errno not in (errno.ENOTTY, errno.EINVAL):
                    raise

    return Motor, Thorlabs.ThorlabsError


def thorlabs(table: TomlTable, key: str) -> KinesisStage:
    """The entry point `thorlabs` of the group `gonio.stages`."""
    return KinesisStage(parse(KinesisAxis, table, key), key)
