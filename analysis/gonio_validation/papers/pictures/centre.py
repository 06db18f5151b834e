"""Pictures of one ray a pixel, through its centre: radiances, and where they come from, are exact there."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from gonio_scenes.integrator import Integrator
from gonio_scenes.render import Picture, render
from gonio_scenes.scene import Scene, SceneFile, build

from gonio.config import load
from gonio.typing import Floats, TomlTable
from gonio_validation.papers.pictures.catalogue import scene_file

Mask = npt.NDArray[np.bool_]
Change = Callable[[TomlTable], None]
"""Changes the tables of a scene file before they are checked again."""


@dataclass(frozen=True)
class Centre:
    """A scene and its radiances at the pixels' centres; lights of finite size shine from theirs."""

    scene: Scene
    picture: Picture

    @property
    def radiance(self) -> Floats:
        """(height, width, wavelengths)."""
        return self.picture.radiance

    def on(self, *names: str) -> Mask:
        """The pixels on shapes of these names, (height, width)."""
        numbers = [k for k, table in enumerate(self.scene.tables.shape) if table.name in names]
        return np.isin(self.picture.shape, numbers)

    @cached_property
    def toward_camera(self) -> Floats:
        """Unit vectors from the surface to the camera, (height, width, 3)."""
        away = self.scene.camera.position - self.picture.position
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))

    @cached_property
    def facing(self) -> Floats:
        """Normals on the camera's side, (height, width, 3)."""
        normal = self.picture.normal
        behind = np.einsum("...k,...k", normal, self.toward_camera) < 0.0
        return np.where(behind[..., None], -normal, normal)

    @cached_property
    def cosine(self) -> Floats:
        """Cosine of the viewing angle, (height, width)."""
        return np.asarray(np.einsum("...k,...k", self.facing, self.toward_camera))

    def near(self, wavelength_nm: float) -> int:
        """The number of the nearest wavelength."""
        return int(np.argmin(np.abs(self.scene.wavelength_nm - wavelength_nm)))

    def grey(self) -> Floats:
        """Radiances at the only, or the middle, wavelength, (height, width)."""
        return self.radiance[..., self.scene.wavelength_nm.size // 2]

    def mirrored(self, where: Mask) -> Floats:
        """What mirrors at some pixels would see, (n, wavelengths)."""
        view, normal = self.toward_camera[where], self.facing[where]
        toward = 2.0 * np.einsum("ij,ij->i", view, normal)[:, None] * normal - view
        # off the surface by far less than anything in a scene, and far more than rounding
        start = self.picture.position[where] + 1e-6 * normal
        onward = replace(self.scene, mirror_depth=self.scene.mirror_depth - 1)
        return Integrator(onward).radiance(start, toward, None)[0]


def centre(name: str, *, height: int | None = None, change: Change | None = None) -> Centre:
    """Render a scene file of the papers' pictures with one ray a pixel.

    Parameters
    ----------
    name
        Of a scene, as in `catalogue.names`.
    height
        Rows of the picture, in place of the file's; columns in proportion.
    change
        Changes the checked tables, as a dictionary, before they are built.
    """
    path = scene_file(name)
    tables = load(SceneFile, path).model_dump(exclude_none=True, exclude_unset=True)
    camera = tables["camera"]
    if height is not None:
        camera["width"] = max(1, round(camera["width"] * height / camera["height"]))
        camera["height"] = height
    camera["samples"] = 1
    tables["tolerance"] = 0.0
    for light in tables["light"]:
        if light["kind"] == "disc":
            light["samples"] = 1
    if change is not None:
        change(tables)
    scene = build(SceneFile.model_validate(tables), path)
    return Centre(scene, render(scene))


def edges(value: Floats, where: Mask, reference: Floats) -> tuple[float, float]:
    """How strong a picture is in another, and how alike the two are, from the steps between neighbours in a row.

    Parameters
    ----------
    value, reference
        Two pictures, (height, width).
    where
        Pixels; steps between two of them count.

    Returns
    -------
    strength, correlation
        The slope of a line through zero, and the correlation of the steps. Steps are large at edges: what is
        blurred by a pixel has small ones at other places, and shades, which change slowly, have none. The correlation
        is that within rows, weighted by the reference's steps: a strength that differs from row to row is no blur.
    """
    pairs = where[:, 1:] & where[:, :-1]
    a, b = (np.where(pairs, np.diff(v, axis=1), 0.0) for v in (value, reference))
    cross, own, other = (np.sum(x * y, axis=1) for x, y in ((a, b), (a, a), (b, b)))
    rows = (own > 0.0) & (other > 0.0)
    alike = cross[rows] / np.sqrt(own[rows] * other[rows])
    return float(cross.sum() / other.sum()), float(np.average(alike, weights=other[rows]))


def blurred(value: Floats, where: Mask) -> Floats:
    """A picture blurred over three pixels of a row, within some of its pixels."""
    inside = np.where(where, value, 0.0)
    total = sum(np.roll(inside, k, axis=1) for k in (-1, 0, 1))
    count = sum(np.roll(where.astype(float), k, axis=1) for k in (-1, 0, 1))
    return np.asarray(total / np.maximum(count, 1.0))


def altogether(*changes: Change) -> Change:
    """Changes one after another."""

    def change(tables: TomlTable) -> None:
        for each in changes:
            each(tables)

    return change


def many(names: Iterable[str], height: int | None = None, change: Change | None = None) -> dict[str, Centre]:
    """`centre` of several scenes."""
    return {name: centre(name, height=height, change=change) for name in names}
