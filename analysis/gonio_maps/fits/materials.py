"""Materials that the pixels of a map share: parameters of each, and which pixel is of which.

The pixels' own fits are brought together by k-means, in units of their uncertainties. Then two steps alternate until
nothing changes: each material is fitted to the values of its pixels together, and each pixel goes to the material whose
model has the least chi-square there. How many materials there are follows from values that are left out: half of the
points of a pixel tell its material, which predicts the other half.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from gonio_analysis.fitting.observations import DEFAULT_WAVELENGTH_NM
from gonio_analysis.fitting.problem import FitRequest, pose

from gonio.errors import DataError
from gonio.geometry import Directions
from gonio.threads import in_threads
from gonio.typing import Floats
from gonio_maps.files import MapFile, Parts, Tile, Variable
from gonio_maps.fits.pixels import PixelPlan, read_tile
from gonio_maps.models import batch_spectra

MOST_DRAWN = 2000
"""Pixels that materials are found from, drawn of more."""
MOST_TOGETHER = 300
"""Pixels of a material that are fitted together, evenly taken of more."""
MOST_MATERIALS = 8
"""Materials that are tried, where their number is sought."""
TURNS, TRIES = 20, 8
LEAST_OWN = 0.1
"""Part of a value's uncertainty that counts as its own, at least."""
EFFORT = 4e7
"""Pixels times points cubed of a joint fit with a cause a point, about: half a second."""
NOBODY = -1
"""Membership of a pixel without a fit."""

Whole = npt.NDArray[np.intp]


@dataclass(frozen=True)
class PixelValues:
    """Values of some pixels."""

    x_mm: Floats
    y_mm: Floats
    values: Floats
    """BRDF [1/sr] of one wavelength after the other, shape (P, n); NaN where flagged."""
    u: Floats

    def __getitem__(self, which: Any) -> PixelValues:
        return PixelValues(self.x_mm[which], self.y_mm[which], self.values[which], self.u[which])

    def only(self, points: npt.NDArray[np.bool_]) -> PixelValues:
        """Without the values at other points."""
        return replace(self, values=np.where(points, self.values, np.nan))


@dataclass(frozen=True)
class MapMaterial:
    """A model that pixels share."""

    values: Floats
    """Of the free parameters, in the order of `PixelPlan.columns`."""
    u: Floats
    chi_square: float
    """A degree of freedom, of the joint fit."""
    models: list[Any]
    """One a wavelength."""


class Mixture:
    """Finds materials of pixels under a plan."""

    def __init__(self, plan: PixelPlan) -> None:
        self._plan, self._plans = plan, (plan, *plan.others)
        self._ends = np.cumsum([len(one.points) for one in self._plans])
        self._common = np.concatenate([one.common for one in self._plans], axis=1)
        # what all pixels of a point share is a cause of its own for each point: it does not average out
        self._u_point = np.concatenate([one.u_point for one in self._plans])
        self._of_points = np.diag(self._u_point)[self._u_point > 0]
        most = int(EFFORT / max(self._u_point.size, 1) ** 3) if self._u_point.any() else MOST_TOGETHER
        self._most = min(max(most, 4), MOST_TOGETHER)
        self._problem = pose(FitRequest(plan.model, fix={n: v for n, v in plan.fixed.items() if n not in ("ior", "k")}))

    def together(self, pixels: PixelValues) -> MapMaterial:
        """One model fitted to all values of some pixels."""
        plan, count = self._plan, len(pixels.x_mm)
        some = pixels[np.unique(np.linspace(0, count - 1, min(count, self._most)).astype(int))]
        spots = np.stack([some.x_mm, some.y_mm, np.zeros_like(some.x_mm)], axis=1)[:, None]
        own = np.sqrt(np.maximum(some.u**2 - (some.values * self._u_point) ** 2, (LEAST_OWN * some.u) ** 2))
        common, times = np.concatenate([self._common, self._of_points]), len(some.x_mm)
        bands = []
        for one, end in zip(self._plans, self._ends, strict=True):
            at = slice(end - len(one.points), end)
            source, camera = ((place - spots).reshape(-1, 3) for place in (one.source_mm, one.camera_mm))
            bands.append(batch_spectra.Band(
                source, camera, some.values[:, at].reshape(1, -1), own[:, at].reshape(1, -1),
                np.tile(common[:, at], times), one.fixed, np.tile(one.blocks, times), _known(one.wavelength_nm),
            ))  # fmt: skip
        found = batch_spectra.fit(plan.model, np.zeros(1), np.zeros(1), bands, plan.geometry)
        values = [dict(zip(one.names, one.values[0], strict=True)) for one in found]
        u = [dict(zip(one.free, one.u[0], strict=True)) for one in found]
        of_free, of_u = (np.array([each[k][name] for k, name in plan.numbered]) for each in (values, u))
        if not np.isfinite(of_free).all():
            raise DataError("a material has too few values to be fitted; ask for fewer --materials")
        freedom = found[0].used[0] - len(plan.columns)
        return MapMaterial(of_free, of_u, float(found[0].chi_square[0] / freedom), [self._model(one) for one in values])

    def _model(self, values: dict[str, float]) -> Any:
        return self._problem.make(self._problem.family.arguments({**self._problem.fixed, **values}))

    def chi_square(self, pixels: PixelValues, material: MapMaterial) -> Floats:
        """Chi-square of each pixel's values with the model of a material (P,)."""
        spots = np.stack([pixels.x_mm, pixels.y_mm, np.zeros_like(pixels.x_mm)], axis=1)[:, None]
        of_each = []
        for plan, one in zip(self._plans, material.models, strict=True):
            at = Directions.from_vectors(plan.source_mm - spots, plan.camera_mm - spots)
            of_each.append(np.asarray(one.brdf(*at.angles, wavelength_nm=_known(plan.wavelength_nm))))
        model = np.concatenate(of_each, axis=1)
        used = np.isfinite(pixels.values) & (pixels.u > 0)
        weight = np.where(used, 1.0 / np.where(used, pixels.u, 1.0), 0.0)
        residual = np.where(used, pixels.values - model, 0.0) * weight
        total = np.einsum("pn,pn->p", residual, residual)
        if len(self._common):
            causes = self._common * (model * weight)[:, None]
            inner = np.eye(len(self._common)) + np.einsum("prn,psn->prs", causes, causes)
            seen = np.einsum("prn,pn->pr", causes, residual)
            total -= np.einsum("pr,pr->p", seen, np.linalg.solve(inner, seen[..., None])[..., 0])
        return np.asarray(total)

    def nearest(self, pixels: PixelValues, materials: list[MapMaterial]) -> tuple[Whole, Floats]:
        """The material of each pixel, and its chi-square there."""
        every = np.array([self.chi_square(pixels, one) for one in materials])
        best = every.argmin(axis=0)
        return best, every[best, np.arange(best.size)]

    def found(self, pixels: PixelValues, own: Floats, u: Floats, count: int) -> list[MapMaterial]:
        """`count` materials of some pixels, or fewer where one loses its last pixel; the largest first."""
        member = _k_means(own, u, count)
        for _ in range(TURNS):
            kinds, sizes = np.unique(member, return_counts=True)
            order = kinds[np.argsort(-sizes, kind="stable")]
            materials = [self.together(pixels[member == kind]) for kind in order]
            before, member = member, self.nearest(pixels, materials)[0]
            if np.array_equal(order[member], before):
                break
        return materials

    def left_out(self, pixels: PixelValues, materials: list[MapMaterial]) -> Floats:
        """Chi-square of each pixel's values, each half of the points predicted by the material of the other half."""
        odd = np.arange(pixels.values.shape[1]) % 2 == 1
        total = np.zeros(len(pixels.x_mm))
        for half in (odd, ~odd):
            member = self.nearest(pixels.only(~half), materials)[0]
            every = np.array([self.chi_square(pixels.only(half), one) for one in materials])
            total += every[member, np.arange(member.size)]
        return total


def _known(wavelength_nm: float) -> float:
    """A wavelength [nm], or the one that stands for a band without any."""
    return DEFAULT_WAVELENGTH_NM if math.isnan(wavelength_nm) else wavelength_nm


def _k_means(own: Floats, u: Floats, count: int) -> Whole:
    """The group of each pixel, by parameters in units of their uncertainties: the best of several tries.

    What is not known of a pixel (NaN) does not count there.
    """
    known = np.isfinite(own) & np.isfinite(u)
    weight = np.where(known, 1.0 / np.where(known, u, 1.0) ** 2, 0.0)
    own = np.where(known, own, np.nanmedian(np.where(known, own, np.nan), axis=0))
    rng = np.random.default_rng(count)
    tries = [_grouped(own, weight, count, rng) for _ in range(TRIES if count > 1 else 1)]
    return min(tries, key=lambda found: found[1])[0]


def _grouped(own: Floats, weight: Floats, count: int, rng: np.random.Generator) -> tuple[Whole, float]:
    """Groups that begin far from each other, and the sum of squares within them."""

    def squares(centres: list[Floats]) -> Floats:
        return np.array([(weight * (own - centre) ** 2).sum(axis=1) for centre in centres])

    centres = [own[rng.integers(len(own))]]
    while len(centres) < count:
        nearest = squares(centres).min(axis=0)
        chance = np.minimum(nearest, np.quantile(nearest, 0.95)) + 1e-300  # a few that are far from all are no group
        centres.append(own[rng.choice(len(own), p=chance / chance.sum())])
    member = np.full(len(own), NOBODY)
    for _ in range(100):
        every = squares(centres)
        before, member = member, every.argmin(axis=0)
        if np.array_equal(before, member):
            break
        for kind in np.unique(member):
            of = member == kind
            total = weight[of].sum(axis=0)
            centre = (weight[of] * own[of]).sum(axis=0) / np.where(total > 0.0, total, 1.0)
            centres[kind] = np.where(total > 0.0, centre, centres[kind])
    return member, float(every.min(axis=0).sum())


def variables(
    map_file: MapFile, parts: Parts, plan: PixelPlan, count: int | None, say: Callable[[str], None]
) -> tuple[dict[str, int], dict[str, Variable]]:
    """Dimensions and variables of the materials of a map whose tiles are fitted.

    Parameters
    ----------
    map_file, parts, plan
        The map, its tiles that are done, and what was fitted.
    count
        How many materials; None: as many as predict values best that are left out.
    say
        Told a line for a person.

    Raises
    ------
    DataError
        Too few pixels are fitted.
    """
    mixture, (pixels, own, u) = Mixture(plan), _drawn(map_file, parts, plan)
    if len(own) < 2 * (count or 1):
        raise DataError(f"{map_file.path}: {len(own)} pixels with a parameter that is known are too few for materials")
    wanted = _best_count(mixture, pixels, own, u, say) if count is None else count
    materials = mixture.found(pixels, own, u, wanted)
    if len(materials) < wanted:
        say(f"{len(materials)} materials are left of {wanted}: no pixel is nearest to the others")
    member, chi = np.full(map_file.shape, NOBODY, np.int16), np.full(map_file.shape, np.nan, np.float32)

    def assign(tile: Tile) -> None:
        some = _pixels(map_file, tile, plan)
        best, least = mixture.nearest(some, materials)
        used = (np.isfinite(some.values) & (some.u > 0)).sum(axis=1)
        there = used > len(plan.columns)
        member[tile.rows, tile.cols] = np.where(there, best, NOBODY).reshape(tile.shape)
        chi[tile.rows, tile.cols] = np.where(there, least / np.maximum(used, 1), np.nan).reshape(tile.shape)

    for _ in in_threads(assign, map_file.tiles()):
        pass
    return {"material": len(materials)}, _layout(plan, materials, member, chi)


def _layout(
    plan: PixelPlan, materials: list[MapMaterial], member: npt.NDArray[np.int16], chi: npt.NDArray[np.float32]
) -> dict[str, Variable]:
    each, yx = ("material",), ("y", "x")
    out = {
        "membership": Variable(yx, member, "i2", about=f"material of the pixel, from 0; {NOBODY} without a fit"),
        "membership_chi_square": Variable(yx, chi, "f4", about="chi-square a value with the model of the material"),
        "material_pixels": Variable(each, np.array([(member == k).sum() for k in range(len(materials))]), "i8",
                                    about="pixels of the material"),
        "material_chi_square": Variable(each, np.array([one.chi_square for one in materials]),
                                        about="chi-square a degree of freedom of the joint fit"),
    }  # fmt: skip
    for k, (name, unit) in enumerate(plan.columns.items()):
        about = f"{name} of the material, of its pixels together"
        out[f"material_{name}"] = Variable(each, np.array([m.values[k] for m in materials]), units=unit, about=about)
        error = np.array([m.u[k] if m.u[k] > 0 else np.nan for m in materials])
        out[f"u_material_{name}"] = Variable(each, error, units=unit, about=f"standard uncertainty of {about}")
    return out


def _pixels(map_file: MapFile, tile: Tile, plan: PixelPlan) -> PixelValues:
    """Those of a tile, with the values of all wavelengths."""
    places = read_tile(map_file, tile)
    bands = [PixelValues(*places.values(one.points)) for one in (plan, *plan.others)]
    values, u = (np.concatenate([getattr(band, name) for band in bands], axis=1) for name in ("values", "u"))
    return replace(bands[0], values=values, u=u)


def _drawn(map_file: MapFile, parts: Parts, plan: PixelPlan) -> tuple[PixelValues, Floats, Floats]:
    """Some pixels of which a parameter is known, evenly drawn over the map, with parameters and uncertainties."""

    def known(tile: Tile) -> tuple[Whole, Floats, Floats]:
        found = parts.read(tile, *(f"{p}{n}" for n in plan.columns for p in ("", "u_")))
        own, u = (np.stack([found[f"{p}{n}"].ravel() for n in plan.columns], axis=1) for p in ("", "u_"))
        good = np.flatnonzero((np.isfinite(own) & np.isfinite(u)).any(axis=1))
        return good, own[good], u[good]

    every = map_file.tiles()
    counts = [known(tile)[0].size for tile in every]
    kept = np.zeros(sum(counts), bool)
    kept[np.random.default_rng(0).permutation(kept.size)[:MOST_DRAWN]] = True
    begin, pixels, owns, us = 0, [], [], []
    for tile, count in zip(every, counts, strict=True):
        of = kept[begin : begin + count]
        begin += count
        if of.any():
            good, own, u = known(tile)
            pixels.append(_pixels(map_file, tile, plan)[good[of]])
            owns.append(own[of])
            us.append(u[of])
    if not pixels:
        raise DataError(f"{map_file.path}: no pixel has a parameter that is known: there are no materials to find")
    joined = (np.concatenate([getattr(one, name) for one in pixels]) for name in ("x_mm", "y_mm", "values", "u"))
    return PixelValues(*joined), np.concatenate(owns), np.concatenate(us)


def _best_count(mixture: Mixture, pixels: PixelValues, own: Floats, u: Floats, say: Callable[[str], None]) -> int:
    """The smallest number of materials that predicts as well as any, to one standard error of the difference."""
    train = np.random.default_rng(1).permutation(len(own)) % 2 == 0
    scores = []
    for count in range(1, min(MOST_MATERIALS, train.sum() // 2) + 1):
        scores.append(mixture.left_out(pixels[~train], mixture.found(pixels[train], own[train], u[train], count)))
    best = scores[int(np.argmin([score.mean() for score in scores]))]
    worse = [score - best for score in scores]
    count = 1 + next(k for k, w in enumerate(worse) if w.mean() <= w.std() / math.sqrt(w.size))
    values = float(np.isfinite(pixels.values[~train]).sum(axis=1).mean())
    told = ", ".join(f"{k}: {score.mean() / values:.4g}" for k, score in enumerate(scores, 1))
    say(f"chi-square a value that was left out, by the number of materials: {told}; {count} are taken")
    return count
