"""What Cook and Torrance say of Figs. 6 to 8, measured in the pictures."""

import numpy as np
from gonio_analysis.report.text import number
from gonio_scenes.picture import tristimulus

from gonio import colour, materials
from gonio.typing import Floats, TomlTable
from gonio_validation.papers.figure import Claim, agreed
from gonio_validation.papers.oren_nayar_samples import between
from gonio_validation.papers.pictures.centre import Centre, Change, Mask, centre

METALS = {"copper": "Cu", "gold": "Au", "brass": "brass", "silver": "Ag", "iron": "Fe", "nickel": "Ni"}
NONMETALS = ("carbon", "rubber", "obsidian", "lunar-dust", "olive-drab", "rust")
LED_NM = 640.0


def _purity(c: Centre, where: Mask) -> tuple[float, float]:
    """Dominant wavelength [nm] and purity of the mean colour of some pixels, under D65."""
    xyz, _ = tristimulus(c.scene, c.radiance[where].mean(axis=0))
    wave, purity = colour.dominant_wavelength(colour.chromaticity(xyz))
    return float(wave), float(purity)


def _of_mirror(metal: str, c: Centre) -> tuple[float, float]:
    """The same of a flat mirror of a metal at normal incidence."""
    wave = c.scene.wavelength_nm
    index = materials.ior(metal)(wavelength_nm=wave)
    xyz = colour.xyz(np.abs((index - 1.0) / (index + 1.0)) ** 2, wave)
    dominant, purity = colour.dominant_wavelength(colour.chromaticity(xyz))
    return float(dominant), float(purity)


def _luminance(c: Centre) -> Floats:
    xyz, _ = tristimulus(c.scene, c.radiance)
    return np.asarray(xyz[..., 1])


def _brightest(c: Centre, where: Mask) -> Mask:
    """The brightest hundredth of some pixels."""
    y = _luminance(c)
    return np.asarray(where & (y >= np.quantile(y[where], 0.99)))


def _body(c: Centre, where: Mask) -> Mask:
    """Pixels about the median brightness."""
    y = _luminance(c)
    low, high = np.quantile(y[where], (0.4, 0.6))
    return np.asarray(where & (y >= low) & (y <= high))


GRAZING = (164.0, 168.0, 172.0)
"""Angles of a light nearly behind the vase to the line of sight [deg]: facets mirror it at half of them."""


def _edge_lit(angle_deg: float) -> Change:
    """One light nearly behind the vase."""

    def change(tables: TomlTable) -> None:
        camera = tables["camera"]
        view = np.subtract(camera["position_mm"], camera["look_at_mm"])
        view = view / np.linalg.norm(view)
        angle = np.radians(angle_deg)
        toward = np.cos(angle) * view + np.sin(angle) * np.array([1.0, 0.0, 0.0])
        tables["light"] = [tables["light"][0] | {"toward": toward.tolist()}]

    return change


def ambient_as_printed(height: int | None = None) -> float:
    """Ambient light of 0.01 I_i, over what lights of d omega = 0.0001 and 0.0002 give; the median of Fig. 6 (a)."""

    def dark(tables: TomlTable) -> None:
        tables["light"] = [light for light in tables["light"] if light["kind"] != "ambient"]

    c, lit = centre("cook-torrance-6a", height=height), centre("cook-torrance-6a", height=height, change=dark)
    where = c.on("vase")
    direct = _luminance(lit)[where]
    ambient = _luminance(c)[where] - direct
    assert c.scene.ambient is not None
    irradiance = np.asarray(c.scene.lights[1].power)  # of d omega = 0.0001
    printed = 0.01 * irradiance[0] / 1e-4 / c.scene.ambient[0]
    return float(np.median(ambient[direct > 0.0] * printed / direct[direct > 0.0]))


def figure_6(height: int | None = None) -> list[Claim]:
    """Plastic and copper."""
    plastic, metal = (centre(f"cook-torrance-6{k}", height=height) for k in "ab")
    of_body, of_highlight = (_purity(plastic, f(plastic, plastic.on("vase"))) for f in (_body, _brightest))
    copper = _purity(metal, _brightest(metal, metal.on("vase")))
    mirror = _of_mirror("Cu", metal)
    grazing = {}
    for angle in GRAZING:
        edge = centre("cook-torrance-6b", height=height, change=_edge_lit(angle))
        grazing[angle] = _purity(edge, edge.on("vase") & (_luminance(edge) > 0.0))[1]
    return [
        Claim(
            "(a) A plastic has “a colored diffuse component and a white specular component”.",
            of_highlight[1] < 0.9 * of_body[1],
            f"purity {number(of_highlight[1], 2)} in the highlight, {number(of_body[1], 2)} on the body; dominant "
            f"wavelengths {of_highlight[0]:.0f} and {of_body[0]:.0f} nm",
            "the highlight is less pure than the body, by a tenth at least",
        ),
        Claim(
            "(b) “The specular reflectance component has a copper color.”",
            abs(copper[1] / mirror[1] - 1.0) < 0.1 and abs(copper[0] - mirror[0]) < 2.0,
            f"highlight: {copper[0]:.1f} nm, purity {number(copper[1], 2)}; a flat copper mirror: {mirror[0]:.1f} nm, "
            f"{number(mirror[1], 2)}",
            "the mirror's purity to a tenth, its dominant wavelength to 2 nm: the incidence is not quite normal",
        ),
        Claim(
            "“The Fresnel equation predicts a color shift of the specular component at grazing angles”, toward the "
            "color of the light source.",
            agreed(purity < 0.9 * copper[1] for purity in grazing.values()),
            "purity of the vase lit from behind: "
            + ", ".join(f"{number(purity, 2)} (facets at about {a / 2:g}°)" for a, purity in grazing.items())
            + f"; lit as in (b): {number(copper[1], 2)}",
            "less pure than the highlights of (b) by a tenth at least, at each of these angles",
        ),
    ]


def figure_7(height: int | None = None) -> list[Claim]:
    """Twelve vases."""
    c = centre("cook-torrance-7", height=height)
    coloured = {}
    for name in ("copper", "gold", "brass"):
        coloured[name] = (_purity(c, _brightest(c, c.on(name)))[1], _of_mirror(METALS[name], c)[1])
    y = _luminance(c)
    shine = {}
    for name in (*METALS, *NONMETALS):
        bright = y[c.on(name)]
        shine[name] = float(np.quantile(bright, 0.995) / np.median(bright))
    matte = {name: shine[name] for name in NONMETALS}
    grey = centre("cook-torrance-7", height=height, change=_grey)
    y = _luminance(grey)
    other = {n: float(np.quantile(y[grey.on(n)], 0.995) / np.median(y[grey.on(n)])) for n in NONMETALS}
    return [
        Claim(
            "“The specular component is usually the color of the material, not the color of the light source.”",
            all(abs(seen / mirror - 1.0) < 0.1 for seen, mirror in coloured.values()),
            "purity of the highlight, and of a flat mirror: "
            + ", ".join(f"{name} {number(a, 2)}, {number(b, 2)}" for name, (a, b) in coloured.items()),
            "equal to a tenth, for the coloured metals",
        ),
        Claim(
            "Table I: obsidian has the largest s and the smallest m, lunar dust no specular component.",
            agreed(
                (max(s, key=s.__getitem__), min(s, key=s.__getitem__)) == ("obsidian", "lunar-dust")
                for s in (matte, other)
            ),
            "highlight over the median brightness: "
            + ", ".join(f"{n} {number(v, 2)} ({number(other[n], 2)} with the same grey F_0)" for n, v in matte.items()),
            "of the six, the highlight stands out most on obsidian, and least on lunar dust; with the spectra that "
            "were chosen here, and with F_0 = 0.05 for all",
        ),
        Claim(
            "Vases of metal do not have “the plastic appearance”: “the entire diffuse component disappears”.",
            agreed(min(shine[n] for n in METALS) > s[n] for s in (matte, other) for n in NONMETALS if n != "obsidian"),
            "highlight over the median brightness of the metals: "
            + ", ".join(f"{n} {number(shine[n], 2)}" for n in METALS),
            "each stands out more than on every nonmetal but obsidian, which has little diffuse light either",
        ),
    ]


def _grey(tables: TomlTable) -> None:
    """The nonmetals of Fig. 7 with one F_0, in place of the spectra that are not the paper's."""
    for name in NONMETALS:
        material = tables["material"][name]
        material["ambient_reflectance"] = 0.05
        material["parameters"] |= {key: 0.05 for key in ("f0", "diffuse_albedo") if key in material["parameters"]}


SLOPES = ((0.1, 0.2), (0.2, 0.3), (0.3, 0.6))
"""Slopes for the borders and interiors of the links, tried beside those of the picture."""


def _slopes(border: float, interior: float) -> Change:
    def change(tables: TomlTable) -> None:
        tables["material"]["gold"]["parameters"]["slopes"] = border
        tables["material"]["gold-rough"]["parameters"]["slopes"] = interior

    return change


def _pattern(c: Centre) -> float:
    """Mean brightness of the links' interiors over that of their borders."""
    y = _luminance(c)
    return float(y[c.on("pattern")].mean() / y[c.on("outer link")].mean())


def figure_8(height: int | None = None) -> list[Claim]:
    """A watch."""
    c = centre("cook-torrance-8", height=height)
    gold, steel = _purity(c, c.on("outer link")), _purity(c, c.on("inner link"))
    led = _purity(c, c.on(*(str(table.name) for table in c.scene.tables.shape if table.material == "led")))
    others = (centre("cook-torrance-8", height=height, change=_slopes(*pair)) for pair in SLOPES)
    ratios = [_pattern(each) for each in (c, *others)]
    return [
        Claim(
            "“The outer band of the watch is made of gold, and the inner band is made of stainless steel.”",
            570.0 < gold[0] < 585.0 and gold[1] > 3.0 * steel[1],
            f"outer links {gold[0]:.0f} nm, purity {number(gold[1], 2)}; inner links {steel[0]:.0f} nm, purity "
            f"{number(steel[1], 2)}",
            "yellow (570 to 585 nm), and steel less than a third as pure",
        ),
        Claim(
            "“The pattern on the links of the outer band was made by using a rougher surface for the interior than for "
            "the border.”",
            agreed(abs(np.log(ratio)) > np.log(1.1) for ratio in ratios),
            f"mean brightness of the interiors over that of the borders: {between(ratios)}",
            "different by more than a tenth: a pattern is seen; for four pairs of slopes, since the paper's are not "
            "known",
        ),
        Claim(
            "The diodes are “standard red 640 nanometer LEDs”, approximated by “a color with the same dominant "
            "wavelength”.",
            None,
            f"dominant wavelength of the diodes in the picture: {led[0]:.1f} nm, of {LED_NM:g} nm",
            "the diodes' spectrum was chosen here, to have that wavelength",
        ),
    ]
