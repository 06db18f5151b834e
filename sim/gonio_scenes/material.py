"""What a shape is made of: a model, whose parameters may be spectra, and textures by which they change over it."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from gonio import measurement, models
from gonio.config import Strict
from gonio.errors import ConfigError, GonioError
from gonio.models import Blinn, CookTorrance, HeTorrance, Lambert, Model, OrenNayar, Phong, Sum
from gonio.models.parameters import Parameters, index_at
from gonio.renderers import tabulated
from gonio.renderers.tabulated import Tabulated
from gonio.samples.files import load_sample
from gonio.samples.textures import PATTERNS, picture
from gonio.spectra import Spectrum, at_wavelength, spectra_in
from gonio.typing import Floats
from gonio_scenes import polarised
from gonio_scenes.lights import NonNegativeSpectrum, Spectral, table_or, values

AMBIENT_NODES = 65
"""Polar angles at which rho_hd is computed; between them it is interpolated, to 1e-3 of its largest value for gentle
and to 1e-5 for rough surfaces (docs/scenes.md)."""
AMBIENT_AZIMUTHS = 25
"""Azimuths of surfaces that have a direction of their own."""
AMBIENT_TOLERANCE = 1e-5
"""Tolerance of each value of the table: well below the error of the interpolation."""


# --- textures: a number in [0, 1] for each point of a surface ----------

Pattern = Callable[[Floats], Floats]
"""uv (n, 2) to values (n,) in [0, 1]."""
Change = Callable[[Model], Model]
"""A model to another form of it."""


class Texture(Strict):
    """A parameter that changes over a surface: `low` where the texture is 0, `high` where it is 1."""

    file: str | None = None
    """A PNG (grey, 8 or 16 bits) or an NPY array (height, width) of values in [0, 1]; row 0 is at v = 1."""
    pattern: Literal["checker", "stripes", "bricks", "dots", "speckle"] | None = None
    low: Spectral = 0.0
    high: Spectral = 1.0
    repeat: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = (1.0, 1.0)
    """How often the texture fits into u and into v."""

    @model_validator(mode="after")
    def _one(self) -> "Texture":
        if (self.file is None) == (self.pattern is None):
            raise ValueError("a texture needs either file or pattern")
        return self

    def load(self, folder: Path, where: str) -> Pattern:
        """The texture as a function of uv; a relative `file` lies beside the scene file."""
        if self.file is None:
            assert self.pattern is not None
            whole, _ = PATTERNS[self.pattern]
        else:
            whole, _ = picture(folder / self.file, f"{where}.file")
        repeat = np.array(self.repeat)
        return lambda uv: whole((uv * repeat) % 1.0, np.floor(uv * repeat))


# --- materials -------------------------------------------------------------------------------------------------------


class MaterialTable(Strict):
    """A table [material.NAME] of a scene file: as a sample file, and textures by the name of a parameter."""

    model: str | None = None
    file: str | None = None
    """Instead of model and parameters: a sample file, or a measured table (a run, a file of any format, FILE:SAMPLE),
    beside the scene file."""
    parameters: Parameters = Field(default_factory=dict)
    """The model's arguments. A number may be a spectrum (`gonio.spectra`)."""
    textures: dict[str, Texture] = Field(default_factory=dict)
    ambient_reflectance: Annotated[
        Annotated[float, Field(ge=0)] | NonNegativeSpectrum | Literal["normal"] | None,
        table_or(NonNegativeSpectrum, 'a number of at least 0, "normal"'),
    ] = None
    """What ambient light is multiplied by, in place of rho_hd: a number, a table, or "normal", the reflectance of a
    smooth surface at normal incidence (Cook and Torrance's R_a = pi R_d with R_d = F_0/pi)."""

    @model_validator(mode="after")
    def _one(self) -> "MaterialTable":
        if (self.file is None) == (self.model is None) or (self.file is not None and self.parameters):
            raise ValueError("a material needs either model and parameters, or file, which holds both")
        return self

    def resolved(self, folder: Path, where: str) -> "tuple[MaterialTable, Tabulated | None]":
        """The table with what its file says, and the measured table where that is one; raises `ConfigError`."""
        if self.file is None:
            return self, None
        told = f'{where}.file = "{self.file}"'
        path = folder / self.file
        try:
            if path.suffix == ".toml":
                sample = load_sample(path, uniform=True)
                return self.model_copy(update={"model": sample.model, "parameters": sample.parameters}), None
            if self.textures:
                raise ConfigError("a measured table has no parameters, and textures change one: leave them out")
            return self, tabulated.read(path)
        except GonioError as error:
            if not Path(measurement.split(path)[0]).exists():
                raise ConfigError(f"{told}: there is no such file or run; it lies beside the scene file") from None
            raise ConfigError(f"{told}: {error}") from None


@dataclass(frozen=True)
class _Level:
    """A material where its textures have one set of values: a model for all wavelengths, or one for each."""

    at: tuple[Model, ...]
    constant: bool
    """Whether the BRDF is the same at all wavelengths."""


class SceneMaterial:
    """A material at the wavelengths of a scene.

    Parameters
    ----------
    table
        What the scene file says.
    wavelength_nm
        The scene's wavelengths.
    folder
        Where the files of textures lie.
    where
        The table's name in the scene file, for messages.

    Raises
    ------
    ConfigError, DataError
        The model does not take the parameters, a spectrum does not reach the wavelengths, or a texture is wrong.
    """

    def __init__(self, table: MaterialTable, wavelength_nm: Floats, folder: Path, where: str) -> None:
        self._table, self.tabulated = table.resolved(folder, where)
        self._waves = wavelength_nm
        self._where = where
        self._levels: dict[tuple[float, ...], _Level] = {}
        self._ambient: dict[tuple[float, ...], Any] = {}
        self._change: Change | None = None
        self._written = self
        self._textures: dict[str, Pattern] = {
            name: texture.load(folder, f"{where}.textures.{name}") for name, texture in table.textures.items()
        }
        first = self._level((0.0,) * len(self._textures))
        up = np.array([[0.0, 0.0, 1.0]])
        try:  # an index of refraction is looked up at every wavelength: now, and not after minutes of rendering
            if self.tabulated is not None:
                self.tabulated.require(float(wavelength_nm[0]))
                self.tabulated.require(float(wavelength_nm[-1]))
            self.untextured(up, up)
        except GonioError as error:
            raise ConfigError(f"{where}: {error}") from None
        self.has_spike = any(model.has_spike for model in first.at)
        """Whether it has a specular spike, so that mirror rays are followed."""
        self.constant = first.constant
        """Whether its BRDF is the same at all wavelengths."""
        self.model = first.at[0]
        """The model at the first wavelength, where every texture is 0."""

    # --- what a renderer asks ---------------------------------------------------------------------------------------

    @property
    def textured(self) -> bool:
        """Whether a parameter changes over the surface."""
        return bool(self._textures)

    def at(self, wave: int) -> Model:
        """The model at a wavelength of the scene, by its number, where every texture is 0."""
        models = self._level((0.0,) * len(self._textures)).at
        return models[wave if len(models) > 1 else 0]

    def untextured(self, omega_i: Floats, omega_r: Floats) -> Floats:
        """As `brdf`, where every texture is 0."""
        return self._brdf((0.0,) * len(self._textures), omega_i, omega_r)

    def brdf(self, omega_i: Floats, omega_r: Floats, uv: Floats) -> Floats:
        """BRDF [1/sr] without the spike: (n, wavelengths), or (n, 1) where it does not depend on the wavelength.

        `omega_i` and `omega_r` are unit vectors (n, 3) in the surface's frame: x its tangent, z its normal.
        """
        return self._by_level(uv, lambda level, here: self._brdf(level, omega_i[here], omega_r[here]))

    def polarised(self, omega_i: Floats, omega_r: Floats, uv: Floats, field: Floats) -> Floats:
        """As `brdf`, for light with an electric field along `field` (n, 3)."""
        return self._by_level(
            uv,
            lambda level, here: self._each(
                level, lambda m, w: polarised.brdf(m, omega_i[here], omega_r[here], field[here], w)
            ),
        )

    def specular(self, cos_theta: Floats, uv: Floats) -> Floats:
        """Reflectivity of the spike at cosines of the polar angle (n,): (n, wavelengths), or (n, 1)."""
        theta = np.arccos(np.clip(cos_theta, 0.0, 1.0))
        return self._by_level(
            uv,
            lambda level, here: self._written._each(
                level, lambda m, w: m.specular_reflectivity(theta[here], wavelength_nm=w)
            ),
        )

    def ambient(self, omega_r: Floats, uv: Floats) -> Floats:
        """What uniform light is multiplied by: rho_hd without the spike, toward unit vectors (n, 3), as `brdf`."""
        given = self._table.ambient_reflectance
        if given is not None:
            return np.broadcast_to(self._given(given), (omega_r.shape[0], self._waves.size))
        return self._by_level(uv, lambda level, here: self._written._rho_hd(level, omega_r[here]))

    def in_form(self, change: Change) -> "SceneMaterial":
        """With other models for the light of lamps; spike and ambient light are as before."""
        made = copy.copy(self)
        made._levels, made._change = {}, change
        return made

    def measured_alone(self) -> "SceneMaterial":
        """A measured table with 0 wherever it would be extrapolated; another material as it is."""
        if self.tabulated is None:
            return self
        made = copy.copy(self)
        made._levels = {(): _Level((self.tabulated.measured_alone(),), self.constant)}
        return made

    # --- levels of textures -----------------------------------------------------------------------------------------

    def _by_level(self, uv: Floats, evaluate: Any) -> Floats:
        """Evaluate at hits, those with the same values of the textures together."""
        if not self._textures:
            return np.asarray(evaluate((), slice(None)))
        values = np.stack([texture(uv) for texture in self._textures.values()], axis=1)
        levels, place = np.unique(values, axis=0, return_inverse=True)
        place = place.reshape(-1)
        order = np.argsort(place, kind="stable")
        ends = np.cumsum(np.bincount(place, minlength=len(levels)))
        out: Floats | None = None
        for k, level in enumerate(levels):
            here = order[ends[k - 1] if k else 0 : ends[k]]
            part = evaluate(tuple(level), here)
            if out is None:
                out = np.empty((uv.shape[0], part.shape[1]))
            out[here] = part
        return out if out is not None else np.empty((0, 1))

    def _level(self, level: tuple[float, ...]) -> _Level:
        if level not in self._levels:
            made = self._made(level)
            if self._change is not None:
                made = _Level(tuple(map(self._change, made.at)), made.constant)
            self._levels[level] = made
        return self._levels[level]

    def _made(self, level: tuple[float, ...]) -> _Level:
        if self.tabulated is not None:
            return _Level((self.tabulated,), self.tabulated.constant)
        spectral = bool(spectra_in(self._table.parameters, f"{self._where}.parameters")) or any(
            isinstance(end, Spectrum)
            for texture in self._table.textures.values()
            for end in (texture.low, texture.high)
        )
        if spectral:
            return _Level(tuple(self._built(level, wave) for wave in self._waves), constant=False)
        model = self._built(level, float(self._waves[0]))
        return _Level((model,), constant=_is_constant(model))

    def _built(self, level: tuple[float, ...], wavelength_nm: float) -> Model:
        """The model at a wavelength, where the textures have certain values."""
        assert self._table.model is not None
        where = f"{self._where} with model = {self._table.model!r}"
        try:
            parameters = at_wavelength(self._table.parameters, wavelength_nm, f"{self._where}.parameters")
            for t, (name, texture) in zip(level, self._table.textures.items(), strict=True):
                low, high = (float(values(end, np.array([wavelength_nm]))[0]) for end in (texture.low, texture.high))
                parameters[name] = low + (high - low) * t
            model = models.build(self._table.model, parameters)
        except ConfigError as error:
            raise ConfigError(f"{where}: {error}") from None
        if isinstance(model, Blinn) and "c" in self._table.textures:
            # a varying c3 is normalised by its smallest value (Blinn 1977, "Varying surface shininess"):
            # [c_min c3/(cos^2 (c3^2 - 1) + 1)]^2 = (c_min/c3)^2 D3
            c_min = min(float(values(end, np.array([wavelength_nm]))[0]) for end in _ends(self._table.textures["c"]))
            parameters["k_s"] = model.k_s * (c_min / parameters["c"]) ** 2
            model = models.build(self._table.model, parameters)
        return model

    # --- evaluation -------------------------------------------------------------------------------------------------

    def _brdf(self, level: tuple[float, ...], omega_i: Floats, omega_r: Floats) -> Floats:
        made = self._level(level)
        if made.constant:
            return np.asarray(made.at[0].brdf_vectors(omega_i, omega_r, wavelength_nm=float(self._waves[0])))[:, None]
        if len(made.at) == 1 and self._waves.size > 1:
            waves = made.at[0].brdf_vectors(omega_i[:, None], omega_r[:, None], wavelength_nm=self._waves)
            return np.asarray(waves)
        return self._each(level, lambda m, w: m.brdf_vectors(omega_i, omega_r, wavelength_nm=w))

    def _each(self, level: tuple[float, ...], evaluate: Any) -> Floats:
        """``evaluate(model, wavelength) -> (n,)`` at each wavelength, (n, wavelengths) or (n, 1)."""
        made = self._level(level)
        waves = self._waves[:1] if made.constant else self._waves
        pairs = ((made.at[k if len(made.at) > 1 else 0], float(wave)) for k, wave in enumerate(waves))
        return np.stack([evaluate(model, wave) for model, wave in pairs], axis=1)

    def _rho_hd(self, level: tuple[float, ...], omega: Floats) -> Floats:
        """rho_hd from a table over the viewer's direction, made once, on the first use of a level."""
        oriented = any(model.depends_on_azimuth for model in self._level(level).at)
        if level not in self._ambient:
            from scipy.interpolate import PchipInterpolator, RegularGridInterpolator  # they take 26 MB

            # nodes close up toward grazing, where reflectances change fastest
            theta = np.pi / 2 * np.sin(np.linspace(0.0, np.pi / 2, AMBIENT_NODES))
            phi = np.linspace(-np.pi, np.pi, AMBIENT_AZIMUTHS) if oriented else np.zeros(1)
            table = self._each(
                level,
                lambda m, w: m.hemispherical_directional(
                    theta[:, None], phi_r=phi, wavelength_nm=w, spike=False, tolerance=AMBIENT_TOLERANCE
                ),
            )  # (theta, wavelength, phi)
            table = np.moveaxis(table, 1, 2)
            self._ambient[level] = (
                RegularGridInterpolator((theta, phi), table, method="pchip")
                if oriented
                else PchipInterpolator(theta, table[:, 0])
            )
        theta = np.arccos(np.clip(omega[:, 2], 0.0, 1.0))
        where = np.stack([theta, np.arctan2(omega[:, 1], omega[:, 0])], axis=1) if oriented else theta
        return np.asarray(self._ambient[level](where))

    def _given(self, given: Any) -> Floats:
        if given != "normal":
            return values(given, self._waves)
        level = self._level((0.0,) * len(self._textures))
        out = np.empty(self._waves.size)
        for k, wave in enumerate(self._waves):
            index = _normal_index(level.at[k if len(level.at) > 1 else 0], float(wave), self._where)
            out[k] = abs((index - 1.0) / (index + 1.0)) ** 2
        return out


def _ends(texture: Texture) -> tuple[Any, Any]:
    return texture.low, texture.high


def _is_constant(model: Model) -> bool:
    """Whether a model is known to be the same at all wavelengths."""
    if isinstance(model, Sum):
        return all(_is_constant(term) for term, _ in model.terms)
    if isinstance(model, (CookTorrance, Blinn)):
        return not (isinstance(model.ior, str) or callable(model.ior))
    return isinstance(model, (Lambert, Phong, OrenNayar))


def _normal_index(model: Model, wavelength_nm: float, where: str) -> complex:
    """The index of refraction that a model has at a wavelength."""

    if isinstance(model, (CookTorrance, Blinn, HeTorrance)):
        return index_at(model.ior, wavelength_nm)
    raise ConfigError(
        f'{where}.ambient_reflectance = "normal": the model "{model.name}" has no index of refraction; give a number'
    )
