"""The axes of a goniometer, turned by Dynamixel servos in Position mode.

Policy. Nothing turns when the rig is opened: every servo's goal is set to where it stands before its torque comes on,
with a profile velocity and acceleration. Every axis arrives from one side, so that backlash lies on one side; none is
sent beyond a limit, on the way either. A move ends when every axis has *landed*: the servo reports no motion, stands
within the tolerance, and has stood still for the settle time. An axis that friction stops short gets a corrected goal.
What does not land stops every axis. The encoder's readback is what is returned, never the goal: the mean of several
readings, since encoders flicker.
"""

import math
import statistics
from collections.abc import Mapping
from types import TracebackType
from typing import Self

from dynamixel_sdk import INST_PING

from gonio.errors import ConfigError, DeviceError, Disturbed, GonioError
from gonio.lab.rig import Health, Pose, Reading, Target, clock
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.kinematics import AXES
from gonio_drivers import control_table, dynamixel, home_mark, joints, log, preparation, settings, signals, watchdog
from gonio_drivers.any_arms import AllAxes, ArmsReading
from gonio_drivers.motion import LARGEST_CORRECTION_DEG, STILL_COUNTS, Motion
from gonio_drivers.sdk import Packets

LOOKS, SECOND_LOOKS = 5, 9
"""Readings whose mean tells where an axis stands, and whether it has left the place where it landed."""
FLICKER_STEPS = 2.5
"""Readings at rest that lie farther apart, in steps of the encoder, do not tell where the axis stands."""
SECOND_S = 0.02
"""The answer of a second servo follows the first one within this time, behind an adapter's latency of 16 ms."""
PINGS = 4
"""Pings in a row that must find a second servo: a late answer looks like one, but not this often."""
LONGER = 4
"""How many times longer each ping is listened to than the one before: an answer may be late, or this computer busy."""


class ServoArms(AllAxes[joints.Joint]):
    """All axes of a rig, as an `ArmsDevice`.

    Parameters
    ----------
    description
        The rig: limits, zero offsets, speeds, the way of approach.
    servos
        Which servo turns which axis.

    Raises
    ------
    ConfigError
        Servos and axes do not belong together, or a limit is beyond a servo's turn.
    """

    def __init__(self, description: RigDescription, servos: settings.Servos) -> None:
        settings.check_axes(servos, description)
        self._servos = servos
        self.bus = dynamixel.Bus(servos.port, servos.baud)
        every = {
            name: preparation.joint_of(self.bus, description, name, servos.axes[name])  # type: ignore[index]
            for name in description.axes()
        }
        if servos.changer is not None:
            every["changer"] = preparation.changer_joint(self.bus, servos.changer, description.acquisition.approach_deg)
        for side, servo in servos.polarisers.items():
            joint = preparation.polariser_joint(self.bus, side, servo, description.acquisition.approach_deg)
            every[joint.name] = joint
        super().__init__(description, every, "devices.servos")
        self.joints.update(every)
        for joint in every.values():
            preparation.check_acceleration(joint, servos.acceleration_deg_per_s2)
        self._motion = Motion(self.bus, self.joints, servos, lambda: self.allowed())
        self.holds = servos.on_exit == "hold"
        self.deaf = False
        """Whether no servo was heard at the last `stop`: nobody knows then whether the servos heard it."""

    # ---- opening and leaving ----

    def __enter__(self) -> Self:
        self.bus.__enter__()
        try:
            self.joints.clear()
            self.joints.update(self.every)
            self.absent = self._left_out() if self.partial else {}
            for joint in self.joints.values() if not self.partial else ():
                joint.identify()
                require_alone(joint)
            for name, joint in list(self.joints.items()):
                try:
                    preparation.prepare(joint, self._servos.acceleration_deg_per_s2)
                except DeviceError as failure:
                    if not self.partial or len(self.joints) == 1:
                        raise
                    self.absent[name] = failure
                    del self.joints[name]
            self._readback()
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            failures = self._let_go() if self.as_found or not self.holds else []
        finally:
            self.bus.__exit__(kind, error, trace)
        if failures and error is None and not self.faulted:
            raise failures[0]
        for said in dict.fromkeys(map(str, failures)):  # a port that went away says the same for every axis
            log.error("while leaving: %s", said)

    def _left_out(self) -> dict[str, DeviceError]:
        """Axes whose servos do not answer, are of another model, or not alone with their id, and why; no joints then.

        Raises
        ------
        DeviceError
            None of them answers; the message says what is found instead.
        """
        absent: dict[str, DeviceError] = {}
        for name, joint in self.joints.items():
            try:
                joint.identify_model()
                require_alone(joint)
            except dynamixel.BusError as failure:
                absent[name] = DeviceError(f"{joint.key}.id = {joint.id}: {self._unheard(joint, failure)}")
            except DeviceError as failure:
                absent[name] = failure
        if len(absent) == len(self.joints):
            raise DeviceError("no servo of the rig file can be used: " + "; ".join(map(str, absent.values())))
        for name in absent:
            del self.joints[name]
        return absent

    def _let_go(self) -> list[DeviceError]:
        """Take the torque from every servo that has been prepared (that had none, for `as_found`); what failed."""
        failures = []
        for joint in self.joints.values():
            if joint.profile and not (self.as_found and joint.held):
                try:
                    joint.write("Torque Enable", 0)
                except DeviceError as failure:
                    failures.append(failure)
        return failures

    # ---- ArmsDevice ----

    def _drive(self, goals: Mapping[str, float], *, parking: bool) -> Pose:
        self._motion.approach(goals)
        read = self._readback(LOOKS)
        for name, count in read.counts.items():
            self.joints[name].stood_at = count
        for name, goal in goals.items() if not parking else ():
            self.joints[name].warn_of_backlash(goal, 0.5 / abs(self.joints[name].counts_per_deg))
        return read.pose

    def read(self) -> Pose:
        """The encoders' readback, now [rad]: the mean of several readings; `last` keeps it with its time."""
        self._require_all()
        return self._readback(LOOKS).pose

    def look(self) -> ArmsReading:
        """One reading of every servo, as it is."""
        return self._readback()

    @property
    def spread(self) -> Pose:
        """By how much the readings differ whose mean `move` or `read` gave last: largest less smallest [rad]."""
        return self.last.spread if self.last is not None else Pose()

    def stop(self) -> None:
        """Stop every axis where it is: hold what answers, and take the torque from what does not. Never raises."""
        with signals.undisturbed():
            self._stop()

    def _stop(self) -> None:
        self.stopped = True
        silent, failures = [], []
        try:
            watchdog.disarm(self.joints.values())
            self._freeze()
        except DeviceError as failure:
            failures.append(str(failure))
        for joint in self.joints.values():
            joint.landed_at = joint.stood_at = None
            try:
                joint.write("Goal Position", joint.get("Present Position"))
            except DeviceError as failure:
                failures.append(str(failure))
                silent.append(joint)
        self.deaf = len(silent) == len(self.joints)
        try:
            if silent:
                self.bus.write_all(silent[0].table["Torque Enable"].address, {joint.id: b"\x00" for joint in silent})
        except DeviceError as failure:
            failures.append(str(failure))
        for told in dict.fromkeys(failures):  # one cable that is pulled out fails them all
            log.error("stopping the axes: %s", told)

    def _freeze(self) -> None:
        """Tell all servos that answer at once to stay where they are, before anybody waits for one that does not."""
        by_id = {joint.id: joint for joint in self.joints.values()}
        if by_id:
            place = next(iter(by_id.values())).table["Present Position"]  # as in every model of the X series
            blocks = self.bus.glance(by_id, place.address, place.size)
            if here := {by_id[n].name: place.decode(block, place.address) for n, block in blocks.items()}:
                self._motion.send(here)

    def change(self, target: Target) -> None:
        """Put sample or white reference into the beam, by the servo of the changer."""
        changer = self._servos.changer
        if changer is None:
            raise ConfigError("devices.servos.changer is missing: the rig has no servo that changes the sample")
        self._move({"changer": changer.sample_deg if target == "sample" else changer.reference_deg})

    def polarise(self, side: str, azimuth_deg: float) -> None:
        """Turn a polariser to an azimuth, at most 90 to either side."""
        self._move({f"polariser_{side}": azimuth_deg})

    def still(self) -> None:
        """Raise where an axis has left the place where it landed, or has let go of its torque.

        Raises
        ------
        Disturbed
            It was moved by a little (pushed, or sagged); another `move` brings it back.
        DeviceError
            It is far from its place, or its servo is unwell; every axis has been stopped.
        """
        reports = joints.reports(self.bus, self.joints.values())
        for name, report in reports.items():
            try:
                self.joints[name].keep_profile(report.profile)
            except DeviceError as failure:
                self._fail(str(failure))
        disturbed = ""
        places: Mapping[str, float] = {name: report.position for name, report in reports.items()}
        if self._strayed(places):  # or is it the encoder that flickers?
            places = self._readback(SECOND_LOOKS).counts
        for name, place in self._strayed(places).items():
            joint = self.joints[name]
            assert joint.stood_at is not None
            disturbed = (
                f"axis {name} has moved by itself, from {joint.to_deg(joint.stood_at):.2f} to "
                f"{joint.to_deg(place):.2f} deg"
            )
            if joint.distance_deg(joint.stood_at, place) > LARGEST_CORRECTION_DEG:
                self._fail(f"{disturbed}; all axes are stopped")
            joint.landed_at = joint.stood_at = None
        try:
            joints.require_torque(self.bus, self.joints.values())
        except DeviceError as failure:
            self._fail(str(failure))
        if disturbed:
            raise Disturbed(disturbed)

    def _strayed(self, places: Mapping[str, float]) -> dict[str, float]:
        """Those of these counts that are elsewhere than where their axes landed."""
        landed = {name: joint.stood_at for name, joint in self.joints.items() if joint.stood_at is not None}
        return {n: place for n, place in places.items() if n in landed and abs(place - landed[n]) > STILL_COUNTS}

    # ---- what they say of themselves ----

    def health(self) -> Health:
        """Angles, temperatures, currents and voltages of servos that are open; one reading of the bus.

        Raises
        ------
        DeviceError
            A servo does not answer, or is unwell.
        """
        found: list[Reading] = []
        for name, report in joints.reports(self.bus, self.joints.values()).items():
            joint = self.joints[name]
            found += [
                _angle(joint, report.position),
                Reading(name, "temperature", report.temperature_c, "C", (-math.inf, joint.max_temperature_c)),
                _current(joint, report.current),
                Reading(name, "voltage", report.voltage_v, "V", joint.voltage_limits_v),
            ]
        return Health(tuple(found), {name: str(failure) for name, failure in self.absent.items()})

    def strain(self) -> Health:
        """The highest current and the lowest voltage in all reports of open servos since this was last asked.

        At rest the one is small and the other good: it is on the way that a supply sags.
        """
        found: list[Reading] = []
        for name, joint in self.joints.items():
            if joint.strained:
                current, voltage = joint.strained
                most = _current(joint, abs(current.current))
                found += [
                    Reading(name, f"{most.quantity}_max", most.value, most.unit),
                    Reading(name, "voltage_min", voltage.voltage_v, "V"),
                ]
            joint.strained.clear()
        return Health(tuple(found))

    def survey(self) -> Health:
        """The same as `health` of servos that nobody has opened, each by itself; whether they hold, and their errors.

        No torque comes or goes by it.
        """
        found: list[Reading] = []
        silent: dict[str, str] = {}
        try:
            with self.bus:
                for name, joint in self.every.items():  # one that cannot be opened may still say where it stands
                    try:
                        found += _asked(joint)
                    except dynamixel.BusError as failure:
                        silent[name] = self._unheard(joint, failure)
                    except GonioError as failure:
                        silent[name] = str(failure)
        except GonioError as failure:
            return Health((), dict.fromkeys(self.every, str(failure)))
        return Health(tuple(found), silent)

    def _unheard(self, joint: joints.Joint, failure: dynamixel.BusError) -> str:
        """What is said of a servo that does not answer.

        Raises
        ------
        DeviceError
            It is the first that is asked, and nobody is there: the message says what answers instead, if anything does.
        """
        if joint is next(iter(self.every.values())) and not self.bus.discover(rounds=1):
            joint.identify()
        return f"{failure}{self.bus.elsewhere(joint.id)}"

    # ---- reading ----

    def _readback(self, looks: int = 1) -> ArmsReading:
        """Where the axes stand: the mean of several readings."""
        before = clock.monotonic()
        seen = [joints.reports(self.bus, self.joints.values()) for _ in range(looks)]
        after = clock.monotonic()
        places = {name: [reports[name].position for reports in seen] for name in seen[0]}
        counts = {name: statistics.fmean(place) for name, place in places.items()}
        axes = {name: math.radians(self.joints[name].to_deg(count)) for name, count in counts.items() if name in AXES}
        spread = {n: math.radians(self.joints[n].distance_deg(max(places[n]), min(places[n]))) for n in axes}
        self.last = ArmsReading(Pose(**axes), (before + after) / 2, counts, Pose(**spread))
        return self.last


def require_alone(joint: joints.Joint) -> None:
    """Raise `DeviceError` where two servos answer to a joint's id: both would obey what is meant for one.

    Two whole answers to one ping tell that, and one tells that it is alone. Silence tells nothing: it is asked again,
    and where no answer is heard at all, this raises `BusError`. Where answers damage each other, no transaction
    succeeds anyway.
    """
    most = 0
    for look in range(PINGS):
        listen_s = SECOND_S * LONGER**look
        heard = joint.bus.overhear(joint.id, INST_PING, listen_s=listen_s, quiet_s=listen_s if look else 0.0)
        answers = sum(packet[4] == joint.id for packet in Packets().whole(heard))
        if answers == 1:
            return
        most = max(most, answers)
    if most == 0:
        raise dynamixel.BusError(
            f"servo id {joint.id} on {joint.bus.port}: no whole answer to {PINGS} pings, so nobody knows whether one "
            "servo has this id or two; check its cable and supply"
        )
    raise DeviceError(
        f"{joint.key}.id = {joint.id}: two servos answer to this id on {joint.bus.port}; connect one at a time, and "
        "give each its own (gonio rig ids --set-id)"
    )


def _asked(joint: joints.Joint) -> list[Reading]:
    """What a servo says that nobody has opened."""
    joint.identify_model()
    home_mark.recall(joint)
    name, report = joint.name, joint.reported(joint.bus.read(joint.id, *joints.span(joint.table)))
    highest, lowest = joint.get("Max Voltage Limit") / 10, joint.get("Min Voltage Limit") / 10
    moving = report.moving or report.under_way
    falsified = joint.falsified()
    places = [place for _ in range(LOOKS) if (place := joint.shaft_count()) is not None]
    error = joint.get("Hardware Error Status")
    hottest = joint.get("Temperature Limit") or joint.max_temperature_c
    apart_deg = joint.distance_deg(max(places), min(places)) if places else 0.0
    most_deg = max(FLICKER_STEPS * joint.axis.encoder_step_deg, FLICKER_STEPS / abs(joint.counts_per_deg))
    unsteady = Reading(name, "angle_spread", apart_deg, "deg", (0.0, most_deg))
    how = "taken out of the angle" if places else "the angle is not known"
    named = ", ".join(f"{item} = {value}" for item, value in falsified.items())
    return [
        *([_angle(joint, statistics.fmean(places))] if places else []),
        *([Reading(name, "settings", f"{named} in the servo: {how}; a move resets it")] if falsified else []),
        *([unsteady] if apart_deg > most_deg and not moving else []),
        Reading(name, "temperature", report.temperature_c, "C", (-math.inf, hottest)),
        _current(joint, report.current),
        Reading(name, "voltage", report.voltage_v, "V", (lowest, highest) if highest else None),
        Reading(name, "motion", "moves" if moving else "still"),
        Reading(name, "torque", "holds" if joint.get("Torque Enable") == 1 else "off"),
        Reading(name, "error", dynamixel.hardware_error(error) if error else "none"),
    ]


def _angle(joint: joints.Joint, count: float) -> Reading:
    return Reading(joint.name, "angle", joint.to_deg(count), "deg", joint.limits_deg)


def _current(joint: joints.Joint, value: int) -> Reading:
    if "Present Current" not in joint.table:  # an estimate from the motor's drive, in 0.1 %
        return Reading(joint.name, "load", value / 10, "%", (-100.0, 100.0))
    unit = control_table.current_unit_ma(joint.servo.model)
    most = joint.full_current * unit if joint.full_current else math.inf
    return Reading(joint.name, "current", value * unit, "mA", (-most, most) if math.isfinite(most) else None)
