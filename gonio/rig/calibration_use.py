"""What a rig file says of the calibrations it takes, and what is known of each number."""

import datetime
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from gonio.config import NonNegative, Strict
from gonio.typing import Floats, TomlTable

ROUNDED = 1e-5
"""Rounding of a correlation in a file that a person wrote, with five decimals."""


class ParameterUncertainty(Strict):
    """How well some numbers are known: standard uncertainties (k = 1), and how they go together."""

    parameters: list[str]
    """Which numbers: of a sample's [parameters] as `tau_um`, `slopes[0][1]`, `phong.k_s`; of a rig file as
    `arms.light.zero_offset_deg`. Others are exact."""
    u: list[NonNegative]
    correlation: list[list[Annotated[float, Field(ge=-1, le=1)]]]
    """One row for each of `parameters`."""
    misfit: NonNegative = 0.0
    """Where the model has a misfit: the relative standard deviation of measurements from it (docs/misfit.md)."""

    @classmethod
    def of(cls, parameters: list[str], covariance: Floats) -> "ParameterUncertainty":
        """Of numbers with a covariance; those without a variance are correlated with none."""
        u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        size = np.where(u > 0.0, u, 1.0)
        correlation = np.clip(covariance / np.outer(size, size), -1.0, 1.0)
        correlation = 0.5 * (correlation + correlation.T)
        np.fill_diagonal(correlation, 1.0)
        return cls(parameters=parameters, u=u.tolist(), correlation=correlation.tolist())

    @model_validator(mode="after")
    def _fits_together(self) -> "ParameterUncertainty":

        n = len(self.parameters)
        if len(set(self.parameters)) < n or len(self.u) != n or [len(row) for row in self.correlation] != [n] * n:
            raise ValueError(f"{n} parameters, each once, need as many u, and a correlation of {n} rows and columns")
        matrix = np.array(self.correlation).reshape(n, n)
        if n and (np.abs(matrix - matrix.T).max() > ROUNDED or np.abs(np.diag(matrix) - 1.0).max() > ROUNDED):
            raise ValueError("a correlation is symmetric, and 1 on its diagonal")
        if n and np.linalg.eigvalsh(matrix)[0] < -n * ROUNDED:
            raise ValueError("no numbers have this correlation: it has a negative eigenvalue")
        return self


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
