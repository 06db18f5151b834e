"""What is fitted of each model: parameters, bounds, scales, and where to start.

A model that is not listed here (another package's, from the entry-point group `gonio.models`) is fitted as its class
declares it by `fitted` (docs/writing_a_model.md).
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from itertools import product
from typing import Any

from gonio.errors import ConfigError
from gonio_analysis.fitting.families import (
    FAMILIES,
    Family,
    Ior,
    Parameter,
    Values,
    _cook_torrance,
    _levels,
    _sum,
    parts,
)
from gonio_analysis.fitting.observations import Observations

METALLIC_N = Parameter("ior", 0.02, 200.0, "log")
"""n where k is fitted too: good conductors have n < 1, which without absorption means total reflection."""
INDICES = ((1.5, 0.3), (0.3, 3.0), (1.0, 7.0), (3.0, 3.5))
"""n and k that a search for both starts from: a glass, silver, aluminium, iron."""


def family(name: str, *, slopes: int = 1, ior: Ior = None) -> Family:
    """The family of a model by its name on the command line.

    Parameters
    ----------
    name
        As in `gonio fit --model NAME`.
    slopes
        Slopes of Cook-Torrance's facet distribution, 1 or 2.
    ior
        Optical constants, where they are known: they are then fixed.

    Raises
    ------
    ConfigError
        No such model can be fitted, or an option does not belong to it.
    """
    if "+" in name:
        if slopes != 1:
            raise ConfigError(f"--slopes {slopes}: only cook-torrance has several slopes, not {name}")
        return _sum(name, ior)
    others = plugin_models() if name not in FAMILIES else ()
    if name not in FAMILIES and name not in others:
        known = [*FAMILIES, *others]
        near = difflib.get_close_matches(name, known, n=1)
        hint = f'did you mean "{near[0]}"?' if near else f"known: {', '.join(known)}"
        raise ConfigError(f'there is no model named "{name}" to fit; {hint}')
    if slopes != 1 and name != "cook-torrance":
        raise ConfigError(f"--slopes {slopes}: only cook-torrance has several slopes, not {name}")
    if slopes not in (1, 2):
        raise ConfigError(f"--slopes {slopes}: 1 or 2 slopes can be fitted")
    if name == "cook-torrance":
        return _cook_torrance(slopes, ior)
    return FAMILIES[name](ior) if name in FAMILIES else _declared(name)


def plugin_models() -> tuple[str, ...]:
    """Names of the models that other packages bring."""
    from gonio import plugins

    return tuple(name for name in plugins.available("gonio.models") if name not in FAMILIES)


def declared() -> tuple[str, ...]:
    """Those of them that declare what is fitted; a model whose import fails is none of them."""
    out = []
    for name in plugin_models():
        try:
            _declared(name)
        except ConfigError:
            continue
        out.append(name)
    return tuple(out)


def _declared(name: str) -> Family:
    """The family of another package's model, as its class declares it."""
    from gonio import plugins
    from gonio.models import Fitted

    kind = plugins.load("gonio.models", name)
    rows: Mapping[str, Fitted] = getattr(kind, "fitted", {})
    if not rows:
        raise ConfigError(
            f'the model "{name}" does not say what of it is fitted: its class needs `fitted`, bounds and scales by'
            " the names of its parameters"
        )
    for key, row in rows.items():
        if not isinstance(row, Fitted):
            raise ConfigError(f'the model "{name}": fitted["{key}"] has to be a gonio.models.Fitted, not {row!r}')
    free = tuple(key for key, row in rows.items() if row.fixed is None)

    def starts(data: Observations) -> list[Values]:
        diffuse, peak = _levels(data)
        grid = []
        for key in free:
            row = rows[key]
            if isinstance(row.starts, str):
                level = diffuse if row.starts == "diffuse" else peak
                some = [level] if row.starts == "diffuse" else [0.03 * level, 0.3 * level, level]
            elif row.starts:
                some = list(row.starts)
            elif row.scale == "log":
                some = [row.lower ** (1 - q) * row.upper**q for q in (0.2, 0.5, 0.8)]
            else:
                some = [row.lower + (row.upper - row.lower) * q for q in (0.2, 0.5, 0.8)]
            grid.append([min(max(x, row.lower), row.upper) for x in some])
        return [dict(zip(free, values, strict=True)) for values in product(*grid)]

    return Family(
        name,
        tuple(Parameter(key, row.lower, row.upper, row.scale, row.unit, row.geometry) for key, row in rows.items()),
        free,
        {key: row.fixed for key, row in rows.items() if row.fixed is not None},
        lambda v: dict(v),
        starts,
        needs_wavelength=kind.needs_wavelength,
    )


def needs_ior(name: str) -> bool:
    """Whether optical constants mean something to this model."""
    return any(part in ("blinn", "cook-torrance", "he-torrance", "anisotropic") for part in parts(name))


def maker(name: str) -> Callable[[Mapping[str, Any]], Any]:
    """What builds models of a family from the constructor's arguments; looked up once, called hundreds of times.

    Of a sum the arguments are one table a term, as `gonio.models.build("sum", ...)` takes them.
    """
    from gonio import plugins
    from gonio.models import Sum
    from gonio.models.model import build_model

    kinds = {part: plugins.load("gonio.models", part) for part in parts(name)}
    if len(kinds) == 1:
        return lambda arguments: build_model(kinds[name], name, arguments)

    def summed(terms: Mapping[str, Any]) -> Any:
        split = [(part, {k: v for k, v in own.items() if k != "weight"}, own["weight"]) for part, own in terms.items()]
        return Sum(*((build_model(kinds[part], part, own), weight) for part, own, weight in split))

    return summed
