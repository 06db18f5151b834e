"""Which servos of a rig file are there, each alone with its id: for work by hand, one that is not stops no other."""

from __future__ import annotations

from collections.abc import Iterator

from dynamixel_sdk import INST_PING

from gonio.errors import DeviceError
from gonio_drivers import dynamixel
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import Joint
from gonio_drivers.sdk import HEADER, Packets

SECOND_S = 0.02
"""The answer of a second servo follows the first one within this time, behind an adapter's latency of 16 ms."""
LOOKS = 3
"""Late answers look like those of a second servo, but not so often one after the other."""
LONGER = 4
"""How many times longer each look listens than the one before: an answer may be late, or this computer busy."""


def require_alone(joint: Joint) -> None:
    """Raise `DeviceError` where two servos answer to a joint's id: both would obey what is meant for one.

    Two whole answers to one ping tell that, and one tells that it is alone. Silence tells nothing: it is asked again,
    and where no answer is heard at all, this raises `BusError`. Where answers damage each other, no transaction
    succeeds anyway.
    """
    most = 0
    for look in range(LOOKS):
        heard = joint.bus.overhear(joint.id, INST_PING, listen_s=SECOND_S * LONGER**look)
        answers = sum(packet[4] == joint.id for packet in packets(heard))
        if answers == 1:
            return
        most = max(most, answers)
    if most == 0:
        raise dynamixel.BusError(
            f"servo id {joint.id} on {joint.bus.port}: no whole answer to {LOOKS} pings, so nobody knows whether one "
            "servo has this id or two; check its cable and supply"
        )
    raise DeviceError(
        f"{joint.key}.id = {joint.id}: two servos answer to this id on {joint.bus.port}; connect one at a time, and "
        "give each its own (gonio rig ids --set-id)"
    )


def packets(data: bytes) -> Iterator[bytes]:
    """The whole and undamaged status packets in what was heard."""
    at = data.find(HEADER)
    while at >= 0:
        end = at + 7 + (data[at + 5] | data[at + 6] << 8) if at + 7 <= len(data) else len(data) + 1
        packet = data[at:end]
        good = len(packet) >= 11 and end <= len(data) and packet[7] == 0x55
        if good and Packets().updateCRC(0, list(packet), len(packet) - 2) == packet[-2] | packet[-1] << 8:
            yield packet
            at = data.find(HEADER, end)
        else:
            at = data.find(HEADER, at + 1)


def leave_out(bus: Bus, joints: dict[str, Joint]) -> dict[str, DeviceError]:
    """Take those joints out of `joints` whose servos do not answer, are of another model, or not alone with
    their id; why, by axis.

    Raises
    ------
    DeviceError
        None of them answers; the message says what is found instead.
    """
    absent: dict[str, DeviceError] = {}
    for name, joint in joints.items():
        try:
            joint.identify_model()
            require_alone(joint)
        except dynamixel.BusError as failure:
            if not absent and joint is next(iter(joints.values())) and not bus.discover(rounds=1):
                joint.identify()  # nobody is there: a longer search, and a better message
            absent[name] = DeviceError(f"{joint.key}.id = {joint.id}: {failure}{bus.elsewhere(joint.id)}")
        except DeviceError as failure:
            absent[name] = failure
    if len(absent) == len(joints):
        raise DeviceError("no servo of the rig file can be used: " + "; ".join(map(str, absent.values())))
    for name in absent:
        del joints[name]
    return absent
