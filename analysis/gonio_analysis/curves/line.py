"""One curve of a plot: theory, measurement, or both."""

from dataclasses import dataclass

from gonio.typing import Floats


@dataclass(frozen=True)
class Line:
    """One curve of a plot: theory, measurement, or both, in the unit of the plot.

    Angles are signed and in radians (negative: retro side), values ascending in angle.
    """

    label: str
    theory_angle: Floats
    theory: Floats
    angle: Floats
    measured: Floats
    u: Floats
    """Standard uncertainties, NaN for none."""
    mirror: float | None = None
    """Angle of the mirror direction."""
    residual: Floats | None = None
    tau: float = 0.0
    """Theory is drawn with a band of a factor exp(tau) to either side, where it is above 0."""
