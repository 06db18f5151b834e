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

from gonio.errors import ConfigError, DeviceError, Disturbed
from gonio.rig import Pose, Target, clock
from gonio.rig.description import RigDescription
from gonio_drivers import dynamixel, joints, log, preparation, settings, signals, watchdog
from gonio_drivers.any_arms import AXES, Arms, ArmsReading
from gonio_drivers.motion import LARGEST_CORRECTION_DEG, STILL_COUNTS, Motion
from gonio_drivers.sdk import Packets

LOOKS, SECOND_LOOKS = 5, 9
"""Readings whose mean tells where an axis stands, and whether it has left the place where it landed."""
SECOND_S = 0.02
"""The answer of a second servo follows the first one within this time, behind an adapter's latency of 16 ms."""
PINGS = 3
"""Late answers look like those of a second servo, but not so often one after the other."""
LONGER = 4
"""How many times longer each ping is listened to than the one before: an answer may be late, or this computer busy."""


class ServoArms(Arms[joints.Joint]):
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
        super().__init__(description, every, "devices.servos")
        self.joints.update(every)
        for joint in every.values():
            preparation.check_acceleration(joint, servos.acceleration_deg_per_s2)
        self._motion = Motion(self.bus, self.joints, servos, lambda: self.allowed())
        self.holds = servos.on_exit == "hold"
        self.deaf = False
        """At the last `stop` no servo was heard: nobody knows whether it was."""

    # ---- opening and leaving ----

    def __enter__(self) -> Self:
        self.bus.__enter__()
        try:
            self.joints.clear()
            self.joints.update(self.every)
            self.absent = _leave_out(self.bus, self.joints) if self.partial else {}
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
        silent = []
        try:
            watchdog.disarm(self.joints.values())
            self._freeze()
        except DeviceError as failure:
            log.error("stopping: %s", failure)
        for joint in self.joints.values():
            joint.landed_at = joint.stood_at = None
            try:
                joint.write("Goal Position", joint.get("Present Position"))
            except DeviceError as failure:
                log.error("stopping %s: %s", joint.name, failure)
                silent.append(joint)
        self.deaf = len(silent) == len(self.joints)
        try:
            if silent:
                self.bus.write_all(silent[0].table["Torque Enable"].address, {joint.id: b"\x00" for joint in silent})
        except DeviceError as failure:
            log.error("stopping: %s", failure)

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
        heard = joint.bus.overhear(joint.id, INST_PING, listen_s=SECOND_S * LONGER**look)
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


def _leave_out(bus: dynamixel.Bus, there: dict[str, joints.Joint]) -> dict[str, DeviceError]:
    """Take those joints out of `there` whose servos do not answer, are of another model, or not alone with
    their id; why, by axis.

    Raises
    ------
    DeviceError
        None of them answers; the message says what is found instead.
    """
    absent: dict[str, DeviceError] = {}
    for name, joint in there.items():
        try:
            joint.identify_model()
            require_alone(joint)
        except dynamixel.BusError as failure:
            if not absent and joint is next(iter(there.values())) and not bus.discover(rounds=1):
                joint.identify()  # nobody is there: a longer search, and a better message
            absent[name] = DeviceError(f"{joint.key}.id = {joint.id}: {failure}{bus.elsewhere(joint.id)}")
        except DeviceError as failure:
            absent[name] = failure
    if len(absent) == len(there):
        raise DeviceError("no servo of the rig file can be used: " + "; ".join(map(str, absent.values())))
    for name in absent:
        del there[name]
    return absent
