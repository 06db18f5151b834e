"""What a goniometer is: its description, the protocols of its devices, its geometry and its raw frames."""

from gonio.rig.prompt import PROMPTS, ask_for
from gonio.rig.protocols import (
    ArmsDevice,
    CameraDevice,
    Frame,
    LightDevice,
    Pose,
    Rig,
    RigPlugin,
    Step,
    Target,
)

__all__ = [
    "PROMPTS",
    "ArmsDevice",
    "CameraDevice",
    "Frame",
    "LightDevice",
    "Pose",
    "Rig",
    "RigPlugin",
    "Step",
    "Target",
    "ask_for",
]
