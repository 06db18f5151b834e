"""What Oren and Nayar say of Figs. 12 to 15, measured in the pictures."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from gonio_analysis.report.text import number

from gonio.typing import Floats
from gonio_validation.papers.figure import Claim
from gonio_validation.papers.pictures.centre import Centre, centre, many

VASE_MM = (60.0, 76.0)
"""Heights of the belt of the vase, about half of its height, that a cross-section averages over."""
SIGMA_DEG = (0, 10, 20, 40)
FLAT = 0.1
"""Scatter of a disc of near constant brightness, over its mean; a Lambertian sphere has 0.35."""


def cross_section(c: Centre) -> tuple[Floats, Floats]:
    """Brightness across the vase: position from -1 (left) to 1 (right), and radiance, its largest 1."""
    height = c.picture.position[..., 1]
    belt = c.on("vase") & (height > VASE_MM[0]) & (height < VASE_MM[1])
    rows = np.flatnonzero(belt.any(axis=1))
    row = int(rows[rows.size // 2])
    columns = np.flatnonzero(belt[row])
    # the vase reaches half a pixel beyond the centres of its outermost pixels, on average
    middle, half = 0.5 * (columns[0] + columns[-1]), 0.5 * (columns[-1] - columns[0] + 1)
    bright = c.grey()[row, columns] - _ambient(c)
    return (columns - middle) / half, bright / bright.max()


def _ambient(c: Centre) -> float:
    """What the background light adds to a surface whose ambient_reflectance is 1."""
    return 0.0 if c.scene.ambient is None else float(c.scene.ambient[0])


def _at(section: tuple[Floats, Floats], where: float) -> float:
    return float(np.interp(where, *section))


def _share(section: tuple[Floats, Floats]) -> float:
    """Share of the width with at least 80 % of the largest brightness."""
    return float(np.mean(section[1] >= 0.8))


def sections(height: int | None = None) -> dict[str, tuple[Floats, Floats]]:
    """The four cross-sections of Fig. 13."""
    names = {
        "viewer, Lambert": "oren-nayar-12b",
        "viewer, model": "oren-nayar-12c",
        "20° right, Lambert": "oren-nayar-13b-lambert",
        "20° right, model": "oren-nayar-13b-model",
    }
    return {words: cross_section(centre(name, height=height)) for words, name in names.items()}


def figure_12(height: int | None = None) -> list[Claim]:
    """The vase, lit from the camera."""
    found = sections(height)
    lambert, model = found["viewer, Lambert"], found["viewer, model"]
    return [
        Claim(
            "The brightness of the real vase “remains nearly constant over most of the cross-section”, and the "
            "proposed model “does very well in predicting this behavior”.",
            _share(model) > 0.75,
            f"share of the width with at least 80 % of the largest brightness: {100 * _share(model):.0f} % (model), "
            f"{100 * _share(lambert):.0f} % (Lambert)",
            "more than three quarters of the width",
        ),
        Claim(
            "The model predicts that it “drops quickly to zero very close to the limbs”.",
            _at(model, 0.98) < 0.5,
            "model at 0.8, 0.9 and 0.98 of the radius: "
            + ", ".join(number(_at(model, x), 2) for x in (0.8, 0.9, 0.98))
            + "; toward the light equation (14) stays above zero up to grazing incidence",
            "below one half at 0.98 of the radius",
        ),
        Claim(
            "“The Lambertian model produces large brightness errors.”",
            _at(model, 0.9) > 1.2 * _at(lambert, 0.9),
            f"at 0.9 of the radius: model {number(_at(model, 0.9), 2)}, Lambert {number(_at(lambert, 0.9), 2)}",
            "near the limb the model is more than 1.2 times as bright",
        ),
    ]


def figure_13(height: int | None = None) -> list[Claim]:
    """The vase, lit from 20 degrees to the right."""
    found = sections(height)
    lambert, model = found["20° right, Lambert"], found["20° right, model"]
    peaks = {words: float(s[0][int(np.argmax(s[1]))]) for words, s in (("model", model), ("Lambert", lambert))}
    ratio = _at(model, 0.9) / _at(model, -0.9)
    return [
        Claim(
            "With the light 20° to the right “brightness variation on the real vase is asymmetric”.",
            ratio > 1.2,
            f"brightness at 0.9 of the radius, right over left: {number(ratio)} (model)",
            "more than 1.2",
        ),
        Claim(
            "“The Lambertian model forces the brightness close to the right limb … to drop much faster than in the "
            "real image.”",
            _at(model, 0.95) > 1.2 * _at(lambert, 0.95),
            f"at 0.95 of the radius: model {number(_at(model, 0.95), 2)}, Lambert {number(_at(lambert, 0.95), 2)}",
            "the model is more than 1.2 times as bright there",
        ),
        Claim(
            "“The brightness peak predicted by the Lambertian model is significantly away from the actual peak.”",
            peaks["model"] - peaks["Lambert"] > 0.1,
            ", ".join(f"{words}’s peak at {p:.2f} of the radius" for words, p in peaks.items()),
            "more than 0.1 of the radius apart",
        ),
    ]


def _uneven(c: Centre) -> float:
    """Scatter of the brightness over the disc, over its mean."""
    bright = c.grey()[c.on("sphere")] - _ambient(c)
    return float(bright.std() / bright.mean())


def _with_interreflections(tables: dict[str, Any]) -> None:
    tables["material"]["matte"]["parameters"]["interreflections"] = True


def figure_14(height: int | None = None) -> list[Claim]:
    """Spheres."""
    taken = {s: centre(f"oren-nayar-14{k}", height=height) for k, s in zip("abcd", SIGMA_DEG, strict=True)}
    uneven = {s: _uneven(c) for s, c in taken.items()}
    first = taken[0]
    where = first.on("sphere")
    cosine = first.picture.normal[where][:, 2]  # the light comes along z
    ratio = (first.grey()[where] - _ambient(first))[cosine > 0.1] / cosine[cosine > 0.1]
    law = float(np.ptp(ratio) / ratio.mean())
    whole = _uneven(centre("oren-nayar-14d", height=height, change=_with_interreflections))
    values = list(uneven.values())
    return [
        Claim(
            "“In the first case, σ = 0, and hence the sphere appears Lambertian.”",
            law < 1e-6,
            f"the brightness is the cosine of the angle, to {number(max(law, 1e-16), 1)}",
            "equal to 1e-6 at every pixel",
        ),
        Claim(
            "“As the roughness increases, the sphere begins to appear flatter.”",
            all(b < a for a, b in pairwise(values)),
            "scatter of the brightness over the disc, over its mean: "
            + ", ".join(f"{100 * u:.0f} % ({s}°)" for s, u in uneven.items()),
            "each sphere is flatter than the one before",
        ),
        Claim(
            "In the extreme case “the sphere appears like a flat disc with near constant brightness” (the full moon).",
            uneven[40] < FLAT,
            f"scatter over the mean at σ = 40°: {100 * uneven[40]:.1f} %, Lambert {100 * uneven[0]:.0f} %; with the "
            f"light between facets (eq. 15), which the shader leaves out, {100 * whole:.1f} %",
            f"less than {100 * FLAT:.0f} %",
        ),
    ]


def figure_15(height: int | None = None) -> list[Claim]:
    """Vase, block and cube."""
    names = ("oren-nayar-15a-viewer", "oren-nayar-15b-viewer")
    matte, rough = many(names, height).values()
    faces = {"a": _faces(matte), "b": _faces(rough)}
    spread = {k: max(f) / min(f) for k, f in faces.items()}
    shade = {name: tuple(_shading(c, name) for c in (matte, rough)) for name in ("vase", "cylinder")}
    edge = {k: _flat_over_curved(c) for k, c in (("a", matte), ("b", rough))}
    return [
        Claim(
            "(a) “The vase and the cylinder have strong brightness variations.” (b) Their shading “is diminished "
            "considerably”.",
            all(b < 0.7 * a for a, b in shade.values()),
            "scatter of the brightness over its mean: "
            + ", ".join(f"{name} {100 * a:.0f} % (a), {100 * b:.0f} % (b)" for name, (a, b) in shade.items()),
            "less than 0.7 times as much in (b)",
        ),
        Claim(
            "(a) “The three visible faces of the cube have distinctly different brightness values.”",
            min(b / a for a, b in pairwise(sorted(faces["a"]))) > 1.05,
            f"faces of the cube, the brightest 1: {_scaled(faces['a'])}",
            "each more than 5 % brighter than the next: steps of that size are seen",
        ),
        Claim(
            "(b) “The contrast between the three faces of the cube [is] reduced substantially.”",
            spread["b"] - 1.0 < 0.5 * (spread["a"] - 1.0),
            f"faces, the brightest 1: {_scaled(faces['a'])} (a), {_scaled(faces['b'])} (b)",
            "the brightest exceeds the darkest by less than half as much in (b)",
        ),
        Claim(
            "(b) “The contrast between the flat and curved sections of the cylindrical block” is reduced.",
            abs(math.log(edge["b"])) < abs(math.log(edge["a"])),
            f"top over the brightest of the side: {number(edge['a'])} (a), {number(edge['b'])} (b)",
            "nearer to 1 in (b)",
        ),
    ]


def _faces(c: Centre) -> list[float]:
    """Mean brightness of the three visible faces of the cube."""
    where = c.on("cube")
    normal = np.round(c.picture.normal[where], 6)
    faces, place = np.unique(normal, axis=0, return_inverse=True)
    count = np.bincount(place.reshape(-1))
    bright = np.bincount(place.reshape(-1), weights=c.grey()[where]) / count
    assert len(faces) == 3
    return [float(b) for b in bright]


def _shading(c: Centre, name: str) -> float:
    outside = c.on(name) & (c.cosine > 0.1) & (np.abs(c.picture.normal[..., 1]) < 0.99)
    bright = c.grey()[outside]
    bright = bright[bright > 0.0]
    return float(bright.std() / bright.mean())


def _flat_over_curved(c: Centre) -> float:
    where, up = c.on("cylinder"), c.picture.normal[..., 1] > 0.5
    return float(c.grey()[where & up].mean() / c.grey()[where & ~up].max())


def _scaled(values: list[float]) -> str:
    return ", ".join(number(v / max(values), 2) for v in sorted(values))
