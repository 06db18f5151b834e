"""A whole driver of a stage: Newport's SMC100 and CONEX controllers (docs/writing_a_driver.md)."""

import serial
from gonio_drivers import ports
from gonio_drivers.settings import StageAxis
from gonio_drivers.stages import StageState

from gonio.config import parse
from gonio.errors import DeviceError

TRIES = 3
TURNS = {"1E", "1F", "28"}  # homing (by RS-232, by the hand control), moving
READY = {"32", "33", "34", "35"}  # after homing, moving, disable, jogging


class Settings(StageAxis):  # direction, zero_deg, park_deg and home are there already
    port: str
    address: int = 1


class NewportStage:
    def __init__(self, table, key):  # touches no device
        self.axis = parse(Settings, table, key)
        self._key = f"{key}.port"
        self._line = None

    def __str__(self):
        return f"Newport controller on {self.axis.port}"

    def __enter__(self):
        ports.require_free(self.axis.port, self._key)
        try:
            self._line = serial.Serial(self.axis.port, 57600, timeout=0.5, write_timeout=0.5)
        except ports.FAILURES as error:
            raise ports.unopened(self.axis.port, error, self._key) from None
        try:
            self._ask("TS")
        except BaseException:
            self._line.close()
            raise
        return self

    def __exit__(self, kind, error, trace):
        self._line.close()

    def prepare(self, speed_deg_per_s, acceleration_deg_per_s2):
        for name, value in (("VA", speed_deg_per_s), ("AC", acceleration_deg_per_s2)):
            self._tell(f"{name}{value:.6f}")
            got = float(self._ask(f"{name}?"))
            if abs(got / value - 1) > 0.01:
                raise DeviceError(f"{self} does not take {name} = {value:g}: it stays at {got:g}")

    def state(self):
        said = self._ask("TS")  # four digits of errors, two of the state
        state, errors = said[4:6].upper(), said[:4]
        known = state in TURNS | READY
        fault = "" if errors == "0000" else f"error {errors} (its manual, command TS)"
        if known and state not in READY and state != "28":  # homing: its readout means nothing yet
            return StageState(0.0, moving=True, homed=False, fault=fault)
        return StageState(float(self._ask("TP")), moving=state == "28", homed=known, fault=fault)

    def go(self, position_deg):
        self._tell(f"PA{position_deg:.6f}")

    def home(self):
        self._tell("OR")

    def stop(self):
        self._tell("ST")

    def _tell(self, command):
        """A command, which has no answer; so the last error is asked for."""
        self._send(command)
        if (error := self._ask("TE")) != "@":
            raise DeviceError(f"{self} refuses {command}: error {error} (its manual, command TE)")

    def _ask(self, command):
        """The answer to a question, which begins with the question."""
        head = f"{self.axis.address}{command.rstrip('?')}"
        for _ in range(TRIES):  # an answer that is damaged, or to an earlier question, is none
            self._send(command)
            answer = self._line.read_until(b"\r\n").decode("ascii", "replace")
            if answer.startswith(head) and answer.endswith("\r\n"):
                return answer[len(head) : -2].strip()
        raise DeviceError(f"{self._key}: {self} does not answer {command}; check power, cable and address")

    def _send(self, command):
        try:
            self._line.reset_input_buffer()
            self._line.write(f"{self.axis.address}{command}\r\n".encode())
        except ports.FAILURES as error:
            raise ports.lost(self.axis.port, error, self._key) from None
