"""What is compared: a quantity, its reference samples, and the ways of evaluating it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.typing import Floats
from gonio_validation.bench.results import Set

Parameters = dict[str, Any]
"""What a model is evaluated with, as the reference values name it: other names for every model."""
Evaluate = Callable[..., Any]
Inputs = list[tuple[Parameters, tuple[Floats, ...]]]
"""Parameters, and arrays for them."""


@dataclass(frozen=True)
class Sample:
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
    """From parameters to a function of the arrays; what it costs is not timed."""
    ours: bool = False
    note: str = ""
    convert: Callable[..., tuple[Any, ...]] | None = None
    """From the quantity's arrays to what the function takes; not timed."""
    accurate: bool = True
    """Whether its results are comparable (a peer may compute another formula)."""
    stated: float | None = None
    """The relative error (times 1 + conditioning) that the way promises."""
    peer: bool = False


@dataclass(frozen=True)
class Quantity:
    """A quantity, its reference samples, inputs to time it with, and ways of evaluating it."""

    name: str
    title: str
    about: str
    samples: tuple[Sample, ...]
    timed: Callable[[int], Inputs]
    """Parameters and arrays for about so many evaluations."""
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
        theta = np.arctan2(np.hypot(v[..., 0], v[..., 1]), v[..., 2])
        out += [theta, np.arctan2(v[..., 1], v[..., 0])]
    return tuple(out)
