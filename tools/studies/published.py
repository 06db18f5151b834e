"""Published fits of others (`*.fit`): their parameters in our names and units, their widths and their energy.

A line is one material: `name = Aggregate(Lambertian(albedo = [r, g, b]), NganHe(albedo = [r, g, b], roughness = ...))`.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gonio_analysis.report.blocks import MOST_ROWS, Block, Figures, Heading, Paragraph, table
from gonio_analysis.report.drawing import Figure, rendered
from gonio_analysis.report.text import percent

from gonio.errors import ArgumentError, DataError
from gonio.models import CookTorrance, Lambert, Model, Sum, examine
from tools.studies.campaigns import Record

LINE = re.compile(
    r"(?P<name>\S+)\s*=\s*Aggregate\(\s*Lambertian\(\s*albedo\s*=\s*\[(?P<base>[^]]*)\]\s*\)\s*,"
    r"\s*(?P<kind>\w+)\(\s*albedo\s*=\s*\[(?P<gloss>[^]]*)\](?P<rest>[^()]*)\)\s*\)"
)
NUMBERS = {
    "NganCookTorrance": ("eta", "roughness"),
    "NganHe": ("autocorrelation", "roughness", "eta"),
    "NganBlinnPhong": ("sharpness",),
    "LowCookTorrance": ("roughness", "eta"),
}
"""The numbers of each form that is read."""
LISTS = {"Ngan": (1.0, 1.15, 1.66), "Low": (1.0, 1.0, 1.0)}
"""Factors of red, green and blue to BRDFs [1/sr]: Ngan's colours are in MERL's raw units."""
WAVELENGTH_UM, LARGE_G = 0.55, 18.0
"""Wavelength at which g is stated; and the g above which the series is the lobe of facets with m = 2 sigma/tau."""


@dataclass(frozen=True)
class Fit:
    """One line of a file."""

    name: str
    kind: str
    base: tuple[float, ...]
    gloss: tuple[float, ...]
    """Factors of the two parts in red, green and blue, as published."""
    numbers: Mapping[str, float]

    @property
    def listed(self) -> str:
        """Whose it is: "Ngan" or "Low"."""
        return next(who for who in LISTS if self.kind.startswith(who))

    @property
    def width(self) -> float:
        """m, the rms slope: of He 2 sigma/tau, which has no unit; of Blinn and Phong that of (N.H)^n near its peak."""
        if self.kind == "NganHe":
            return 2.0 * self.numbers["roughness"] / self.numbers["autocorrelation"]
        if self.kind == "NganBlinnPhong":
            return math.sqrt(2.0 / self.numbers["sharpness"])
        return self.numbers["roughness"]

    @property
    def g(self) -> float:
        """(4 pi sigma/lambda)^2 of He's fits at normal incidence, with sigma in um."""
        return (4.0 * math.pi * self.numbers["roughness"] / WAVELENGTH_UM) ** 2

    def model(self, colour: int) -> Model | None:
        """In our models, for a colour; None where the conversion is not certain."""
        scale, n = LISTS[self.listed][colour], self.numbers
        if self.kind == "NganCookTorrance":  # Schlick's F with F_0 = eta, and a further 1/pi in D
            lobe, weight = CookTorrance(slopes=n["roughness"], f0=n["eta"], fresnel="schlick"), 1.0 / math.pi
        elif self.kind == "LowCookTorrance":
            lobe, weight = CookTorrance(slopes=n["roughness"], ior=n["eta"]), 1.0
        else:
            return None
        return Sum((Lambert(scale * self.base[colour]), 1.0), (lobe, weight * scale * self.gloss[colour]))

    def record(self) -> Record:
        """In our names and units."""
        scale, n = LISTS[self.listed], self.numbers
        base = [s * x for s, x in zip(scale, self.base, strict=True)]
        gloss = [s * x for s, x in zip(scale, self.gloss, strict=True)]
        if self.kind == "NganHe":
            return {
                "diffuse_albedo": base, "factor_as_published": gloss, "slope_m": self.width, "ior": n["eta"],
                "sigma0_um_if_um": n["roughness"], "tau_um_if_um": n["autocorrelation"],
                "g_at_550_nm_if_um": self.g,
            }  # fmt: skip
        if self.kind == "NganBlinnPhong":
            return {"diffuse_albedo": base, "albedo_as_published": gloss, "exponent": n["sharpness"], "m": self.width}
        ngan = self.kind == "NganCookTorrance"
        weight = [x / math.pi for x in gloss] if ngan else gloss
        form = {"f0": n["eta"], "fresnel": "schlick"} if ngan else {"ior": n["eta"], "fresnel": "exact"}
        pairs = list(zip(base, weight, strict=True))
        bright = [k for k, (x, y) in enumerate(pairs) if not any(u > x and v > y for u, v in pairs)]
        found = max((examine(model) for k in bright if (model := self.model(k))), key=lambda e: e.reflected)
        return {
            "diffuse_albedo": base, "weight": weight, "m": n["roughness"], **form,
            "reflected": found.reflected, "at_deg": found.at_deg,
        }  # fmt: skip


def read(path: Path) -> list[Fit]:
    """The fits of a file; empty lines and those that begin with # say nothing.

    Raises
    ------
    DataError
        A line is none, with its number.
    """
    found: dict[tuple[str, str], Fit] = {}
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from None
    for number, line in enumerate(lines, 1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                fit = _fit(line.strip())
                if (fit.name, fit.kind) in found:
                    raise ArgumentError(f'"{fit.name}" stands there twice')
            except ArgumentError as error:
                raise DataError(f"{path}: line {number}: {error}") from None
            found[fit.name, fit.kind] = fit
    return list(found.values())


def _fit(line: str) -> Fit:
    match = LINE.fullmatch(line)
    if match is None:
        raise ArgumentError(
            "must read NAME = Aggregate(Lambertian(albedo = [r, g, b]), FORM(albedo = [r, g, b], NUMBER = ..., ...))"
        )
    kind = match["kind"]
    if kind not in NUMBERS:
        raise ArgumentError(f'the form "{kind}" is not known; known: {", ".join(NUMBERS)}')
    pairs = [part.partition("=") for part in match["rest"].split(",") if part.strip()]
    given = {key.strip(): _number(key.strip(), text) for key, _, text in pairs}
    if len(pairs) != len(NUMBERS[kind]) or set(given) != set(NUMBERS[kind]):
        raise ArgumentError(f"{kind} takes {', '.join(NUMBERS[kind])} beside its albedo, each once")
    for name in set(given) - {"eta"}:
        if given[name] == 0.0:
            raise ArgumentError(f"{name} = 0: must be above 0")
    base, gloss = (tuple(_number("albedo", text) for text in match[key].split(",")) for key in ("base", "gloss"))
    if len(base) != 3 or len(gloss) != 3:
        raise ArgumentError("albedo: must be three numbers, of red, green and blue")
    fit = Fit(match["name"], kind, base, gloss, given)
    for colour in range(3):
        fit.model(colour)  # which raises for what is out of range
    return fit


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0.0):
        raise ArgumentError(f"{name} = {text.strip()}: must be a number of at least 0")
    return value


def judged(fits: Sequence[Fit]) -> Record:
    """One record a material of each list, and what can be said of all without measurements."""
    materials: dict[tuple[str, str], Record] = {}
    for fit in fits:
        own = materials.setdefault((fit.listed, fit.name), {"name": fit.name, "list": fit.listed, "fits": {}})
        own["fits"][fit.kind] = fit.record()
    he = [m["fits"]["NganHe"] for m in materials.values() if "NganHe" in m["fits"]]
    energy = {}
    for kind in ("NganCookTorrance", "LowCookTorrance"):
        shares = [m["fits"][kind]["reflected"] for m in materials.values() if kind in m["fits"]]
        if shares:
            energy[kind] = {"fits": len(shares), "above_1": sum(x > 1.001 for x in shares), "largest": max(shares)}
    return {
        "materials": list(materials.values()),
        "he_fits": len(he),
        "he_with_g_above_18": sum(one["g_at_550_nm_if_um"] > LARGE_G for one in he),
        "he_with_level_uncertain_by_a_tenth": sum(one["ior"] < 1.1 for one in he),
        "widths": _widths(fits),
        "energy": energy,
    }


def _widths(fits: Sequence[Fit]) -> list[Record]:
    """How the widths of two families agree, over the materials that both have."""
    from scipy.stats import spearmanr

    by_kind = {kind: {f.name: f.width for f in fits if f.kind == kind} for kind in NUMBERS}
    of_facets = f"NganHe, g above {LARGE_G:g}"
    by_kind[of_facets] = {f.name: f.width for f in fits if f.kind == "NganHe" and f.g > LARGE_G}
    rows: list[Record] = []
    for kind in ("NganHe", of_facets, "NganBlinnPhong", "LowCookTorrance"):
        own, other = by_kind[kind], by_kind["NganCookTorrance"]
        both = [name for name in own if name in other]
        if len(both) >= 3:
            ratio = np.array([own[n] / other[n] for n in both])
            rank = float(spearmanr([own[n] for n in both], [other[n] for n in both]).statistic)
            low, middle, high = np.quantile(ratio, [0.25, 0.5, 0.75]).tolist()
            rows.append({
                "of": kind, "over": "NganCookTorrance", "materials": len(both), "rank_correlation": rank,
                "ratio": middle, "quartiles": [low, high],
            })  # fmt: skip
    return rows


def picture(fits: Sequence[Fit]) -> Figure:
    """The width of every family against that of Ngan's Cook-Torrance."""
    reference = {f.name: f.width for f in fits if f.kind == "NganCookTorrance"}

    def on(figure: Any) -> None:
        figure.set_layout_engine("constrained")
        ax = figure.add_subplot()
        for kind, marker, label in (
            ("NganHe", "o", "He-Torrance, 2 sigma/tau"),
            ("NganBlinnPhong", "^", "Blinn-Phong, sqrt(2/n)"),
            ("LowCookTorrance", "s", "Low's Cook-Torrance"),
        ):
            points = [(reference[f.name], f.width) for f in fits if f.kind == kind and f.name in reference]
            if points:
                ax.loglog(*zip(*points, strict=True), marker, ms=4, mfc="none", label=label)
        ends = [min(reference.values(), default=1e-3), max(reference.values(), default=1.0)]
        ax.plot(ends, ends, color="0.6", lw=0.8)
        ax.set_xlabel("rms slope m of Ngan's Cook-Torrance")
        ax.set_ylabel("rms slope m of the other fit")
        ax.legend(fontsize=8)

    said = "Widths of the published fits of a material by several families; on the line they agree."
    return rendered("published_widths", "materials", "", said, said, (6.0, 4.6), on)


def section(found: Record, drawn: Sequence[Figure]) -> list[Block]:
    """What the page says of them."""
    said = "Parameters in our names and units are in results.json. Ngan's colours are scaled by 1, 1.15 and 1.66."
    if found["he_fits"]:
        share = percent(found["he_with_g_above_18"] / found["he_fits"])
        said += (
            f" The unit of He's lengths is not published. In micrometres g at normal incidence and 550 nm is above"
            f" {LARGE_G:g} for {found['he_with_g_above_18']} of {found['he_fits']} ({share}): only m = 2 sigma/tau is"
            f" observable there. Of {found['he_with_level_uncertain_by_a_tenth']} the index is below 1.1, so that its"
            " printed digits leave the level open by a tenth and more."
        )
    for kind, one in found["energy"].items():
        said += f" As our models {one['above_1']} of {one['fits']} {kind} reflect more than they receive, up to"
        said += f" {one['largest']:.3g} times."
    agree = [
        [str(w["of"]), str(w["materials"]), f"{w['rank_correlation']:.2f}", f"{w['ratio']:.2f}",
         "{:.2f} to {:.2f}".format(*w["quartiles"])]
        for w in found["widths"]
    ]  # fmt: skip
    result = f"{len(found['materials'])} materials of both lists"
    blocks: list[Block] = [Heading(3, "Published fits", result), Paragraph(said), Figures(tuple(drawn))]
    if agree:
        blocks.append(table("Widths over those of Ngan's Cook-Torrance.", [
            "fits", "materials", "rank correlation", "median ratio", "quartiles"], agree, right=(1, 2, 3)))  # fmt: skip
    rows = [_row(m) for m in found["materials"]]
    names = ["material", "list", "m", "F_0 or n", "reflects at most", "m of He", "g", "n of Blinn-Phong"]
    return [*blocks, table("", names, rows, right=(2, 3, 4, 5, 6, 7), most=(MOST_ROWS, "results.json"))]


def _row(material: Record) -> list[str]:
    fits = material["fits"]
    facets = fits.get("NganCookTorrance") or fits.get("LowCookTorrance") or {}
    he, phong = fits.get("NganHe", {}), fits.get("NganBlinnPhong", {})
    shown = (
        facets.get("m"), facets.get("f0", facets.get("ior")), facets.get("reflected"), he.get("slope_m"),
        he.get("g_at_550_nm_if_um"), phong.get("exponent"),
    )  # fmt: skip
    return [material["name"], material["list"], *("–" if x is None else f"{x:.3g}" for x in shown)]
