"""Work before a rig can be opened: who is at a port, servos' ids and line speeds, restarts, homing.

Nothing here lights anything. A lamp is only asked for its name, in each shipped dialect in turn.

Two servos with one id answer at once. Their answers come one after the other, or damage each other; what only looks
like one servo must not be given an id. Servos are therefore told apart by a block that no two of them agree in (clock,
position, temperature), and by every byte that comes over the line.
"""

import contextlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence

import serial
from dynamixel_sdk import INST_PING, INST_READ, INST_REBOOT, INST_WRITE

from gonio.config import parse
from gonio.errors import ConfigError, DeviceError, GonioError
from gonio.lab.rig import FoundServo, Homed
from gonio.lab.rig.description import RigDescription
from gonio_drivers import control_table, dynamixel, homing, interlock, joints, ports, preparation, settings
from gonio_drivers.lamp_line import DIALECTS, Dialect, dialect
from gonio_drivers.patience import Patience
from gonio_drivers.sdk import Packets

BROADCAST = 254
LAST_ID = 252
EVERYBODY_S = 0.85
"""Servos answer a broadcast ping in turn, 3 ms for each of 253 ids."""
ONE_S = 0.06
"""Time for one servo, behind an adapter with a latency of 16 ms on a busy computer."""
LOOKS = 3
RESTART_S = 3.0
CODES = {9_600: 0, 57_600: 1, 115_200: 2, 1_000_000: 3, 2_000_000: 4, 3_000_000: 5, 4_000_000: 6}
"""Values of the item Baud Rate (ROBOTIS e-Manual, "Baud Rate(8)")."""
TELLING = 120, 27
"""Address and size of Realtime Tick to Present Temperature, in every model of the X series."""
WIGGLE_COUNTS = 34
"""3 degrees: enough to see, and too little to hit anything."""
SLOW = 25
"""Profile velocity in 0.229 rpm: 34 degrees a second at most."""
GENTLE = 10
MOVED_S = 2.0
LISTEN_S = 0.3
RELEASE_BAUD = 115_200


class ServoService:
    """The protocol `gonio.lab.rig.RigService`, for Dynamixel servos."""

    __slots__ = ()

    def ports(self, description: RigDescription | None = None) -> list[str]:
        """The port of a rig file's servos; without one, all that this computer has."""
        return ports.present() if description is None else [_servos(description).port]

    def servos(self, port: str, say: Callable[[str], None]) -> list[FoundServo]:
        """Every servo that answers on a port, at every line speed.

        Raises
        ------
        DeviceError
            None answers, and some answer to another protocol than ours.
        """
        found: list[FoundServo] = []
        for baud in dynamixel.speeds(port):
            say(f"asking at {baud} baud")
            with dynamixel.Bus(port, baud, key="devices.servos") as bus:
                found += _at(bus)
        if not found:
            say("asking in protocol 1")
            with dynamixel.Bus(port, dynamixel.speeds(port)[0], key="devices.servos") as bus:
                if old := bus.old_servos():
                    raise DeviceError(f"no servo answers to protocol 2; {old}")
        return found

    def assign(self, servo: FoundServo, *, identity: int | None = None, baud: int | None = None) -> FoundServo:
        """Give a servo another id or line speed, for good; as it answers now.

        Raises
        ------
        ConfigError
            There is no such id or line speed.
        DeviceError
            It is not alone with its id, the new id is taken, or the servo does not keep it.
        """
        new_id = servo.id if identity is None else identity
        new_baud = servo.baud if baud is None else baud
        if not 0 <= new_id <= LAST_ID:
            raise ConfigError(f"id {new_id}: ids are 0 to {LAST_ID}")
        if new_baud not in CODES:
            raise ConfigError(f"baud {new_baud}: servos have {', '.join(map(str, sorted(CODES)))}")
        with dynamixel.Bus(servo.port, servo.baud) as bus:
            table = control_table.of_model(servo.model)  # another series keeps its id elsewhere
            _require_alone(bus, servo.id)
            if new_id != servo.id and _answers(bus, new_id):
                raise DeviceError(f"id {new_id} is taken: a servo answers to it on {bus.port} at {bus.baud} baud")
            _write(bus, servo.id, table["Torque Enable"].address, 0)  # or its EEPROM is locked
            if new_id != servo.id:
                _write(bus, servo.id, table["ID"].address, new_id)
                _require_moved(bus, servo.id, new_id)
            if new_baud != servo.baud:
                _write(bus, new_id, table["Baud Rate"].address, CODES[new_baud])
                bus.set_baud(new_baud)
            try:
                number, firmware = bus.ping(new_id)
            except dynamixel.BusError as failure:
                raise DeviceError(f"servo id {new_id} does not answer at {new_baud} baud: {failure}") from None
        return FoundServo(servo.port, new_baud, new_id, _model(number), firmware)

    def reboot(self, description: RigDescription, axes: Sequence[str] = ()) -> dict[str, str]:
        """Restart the servos of axes (of all, without `axes`); by axis, "" or why it failed. Their torque goes off."""
        servos = _servos(description)
        there = servos.everything()
        _require_known(axes, there)
        out: dict[str, str] = {}
        with dynamixel.Bus(servos.port, servos.baud) as bus:
            for name in axes or there:
                try:
                    _restart(bus, there[name].id)
                    out[name] = ""
                except GonioError as failure:
                    out[name] = str(failure)
        return out

    def home(
        self, description: RigDescription, axes: Sequence[str], say: Callable[[str], None]
    ) -> dict[str, Homed | str]:
        """Home axes (without `axes`, those that need it) one after the other; by axis, or why it failed.

        They hold where they stand then. The other axes stay as they are.
        """
        servos = _servos(description)
        out: dict[str, Homed | str] = {}
        with dynamixel.Bus(servos.port, servos.baud) as bus:
            there = {str(n): preparation.joint_of(bus, description, n, servo) for n, servo in servos.axes.items()}
            _require_known(axes, there)
            wanted = axes or homing.lacking({n: j for n, j in there.items() if j.servo.homing is not None})
            with _interlock(description, there) as allowed:
                for name in wanted:
                    try:
                        out[name] = homing.home(there[name], say, allowed)
                    except DeviceError as failure:
                        out[name] = str(failure)
        return out


def _servos(description: RigDescription) -> settings.Servos:
    """The servos' table alone: nothing else of the rig file has to be right for them."""
    table = description.devices.get("servos")
    if table is None and "stages" in description.devices:
        raise ConfigError(f'rig "{description.name}" has stages (devices.stages) and no servos')
    if not isinstance(table, dict):
        raise ConfigError(f'rig "{description.name}": the table devices.servos is missing')
    return parse(settings.Servos, table, f'rig "{description.name}": devices.servos')


def _require_known(axes: Sequence[str], there: Mapping[str, object]) -> None:
    for name in axes:
        if name not in there:
            raise ConfigError(f"the rig has no servo of an axis {name}; it has {', '.join(there)}")


@contextlib.contextmanager
def _interlock(description: RigDescription, there: Mapping[str, joints.Joint]) -> Iterator[Callable[[], None]]:
    """What raises where the rig's interlock has stopped it; nobody lights a lamp meanwhile."""
    table = description.devices.get("interlock")
    if table is None:
        yield lambda: None
        return
    wanted = parse(settings.InterlockSettings, table, f'rig "{description.name}": devices.interlock')
    watched = interlock.build(wanted, there, lambda: None)
    if isinstance(watched.contact, interlock.ServoPort):
        watched.contact.make_input()
    with watched:
        yield watched.require


def _at(bus: dynamixel.Bus) -> list[FoundServo]:
    """The servos at the line speed of a bus."""
    said: dict[int, bytes] = {}
    stray = False
    for _ in range(2):  # what is lost or damaged in one round is heard in another
        heard = bus.overhear(BROADCAST, INST_PING, listen_s=EVERYBODY_S)
        if not heard:
            break
        packets = list(Packets().whole(heard))
        said |= {packet[4]: packet for packet in packets}
        stray = sum(map(len, packets)) < len(heard)
    # damaged in the last round too: ids that two have damage each other's answers, and may never be heard whole
    for identity in range(LAST_ID + 1) if stray else ():
        if identity not in said and (heard := bus.overhear(identity, INST_PING, listen_s=ONE_S / 2)):
            said[identity] = next(Packets().whole(heard), b"")
    out = []
    for identity, packet in sorted(said.items()):
        model = _model(packet[9] | packet[10] << 8) if len(packet) >= 14 else "not understood"
        firmware = packet[11] if len(packet) >= 14 else 0
        out.append(FoundServo(bus.port, bus.baud, identity, model, firmware, alone=_alone(bus, identity)))
    return out


def _alone(bus: dynamixel.Bus, identity: int) -> bool:
    """Whether one servo, and not two, answers to an id."""
    address, size = TELLING
    request = address.to_bytes(2, "little") + size.to_bytes(2, "little")
    clean, damaged = 0, False
    for _ in range(LOOKS):
        heard = bus.overhear(identity, INST_READ, request, listen_s=ONE_S)
        packets = [packet for packet in Packets().whole(heard) if packet[4] == identity]
        if len(packets) > 1:
            return False
        if packets and len(packets[0]) == len(heard):
            clean += 1
        else:
            damaged = damaged or bool(heard)
    if clean or damaged:  # two that talk at once damage every answer but those in which they agree, as to a ping
        return bool(clean)
    return len(bus.overhear(identity, INST_PING, listen_s=ONE_S)) == 14  # it answers nothing but pings


def _answers(bus: dynamixel.Bus, identity: int) -> bool:
    """Whether anything answers to an id; one lost answer does not hide it."""
    return any(bus.overhear(identity, INST_PING, listen_s=ONE_S) for _ in range(LOOKS))


def _require_alone(bus: dynamixel.Bus, identity: int) -> None:
    if not _answers(bus, identity):
        raise DeviceError(f"no servo with id {identity} answers on {bus.port} at {bus.baud} baud")
    if not _alone(bus, identity):
        raise DeviceError(
            f"two servos answer to id {identity} on {bus.port} at {bus.baud} baud, or their answers are damaged: "
            "connect one at a time"
        )


def _require_moved(bus: dynamixel.Bus, old: int, new: int) -> None:
    try:
        bus.ping(new)
    except dynamixel.BusError:
        still = " it is the old one still" if _answers(bus, old) else ""
        raise DeviceError(f"servo id {old} does not take the id {new};{still or ' it answers to neither'}") from None
    if _answers(bus, old):
        raise DeviceError(f"a servo answers to id {new} now, and one to id {old} still: there were two with that id")


def _write(bus: dynamixel.Bus, identity: int, address: int, value: int) -> None:
    """One byte, written once: the answer may come under the new id, or at the new speed, or not at all."""
    heard = bus.overhear(identity, INST_WRITE, address.to_bytes(2, "little") + bytes([value]), listen_s=ONE_S)
    for packet in Packets().whole(heard):
        if packet[4] == identity and (error := packet[8] & 0x7F):
            what = dynamixel.ERRORS.get(error, f"error number {error}")
            raise DeviceError(f"servo id {identity} on {bus.port} refuses {value} at address {address}: {what}")


def _restart(bus: dynamixel.Bus, identity: int) -> None:
    bus.ping(identity)
    bus.overhear(identity, INST_REBOOT, listen_s=ONE_S)
    looked = Patience()
    while True:
        over = looked() > RESTART_S
        try:
            bus.ping(identity)
            break
        except dynamixel.BusError as failure:
            if over:
                raise DeviceError(f"it does not come back after its restart: {failure}") from None
    (error,) = bus.read(identity, 70, 1)
    if error:
        raise DeviceError(f"restarted, and reports again: {dynamixel.hardware_error(error)}; remove the cause")


def _model(number: int) -> str:
    return control_table.models().get(number, f"model number {number}")


def lamp_on(port: str) -> tuple[str, str] | None:
    """Dialect and name of the lamp at a port; None where none of the shipped dialects is spoken.

    Raises
    ------
    DeviceError
        The port cannot be opened.
    """
    for name in DIALECTS:
        spoken = dialect(name)
        with ports.in_use(port, "port"), ports.opened(port, int(spoken.baud), LISTEN_S, "port") as line:
            answer = _name(line, spoken)
        if answer is not None:
            return name, answer
    return None


def _name(line: serial.Serial, spoken: Dialect) -> str | None:
    """What a controller calls itself in a dialect; one that restarts when it is opened says first that it has."""
    heard, looked = "", Patience(LISTEN_S)
    while spoken.banner and (now := looked()) < spoken.banner_s:
        part = str(line.read(256), "ascii", "replace")
        heard += part
        if any(re.fullmatch(spoken.banner, text.strip()) for text in re.split(r"[\r\n]+", heard)):
            break
        if not part and not heard.strip() and now > 4 * LISTEN_S:
            break  # it says nothing: no restart, or no such controller
    for _ in range(2):  # what another dialect left in its buffer may spoil the first
        line.reset_input_buffer()
        ports.send(line, (spoken.identify + spoken.send_ending).encode())
        heard, looked = "", Patience(LISTEN_S)
        while looked() < 2 * LISTEN_S:
            heard += str(line.read(line.in_waiting or 1), "ascii", "replace")
            for text in re.split(r"[\r\n]+", heard)[:-1]:
                known = text.strip().removeprefix((spoken.prompt or "").strip()).strip()
                if re.fullmatch(spoken.identity, known) and known != spoken.identify:
                    return known
    return None


def is_release(port: str) -> bool:
    """Whether a release box answers a line that it does not know, and so makes no exposure."""
    with ports.in_use(port, "port"), ports.opened(port, RELEASE_BAUD, LISTEN_S, "port") as line:
        for _ in range(2):
            line.reset_input_buffer()
            ports.send(line, b"\n?\n")
            if b"ERR" in line.read_until(b"\n") + line.read_until(b"\n"):
                return True
    return False


def count_of(servo: FoundServo) -> int:
    """Where a servo stands, as its count within one turn, without an offset of its own.

    Raises
    ------
    DeviceError
        It counts the other way round: what it will read once it does not is not known.
    """
    with dynamixel.Bus(servo.port, servo.baud) as bus:
        count = joints.BusServo(bus, servo.id, control_table.of_model(servo.model)).undisplaced_count()
    if count is None:
        raise DeviceError(
            f"servo id {servo.id} is in reverse mode (Drive Mode, bit 0), which no rig uses: reset it with the "
            "Dynamixel Wizard"
        )
    return count % joints.COUNTS


def wiggle(servo: FoundServo) -> None:
    """Turn a servo by 3 degrees toward growing counts and back, slowly; then its torque is as it was before.

    Raises
    ------
    DeviceError
        It does not answer, or does not move; its torque is off then.
    """
    with dynamixel.Bus(servo.port, servo.baud) as bus:
        wiggled = joints.BusServo(bus, servo.id, control_table.of_model(servo.model))
        get, put = wiggled.get, wiggled.write
        held = get("Torque Enable")
        if get("Operating Mode") != joints.POSITION_MODE:
            put("Torque Enable", 0)
            put("Operating Mode", joints.POSITION_MODE)
        here = get("Present Position")
        put("Goal Position", here)
        put("Profile Velocity", SLOW)  # after the mode, which resets it
        put("Profile Acceleration", GENTLE)
        try:
            put("Torque Enable", 1)
            put("Goal Position", here)
            for goal in (here + WIGGLE_COUNTS, here):
                put("Goal Position", goal)
                looked = Patience()
                while abs(get("Present Position") - goal) > WIGGLE_COUNTS / 3:
                    if looked() > MOVED_S:
                        raise DeviceError(f"servo id {servo.id} does not turn: is something in its way")
        finally:
            if not held:
                with contextlib.suppress(DeviceError):
                    put("Torque Enable", 0)
