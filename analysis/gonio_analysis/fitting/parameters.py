"""Models by name, as fits see them: what their classes declare (`gonio.models.parameters`), and sums of two."""

import inspect
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from gonio import plugins
from gonio.errors import ConfigError, did_you_mean
from gonio.models import Sum
from gonio.models.model import Model, build_model
from gonio.models.parameters import ALBEDO, Arguments, Declaration, Fitted, Ior, Levels, Values, described
from gonio_analysis.fitting.observations import Observations

INDICES = ((1.5, 0.3), (0.3, 3.0), (1.0, 7.0), (3.0, 3.5))
"""n and k that a search for both starts from: a glass, silver, aluminium, iron."""


def kind(name: str) -> type[Model]:
    """The class of a single model; raises `ConfigError` where there is none, or its import fails."""
    loaded: type[Model] = plugins.load("gonio.models", name)
    return loaded


def known(role: str = "") -> tuple[str, ...]:
    """Names of the models that can be loaded, by their rank; of those that play a role in sums, where one is asked."""
    found = {}
    for name in plugins.available("gonio.models"):
        with suppress(ConfigError):
            found[name] = kind(name)
    every = sorted(found, key=lambda name: (found[name].rank, name))
    return tuple(name for name in every if not role or role in found[name].in_sums.split())


def declared() -> tuple[str, ...]:
    """Those of them that say what of them is fitted."""
    out = []
    for name in known():
        with suppress(ConfigError):
            kind(name).declaration()
            out.append(name)
    return tuple(out)


def family(name: str, *, slopes: int = 1, ior: Ior = None) -> Declaration:
    """What a fit may move of a model, by its name on the command line.

    Parameters
    ----------
    name
        As in `gonio fit --model NAME`.
    slopes
        Slopes of the facet distribution, 1 or 2.
    ior
        Optical constants, where they are known: they are then fixed.

    Raises
    ------
    ConfigError
        No such model can be fitted, or an option does not belong to it.
    """
    if "+" not in name and not _there(name):
        hint = did_you_mean(name, known(), f"known: {', '.join(known())}")
        raise ConfigError(f'there is no model named "{name}" to fit; {hint}')
    if slopes != 1 and ("+" in name or not kind(name).several_slopes):
        several = ", ".join(one for one in known() if kind(one).several_slopes)
        raise ConfigError(f"--slopes {slopes}: only {several} has several slopes, not {name}")
    if slopes not in (1, 2):
        raise ConfigError(f"--slopes {slopes}: 1 or 2 slopes can be fitted")
    return _sum(name, ior) if "+" in name else kind(name).declaration(ior, slopes)


def told(of: type[Model]) -> list[tuple[str, str, str, str, str, str]]:
    """Of each parameter of a model's class: name, unit, default, what is allowed, bounds of a fit, and what it is."""
    table, defaults, texts = {**of.table, **of.besides}, inspect.signature(of).parameters, described(of)
    fitted: Mapping[str, Fitted] = {}
    with suppress(ConfigError):  # nothing of it is fitted
        fitted = of.declaration().parameters
    rows = []
    for name in dict.fromkeys([*defaults, *fitted]):
        row, search = table.get(name), fitted.get(name)
        given = defaults[name].default if name in defaults else None
        default = "" if given in (None, inspect.Parameter.empty) else str(given)
        bounds = "" if search is None else f"{search.lower:g} to {search.upper:g}"
        unit, allowed, text = (row.unit, row.range, row.text) if row else ("", "", texts.get(name, ""))
        rows.append((name, unit, default, allowed.removesuffix(f" {unit}"), bounds, text.replace("`", "")))
    return rows


def parts(name: str) -> tuple[str, ...]:
    """The models that a name stands for: one, or the terms of a sum as in "oren-nayar+cook-torrance"."""
    return tuple(part.strip() for part in name.split("+"))


def sums() -> tuple[str, ...]:
    """Sums that are tried unasked: the bases that a glossy model names, under its gloss."""
    return tuple(f"{base}+{gloss}" for gloss in known() for base in kind(gloss).bases)


def needs_ior(name: str) -> bool:
    """Whether optical constants mean something to this model."""
    return any(_there(part) and kind(part).has_ior for part in parts(name))


def _there(name: str) -> bool:
    return plugins.in_file(name) or name in plugins.available("gonio.models")


def tells_index(name: str) -> bool:
    """Whether data may tell n + ik of this model."""
    return needs_ior(name) and not any(kind(part).hides_index for part in parts(name))


def levels(data: Observations) -> Levels:
    """What starts are made of."""
    low, high = np.quantile(data.brdf, [0.1, 1.0])
    known = data.wavelength_nm[np.isfinite(data.wavelength_nm)]
    return Levels(
        max(math.pi * float(low), 0.0),
        math.pi * float(np.median(data.brdf)),
        max(math.pi * float(high), 1e-6),
        float(known.mean()) / 1e3 if known.size else 1.0,
    )


def maker(name: str) -> Callable[[Mapping[str, Any]], Any]:
    """What builds models of a family from the constructor's arguments; looked up once, called hundreds of times.

    Of a sum the arguments are one table a term, as `gonio.models.build("sum", ...)` takes them.
    """
    kinds = {part: kind(part) for part in parts(name)}
    if len(kinds) == 1:
        return lambda arguments: build_model(kinds[name], name, arguments)

    def summed(terms: Mapping[str, Any]) -> Any:
        split = [(part, {k: v for k, v in own.items() if k != "weight"}, own["weight"]) for part, own in terms.items()]
        return Sum(*((build_model(kinds[part], part, own), weight) for part, own, weight in split))

    return summed


def _sum(name: str, ior: Ior) -> Declaration:
    """A matte or retroreflecting base and a glossy model on it, whose own Lambertian part is left out.

    The level of the gloss lies in its own k_s or s; one that has none gets a weight.
    """
    terms, bases, glosses = parts(name), known("base"), known("gloss")
    if len(terms) != 2 or terms[0] not in bases or terms[1] not in glosses or terms[0] == terms[1]:
        raise ConfigError(f'"{name}": a sum to fit is one of {", ".join(bases)} + another of {", ".join(glosses)}')
    base, gloss = (kind(term).declaration(ior) for term in terms)
    own = {"k_d", "diffuse_albedo"} & gloss.parameters.keys()
    weighted = "weighted" in kind(terms[1]).in_sums.split()
    level = {"weight": Fitted(0.0, 1.0)} if weighted else {}
    if weighted and "albedo" in base.parameters:  # of a gloss whose own may be 0
        level["albedo"] = replace(base.parameters["albedo"], lower=0.0)

    def arguments(v: Values) -> Arguments:
        shine = gloss.arguments({**v, **dict.fromkeys(own, 0.0)})
        return {terms[0]: {"weight": 1.0, **base.arguments(v)}, terms[1]: {"weight": v.get("weight", 1.0), **shine}}

    def starts(levels: Levels) -> list[Values]:
        bases = base.base_starts(min(max(levels.diffuse, ALBEDO[0]), ALBEDO[1]))
        shapes: dict[tuple[tuple[str, float], ...], None] = {}
        for values in gloss.starts(levels):
            shapes[tuple((n, x) for n, x in values.items() if n not in own)] = None
        more: Values = {"weight": 0.5} if weighted else {}
        return [{**base, **dict(shape), **more} for base in bases for shape in shapes]

    return Declaration(
        name,
        {**base.parameters, **level, **{n: p for n, p in gloss.parameters.items() if n not in own}},
        (*base.free, *({"weight"} & level.keys()), *(n for n in gloss.free if n not in own)),
        {n: x for n, x in gloss.fixed.items() if n not in own},
        arguments,
        starts,
        needs_wavelength=gloss.needs_wavelength,
        flat=base.flat,
        derived=gloss.derived if weighted else lambda values: {},
    )
