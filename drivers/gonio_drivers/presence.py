"""Which servos of a rig file are there: for work by hand, where one that is missing must not stop the others."""

from __future__ import annotations

from gonio.errors import DeviceError
from gonio_drivers import dynamixel
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import Joint


def leave_out(bus: Bus, joints: dict[str, Joint]) -> dict[str, DeviceError]:
    """Take those joints out of `joints` whose servos do not answer, or are of another model; why, by axis.

    Raises
    ------
    DeviceError
        None of them answers; the message says what is found instead.
    """
    absent: dict[str, DeviceError] = {}
    for name, joint in joints.items():
        try:
            joint.identify_model()
        except dynamixel.BusError as failure:
            if not absent and joint is next(iter(joints.values())) and not bus.discover(rounds=1):
                joint.identify()  # nobody is there: a longer search, and a better message
            absent[name] = DeviceError(f"{joint.key}.id = {joint.id}: {failure}")
        except DeviceError as failure:
            absent[name] = failure
    if len(absent) == len(joints):
        raise DeviceError("no servo of the rig file can be used: " + "; ".join(map(str, absent.values())))
    for name in absent:
        del joints[name]
    return absent
