"""What is compared: quantities, their reference values, and ways of evaluating them; and what came of each way."""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from gonio.typing import Floats

Set = Literal["grid", "hard"]
"""The stated grid of directions, and the hard cases."""
SETS: tuple[Set, ...] = ("grid", "hard")
Parameters = dict[str, Any]
"""What a model is evaluated with, as the reference values name it: other names for every model."""
Evaluate = Callable[..., Any]
Inputs = list[tuple[Parameters, tuple[Floats, ...]]]
"""Parameters, and arrays for them."""


@dataclass(frozen=True)
class BenchSample:
    """Reference values of one set of parameters: what a way is given, and what it should say."""

    kind: Set
    parameters: Parameters
    arrays: tuple[Floats, ...]
    value: Floats
    condition: Floats
    cases: tuple[str, ...]


@dataclass(frozen=True)
class Way:
    """One way of evaluating a quantity."""

    name: str
    prepare: Callable[[Parameters], Evaluate]
    """Turns parameters into a function of the arrays; what it costs is not timed."""
    ours: bool = False
    note: str = ""
    convert: Callable[..., tuple[Any, ...]] | None = None
    """Turns the quantity's arrays into what the function takes; not timed."""
    accurate: bool = True
    """Whether its results are comparable (a peer may compute another formula)."""
    stated: float | None = None
    """The relative error (times 1 + conditioning) that the way promises."""
    peer: bool = False


@dataclass(frozen=True)
class BenchQuantity:
    """A quantity, its reference samples, inputs to time it with, and ways of evaluating it."""

    name: str
    title: str
    about: str
    samples: tuple[BenchSample, ...]
    timed: Callable[[int], Inputs]
    """Parameters and arrays for about a given number of evaluations."""
    inputs: str
    """The timed inputs in words."""
    ways: tuple[Way, ...]


def directions(count: int, seed: int = 1) -> tuple[Floats, Floats]:
    """Pairs of unit vectors, each even over the hemisphere."""
    rng = np.random.default_rng(seed)

    def one() -> Floats:
        z, phi = rng.random(count), rng.random(count) * 2.0 * math.pi
        s = np.sqrt((1.0 - z) * (1.0 + z))
        return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)

    return one(), one()


def to_angles(omega_i: Floats, omega_r: Floats) -> tuple[Floats, ...]:
    """theta_i, phi_i, theta_r, phi_r [rad] of vectors."""
    out: list[Floats] = []
    for v in (omega_i, omega_r):
        out += [np.arctan2(np.hypot(v[..., 0], v[..., 1]), v[..., 2]), np.arctan2(v[..., 1], v[..., 0])]
    return tuple(out)


# --- what came of each way, as `summary.json` has it ----------------------------------------------------------------


@dataclass(frozen=True)
class ErrorSummary:
    """Relative errors on one set; None where a result is not finite."""

    points: int
    max: float | None
    p99: float | None
    median: float | None
    max_scaled: float | None
    """The largest over 1 + conditioning."""
    not_finite: int
    warning: bool


@dataclass(frozen=True)
class TimeSummary:
    """What an evaluation takes [ns]."""

    best_ns: float
    median_ns: float
    processor_ns: float
    """Summed over threads, the least of the repeats."""
    pairs: int
    """Evaluations a repeat."""
    repeats: int


@dataclass(frozen=True)
class PeerTime(TimeSummary):
    """The same of a peer, in a process of its own."""

    threads: int | None
    """Threads of its process, idle ones included; None where the system does not say."""


@dataclass(frozen=True)
class WaySummary:
    """Errors and times of one way of evaluating a quantity."""

    way: str
    ours: bool
    peer: bool
    note: str
    stated: float | None
    """The accuracy that it promises: relative error over 1 + conditioning."""
    errors: dict[Set, ErrorSummary]
    """Nothing where its results are not comparable."""
    time: TimeSummary
    on_front_grid: bool
    on_front_hard: bool

    def on_front(self, kind: Set) -> bool:
        """Whether no other way is faster and better on this set."""
        return self.on_front_grid if kind == "grid" else self.on_front_hard

    @property
    def worst(self) -> float | None:
        """The largest error over 1 + conditioning on all sets; None where a result is not finite."""
        found = [e.max_scaled for e in self.errors.values()]
        return None if None in found else max(x for x in found if x is not None)


@dataclass(frozen=True)
class QuantitySummary:
    """Every way of evaluating one quantity."""

    name: str
    title: str
    about: str
    inputs: str
    ways: Sequence[WaySummary]

    @property
    def sets(self) -> list[Set]:
        """The sets that a way was held against."""
        return [kind for kind in SETS if any(kind in w.errors for w in self.ways)]


# --- the reference values of reference.json, written by tools/studies/bench_reference.py, and samples of them ---


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


def samples(groups: list[ModelValues], wanted: Mapping[str, Set]) -> tuple[BenchSample, ...]:
    """Samples over vectors; `wanted` says which of the file's sets, and what each is to the bench."""
    return tuple(
        BenchSample(
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
