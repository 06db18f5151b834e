"""The rig file of a laboratory whose axes hang on motorised stages."""

import tomllib
from typing import Any

from gonio_drivers.lab import LAB
from gonio_sim.wire.kinesis import COUNTS_PER_DEG

from gonio.config import parse
from gonio.lab.rig.description import RigDescription

AXES = ("light", "camera", "tilt", "spin")
PORT = "/dev/ttyUSB0"
STEP_DEG = 1 / COUNTS_PER_DEG


def on_stages(**changes: dict[str, Any]) -> RigDescription:
    """The shipped rig with a K10CR1 on each axis, and a small sensor; the camera's stage is built in the other way
    round."""
    tables = tomllib.loads(LAB.toml)
    tables["camera"] |= {"width": 64, "height": 48}
    tables["reference"] |= {"frames": 3, "how": "swap"}
    tables["acquisition"] |= {"dark_frames": 2}
    for table in (tables["arms"]["light"], tables["arms"]["camera"], tables["holder"]):
        table |= {"encoder_step_deg": STEP_DEG}
    devices = tables["devices"]
    devices["camera"]["timeout_s"] = 60.0
    del devices["servos"]
    axes: dict[str, dict[str, Any]] = {
        name: {"port": f"{PORT}{k}", "serial": 55000001 + k} for k, name in enumerate(AXES)
    }
    axes["light"] |= {"park_deg": -88.0}
    axes["camera"] |= {"direction": -1, "zero_deg": 180.0, "park_deg": 88.0}
    devices["stages"] = {"driver": "thorlabs", "axes": axes}
    for name, table in changes.items():
        tables[name] |= table
    return parse(RigDescription, tables, "stages.toml")
