"""Cheaper forms of a model: others of its paper's, or of its program, that come near it in some directions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from gonio.models._htsg_series import TIERS
from gonio.models.corrected import Corrected
from gonio.models.eon import EON
from gonio.models.ggx import GGX, GGXMultiscatter
from gonio.models.he_torrance import HeTorrance
from gonio.models.lambert import Lambert
from gonio.models.model import Model
from gonio.models.oren_nayar import OrenNayar
from gonio.models.sum import Sum
from gonio.typing import Floats

FITTED = 512
"""Most directions that a form's parameters are fitted in."""
STEEPEST_DEG = 80.0


class Form(NamedTuple):
    """A cheaper form of a model."""

    name: str
    change: Callable[[Model], Model]
    bound: float = math.inf
    """Largest relative error anywhere that the model states of it; it may be `BEYOND` times as large."""


class ModelDirections(NamedTuple):
    """Directions that count, unit vectors (n, 3)."""

    toward: Floats
    away: Floats

    def fitted(self, cheap: Callable[..., Model], start: Sequence[float], most: Sequence[float], to: Model) -> Model:
        """The model `cheap` of as many numbers as `start` has, nearest to another by relative differences."""
        from scipy.optimize import least_squares

        some = slice(None, None, -(-len(self.toward) // FITTED))
        toward, away = self.toward[some], self.away[some]
        true = np.asarray(to.brdf_vectors(toward, away))
        lit = true > 0.0

        def off(p: Floats) -> Floats:
            return np.asarray(cheap(*p).brdf_vectors(toward[lit], away[lit])) / true[lit] - 1.0

        begin = np.clip(start, 1e-6, np.array(most) * (1.0 - 1e-6))
        return cheap(*least_squares(off, begin, bounds=(0.0, most), x_scale=most).x) if lit.any() else cheap(*begin)


def forms(model: Model, seen: ModelDirections) -> list[Form]:
    """Cheaper forms of a model, the cheapest first.

    Matt ones have their parameters fitted to the model in the directions `seen`.
    """
    if isinstance(model, OrenNayar):
        order = ("qualitative", "functional")
        cheaper = order[: order.index(model.form)] if model.form in order else order if model.form == "exact" else ()
        return [_lambert(seen), *(_oren_nayar(form, seen) for form in cheaper)]
    if isinstance(model, EON):
        return [_lambert(seen)]
    if isinstance(model, HeTorrance):
        return [_he_torrance(tier) for tier in sorted(TIERS, reverse=True) if tier > model.tolerance]
    if isinstance(model, GGXMultiscatter):
        return [Form("ggx", lambda m: GGX(m.alpha, m.ior, diffuse_albedo=m.diffuse_albedo))]  # type: ignore[attr-defined]
    if isinstance(model, Corrected):
        return [Form("without its misfit", lambda m: m.model)]  # type: ignore[attr-defined]
    if isinstance(model, Sum):
        return _of_sum(model, seen)
    return []


def _lambert(seen: ModelDirections) -> Form:
    return Form("lambert", lambda m: seen.fitted(Lambert, [0.5], [1.0], m))


def _oren_nayar(form: str, seen: ModelDirections) -> Form:
    def change(model: Model) -> Model:
        assert isinstance(model, OrenNayar)
        plain = replace(model, form=form, mean_slope_deg=0.0)  # the cheaper forms have no mean
        spread = math.hypot(model.sigma_deg, model.mean_slope_deg)
        if spread == 0.0 or model.albedo == 0.0:
            return plain

        def cheap(albedo: float, sigma_deg: float) -> Model:
            return replace(plain, albedo=albedo, sigma_deg=sigma_deg)

        return seen.fitted(cheap, [model.albedo, spread], [1.0, STEEPEST_DEG], model)

    return Form(form, change)


def _he_torrance(tier: float) -> Form:
    return Form(f"tolerance {tier:g}", lambda m: replace(m, tolerance=tier), tier)  # type: ignore[type-var]


def _of_sum(model: Sum, seen: ModelDirections) -> list[Form]:
    """Every combination of the terms' forms."""
    own = Form("", lambda m: m, 0.0)
    ladders = [[*forms(term, seen), own] for term, _ in model.terms]
    ranked = sorted(product(*(range(len(ladder)) for ladder in ladders)), key=sum)[:-1]
    return [_sum([ladder[k] for ladder, k in zip(ladders, ranks, strict=True)]) for ranks in ranked]


def _sum(each: Sequence[Form]) -> Form:
    def change(model: Model) -> Model:
        assert isinstance(model, Sum)
        return Sum(*((form.change(term), weight) for form, (term, weight) in zip(each, model.terms, strict=True)))

    return Form(", ".join(form.name for form in each if form.name), change, max(form.bound for form in each))


def full(model: Model) -> Model:
    """The dearest form of a model: Oren and Nayar's integral, He and Torrance's series to 1e-12."""
    if isinstance(model, OrenNayar) and model.form in ("functional", "qualitative"):
        return replace(model, form="exact")
    if isinstance(model, HeTorrance):
        return replace(model, tolerance=min(TIERS))
    return model
