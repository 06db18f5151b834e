"""What a sample file says: a model, its parameters, and those that change over the surface."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from gonio.config import NonNegative, Positive, Strict, numbers_in, with_numbers
from gonio.samples.regions import MOST, Numbers, SampleMask, SampleRegion, areas
from gonio.samples.textures import SampleTexture
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
    def of(cls, parameters: list[str], covariance: Floats) -> ParameterUncertainty:
        """Of numbers with a covariance; those without a variance are correlated with none."""
        u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        size = np.where(u > 0.0, u, 1.0)
        correlation = np.clip(covariance / np.outer(size, size), -1.0, 1.0)
        correlation = 0.5 * (correlation + correlation.T)
        np.fill_diagonal(correlation, 1.0)
        return cls(parameters=parameters, u=u.tolist(), correlation=correlation.tolist())

    @model_validator(mode="after")
    def _fits_together(self) -> ParameterUncertainty:

        n = len(self.parameters)
        if len(set(self.parameters)) < n or len(self.u) != n or [len(row) for row in self.correlation] != [n] * n:
            raise ValueError(f"{n} parameters, each once, need as many u, and a correlation of {n} rows and columns")
        matrix = np.array(self.correlation).reshape(n, n)
        if n and (np.abs(matrix - matrix.T).max() > ROUNDED or np.abs(np.diag(matrix) - 1.0).max() > ROUNDED):
            raise ValueError("a correlation is symmetric, and 1 on its diagonal")
        if n and np.linalg.eigvalsh(matrix)[0] < -n * ROUNDED:
            raise ValueError("no numbers have this correlation: it has a negative eigenvalue")
        return self


class SampleDescription(Strict):
    """A sample for a simulated rig: which model it scatters light by."""

    name: str
    model: str
    parameters: TomlTable = Field(default_factory=dict)
    texture: dict[str, SampleTexture] = Field(default_factory=dict)
    """By the name of a number in [parameters]: how it changes over the sample."""
    region: tuple[SampleRegion, ...] = ()
    """Areas of other materials; the rest is of the model above."""
    mask: SampleMask | None = None
    """The picture whose values regions name."""
    diameter_mm: Positive | None = None
    integrate_band: bool = False
    """Render the integral over the band instead of the value at its centre."""
    uncertainty: ParameterUncertainty | None = None
    """What `gonio fit --save` knows of the parameters: quantities of appearance have uncertainties from it."""

    @model_validator(mode="after")
    def _names_are_there(self) -> SampleDescription:
        known = numbers_in(self.parameters)
        missing = [name for name in (self.uncertainty.parameters if self.uncertainty else []) if name not in known]
        if missing:
            raise ValueError(
                f'uncertainty.parameters: there is no number "{missing[0]}" in [parameters]; there are'
                f" {', '.join(known) or 'none'}"
            )
        for name in self.texture:
            if name not in known:
                raise ValueError(
                    f'texture: there is no number "{name}" in [parameters], which a texture needs; there are'
                    f" {', '.join(known) or 'none'}"
                )
        if len(self.region) > MOST:
            raise ValueError(f"region: {len(self.region)} regions; a sample has {MOST} at most")
        if (self.mask is None) != all(one.mask is None for one in self.region):
            raise ValueError("the table [mask], and a [[region]] with mask = VALUE, go together")
        return self

    def materials(self) -> tuple[SampleDescription, ...]:
        """The sample without its regions, and the material of each region: what `region_at` numbers."""
        rest = self.model_copy(update={"region": (), "mask": None})
        own = (
            SampleDescription(
                name=one.name or f"region {number}", model=one.model, parameters=one.parameters, texture=one.texture
            )
            for number, one in enumerate(self.region, 1)
        )
        return rest, *own

    def region_at(self, x_mm: Floats, y_mm: Floats) -> Numbers:
        """The number of the region at places on the sample [mm], arrays of one shape: 0 for none, else from 1.

        Raises
        ------
        ConfigError, DataError
            The mask's picture is not there, is none, or has changed since the sample file was read.
        """
        return areas(self.region, self.mask, f'sample "{self.name}", ')(x_mm, y_mm)

    def parameters_at(self, shares: dict[str, float]) -> TomlTable:
        """The parameters where textures have certain shares of their `high`, by name."""
        numbers = {n: t.low + (t.high - t.low) * shares[n] for n, t in self.texture.items()}
        return dict(with_numbers(self.parameters, numbers))
