"""What a rig file says of the calibrations it takes, and what is known of each number."""

import datetime
from typing import Literal

from pydantic import Field

from gonio.config import Strict
from gonio.samples.description import ParameterUncertainty
from gonio.typing import TomlTable


class Calibrated(ParameterUncertainty):
    """What one calibration file has told of the rig: the covariance of the values that it gave."""

    kind: Literal["geometry", "camera", "light"]
    file: str
    """Where it was read from, and `sha256` of its content."""
    sha256: str
    made: datetime.date
    valid_until: datetime.date | None = None


class CalibrationUse(Strict):
    """Which calibrations the rig is measured with. Their values replace those of the rig file."""

    files: tuple[str, ...] = ()
    """Beside the rig file. A later file's values replace those of an earlier one."""
    when_unfit: Literal["refuse", "warn"] = "refuse"
    """Where a file is out of date, or was made on another rig."""
    known: tuple[Calibrated, ...] = ()
    """What was read: a run keeps it, so that it can be reduced without the files. Not for a person to write."""
    replaced: TomlTable = Field(default_factory=dict)
    """What the rig file itself says where a calibration says otherwise, in its tables. Not for a person to write."""
    remarks: tuple[str, ...] = ()
    """Why a file was unfit, where that was only to be warned of. Not for a person to write."""
