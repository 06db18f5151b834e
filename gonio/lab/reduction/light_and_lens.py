"""What profile, polarisation and spectrum of the light add to the budget; nothing where the rig file has none of them.

Derived in docs/calibration.md. None of these effects is corrected here (the beam's profile is, in
`gonio.lab.rig.imaging`): each is a signed column, the change of the BRDF for one standard deviation of its cause.

Also here is what a calibration leaves open of the camera's linearity and stray light, and what that does to values.

A band reports the mean of f over the band as the value at its centre. To second order that is f(centre) + sigma^2/2
f''(centre), sigma = fwhm/2.355, and a centre that is wrong by u changes it by f' u. Both derivatives are finite
differences of the run's own bands: `s_wavelength` = f' u(centre), `s_bandwidth` = f'' sigma^2/2.

A lamp of degree P and azimuth a has the Stokes vector (1, P cos 2a, P sin 2a, 0). A camera with the diattenuation p, b
weighs with the row (1, p cos 2b, p sin 2b, 0). With the sample's normalised Mueller matrix m (m_00 = 1) a measurement
of f gives, in the frame of s and p,

    f [1 + P cos 2a m_01 + p cos 2b m_10 + P p (cos 2a cos 2b m_11 + ...)]

A facet that reflects once has m_01 = m_10 = D = (R_s - R_p)/(R_s + R_p) at half of the angle between source and
camera, and m_11 = 1. Light that is scattered more than once, and metals, have smaller values. So the relative error
lies between 0 and

    bound = D |P cos 2a + p cos 2b| + 2 P p

with D of glass (n = 1.5). The standard uncertainty of a value is brdf bound/sqrt(3). At the Brewster angle of bare
glass the error is sqrt(3) = 1.7 standard uncertainties. An azimuth that is not given counts as the worst.
"""

import math

import numpy as np

from gonio.lab.reduction import polarised
from gonio.lab.reduction.count_rates import camera_parameters
from gonio.lab.reduction.polarised import FACET
from gonio.lab.reduction.unknown_shape import of_unknown_shape
from gonio.lab.reduction.values import BandResult, Cause, MeasuredBand, Values
from gonio.lab.rig import Pose, imaging, kinematics, regions
from gonio.lab.rig.calibration_files import covariance_of
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band, Beam, Polarisation
from gonio.lab.rig.protocols import Target
from gonio.lab.rig.regions import filling
from gonio.polarisation import UNPOLARISED
from gonio.typing import Floats

BEAM = tuple(f"lamp.beam.{name}" for name in Beam.model_fields)
SIGMA = 1.0 / (2.0 * math.sqrt(2.0 * math.log(2.0)))
"""Standard deviation of a band of Gaussian shape over its full width at half maximum."""


def beam(measured: MeasuredBand, values: Values) -> None:
    """Add `s_beam`, and the part "beam" of `u_random`, where the rig file or a calibration tells of the profile."""
    description = measured.description
    covariance = covariance_of(description, BEAM)
    # the whole beam is seen, on the sample as on the reference, where it underfills
    if filling(description) != "under" and covariance.any():
        values.common["s_beam"], values.own["beam"] = _beam(measured, covariance, values.brdf)


def polarisation(measured: MeasuredBand, values: Values) -> None:
    """Add what polarisation does, where the rig file or a calibration tells how far lamp or camera polarise.

    Its size is a bound at each point, and its shape over the directions is not known (`of_unknown_shape`).
    """
    description, word = measured.description, measured.band.polarisation
    effects = []
    if description.lamp.polarisation.degree or description.camera.polarisation.degree:
        if word == UNPOLARISED:
            bounds = [polarisation_bound(description, point.pose) for point in measured.points]
        else:
            bounds = [polarised.bound(description, point.pose, word) for point in measured.points]
        u = values.brdf * (np.array(bounds) / math.sqrt(3.0))
        effects.append(u[:, None] * of_unknown_shape([point.directions for point in measured.points]))
    if description.polarisers.sides():
        effects.append(polarised.uneven(measured, values.brdf))
    if effects:
        values.shared["polarisation"] = np.concatenate(effects, axis=1)


def _beam(measured: MeasuredBand, covariance: Floats, brdf: Floats) -> tuple[Floats, Floats]:
    """The change of the BRDF that all points share, and the standard uncertainty that is each point's own [1/sr].

    A profile that is wrong by a factor exp(m d), with m the monomials and d the errors of their coefficients, changes a
    rate by the mean of m over its region; a BRDF by the difference of that at the reference and at the point.
    """
    description, band = measured.description, measured.band
    at_visit = np.zeros(len(BEAM))
    if description.reference.how != "beam":
        at_visit = monomials(description, measured.visit.pose, "reference", band)
    gradients = np.array([at_visit - monomials(description, p.pose, "sample", band) for p in measured.points])
    gradients = gradients.reshape(-1, len(BEAM)) * brdf[:, None]
    size = np.einsum("pk,kl,pl->p", gradients, covariance, gradients)
    if not size.size:
        return np.zeros(0), np.zeros(0)
    largest = gradients[int(np.argmax(size))]
    column = gradients @ covariance @ largest / math.sqrt(max(float(largest @ covariance @ largest), 1e-300))
    return column, np.sqrt(np.maximum(size - column**2, 0.0))


def monomials(description: RigDescription, pose: Pose, target: Target, band: Band) -> Floats:
    """Mean over a region of x, y, x^2, xy, y^2 on the plane that faces the lamp [mm, mm^2]."""
    view = kinematics.view(description, pose)
    region = regions.roi(description, view, target, band.channel)
    x, y = (value[region.mask] for value in imaging.pixel_map(description, view, region.rows, region.cols).beam_xy_mm)
    return np.array([float(np.mean(term)) for term in (x, y, x * x, x * y, y * y)])


def polarisation_bound(description: RigDescription, pose: Pose) -> float:
    """Largest relative error of a BRDF from the polarisation of lamp and camera at a pose, with its likely sign.

    Of a sample whose facets reflect once, with the index `FACET`; and of lamp and camera together, where neither the
    sample nor the reference need depolarise.
    """
    view = kinematics.view(description, pose)
    light, camera = (v / np.linalg.norm(v) for v in (view.source_mm, view.camera_mm))
    lamp, lens = description.lamp.polarisation, description.camera.polarisation
    across = np.cross(light, camera)
    length = float(np.linalg.norm(across))
    first = 0.0
    if length > 1e-9:  # else light and camera are in one line, and there is no plane of incidence
        across /= length
        beam_y = view.image_y if view.beam_y is None else view.beam_y
        parts = [_along(lamp, light, beam_y, across), _along(lens, camera, view.image_y, across)]
        known = sum(part for part, sure in parts if sure)
        first = math.copysign(abs(known) + sum(part for part, sure in parts if not sure), known)
        first *= diattenuation(0.5 * math.atan2(length, float(light @ camera)))
    return first + math.copysign(2.0 * lamp.degree * lens.degree, first)


def _along(of: Polarisation, toward: Floats, y: Floats, across: Floats) -> tuple[float, bool]:
    """Degree of polarisation across the plane of incidence, less that along it; and whether its azimuth is known."""
    if of.azimuth_deg is None:
        return of.degree, False
    turn = math.atan2(float(across @ np.cross(y, toward)), float(across @ y))
    return of.degree * math.cos(2.0 * (turn - math.radians(of.azimuth_deg))), True


def diattenuation(theta: float) -> float:
    """(R_s - R_p)/(R_s + R_p) of a smooth dielectric of the index `FACET` at an angle of incidence [rad]."""
    inside = math.asin(math.sin(theta) / FACET)
    # Fresnel: R_p/R_s = (cos(theta + theta_t)/cos(theta - theta_t))^2
    ratio = (math.cos(theta + inside) / math.cos(theta - inside)) ** 2
    return (1.0 - ratio) / (1.0 + ratio)


def centre_uncertainties(description: RigDescription) -> dict[str, float]:
    """Standard uncertainty of the centre of each band [nm], by its name."""
    bands = description.bands
    names = [f"bands.list[{k}].centre_nm" for k in range(len(bands.list))]
    out = np.sqrt(np.diag(covariance_of(description, names))).tolist() if names else []
    count = len(bands.all()) - len(bands.list)
    if count:
        c = covariance_of(description, ["bands.tunable.start_nm", "bands.tunable.step_nm"])
        out += [math.sqrt(max(c[0, 0] + 2 * k * c[0, 1] + k * k * c[1, 1], 0.0)) for k in range(count)]
    return {band.name: u for band, u in zip(bands.all(), out, strict=True)}


def add_wavelength(description: RigDescription, results: list[BandResult]) -> None:
    """Add `s_wavelength` and `s_bandwidth` where a calibration knows the bands, and the run has several of them.

    The BRDF's derivatives over the wavelength are finite differences over the run's own bands: the first between
    neighbours, with the uncertainty of the centre; the second of three bands, with sigma^2/2, which is what the mean
    over a band differs by from the value at its centre. Of polarised values those of one state belong together.
    """
    for word in dict.fromkeys(result.band.polarisation for result in results):
        _along_wavelengths(description, [result for result in results if result.band.polarisation == word])


def _along_wavelengths(description: RigDescription, results: list[BandResult]) -> None:
    u = centre_uncertainties(description)
    if len(results) < 2 or not any(u[result.band.alone.name] for result in results):
        return
    points = np.unique(np.concatenate([result.rows for result in results]))
    brdf = np.full((points.size, len(results)), math.nan)
    for k, result in enumerate(results):
        brdf[np.searchsorted(points, result.rows), k] = result.values.brdf
    order = np.argsort([result.band.centre_nm for result in results])
    waves = np.array([results[k].band.centre_nm for k in order])
    names = ("s_wavelength", "s_bandwidth") if len(results) > 2 else ("s_wavelength",)
    for result in results:
        result.values.common |= {name: np.zeros(len(result.rows)) for name in names}
    for row, values in zip(points.tolist(), brdf[:, order], strict=True):
        there = np.flatnonzero(np.isfinite(values))
        if there.size < 2:
            continue
        slopes = np.gradient(values[there], waves[there])
        curvatures = _curvatures(values[there], waves[there])
        for k, slope, curvature in zip(there.tolist(), slopes, curvatures, strict=True):
            result = results[int(order[k])]
            place = np.searchsorted(result.rows, row)
            found = slope * u[result.band.alone.name], 0.5 * curvature * (SIGMA * result.band.fwhm_nm) ** 2
            for name, change in zip(names, found, strict=False):
                result.values.common[name][place] = change


def _curvatures(values: Floats, x: Floats) -> Floats:
    """Second derivatives by parabolas through three neighbours; at the ends that of the neighbour."""
    if values.size < 3:
        return np.zeros(values.size)
    steps = np.diff(x)
    inner = 2.0 * np.diff(np.diff(values) / steps) / (steps[:-1] + steps[1:])
    return np.concatenate([inner[:1], inner, inner[-1:]])


def notes(description: RigDescription, results: list[BandResult]) -> list[str]:
    """What the budget lacks, where a calibration tells of the bands and the run does not tell their effect."""
    results = [result for result in results if result.band.polarisation == results[0].band.polarisation]
    u = centre_uncertainties(description)
    if len(results) > 2 or not any(u[result.band.alone.name] for result in results):
        return []
    one = len(results) == 1
    return [
        f"the run has {'one band' if one else 'two bands'}: the effect of "
        f"{'the wavelength and of the width of the band' if one else 'the width of the bands'} is not in u_brdf"
    ]


def camera(measured: MeasuredBand, values: Values) -> None:
    """Add `s_linearity` and `s_stray_light`, as far as a calibration of the camera tells of them.

    A point's change is that of its own rate less that of the reference's, to which it is compared.
    """
    points, visit = measured.points, measured.visit
    by = np.array([point.by_camera for point in points]).reshape(len(points), visit.by_camera.size)
    change = by / measured.level[:, None] - values.brdf[:, None] * visit.by_camera / visit.rate
    values.common |= {name: change @ direction for name, direction in _causes(measured.description).items()}


def black(measured: MeasuredBand, values: Values) -> None:
    """Add `s_black`, where the dark frames say that noise is cut off at black: small signals come out too low."""
    visit, hidden = measured.visit, np.array([point.hidden for point in measured.points])
    if visit.hidden:
        values.common["s_black"] = values.brdf * (visit.hidden / visit.rate) - hidden / measured.level


def _causes(description: RigDescription) -> dict[str, Floats]:
    """Independent directions of the calibration's covariance of the camera, in `camera_parameters`, by their columns.

    The first direction of a cause has the name of the cause; others, where several numbers are known, have a number.
    """
    parameters = camera_parameters(description)
    out: dict[str, Floats] = {}
    for cause in dict.fromkeys(parameters.values()):
        names = [name for name, of in parameters.items() if of == cause]
        values, vectors = np.linalg.eigh(covariance_of(description, names))
        held = [k for k in range(len(names))[::-1] if values[k] > 1e-12 * max(values[-1], 1e-300)]
        for number, k in enumerate(held):
            direction = np.zeros(len(parameters))
            direction[[list(parameters).index(name) for name in names]] = vectors[:, k] * math.sqrt(values[k])
            out[cause if number == 0 else f"{cause}_{number + 1}"] = direction
    return out


CAUSES: tuple[Cause, ...] = (camera, black, beam, polarisation)
