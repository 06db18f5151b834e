"""What shines in a scene: directional light, points, discs of finite size, and uniform ambient light.

Numbers of a scene file that may depend on the wavelength: a number, or a table of wavelengths and values.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    Field,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_validator,
)

from gonio.config import Strict
from gonio.errors import ConfigError
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.kinematics import view
from gonio.lab.rig.protocols import Pose
from gonio.spectra import Spectrum, Wavelength
from gonio.typing import Floats
from gonio_scenes.camera import on_disc, point
from gonio_scenes.shapes.shape import Coordinate, Length, refuse_parallel, unit

MAX_WAVELENGTHS = 1000


class NonNegativeSpectrum(Spectrum):
    """A spectrum without a value below 0: of a light, or of a reflectance."""

    @model_validator(mode="after")
    def _not_negative(self) -> "NonNegativeSpectrum":
        if min(self.value) < 0:
            raise ValueError(f"value holds {min(self.value):g}: must be at least 0")
        return self


def table_or(table: type[Strict], otherwise: str) -> WrapValidator:
    """For a key that holds a table or something else (`otherwise`, in words): errors name the key that is wrong."""

    def check(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        if not isinstance(value, dict):
            try:
                return handler(value)
            except ValidationError:
                raise ValueError(f"must be {otherwise}, or a table with {' and '.join(table.model_fields)}") from None
        try:
            return table.model_validate(value)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"])
            message = first["msg"].removeprefix("Value error, ")
            raise ValueError(f"{key + ': ' if key else ''}{message[:1].lower()}{message[1:]}") from None

    return WrapValidator(check)


Spectral = Annotated[
    Annotated[float, Field(ge=0)] | NonNegativeSpectrum, table_or(NonNegativeSpectrum, "a number of at least 0")
]
"""A number at least 0, the same at every wavelength, or a table."""


class WavelengthRange(Strict):
    """Wavelengths from `start` to `stop`, both included where the step fits [nm]."""

    start: Wavelength
    stop: Wavelength
    step: Annotated[float, Field(gt=0)]

    @model_validator(mode="after")
    def _sound(self) -> "WavelengthRange":
        if self.stop < self.start:
            raise ValueError("needs start <= stop")
        if (self.stop - self.start) / self.step >= MAX_WAVELENGTHS:
            raise ValueError(f"has more than {MAX_WAVELENGTHS} wavelengths; take a larger step")
        return self

    def all(self) -> tuple[float, ...]:
        """Every wavelength [nm]."""
        count = int((self.stop - self.start) / self.step + 1.0 + 1e-9)
        return tuple(self.start + k * self.step for k in range(count))


def values(spectral: float | Spectrum, wavelength_nm: Floats) -> Floats:
    """A spectral number at wavelengths, of their shape."""
    if isinstance(spectral, Spectrum):
        return np.array([spectral.at(wave) for wave in wavelength_nm])
    return np.full(wavelength_nm.shape, float(spectral))


Vector = tuple[Coordinate, Coordinate, Coordinate]


class _Light(Strict):
    name: str = ""
    spectrum: Annotated[
        str | NonNegativeSpectrum | None, table_or(NonNegativeSpectrum, 'the name of an illuminant as "D65"')
    ] = None
    """Relative spectral power that multiplies the light's value: "D65", "A", "D50" (1 at 560 nm), or a table."""

    polarisation: Vector | None = None
    """Along the electric field of linearly polarised light; what of it lies along the light does not count."""

    @field_validator("polarisation")
    @classmethod
    def _is_a_direction(cls, vector: Vector | None) -> Vector | None:
        if vector is not None:
            _some_direction("polarisation", vector)
        return vector


def _some_direction(name: str, vector: Vector) -> None:
    if not any(vector):
        raise ValueError(f"{name} = [0, 0, 0] is no direction")


class DirectionalTable(_Light):
    """Light from one direction, as from far away."""

    kind: Literal["directional"]
    toward: Vector
    """Direction from the scene to the light; its length does not matter."""
    irradiance: Spectral
    """Irradiance on a surface that faces the light."""

    @model_validator(mode="after")
    def _sound(self) -> "DirectionalTable":
        _some_direction("toward", self.toward)
        if self.polarisation is not None:
            refuse_parallel("toward", self.toward, self.polarisation, "polarisation")
        return self


class PointTable(_Light):
    """A point that shines alike in all directions."""

    kind: Literal["point"]
    position_mm: Vector
    intensity: Spectral
    """[1/sr]; the irradiance at the distance d, facing the light, is intensity / d^2 with d in mm."""


class DiscTable(_Light):
    """A disc of uniform radiance on the side that `normal` points to; the other side is dark, and in nobody's way."""

    kind: Literal["disc"]
    center_mm: Vector
    normal: Vector
    radius_mm: Length
    radiance: Spectral
    samples: Annotated[int, Field(ge=1, le=65536)] = 16
    """Points of the disc that a ray's hit looks at."""
    visible: bool = False
    """Whether the camera sees the disc itself; mirror rays always do."""

    @model_validator(mode="after")
    def _sound(self) -> "DiscTable":
        _some_direction("normal", self.normal)
        return self


class RigTable(_Light):
    """The lamp of the camera's rig, at its pose: a disc that faces the origin."""

    kind: Literal["rig"]
    irradiance: Spectral
    """Irradiance at the origin, on a surface that faces the lamp."""
    samples: Annotated[int, Field(ge=1, le=65536)] = 16
    visible: bool = False


class AmbientTable(_Light):
    """Uniform radiance from all around, without shadows and unpolarised."""

    kind: Literal["ambient"]
    radiance: Spectral


Shining = DirectionalTable | PointTable | DiscTable | RigTable
LightTable = Annotated[Shining | AmbientTable, Field(discriminator="kind")]


@dataclass(frozen=True)
class Arriving:
    """Light that arrives at hits from one direction each."""

    direction: Floats
    """Unit vectors (n, 3) toward the light; one (3,) where it is the same for all."""
    distance: Floats | float
    """How far the light is [mm], (n,); inf for directional light."""
    strength: Floats | float
    """What multiplies the light's spectral `power` to give the irradiance on a surface that faces the light, (n,)."""


def _from_point(place: Floats, position: Floats) -> Arriving:
    """What a point of unit intensity at a place, or at one for each hit, gives at positions (n, 3)."""
    away = place - position
    squared = np.einsum("ij,ij->i", away, away)
    distance = np.sqrt(squared)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Arriving(away / distance[:, None], distance, 1.0 / squared)


@dataclass(frozen=True)
class Directional:
    """Light from one direction."""

    power: Floats
    """Irradiance at each wavelength, (w,)."""
    toward: Floats
    polarisation: Floats | None = None
    samples: int = 1

    def arrive(self, position: Floats, sample: int, shift: Floats | None) -> Arriving:
        """The light at positions (n, 3)."""
        return Arriving(self.toward, math.inf, 1.0)


@dataclass(frozen=True)
class PointLight:
    """A point that shines alike in all directions."""

    power: Floats
    """Intensity at each wavelength, (w,)."""
    position: Floats
    polarisation: Floats | None = None
    samples: int = 1

    def arrive(self, position: Floats, sample: int, shift: Floats | None) -> Arriving:
        """The light at positions (n, 3)."""
        return _from_point(self.position, position)


@dataclass(frozen=True)
class DiscLight:
    """A disc of uniform radiance on one side."""

    power: Floats
    """Radiance at each wavelength, (w,)."""
    center: Floats
    normal: Floats
    radius: float
    samples: int
    visible: bool
    polarisation: Floats | None = None

    def arrive(self, position: Floats, sample: int, shift: Floats | None) -> Arriving:
        """What arrives at positions (n, 3) from one point of the disc; the disc's light is the mean over its points.

        `sample` numbers the point, and `shift` (n, 2) moves each hit's points over the disc; without it they are the
        centre.
        """
        at = self.center
        if shift is not None:
            a, b = on_disc(*point(sample, shift))
            first, second = across(self.normal)
            at = self.center + self.radius * (a[:, None] * first + b[:, None] * second)
        of_point = _from_point(at, position)
        facing = np.maximum(-(of_point.direction @ self.normal), 0.0)
        return replace(of_point, strength=math.pi * self.radius**2 * facing * of_point.strength)

    def seen(self, origin: Floats, direction: Floats) -> Floats:
        """Distance along rays to the shining side of the disc, inf where they miss it."""
        toward = direction @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = ((self.center - origin) @ self.normal) / toward
            at = origin + distance[:, None] * direction - self.center
        inside = np.einsum("ij,ij->i", at, at) <= self.radius**2
        return np.where((toward < 0.0) & (distance > 0.0) & inside, distance, math.inf)


Light = Directional | PointLight | DiscLight


def across(normal: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors across a normal and each other: a right-handed frame with it."""
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(helper, normal)
    first /= np.linalg.norm(first)
    return first, np.cross(normal, first)


def power(table: _Light, value: float | NonNegativeSpectrum, wavelength_nm: Floats) -> Floats:
    """A light's value at each wavelength, its spectrum included."""
    strength = values(value, wavelength_nm)
    if isinstance(table.spectrum, str):
        return strength * relative_power(table.spectrum, wavelength_nm)
    return strength if table.spectrum is None else strength * values(table.spectrum, wavelength_nm)


def relative_power(illuminant: str, wavelength_nm: Floats) -> Floats:
    """Relative spectral power of a CIE illuminant, 1 at 560 nm.

    Raises
    ------
    ConfigError
        There is no such illuminant, or its table does not reach a wavelength.
    """
    from gonio import colour

    table = colour.wavelengths()
    outside = wavelength_nm[(wavelength_nm < table[0]) | (wavelength_nm > table[-1])]
    if outside.size:
        raise ConfigError(
            f'spectrum = "{illuminant}" is a table from {table[0]:g} to {table[-1]:g} nm and has no value at '
            f"{outside[0]:g} nm: give spectrum = {{ wavelength_nm = [...], value = [...] }}"
        )
    return np.interp(wavelength_nm, table, colour.illuminant(illuminant) / 100.0)


def from_table(table: Shining, wavelength_nm: Floats, rig: RigDescription | None, pose: Pose | None) -> Light:
    """A light of a scene file at its wavelengths; `rig` and `pose` are the camera's, for a light of the kind "rig"."""
    field = None if table.polarisation is None else unit(table.polarisation)
    if isinstance(table, DirectionalTable):
        return Directional(power(table, table.irradiance, wavelength_nm), unit(table.toward), field)
    if isinstance(table, PointTable):
        return PointLight(power(table, table.intensity, wavelength_nm), np.array(table.position_mm), field)
    if isinstance(table, DiscTable):
        return DiscLight(
            power(table, table.radiance, wavelength_nm),
            np.array(table.center_mm),
            unit(table.normal),
            table.radius_mm,
            table.samples,
            table.visible,
            field,
        )
    assert isinstance(table, RigTable)
    assert rig is not None
    assert pose is not None
    return _lamp(table, wavelength_nm, rig, pose, field)


def _lamp(table: RigTable, wavelength_nm: Floats, rig: RigDescription, pose: Pose, field: Floats | None) -> Light:
    """The rig's lamp: a disc about its centre that faces the sample, a point if the rig file gives it no size."""
    position = view(rig, pose).source_mm
    distance = rig.geometry.light_distance_mm
    irradiance = power(table, table.irradiance, wavelength_nm)
    half = math.radians(rig.lamp.half_angle_deg)
    if half == 0.0:
        return PointLight(irradiance * distance**2, position, field)
    # on the axis a disc of radiance L and half-angle a gives the irradiance pi L sin^2 a
    return DiscLight(
        irradiance / (math.pi * math.sin(half) ** 2),
        position,
        -position / distance,
        distance * math.tan(half),
        table.samples,
        table.visible,
        field,
    )
