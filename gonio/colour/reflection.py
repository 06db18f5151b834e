"""The colour of a mirror reflection over the angle: Cook and Torrance's full procedure and their short one."""

from collections.abc import Callable

import numpy as np

from gonio.colour.cie import weights, white
from gonio.models import fresnel
from gonio.models.parameters import indices_at
from gonio.typing import ArrayLike, Floats

Index = str | ArrayLike | Callable[[Floats], ArrayLike]


def index_from_f0(f0: ArrayLike) -> Floats:
    """The real indices that give a spectrum of normal reflectances, k = 0, as the paper takes them; the same shape.

    Raises
    ------
    ArgumentError
        A reflectance lies outside [0, 0.9999999].
    """
    spectrum = np.asarray(f0, dtype=np.float64)
    return np.array([fresnel.n_from_f0(float(value)) for value in spectrum.ravel()]).reshape(spectrum.shape)


def reflectance(theta: ArrayLike, wavelength_nm: ArrayLike, ior: Index) -> Floats:
    """Fresnel reflectance for unpolarised light at angles and wavelengths.

    Parameters
    ----------
    theta
        Angle of incidence [rad], in [0, pi/2], any shape.
    wavelength_nm
        Wavelengths [nm], (n,).
    ior
        n + ik: a material's name, a number, one number a wavelength, or a function of the wavelengths. For a measured
        normal reflectance: ``index_from_f0(f0)``.

    Returns
    -------
    float64 array of the shape of `theta` with the wavelengths as a last axis.

    Raises
    ------
    ArgumentError
        An angle or an index is out of range, or the material is not known at a wavelength.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=np.float64))
    return np.asarray(fresnel.reflectance(np.cos(np.asarray(theta, dtype=np.float64))[..., None], indices_at(ior, nm)))


def reflected_xyz(theta: ArrayLike, wavelength_nm: ArrayLike, ior: Index, illuminant: str = "D65") -> Floats:
    """XYZ of an illuminant's light after a mirror reflection, the full procedure: F at every wavelength, then the sum.

    Parameters as `reflectance` and `weights`. Y = 1 where everything is reflected.

    Returns
    -------
    float64 array of the shape of `theta` with XYZ as a last axis.
    """
    return np.asarray(reflectance(theta, wavelength_nm, ior) @ weights(wavelength_nm, illuminant))


def shifted_xyz(theta: ArrayLike, wavelength_nm: ArrayLike, ior: Index, illuminant: str = "D65") -> Floats:
    """As `reflected_xyz` by the short procedure, `fresnel.colour_shift`: between the colour at normal incidence and the
    light's, by F for the mean of the normal reflectances at the given wavelengths.

    The paper interpolates RGB; interpolating XYZ is the same, as both are linear.
    """
    normal = reflectance(0.0, wavelength_nm, ior)
    first = normal @ weights(wavelength_nm, illuminant)
    cosine = np.cos(np.asarray(theta, dtype=np.float64))
    return np.asarray(fresnel.colour_shift(cosine, float(normal.mean()), first, white(illuminant)))
