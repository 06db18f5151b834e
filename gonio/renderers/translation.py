"""A model, or a table, as the material of another program: its BRDF fitted to ours, and how far off it is.

The fit takes a model over the whole hemisphere, and a table at its own directions: nothing is filled in. It minimises
the differences of the cube roots of brdf cos(theta_r), which neither the lobe nor the diffuse part rules (Low2012
compares such metrics). Each direction counts alike; those of a model crowd about the mirror direction.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio import __version__, geometry
from gonio.formats.reader import write_bytes
from gonio.models import Model
from gonio.renderers import channels, gltf, principled
from gonio.renderers.microfacet import Geometry, Material
from gonio.typing import Floats

_INCIDENCES = np.deg2rad([8.0, 25.0, 40.0, 55.0, 68.0, 78.0])
_POLAR, _AZIMUTHS = 24, 10
"""Directions of a model at each of them: half vectors, close together about the mirror direction."""
_ROUGHNESSES = (0.1, 0.3, 0.6)
_GRAZING = np.deg2rad(70.0)
_FLOOR = 0.001 / np.pi
"""Added to both where they are divided [1/sr]: a thousandth of a white, below which no eye sees a difference."""
_WORST = 0.1
"""A median off by more is said to be off."""


@dataclass(frozen=True)
class Target:
    """What is to be described."""

    name: str
    geometry: Geometry
    values: Floats
    """(n, 3) linear sRGB [1/sr]."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Residual:
    """How far a material is off in one region of angles."""

    region: str
    values: int
    ratio: float
    """Median of material / sample, over directions and channels."""
    spread: float
    """The factor within which nine tenths of the values are right."""


@dataclass(frozen=True)
class Translation:
    """A fitted material and what it misses."""

    material: Material
    residuals: tuple[Residual, ...]
    remarks: tuple[str, ...]


def of_model(model: Model, name: str) -> Target:
    """A model at half vectors that crowd about the mirror direction, at six incidences to 78 degrees."""
    side = (np.arange(_POLAR) + 0.5) / _POLAR
    theta_h, phi_h = (
        a.ravel()
        for a in np.meshgrid(np.pi / 2 * side**2, np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS, indexing="ij")
    )
    half = geometry.direction(theta_h, phi_h)
    parts = []
    for theta in _INCIDENCES.tolist():
        cosine = half @ geometry.direction(theta, 0.0)
        outgoing = 2 * cosine[:, np.newaxis] * half - geometry.direction(theta, 0.0)
        above = (cosine > 0) & (outgoing[:, 2] > 0.05)
        theta_r, dphi = geometry.angles(outgoing[above])
        parts.append(np.column_stack([np.full(theta_r.size, theta), theta_r, dphi]))
    theta_i, theta_r, dphi = np.concatenate(parts).T
    values = channels.of_model(model, theta_i, theta_r, dphi)
    notes = []
    below = int((values < 0).any(axis=1).sum())
    if below:
        notes.append(f"colours beyond sRGB in {below} of {len(values)} directions: negative channels become zero")
    if model.depends_on_azimuth:
        notes.append(
            "the model depends on the sample's azimuth; it is taken at phi_i = 0, and the material is isotropic"
        )
    if model.has_spike:
        share = float(model.specular_reflectivity(0.0, wavelength_nm=550.0))
        if share > 1e-4:
            notes.append(
                f"the specular spike ({100 * share:.2g} % of the light at normal incidence, 550 nm) is not in it"
            )
    return Target(name, Geometry.of(theta_i, theta_r, dphi), np.maximum(values, 0.0), tuple(notes))


def of_rows(rows: channels.Rows) -> Target:
    """A table at its own directions below 87 degrees."""
    usable = (rows.angles[:, :2] < np.deg2rad(87.0)).all(axis=1)
    theta_i, theta_r, dphi = rows.angles[usable].T
    values = np.broadcast_to(rows.values, (len(rows.values), 3))[usable]
    said = (*rows.notes, f"fitted to the {int(usable.sum())} directions of the table, and to nothing beyond them")
    return Target(rows.name, Geometry.of(theta_i, theta_r, dphi), values, said)


KINDS: Mapping[str, tuple[type[Material], ...]] = {"gltf": gltf.KINDS, "principled": principled.KINDS}


def translate(target: Target, to: str) -> Translation:
    """Fit each kind of material that a program has, the simple ones first, and take the one that is least off.

    A kind with more parameters has to be better by a twentieth of the residual.
    """
    best: Material | None = None
    least = np.inf
    for kind in KINDS[to]:
        found, off = _fitted(kind, target)
        if best is None or off < 0.95 * least:
            best, least = found, off
    assert best is not None
    residuals = tuple(_residuals(best, target))
    return Translation(best, residuals, (*target.notes, *_said(residuals)))


def _fitted(kind: type[Material], target: Target) -> tuple[Material, float]:
    from scipy.optimize import least_squares

    cosine = target.geometry.cos_r[:, np.newaxis]
    wanted = np.cbrt(target.values * cosine)
    grey = bool(np.ptp(target.values, axis=1).max() <= 1e-9 * target.values.max())
    level = np.pi * np.quantile(target.values, 0.2, axis=0)

    def residual(vector: Floats) -> Floats:
        made = kind.of(vector, grey).brdf(target.geometry)
        return np.asarray((np.cbrt(made * cosine) - wanted).ravel())

    found = []
    lower, upper = kind.bounds(grey)
    for roughness in _ROUGHNESSES:
        start = np.clip(kind.start(level, roughness, grey), lower + 1e-6, upper - 1e-6)
        done = least_squares(residual, start, bounds=(lower, upper), x_scale="jac", tr_solver="lsmr", max_nfev=60)
        found.append((float(done.cost), done.x))
    cost, vector = min(found, key=lambda pair: pair[0])
    return kind.of(vector, grey), float(np.sqrt(2 * cost))


def _residuals(material: Material, target: Target) -> list[Residual]:
    made = material.brdf(target.geometry)
    out = []
    for words, here in regions(target.geometry).items():
        if here.any():
            logs = np.log((made[here] + _FLOOR) / (target.values[here] + _FLOOR))
            out.append(
                Residual(
                    words,
                    int(here.sum()),
                    float(np.exp(np.median(logs))),
                    float(np.exp(np.quantile(np.abs(logs), 0.9))),
                )
            )
    return out


def regions(given: Geometry) -> dict[str, npt.NDArray[np.bool_]]:
    """Named regions of angles, each direction in one."""
    lobe = 2 * np.arccos(np.clip(given.cos_h, -1, 1)) < geometry.AROUND_MIRROR
    grazing = ~lobe & (np.arccos(np.minimum(given.cos_i, given.cos_r)) > _GRAZING)
    retro = ~lobe & ~grazing & (2 * np.arccos(np.clip(given.cos_d, -1, 1)) < geometry.AROUND_MIRROR)
    return {
        "around the mirror direction": lobe,
        "grazing (either angle above 70 degrees)": grazing,
        "around retro-reflection": retro,
        "elsewhere": ~(lobe | grazing | retro),
    }


def _said(residuals: tuple[Residual, ...]) -> list[str]:
    said = [
        f"residual {r.region}: material / sample = {r.ratio:.3g} in the median, nine tenths within a factor of"
        f" {r.spread:.3g} ({r.values} directions)"
        for r in residuals
    ]
    off = [r.region for r in residuals if abs(np.log(r.ratio)) > _WORST or r.spread > 1.5]
    if off:
        said.append(f"WARNING: the material does not describe the sample {'; '.join(off)}")
    return said


def write(target: Target, path: Path, to: str) -> list[str]:
    """Fit and write a material; what it misses is printed, and stands in the file.

    Parameters
    ----------
    target
        What is to be described.
    path
        For "gltf" a .gltf or .glb; for "principled" a .json, or a .py that makes the material in Blender.
    to
        "gltf" or "principled".

    Raises
    ------
    ConfigError
        The file cannot be written, or its ending is another.
    """
    module: Any = {"gltf": gltf, "principled": principled}[to]
    module.check(path)
    made = translate(target, to)
    extras = {
        "generator": f"gonio {__version__}",
        "sample": target.name,
        "residuals": [
            {"region": r.region, "directions": r.values, "median_ratio": r.ratio, "factor_90": r.spread}
            for r in made.residuals
        ],
        "remarks": list(made.remarks),
    }
    write_bytes(path, module.encoded(made.material, target.name, extras, path))
    shown = json.dumps(made.material.shown())
    return [f"{type(made.material).__name__}: {shown}", *made.remarks]
