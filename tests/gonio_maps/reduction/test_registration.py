"""Shifts of pictures that are drawn from formulas, and looked up where they are asked for."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gonio_maps.files import Tile
from gonio_maps.reduction import registration
from gonio_maps.reduction.map_grid import Grid

from gonio.typing import Floats, Ints

GRID = Grid(0.1, 9.0)
NOISE = 0.01
LEATHER = tuple(
    (np.cos(a) * 2.0 * np.pi / wide, np.sin(a) * 2.0 * np.pi / wide, 2.4 * a) for a, wide in
    zip(np.arange(24) * 2.4, np.linspace(0.9, 2.1, 24), strict=True)
)  # fmt: skip
"""Wave numbers along x and y [1/mm] and phases."""


def leather(x: Floats, y: Floats) -> Floats:
    return np.asarray(0.05 * sum(np.cos(kx * x + ky * y + phase) for kx, ky, phase in LEATHER))


def streaks(x: Floats, y: Floats) -> Floats:
    """Along x."""
    return leather(0.0 * x, y)


def edge(x: Floats, y: Floats) -> Floats:
    """It runs along (-0.6, 0.8)."""
    return np.tanh((0.8 * x + 0.6 * y) / 0.15) * 0.2


def plain(x: Floats, y: Floats) -> Floats:
    """A lobe's own course."""
    return 0.02 * x - 0.001 * (x**2 + y**2)


def found(monkeypatch: pytest.MonkeyPatch, texture: Any, lie: Floats, contrast: Any) -> tuple[Floats, Floats]:
    """Shifts and uncertainties of pictures 1 + b texture with white noise that lie `lie` [mm] beside."""

    class Drawn:
        def __init__(self, planes: object, grid: Grid, point: Any) -> None:
            self.number = point.number

        def at(self, tile: Tile, shift: tuple[float, float]) -> tuple[Floats, Floats, Ints]:
            x, y = GRID.cells(tile)
            beside = lie[self.number]
            seen = texture(x + shift[0] - beside[0], y + shift[1] - beside[1])
            noise = np.random.default_rng(self.number).normal(0.0, NOISE, x.shape)
            value = 0.3 * (1.0 + contrast(self.number, x) * seen + noise)
            flag = np.where(np.hypot(x, y) < GRID.radius_mm, 0, 1)
            return value, np.full(x.shape, (0.3 * NOISE) ** 2), flag

    monkeypatch.setattr(registration, "Lookup", Drawn)
    points = [SimpleNamespace(number=k, band=SimpleNamespace(name="green")) for k in range(len(lie))]
    return registration.shifts(None, GRID, points)  # type: ignore[arg-type]


def drawn(count: int, cells: float) -> Floats:
    """Shifts without a mean, of so many cells."""
    lie = np.random.default_rng(7).uniform(-cells, cells, (count, 2)) * GRID.pixel_mm
    return np.asarray(lie - lie.mean(axis=0))


CONTRASTS = {
    "alike": lambda k, x: 1.0,
    "from low to high, and over the sample": lambda k, x: (0.3 + 0.1 * k) * (1.0 + 0.03 * x),
    "of either sign": lambda k, x: (-1.0) ** k * (0.5 + 0.1 * k),
}


@pytest.mark.parametrize("contrast", CONTRASTS)
@pytest.mark.parametrize("cells", [0.3, 1.5])
def test_shifts_are_found_within_their_uncertainty(
    contrast: str, cells: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    lie = drawn(8, cells)
    shift, u = found(monkeypatch, leather, lie, CONTRASTS[contrast])
    # a hundredth of a cell: noise of 1 % beside slopes of 0.1 a cell in 25 000 cells gives 0.001, interpolation nothing
    assert np.abs(shift - lie).max() < 0.01 * GRID.pixel_mm
    # sixteen pulls that share a mean: 1.0 +- 0.2
    assert 0.5 < np.sqrt(np.mean(((shift - lie) / u) ** 2)) < 1.6


@pytest.mark.parametrize(("texture", "across"), [(streaks, (0.0, 1.0)), (edge, (0.8, 0.6))])
def test_of_streaks_and_edges_the_shift_across_them_is_told(
    texture: Any, across: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    lie = drawn(6, 0.7)
    shift, u = found(monkeypatch, texture, lie, CONTRASTS["alike"])
    assert np.abs((shift - lie) @ across).max() < 0.02 * GRID.pixel_mm
    assert np.abs(shift @ np.array([-across[1], across[0]])).max() < 0.02 * GRID.pixel_mm
    assert np.isnan(u).all(axis=0).tolist() == [across[0] == 0.0, False]


def test_without_texture_nothing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    shift, u = found(monkeypatch, plain, drawn(6, 0.7), CONTRASTS["alike"])
    assert not shift.any()
    assert np.isnan(u).all()


def test_pictures_that_are_equal_to_the_bit_lie_in_one_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(np.random, "default_rng", lambda seed, make=np.random.default_rng: make(0))
    shift, u = found(monkeypatch, leather, np.zeros((4, 2)), CONTRASTS["alike"])
    assert np.abs(shift).max() < 1e-9
    assert (u > 0.0).all()  # and no NaN


def test_a_picture_like_no_other_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last one lies eight cells aside: of waves of 9 to 21 cells nothing is where it was."""
    lie = drawn(6, 0.5)
    lie[-1] = 0.8
    shift, u = found(monkeypatch, leather, lie, CONTRASTS["alike"])
    assert np.isnan(u[-1]).all()
    assert not shift[-1].any()
    assert np.isfinite(u[:-1]).all()
    assert np.abs(shift - lie + lie[:-1].mean(axis=0))[:-1].max() < 0.01 * GRID.pixel_mm
