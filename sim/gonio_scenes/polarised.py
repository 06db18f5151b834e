"""Polarised light: what a model's Mueller matrix makes of it, for a camera that does not tell polarisations apart.

Stokes vectors stand on the bases of `HeTorrance.mueller`: s = k x z/|k x z|, p = s x k, with k the direction in which
the light travels and z the surface's normal.
"""

import numpy as np

from gonio.errors import ConfigError
from gonio.geometry import angles
from gonio.models import HeTorrance, Lambert, Model, OrenNayar, Sum
from gonio.typing import Floats


def require(model: Model, where: str) -> None:
    """Raise `ConfigError` for a model that has no polarised form."""
    if isinstance(model, Sum):
        for term, _ in model.terms:
            require(term, where)
    elif not isinstance(model, (HeTorrance, Lambert, OrenNayar)):
        raise ConfigError(
            f'{where}: the model "{model.name}" has no polarised form, and the scene has polarised light: take '
            "he-torrance, lambert or oren-nayar (which depolarise), or leave polarisation out"
        )


def doubled_angle(travel: Floats, axis: Floats) -> tuple[Floats, Floats]:
    """cos 2 chi and sin 2 chi of an axis (n, 3) against s, for light that travels along `travel` (n, 3).

    The part of the axis along the light does not count; where there is no other, neither direction is preferred, and
    both are 0. Both are vectors in the surface's frame.
    """
    flat = np.hypot(travel[:, 0], travel[:, 1])
    # along the normal: the limit at the azimuth that `gonio.geometry.angles` gives, that of the direction that leaves
    # the surface, 0
    leaving = np.where(travel[:, 2] < 0.0, -1.0, 1.0)
    x = np.where(flat > 0.0, travel[:, 0], leaving)
    y = np.where(flat > 0.0, travel[:, 1], 0.0)
    s = np.stack([y, -x, np.zeros_like(x)], axis=1) / np.hypot(x, y)[:, None]
    p = np.cross(s, travel)
    along_s, along_p = np.einsum("ij,ij->i", axis, s), np.einsum("ij,ij->i", axis, p)
    total = along_s**2 + along_p**2
    total = np.where(total > 0.0, total, 1.0)
    return (along_s**2 - along_p**2) / total, 2.0 * along_s * along_p / total


def brdf(model: Model, omega_i: Floats, omega_r: Floats, field: Floats, wavelength_nm: float) -> Floats:
    """What multiplies the irradiance to give the radiance [1/sr], (n,).

    Parameters
    ----------
    model
        A model that `require` lets pass.
    omega_i, omega_r
        Unit vectors (n, 3) in the surface's frame.
    field
        Along the electric field of the light (n, 3), in the surface's frame.
    """
    if isinstance(model, Sum):
        return np.asarray(
            sum(weight * brdf(term, omega_i, omega_r, field, wavelength_nm) for term, weight in model.terms)
        )
    if not isinstance(model, HeTorrance):  # it depolarises
        return np.asarray(model.brdf_vectors(omega_i, omega_r, wavelength_nm=wavelength_nm))
    seen = (omega_i[:, 2] >= 0.0) & (omega_r[:, 2] >= 0.0)
    out = np.zeros(omega_i.shape[0])
    omega_i, omega_r = omega_i[seen], omega_r[seen]
    matrix = model.mueller(*angles(omega_i), *angles(omega_r), wavelength_nm=wavelength_nm)
    light = np.zeros((omega_i.shape[0], 4))
    light[:, 0] = 1.0
    light[:, 1], light[:, 2] = doubled_angle(-omega_i, field[seen])
    out[seen] = np.einsum("nj,nj->n", matrix[:, 0], light)
    return out
