"""What `summary.json` of `gonio bench scenes` holds, key by key: page, drawing and table are made from these."""

from collections.abc import Sequence
from dataclasses import dataclass

from gonio_validation.bench.results import Machine


@dataclass(frozen=True)
class SamplesRow:
    """A picture with so many rays for every pixel."""

    scene: str
    rays: float
    """A pixel, the mean."""
    seconds: float
    rms: float
    """Root mean square of the error over the picture's mean radiance."""
    stated: float | None
    """The same of the standard errors that the picture states; None for one ray, which states none."""


@dataclass(frozen=True)
class ToleranceRow:
    """A picture that is brought to a tolerance, and what it would cost with as many rays everywhere."""

    scene: str
    tolerance: float
    rays: float
    most: int
    """Rays of the pixel that took the most."""
    seconds: float
    rms: float
    """Root mean square over pixels of the error, over the tolerance's level: the pixel, or the picture's mean."""
    stated: float
    """The same of the stated standard errors."""
    above: int
    """Pixels that the most rays did not bring to the tolerance."""
    beyond_three: float
    """Share of pixels whose error is above three times the tolerance."""
    holds: bool
    """Stated is at most the tolerance, the error at most half as large again as stated, and few lie beyond three."""
    seconds_for_all: float
    """What as many rays for every pixel would take as the worst pixel needed, from the time of a ray."""


@dataclass(frozen=True)
class BinsRow:
    """A picture with so many wavelengths, in colour, against one with many more."""

    scene: str
    wavelengths: int
    seconds: float
    xyz: float
    """The largest difference of X, Y or Z, over the white's."""
    delta_e: float
    """CIE 1976 colour difference, the mean over the pixels that show the sample."""
    delta_e_worst: float


@dataclass(frozen=True)
class WayRow:
    """A picture by one of several ways of evaluating a material, against the exact one."""

    material: str
    way: str
    seconds: float
    rms: float
    """Over the picture's mean radiance."""
    worst: float
    note: str = ""


@dataclass(frozen=True)
class SharedRow:
    """The same wavelengths in one picture, and in a picture each."""

    material: str
    wavelengths: int
    together_s: float
    apart_s: float


@dataclass(frozen=True)
class PeerRow:
    """The same scene in Mitsuba 3."""

    scene: str
    variant: str
    tiles: int
    largest: float
    """Difference of a tile of 8 x 8 pixels, in standard errors: the largest."""
    rms: float
    beyond_three: int
    """Tiles that are apart by more than three; by chance 0.3 % are."""
    ours_s: float
    ours_rays: int
    ours_rms: float
    """Root mean square of the standard errors over the picture's mean radiance."""
    theirs_s: float
    theirs_rays: int
    theirs_rms: float
    ours_to_one_percent_s: float
    """Time for 1 % rms error: the error falls with the square root of the time."""
    theirs_to_one_percent_s: float
    note: str


@dataclass(frozen=True)
class SceneBench:
    """Every number of the report."""

    title: str
    created: str
    command: str
    quick: bool
    machine: Machine
    pixels: int
    samples: Sequence[SamplesRow]
    tolerances: Sequence[ToleranceRow]
    bins: Sequence[BinsRow]
    ways: Sequence[WayRow]
    shared: Sequence[SharedRow]
    mitsuba: str
    """What was found of it, and which variant was used."""
    peers: Sequence[PeerRow]
