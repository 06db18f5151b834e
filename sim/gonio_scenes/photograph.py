"""A photograph of a curved sample as a measurement: every square of pixels is a row of a measurement table.

See docs/photograph.md for the design, and for what is neglected and how small that is.

How f changes is taken from the picture itself: a displaced cause has the normals of another place on the sphere. Two
things the picture does not show get columns of their own.

- `s_unseen_level`, `s_unseen_lobe`: theta_d, half of the angle between light and viewer, is nearly the same in the
  whole picture, and an error of the light changes it. d f/d theta_d at the same normal is a f + b (f - f_low), with
  f_low the level far from the lobe (5 % quantile). Of random samples a lies between -0.5 and 0; b is 0.6, 1.4 and 2 to
  3 for lobes (theta_d 15, 30 and 43 degrees), about -1 to -1.8 for Oren-Nayar. The columns take 0.3 and 0.5 + 2 tan
  theta_d as standard deviations of a and b. With them a light 0.3 degrees off leaves 0.02 % of coherent error on a
  rough metal (0.24 % without).
- `s_unseen_turn`: a turn of the normal that no place has, as along a cylinder.
"""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from gonio import __version__, geometry
from gonio.errors import ConfigError, DataError
from gonio.formats.reader import ANGLES, Attributes, attributes
from gonio.typing import Bools, DataFrame, Floats, NDArray
from gonio_scenes import exposures
from gonio_scenes.exposures import Exposure
from gonio_scenes.scene import Scene
from gonio_scenes.shapes import AnyShape, Shape
from gonio_scenes.shapes.analytic import Analytic, Revolution
from gonio_scenes.shapes.heightfield import Heights
from gonio_scenes.squares import FLAGS, RING, Mask, Squares, WholePicture, common, require_light
from gonio_scenes.vantage import Seen, Vantage, displaced
from gonio_scenes.world import Hits, SceneShapes

ROWS = 4000
"""Squares, about, where the file does not say how large they are."""
BLOCK = 1 << 17
"""Pixels that are traced together."""
EDGE_DEG = 10.0
"""Normals of neighbouring pixels that differ by more lie on either side of an edge."""
FEW_FACETS = 30
"""Facets in sight from which on they say together how f changes with the normal; fewer are looked at one by one."""
REACH = 3.0
"""Standard deviations, of all causes together, by which creases may lie elsewhere: closer pixels are not used."""
KEY = np.array([1.0, math.sqrt(2.0), math.pi])
"""Normals are the same where their products with it are, to `SAME`."""
SAME = 1e-9
SEVERAL, ALIKE = 20, 0.01
"""Pixels that have the same value though their light differs by this much: it was cut off there."""


def reduce(scene: Scene, image: str | Path) -> DataFrame:
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
    assert table is not None  # `exposures.read` has refused it
    moved = displaced(vantage, scene.tables.shape[which], scene.source.parent, table.uncertainty)
    pixels = _looked_at(scene, vantage, which, exposure, table.limb_px, moved)
    seen = pixels.why >= 0
    if not (seen & exposure.used).any():
        raise DataError(f"{image}: the camera of the scene does not see the shape that is measured")
    size = table.bin or max(1, math.ceil(math.sqrt(np.count_nonzero(seen) / ROWS)))
    if table.channel is not None and size % 2 and not exposure.used.all():
        size += 1  # a square of a mosaic holds whole cells
    squares = Squares(pixels, exposure, size, scene.camera.samples > 1)
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
    if scene.lights[0].polarisation is not None:
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
) -> WholePicture:
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
    facets = isinstance(vantage.shape, Heights)
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
    return WholePicture(received.reshape(shape), why, piece, flat, facets and crease is None)


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
    if isinstance(shape, Heights) and shape.normals is None:
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
    """Places of the picture with another facet at one of eight places `beside` pixels away."""
    out = np.zeros(len(column), bool)
    if beside.max() == 0.0:
        return out
    for down, right in RING:
        origin, direction = vantage.camera.through(column + right * beside, row + down * beside)
        there = SceneShapes([vantage.shape], vantage.camera.position).hit(origin - vantage.shift, direction)
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


# --- the table -------------------------------------------------------------------------------------------------------


def _table(
    scene: Scene,
    image: Path,
    exposure: Exposure,
    vantage: Vantage,
    moved: dict[str, tuple[Vantage, Vantage]],
    squares: Squares,
    theta_max_deg: float,
) -> DataFrame:
    import pandas as pd

    given = scene.tables.photograph
    assert given is not None
    there = np.flatnonzero(squares.of_shape)
    seen = vantage.at(squares.column.flat[there], squares.row.flat[there])
    omega_i, omega_r = seen.omega_i, seen.omega_r
    flag = np.array(["", *FLAGS], dtype=object)[squares.why.flat[there]]
    value, random = squares.value.flat[there], squares.random.flat[there]
    flag[(flag == "") & ~seen.met] = "limb"
    middle = scene.world.hit(*scene.camera.through(squares.column.flat[there], squares.row.flat[there]))
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
    require_light(image, squares, grid, exposure, given.uncertainty.black_level_dn)
    stated = given.uncertainty.model_dump()
    columns, unseen_deg = common(squares, grid, exposure, stated, moved, _picked(seen, good), jacobian[good])
    if columns:  # the limb may come past a square before a cause has moved by one standard deviation
        whole = np.isfinite(np.stack(list(columns.values()))).all(axis=0)
        flag[np.flatnonzero(good)[~whole]] = "limb"
        good, columns = flag == "", {name: column[whole] for name, column in columns.items()}
    numbers = np.full((len(columns) + 2, flag.size), np.nan)
    numbers[0], numbers[1] = np.where(good, value, np.nan), np.where(good, random, np.nan)
    for k, name in enumerate(columns):
        numbers[2 + k, good] = columns[name]
    angles = [np.degrees(a) for omega in (omega_i, omega_r) for a in geometry.angles(np.nan_to_num(omega))]
    filled = dict(zip(ANGLES, angles, strict=True)) | {
        "wavelength_nm": float(scene.wavelength_nm[0]), "polarisation": "unpolarised", "brdf": numbers[0],
        "u_brdf": np.sqrt((numbers[1:] ** 2).sum(axis=0)), "u_random": numbers[1],
    }  # fmt: skip
    filled |= {f"s_{name}": numbers[2 + k] for k, name in enumerate(columns)} | {"flag": flag}
    frame = pd.DataFrame(filled)[shown].reset_index(drop=True)
    frame["flag"] = frame["flag"].astype(str)
    frame.attrs.update(_attributes(scene, image, exposure, squares, cones, good))
    frame.attrs["notes"] = _notes(scene, squares.size, flag[~shown], columns, unseen_deg)
    return frame


def _notes(scene: Scene, size: int, hidden: NDArray[np.object_], causes: Iterable[str], unseen_deg: float) -> list[str]:
    aside = {str(word): int(np.count_nonzero(hidden == word)) for word in sorted(set(hidden))}
    notes = [f"Each row is the mean over {size} x {size} pixels, brought to its middle."]
    notes += [f"{count} more squares have no directions above the horizon: {word}." for word, count in aside.items()]
    if any(name.startswith("unseen") for name in causes):
        notes.append(
            f"The stated uncertainties turn directions by up to {unseen_deg:.2g} degrees to where this picture does "
            "not look; what that may do is in the columns s_unseen."
        )
    if len(scene.world.shapes) > 1:
        notes.append("Light that the scene's other shapes reflect onto the sample is not subtracted.")
    return notes


def _attributes(
    scene: Scene,
    image: Path,
    exposure: Exposure,
    squares: Squares,
    cones: tuple[Floats, float],
    good: Bools,
) -> Attributes:
    """All but the notes; `cones` are half-angles [rad], of the source as each square sees it and of the lens."""
    given = scene.tables.photograph
    assert given is not None
    source = float(np.median(cones[0][good]))
    return attributes(
        quantity="brdf",
        source_solid_angle_sr=float(geometry.solid_angle_of_cone(source)),
        receiver_solid_angle_sr=float(geometry.solid_angle_of_cone(cones[1])),
        source_file=str(image),
        sample=scene.name,
        provenance={
            "reduced_by": f"gonio {__version__}",
            "scene": scene.name,
            "pixels_a_square": squares.size,
            **dict(exposure.described),
            "standard_uncertainties": {n: u for n, u in given.uncertainty.model_dump().items() if u},
        },
    )


def _picked(seen: Seen, here: Mask) -> Seen:
    return Seen(*(getattr(seen, name)[here] for name in Seen.__dataclass_fields__))


def _across_picture(vantage: Vantage, column: Floats, row: Floats) -> Floats:
    """d(normal)/d(column, row) of `Seen.normal`, (n, 3, 2) [1/px]."""
    sides = [vantage.at(column + x, row + y).normal for x, y in ((0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5))]
    return np.stack([sides[0] - sides[1], sides[2] - sides[3]], axis=2)
