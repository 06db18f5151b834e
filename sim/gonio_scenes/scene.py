"""The scene file: checked tables, and the scene that they describe."""

import itertools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from gonio.config import NonNegative, Positive, Strict, load
from gonio.errors import ConfigError, DataError, did_you_mean
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.rig.description import RigDescription
from gonio.models import examine
from gonio.renderers.tabulated import Tabulated
from gonio.spectra import CHANNELS_NM, Wavelength
from gonio.typing import Floats
from gonio_scenes import camera as cameras
from gonio_scenes import lights, polarised
from gonio_scenes.camera import CameraTable, SceneCamera, SensorTable, require_size
from gonio_scenes.lights import (
    MAX_WAVELENGTHS,
    AmbientTable,
    DiscLight,
    Light,
    LightTable,
    PointLight,
    RigTable,
    WavelengthRange,
    table_or,
)
from gonio_scenes.material import MaterialTable, SceneMaterial
from gonio_scenes.shapes import AnyShape
from gonio_scenes.world import SceneShapes


class PictureTable(Strict):
    """The table [picture]: how radiances are shown. It changes no number of `radiance.npz`."""

    white: Positive | None = None
    """The luminance shown as white: that of a perfect white under irradiance pi is 1. Chosen from the picture if not
    given."""
    display: Literal["srgb", "1982"] = "srgb"
    """Today's practice, or Cook and Torrance's: scaled as a whole, desaturated at constant dominant wavelength."""


class UncertaintyTable(Strict):
    """The table [photograph.uncertainty]: standard uncertainties of what a reduction takes for known."""

    irradiance_rel: NonNegative = 0.0
    """Uncertainty of the absolute scale: the light's strength and the sensor's responsivity together."""
    light_deg: NonNegative = 0.0
    """Uncertainty of a directional light, along each of two axes across its direction."""
    light_mm: NonNegative = 0.0
    """Uncertainty of the place of a point or a disc of light, along x, y and z each."""
    center_mm: NonNegative = 0.0
    """Uncertainty of the shape's place, along x, y and z each."""
    radius_mm: NonNegative = 0.0
    camera_mm: NonNegative = 0.0
    """Uncertainty of the camera's place, along x, y and z each; it goes on looking in the same direction."""
    pointing_deg: NonNegative = 0.0
    """Uncertainty of the camera's turn to the right, and of that upward."""
    roll_deg: NonNegative = 0.0
    """Uncertainty of the camera's turn about its axis."""
    field_rel: NonNegative = 0.0
    """Uncertainty of the size of a pixel on the plane at distance 1: the focal length."""
    black_level_dn: NonNegative = 0.0


class PhotographTable(Strict):
    """The table [photograph]: the sensor behind the lens, and how its frames are reduced."""

    sensor: SensorTable | None = None
    """Needed for raw frames, simulated or real."""
    exposure_s: Positive | None = None
    """Exposure of the simulated frame; a raw file says its own."""
    seed: Annotated[int, Field(ge=0, lt=1 << 63)] = 0
    """Seed of the simulated frame's noise."""
    shape: str | None = None
    """The name of the shape that is measured; a scene of one shape need not say it."""
    channel: Literal["R", "G", "B"] | None = None
    """The channel of a colour mosaic, or of a picture in three colours."""
    bin: Annotated[int, Field(ge=1, le=512)] | None = None
    """Pixels along a side of the squares that become rows; otherwise as many as make about 4000 squares."""
    limb_px: Annotated[int, Field(ge=0, le=512)] = 2
    """Pixels nearer than this to an edge of the shape are not used."""
    theta_max_deg: Annotated[float, Field(gt=0, le=90)] = 80.0
    """Directions nearer to grazing are not used."""
    noise_rel: NonNegative | None = None
    """In a picture of linear radiances: standard deviation of a pixel, relative."""
    noise: NonNegative | None = None
    """In a picture of linear radiances: standard deviation of a pixel, in units of radiance."""
    uncertainty: UncertaintyTable = UncertaintyTable()

    @model_validator(mode="after")
    def _sound(self) -> "PhotographTable":
        if self.exposure_s is not None and self.sensor is None:
            raise ValueError("exposure_s is that of a simulated raw frame, which needs the table [photograph.sensor]")
        return self

    @property
    def simulated(self) -> bool:
        """Whether a raw frame is to be rendered."""
        return self.exposure_s is not None


class SceneFile(Strict):
    """A scene file, as it is written."""

    name: str
    wavelength_nm: Annotated[
        tuple[Wavelength, ...] | WavelengthRange | Literal["rgb"],
        table_or(WavelengthRange, 'a list of wavelengths in nm, "rgb"'),
    ]
    """Or "rgb": the three channels of linear sRGB, each at its nominal wavelength (`gonio.spectra.RGB_NM`)."""
    camera: CameraTable
    shape: tuple[AnyShape, ...]
    material: dict[str, MaterialTable]
    light: tuple[LightTable, ...]
    picture: PictureTable = PictureTable()
    photograph: PhotographTable | None = None
    mirror_depth: Annotated[int, Field(ge=0, le=64)] = 4
    """How many mirror rays follow each other at most."""
    tolerance: NonNegative = 0.0
    """Standard error that every pixel is brought below, of its own value or of the picture's mean, whichever is larger;
    0 for `camera.samples` rays a pixel, as they are."""
    seed: Annotated[int, Field(ge=0, lt=1 << 63)] = 0

    @model_validator(mode="after")
    def _sound(self) -> "SceneFile":
        waves = self.waves()
        if not waves or len(waves) > MAX_WAVELENGTHS:
            raise ValueError(f"wavelength_nm holds {len(waves)} wavelengths: 1 to {MAX_WAVELENGTHS} are rendered")
        if any(b <= a for a, b in itertools.pairwise(waves)):
            raise ValueError("wavelength_nm must grow from entry to entry")
        for key in ("shape", "light"):
            if not getattr(self, key):
                raise ValueError(f"{key} = []: a scene needs one [[{key}]] at least")
        for k, shape in enumerate(self.shape):
            if shape.material not in self.material:
                hint = did_you_mean(shape.material, self.material, f"there are: {', '.join(self.material) or 'none'}")
                raise ValueError(
                    f'shape[{k + 1}].material = "{shape.material}": no [material] table of that name; {hint}'
                )
        if sum(isinstance(light, AmbientTable) for light in self.light) > 1:
            raise ValueError("light: one ambient light is all: add their radiances")
        if self.camera.rig is None and any(isinstance(light, RigTable) for light in self.light):
            raise ValueError('light: kind = "rig" is the lamp of camera.rig, which is missing')
        for k, light in enumerate(self.light):
            if self.of_channels and isinstance(light.spectrum, str) and light.spectrum != "D65":
                raise ValueError(
                    f'light[{k + 1}].spectrum = "{light.spectrum}": in channels of sRGB white is D65; leave it out, or '
                    "list wavelengths in nm"
                )
        if self.photograph is not None and len(waves) != 1:
            raise ValueError(
                f"photograph: a raw frame is taken at one wavelength, and wavelength_nm holds {len(waves)}: write a "
                "scene file a wavelength"
            )
        return self

    def waves(self) -> tuple[float, ...]:
        """The wavelengths [nm]."""
        if isinstance(self.wavelength_nm, str):
            return CHANNELS_NM
        return self.wavelength_nm.all() if isinstance(self.wavelength_nm, WavelengthRange) else self.wavelength_nm

    @property
    def of_channels(self) -> bool:
        """Whether the radiances are those of the channels of linear sRGB."""
        return self.wavelength_nm == "rgb"


@dataclass(frozen=True)
class Scene:
    """A scene that can be rendered."""

    name: str
    wavelength_nm: Floats
    camera: SceneCamera
    world: SceneShapes
    material: tuple[SceneMaterial, ...]
    """Of each shape."""
    lights: tuple[Light, ...]
    ambient: Floats | None
    """Radiance of the ambient light at each wavelength."""
    mirror_depth: int
    tolerance: float
    seed: int
    picture: PictureTable
    source: Path
    """The scene file, as messages name it."""
    tables: SceneFile = field(repr=False)


def too_bright(scene: Scene) -> list[str]:
    """Materials that reflect more than they receive, a sentence each, at the first and the last wavelength."""
    waves = {0, len(scene.wavelength_nm) - 1}
    found = [examine(one.at(k), float(scene.wavelength_nm[k])) for one in scene.material for k in sorted(waves)]
    return [one.too_bright for one in found if one.too_bright]


def tables(scene: Scene) -> dict[str, Tabulated]:
    """The materials that are measured tables, by name."""
    named = zip(scene.tables.shape, scene.material, strict=True)
    return {table.material: one.tabulated for table, one in named if one.tabulated is not None}


def read(path: str | Path) -> Scene:
    """Read a scene file.

    Raises
    ------
    ConfigError, DataError
        The file, or one that it names, is missing or wrong; the message names file, key and remedy.
    """
    path = Path(path)
    return build(load(SceneFile, path), path)


def build(tables: SceneFile, source: Path) -> Scene:
    """The scene of checked tables; relative files lie beside `source`, which messages name."""
    try:
        return _built(tables, source)
    except (ConfigError, DataError) as error:
        raise type(error)(f"{source}: {error}") from None


def _built(tables: SceneFile, source: Path) -> Scene:
    folder = source.parent
    waves = np.array(tables.waves())
    rig = _rig(tables.camera, folder)
    pose = tables.camera.pose.pose() if tables.camera.pose is not None else None
    used = dict.fromkeys(shape.material for shape in tables.shape)
    materials = {name: SceneMaterial(tables.material[name], waves, folder, f"material.{name}") for name in used}
    shapes = []
    for k, table in enumerate(tables.shape):
        try:
            shapes.append(table.build(folder))
        except (ConfigError, DataError) as error:
            raise type(error)(f"shape[{k + 1}] ({table.kind}): {error}") from None
    if any(not isinstance(light, AmbientTable) and light.polarisation is not None for light in tables.light):
        for name, material in materials.items():
            polarised.require(material.model, f"material.{name}")
    camera = cameras.from_table(tables.camera, rig)
    if tables.photograph is not None and tables.photograph.simulated:
        require_size(camera)
    world = SceneShapes(shapes, camera.position)
    shining: list[Light] = []
    ambient: Floats | None = None
    for k, light in enumerate(tables.light):
        if tables.of_channels and isinstance(light.spectrum, str):  # white, which is 1 in each channel
            light = light.model_copy(update={"spectrum": None})
        try:
            if isinstance(light, AmbientTable):
                ambient = lights.power(light, light.radiance, waves)
                continue
            made = lights.from_table(light, waves, rig, pose)
        except ConfigError as error:
            raise ConfigError(f"light[{k + 1}] ({light.kind}): {error}") from None
        _check_free(made, f"light[{k + 1}] ({light.kind})", tables, world, camera)
        shining.append(made)
    return Scene(
        name=tables.name,
        wavelength_nm=waves,
        camera=camera,
        world=world,
        material=tuple(materials[shape.material] for shape in tables.shape),
        lights=tuple(shining),
        ambient=ambient,
        mirror_depth=tables.mirror_depth,
        tolerance=tables.tolerance,
        seed=tables.seed,
        picture=tables.picture,
        source=source,
        tables=tables,
    )


def _rig(table: CameraTable, folder: Path) -> RigDescription | None:
    """The rig that a camera belongs to; a relative file lies beside the scene file."""
    if table.rig is None:
        return None
    beside = folder / table.rig
    return find_rig(str(beside) if beside.is_file() else table.rig).description


def _check_free(light: Light, where: str, tables: SceneFile, world: SceneShapes, camera: SceneCamera) -> None:
    """Refuse a light inside a closed shape, unless the camera is in it too (a room)."""
    if not isinstance(light, (PointLight, DiscLight)):
        return
    place = light.position if isinstance(light, PointLight) else light.center
    for k, (shape, table) in enumerate(zip(world.shapes, tables.shape, strict=True)):
        if shape.closed and shape.contains(place) and not shape.contains(camera.position):
            raise ConfigError(
                f"{where} lies inside shape[{k + 1}] ({table.kind}), which it cannot leave: move it outside, or the "
                "camera inside"
            )
