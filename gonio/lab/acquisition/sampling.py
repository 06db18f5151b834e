"""Runs that grow: what a sampler is, and how a plan finds its own (docs/adaptive_sweeps.md)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from gonio import plugins
from gonio.errors import ConfigError
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.run import Run
from gonio.lab.rig.description import RigDescription
from gonio.typing import TomlTable


@dataclass(frozen=True, slots=True)
class Choice:
    """What is measured next, or that nothing is."""

    points: tuple[Point, ...]
    """Points in the order in which they are measured; the same point may come again. None: it is enough."""
    why: TomlTable = field(default_factory=dict)
    """What the journal keeps of the reasons: numbers and words, in lists and tables; numpy's too (`keepable`)."""
    message: str = ""
    """For the person who watches, in one line."""
    met: bool = False
    """Where it is enough: whether the target is reached, and not only the budget spent."""


class Sampler(Protocol):
    """What chooses the next points of a run. Its choice follows from the run on the disk alone."""

    def first(self, planned: Sequence[Point]) -> Sequence[Point]:
        """What is measured before anything is known, beside the points that the plan names itself."""

    def next(self, run: Run) -> Choice:
        """The next batch, after all steps so far were taken; every point of it can be reached on the rig."""


def about(sampler: Sampler) -> list[str]:
    """What a sampler will do, a line each: candidates, target, budget. Samplers may have a method `about` for it."""
    return list(getattr(sampler, "about", list)())


class SamplerPlugin(Protocol):
    """What an entry point of the group `gonio.choosers` names."""

    def open(self, plan: Plan, description: RigDescription) -> Sampler:
        """A sampler for a plan on a rig, by `plan.adaptive`.

        Raises `ConfigError` for a key that is wrong; the message names the plan's file, the key, value and remedy.
        """


def sampler_of(plan: Plan, description: RigDescription) -> tuple[Plan, Sampler | None]:
    """The sampler that a plan asks for, and the plan with the points that it wants first; the plan itself without one.

    Raises
    ------
    ConfigError
        There is no such sampler, or one of its keys is wrong.
    """
    if plan.adaptive is None:
        return plan, None
    try:
        plugin: SamplerPlugin = plugins.load("gonio.choosers", plan.adaptive.how)
    except ConfigError as error:
        raise ConfigError(f"{plan.source}: adaptive.how: {error}") from None
    sampler = plugin.open(plan, description)
    return replace(plan, points=(*plan.points, *sampler.first(plan.points))), sampler


def keepable(why: Mapping[str, Any], how: str) -> TomlTable:
    """The reasons of a sampler as JSON holds them: numpy's scalars and arrays become numbers and lists.

    A number that is not finite becomes None, as everywhere in a journal.

    Raises
    ------
    ConfigError
        Something else stands there; the message names the sampler, the key and what it is.
    """
    return {str(key): _plain(value, f"why[{key!r}]", how) for key, value in why.items()}


def _plain(value: Any, key: str, how: str) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, Mapping):
        return {str(name): _plain(part, f"{key}[{name!r}]", how) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part, f"{key}[{at}]", how) for at, part in enumerate(value)]
    raise ConfigError(
        f'the sampler "{how}" gives {key} = {value!r}, a {type(value).__name__}, as a reason; a journal keeps numbers, '
        "words, lists and tables: turn it into one of these in the sampler, and go on with --resume"
    )
