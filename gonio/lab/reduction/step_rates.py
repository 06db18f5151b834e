"""What a step's frames come to in a band: a rate, or why there is none."""

from dataclasses import dataclass, fields
from typing import Any

from gonio.geometry import Directions
from gonio.lab.rig import Pose
from gonio.typing import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Merged:
    """What the frames of one step tell of a region, however they were merged."""

    rate: float
    """[e-/s]"""
    variance: float
    """Variance of all that is independent from step to step, the pixels' responsivities left out."""
    of_lamp: float
    """The part of it that the lamp makes from frame to frame: all pixels have it alike."""
    chi_square: float
    """Chi-square of the frames around their mean."""
    frames: int
    """How many are used."""
    hits: int = 0
    """Pixels of single frames left out as hits of cosmic radiation; where frames are merged by pixels."""
    hot: int = 0
    """Pixels left out in all frames."""
    saturated: float = 0.0
    """The part of all pixels of all frames that was left out as too bright."""

    def named(self) -> dict[str, Any]:
        """These values by their names."""
        return {one.name: getattr(self, one.name) for one in fields(Merged)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduced(Merged):
    """The frames of one step and band, merged to a rate."""

    dark: Floats
    """Change of the rate for one standard deviation of the noise of the shorter and of the longer dark frames in each
    of the patterns that points share (`dark_signal.Patterns`), shape (2, n); zero for a visit to the reference."""
    time_s: float
    left_out: int
    """Frames that are not used, because a pixel of the region is nearly full."""
    pixels: int
    """How many the light falls on."""
    by_camera: Floats
    """Derivatives of the rate by `camera_parameters`."""
    shared: int
    """How many of the pixels the first visit to the reference uses too."""
    by_pixels: Floats
    """Relative change of a value for one standard deviation of the responsivities, which stands for 1 here: of their
    mean over the pixels of the first visit, and in each of the patterns that points share; zero for a visit."""
    directions: Directions
    pose: Pose
    point: int | None
    """Row of the plan; None for a visit to the reference."""


@dataclass(frozen=True, slots=True)
class Rejected:
    """A step that gives no rate in a band."""

    point: int | None
    """Row of the plan; None for a visit to the reference."""
    flag: str
    """Why."""
    left_out: int = 0
    """As in `Reduced`."""
