"""What He, Torrance, Sillion and Greenberg say of Figs. 12 to 14, measured in the pictures."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from gonio_analysis.report.text import number
from gonio_scenes.scene import SceneFile

from gonio import materials
from gonio.config import load
from gonio.models import fresnel
from gonio.typing import Floats, TomlTable
from gonio_validation.papers.figure import Claim, agreed
from gonio_validation.papers.oren_nayar_samples import between
from gonio_validation.papers.pictures.catalogue import scene_file
from gonio_validation.papers.pictures.centre import Centre, Change, Mask, altogether, blurred, centre, edges, many

CYLINDERS = tuple(f"htsg-12{letter}" for letter in "abcde")
MIRROR = "htsg-13b"
ALUMINIUM = materials.ior("Al")
GRAZING = 0.35
"""Cosine of the viewing angle below which the sides of a cylinder count as its lateral edges: 70 degrees and more."""
UPRIGHT = 0.7
"""Cosine of the viewing angle above which they count as its front."""
FAINT = 1.0 / 255.0
"""Strength of a mirror image below which nobody sees edges in it: one step of an 8-bit picture."""
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


def _blue(name: str, light: TomlTable, height: int | None) -> float:
    """A lamp's highlight at the shortest over that at the longest wavelength, the metal divided out."""

    def alone(tables: TomlTable) -> None:
        tables["light"] = [light]
        tables["shape"] = tables["shape"][:1]  # the cylinder: the floor would shade it

    c = centre(name, height=height, change=alone)
    bright = np.where(_side(c, 0.0, 1.0), c.grey(), 0.0)
    index = ALUMINIUM(wavelength_nm=c.scene.wavelength_nm)
    mirror = np.abs((index - 1.0) / (index + 1.0)) ** 2
    seen = c.radiance[bright > 0.5 * bright.max()].mean(axis=0) / mirror
    return float(seen[0] / seen[-1])


IN_FRONT = {"kind": "directional", "toward": [-0.15, -0.17, 1.0], "irradiance": 1.0}
AT_THE_SIDE = {"kind": "directional", "toward": [0.90, -0.42, -0.25], "irradiance": 1.0}
"""Lamps whose light meets the cylinder where it is mirrored toward the camera at some 20 and at some 60 degrees."""


CAMERAS_MM = (850.0, 700.0, 1100.0)
"""Heights of the camera: that of the pictures, and two that see the tops at about 80 and 67 degrees."""


def _lit_as_12(tables: TomlTable) -> None:
    """The lights of Fig. 12 on the same surface, with which a mirror image is compared."""
    tables["light"] = load(SceneFile, scene_file("htsg-12a")).model_dump(exclude_none=True, exclude_unset=True)["light"]


def _from(height_mm: float) -> Change:
    def change(tables: TomlTable) -> None:
        at = tables["camera"]["position_mm"]
        tables["camera"]["position_mm"] = (at[0], height_mm, at[2])

    return change


@dataclass(frozen=True)
class _Images:
    """What one camera sees of the mirror images of Fig. 12."""

    strengths: list[float]
    """Strengths at 700 nm, (a) to (e); a perfect mirror's is 1."""
    correlations: list[float]
    """Correlations of their edges with a perfect mirror's, where the image is not faint."""
    of_blurred: float
    in_blue: float
    """Strength of (a) at 400 nm."""
    spikes: dict[str, float]


def _images(height: int | None, camera_mm: float) -> _Images:
    where = _from(camera_mm)
    taken = many(CYLINDERS, height, where)
    mirror = centre(MIRROR, height=height, change=altogether(where, _lit_as_12))
    red, blue = mirror.near(700.0), mirror.near(400.0)
    top = _top(mirror)
    wall = mirror.radiance[..., red]
    found = [edges(c.radiance[..., red], top, wall) for c in taken.values()]
    rough = taken["htsg-12a"]
    flat = centre("htsg-12a", height=height, change=altogether(where, _no_mirror))
    masks = {"top": top, "lateral": _side(rough, 0.0, GRAZING), "front": _side(rough, UPRIGHT, 1.0)}
    return _Images(
        [strength for strength, _ in found],
        [alike for strength, alike in found if strength > FAINT],
        edges(blurred(wall, top), top, wall)[1],
        edges(rough.radiance[..., blue], top, mirror.radiance[..., blue])[0],
        {place: float(np.median(_spike(rough, flat, mask)[1][:, red])) for place, mask in masks.items()},
    )


def _claims_of_colour(first: _Images, height: int | None) -> list[Claim]:
    """What the paper says of blue and red shifts."""
    blues = {
        words: [_blue(name, light, height) for name in CYLINDERS]
        for words, light in (("in front", IN_FRONT), ("behind, at the side", AT_THE_SIDE))
    }
    return [
        Claim(
            "“A slight color shift … is most apparent in the blue shift on the front faces.”",
            agreed(all(b > 1.0 for b in ratios) for ratios in blues.values()),
            "highlight at 400 over 700 nm, the metal divided out, for (a) to (e): "
            + "; ".join(f"lamp {words}: " + ", ".join(f"{r:.3f}" for r in ratios) for words, ratios in blues.items()),
            "more than 1 for every cylinder; hangs on where the lamp is, which the paper does not say",
        ),
        Claim(
            "“The enhanced red shift of the specular images is not so apparent.”",
            None,
            f"(a): strength of the image on the top {number(first.strengths[0])} at 700 nm, {number(first.in_blue)} at "
            "400 nm: the red shift is there",
            "how apparent it is hangs on the spectra of bricks and lamps, which were chosen here",
        ),
    ]


def figure_12(height: int | None = None) -> list[Claim]:
    """Six cylinders before a wall."""
    every = [_images(height, camera) for camera in CAMERAS_MM]
    first = every[0]
    spikes = first.spikes
    widths = [_width_deg(c) for c in many(CYLINDERS, height).values()]
    elsewhere = "with the camera of the pictures, a lower and a higher one: the paper does not say where it is"
    return [
        Claim(
            "“The sharp specular image in the top faces of the cylinders diminishes … with increasing surface "
            "roughness.”",
            agreed(all(b < 0.8 * a for a, b in pairwise(images.strengths)) for images in every),
            f"strength of the bricks' image at 700 nm, a perfect mirror's under the same lights 1: "
            f"{_each(first.strengths)} for (a) to (e); camera lower: {_each(every[1].strengths)}; higher: "
            f"{_each(every[2].strengths)}",
            f"each cylinder shows less than 0.8 of the one before, {elsewhere}",
        ),
        Claim(
            "The image “is not blurred”.",
            agreed(r > SHARP > images.of_blurred for images in every for r in images.correlations),
            "correlation of its edges with a perfect mirror's: "
            f"{min(r for images in every for r in images.correlations):.4f} and more where the image has more than "
            f"{FAINT:.2g} of a mirror's strength; blurred over three pixels: "
            f"{max(images.of_blurred for images in every):.2f} at most",
            f"more than {SHARP}, which an image blurred over three pixels has not, {elsewhere}",
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
            agreed(
                min(i.spikes["top"], i.spikes["lateral"]) > 10.0 * FAINT and abs(i.spikes["front"]) < FAINT
                for i in every
            ),
            f"(a): a mirror image at 700 nm has {number(spikes['top'])} of what it shows on the top, "
            f"{number(spikes['lateral'])} on the lateral edges (beyond 70°), {number(spikes['front'], 1)} on the front "
            f"(other cameras: top {between(i.spikes['top'] for i in every[1:])}, front "
            f"{between(i.spikes['front'] for i in every[1:])})",
            f"an image that is seen (above {10 * FAINT:.2g}) at the edges, and none (below {FAINT:.2g}) on the front, "
            f"{elsewhere}",
        ),
        *_claims_of_colour(first, height),
    ]


def figure_13(height: int | None = None) -> list[Claim]:
    """The three limits."""
    lobe, diffuse = (centre(n, height=height, change=_lamps_alone) for n in ("htsg-12f", "htsg-13c"))
    mirror = centre(MIRROR, height=height)
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
            "more than three times that of the matte cylinder; all without ambient light, as (b)",
        ),
        Claim(
            "“Note the striking differences between the three cylinders.”",
            peaks["b"] > 2.0 * peaks["a"] > 4.0 * peaks["c"],
            "highlight on the front over its median: " + ", ".join(f"{number(v)} ({k})" for k, v in peaks.items()),
            "each at least twice the next, in the order specular, directional diffuse, uniform diffuse; all without "
            "ambient light, as (b)",
        ),
    ]


def figure_14(height: int | None = None) -> list[Claim]:
    """Four materials."""
    c, flat = centre("htsg-14", height=height), centre("htsg-14", height=height, change=_no_mirror)
    cube = _spike(c, flat, c.on("cube"))
    k = c.near(550.0)
    off = float(np.max(np.abs(cube[1] / cube[2] - 1.0)))
    by = {}
    for index in PLASTICS:
        of = _of_index(index)
        pair = [centre("htsg-14", height=height, change=altogether(of, *more)) for more in ((), (_no_mirror,))]
        theta, carried, mirror = _spike(pair[0], pair[1], pair[0].on("table"), index)
        first, last = int(np.argmin(theta)), int(np.argmax(theta))
        rough = carried[:, k] / mirror[:, k]
        by[index] = float(rough[last] / rough[first]), float(mirror[last, k] / mirror[first, k])
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
            agreed(roughness > mirror > 1.0 for roughness, mirror in by.values()),
            f"from {np.degrees(theta.min()):.0f} to {np.degrees(theta.max()):.0f}° (550 nm), times as much: "
            + "; ".join(
                f"n = {n:g}: roughness lets {number(a)} through, |F|² reflects {number(b)}" for n, (a, b) in by.items()
            ),
            "the roughness factor changes more than |F|² does, over the same angles; for three indices, since the "
            "paper's is not known",
        ),
        Claim(
            "“In the rough metallic surfaces, the glossy highlights result from directional diffuse reflection.”",
            all(v > 3.0 for v in metal.values()),
            "highlight over the median: " + ", ".join(f"{number(v)} ({n})" for n, v in metal.items()),
            "at least 3: a highlight that stands out",
        ),
    ]


PLASTICS = (1.4, 1.5, 1.7)


def _of_index(index: float) -> Change:
    def change(tables: TomlTable) -> None:
        for name in ("cube", "table"):
            tables["material"][name]["parameters"]["ior"] = index

    return change


def _lamps_alone(tables: TomlTable) -> None:
    tables["light"] = [light for light in tables["light"] if light["kind"] != "ambient"]


def _no_mirror(tables: TomlTable) -> None:
    tables["mirror_depth"] = 0


def _step(c: Centre, where: Mask) -> float:
    """The largest step between neighbours in a row, over the mean radiance."""
    pairs = where[:, 1:] & where[:, :-1]
    return float(np.abs(np.diff(c.grey(), axis=1))[pairs].max() / c.grey()[where].mean())


def _spike(c: Centre, flat: Centre, where: Mask, index: float = 1.5) -> tuple[Floats, Floats, Floats]:
    """Viewing angles [rad], reflectivity of the spike from the radiances, and |F|² of the plastic, at some pixels.

    With no mirror ray the ambient radiance is seen in its place: the difference is the reflectivity times what the
    mirror shows beyond that. Only where it shows clearly more or less.
    """
    ambient = np.asarray(c.scene.ambient)
    beyond = c.mirrored(where) - ambient
    clear = (np.abs(beyond) > 0.2 * ambient).all(axis=1)
    carried = (c.radiance[where] - flat.radiance[where])[clear] / beyond[clear]
    cosine = c.cosine[where][clear]
    mirror = np.asarray(fresnel.reflectance(cosine, index))
    return np.arccos(cosine), carried, np.repeat(mirror[:, None], carried.shape[1], axis=1)


def _each(values: list[float], digits: int = 2, unit: str = "") -> str:
    return ", ".join(f"{number(v, digits)}{unit}" for v in values)
