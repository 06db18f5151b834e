"""What every reflectance model is: a frozen set of parameters, and a BRDF over angles or unit vectors."""

import dataclasses
import functools
import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, cast, overload

import numpy as np

from gonio.errors import ArgumentError, did_you_mean
from gonio.geometry import Directions
from gonio.models import engine, hemispherical
from gonio.models.engine import SPLIT, Constants, Geometry, Kernel
from gonio.models.parameters import Declaration, Fitted, Ior, Parameter, Parameters, checked_wavelength, plain
from gonio.models.polarised import Facets, Light
from gonio.typing import ArrayLike, Floats, NDArray

Vector = tuple[float, float, float]
OUT_OF_RANGE = "ArgumentError\n    A parameter is outside its range; the message names it."


def _checked_behind(*angles: ArrayLike) -> tuple[Any, ...]:
    """Four angles [rad] of transmission as arrays, and the shape that they broadcast to."""
    arrays = [np.asarray(a, dtype=np.float64) for a in angles]
    bounds = {"theta_i": (0.0, np.pi / 2), "phi_i": None, "theta_r": (np.pi / 2, np.pi), "phi_r": None}
    for (name, bound), array in zip(bounds.items(), arrays, strict=True):
        low, high = bound or (-np.inf, np.inf)
        bad = ~((array >= low) & (array <= high) & np.isfinite(array))
        if bad.any():
            allowed = f"in [{low:g}, {high:g}] rad" if bound else "a finite number"
            raise ArgumentError(f"{name} = {array[bad].flat[0]:g}: must be {allowed}")
    return *arrays, np.broadcast_shapes(*(array.shape for array in arrays))


class Model(ABC):
    """A reflectance model with its parameters.

    Subclasses are frozen dataclasses whose fields are the constructor's arguments; they name a compiled kernel and
    the constants that it needs at a wavelength. A model with a specular spike overrides `_spike`.
    """

    name: ClassVar[str]
    """The model's name on the command line and in sample files."""
    table: ClassVar[Mapping[str, Parameter]] = {}
    """The fields that are a `parameter` each, and what was said of them."""
    besides: ClassVar[Mapping[str, Parameter]] = {}
    """Arguments of the constructor that are no fields."""
    fitted: ClassVar[Mapping[str, Fitted]] = {}
    """What a fit may move of the constructor's arguments, and within which bounds; unless `declaration` says more. By
    itself what the table says of it."""
    needs_wavelength: ClassVar[bool] = False
    """Of such a model: whether its value depends on the wavelength, so that a broad band cannot be fitted."""
    rank: ClassVar[int] = 100
    """Its place among models with as many parameters."""
    has_ior: ClassVar[bool] = False
    """Whether optical constants mean something to it."""
    several_slopes: ClassVar[bool] = False
    """Whether its facets may have two slopes (`--slopes 2`)."""
    in_sums: ClassVar[str] = ""
    """What it may be in a sum that is fitted: "base", "gloss", "weighted gloss" (it has no level of its own), or two of
    these."""
    bases: ClassVar[tuple[str, ...]] = ()
    """Bases under its gloss that are tried unasked."""
    hides_index: ClassVar[bool] = False
    """Whether no data tell n + ik of a gloss over it."""
    assumes: ClassVar[str] = ""
    """What its derivation asks of the surface and none of its parameters tells, after "holds for"; "" for nothing."""
    grain: ClassVar[int] = SPLIT
    """How many evaluations are worth a thread of their own."""

    def __init_subclass__(cls, **more: Any) -> None:
        """Read the table of a class that has one; its docstring and what is fitted follow."""
        super().__init_subclass__(**more)
        found = {n: f.metadata.get("parameter") for n, f in vars(cls).items() if isinstance(f, dataclasses.Field)}
        own = {name: row for name, row in found.items() if row is not None}
        if not own and "table" not in vars(cls):
            return
        cls.table = {**cls.table, **own}
        if "fitted" not in vars(cls):
            cls.fitted = {name: row.fitted for name, row in cls.table.items() if row.fitted is not None}
        doc = inspect.cleandoc(cls.__doc__ or "")
        if "\nParameters\n" not in doc:
            told = "\n".join(f"{name}\n    {row.told}" for name, row in {**cls.table, **cls.besides}.items())
            cls.__doc__ = f"{doc}\n\nParameters\n----------\n{told}\n\nRaises\n------\n{OUT_OF_RANGE}\n"

    def __post_init__(self, *_: Any) -> None:
        """Check what the table says, and store it as checked."""
        for name, row in self.table.items():
            value = getattr(self, name)
            if (value is not None or row.default is not None) and (checked := row.checked(name, value)) is not value:
                object.__setattr__(self, name, checked)

    @property
    def parameters(self) -> Parameters:
        """The constructor's arguments by name, as reports print them and `gonio.models.build` takes them."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(cast(Any, self)) if f.init}

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{key}={value!r}' for key, value in self.parameters.items())})"

    @property
    @abstractmethod
    def convention(self) -> str:
        """One sentence for reports: the paper, the form, the normalisation, and what departs from the print."""

    @property
    def parameter_notes(self) -> Mapping[str, str]:
        """By parameter what a reader has to know beside its value, as which normalisation it goes with."""
        return {}

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        """The kernel and its constants at one wavelength.

        A model without a kernel of its own overrides `brdf`, `brdf_vectors` and `at`.
        """
        raise NotImplementedError

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:
        """What a fit may move of it, where optical constants `ior` are known, or not (None).

        Raises
        ------
        ConfigError
            The class does not say what is fitted.
        """
        return plain(cls.name, cls.fitted, cls.needs_wavelength)

    @classmethod
    def undetermined_by(cls, directions: Directions) -> str:
        """Why it cannot be told from other models in these directions; "" where it can."""
        return ""

    def outside(self, wavelength_nm: float) -> str:
        """Which conditions of its derivation these parameters break at a wavelength [nm], as a clause; "" for none."""
        return ""

    def facets(self, wavelength_nm: float) -> Facets | None:
        """What of it reflects as mirror facets do; None where nothing does, and all is depolarised."""
        return None

    def jones_at(self, at: Directions, wavelength_nm: float) -> NDArray[np.complex128] | None:
        """Jones matrices (n, 2, 2) of a model whose light is polarised otherwise than by facets, up to a factor each.

        Rows are s, p of the reflected field, columns s, p of the incident one (docs/conventions.md). None of others.
        """
        return None

    def in_light(self, light: Light, evaluate: "Callable[[Model], Floats]", wavelength_nm: float) -> Floats:
        """What is seen of it [1/sr], (n,), in polarised light or through an analyser.

        Parameters
        ----------
        light
            Light, analysers and directions.
        evaluate
            The BRDF of a model for unpolarised light in these directions, (n,) [1/sr], as an instrument sees it.
        wavelength_nm
            Wavelength [nm].
        """
        unpolarised = evaluate(self)
        if (jones := self.jones_at(light.at, wavelength_nm)) is not None:
            return unpolarised * light.of_jones(jones)
        if (facets := self.facets(wavelength_nm)) is None:
            return unpolarised * light.depolarised
        lobe = unpolarised - facets.beside if facets.alone is None else evaluate(facets.alone)
        return lobe * light.of_facets(facets.index) + (unpolarised - lobe) * light.depolarised

    @property
    def depends_on_azimuth(self) -> bool:
        """Whether the BRDF depends on both azimuths and not on their difference alone."""
        return False

    def btdf(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_r: ArrayLike,
        phi_r: ArrayLike,
        *,
        wavelength_nm: float = 550.0,
    ) -> Floats:
        """BTDF [1/sr] of detectors behind the sample: 0, unless a model transmits light.

        Parameters
        ----------
        theta_i, phi_i, phi_r, wavelength_nm
            As in `brdf` [rad, nm].
        theta_r
            Polar angle of the detector [rad], in [pi/2, pi], from the normal of the lit side.

        Raises
        ------
        ArgumentError
            An angle is outside its range or not a number.

        Examples
        --------
        >>> from gonio.models import DiffuseTransmitter
        >>> print(round(float(DiffuseTransmitter(0.4, 0.5).btdf(0.0, 0.0, 3.0, 0.0)), 4))
        0.1592
        """
        incident, _, behind, _, shape = _checked_behind(theta_i, phi_i, theta_r, phi_r)
        checked_wavelength(wavelength_nm)
        return np.broadcast_to(self._transmitted(incident, behind), shape).copy()

    def _transmitted(self, theta_i: Floats, theta_r: Floats) -> Floats:
        """BTDF [1/sr] of checked polar angles."""
        return np.zeros(np.broadcast_shapes(theta_i.shape, theta_r.shape))

    @overload
    def brdf(
        self,
        theta_i: float,
        phi_i: float,
        theta_r: float,
        phi_r: float,
        *,
        wavelength_nm: float = ...,
        out: None = ...,
    ) -> float: ...

    @overload
    def brdf(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_r: ArrayLike,
        phi_r: ArrayLike,
        *,
        wavelength_nm: ArrayLike = ...,
        out: Floats | None = ...,
    ) -> Floats: ...

    def brdf(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_r: ArrayLike,
        phi_r: ArrayLike,
        *,
        wavelength_nm: ArrayLike = 550.0,
        out: Any = None,
    ) -> Any:
        """BRDF [1/sr] at angles, without any specular spike.

        Parameters
        ----------
        theta_i, theta_r
            Polar angles of the directions toward the source and the detector [rad], in [0, pi/2]. The double nearest
            pi/2 is exactly grazing, and the formula's limit is returned there.
        phi_i, phi_r
            Their azimuths from the sample's x axis [rad]; phi_r - phi_i is 0 in retro-reflection and pi in the mirror
            half-plane.
        wavelength_nm
            Wavelength [nm]; an array broadcasts with the directions. On an axis of its own, as (n, 1) angles with (m,)
            wavelengths, all wavelengths share what does not depend on them.
        out
            Where the result goes: a writable array of its shape and type, which may overlap the arguments. Nothing is
            written into it before all arguments are checked.

        Returns
        -------
        float64 array of the shape that the arguments broadcast to (a float64 scalar for scalars).

        Raises
        ------
        ArgumentError
            An angle is NaN or out of range, an argument is not real, or the shapes do not broadcast; it names the
            argument.

        Examples
        --------
        >>> import numpy as np
        >>> from gonio.models import Blinn
        >>> theta_r = np.radians([0.0, 30.0, 60.0])
        >>> Blinn(k_d=0.3, k_s=0.1, ior=1.5, c=0.3).brdf(np.radians(30.0), 0.0, theta_r, np.pi).round(4)
        array([0.096 , 0.0973, 0.0968])
        """
        if isinstance(wavelength_nm, (int, float)) or engine.real_array("wavelength_nm", wavelength_nm).ndim == 0:
            kernel, constants = self._evaluation(checked_wavelength(wavelength_nm))
            angles, absolute = (theta_i, phi_i, theta_r, phi_r), self.depends_on_azimuth
            return engine.over_angles(kernel, constants, *angles, absolute=absolute, split=self.grain, out=out)
        arrays, shape = engine.angle_arrays(theta_i, phi_i, theta_r, phi_r)
        engine.check_angles(arrays)
        return engine.delivered(out, engine.by_wavelength(self._spectra, wavelength_nm, arrays, shape, ()))

    def _spectra(self, arguments: list[Any], waves: list[float]) -> Floats:
        """The BRDF (wavelengths, pairs) at four angles of one shape, or at two arrays of vectors."""
        of_angles = len(arguments) == 4
        if of_angles and type(self).brdf is Model.brdf and len(waves) > 1:
            evaluations = [self._evaluation(wave) for wave in waves]
            if all("columns" in kernel.__dict__ for kernel, _ in evaluations):
                absolute = self.depends_on_azimuth
                return engine.over_wavelengths(evaluations, arguments, absolute=absolute, split=self.grain)
        evaluate = self.brdf if of_angles else self.brdf_vectors
        return np.stack([np.reshape(evaluate(*arguments, wavelength_nm=wave), -1) for wave in waves])

    @overload
    def brdf_vectors(  # type: ignore[overload-overlap]  # a tuple of three numbers is an ArrayLike too
        self, omega_i: Vector, omega_r: Vector, *, wavelength_nm: float = ..., out: None = ...
    ) -> float: ...

    @overload
    def brdf_vectors(
        self,
        omega_i: NDArray[np.float32],
        omega_r: NDArray[np.float32],
        *,
        wavelength_nm: float = ...,
        out: NDArray[np.float32] | None = ...,
    ) -> NDArray[np.float32]: ...

    @overload
    def brdf_vectors(
        self,
        omega_i: ArrayLike,
        omega_r: ArrayLike,
        *,
        wavelength_nm: ArrayLike = ...,
        out: Floats | None = ...,
    ) -> Floats: ...

    def brdf_vectors(
        self, omega_i: ArrayLike, omega_r: ArrayLike, *, wavelength_nm: ArrayLike = 550.0, out: Any = None
    ) -> Any:
        """BRDF [1/sr] at unit vectors toward the source and the detector, without any specular spike.

        Parameters
        ----------
        omega_i, omega_r
            Vectors (..., 3) in the sample's frame, z its normal, both leaving the surface. Their lengths may differ
            from 1 by 1e-6 (float32) and are taken out to second order; beyond that they are refused.
        wavelength_nm
            Wavelength [nm]; an array broadcasts with the directions. On an axis of its own, as (n, 1) angles with (m,)
            wavelengths, all wavelengths share what does not depend on them.
        out
            Where the result goes: a writable array of its shape and type, which may overlap the arguments. Nothing is
            written into it before all arguments are checked.

        Returns
        -------
        float64 array of the shape that the arguments broadcast to without the last axis; 0 where either vector is
        below the surface. Two float32 arrays give a float32 result, by float32 arithmetic where a model has it
        (docs/reference/models_evaluation.md states its error).

        Raises
        ------
        ArgumentError
            A vector is not of unit length or holds NaN, or the shapes do not broadcast; it names the argument.
        """
        if isinstance(wavelength_nm, (int, float)) or engine.real_array("wavelength_nm", wavelength_nm).ndim == 0:
            kernel, constants = self._evaluation(checked_wavelength(wavelength_nm))
            return engine.over_vectors(kernel, constants, omega_i, omega_r, split=self.grain, out=out)
        vectors, shape = engine.vector_arrays(omega_i, omega_r)
        return engine.delivered(out, engine.by_wavelength(self._spectra, wavelength_nm, vectors, shape, (3,)))

    def at(self, geometry: Geometry, *, wavelength_nm: float = 550.0, out: Any = None) -> Any:
        """BRDF [1/sr] at directions that `gonio.models.geometry` has checked: the fast way to try many parameters.

        Parameters
        ----------
        geometry
            The directions.
        wavelength_nm
            Wavelength [nm] of models whose index of refraction depends on it.
        out
            Where the result goes: a writable array of its shape and type, which may overlap the arguments. Nothing is
            written into it before all arguments are checked.

        Returns
        -------
        float64 array of the geometry's shape.

        Raises
        ------
        ArgumentError
            The wavelength is no positive number, or the index is not known at it.
        """
        kernel, constants = self._evaluation(checked_wavelength(wavelength_nm))
        return engine.at_geometry(kernel, constants, geometry, split=self.grain, out=out)

    @property
    def has_spike(self) -> bool:
        """Whether the model has a specular spike: whether its class overrides what says that there is none."""
        own = type(self)
        return own._spike is not Model._spike or own.specular_reflectivity is not Model.specular_reflectivity

    def specular_reflectivity(self, theta_i: ArrayLike, *, wavelength_nm: ArrayLike = 550.0, out: Any = None) -> Any:
        """Reflectivity of the specular spike: 0 for a model without one.

        Parameters
        ----------
        theta_i
            Polar angle of the source [rad], in [0, pi/2].
        wavelength_nm
            Wavelength [nm].
        out
            Where the result goes, as in `brdf`.

        Returns
        -------
        float64 array of the shape that the arguments broadcast to, in [0, 1].

        Raises
        ------
        ArgumentError
            An angle is NaN or out of range; it names the argument.
        """
        return engine.delivered(out, engine.over_thetas(self._spike, theta_i, wavelength_nm))

    def _spike(self, theta: Floats, wavelength_nm: float) -> Floats:
        """Reflectivity (n,) of the spike at checked polar angles (n,)."""
        return np.zeros(theta.size)

    def directional_hemispherical(
        self,
        theta_i: ArrayLike,
        *,
        phi_i: ArrayLike = 0.0,
        wavelength_nm: ArrayLike = 550.0,
        spike: bool = True,
        tolerance: float = hemispherical.TOLERANCE,
    ) -> Any:
        """rho_dh, the share of light from one direction that is reflected: spike + integral of brdf cos(theta_r).

        Parameters
        ----------
        theta_i
            Polar angle of the source [rad], in [0, pi/2].
        phi_i
            Its azimuth [rad], which counts where the surface has a direction of its own (parallel grooves).
        wavelength_nm
            Wavelength [nm].
        spike
            False leaves out the specular spike: what is left where a mirror ray is followed.
        tolerance
            Relative error of the integral: a coarser one takes less time.

        Returns
        -------
        float64 array of the shape that the arguments broadcast to, right to `tolerance` of itself unless the model's
        class says otherwise. Nothing forces it below 1: some of the papers' forms reflect more than they receive.

        Raises
        ------
        ArgumentError
            An angle is NaN or out of range; it names the argument.
        DataError
            The integral does not converge.

        Examples
        --------
        >>> from gonio.models import HeTorrance
        >>> smooth = HeTorrance(sigma0_um=0.05, tau_um=2.0, ior="Al")
        >>> spike = smooth.specular_reflectivity(0.0)
        >>> print(f"{smooth.directional_hemispherical(0.0):.3f}, of it {spike:.3f} in the spike")
        0.915, of it 0.248 in the spike
        """
        return engine.delivered(
            None,
            hemispherical.reflectance(
                self, theta_i, phi_i, wavelength_nm, viewer=False, spike=spike, tolerance=tolerance
            ),
        )

    def hemispherical_directional(
        self,
        theta_r: ArrayLike,
        *,
        phi_r: ArrayLike = 0.0,
        wavelength_nm: ArrayLike = 550.0,
        spike: bool = True,
        tolerance: float = hemispherical.TOLERANCE,
    ) -> Any:
        """rho_hd, the radiance under light that is the same from everywhere: spike + integral of brdf cos(theta_i).

        Equal to `directional_hemispherical` for a reciprocal model. Parameters, result and errors as there, for the
        viewer's direction.
        """
        value = hemispherical.reflectance(
            self, theta_r, phi_r, wavelength_nm, viewer=True, spike=spike, tolerance=tolerance
        )
        return engine.delivered(None, value)

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        """The integral of the BRDF times the cosine of the other direction, for sources or (`viewer`) viewers."""
        return hemispherical.over_directions(self, theta, phi, wavelength_nm, viewer, tolerance=tolerance)


def store(model: Model, **values: Any) -> None:
    """Set a frozen model's fields to their checked values while it is being made."""
    for key, value in values.items():
        object.__setattr__(model, key, value)


@functools.cache
def _arguments(kind: type[Model]) -> tuple[str, ...]:
    return tuple(inspect.signature(kind).parameters)


def build_model(kind: type[Model], name: str, parameters: Mapping[str, Any]) -> Model:
    """A model of a class from named parameters; raises `ArgumentError` for a name it does not know."""
    known = _arguments(kind)
    for key in parameters:
        if key not in known:
            hint = did_you_mean(key, known, f"it has {', '.join(known)}")
            raise ArgumentError(f'the model "{name}" has no parameter "{key}"; {hint}')
    return kind(**parameters)
