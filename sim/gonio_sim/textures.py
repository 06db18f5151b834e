"""A sample whose parameters change over it: which levels of its textures each pixel sees, and how much of each.

The model is evaluated at levels of the textures alone. A texture of few values (a pattern, a picture of some shades)
has those as its levels. Any other has levels between which the BRDF is interpolated by cubics: an interval is halved
until its middle is predicted within `TOLERANCE`, or there are `MOST` levels; the worst intervals come first.

A pixel sees the mean over its own area: some spots of it, each with the weights of the levels around its value.

Levels are the values of a pattern or picture, if there are at most 64, else 9 to 65 with a cubic between them, of an
error of 1e-4. Tenfold gradients of roughness are followed within 1.1e-4. Levels of several textures multiply, to at
most 4225. Pixels away from edges agree with a model of their own parameters within 2e-4
(`tests/gonio_sim/test_textures.py`). A pixel's share beside an edge is right to 1/68 along rows and columns, otherwise
to 3/34.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from scipy import sparse

from gonio import models
from gonio.errors import ConfigError
from gonio.lab.rig.imaging import PixelMap
from gonio.samples.description import SampleDescription
from gonio.samples.regions import areas
from gonio.typing import Bools, Floats, NDArray
from gonio_sim.adaptive_grid import DARK, FLOOR, TOLERANCE

SPOTS = 34, 21
"""Spots in a pixel, on a lattice of Fibonacci's: how many, and its step. Across and down no two are alike, so that an
edge along rows or columns divides a pixel to 1/68."""
FEW_SPOTS = 5, 2
"""The same where no texture has steps."""
FEWEST, MOST = 9, 65
"""Levels of a texture of many values."""
MOST_TOGETHER = 65**2
"""Levels of all textures together."""
AT_ONCE = 1 << 20
"""Weights that are counted together."""
Whole = NDArray[np.int64]
Probe = Callable[[models.Model], Floats]
"""What a model shows in a view: values of one kind in each row."""


@dataclass(frozen=True, slots=True)
class TextureLevel:
    """What some pixels see of one level of the textures."""

    model: models.Model
    rows: Whole
    cols: Whole
    weight: Floats
    """Weight of the level in each of these pixels; over all levels they add up to 1, and some may be negative."""


class Textures:
    """The textures of a sample, and its models.

    Raises
    ------
    ConfigError, DataError
        A picture cannot be read, or a model does not take a value.
    """

    def __init__(self, sample: SampleDescription, *, steps: bool = False) -> None:
        """With `steps` pixels have `SPOTS`, whether the textures have steps or not."""
        self._sample = sample
        where = f'sample "{sample.name}", texture'
        self._names = list(sample.texture)
        self._loaded = [sample.texture[name].load(f"{where}.{name}") for name in self._names]
        self._of_few = [one.occurring is not None and len(one.occurring) < MOST for one in self._loaded]
        self._spots = SPOTS if steps or any(one.occurring is not None for one in self._loaded) else FEW_SPOTS
        self._model = lru_cache(maxsize=MOST_TOGETHER)(self._built)
        self._model((0.0,) * len(self._names))
        self._model((1.0,) * len(self._names))

    def _built(self, shares: tuple[float, ...]) -> models.Model:
        """The model where textures have these values."""
        values = dict(zip(self._names, shares, strict=True))
        try:
            return models.build(self._sample.model, self._sample.parameters_at(values))
        except ConfigError as error:
            told = ", ".join(f"{name} at {share:g}" for name, share in values.items())
            raise ConfigError(f'sample "{self._sample.name}", [texture] with {told}: {error}') from error

    def parts(
        self, seen: PixelMap, covered: Bools, probe: Probe, inside: Bools | None = None
    ) -> Iterator[TextureLevel]:
        """Level by level, the pixels that see it; `probe` tells how close levels must be in this view.

        `inside` says which spots of the covered pixels count, (pixels, spots); without it all do.
        """
        levels = self._levels(probe)
        total = math.prod(map(len, levels))
        if total > MOST_TOGETHER:
            raise ConfigError(
                f'sample "{self._sample.name}": its textures have {total} levels together, and at most {MOST_TOGETHER} '
                "are rendered: let fewer of them be gradients or pictures of many shades"
            )
        rows, cols = np.nonzero(covered)
        x, y = places(seen, rows, cols, self._spots)
        of_spot = 4 ** self._of_few.count(False)
        step = max(1, AT_ONCE // max(total, self._spots[0] * of_spot))
        weights = sparse.vstack(
            [
                self._weights(levels, x(k, k + step), y(k, k + step), None if inside is None else inside[k : k + step])
                for k in range(0, len(rows), step)
            ]
            or [sparse.csr_array((0, total))]
        ).tocsc()
        for level, shares in enumerate(product(*levels)):
            here = slice(weights.indptr[level], weights.indptr[level + 1])
            if here.start < here.stop:
                at = weights.indices[here]
                yield TextureLevel(self._model(tuple(map(float, shares))), rows[at], cols[at], weights.data[here])

    def _weights(self, levels: list[Floats], x: Floats, y: Floats, inside: Bools | None) -> sparse.csr_array:
        """Weight of each level in each pixel (pixels, levels), from its spots (pixels, spots)."""
        place = np.zeros((*x.shape, 1), dtype=np.int64)
        weight = np.ones(place.shape) if inside is None else inside[..., None].astype(np.float64)
        for one, of_few, own in zip(self._loaded, self._of_few, levels, strict=True):
            value = one.shares(x, y)
            if of_few:
                nearest, share = np.searchsorted(own, value - 1e-9)[..., None], np.ones((*x.shape, 1))
            else:
                nearest, share = _cubic(value, own)
            place = (place[..., None] * len(own) + nearest[..., None, :]).reshape(*x.shape, -1)
            weight = (weight[..., None] * share[..., None, :]).reshape(*x.shape, -1)
        total = math.prod(map(len, levels))
        place += total * np.arange(len(x))[:, None, None]
        counted = np.bincount(place.ravel(), weight.ravel() / x.shape[1], total * len(x))
        return sparse.csr_array(counted.reshape(len(x), total))

    def _levels(self, probe: Probe) -> list[Floats]:
        """The levels of each texture in a view."""
        out = []
        for number, (one, of_few) in enumerate(zip(self._loaded, self._of_few, strict=True)):
            if of_few:
                assert one.occurring is not None
                out.append(one.occurring)
                continue

            @lru_cache(maxsize=MOST)
            def at(share: float, number: int = number) -> Floats:
                """With all other textures at 0, and at 1."""
                ends = [[end] * len(self._names) for end in (0.0, 1.0)]
                ats = [tuple([*end[:number], share, *end[number + 1 :]]) for end in ends]
                return np.concatenate([probe(self._model(each)) for each in dict.fromkeys(ats)])

            out.append(_enough(at))
        return out


class Plate:
    """A sample of several materials by area, each with textures of its own.

    Raises
    ------
    ConfigError, DataError
        A picture cannot be read, or a model does not take a value.
    """

    def __init__(self, sample: SampleDescription) -> None:
        self._region_at = areas(sample.region, sample.mask, f'sample "{sample.name}", ')
        self._materials = [Textures(one, steps=True) for one in sample.materials()]

    def parts(self, seen: PixelMap, covered: Bools, probe: Probe) -> Iterator[TextureLevel]:
        """As `Textures.parts`, material by material: an edge divides a pixel by its spots on both sides."""
        rows, cols = np.nonzero(covered)
        x, y = places(seen, rows, cols, SPOTS)
        step = AT_ONCE // SPOTS[0]
        numbers = np.concatenate(
            [self._region_at(x(k, k + step), y(k, k + step)) for k in range(0, len(rows), step)]
            or [np.zeros((0, SPOTS[0]), np.int8)]
        )
        for number, material in enumerate(self._materials):
            inside = numbers == number
            here = np.flatnonzero(inside.any(axis=1))
            own = np.zeros_like(covered)
            own[rows[here], cols[here]] = True
            yield from material.parts(seen, own, probe, inside[here])


def places(seen: PixelMap, rows: Whole, cols: Whole, lattice: tuple[int, int]) -> list[Callable[[int, int], Floats]]:
    """x and y [mm] of the spots of pixels from one number up to another, (pixels, spots)."""
    count, turn = lattice
    down, across = (((step * np.arange(count)) % count + 0.5) / count - 0.5 for step in (1, turn))

    def of(whole: Floats) -> Callable[[int, int], Floats]:
        per_row, per_col = (np.nan_to_num(np.gradient(whole, axis=axis)[rows, cols]) for axis in (0, 1))
        middle = whole[rows, cols]

        def spots(first: int, end: int) -> Floats:
            these = slice(first, end)
            return np.asarray(
                middle[these, None] + per_row[these, None] * down + per_col[these, None] * across, dtype=float
            )

        return spots

    return [of(seen.x_mm), of(seen.y_mm)]


def _enough(at: Callable[[float], Floats]) -> Floats:
    """Levels that follow a function of a share, which gives an array (kinds, values of a kind)."""
    levels = np.linspace(0.0, 1.0, FEWEST)
    asked = 0.5 * (levels[1:] + levels[:-1])
    while len(asked) and len(levels) < MOST:
        known, new = (np.stack([at(float(share)) for share in shares]) for shares in (levels, asked))
        nearest, weight = _cubic(asked, levels)
        size = np.abs(new) + FLOOR * np.abs(known).max(axis=(0, 2), keepdims=True) + DARK
        error = np.max(np.abs(np.einsum("lw,lwks->lks", weight, known[nearest]) - new) / size, axis=(1, 2))
        worst = np.argsort(-error, kind="stable")[: MOST - len(levels)]
        halved = asked[worst[error[worst] > TOLERANCE]]
        levels = np.sort(np.concatenate([levels, halved]))
        # the two halves of each interval that was too wide
        after = np.searchsorted(levels, halved)
        asked = np.concatenate([0.5 * (halved + levels[after + side]) for side in (-1, 1)])
    return levels


def _cubic(at: Floats, nodes: Floats) -> tuple[Whole, Floats]:
    """Lagrange's cubic through the four nearest of some nodes in growing order: which, and their weights, (..., 4)."""
    first = np.clip(np.searchsorted(nodes, at, side="right") - 2, 0, len(nodes) - 4)
    four = np.arange(4)
    apart = nodes[np.arange(len(nodes) - 3)[:, None] + four]
    between = apart[:, :, None] - apart[:, None, :]
    between[:, four, four] = 1.0
    off = at[..., None] - apart[first]
    a, b = off[..., 0] * off[..., 1], off[..., 2] * off[..., 3]
    weight = np.stack([off[..., 1] * b, off[..., 0] * b, a * off[..., 3], a * off[..., 2]], axis=-1)
    weight *= (1.0 / between.prod(axis=2))[first]
    return first[..., None] + four, weight
