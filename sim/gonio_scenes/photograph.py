"""A photograph of a curved sample as a measurement: every square of pixels is a row of a measurement table.

See docs/photograph.md for the design, and for what is neglected and how small that is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from gonio import __version__, geometry
from gonio.errors import ConfigError, DataError
from gonio.shown import with_u
from gonio.typing import Floats
from gonio_scenes import exposures
from gonio_scenes._squares import _RING, FLAGS, Mask, _Pixels, _shifted, _Squares
from gonio_scenes.exposures import Exposure
from gonio_scenes.scene import Scene
from gonio_scenes.shapes import AnyShape, Shape
from gonio_scenes.shapes.revolution import Revolution
from gonio_scenes.shapes.shape import Analytic
from gonio_scenes.shapes.triangles import Triangles
from gonio_scenes.vantage import Seen, Vantage, displaced
from gonio_scenes.world import Hits, World

if TYPE_CHECKING:
    import pandas as pd

ROWS = 4000
"""About so many squares are made where the file does not say how large they are."""
BLOCK = 1 << 17
"""Pixels that are traced together."""
EDGE_DEG = 10.0
"""Normals of neighbouring pixels that differ by more lie on either side of an edge."""
FLAT = 0.05
"""Directions in which the normal changes this much less than in the steepest one do not count as a gradient."""
LOW = 0.05
"""Quantile of the values that counts as their level far from the lobe."""
LEVEL_SLOPE, LOBE_SLOPE = 0.3, 0.5
"""How f may change with half the angle between light and viewer [1/rad], the lobe by 2 tan of it more: what microfacet
models do through 1 / (cos theta_i cos theta_r). docs/photograph.md has the slopes of random samples."""
STILL = 1e-5
"""Turns of the normal [rad] that are left out: what a sphere's picture has by its perspective."""
FEW_FACETS = 30
"""So many facets in sight at least say together how f changes with the normal; fewer are looked at one by one."""
NEAREST = 15
"""Facets of the nearest normals that a quadratic through them takes: its six terms, and some noise averaged."""
REACH = 3.0
"""Standard deviations of all causes together by which creases may lie elsewhere: pixels so close are not used."""
KEY = np.array([1.0, math.sqrt(2.0), math.pi])
"""Normals are the same where their products with it are, to `SAME`."""
SAME = 1e-9
DETECTED = 5.0
"""Standard deviations above which a picture holds light."""
SEVERAL, ALIKE = 20, 0.01
"""Pixels that have the same value though their light differs by this much: it was cut off there."""
DIM, DIM_DN = 3.0, 2.0
"""Standard deviations of a dark pixel, and DN, below which a picture without shades may be a wrong black level."""


def reduce(scene: Scene, image: str | Path) -> pd.DataFrame:
    """The measurement table of a photograph of a scene.

    Parameters
    ----------
    scene
        Where camera, shape and light are taken to be; its materials are not looked at.
    image
        A raw frame, or linear radiances as .npz, .exr, .npy or .tif (`gonio_scenes.exposures`).

    Raises
    ------
    ConfigError
        There is no such picture; or the scene does not say what is needed, or holds light that cannot be told from
        that of its one lamp.
    DataError
        The picture is damaged, of another size, or holds no light; or not one square of it can be used.
    """
    which = _shape(scene)
    table = scene.tables.photograph
    vantage = Vantage(scene.camera, _light(scene), scene.world.shapes[which], np.zeros(3))
    exposure = exposures.read(scene, image)
    if table is None:  # `exposures.read` has refused it
        raise ConfigError("the table [photograph] is missing")
    moved = displaced(vantage, scene.tables.shape[which], scene.source.parent, table.uncertainty)
    pixels = _looked_at(scene, vantage, which, exposure, table.limb_px, moved)
    seen = pixels.why >= 0
    if not (seen & exposure.used).any():
        raise DataError(f"{image}: the camera of the scene does not see the shape that is measured")
    size = table.bin or max(1, math.ceil(math.sqrt(np.count_nonzero(seen) / ROWS)))
    if table.channel is not None and size % 2 and not exposure.used.all():
        size += 1  # a square of a mosaic holds whole cells
    squares = _Squares(pixels, exposure, size, scene.camera.samples > 1)
    return _table(scene, Path(image), exposure, vantage, moved, squares, table.theta_max_deg)


def _shape(scene: Scene) -> int:
    shapes, table = scene.tables.shape, scene.tables.photograph
    name = table.shape if table is not None else None
    named = [k for k, shape in enumerate(shapes) if shape.name == name]
    if name is None and len(shapes) == 1:
        return 0
    listed = ", ".join(f'"{shape.name}"' for shape in shapes if shape.name) or "none: give them a name"
    if name is None:
        raise ConfigError(
            f"photograph.shape is missing: say which of the {len(shapes)} shapes is measured; names: {listed}"
        )
    if len(named) != 1:
        raise ConfigError(f'photograph.shape = "{name}": {len(named)} shapes have that name; names: {listed}')
    return named[0]


def _light(scene: Scene) -> Any:
    if scene.ambient is not None:
        raise ConfigError(
            "light: ambient light cannot be told from the lamp's in one picture: take a second picture with the lamp "
            "off, subtract it, and leave the ambient light out of the scene file"
        )
    if len(scene.lights) != 1:
        raise ConfigError(f"light: {len(scene.lights)} lights: which of them lit a pixel cannot be told; one is needed")
    if scene.polariser_deg is not None or scene.lights[0].polarisation is not None:
        raise ConfigError("polarisation: a photograph is reduced for unpolarised light alone")
    if not scene.lights[0].power[0] > 0.0:
        raise ConfigError("light[1]: is dark")
    return scene.lights[0]


# --- every pixel -----------------------------------------------------------------------------------------------------


def _looked_at(
    scene: Scene,
    vantage: Vantage,
    which: int,
    exposure: Exposure,
    margin: int,
    moved: dict[str, tuple[Vantage, Vantage]],
) -> _Pixels:
    """What every pixel's centre sees, and why some are not used."""
    camera = scene.camera
    count = camera.pixels
    received = np.full(count, np.nan)
    normal = np.full((count, 3), np.nan)
    low, hidden, mixed = np.zeros(count, bool), np.zeros(count, bool), np.zeros(count, bool)
    crease = _creases(scene.tables.shape[which], vantage.shape)
    for first in range(0, count, BLOCK):
        pixel = np.arange(first, min(first + BLOCK, count))
        row, column = np.divmod(pixel, camera.width)
        origin, direction = camera.through(column + 0.5, row + 0.5)
        hits = scene.world.hit(origin, direction)
        own = np.flatnonzero(hits.shape == which)
        if not own.size:
            continue
        hits = hits.picked(own)
        at = pixel[own]
        received[at] = vantage.received(hits.position, hits.facing)
        normal[at] = hits.facing
        if crease is not None:
            beside = _moves(vantage, moved, hits.position) + (0.5 if camera.samples > 1 else 0.0)
            mixed[at] = _beside_crease(vantage, crease, hits, column[own] + 0.5, row[own] + 0.5, beside)
        for toward, distance in vantage.edges(hits.position):
            low[at] |= np.einsum("ij,ij->i", toward, hits.facing) <= 0.0
            if scene.world.casts_shadows:
                hidden[at] |= scene.world.blocked(toward, distance, hits, np.arange(hits.shape.size))
    shape = (camera.height, camera.width)
    seen = np.isfinite(received).reshape(shape)
    saturated = exposure.saturated | _cut_off(exposure, received.reshape(shape), low.reshape(shape))
    piece = None
    if crease is not None:
        _, piece = np.unique(np.round(normal @ crease / SAME), return_inverse=True, equal_nan=True)
        piece = piece.reshape(shape)
    facets = isinstance(vantage.shape, Triangles)
    flat = facets and piece is not None and np.unique(piece[seen]).size >= FEW_FACETS
    reasons = (
        _near_edge(seen, normal.reshape(*shape, 3), margin),
        mixed.reshape(shape),
        low.reshape(shape),
        _widened(hidden.reshape(shape), margin),
        saturated,
        exposure.clamped,
    )
    why = np.zeros(shape, np.int8)
    for k, here in reversed(list(enumerate(reasons))):
        why[here] = k + 1
    why[~seen] = -1
    return _Pixels(received.reshape(shape), why, piece, flat, facets and crease is None)


def _cut_off(exposure: Exposure, received: Floats, low: Mask) -> Mask:
    """Pixels of the greatest value, where several have it though they do not receive the same light."""
    lit = exposure.used & np.isfinite(received) & ~low
    top: Mask = lit & (exposure.value == np.max(exposure.value, where=lit, initial=-np.inf))
    light = (exposure.per_radiance * received)[top]
    whole = exposure.step > 0.0 and not top[lit].all()  # rounded to whole DN, several may well be the greatest
    if light.size < SEVERAL or whole or np.ptp(light) < ALIKE * light.max():
        return np.zeros_like(lit)
    return top


def _creases(table: AnyShape, shape: Shape) -> Floats | None:
    """What normals are multiplied with to tell one side of a crease from the other; None where there are no creases."""
    if isinstance(shape, Triangles) and shape.normals is None:
        return KEY
    if isinstance(table, Revolution) and isinstance(shape, Analytic) and not table.smooth:
        return np.asarray(shape.place.axes[2])
    return None


def _moves(vantage: Vantage, moved: dict[str, tuple[Vantage, Vantage]], position: Floats) -> Floats:
    """How far [px] the picture of each point may lie elsewhere, by all causes together, `REACH` standard deviations."""
    squared = np.zeros(len(position))
    for both in moved.values():
        places = [np.stack(end.camera.project(position - vantage.shift + end.shift), axis=1) for end in both]
        squared += (0.25 * (places[0] - places[1]) ** 2).sum(axis=1)
    return np.asarray(REACH * np.sqrt(squared))


def _beside_crease(vantage: Vantage, crease: Floats, hits: Hits, column: Floats, row: Floats, beside: Floats) -> Mask:
    """Places of the picture with another facet at one of eight places so many pixels beside them."""
    out = np.zeros(len(column), bool)
    if beside.max() == 0.0:
        return out
    for down, right in _RING:
        origin, direction = vantage.camera.through(column + right * beside, row + down * beside)
        there = World([vantage.shape], vantage.camera.position).hit(origin - vantage.shift, direction)
        out |= (np.abs((there.facing - hits.facing) @ crease) > SAME) | (there.shape < 0)
    return out


def _near_edge(seen: Mask, normal: Floats, margin: int) -> Mask:
    """Pixels within a margin of where the shape ends, of an edge of it, or of the picture's own edge."""
    edge = ~seen
    with np.errstate(invalid="ignore"):
        for axis in (0, 1):
            near, far = np.moveaxis(normal, axis, 0)[:-1], np.moveaxis(normal, axis, 0)[1:]
            apart = np.einsum("ijk,ijk->ij", near, far) < math.cos(math.radians(EDGE_DEG))
            along = np.moveaxis(edge, axis, 0)
            along[:-1] |= apart
            along[1:] |= apart
    return _widened(edge, margin)


def _widened(here: Mask, margin: int) -> Mask:
    from scipy.ndimage import binary_dilation

    return np.asarray(binary_dilation(here, np.ones((3, 3)), iterations=margin) if margin and here.any() else here)


# --- squares of pixels -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Slopes:
    """The logarithm (asinh) of squares' values around their middles, as a quadratic in pixels."""

    small: float
    level: Floats
    gradient: Floats
    """(n, 2): along columns and rows."""
    hessian: Floats
    """(n, 3): columns, rows, both."""

    def moved(self, step: Floats) -> Floats:
        """The BRDF [1/sr] at places (n, 2) [px] beside the middles."""
        x, y = step.T
        bend = 0.5 * (self.hessian[:, 0] * x**2 + self.hessian[:, 1] * y**2) + self.hessian[:, 2] * x * y
        return np.asarray(2.0 * self.small * np.sinh(self.level + (self.gradient * step).sum(axis=1) + bend))


def _slopes(squares: _Squares, used: Mask, normal: Floats, across: Floats) -> _Slopes:
    """The quadratic of least squares through 3 x 3 squares, or through facets (of `normal`, in `across`)."""
    value, size = squares.mean, float(squares.size)
    small = max(3.0 * float(np.median(squares.noise[used])), 1e-6 * float(np.abs(value[used]).max()), 1e-300)
    log = np.arcsinh(value / (2.0 * small))
    level = np.arcsinh(squares.value[used] / (2.0 * small))
    if squares.flat and squares.piece is not None:
        return _Slopes(small, level, *_over_facets(squares.piece[used], normal, level, across))
    at = {(r, c): _shifted(log, r, c) for r in (-1, 0, 1) for c in (-1, 0, 1)}
    rows = [(at[r, -1], at[r, 0], at[r, 1]) for r in (-1, 0, 1)]
    columns = [(at[-1, c], at[0, c], at[1, c]) for c in (-1, 0, 1)]
    x, y = (np.mean([b - a for a, _, b in lines], axis=0) / (2.0 * size) for lines in (rows, columns))
    xx, yy = (np.mean([a + b - 2.0 * m for a, m, b in lines], axis=0) / size**2 for lines in (rows, columns))
    xy = (at[1, 1] + at[-1, -1] - at[1, -1] - at[-1, 1]) / (4.0 * size**2)
    return _Slopes(
        small,
        level,
        np.stack([x[used], y[used]], axis=1),
        np.stack([xx[used], yy[used], xy[used]], axis=1),
    )


def _over_facets(piece: npt.NDArray[np.intp], normal: Floats, log: Floats, across: Floats) -> tuple[Floats, Floats]:
    """Gradient (n, 2) and Hessian (n, 3) by quadratics through the facets of the nearest normals."""

    _, facet = np.unique(piece, return_inverse=True)
    count = np.bincount(facet)
    middle = np.stack([np.bincount(facet, n) for n in normal.T], axis=1) / count[:, None]
    level = np.bincount(facet, log) / count
    _, near = cKDTree(middle).query(normal, min(NEAREST, count.size))
    x, y = np.moveaxis(np.einsum("nki,nij->nkj", middle[near] - normal[:, None, :], across), 2, 0)
    scale = np.sqrt(np.mean(x**2 + y**2, axis=1))[:, None] + 1e-12
    x, y = x / scale, y / scale
    terms = np.stack([np.ones_like(x), x, y, 0.5 * x**2, 0.5 * y**2, x * y], axis=2)
    weight = np.sqrt(count[near])
    found = np.einsum("nkj,nj->nk", np.linalg.pinv(weight[..., None] * terms, rcond=1e-3), weight * level[near])
    return found[:, 1:3] / scale, found[:, 3:] / scale**2


# --- the table -------------------------------------------------------------------------------------------------------


def _table(
    scene: Scene,
    image: Path,
    exposure: Exposure,
    vantage: Vantage,
    moved: dict[str, tuple[Vantage, Vantage]],
    squares: _Squares,
    theta_max_deg: float,
) -> pd.DataFrame:
    import pandas as pd

    given = scene.tables.photograph
    assert given is not None
    there = np.flatnonzero(squares.of_shape)
    seen = vantage.at(squares.column.flat[there], squares.row.flat[there])
    omega_i, omega_r = seen.omega_i, seen.omega_r
    flag = np.array(["", *FLAGS], dtype=object)[squares.why.flat[there]]
    value, random = squares.value.flat[there], squares.random.flat[there]
    flag[(flag == "") & ~seen.met] = "limb"
    origin, direction = scene.camera.through(squares.column.flat[there], squares.row.flat[there])
    middle = scene.world.hit(origin, direction)
    grazing = np.minimum(omega_i[:, 2], omega_r[:, 2]) <= math.cos(math.radians(theta_max_deg))
    flag[(flag == "") & grazing] = "grazing"
    flag[(flag == "") & ~np.isfinite(value)] = "beside_unused"
    jacobian = _across_picture(vantage, squares.column.flat[there], squares.row.flat[there])
    cones = vantage.half_angles(middle.position)
    turn = 2.0 * squares.size / math.sqrt(2.0) * np.linalg.norm(jacobian, axis=(1, 2))
    from_mirror = geometry.angle_between(geometry.mirrored(omega_r), omega_i)
    flag[(flag == "") & (from_mirror < cones[0] + cones[1] + turn)] = "mirror"
    shown = seen.met & (np.minimum(omega_i[:, 2], omega_r[:, 2]) > 0.0)
    good = flag == ""
    if not good.any():
        counts = ", ".join(f"{np.count_nonzero(flag == word)} {word}" for word in sorted(set(flag)))
        raise DataError(f"{image}: not one of {flag.size} squares of {squares.size} pixels can be used: {counts}")

    grid = np.zeros(squares.of_shape.shape, bool)
    grid.flat[there[good]] = True
    _require_light(image, squares, grid, exposure, given.uncertainty.black_level_dn)
    stated = given.uncertainty.model_dump()
    columns, unseen_deg = _common(squares, grid, exposure, stated, moved, _picked(seen, good), jacobian[good])
    if columns:  # the limb may come past a square before a cause has moved by one standard deviation
        whole = np.isfinite(np.stack(list(columns.values()))).all(axis=0)
        flag[np.flatnonzero(good)[~whole]] = "limb"
        good, columns = flag == "", {name: column[whole] for name, column in columns.items()}
    numbers = np.full((len(columns) + 2, flag.size), np.nan)
    numbers[0], numbers[1] = np.where(good, value, np.nan), np.where(good, random, np.nan)
    for k, name in enumerate(columns):
        numbers[2 + k, good] = columns[name]
    angles = [np.degrees(a) for omega in (omega_i, omega_r) for a in geometry.angles(np.nan_to_num(omega))]
    frame = pd.DataFrame(
        {
            **dict(zip(("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"), angles, strict=True)),
            "wavelength_nm": float(scene.wavelength_nm[0]),
            "polarisation": "unpolarised",
            "brdf": numbers[0],
            "u_brdf": np.sqrt((numbers[1:] ** 2).sum(axis=0)),
            "u_random": numbers[1],
            **{f"s_{name}": numbers[2 + k] for k, name in enumerate(columns)},
            "flag": flag,
        }
    )[shown].reset_index(drop=True)
    frame["flag"] = frame["flag"].astype(str)
    aside = {str(word): int(np.count_nonzero(flag[~shown] == word)) for word in sorted(set(flag[~shown]))}
    notes = [f"Each row is the mean over {squares.size} x {squares.size} pixels, brought to its middle."]
    notes += [f"{count} more squares have no directions above the horizon: {word}." for word, count in aside.items()]
    if any(name.startswith("unseen") for name in columns):
        notes.append(
            f"The stated uncertainties turn directions by up to {unseen_deg:.2g} degrees to where this picture does "
            "not look; what that may do is in the columns s_unseen."
        )
    if len(scene.world.shapes) > 1:
        notes.append("Light that the scene's other shapes reflect onto the sample is not subtracted.")
    source = float(np.median(cones[0][good]))
    frame.attrs.update(
        quantity="brdf",
        source_solid_angle_sr=float(geometry.solid_angle_of_cone(source)),
        receiver_solid_angle_sr=float(geometry.solid_angle_of_cone(cones[1])),
        bands=[],
        polarisation="unpolarised",
        source_file=str(image),
        sample=scene.name,
        provenance={
            "reduced_by": f"gonio {__version__}",
            "scene": scene.name,
            "pixels_a_square": squares.size,
            **dict(exposure.described),
            "standard_uncertainties": {n: u for n, u in stated.items() if u},
        },
        notes=notes,
    )
    return frame


def _require_light(image: Path, squares: _Squares, used: Mask, exposure: Exposure, black_level_dn: float) -> None:
    """Raise `DataError` where the squares that can be used hold no light, or only an offset."""
    f, u = squares.mean[used], squares.noise[used]
    with np.errstate(divide="ignore"):
        weight = 1.0 / u**2
    offset = black_level_dn * exposure.step * squares.per_value[used]
    if np.isinf(weight).any() or (f / u).max() > 2.0 * DETECTED:
        return
    spread = math.sqrt(float(weight.sum()) + float((weight * offset).sum()) ** 2)
    remedy = "was the lens open, the lamp lit, and the exposure long enough?"
    if (weight * f).sum() < DETECTED * spread:
        raise DataError(
            f"{image}: holds no light of the shape: the mean BRDF of {f.size} squares is "
            f"{with_u(float((weight * f).sum() / weight.sum()), spread / float(weight.sum()))} per sr: {remedy}"
        )
    # an offset alone is the same in light and shade; what a surface reflects is about in proportion to its light
    signal, noise = f / squares.per_value[used], u / squares.per_value[used]
    dark = math.sqrt(float(np.mean(exposure.constant)) + exposure.step**2 / 12.0)
    level = float(np.average(signal, weights=noise**-2.0))
    even = float((((signal - level) / noise) ** 2).sum())
    matte = float((((f - np.average(f, weights=weight)) / u) ** 2).sum())
    if (
        level < max(DIM * dark, DIM_DN * exposure.step)
        and even < f.size + DETECTED * math.sqrt(2.0 * f.size)
        and matte > even + DETECTED**2
    ):
        raise DataError(
            f"{image}: the shape is as bright in shade as in light, {level:.2g} "
            f"{'electrons' if exposure.step else 'units'} a pixel: a wrong black level or dark current gives that: "
            f"{remedy}"
        )


def _picked(seen: Seen, here: Mask) -> Seen:
    return Seen(*(getattr(seen, name)[here] for name in Seen.__dataclass_fields__))


def _tangents(normal: Floats) -> Floats:
    """Two unit vectors across each normal, (n, 3, 2)."""
    helper = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(helper, normal)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normal, first)], axis=2)


def _across_picture(vantage: Vantage, column: Floats, row: Floats) -> Floats:
    """d(normal)/d(column, row) of `Seen.normal`, (n, 3, 2) [1/px]."""
    sides = [vantage.at(column + x, row + y).normal for x, y in ((0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5))]
    return np.stack([sides[0] - sides[1], sides[2] - sides[3]], axis=2)


def _common(
    squares: _Squares,
    used: Mask,
    exposure: Exposure,
    given: dict[str, float],
    moved: dict[str, tuple[Vantage, Vantage]],
    seen: Seen,
    jacobian: Floats,
) -> tuple[dict[str, Floats], float]:
    """Cause -> what one standard deviation of it does to each value [1/sr]; and the angle [deg] of `_unseen`."""
    f = squares.value[used]
    out: dict[str, Floats] = {}
    if given["irradiance_rel"]:
        out["irradiance"] = f * given["irradiance_rel"]
    if given["black_level_dn"] and exposure.step:
        out["black_level"] = given["black_level_dn"] * exposure.step * squares.per_value[used]
    if not moved:
        return out, 0.0
    column, row = squares.column[used], squares.row[used]
    if squares.flat:
        jacobian = _tangents(seen.normal)
    inverse: Floats = np.asarray(np.linalg.pinv(jacobian, rcond=FLAT), np.float64)
    slopes = _slopes(squares, used, seen.normal, jacobian)
    turned, opened = np.zeros(f.size), np.zeros(f.size)
    for name, both in moved.items():
        ends, turns, angles = [], [], []
        for end in both:
            other = end.at(column, row)
            change = other.normal - seen.normal
            step = np.einsum("nij,nj->ni", inverse, change)
            beyond = change - np.einsum("nij,nj->ni", jacobian, step)
            beyond -= np.einsum("ni,ni->n", beyond, seen.normal)[:, None] * seen.normal  # unit vectors stay so
            turns.append(np.linalg.norm(beyond, axis=1))
            angles.append(other.difference)
            ends.append(slopes.moved(step) * other.received / seen.received)
        out[name] = 0.5 * (ends[0] - ends[1])
        turned += (0.5 * (turns[0] + turns[1])) ** 2
        opened += (0.5 * (angles[0] - angles[1])) ** 2
    widest = math.degrees(math.sqrt(float(np.nanmax(opened + turned))))
    turned, opened = np.asarray(np.sqrt(turned)), np.asarray(np.sqrt(opened))
    return out | _unseen(squares, used, slopes, inverse, seen, turned, opened), widest


def _unseen(
    squares: _Squares, used: Mask, slopes: _Slopes, inverse: Floats, seen: Seen, turned: Floats, opened: Floats
) -> dict[str, Floats]:
    """What all causes together may do in directions that the picture does not hold [1/sr].

    `opened` [rad] is the change of half the angle between light and viewer, which is nearly the same in the whole
    picture. What it does to f is, for all models here, close to a f + b (f - f_low) with f_low the level far from the
    lobe; a and b are unknown. `turned` [rad] is a turn of the normal that no place of the picture has, as along a
    cylinder; f may change with it as fast as along the picture.
    """
    f = squares.value[used]
    low = float(np.quantile(squares.around[used], LOW))
    tangent = np.tan(seen.difference)
    out = {
        "unseen_level": LEVEL_SLOPE * opened * f,
        "unseen_lobe": (LOBE_SLOPE + 2.0 * tangent) * opened * f * (1.0 - low / squares.around[used]),
    }
    if float(turned.max()) > STILL:
        steep = np.einsum("ni,nij->nj", slopes.gradient, inverse)
        out["unseen_turn"] = math.sqrt(float(np.mean(steep**2))) * turned * f
    return {name: column for name, column in out.items() if np.any(np.abs(column) > 0.0)}
