"""What the polarisation of lamp and camera changes of a sample's light, for models that know a Mueller matrix.

A lamp of degree P has the Stokes vector (1, P cos 2a, P sin 2a, 0), a camera the row (1, p cos 2b, p sin 2b, 0), on the
bases of `HeTorrance.mueller`. The signal is row . matrix . vector, over the matrix's first element: 1 where neither is
polarised.
"""

import math
from typing import Any

import numpy as np

from gonio.geometry import Directions
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.kinematics import View
from gonio.lab.rig.light_and_camera import Polarisation
from gonio.models import Model, SpectralModel
from gonio.typing import Floats


def is_on(description: RigDescription) -> bool:
    """Whether lamp or camera are polarised at all."""
    return bool(description.lamp.polarisation.degree or description.camera.polarisation.degree)


def of_lobe(description: RigDescription, model: Model, scene: View, at: Directions, wavelength_nm: float) -> Floats:
    """Factor on the lobe at some directions; 1 for a model without a Mueller matrix, which depolarises."""
    out = np.ones(at.theta_i.shape)
    model = model.plain(wavelength_nm) if isinstance(model, SpectralModel) else model
    if not hasattr(model, "mueller"):
        return out
    vector, row = _stokes(description, scene, at)
    matrix = model.mueller(*at.angles, wavelength_nm=wavelength_nm)
    seen = np.einsum("...i,...ij,...j->...", row, matrix, vector)
    lit = matrix[..., 0, 0] > 0.0
    out[lit] = seen[lit] / matrix[..., 0, 0][lit]
    return out


def of_spike(description: RigDescription, model: Model, scene: View, at: Directions, wavelength_nm: float) -> Floats:
    """Factor on the specular spike, which reflects as one facet."""
    out = np.ones(at.theta_i.shape)
    model = model.plain(wavelength_nm) if isinstance(model, SpectralModel) else model
    if not hasattr(model, "jones"):
        return out
    vector, row = _stokes(description, scene, at)
    jones: Any = model.jones(*at.angles, wavelength_nm=wavelength_nm)
    left = jones @ (0.5 * _coherency(vector)) @ np.conj(np.swapaxes(jones, -1, -2))
    seen = np.real(np.einsum("...ij,...ji->...", _coherency(row), left))
    usual = 0.5 * np.sum(np.abs(jones) ** 2, axis=(-2, -1))
    lit = usual > 0.0
    out[lit] = seen[lit] / usual[lit]
    return out


def straight(description: RigDescription, scene: View) -> float:
    """Factor on the light of a lamp that the camera looks into."""
    lamp, camera = description.lamp.polarisation, description.camera.polarisation
    light, lens = _axes(description, scene)
    return 1.0 + lamp.degree * camera.degree * (2.0 * float(light @ lens) ** 2 - 1.0)


def _coherency(stokes: Floats) -> Floats:
    _, q, u, _ = np.moveaxis(stokes, -1, 0)
    return np.moveaxis(np.array([[1.0 + q, u], [u, 1.0 - q]]), (0, 1), (-2, -1))


def _axes(description: RigDescription, scene: View) -> tuple[Floats, Floats]:
    """Unit vectors of the larger field: of the lamp's light, and of that which the camera prefers."""
    beam_y = scene.image_y if scene.beam_y is None else scene.beam_y
    pairs = (
        (description.lamp.polarisation, beam_y, scene.source_mm),
        (
            description.camera.polarisation,
            scene.image_y,
            scene.camera_mm,
        ),
    )
    light, lens = (_field(of, y, place / np.linalg.norm(place)) for of, y, place in pairs)
    return light, lens


def _field(of: Polarisation, y: Floats, toward: Floats) -> Floats:
    turn = math.radians(of.azimuth_deg or 0.0)
    return np.asarray(math.cos(turn) * y + math.sin(turn) * np.cross(y, toward))


def _stokes(description: RigDescription, scene: View, at: Directions) -> tuple[Floats, Floats]:
    """The lamp's vector and the camera's row, on s = k x z / |k x z| and p = s x k, k the way that the light goes."""
    out = []
    for of, field, theta, phi, sense in (
        (description.lamp.polarisation, _axes(description, scene)[0], at.theta_i, at.phi_i, -1.0),
        (description.camera.polarisation, _axes(description, scene)[1], at.theta_r, at.phi_r, 1.0),
    ):
        sin, cos, zero = np.sin(phi), np.cos(phi), np.zeros(np.shape(phi))
        k = sense * np.stack([np.sin(theta) * cos, np.sin(theta) * sin, np.cos(theta)], axis=-1)
        s = sense * np.stack([sin, -cos, zero], axis=-1)
        p = np.cross(s, k)
        twice = 2.0 * np.arctan2(p @ field, s @ field)
        out.append(np.stack([zero + 1.0, of.degree * np.cos(twice), of.degree * np.sin(twice), zero], axis=-1))
    return out[0], out[1]
