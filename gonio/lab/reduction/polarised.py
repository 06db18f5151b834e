"""Values that were measured through polarisers: what their level is, and what is not known of it.

The white reference depolarises. In a state with an analyser it shows half of its BRDF, so that visits in that state
tell what lamp, polarisers and lens let through (`of_white`). A lamp, or a lens, that polarises by itself lets through
1 + P cos 2(c - a) of it behind a polariser of the azimuth c. In the plane of the arms axes stand as before the
reference. Elsewhere rates are divided by that where P and a are known (`throughput` of
`gonio.lab.rig.polariser_axes`), and the budget has it where they are not (`uneven`).

Values are those that the polarisers of the rig show, with their extinctions as the rig file has them: the
attribute `polarisers` says so. What is uncertain of these, and of azimuths, changes a value by d(a M b), with the
sample's Mueller matrix M. It is the one nearest to half of a smooth glass's and half of a depolariser's that has the
values that were measured at the point (`add_shared`); a fit puts its own model in place of it.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from gonio.geometry import Directions
from gonio.lab.reduction.values import BandResult, MeasuredBand
from gonio.lab.rig import Pose, kinematics
from gonio.lab.rig.calibration_files import covariance_of, known_parameters
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.polariser_axes import linear, on_rays, own, standing
from gonio.lab.rig.polarisers import SIDES, letters
from gonio.polarisation import UNPOLARISED, Polariser, Polarisers, ray_axes, states, stokes
from gonio.typing import Floats, JsonObject

FACET = 1.5
"""Index of refraction of the facets that a sample may reflect with: glass and polymers; metals polarise less."""
NUMBERS = ("extinction", "azimuth")
OF_VISITS = ("s_reference_noise", "s_lamp_drift")
"""Columns of what the noise of the visits to the white reference leaves open."""


def known(description: RigDescription) -> Polarisers:
    """The polarisers of a rig, as tables state them; perfect ones where it has none.

    Azimuths that are known have been taken out where they were set: 0 is left, and its uncertainty.
    """
    sure, out = known_parameters(description), {}
    for side in description.polarisers.sides():
        mount = description.polarisers.on(side)
        assert mount is not None
        names = [f"polarisers.{side}.{name}" for name in ("extinction", "azimuth_deg")]
        u = [mount.u_extinction, mount.u_azimuth_deg]
        of_file = np.sqrt(np.diag(covariance_of(description, names)))
        u = [float(of_file[k]) if name in sure else u[k] for k, name in enumerate(names)]
        out[side] = Polariser(mount.extinction, 0.0, u[0], math.radians(u[1]))
    return Polarisers(**out)


def stated(description: RigDescription) -> JsonObject:
    """The attribute `polarisers` of a table; see `gonio.polarisation.Polariser.of`."""
    out: JsonObject = {}
    for side, of in zip(SIDES, known(description), strict=True):
        if side in description.polarisers.sides():
            out[side] = {
                "extinction": of.extinction, "u_extinction": of.u_extinction,
                "u_azimuth_deg": math.degrees(of.u_azimuth),
            }  # fmt: skip
    return out


def of_white(word: str) -> float:
    """What a depolarising white shows in a state, over its BRDF."""
    light, seen = stokes(word)
    return float(light[0] * seen[0])


def uneven(measured: MeasuredBand, brdf: Floats) -> Floats:
    """Change of each value [1/sr] for one standard deviation of what is not known of the throughput, shape (n, 4).

    It follows cosine and sine of twice an azimuth, before the lamp and before the camera.
    """
    description, word = measured.description, measured.band.polarisation
    at_visit = standing(description, kinematics.view(description, measured.visit.pose), "reference", word)
    out = np.zeros((len(measured.points), 2 * len(SIDES)))
    for k, point in enumerate(measured.points):
        for side, turned in standing(description, kinematics.view(description, point.pose), "sample", word).items():
            mount, of = description.polarisers.on(side), own(description, side)
            assert mount is not None
            open_degree = of.degree if of.azimuth_deg is None else 0.0
            u = math.hypot(mount.u_transmittance, open_degree / math.sqrt(2.0))
            change = linear(u, turned) - linear(u, at_visit[side])
            at = 2 * SIDES.index(side)
            out[k, at : at + 2] = brdf[k] * change[1:3]
    return out


def bound(description: RigDescription, pose: Pose, word: str) -> float:
    """Largest relative error of a value from the polarisation of the lamp, or of the lens, without a polariser there.

    Of a sample whose facets of the index `FACET` reflect once, with its likely sign.
    """
    view = kinematics.view(description, pose)
    d = kinematics.directions(description, pose)
    glass = of_glass(d)
    light, seen = stokes(word)
    ideal = {"light": light, "receiver": seen}
    usual, out = float(seen @ glass @ light), 0.0
    places = ((d.theta_i, d.phi_i), (d.theta_r, d.phi_r))
    for side, letter, (theta, phi) in zip(SIDES, letters(word), places, strict=True):
        of = own(description, side)
        if letter != "u" or not of.degree:
            continue
        changes = []
        for azimuth_deg in (0.0, 45.0) if of.azimuth_deg is None else (of.azimuth_deg,):
            stands = on_rays(view, side, linear(of.degree, math.radians(azimuth_deg)), theta, phi)
            vectors = ideal | {side: stands}
            changes.append(float(vectors["receiver"] @ glass @ vectors["light"]) - usual)
        out += math.hypot(*changes) if len(changes) > 1 else changes[0]
    return out / max(usual, 0.5 * of_white(word))


def add_shared(description: RigDescription, results: Sequence[BandResult]) -> None:
    """Add what values of several states share, and tell apart what they do not."""
    _tell_apart(results)
    _add_polarisers(description, results)


def _tell_apart(results: Sequence[BandResult]) -> None:
    """Give the noise of the visits in each state columns of its own: states are compared with each other."""
    words = list(dict.fromkeys(result.band.polarisation for result in results))
    for result, name in itertools.product(results, OF_VISITS) if words != [UNPOLARISED] else ():
        change = result.values.common.pop(name)
        for word in words:
            own = change if word == result.band.polarisation else np.zeros_like(change)
            result.values.common[name if word == UNPOLARISED else f"{name}_{word}"] = own


def _add_polarisers(description: RigDescription, results: Sequence[BandResult]) -> None:
    """Add what is uncertain of extinctions and azimuths: `s_light_extinction`, ..., shared by all values."""
    polarisers = known(description)
    u = {
        (side, number): getattr(getattr(polarisers, side), f"u_{number}")
        for side, number in itertools.product(SIDES, NUMBERS)
    }
    u = {cause: value for cause, value in u.items() if value > 0.0}
    for name in dict.fromkeys(result.band.alone.name for result in results) if u else ():
        group = [result for result in results if result.band.alone.name == name]
        words = [result.band.polarisation for result in group]
        matrix = _effects(words, polarisers)
        changes = {
            cause: 0.5
            * (_effects(words, polarisers.moved(*cause, by)) - _effects(words, polarisers.moved(*cause, -by)))
            for cause, by in u.items()
        }
        for result in group:
            result.values.common |= {f"s_{side}_{number}": np.zeros(len(result.rows)) for side, number in u}
        places = [{int(row): k for k, row in enumerate(result.rows)} for result in group]
        for point in np.unique(np.concatenate([result.rows for result in group])).tolist():
            found = [(k, rows[point]) for k, rows in enumerate(places) if point in rows]
            there, place = (list(each) for each in zip(*found, strict=True))
            values = np.array([group[k].values.brdf[at] for k, at in zip(there, place, strict=True)])
            at = group[there[0]].measured.points[place[0]].directions
            sample = _matrix(matrix[there], values, _likely(at))
            for (side, number), change in changes.items():
                for k, where, by in zip(there, place, change[there] @ sample, strict=True):
                    group[k].values.common[f"s_{side}_{number}"][where] = by


def _effects(words: Sequence[str], polarisers: Polarisers) -> Floats:
    """What each element of a Mueller matrix, row by row, gives to values in some states, shape (n, 16)."""
    light, seen = states(words, polarisers)
    return np.asarray(np.einsum("ni,nj->nij", seen, light)).reshape(len(words), 16)


def _likely(d: Directions) -> Floats:
    """Half of a smooth glass's and half of a depolariser's Mueller matrix at a point, over the BRDF, (16,).

    Behind the sample all of a depolariser's.
    """
    first = (np.arange(16) == 0).astype(float)
    return first if d.theta_r > 0.5 * math.pi else np.asarray(0.5 * (of_glass(d).ravel() + first))


STOKES = np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 1, 1, 0], [0, 1j, -1j, 0]])
"""I, Q, U and V by E_s E_s*, E_s E_p*, E_p E_s* and E_p E_p* (docs/conventions.md)."""


def of_glass(d: Directions, index: float = FACET) -> Floats:
    """The Mueller matrix (4, 4) of a smooth facet that reflects from source to detector, over its first element.

    `d` is one pair of directions, `index` that of a dielectric.
    """
    (k_i, s_i, p_i), (k_r, s_r, p_r) = (
        ray_axes(theta, phi, incident=incident)
        for theta, phi, incident in ((d.theta_i, d.phi_i, True), (d.theta_r, d.phi_r, False))
    )
    s = np.cross(k_i, k_r)
    length = float(np.linalg.norm(s))
    s = s / length if length > 1e-9 else s_i  # in one line any plane is that of incidence
    cos_i = 0.5 * float(np.linalg.norm(k_r - k_i))
    cos_t = math.sqrt(1.0 - (1.0 - cos_i**2) / index**2)
    r_s = (cos_i - index * cos_t) / (cos_i + index * cos_t)
    r_p = (index * cos_i - cos_t) / (index * cos_i + cos_t)
    into = np.array([s, np.cross(s, k_i)]) @ np.array([s_i, p_i]).T
    out = np.array([s_r, p_r]) @ np.array([s, np.cross(s, k_r)]).T
    jones = out @ np.diag([r_s, r_p]) @ into
    mueller = (STOKES @ np.kron(jones, jones) @ np.linalg.inv(STOKES)).real
    return np.asarray(mueller / mueller[0, 0])


def _matrix(effects: Floats, values: Floats, likely: Floats) -> Floats:
    """The Mueller matrix (16,) [1/sr] that shows these values, as near as can be to a likely one."""
    usual = effects @ likely
    scale = float(values @ usual) / float(usual @ usual)
    return np.asarray(scale * likely + np.linalg.lstsq(effects, values - scale * usual)[0])
