"""What a blind campaign hides: a sample, a plan, and the errors of a bench, all drawn from (seed, campaign).

`CAUSES` is the one list of errors. A cause has two sides: what the rig file says of it, and what is true (the rig's
`truth` file, which only the simulated devices read). A cause that is left out is off on both sides.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from gonio.errors import ConfigError
from gonio.typing import TomlTable

Tables = TomlTable
"""Keys of a file, in its tables."""
Angles = tuple[float, float, float, float]
"""theta_i, phi_i, theta_r, phi_r [deg]."""
METALS = {"Al": 0.96 + 6.69j, "Au": 0.26 + 2.55j, "Fe": 2.9 + 3.05j, "glass": 1.5 + 0.0j}
"""Optical constants at about 550 nm, for He-Torrance; a campaign uses one at its own wavelength as if it held there."""
CERTIFIED = {
    "arms.light.zero_offset_deg": 0.015, "arms.camera.zero_offset_deg": 0.015, "holder.tilt_zero_offset_deg": 0.015,
    "arms.light.harmonics_deg[0][1]": 0.01, "arms.light.harmonics_deg[0][2]": 0.01,
    "arms.camera.harmonics_deg[0][1]": 0.01, "arms.camera.harmonics_deg[0][2]": 0.01,
    "arms.light.axis_tilt_deg[0]": 0.015, "arms.light.axis_tilt_deg[1]": 0.015, "arms.camera.elevation_deg": 0.015,
    "holder.surface_tilt_deg[0]": 0.015, "holder.surface_tilt_deg[1]": 0.015,
}  # fmt: skip
"""Errors of the bench that its geometry file states, each with about its standard uncertainty [deg]."""
BENCH: Tables = {
    "rig": "sim",
    "name": "blind goniometer",
    "truth": "truth.toml",
    "arms": {"light": {"limits_deg": [-95.0, 95.0]}, "camera": {"limits_deg": [-95.0, 95.0]}},
    "holder": {"axes": ["tilt", "spin"], "sample_diameter_mm": 6.0},
    # a sensor without noise, whose levels are as fine as a raw file can hold
    "camera": {
        "width": 96, "height": 72, "pixel_um": 20.0, "cos4": True, "bits": 16, "quantised": False,
        "electrons_per_dn": 0.165, "exposure_limits_s": [1e-5, 60.0],
    },
    # smaller than the field of view: what is dark around it tells the camera's linearity
    "reference": {"how": "swap", "albedo": 0.97, "every": 8, "frames": 8, "diameter_mm": 8.0},
    "bands": {"tunable": {"start_nm": 400.0, "stop_nm": 700.0, "step_nm": 10.0, "fwhm_nm": 10.0}},
    "acquisition": {"frames": 2, "dark_frames": 8},
}  # fmt: skip


@dataclass(frozen=True)
class Drawn:
    """One error of one bench."""

    known: Tables = field(default_factory=dict)
    """What the rig file says."""
    true: Tables = field(default_factory=dict)
    """What the truth file says."""
    certificate: Certificate | None = None


@dataclass(frozen=True)
class Certificate:
    """What somebody else's calibration of a bench says: how far it is off, drawn from the covariance that it states."""

    parameters: tuple[str, ...]
    """Paths of numbers of the rig file."""
    off: tuple[float, ...]
    """Certified value less the true one."""
    u: tuple[float, ...]
    correlation: tuple[tuple[float, ...], ...]
    values: Tables
    """What it says beside these numbers."""


@dataclass(frozen=True)
class Cause:
    """An error that a bench may have."""

    name: str
    hidden: str
    """What is drawn, in words."""
    learned: str
    """What the laboratory knows of it, and how."""
    draw: Callable[[np.random.Generator], Drawn]


@dataclass(frozen=True)
class Campaign:
    """Everything that is true in one campaign."""

    number: int
    seed: int
    """Of the simulated bench's noise."""
    model: str
    given: Tables
    """Arguments of the model."""
    truth: dict[str, float]
    """Parameters, as a fit calls them."""
    ior: complex | None
    """Optical constants that the fit is told."""
    plan: str
    points: tuple[Angles, ...]
    wavelength_nm: float
    rig: Tables
    """The rig file."""
    true: Tables
    """The truth file."""
    errors: tuple[str, ...]
    """Names of its causes."""
    certificate: Certificate | None
    """Of its geometry, where the bench has one."""


def campaign(seed: int, number: int, only: Sequence[str] = (), most: int = 40) -> Campaign:
    """The campaign of a number: the same for one seed, whatever other campaigns there are.

    Parameters
    ----------
    only
        Names of `CAUSES`; all of them, where none is named. A cause is drawn alike, alone or among others.
    most
        Points of its plan.
    """
    model = list(SAMPLES)[number % len(SAMPLES)]
    given, truth, ior = SAMPLES[model](_generator(seed, number, "sample"))
    rng = _generator(seed, number, "plan")
    plan = list(PLANS)[number // len(SAMPLES) % len(PLANS)]
    points = tuple(dict.fromkeys(PLANS[plan](rng)))
    if len(points) > most:
        points = tuple(points[k] for k in sorted(rng.choice(len(points), most, replace=False)))
    wavelength = float(rng.choice(np.arange(450.0, 651.0, 10.0)))
    causes = chosen(only)
    drawn = [cause.draw(_generator(seed, number, cause.name)) for cause in causes]
    rig = merged(BENCH, _instrument(_generator(seed, number, "instrument")), *(d.known for d in drawn))
    noise = int(_generator(seed, number, "noise").integers(1 << 31))
    true = merged(*(d.true for d in drawn))
    certificate = next((d.certificate for d in drawn if d.certificate is not None), None)
    errors = tuple(cause.name for cause in causes)
    return Campaign(number, noise, model, given, truth, ior, plan, points, wavelength, rig, true, errors, certificate)


def chosen(only: Sequence[str]) -> list[Cause]:
    """The causes of these names, or all.

    Raises
    ------
    ConfigError
        There is none of a name.
    """
    known = [cause.name for cause in CAUSES]
    for name in only:
        if name not in known:
            raise ConfigError(f'--only {",".join(only)}: there is no error "{name}"; there are {", ".join(known)}')
    return [cause for cause in CAUSES if not only or cause.name in only]


def merged(*several: Mapping[str, Any]) -> Tables:
    """Nested tables, a later one over an earlier one."""
    out: Tables = {}
    for tables in several:
        for key, value in tables.items():
            below = out.get(key)
            out[key] = merged(below if isinstance(below, dict) else {}, value) if isinstance(value, dict) else value
    return out


def _generator(seed: int, number: int, what: str) -> np.random.Generator:
    """Random numbers for one thing of one campaign: they do not depend on what else is drawn."""
    return np.random.default_rng([seed, number, zlib.crc32(what.encode())])


def _even(rng: np.random.Generator, low: float, high: float, digits: int = 4) -> float:
    return round(float(rng.uniform(low, high)), digits)


def _instrument(rng: np.random.Generator) -> Tables:
    """What the laboratory knows rightly: distances and cones."""
    return {
        "geometry": {
            "light_distance_mm": _even(rng, 800.0, 1200.0, 0),
            "camera_distance_mm": _even(rng, 800.0, 1200.0, 0),
        },
        "lamp": {"half_angle_deg": _even(rng, 0.3, 0.8, 2)},
        "camera": {"lens_half_angle_deg": _even(rng, 0.3, 0.8, 2)},
    }


# --- errors -------------------------------------------------------------------------------------------------------


def _zeros(rng: np.random.Generator) -> Drawn:
    light, camera, tilt = (_even(rng, -limit, limit, 3) for limit in (3.0, 3.0, 1.5))
    unknown = {"zero_offset_known": False}
    return Drawn(
        {"arms": {"light": unknown, "camera": unknown}, "holder": unknown},
        {
            "arms": {"light": {"zero_offset_deg": light}, "camera": {"zero_offset_deg": camera}},
            "holder": {"tilt_zero_offset_deg": tilt},
        },
    )


def _encoders(rng: np.random.Generator) -> Drawn:
    step = float(rng.choice([0.022, 0.044, 0.088]))

    def axes(backlash: Sequence[float]) -> Tables:
        light, camera, holder = ({"encoder_step_deg": step, "backlash_deg": b} for b in backlash)
        return {"arms": {"light": light, "camera": camera}, "holder": holder}

    return Drawn(axes([0.2] * 3), axes([_even(rng, 0.0, 0.3, 3) for _ in range(3)]))


def _geometry(rng: np.random.Generator) -> Drawn:
    if rng.random() < 0.5:
        return Drawn()  # a bench whose axes are straight: where its zeros are hidden, `gonio rig align` finds them
    true = {
        "arms": {
            "light": {"harmonics_deg": [[1, *_several(rng, 2, 0.1)]], "axis_tilt_deg": _several(rng, 2, 0.3)},
            "camera": {"harmonics_deg": [[2, *_several(rng, 2, 0.1)]], "elevation_deg": _even(rng, -0.3, 0.3)},
        },
        "holder": {"surface_tilt_deg": _several(rng, 2, 0.3)},
    }
    some = len(CERTIFIED)
    u = np.array(list(CERTIFIED.values())) * rng.uniform(0.5, 1.5, some)
    mixed = rng.standard_normal((some, 4))  # four errors that all have a part in, and one of each its own
    covariance = mixed @ mixed.T + 2.0 * np.eye(some)
    size = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(size, size)
    np.fill_diagonal(correlation, 1.0)
    correlation = np.clip(correlation, -1.0, 1.0)
    off = u * (np.linalg.cholesky(correlation) @ rng.standard_normal(some))
    known = {"zero_offset_known": True}
    return Drawn(
        true=true,
        certificate=Certificate(
            tuple(CERTIFIED), tuple(off.tolist()), tuple(u.tolist()), tuple(map(tuple, correlation.tolist())),
            {"arms": {"light": known, "camera": known}, "holder": known},
        ),
    )  # fmt: skip


def _several(rng: np.random.Generator, count: int, limit: float) -> list[float]:
    return [_even(rng, -limit, limit) for _ in range(count)]


def _lamp(rng: np.random.Generator) -> Drawn:
    return Drawn(
        {"lamp": {"noise": 0.003}},
        {
            "lamp": {
                "noise": _even(rng, 0.001, 0.008), "warm_up_loss": _even(rng, 0.02, 0.08),
                "warm_up_time_constant_s": _even(rng, 150.0, 450.0, 0),
            }
        },
    )  # fmt: skip


def _drift(rng: np.random.Generator) -> Drawn:
    return Drawn(true={"lamp": {"drift_per_hour": _even(rng, -0.03, 0.03)}})


def _camera(rng: np.random.Generator) -> Drawn:
    gain = _even(rng, 2.0, 4.0, 2)
    sheet = {
        "photon_noise": True, "bits": 12, "quantised": True, "electrons_per_dn": 3.0, "full_well_e": 11700.0,
        "read_noise_e": 5.0, "dark_current_e_per_s": 8.0, "prnu": 0.005, "dsnu_e": 2.0,
    }  # fmt: skip
    true = {
        "electrons_per_dn": gain, "full_well_e": round(3900.0 * gain), "read_noise_e": _even(rng, 2.0, 8.0, 2),
        "dark_current_e_per_s": _even(rng, 1.0, 20.0, 1), "prnu": _even(rng, 0.002, 0.01),
        "dsnu_e": _even(rng, 0.5, 4.0, 2), "nonlinearity": [_even(rng, -0.015, 0.015)],
        "stray_light": _even(rng, 0.005, 0.02), "vignetting": _even(rng, 0.0, 0.2, 2),
    }  # fmt: skip
    return Drawn({"camera": sheet}, {"camera": true})


def _reference(rng: np.random.Generator) -> Drawn:
    certified, u_rel = _even(rng, 0.90, 0.96, 3), _even(rng, 0.001, 0.005)
    return Drawn(
        {"reference": {"albedo": certified, "u_rel": u_rel}},
        {"reference": {"albedo": round(certified * (1.0 + u_rel * float(rng.standard_normal())), 7)}},
    )


CAUSES = (
    Cause(
        "zeros",
        "zero offsets of light and camera (up to 3 deg) and of the tilt (up to 1.5 deg)",
        "`gonio rig align`: scans over a mirror and straight through, with their uncertainty; or the certificate below",
        _zeros,
    ),
    Cause(
        "geometry",
        "in every second campaign, by chance: encoder harmonics (0.1 deg), a tilted axis of the light arm, a camera "
        "that stands out of the plane, a surface that is not normal to the spin (0.3 deg each)",
        "a calibration file with these and the zeros: the truth and an error that is drawn from the covariance that "
        "the file states (0.005 to 0.02 deg, correlated)",
        _geometry,
    ),
    Cause(
        "encoders",
        "where an axis lands within an encoder step of 0.022 to 0.088 deg; backlash of 0 to 0.3 deg",
        "the step stands in the rig file; the backlash there is 0.2 deg, and every goal is approached from below",
        _encoders,
    ),
    Cause(
        "lamp",
        "a warm-up of 2 to 8 % with a time constant of 150 to 450 s; noise from frame to frame (0.1 to 0.8 %)",
        "`gonio calibrate light --only lamp`: how long to wait, and the noise",
        _lamp,
    ),
    Cause("drift", "drift of the lamp, up to 3 % an hour either way", "measurements of the white reference", _drift),
    Cause(
        "camera",
        "gain (2 to 4 e-/DN), read noise, dark current, PRNU and DSNU of every pixel, nonlinearity up to 1.5 %, stray "
        "light of 0.5 to 2 %, vignetting",
        "`gonio calibrate camera`: dark frames, flats, fields, a trap and a knife edge; each run has its dark frames",
        _camera,
    ),
    Cause(
        "reference",
        "the reference's albedo, off its certificate by a normal error of 0.1 to 0.5 %",
        "its standard uncertainty stands in the certificate",
        _reference,
    ),
)


# --- samples ------------------------------------------------------------------------------------------------------

Sample = tuple[Tables, dict[str, float], complex | None]


def _even_in(rng: np.random.Generator, **ranges: tuple[float, float] | tuple[float, float, int]) -> Sample:
    """Parameters that are drawn apart from each other, as `_even` takes them."""
    truth = {name: _even(rng, *of) for name, of in ranges.items()}
    return dict(truth), truth, None


def _cook_torrance(rng: np.random.Generator) -> Sample:
    truth = {
        "s": _even(rng, 0.2, 0.8),
        "m": _even(rng, 0.15, 0.45),
        "diffuse_albedo": _even(rng, 0.1, 0.9),
        "ior": _even(rng, 1.35, 2.2),
    }
    given = {"s": truth["s"], "d": 1.0 - truth["s"], "slopes": [[truth["m"], 1.0]]}
    return given | {name: truth[name] for name in ("diffuse_albedo", "ior")}, truth, None


def _he_torrance(rng: np.random.Generator) -> Sample:
    index = METALS[str(rng.choice(list(METALS)))]
    sigma0 = _even(rng, 0.08, 0.5)
    truth = {
        "sigma0_um": sigma0,
        "tau_um": round(sigma0 * float(rng.uniform(5.0, 14.0)), 4),
        "diffuse_albedo": _even(rng, 0.02, 0.3),
    }
    return {**truth, "ior": [index.real, index.imag]}, truth, index


SAMPLES: dict[str, Callable[[np.random.Generator], Sample]] = {
    "lambert": partial(_even_in, albedo=(0.05, 0.95)),
    "oren-nayar": partial(_even_in, albedo=(0.1, 0.9), sigma_deg=(3.0, 40.0)),
    "phong": partial(_even_in, k_d=(0.02, 0.2), k_s=(0.05, 1.0), exponent=(4.0, 50.0, 2)),
    "blinn": partial(_even_in, k_d=(0.02, 0.2), k_s=(0.3, 2.0), c=(0.15, 0.5), ior=(1.35, 2.5)),
    "cook-torrance": _cook_torrance,
    "he-torrance": _he_torrance,
}


# --- plans --------------------------------------------------------------------------------------------------------


def _signed(theta_i: float, theta_r: float, dphi: float = 180.0) -> Angles:
    """A point by its signed theta_r."""
    turn = dphi if theta_r >= 0 else dphi + 180.0
    return round(theta_i, 4), 0.0, round(abs(theta_r), 4), round(turn % 360.0, 4)


def _in_plane(rng: np.random.Generator) -> list[Angles]:
    step = _even(rng, 6.0, 11.0, 0)
    incidences = [_even(rng, low, low + 25.0, 0) for low in (5.0, 40.0)]
    start = _even(rng, -78.0, -70.0, 0)
    return [_signed(t, a) for t in incidences for a in np.arange(start, 78.0, step)]


def _around_the_mirror(rng: np.random.Generator) -> list[Angles]:
    step = _even(rng, 1.0, 5.0, 1)
    incidences = [_even(rng, 15.0, 65.0, 1) for _ in range(int(rng.integers(1, 3)))]
    half = 18 // len(incidences)
    return [_signed(t, t + k * step) for t in incidences for k in range(-half, half + 1) if abs(t + k * step) < 80.0]


def _out_of_plane(rng: np.random.Generator) -> list[Angles]:
    incidences = [_even(rng, 20.0, 65.0, 1) for _ in range(2)]
    out = [_signed(t, a) for t in incidences for a in np.arange(-72.0, 73.0, 16.0)]
    apart = rng.uniform(-1.0, 1.0, (20, 2)) * (35.0, 60.0)
    return out + [
        _signed(incidences[k % 2], min(max(incidences[k % 2] + x, 3.0), 76.0), 180.0 + y)
        for k, (x, y) in enumerate(apart)
    ]


def _grazing(rng: np.random.Generator) -> list[Angles]:
    incidences = [_even(rng, 60.0, 78.0, 0), _even(rng, 20.0, 50.0, 0)]
    return [_signed(t, a) for t in incidences for a in [*np.arange(-80.0, 50.0, 20.0), *np.arange(50.0, 83.0, 4.0)]]


def _anywhere(rng: np.random.Generator, count: int) -> list[Angles]:
    """Directions over the hemisphere, each with its own angle of incidence; half of the plans have every azimuth."""
    turned = rng.random() < 0.5
    theta = np.degrees(np.arcsin(np.sqrt(rng.uniform(0.0, np.sin(np.radians(78.0)) ** 2, (count, 2)))))
    phi_i, dphi = 360.0 * turned * rng.random(count), rng.uniform(0.0, 360.0, count)
    return [
        (round(float(i), 4), round(float(p), 4), round(float(r), 4), round(float(p + d) % 360.0, 4))
        for (i, r), p, d in zip(theta, phi_i, dphi, strict=True)
    ]


def _around_many_mirrors(rng: np.random.Generator) -> list[Angles]:
    """Each point has an angle of incidence of its own, and lies around the mirror direction of that."""
    reach, out = _even(rng, 5.0, 25.0), []
    for theta_i in rng.uniform(5.0, 68.0, 40).tolist():
        x, y = rng.normal(0.0, reach, 2)
        theta_r = float(np.hypot(theta_i + x, y))
        if theta_r < 78.0:
            turn = 180.0 + float(np.degrees(np.arctan2(y, theta_i + x)))
            out.append((round(theta_i, 4), 0.0, round(theta_r, 4), round(turn % 360.0, 4)))
    return out


def _few(rng: np.random.Generator) -> list[Angles]:
    return _anywhere(rng, int(rng.integers(4, 10)))


PLANS: dict[str, Callable[[np.random.Generator], list[Angles]]] = {
    "in plane": _in_plane,
    "around the mirror": _around_the_mirror,
    "out of plane": _out_of_plane,
    "grazing": _grazing,
    "scattered": lambda rng: _anywhere(rng, 40),
    "around many mirrors": _around_many_mirrors,
    "few": _few,
}
