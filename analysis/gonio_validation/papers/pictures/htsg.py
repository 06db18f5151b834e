"""What He, Torrance, Sillion and Greenberg say of Figs. 12 to 14, measured in the pictures."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from gonio_analysis.report.text import number

from gonio import materials
from gonio.models import fresnel
from gonio.typing import Floats
from gonio_validation.papers.figure import Claim, agreed
from gonio_validation.papers.pictures.centre import Centre, Mask, blurred, centre, edges, many

CYLINDERS = tuple(f"htsg-12{letter}" for letter in "abcde")
MIRROR = "htsg-13b"
ALUMINIUM = materials.ior("Al")
GRAZING = 0.35
"""Cosine of the viewing angle below which the sides of a cylinder count as its lateral edges: 70 degrees and more."""
UPRIGHT = 0.7
"""Cosine of the viewing angle above which they count as its front."""
FAINT = 1e-3
"""Strength of a mirror image below which nobody looks for edges in it: steps of an 8-bit picture are 4e-3."""
SHARP = 0.95
"""Correlation of a mirror image's edges with those of a perfect mirror; blurred over 3 pixels they have less."""


def _top(c: Centre) -> Mask:
    return c.on("cylinder") & (c.picture.normal[..., 1] > 0.5)


def _side(c: Centre, low: float, high: float) -> Mask:
    return c.on("cylinder") & (c.picture.normal[..., 1] < 0.5) & (c.cosine > low) & (c.cosine <= high)


def _width_deg(c: Centre) -> float:
    """Full width at half height of the highlight on the front, as azimuth of the cylinder's normal [deg]."""
    height = c.picture.position[..., 1]
    belt = _side(c, 0.0, 1.0) & (np.abs(height - 210.0) < 60.0)
    azimuth = np.degrees(np.arctan2(c.picture.normal[..., 0], c.picture.normal[..., 2]))[belt]
    bright = c.grey()[belt]
    steps = np.arange(-85.0, 86.0, 2.5)
    number_of = np.digitize(azimuth, steps)
    count = np.bincount(number_of, minlength=steps.size)[1 : steps.size]
    total = np.bincount(number_of, weights=bright, minlength=steps.size)[1 : steps.size]
    profile = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    at = 0.5 * (steps[1:] + steps[:-1])
    known = np.isfinite(profile)
    fine = np.arange(at[known][0], at[known][-1], 0.1)
    profile = np.interp(fine, at[known], profile[known])
    lifted = profile - profile.min()
    peak = int(np.argmax(lifted))
    low = np.flatnonzero(lifted[:peak] < 0.5 * lifted[peak])
    high = np.flatnonzero(lifted[peak:] < 0.5 * lifted[peak])
    first = low[-1] if low.size else 0
    last = peak + high[0] if high.size else fine.size - 1
    return float(fine[last] - fine[first])


def _blue(name: str, light: dict[str, Any], height: int | None) -> float:
    """A lamp's highlight at the shortest over that at the longest wavelength, the metal divided out."""

    def alone(tables: dict[str, Any]) -> None:
        tables["light"] = [light]
        tables["shape"] = tables["shape"][:1]  # the cylinder: the floor would shade it

    c = centre(name, height=height, change=alone)
    bright = np.where(_side(c, 0.0, 1.0), c.grey(), 0.0)
    waves = c.scene.wavelength_nm
    index = ALUMINIUM(wavelength_nm=waves)
    mirror = np.abs((index - 1.0) / (index + 1.0)) ** 2
    seen = c.radiance[bright > 0.5 * bright.max()].mean(axis=0) / mirror
    return float(seen[0] / seen[-1])


IN_FRONT = {"kind": "directional", "toward": [-0.15, -0.17, 1.0], "irradiance": 1.0}
AT_THE_SIDE = {"kind": "directional", "toward": [0.90, -0.42, -0.25], "irradiance": 1.0}
"""Lamps whose light meets the cylinder where it is mirrored toward the camera at some 20 and at some 60 degrees."""


def figure_12(height: int | None = None) -> list[Claim]:
    """Six cylinders before a wall."""
    taken, mirror = many(CYLINDERS, height), centre(MIRROR, height=height)
    red = mirror.near(700.0)
    blue = mirror.near(400.0)
    top = _top(mirror)
    wall = mirror.radiance[..., red]
    found = [edges(c.radiance[..., red], top, wall) for c in taken.values()]
    strengths = [strength for strength, _ in found]
    seen = [(s, r) for s, r in found if s > FAINT]
    _, of_blurred = edges(blurred(wall, top), top, wall)
    widths = [_width_deg(c) for c in taken.values()]
    rough = taken["htsg-12a"]
    flat = centre("htsg-12a", height=height, change=_no_mirror)
    spikes = {
        where: float(np.median(_spike(rough, flat, mask)[1][:, red]))
        for where, mask in (
            ("top", top),
            ("lateral", _side(rough, 0.0, GRAZING)),
            ("front", _side(rough, UPRIGHT, 1.0)),
        )
    }
    blues = {
        words: [_blue(name, light, height) for name in CYLINDERS]
        for words, light in (("in front", IN_FRONT), ("behind, at the side", AT_THE_SIDE))
    }
    in_blue = edges(rough.radiance[..., blue], top, mirror.radiance[..., blue])[0]
    return [
        Claim(
            "“The sharp specular image in the top faces of the cylinders diminishes … with increasing surface "
            "roughness.”",
            all(b < 0.5 * a for a, b in pairwise(strengths)),
            f"strength of the bricks' image at 700 nm, a perfect mirror's 1: {_each(strengths)} for (a) to (e)",
            "each cylinder shows less than half of the one before: clearly less to the eye",
        ),
        Claim(
            "The image “is not blurred”.",
            all(r > SHARP > of_blurred for _, r in seen) if seen else None,
            f"correlation of its edges with a perfect mirror's: {', '.join(f'{r:.4f}' for _, r in seen)} where the "
            f"image has more than {FAINT:g} of a mirror's strength; blurred over three pixels: {of_blurred:.2f}",
            f"more than {SHARP}, which an image blurred over three pixels has not",
        ),
        Claim(
            "“The image of the light source on the front vertical face spreads out.”",
            all(b > a for a, b in pairwise(widths)),
            f"full width at half height, as azimuth on the cylinder: {_each(widths, 3, '°')} for (a) to (e)",
            "each is wider than the one before",
        ),
        Claim(
            "“The top and lateral edges can appear specular or nearly specular at grazing angles, even when the "
            "vertical face on the front side appears to be rough.”",
            min(spikes["top"], spikes["lateral"]) > 10.0 * FAINT and abs(spikes["front"]) < FAINT,
            f"(a): a mirror image at 700 nm has {number(spikes['top'])} of what it shows on the top, "
            f"{number(spikes['lateral'])} on the lateral edges (beyond 70°), {number(spikes['front'], 1)} on the front",
            f"an image that is seen (above {10 * FAINT:g}) at the edges, and none (below {FAINT:g}) on the front",
        ),
        Claim(
            "“A slight color shift … is most apparent in the blue shift on the front faces.”",
            agreed(all(b > 1.0 for b in ratios) for ratios in blues.values()),
            "highlight at 400 over 700 nm, the metal divided out, for (a) to (e): "
            + "; ".join(f"lamp {words}: " + ", ".join(f"{r:.3f}" for r in ratios) for words, ratios in blues.items()),
            "more than 1 for every cylinder; hangs on where the lamp is, which the paper does not say",
        ),
        Claim(
            "“The enhanced red shift of the specular images is not so apparent.”",
            strengths[0] > in_blue,
            f"(a): strength of the image on the top {number(strengths[0])} at 700 nm, {number(in_blue)} at 400 nm",
            "stronger at 700 than at 400 nm; how apparent it is is not measured",
        ),
    ]


def figure_13(height: int | None = None) -> list[Claim]:
    """The three limits."""
    lobe, mirror, diffuse = (centre(n, height=height) for n in ("htsg-12f", MIRROR, "htsg-13c"))
    top = _top(mirror)
    there = top & (mirror.radiance[..., 0] > 0.0)
    wave = mirror.scene.wavelength_nm
    seen = mirror.radiance[there] / mirror.mirrored(there)
    expected = np.stack([fresnel.reflectance(mirror.cosine[there], i) for i in ALUMINIUM(wavelength_nm=wave)], axis=1)
    off = float(np.max(np.abs(seen / expected - 1.0)))
    places = {"top": top, "lateral edges": _side(mirror, 0.0, GRAZING)}
    steps = {words: (_step(mirror, where), _step(diffuse, where)) for words, where in places.items()}
    peaks = {}
    for letter, c in (("a", lobe), ("b", mirror), ("c", diffuse)):
        front = c.grey()[_side(c, UPRIGHT, 1.0)]
        peaks[letter] = float(front.max() / np.median(front))
    return [
        Claim(
            "(b): “the reflectance is a function of incidence angle according to the Fresnel reflectivity”.",
            off < 1e-6,
            f"radiance of the top over what its mirror rays see, against |F|²: equal to {number(max(off, 1e-16), 1)}",
            "equal to 1e-6 at every pixel and wavelength",
        ),
        Claim(
            "(b): “Specular images are apparent on the top and lateral edges.”",
            all(image > 3.0 * matte for image, matte in steps.values()),
            "largest step between neighbours in a row, over the mean: "
            + ", ".join(f"{words} {number(a)}, on the matte (c) {number(b)}" for words, (a, b) in steps.items()),
            "more than three times that of the matte cylinder",
        ),
        Claim(
            "“Note the striking differences between the three cylinders.”",
            peaks["b"] > 2.0 * peaks["a"] > 4.0 * peaks["c"],
            "highlight on the front over its median: " + ", ".join(f"{number(v)} ({k})" for k, v in peaks.items()),
            "each at least twice the next, in the order specular, directional diffuse, uniform diffuse",
        ),
    ]


def figure_14(height: int | None = None) -> list[Claim]:
    """Four materials."""
    c, flat = centre("htsg-14", height=height), centre("htsg-14", height=height, change=_no_mirror)
    cube, table = (_spike(c, flat, c.on(name)) for name in ("cube", "table"))
    k = c.near(550.0)
    off = float(np.max(np.abs(cube[1] / cube[2] - 1.0)))
    theta, carried, mirror = table
    rough = carried[:, k] / mirror[:, k]
    first, last = int(np.argmin(theta)), int(np.argmax(theta))
    by_roughness, by_fresnel = float(rough[last] / rough[first]), float(mirror[last, k] / mirror[first, k])
    metal = {}
    for name in ("cylinder", "sphere"):
        bright = c.grey()[c.on(name)]
        metal[name] = float(bright.max() / np.median(bright))
    return [
        Claim(
            "“On the faces of the cube, the specular image varies with reflection angle, an effect caused solely by "
            "the Fresnel reflectivity.”",
            # mirror rays start 1e-6 mm off the surface here, and differences of radiances are taken
            off < 1e-3,
            f"mirror images over what they show, against |F|²: equal to {number(max(off, 1e-16), 1)} over angles from "
            f"{np.degrees(cube[0].min()):.0f} to {np.degrees(cube[0].max()):.0f}°; |F|² from "
            f"{number(float(cube[2].min()))} to {number(float(cube[2].max()))}",
            "equal to 1e-3 at every pixel and wavelength",
        ),
        Claim(
            "“The specular images on the table top also vary with reflection angle (and disappear), but this is caused "
            "mainly by roughness effects.”",
            by_roughness > by_fresnel > 1.0,
            f"from {np.degrees(theta[first]):.0f} to {np.degrees(theta[last]):.0f}° roughness lets "
            f"{number(by_roughness)} times as much through, |F|² reflects {number(by_fresnel)} times as much (550 nm)",
            "the roughness factor changes more than |F|² does, over the same angles",
        ),
        Claim(
            "“In the rough metallic surfaces, the glossy highlights result from directional diffuse reflection.”",
            all(v > 3.0 for v in metal.values()),
            "highlight over the median: " + ", ".join(f"{number(v)} ({n})" for n, v in metal.items()),
            "at least 3: a highlight that stands out",
        ),
    ]


def _no_mirror(tables: dict[str, Any]) -> None:
    tables["mirror_depth"] = 0


def _step(c: Centre, where: Mask) -> float:
    """The largest step between neighbours in a row, over the mean radiance."""
    pairs = where[:, 1:] & where[:, :-1]
    return float(np.abs(np.diff(c.grey(), axis=1))[pairs].max() / c.grey()[where].mean())


def _spike(c: Centre, flat: Centre, where: Mask) -> tuple[Floats, Floats, Floats]:
    """Viewing angles [rad], reflectivity of the spike from the radiances, and |F|² of the plastic, at some pixels.

    With no mirror ray the ambient radiance is seen in its place: the difference is the reflectivity times what the
    mirror shows beyond that. Only where it shows clearly more or less.
    """
    ambient = np.asarray(c.scene.ambient)
    beyond = c.mirrored(where) - ambient
    clear = (np.abs(beyond) > 0.2 * ambient).all(axis=1)
    carried = (c.radiance[where] - flat.radiance[where])[clear] / beyond[clear]
    cosine = c.cosine[where][clear]
    mirror = np.asarray(fresnel.reflectance(cosine, 1.5))
    return np.arccos(cosine), carried, np.repeat(mirror[:, None], carried.shape[1], axis=1)


def _each(values: list[float], digits: int = 2, unit: str = "") -> str:
    return ", ".join(f"{number(v, digits)}{unit}" for v in values)
