"""Two maps of fits, pixel by pixel: what changed, where false discoveries are a bounded share of what is marked."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from gonio_analysis.changes.verdict import FALSE_DISCOVERIES

from gonio.errors import DataError
from gonio.threads import in_threads
from gonio.typing import Bools, Floats
from gonio_maps.files import FitFile, Tile

Singles = npt.NDArray[np.float32]
"""Values of very many pixels: seven digits are more than a difference has."""
SAME_PLACE = 1e-3
"""Part of a pixel: grids that lie closer are one."""


@dataclass(frozen=True)
class ParameterChange:
    """How one parameter changed; arrays have the shape of the map."""

    name: str
    unit: str
    difference: Singles
    """B - A; NaN where either is not determined."""
    z: Singles
    """In standard deviations of the difference."""
    marked: Bools
    """The pixels in which it changed, judged by itself."""
    u: float
    """Median standard uncertainty of the difference; NaN of none."""


@dataclass(frozen=True)
class MapChange:
    """What changed from one map of fits to another."""

    model: str
    x_mm: Floats
    y_mm: Floats
    parameters: list[ParameterChange]
    chi_square: Singles
    """Chi-square of the differences of all parameters of a pixel together."""
    freedom: npt.NDArray[np.uint8]
    """How many parameters were compared; 0: none."""
    p: Floats
    """Probability of a larger chi-square by chance; NaN where nothing was compared."""
    changed: Bools
    """The pixels that changed."""

    @property
    def compared(self) -> int:
        """Pixels in which something could be compared."""
        return int(np.count_nonzero(self.freedom))

    @property
    def share(self) -> float:
        """Share of the compared pixels that changed; NaN where none is compared."""
        return int(self.changed.sum()) / self.compared if self.compared else float("nan")


def change(path_a: str | Path, path_b: str | Path) -> MapChange:
    """Compare two maps of fits on the same grid.

    Parameters
    ----------
    path_a, path_b
        The files.

    Raises
    ------
    DataError
        A file cannot be read, or their grids, models or parameters do not match.
    """
    from scipy.special import chdtrc

    with FitFile(path_a) as a, FitFile(path_b) as b:
        names = _matching(a, b)
        shape = a.shape
        found = {name: np.full((3, *shape), np.nan, np.float32) for name in names}
        total, freedom = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
        p = np.full(shape, np.nan)

        def compare(tile: Tile) -> None:
            at = np.s_[tile.rows, tile.cols]
            difference, covariance = _of_tile(a, b, names, tile)
            error = np.sqrt(np.einsum("...aa->...a", covariance))
            for k, name in enumerate(names):
                for place, one in zip(found[name], (difference, difference / error, error), strict=True):
                    place[at] = one[..., k]
            chi_square, count = together(difference, covariance)
            total[at], freedom[at] = chi_square, count
            p[at] = np.where(count > 0, chdtrc(np.maximum(count, 1), chi_square), np.nan)

        for _ in in_threads(compare, a.tiles()):
            pass
        changes = []
        for name in names:
            difference, z, error = found.pop(name)
            typical = float(np.nanmedian(error)) if np.isfinite(error).any() else float("nan")
            changes.append(ParameterChange(name, a.unit(name), difference, z, marked_pixels(_two_sided(z)), typical))
        return MapChange(a.model, a.x_mm, a.y_mm, changes, total, freedom, p, marked_pixels(p))


def marked_pixels(p: Floats) -> Bools:
    """Which probabilities are so small that about `FALSE_DISCOVERIES` of those marked are by chance; never NaN."""
    from scipy.stats import false_discovery_control

    known = np.isfinite(p)
    out = np.zeros(p.shape, bool)
    out[known] = false_discovery_control(p[known]) <= FALSE_DISCOVERIES  # Benjamini and Hochberg (1995)
    return out


def together(difference: Floats, covariance: Floats) -> tuple[Floats, npt.NDArray[np.intp]]:
    """Chi-square of the differences of a pixel that are known, and how many those are.

    Parameters
    ----------
    difference : (..., k) array
        NaN where it is not known.
    covariance : (..., k, k) array
    """
    known = np.isfinite(difference) & np.isfinite(np.einsum("...aa->...a", covariance))
    both = known[..., :, None] & known[..., None, :]
    eye = np.eye(difference.shape[-1])
    # what is not known is a difference of 0 with a variance of 1: it adds nothing
    filled = np.where(both, np.nan_to_num(covariance), eye)
    size = np.sqrt(np.einsum("...aa->...a", filled))
    whitened = np.where(known, difference, 0.0) / size
    solved = np.linalg.solve(filled / (size[..., :, None] * size[..., None, :]), whitened[..., None])[..., 0]
    return np.einsum("...a,...a->...", whitened, solved), known.sum(axis=-1)


def _two_sided(z: Singles) -> Floats:
    from scipy.special import ndtr

    return np.asarray(2.0 * ndtr(-np.abs(z.astype(float))))


def _of_tile(a: FitFile, b: FitFile, names: list[str], tile: Tile) -> tuple[Floats, Floats]:
    """Differences (rows, columns, k) and their covariances (rows, columns, k, k)."""
    values, covariance = [], np.zeros((*tile.shape, len(names), len(names)))
    for file in (a, b):
        pairs = [file.parameter(name, tile) for name in names]
        values.append(np.stack([value for value, _ in pairs], axis=-1))
        u = np.stack([u for _, u in pairs], axis=-1)
        covariance += u[..., :, None] * u[..., None, :] * file.correlations(names, tile)
    return values[1] - values[0], covariance


def _matching(a: FitFile, b: FitFile) -> list[str]:
    """The parameters that both have; raises `DataError` where the files do not go together."""
    if a.shape != b.shape:
        raise DataError(
            f"{a.path} has {a.shape[1]} x {a.shape[0]} pixels, {b.path} {b.shape[1]} x {b.shape[0]}: --change compares"
            " maps on one grid; reduce both runs with the same --pixel-mm"
        )
    for axis, one, other in (("x", a.x_mm, b.x_mm), ("y", a.y_mm, b.y_mm)):
        pixel = abs(float(one[-1] - one[0])) / max(one.size - 1, 1) or 1.0
        off = float(np.abs(one - other).max())
        if off > SAME_PLACE * pixel:
            raise DataError(
                f"{b.path}: its {axis} lies up to {off:.3g} mm beside that of {a.path}, whose pixels have {pixel:.3g}"
                " mm: --change compares maps on one grid; reduce both runs on the same one"
            )
    if a.model != b.model:
        raise DataError(f"{a.path} holds {a.model}, {b.path} {b.model}: fit one model to both maps")
    names = [name for name in a.parameters if name in b.parameters]
    if not names:
        raise DataError(f"{a.path} and {b.path} have no parameter in common; fit both maps with the same ones free")
    return names
