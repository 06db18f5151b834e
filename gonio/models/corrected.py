"""A model with the smooth curve of its misfit: the measurement where there is one, the model far away (docs/misfit.md).

The misfit is a Gaussian process (`gonio.models.gaussian_process`) on the scale z = asinh(f/2e), which is ln f for all
but the smallest values.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from gonio.errors import ArgumentError
from gonio.geometry import ANGLES, Directions
from gonio.models.arrays import ArrayModel
from gonio.models.gaussian_process import NAMES, OF_CURVES, Coordinates, Prior, Process, Training
from gonio.models.model import Model
from gonio.models.parameters import Parameters, number
from gonio.typing import ArrayLike, Floats, Ints

AZIMUTHS = 128
"""Angles of a grid over the hemisphere, either way; a lobe narrower than its cells keeps its middle."""
PICKED = 300
"""Directions of the grid at which the misfit is looked at."""
UNMEASURED = 0.15
"""Open part of the misfit's variance above which the model alone speaks: beyond a plan's steepest angles, or out of its
only plane. Between incidences 30 degrees apart it is 0.11."""
LEVEL = 0.5
"""Standard deviation of the process's mean, of tau."""
PEAK = np.radians(6.0)
"""theta_h is warped, asinh(theta_h / PEAK): steps are dense at the lobe's peak."""
SPACING = np.array([0.6, 0.6, 2.0, 1.5])
"""Distance 1 toward the peak, toward grazing half vectors, toward the limb and around. These numbers and those that
follow were sought so that stated intervals hold on samples that no model has (docs/misfit.md)."""
INWARD = 3.0
"""Factor on the first three of them away from peak, grazing light and limb, where a model goes on as it was measured.
"""
GROWN, ROOT, POWER = 0.8, 0.4, 1.3
"""At a distance d the misfit has grown by GROWN tau^ROOT d^POWER: how well a model describes the values says little of
how it goes on."""
WIDEST = 2.0
"""Largest standard deviation that it grows to, of a logarithm: a factor of 7."""
FORGOTTEN = 2.0
"""Distance at which the parameters of the model are no better known than without the values."""
TOGETHER = 3.0
"""Distance within which it grows alike: the values leave one side open, and there all is too high or all too low."""
AT_ONCE = 128
"""Directions that the process is evaluated at in one step: with 300 nodes its arrays stay in the cache."""


@dataclass(frozen=True)
class Correction:
    """The misfit of a model as a process that has learned from measured values."""

    process: Process
    """The process of asinh(measured/2e) - asinh(model/2e)."""
    directions: Directions
    """Directions of the values that it rests on, `folded` where the model is isotropic."""
    small: float
    """e [1/sr]."""
    wider: float
    """Factor on its standard uncertainties, at least 1, from the scatter of left-out values about it."""
    spike: float
    """Relative standard uncertainty of the model's specular spike."""

    def applied(self, at: Directions, brdf: Floats) -> Floats:
        """The model's values (n,) [1/sr] at directions (n,), with the mean of the misfit."""
        mean = np.concatenate(
            [self.process.mean_at(Coordinates.of(at[k : k + AT_ONCE])) for k in range(0, max(brdf.size, 1), AT_ONCE)]
        )
        return np.asarray(2 * self.small * np.sinh(np.arcsinh(brdf / (2 * self.small)) + mean))

    def beside(self, at: Directions, model: Floats) -> tuple[Floats, Floats]:
        """The measurement as model and misfit have it.

        Parameters
        ----------
        at
            Where, shape (n,).
        model : (n,) array [1/sr]
            The model there.

        Returns
        -------
        brdf : (n,) array [1/sr]
            The model with the mean of the process.
        root : (n, k) array [1/sr]
            root @ root.T is its covariance, the common causes of the measurement included.
        """
        brdf, covariance, scale = self._beside(at, model)
        values, vectors = np.linalg.eigh(covariance)
        return brdf, vectors * np.sqrt(np.maximum(values, 0.0)) * scale[:, None]

    def total(self, at: Directions, model: Floats, share: Floats) -> tuple[float, float]:
        """The sum of `share` times what `beside` has, and its standard uncertainty."""
        brdf, covariance, scale = self._beside(at, model)
        weights = share * scale
        return float(share @ brdf), math.sqrt(max(float(weights @ covariance @ weights), 0.0))

    def _beside(self, at: Directions, model: Floats) -> tuple[Floats, Floats, Floats]:
        """The BRDF with its misfit, the covariance of its logarithm, and what that is multiplied by."""
        brdf = self.applied(at, model)
        covariance = self.wider**2 * self.process.covariance_at(Coordinates.of(at)) + self._grown(at)
        return brdf, covariance, np.hypot(brdf, 2 * self.small)

    def open(self, at: Directions) -> Floats:
        """How little values near by say of the misfit, (n,): the part of its variance that they leave, 0 to 1."""
        places = Coordinates.of(at)
        left = np.clip(self.process.variance_at(places) / self.process.prior_variance_at(places), 0.0, 1.0)
        return np.asarray(np.maximum(left, 1.0 - np.exp(-((self._distance(at)[0] / FORGOTTEN) ** 2))))

    def _distance(self, at: Directions) -> tuple[Floats, Floats]:
        """How far the value is that says most of each direction (n,), and how far the misfit may have grown there.

        The nearest one, unless others are known better: a value that says nothing is never it.
        """
        away = _places(at)[:, None] - _places(self.directions)
        away[..., :3] = np.where(away[..., :3] < 0.0, away[..., :3] / INWARD, away[..., :3])
        distance = np.linalg.norm(away, axis=-1)
        tau = self.process.data.prior.level / LEVEL
        grown = np.minimum(GROWN * tau**ROOT * distance**POWER, WIDEST)
        best = np.argmin(np.hypot(grown, self.process.data.u), axis=1)
        rows = np.arange(best.size)
        return distance[rows, best], grown[rows, best]

    def _grown(self, at: Directions) -> Floats:
        """Covariance (n, n) of what the misfit may grow by between values and away from them."""
        places, size = _places(at), self._distance(at)[1]
        square = np.sum((places[:, None] - places) ** 2, axis=-1)
        return np.asarray(np.outer(size, size) * np.exp(-0.5 * square / TOGETHER**2))

    @property
    def parameters(self) -> Parameters:
        """Plain numbers, for a sample file; `of` undoes it."""
        data = self.process.data
        return {
            "small_per_sr": self.small,
            "wider": self.wider,
            "u_spike": self.spike,
            "kernel": [float(f"{value:.9g}") for value in np.exp(self.process.p)],
            "level": data.prior.level,
            "cosine": data.prior.cosine,
            **{
                f"{name}_deg": np.round(np.degrees(getattr(self.directions[...], name)), 7).tolist() for name in ANGLES
            },
            "z": np.round(data.z, 9).tolist(),
            "u_z": [float(f"{value:.6g}") for value in data.u],
            "common": [[float(f"{value:.6g}") for value in row] for row in data.causes],
        }  # fmt: skip

    @classmethod
    def of(cls, parameters: Mapping[str, Any]) -> Self:
        """From plain numbers.

        Raises
        ------
        ArgumentError
            One of them is missing or wrong.
        """
        lists = ("kernel", *(f"{name}_deg" for name in ANGLES), "z", "u_z", "common")
        names = ("small_per_sr", "wider", "u_spike", "level", "cosine", *lists)
        for name in (*names, *parameters):
            if name not in parameters or name not in names:
                which = "is missing" if name in names else f"is none of {', '.join(names)}"
                raise ArgumentError(f"misfit: {name} {which}")
        found = {}
        for name in lists:
            try:
                found[name] = np.asarray(parameters[name], dtype=np.float64)
            except (TypeError, ValueError):
                raise ArgumentError(f"misfit: {name} has to be a list of numbers") from None
        n = len(found["z"])
        for name, array in found.items():
            shape = (len(NAMES),) if name == "kernel" else (n, *array.shape[1:]) if name == "common" else (n,)
            if array.shape != shape or not n or not np.all(np.isfinite(array)):
                raise ArgumentError(f"misfit: {name} has to be {len(NAMES) if name == 'kernel' else n} finite numbers")
        kernel = found["kernel"]
        if not np.all(kernel > 0):
            raise ArgumentError("misfit: the numbers of kernel have to be above 0")
        single = {
            name: number(f"misfit: {name}", parameters[name], 0.0)
            for name in ("small_per_sr", "wider", "u_spike", "level", "cosine")
        }
        prior = Prior(np.log(kernel), OF_CURVES.spreads, single["level"], single["cosine"])
        at = Directions(*(np.radians(found[f"{name}_deg"]) for name in ANGLES))
        common = found["common"].reshape(n, -1)
        process = Process(Training(Coordinates.of(at), found["z"], found["u_z"], common, prior=prior), np.log(kernel))
        return cls(process, at, single["small_per_sr"], single["wider"], single["u_spike"])


def _places(at: Directions) -> Floats:
    """Where directions (n,) lie for a misfit that grows, (n, 4): toward the lobe's peak, grazing, the limb, around.

    Facets hide each other toward the limb, of source or detector: no half vector tells that.
    """
    at = at[...]  # of one shape
    theta_h, theta_d = at.half
    around = np.sin(theta_h) * np.sin(theta_d) * np.abs((at.dphi + np.pi) % (2 * np.pi) - np.pi)
    limb = np.maximum(at.theta_i, at.theta_r)
    grazing, limb = (theta - np.log(np.maximum(np.cos(theta), 1e-3)) for theta in (theta_d, limb))
    return np.asarray(np.stack([-np.arcsinh(theta_h / PEAK), grazing, limb, around], axis=-1) / SPACING)


class Corrected(ArrayModel):
    """A model and what measured values say of its misfit, as `gonio fit --residual` makes it.

    Parameters
    ----------
    model
        Any other model. Its spike stays as it is.
    correction
        The misfit. It is the same at all wavelengths.
    """

    name: ClassVar[str] = "corrected"

    def __init__(self, model: Model, correction: Correction) -> None:
        self.model = model
        self.correction = correction

    @classmethod
    def of(cls, model: Model, misfit: Any) -> Self:
        """From the table of the misfit in a sample file; raises `ArgumentError`."""
        if not isinstance(misfit, Mapping):
            raise ArgumentError("misfit: has to be a table")
        return cls(model, Correction.of(misfit))

    @property
    def parameters(self) -> Parameters:
        return {self.model.name: self.model.parameters, "misfit": self.correction.parameters}

    def __repr__(self) -> str:
        return f"<{self.model!r} with its misfit, from {len(self.correction.process.data.z)} values>"

    @property
    def convention(self) -> str:
        return f"{self.model.convention} With the smooth curve of its misfit."

    @property
    def depends_on_azimuth(self) -> bool:
        return self.model.depends_on_azimuth

    @property
    def has_spike(self) -> bool:
        """Whether the model has a specular spike."""
        return self.model.has_spike

    def specular_reflectivity(self, theta_i: ArrayLike, *, wavelength_nm: ArrayLike = 550.0, out: Any = None) -> Any:
        return self.model.specular_reflectivity(theta_i, wavelength_nm=wavelength_nm, out=out)

    def evaluate(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> Floats:
        at = folded(Directions.from_vectors(omega_i, omega_r), self.model)
        return self.correction.applied(at, self.model.brdf_vectors(omega_i, omega_r, wavelength_nm=wavelength_nm))


def reflected(model: Model, theta_i: float, phi_i: float, wavelength_nm: float) -> tuple[Directions, Floats]:
    """Directions that each stand for as much of the light that a model reflects, without its spike.

    Returns
    -------
    at
        `PICKED` directions; none where the model reflects nothing.
    brdf
        The model there [1/sr].
    """
    sine = (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS  # cells of equal cos(theta) d(omega)
    theta_r, phi_r = (g.ravel() for g in np.meshgrid(np.arcsin(np.sqrt(sine)), phi_i + 2 * np.pi * sine, indexing="ij"))
    light = np.maximum(model.brdf(theta_i, phi_i, theta_r, phi_r, wavelength_nm=wavelength_nm), 0.0)
    picked = evenly(light, PICKED)
    same = np.ones(picked.size)
    return Directions(theta_i * same, phi_i * same, theta_r[picked], phi_r[picked]), light[picked]


def evenly(light: Floats, count: int) -> Ints:
    """Which of many places stand for equal parts of the light from all; none where there is no light."""
    if not light.sum() > 0:
        return np.zeros(0, np.intp)
    return np.searchsorted(np.cumsum(light) / light.sum(), (np.arange(count) + 0.5) / count)


def folded(at: Directions, model: Model) -> Directions:
    """Directions that an isotropic model does not tell apart become one: phi_i = 0, phi_r from 0 to 180 degrees."""
    if model.depends_on_azimuth:
        return at
    at = at[...]  # of one shape
    dphi = np.abs((at.phi_r - at.phi_i + np.pi) % (2 * np.pi) - np.pi)
    return Directions(at.theta_i, np.zeros(at.shape), at.theta_r, dphi)
