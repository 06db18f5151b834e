"""From values at a list of wavelengths to XYZ by the CIE 1931 observer, as one matrix, and on to L*a*b*."""

import functools
from importlib.resources import files

import numpy as np

from gonio.errors import ArgumentError, refuse_masked
from gonio.typing import ArrayLike, Floats

ILLUMINANTS = ("D65", "A", "D50", "E")
"""Daylight (the D6500 of 1982), a tungsten lamp, the daylight of print, and equal energy at every wavelength."""
_EDGE = 6.0 / 29.0
"""Cube root of the ratio to white below which f is a straight line."""
_MIX = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])
"""L* + 16, a* and b* from f(X/Xn), f(Y/Yn), f(Z/Zn)."""


@functools.cache
def _table(name: str) -> Floats:
    with files("gonio.colour").joinpath(name).open(encoding="utf-8") as stream:
        table = np.loadtxt(stream, delimiter=",", skiprows=1)
    table.flags.writeable = False
    return np.asarray(table)


def spectrum_locus() -> tuple[Floats, Floats]:
    """The observer at 1 nm: wavelengths [nm] from 360 to 830, (471,), and the XYZ of monochromatic light, (471, 3)."""
    table = _table("observer.csv")
    return table[:, 0], table[:, 1:]


def wavelengths() -> Floats:
    """The wavelengths of sums [nm]: 360 to 830 in steps of 5, (95,)."""
    return _table("illuminants.csv")[:, 0]


def observer() -> Floats:
    """The colour-matching functions of the CIE 1931 2-degree observer at `wavelengths`, (95, 3)."""
    return spectrum_locus()[1][::5]


def illuminant(name: str = "D65") -> Floats:
    """Relative spectral power of an illuminant of `ILLUMINANTS` at `wavelengths`, 100 at 560 nm, (95,).

    Raises
    ------
    ArgumentError
        There is no such illuminant.
    """
    if name not in ILLUMINANTS:
        raise ArgumentError(f"illuminant = {name!r}: must be one of {', '.join(ILLUMINANTS)}")
    if name == "E":
        return np.full(wavelengths().size, 100.0)
    return _table("illuminants.csv")[:, 1 + ILLUMINANTS.index(name)]


def weights(wavelength_nm: ArrayLike, illuminant: str = "D65") -> Floats:
    """The matrix that turns reflectances at a list of wavelengths into XYZ under an illuminant: ``values @ weights``.

    Between the given wavelengths values are taken as linear, beyond the first and the last as constant. The sum is
    that of CIE 15 in steps of 5 nm from 360 to 830 nm. Y = 1 for a perfect white.

    Parameters
    ----------
    wavelength_nm
        At least two different wavelengths between 360 and 830 nm, in any order, (n,). Others may stand beside them.
    illuminant
        A name of `ILLUMINANTS`.

    Returns
    -------
    float64 array (n, 3).

    Raises
    ------
    ArgumentError
        A wavelength is no positive number or stands twice, fewer than two are visible, or the illuminant is unknown.
    """
    nm = _wavelengths(wavelength_nm)
    light = _illuminant(illuminant)[:, None] * observer()
    return np.asarray(_hats(nm).T @ light / light[:, 1].sum())


def light_weights(wavelength_nm: ArrayLike) -> Floats:
    """The matrix that turns radiances at a list of wavelengths into XYZ, for values that hold the light's spectrum.

    As `weights`, without an illuminant: Y = 1 for a radiance of 1 at every wavelength.

    Raises
    ------
    ArgumentError
        As `weights`.
    """
    return weights(wavelength_nm, "E")


def xyz(values: ArrayLike, wavelength_nm: ArrayLike, illuminant: str = "D65") -> Floats:
    """XYZ of an illuminant's light after a reflection, Y = 1 for a perfect white; (..., n) to (..., 3).

    Parameters
    ----------
    values
        Reflectances, or pi times a BRDF, at `wavelength_nm`, on the last axis.
    wavelength_nm, illuminant
        As `weights`.

    Raises
    ------
    ArgumentError
        As `weights`, or the last axis of `values` has not one value a wavelength.
    """
    matrix = weights(wavelength_nm, illuminant)
    refuse_masked("values", values)
    spectra = np.asarray(values, dtype=np.float64)
    if spectra.ndim == 0 or spectra.shape[-1] != len(matrix):
        raise ArgumentError(f"values has shape {spectra.shape}: its last axis must have {len(matrix)} wavelengths")
    return np.asarray(spectra @ matrix)


def white(illuminant: str = "D65") -> Floats:
    """XYZ of an illuminant, Y = 1, (3,): the sum of the tables."""
    light = _illuminant(illuminant) @ observer()
    return np.asarray(light / light[1])


def chromaticity(xyz: ArrayLike) -> Floats:
    """xy of XYZ, (..., 3) to (..., 2); NaN for black."""
    values = np.asarray(xyz, dtype=np.float64)
    total = values.sum(axis=-1, keepdims=True)
    return np.asarray(values[..., :2] / np.where(total == 0.0, np.nan, total))


_illuminant = illuminant  # where an argument has the function's name


def _wavelengths(wavelength_nm: ArrayLike) -> Floats:
    refuse_masked("wavelength_nm", wavelength_nm)
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=np.float64))
    if nm.ndim != 1 or not bool(np.all(np.isfinite(nm) & (nm > 0.0))):
        raise ArgumentError("wavelength_nm: must be a list of positive numbers of nm")
    if np.unique(nm).size != nm.size:
        raise ArgumentError("wavelength_nm: a wavelength stands in the list twice")
    first, last = wavelengths()[[0, -1]]
    if int(np.count_nonzero((nm >= first) & (nm <= last))) < 2:
        raise ArgumentError(
            f"wavelength_nm = {', '.join(f'{v:g}' for v in nm[:6])}: a colour needs two wavelengths or more between "
            f"{first:g} and {last:g} nm; fewer give a grey picture"
        )
    return nm


def _hats(nm: Floats) -> Floats:
    """Values at `wavelengths` of the functions that are 1 at one wavelength of a list and 0 at the others, (95, n)."""
    order = np.argsort(nm)
    out = np.empty((wavelengths().size, nm.size))
    for column, one in zip(order, np.eye(nm.size), strict=True):
        out[:, column] = np.interp(wavelengths(), nm[order], one)
    return out


# --- CIE 1976 L*a*b* (CIE 15, ISO 11664-4) ------------------------------------------------------------------------


def lab(xyz: ArrayLike, illuminant: str = "D65") -> Floats:
    """L*a*b* of XYZ against the white of an illuminant, (..., 3) to (..., 3).

    Parameters
    ----------
    xyz
        Y = 1 for a perfect white, as `gonio.colour.xyz` gives it. Values below 0, as noise makes them, go on along the
        straight line that ends at black.
    illuminant
        A name of `ILLUMINANTS`; its white has L* = 100, a* = b* = 0.

    Raises
    ------
    ArgumentError
        There is no such illuminant, or the last axis is not of length 3.
    """
    ratio = _ratio(xyz, illuminant)
    f = np.where(ratio > _EDGE**3, np.cbrt(ratio), ratio / (3.0 * _EDGE**2) + 4.0 / 29.0)
    return np.asarray(f @ _MIX.T - (16.0, 0.0, 0.0))


def lab_slope(xyz: ArrayLike) -> Floats:
    """d(L*, a*, b*)/d(X, Y, Z) at XYZ, (..., 3) to (..., 3, 3): what carries a covariance from XYZ to L*a*b*.

    For the illuminant D65. Errors as `lab`.
    """
    ratio = _ratio(xyz, "D65")
    slope = np.where(ratio > _EDGE**3, np.cbrt(np.maximum(ratio, _EDGE**3)) ** -2, _EDGE**-2) / 3.0
    return np.asarray(_MIX * (slope / white("D65"))[..., None, :])


def _ratio(xyz: ArrayLike, illuminant: str) -> Floats:
    refuse_masked("xyz", xyz)
    values = np.asarray(xyz, dtype=np.float64)
    if values.ndim == 0 or values.shape[-1] != 3:
        raise ArgumentError(f"xyz has shape {values.shape}: its last axis must hold X, Y and Z")
    return np.asarray(values / white(illuminant))
