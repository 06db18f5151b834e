"""What a goniometer is: its description, the protocols of its devices, its geometry and its raw frames."""

from gonio.lab.rig.health import Health, Reading
from gonio.lab.rig.prompt import PROMPTS, ask_for
from gonio.lab.rig.protocols import (
    ArmsDevice,
    ByHand,
    CameraDevice,
    Device,
    FoundServo,
    Frame,
    Homed,
    LightDevice,
    PolariserDevice,
    Pose,
    Rig,
    RigDiscovery,
    RigPlugin,
    RigService,
    Step,
    Target,
)

__all__ = [
    "PROMPTS",
    "ArmsDevice",
    "ByHand",
    "CameraDevice",
    "Device",
    "FoundServo",
    "Frame",
    "Health",
    "Homed",
    "LightDevice",
    "PolariserDevice",
    "Pose",
    "Reading",
    "Rig",
    "RigDiscovery",
    "RigPlugin",
    "RigService",
    "Step",
    "Target",
    "ask_for",
]
