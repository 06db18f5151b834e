"""Digits that others computed or published: models and colour."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gonio import geometry
from gonio import models as of_models
from gonio.colour import cie
from gonio.models.plain import anisotropic, retroreflecting
from gonio.typing import Floats
from gonio_validation.bench import specification
from gonio_validation.verify.finding import Finding, most, near

DIGITS = Path(__file__).with_name("digits.json")
CLOSED, INTEGRAL = 1e-9, 1e-7
"""Bounds for closed formulas (processors round differently, and inputs are a double's) and for the exact integral."""
PLAIN = 1e-9
"""Kernels and plain formulas round alike to 1e-12, but where facets are steep."""
WHITES = {"D65": (0.31272, 0.32903), "A": (0.44757, 0.40745), "D50": (0.34567, 0.35851)}
"""x, y for the 2 degree observer (CIE 15:2004, table T.3)."""
SUMS = (106.8655, 106.8569, 106.8922)
"""Sums of the 2 degree observer's three functions at every nanometre from 360 to 830 nm."""


def models(_folder: Path) -> list[Finding]:
    """See `gonio_validation.verify`."""
    worst = dict[str, tuple[float, str]]()
    counts = dict[str, int]()
    for case in json.loads(DIGITS.read_text(encoding="utf-8"))["cases"]:
        p = dict(case["parameters"])
        name = case["model"] + (f", {p['form']}" if "form" in p else "")
        off = abs(_computed(case) / case["value"] - 1.0)
        off = off if math.isfinite(off) else math.inf
        counts[name] = counts.get(name, 0) + 1
        if off >= worst.get(name, (-1.0, ""))[0]:
            worst[name] = (off, f"{case['what']} at {', '.join(f'{x:.4g}' for x in case['at'])} rad")
    out = [
        most(f"{name}: {counts[name]} digits", off, INTEGRAL if name.endswith("exact") else CLOSED,
             f"the digits of others; worst: {where}")
        for name, (off, where) in worst.items()
    ]  # fmt: skip
    return [*out, *_against_plain()]


def _computed(case: dict[str, Any]) -> float:
    p = dict(case["parameters"])
    if isinstance(p.get("ior"), str):
        p["ior"] = complex(p["ior"])
    if "slopes" in p:
        p["slopes"] = tuple(tuple(pair) for pair in p["slopes"])
    model = getattr(of_models, case["model"])(**p)
    more = {"wavelength_nm": case["wavelength_nm"]} if "wavelength_nm" in case else {}
    return float(getattr(model, case["what"])(*case["at"], **more))


def _against_plain() -> list[Finding]:
    """Kernels whose equations no file of digits covers, against their plain formulas."""
    rng = np.random.default_rng(1991)
    theta, phi = np.arccos(rng.uniform(0.15, 1.0, (2, 400))), rng.uniform(0.0, 2 * np.pi, (2, 400))
    light, view = geometry.direction(theta[0], phi[0]), geometry.direction(theta[1], phi[1])
    pairs: dict[str, tuple[Any, Callable[[], Floats]]] = {
        "Lambert": (of_models.Lambert(0.5), lambda: np.full(400, 0.5 / np.pi)),
        "Phong": (
            of_models.Phong(0.5, 0.4, 20.0),
            lambda: specification.phong({"k_d": 0.5, "k_s": 0.4, "exponent": 20.0}, light, view),
        ),
        **_more_plain(light, view),
    }
    out = []
    for name, (model, plain) in pairs.items():
        found, right = model.brdf_vectors(light, view, wavelength_nm=550.0), plain()
        off = float(np.max(np.abs(found - right) / np.abs(right)))
        out.append(most(f"{name}: 400 pairs of directions", off if math.isfinite(off) else math.inf, PLAIN,
                        "its plain formula"))  # fmt: skip
    return out


def _more_plain(light: Floats, view: Floats) -> dict[str, tuple[Any, Callable[[], Floats]]]:
    along, across, azimuth, ior = 0.2, 0.5, math.radians(25.0), 0.77 + 6.08j
    cos, sin = math.cos(azimuth), math.sin(azimuth)
    back = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])  # of rows: by minus the azimuth
    width, tail, entrance = math.radians(5.0), 1.4, 0.7
    return {
        "AnisotropicFacets": (
            of_models.AnisotropicFacets(along, across, 25.0, ior, 0.6, 0.8),
            lambda: 0.6 * anisotropic.f_r(light @ back, view @ back, along, across, ior) + 0.4 * 0.8 / np.pi,
        ),
        "Retroreflecting": (
            of_models.Retroreflecting(0.3, 5.0, tail, entrance, 0.5),
            lambda: 0.3 * retroreflecting.f_r(light, view, width, tail, entrance) + 0.7 * 0.5 / np.pi,
        ),
    }


def colour(_folder: Path) -> list[Finding]:
    """See `gonio_validation.verify`."""
    nm, functions = cie.spectrum_locus()
    out = [Finding("observer: every nanometre", nm.size == 471, str(nm.size), "471")]
    for letter, found, right in zip("xyz", functions.sum(axis=0), SUMS, strict=True):
        out.append(near(f"observer: sum of {letter}", float(found), right, rel=1e-6, digits=7))
    for name, (x, y) in WHITES.items():
        if name in cie.ILLUMINANTS:
            found_x, found_y = (float(v) for v in cie.chromaticity(cie.white(name)))
            # published to the fifth place, of sums at every nanometre; these are at every fifth
            out += [
                near(f"{name}: x", found_x, x, rel=1e-4, digits=5),
                near(f"{name}: y", found_y, y, rel=1e-4, digits=5),
            ]
    return out
