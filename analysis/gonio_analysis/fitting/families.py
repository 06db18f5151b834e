"""The models that are fitted: their parameters, and how they are made of them."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Literal, TypeAlias

import numpy as np

from gonio.errors import ConfigError
from gonio_analysis.fitting.observations import Observations

Values = dict[str, float]
Arguments: TypeAlias = "dict[str, float | complex | str | tuple[tuple[float, float], ...] | Arguments]"
"""Of a model's constructor; of a sum, those of its parts by their names."""
Ior = complex | str | None
"""A constant n + ik, the name of a material, or None: not given."""


@dataclass(frozen=True)
class Parameter:
    """One fitted number: its bounds, and the scale that the search moves it on."""

    name: str
    lower: float
    upper: float
    scale: Literal["linear", "log"] = "linear"
    unit: str = ""
    geometry: bool = False
    """Whether it belongs to the surface, and so is the same at every wavelength."""

    def inside(self, value: float) -> float:
        """`value`, brought between the bounds."""
        return min(max(value, self.lower), self.upper)


@dataclass(frozen=True)
class Family:
    """A model as a fit sees it."""

    name: str
    parameters: tuple[Parameter, ...]
    """All that can be fitted."""
    free: tuple[str, ...]
    """Those that are fitted unless the user says otherwise."""
    fixed: Values
    """Values of those that are not fitted unless the user frees them."""
    arguments: Callable[[Values], Arguments]
    """Parameter values -> arguments of the model's constructor."""
    starts: Callable[[Observations], list[Values]]
    """Coarse grid over the parameters that the model depends on strongly (values for those only)."""
    needs_wavelength: bool = False
    derived: Callable[[Values], Values] = lambda values: {}
    """Combinations that say more than the parameters do."""
    flat: Callable[[Values], Values] = lambda values: {}
    """d(model)/d(parameter) [1/sr] of the parameters whose effect is the same in every direction."""

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name.

        Raises
        ------
        ConfigError
            The model has none (with the nearest name).
        """
        for p in self.parameters:
            if p.name == name:
                return p
        names = [p.name for p in self.parameters]
        near = difflib.get_close_matches(name, names, n=1)
        hint = f'did you mean "{near[0]}"?' if near else f"it has: {', '.join(names)}"
        raise ConfigError(f'{self.name} has no parameter "{name}" that can be fitted or fixed; {hint}')


_ALBEDO = Parameter("albedo", 1e-6, 1.0)
_DIFFUSE = Parameter("diffuse_albedo", 0.0, 1.0)
_N = Parameter("ior", 1.001, 200.0, "log")
_K = Parameter("k", 0.0, 100.0)


def parts(name: str) -> tuple[str, ...]:
    """The models that a name stands for: one, or the terms of a sum as in "oren-nayar+cook-torrance"."""
    return tuple(part.strip() for part in name.split("+"))


def _phong(ior: Ior) -> Family:
    def starts(data: Observations) -> list[Values]:
        diffuse, peak = _levels(data)
        return [
            {"k_d": min(diffuse, 1.0), "k_s": min(peak * scale, 100.0), "exponent": exponent}
            for exponent, scale in product((3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 10000.0), (0.3, 1.0))
        ]

    return Family(
        "phong",
        (
            Parameter("k_d", 0.0, 1.0),
            Parameter("k_s", 0.0, 1e4),
            Parameter("exponent", 0.1, 1e6, "log", geometry=True),
        ),
        ("k_d", "k_s", "exponent"),
        {},
        lambda v: {"k_d": v["k_d"], "k_s": v["k_s"], "exponent": v["exponent"]},
        starts,
    )


def _blinn(ior: Ior) -> Family:
    fixed, free, needs = _ior_defaults(ior, ("k_d", "k_s", "c", "ior"))

    def starts(data: Observations) -> list[Values]:
        diffuse, peak = _levels(data)
        grid = product((0.03, 0.08, 0.15, 0.3, 0.5, 0.8), (0.03, 0.3, 1.0), (1.5, 5.0, 50.0))
        return [{"k_d": min(diffuse, 1.0), "k_s": peak * scale, "c": c, "ior": n} for c, scale, n in grid]

    return Family(
        "blinn",
        (
            Parameter("k_d", 0.0, 1.0),
            Parameter("k_s", 0.0, 1e4),
            Parameter("c", 0.001, 1.0, "log", geometry=True),
            _N,
            _K,
        ),
        free,
        fixed,
        lambda v: {"k_d": v["k_d"], "k_s": v["k_s"], "c": v["c"], "ior": _ior_argument(v, ior)},
        starts,
        needs_wavelength=needs,
    )


def _cook_torrance(slopes: int, ior: Ior) -> Family:
    names = ("m",) if slopes == 1 else ("m_1", "m_2", "w_1")
    fixed, free, needs = _ior_defaults(ior, ("s", *names, "diffuse_albedo", "ior"))

    def arguments(v: Values) -> Arguments:
        slope = ((v["m"], 1.0),) if slopes == 1 else ((v["m_1"], v["w_1"]), (v["m_2"], 1.0 - v["w_1"]))
        # s + d = 1 to the last bit: the constructor refuses more
        return {
            "s": v["s"],
            "d": 1.0 - v["s"],
            "slopes": slope,
            "diffuse_albedo": v["diffuse_albedo"],
            "ior": _ior_argument(v, ior),
        }

    def starts(data: Observations) -> list[Values]:
        diffuse, _ = _levels(data)
        grid = product((0.005, 0.03, 0.08, 0.15, 0.25, 0.4, 0.7), (0.03, 0.2, 0.7), (1.5, 3.0, 20.0))
        out = [{"s": s, "m": m, "diffuse_albedo": min(diffuse / (1 - s), 1.0), "ior": n} for m, s, n in grid]
        if slopes == 1:
            return out
        pairs = [p for p in product((0.03, 0.08, 0.15, 0.25), (0.25, 0.5, 0.9)) if p[0] < p[1]]
        grid2 = product(pairs, (0.03, 0.2, 0.7), (1.5, 3.0, 20.0))
        return [
            {"s": s, "m_1": a, "m_2": b, "w_1": 0.5, "diffuse_albedo": min(diffuse / (1 - s), 1.0), "ior": n}
            for (a, b), s, n in grid2
        ]

    width = [
        Parameter(n, 0.0, 1.0, geometry=True) if n == "w_1" else Parameter(n, 0.0005, 3.0, "log", geometry=True)
        for n in names
    ]
    return Family(
        "cook-torrance",
        (Parameter("s", 0.0, 1.0), *width, _DIFFUSE, _N, _K),
        free,
        fixed,
        arguments,
        starts,
        needs_wavelength=needs,
        flat=lambda v: {"diffuse_albedo": (1.0 - v["s"]) / math.pi},
        derived=lambda v: {"d": 1.0 - v["s"]} | ({"w_2": 1.0 - v["w_1"]} if slopes == 2 else {}),
    )


def _he_torrance(ior: Ior) -> Family:
    fixed, free, _ = _ior_defaults(ior, ("sigma0_um", "tau_um", "diffuse_albedo", "ior"))

    def starts(data: Observations) -> list[Values]:
        diffuse, _ = _levels(data)
        known = data.wavelength_nm[np.isfinite(data.wavelength_nm)]
        wavelength_um = float(known.mean()) / 1e3 if known.size else 1.0
        roughness = (0.01, 0.03, 0.06, 0.1, 0.16, 0.25, 0.4, 0.6, 1.0, 2.0, 5.0)
        slope = (0.02, 0.05, 0.1, 0.17, 0.25, 0.35, 0.5, 0.8, 1.3)
        indices = (1.5,) if ior is not None else (1.3, 1.5, 3.0, 20.0)
        return [
            {"sigma0_um": r * wavelength_um, "tau_um": 2 * r * wavelength_um / m, "diffuse_albedo": a, "ior": n}
            for r, m, a, n in product(roughness, slope, {0.0, min(diffuse, 1.0)}, indices)
        ]

    return Family(
        "he-torrance",
        (
            Parameter("sigma0_um", 1e-4, 100.0, "log", "um", geometry=True),
            Parameter("tau_um", 1e-3, 1e4, "log", "um", geometry=True),
            _DIFFUSE,
            _N,
            _K,
        ),
        free,
        fixed,
        lambda v: {
            "sigma0_um": v["sigma0_um"],
            "tau_um": v["tau_um"],
            "diffuse_albedo": v["diffuse_albedo"],
            "ior": _ior_argument(v, ior),
        },
        starts,
        needs_wavelength=True,
        flat=lambda v: {"diffuse_albedo": 1.0 / math.pi},
        derived=lambda v: {"slope_m": 2.0 * v["sigma0_um"] / v["tau_um"]},
    )


def _anisotropic(ior: Ior) -> Family:
    fixed, free, needs = _ior_defaults(
        ior, ("s", "alpha_along", "alpha_across", "brushing_deg", "diffuse_albedo", "ior")
    )

    def starts(data: Observations) -> list[Values]:
        diffuse, _ = _levels(data)
        indices = (1.5,) if ior is not None else (1.5, 20.0)
        grid = product((0.03, 0.1, 0.3), (1.5, 4.0), (-45.0, 0.0, 45.0, 90.0), (0.03, 0.2, 0.7), indices)
        return [
            {
                "s": s,
                "alpha_along": alpha,
                "alpha_across": alpha * ratio,
                "brushing_deg": brushing,
                "diffuse_albedo": min(diffuse / (1 - s), 1.0),
                "ior": n,
            }
            for alpha, ratio, brushing, s, n in grid
        ]

    return Family(
        "anisotropic",
        (
            Parameter("s", 0.0, 1.0),
            Parameter("alpha_along", 0.002, 3.0, "log"),
            Parameter("alpha_across", 0.002, 3.0, "log"),
            # twice round, so that no direction of brushing lies at a bound
            Parameter("brushing_deg", -180.0, 180.0, unit="deg"),
            _DIFFUSE,
            _N,
            _K,
        ),
        free,
        fixed,
        lambda v: {
            **{n: v[n] for n in ("s", "alpha_along", "alpha_across", "brushing_deg", "diffuse_albedo")},
            "ior": _ior_argument(v, ior),
        },
        starts,
        needs_wavelength=needs,
        flat=lambda v: {"diffuse_albedo": (1.0 - v["s"]) / math.pi},
    )


def _retroreflecting(ior: Ior) -> Family:
    names = ("returned", "width_deg", "tail", "entrance", "diffuse_albedo")

    def starts(data: Observations) -> list[Values]:
        diffuse, _ = _levels(data)
        grid = product((0.01, 0.1, 0.5), (0.2, 1.0, 4.0, 15.0), (1.0, 2.0), (0.0, 1.0))
        return [
            dict(zip(names, (s, width, tail, entrance, min(diffuse / (1 - s), 1.0)), strict=True))
            for s, width, tail, entrance in grid
        ]

    return Family(
        "retroreflecting",
        (
            Parameter("returned", 0.0, 1.0),
            Parameter("width_deg", 0.01, 60.0, "log", "deg"),
            Parameter("tail", 0.5, 30.0, "log"),
            Parameter("entrance", 0.0, 20.0),
            _DIFFUSE,
        ),
        names,
        {},
        lambda v: {n: v[n] for n in names},
        starts,
        flat=lambda v: {"diffuse_albedo": (1.0 - v["returned"]) / math.pi},
    )


BASES = ("lambert", "oren-nayar", "retroreflecting")
GLOSSY = ("phong", "blinn", "cook-torrance", "he-torrance", "anisotropic", "retroreflecting")


def _sum(name: str, ior: Ior) -> Family:
    """A matte or retroreflecting base and a glossy model on it, whose own Lambertian part is left out.

    The level of the gloss lies in its own k_s or s; He-Torrance has none, and gets a weight.
    """
    terms = parts(name)
    if len(terms) != 2 or terms[0] not in BASES or terms[1] not in GLOSSY or terms[0] == terms[1]:
        raise ConfigError(f'"{name}": a sum to fit is one of {", ".join(BASES)} + another of {", ".join(GLOSSY)}')
    base, gloss = FAMILIES[terms[0]](ior), FAMILIES[terms[1]](ior)
    own = {"k_d", "diffuse_albedo"} & {p.name for p in gloss.parameters}
    level = (Parameter("weight", 0.0, 1.0),) if terms[1] == "he-torrance" else ()

    def arguments(v: Values) -> Arguments:
        shine = gloss.arguments({**v, **dict.fromkeys(own, 0.0)})
        return {
            terms[0]: {"weight": 1.0, **base.arguments(v)},
            terms[1]: {"weight": v.get("weight", 1.0), **shine},
        }

    def starts(data: Observations) -> list[Values]:
        albedo = _ALBEDO.inside(_levels(data)[0])
        bases: list[Values] = [{"albedo": albedo}]
        if terms[0] == "oren-nayar":
            bases = [{"albedo": albedo, "sigma_deg": 20.0}]
        elif terms[0] == "retroreflecting":
            lobe = {"returned": 0.1, "tail": 1.2, "entrance": 0.0, "diffuse_albedo": albedo}
            bases = [{**lobe, "width_deg": width} for width in (0.5, 2.0, 8.0)]
        shapes: dict[tuple[tuple[str, float], ...], None] = {}
        for values in gloss.starts(data):
            shapes[tuple((n, x) for n, x in values.items() if n not in own)] = None
        more: Values = {"weight": 0.5} if level else {}
        return [{**base, **dict(shape), **more} for base in bases for shape in shapes]

    return Family(
        name,
        (*base.parameters, *level, *(p for p in gloss.parameters if p.name not in own)),
        (*base.free, *(p.name for p in level), *(n for n in gloss.free if n not in own)),
        {n: x for n, x in gloss.fixed.items() if n not in own},
        arguments,
        starts,
        needs_wavelength=gloss.needs_wavelength,
        flat=base.flat,
        derived=gloss.derived if terms[1] == "he-torrance" else lambda values: {},
    )


def _ior_defaults(ior: Ior, free: tuple[str, ...]) -> tuple[Values, tuple[str, ...], bool]:
    """Fixed values, free parameters, and whether the wavelength matters, for what is known of the optical constants."""
    if ior is None:
        return {"k": 0.0}, free, False
    rest = tuple(name for name in free if name != "ior")
    if isinstance(ior, str):
        return {}, rest, True
    return {"ior": ior.real, "k": ior.imag}, rest, False


def _ior_argument(values: Values, ior: Ior) -> float | complex | str:
    if isinstance(ior, str):
        return ior
    return complex(values["ior"], values["k"]) if values["k"] else values["ior"]


def _levels(data: Observations) -> tuple[float, float]:
    """Albedos [1] that a diffuse floor and the highest value of the data would have as Lambertian reflectors."""
    low, high = np.quantile(data.brdf, [0.1, 1.0])
    return max(math.pi * float(low), 0.0), max(math.pi * float(high), 1e-6)


def _lambert(ior: Ior) -> Family:
    return Family(
        "lambert",
        (_ALBEDO,),
        ("albedo",),
        {},
        lambda v: {"albedo": v["albedo"]},
        lambda data: [{"albedo": _ALBEDO.inside(math.pi * float(np.median(data.brdf)))}],
        flat=lambda v: {"albedo": 1.0 / math.pi},
    )


def _oren_nayar(ior: Ior) -> Family:
    return Family(
        "oren-nayar",
        (_ALBEDO, Parameter("sigma_deg", 0.0, 60.0, unit="deg", geometry=True)),
        ("albedo", "sigma_deg"),
        {},
        lambda v: {"albedo": v["albedo"], "sigma_deg": v["sigma_deg"]},
        lambda data: [
            {"albedo": _ALBEDO.inside(scale * math.pi * float(np.median(data.brdf))), "sigma_deg": sigma}
            for scale, sigma in product((0.5, 1.0, 1.3), (5.0, 25.0, 45.0))
        ],
    )


FAMILIES: Mapping[str, Callable[[Ior], Family]] = {
    "lambert": _lambert,
    "oren-nayar": _oren_nayar,
    "phong": _phong,
    "blinn": _blinn,
    "cook-torrance": lambda ior: _cook_torrance(1, ior),
    "he-torrance": _he_torrance,
    "anisotropic": _anisotropic,
    "retroreflecting": _retroreflecting,
}
