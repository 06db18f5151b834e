"""Ranges of numbers that keys of a rig file share."""

from typing import Annotated

from pydantic import Field

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
SmallAngle = Annotated[float, Field(ge=-30, le=30)]
"""Error of alignment [deg]: what is larger is another construction."""
