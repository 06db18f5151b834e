"""The reference values of `reference.json` (written by tests/reference/bench_reference.py), and samples of them."""

import functools
from collections.abc import Mapping
from importlib.resources import files

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from gonio_validation.bench.quantity import Parameters, Sample, Set

Vector = tuple[float, float, float]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ModelValues(_Strict):
    """BRDFs of one set of parameters, pair by pair."""

    set: str
    parameters: Parameters
    cases: tuple[str, ...]
    omega_i: list[Vector]
    omega_r: list[Vector]
    value: list[float]
    """[1/sr]"""
    condition: list[float]
    """Sum of |d ln f/d ln x| over the inputs."""


class FresnelValues(_Strict):
    """Unpolarised reflectance of one index over the cosine."""

    name: str
    n: float
    k: float
    cos: list[float]
    value: list[float]


class RoughnessValues(_Strict):
    """sigma/sigma0 over K (eqs. 80 to 82 of He et al.)."""

    K: list[float]
    value: list[float]


class SeriesValues(_Strict):
    """ln S(g, c)."""

    g: list[float]
    c: list[float]
    ln_S: list[float]
    condition: list[float]


class GrooveValues(_Strict):
    """BRDFs of Oren and Nayar's grooves by quadrature, point by point; angles and sigma in radians."""

    source: str
    theta_i: list[float]
    theta_r: list[float]
    phi: list[float]
    sigma: list[float]
    rho: list[float]
    value: list[float]
    """[1/sr]"""


class ReferenceValues(_Strict):
    """The whole file."""

    made_by: str
    made_with: str = Field(alias="with")
    grid: str
    condition: str
    he_torrance: list[ModelValues] = Field(alias="he-torrance")
    cook_torrance: list[ModelValues] = Field(alias="cook-torrance")
    blinn: list[ModelValues]
    phong: list[ModelValues]
    oren_nayar: list[ModelValues] = Field(alias="oren-nayar")
    oren_nayar_exact: GrooveValues = Field(alias="oren-nayar exact")
    fresnel: list[FresnelValues]
    fresnel_hard: list[FresnelValues]
    roughness: RoughnessValues
    series: SeriesValues

    @property
    def made(self) -> dict[str, str]:
        """How the values were made, as `summary.json` tells it."""
        return {"made_by": self.made_by, "with": self.made_with, "grid": self.grid, "condition": self.condition}


@functools.cache
def reference() -> ReferenceValues:
    """What the file holds."""
    text = files("gonio_validation.bench").joinpath("reference.json").read_text(encoding="utf-8")
    return ReferenceValues.model_validate_json(text)


def samples(groups: list[ModelValues], wanted: Mapping[str, Set]) -> tuple[Sample, ...]:
    """Samples over vectors; `wanted` says which of the file's sets, and what each is to the bench."""
    return tuple(
        Sample(
            wanted[g.set],
            g.parameters,
            (np.array(g.omega_i), np.array(g.omega_r)),
            np.array(g.value),
            np.array(g.condition),
            g.cases,
        )
        for g in groups
        if g.set in wanted
    )
