"""Surface scattering distribution data (`.ssdd`) of libbsdf and BSDF Processor, version 0.x.

A file has up to four blocks. Lines of text say what a block is: DATA_TYPE, COLOR_MODEL, WAVELENGTH_LIST [nm],
PARAM_TYPE, PARAM0_LIST to PARAM3_LIST [degrees], and DATA, after which its values follow: in text a line each, or as
float32 (little endian). The index of PARAM0 runs fastest. Read are BRDF and BTDF [1/sr] in

    spherical_coordinate_system        theta_i, phi_i, theta, phi: the mirror direction is at phi = phi_i + 180
    specular_coordinate_system         theta_i, phi_i, and angles about the mirror direction, as Zemax's: 0 is inward
    half_difference_coordinate_system  of Rusinkiewicz (1998), as MERL's

Without PARAM1_LIST its angle is 0. Directions below the surface are dropped; a BTDF's lie behind it. Each colour (red,
green, blue, X, Y, Z) is a sample; a spectrum is rows of its wavelengths. Specular reflectance and transmittance, which
are no BRDF, are passed over, and a note says so. REDUCTION_TYPE halves azimuths; they are not filled in here.

Read as the specification (0.3, in github.com/KimuraRyo/libbsdf) and libbsdf's coordinate systems say; tried on the
specification's own examples, as no other file was at hand.
"""

import math
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import Format, table, wrap_deg
from gonio.formats.text import decode, numbers
from gonio.formats.zemax_bsdf import about_mirror
from gonio.typing import DataFrame, Floats

_COLOURS = {"monochrome": ("",), "rgb": (" red", " green", " blue"), "xyz": (" X", " Y", " Z")}
_LIMITS = {
    "spherical_coordinate_system": (90.0, 360.0, 90.0, 360.0),
    "specular_coordinate_system": (90.0, 360.0, 180.0, 360.0),
    "half_difference_coordinate_system": (90.0, 360.0, 90.0, 360.0),
}
_LISTS = ("PARAM0_LIST", "PARAM1_LIST", "PARAM2_LIST", "PARAM3_LIST")
_SPECULAR = ("specular_reflectance", "specular_transmittance")
MOST_VALUES = 5_000_000
"""Most values of a file."""


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in an SSDD file; `DataError` says what is wrong with the file, and where."""
    file = _File(data, path)
    notes = ["the file states no uncertainties and no solid angles"]
    parts: list[tuple[str, Floats, np.ndarray, Floats]] = []
    names: list[str] = []
    while block := file.block():
        kind, model = block.get("DATA_TYPE", ""), block.get("COLOR_MODEL", "")
        nm = file.angles(block, "WAVELENGTH_LIST", math.inf) if model == "spectrum" else np.array([math.nan])
        if model not in (*_COLOURS, "spectrum") or kind not in ("brdf", "btdf", *_SPECULAR):
            raise DataError(
                f'{file.where}: DATA_TYPE is "{kind[:40]}" and COLOR_MODEL "{model[:40]}"; not both are known'
            )
        system = block.get("PARAM_TYPE", "") if kind not in _SPECULAR else "spherical_coordinate_system"
        if system not in _LIMITS:
            raise DataError(f'{file.where}: PARAM_TYPE is "{system[:60]}"; read are {", ".join(_LIMITS)}')
        lists = [file.angles(block, name, most) for name, most in zip(_LISTS, _LIMITS[system], strict=True)]
        lists = lists[:2] if kind in _SPECULAR else lists
        colours = _COLOURS.get(model, ("",))
        values = file.values(block, [len(angles) for angles in lists], len(nm) if model == "spectrum" else len(colours))
        if kind in _SPECULAR:
            notes.append(f"{kind} is no BRDF, and is left out")
            continue
        if any(float(cell) for cell in block.get("PARAM4_LIST", "").split() if cell != "0"):
            raise DataError(f"{file.where}: PARAM4_LIST moves the mirror direction; files without it are read")
        angles = _directions(system, lists, kind == "btdf")
        keep = ~np.isnan(angles).any(axis=1)
        for colour, column in zip(colours, values.T if model != "spectrum" else [values], strict=True):
            parts.append((kind, angles[keep], nm, column[keep].reshape(int(keep.sum()), -1)))
            names.append(f"{block.get('NAME', path.stem)}{colour}")
    if not parts:
        raise DataError(f"{path}: holds no BRDF and no BTDF; specular reflectances alone are not read")
    counts = [values.size for *_, values in parts]
    angles = np.concatenate([np.repeat(angles, len(nm), axis=0) for _, angles, nm, _ in parts])
    kinds = np.array(["transmission" if kind == "btdf" else "reflection" for kind, *_ in parts], dtype=object)
    return table(
        theta_i_deg=angles[:, 0],
        phi_i_deg=wrap_deg(angles[:, 1]),
        theta_r_deg=angles[:, 2],
        phi_r_deg=wrap_deg(angles[:, 3]),
        wavelength_nm=np.concatenate([np.tile(nm, len(angles)) for _, angles, nm, _ in parts]),
        brdf=np.concatenate([values.ravel() for *_, values in parts]),
        sample=np.repeat(np.array(names, dtype=object), counts) if len(set(names)) > 1 else None,
        side=np.repeat(kinds, counts),
        attrs={"source_file": str(path), "sample": names[0], "notes": notes},
    )


def _directions(system: str, lists: list[Floats], through: bool) -> Floats:
    """theta_i, phi_i, theta_r, phi_r [degrees] of each value, in the file's order; NaN for one below the surface."""
    fourth, third, second, first = (axis.ravel() for axis in np.meshgrid(*reversed(lists), indexing="ij"))
    if system == "spherical_coordinate_system":
        theta_i, phi_i, theta, phi = first, second, third, fourth
    elif system == "specular_coordinate_system":
        theta_i, phi_i = first, second
        theta, phi = _polar(about_mirror(first, fourth, third))
        phi = phi + phi_i
    else:
        h, d, p = np.deg2rad(first), np.deg2rad(third), np.deg2rad(fourth)
        x, y, z = np.sin(d) * np.cos(p), np.sin(d) * np.sin(p), np.cos(d)
        incident = np.column_stack([np.cos(h) * x + np.sin(h) * z, y, np.cos(h) * z - np.sin(h) * x])
        half = np.column_stack([np.sin(h), 0 * h, np.cos(h)])
        outgoing = 2 * (incident * half).sum(axis=1, keepdims=True) * half - incident
        (theta_i, phi_i), (theta, phi) = _polar(incident), _polar(outgoing)
        phi_i, phi = phi_i + second, phi + second
    below = (theta_i > 90) | (theta > 90) | (through & (theta == 90))
    out = np.column_stack([theta_i, phi_i, 180.0 - theta if through else theta, phi])
    out[below] = np.nan
    return out


def _polar(xyz: Floats) -> tuple[Floats, Floats]:
    """Polar angle and azimuth [degrees], rounded far below any instrument's resolution."""
    x, y, z = xyz.T
    return np.round(np.rad2deg(np.arctan2(np.hypot(x, y), z)), 9), np.round(np.rad2deg(np.arctan2(y, x)), 9)


class _File:
    """The bytes of a file, which are lines of text and, where they say so, numbers."""

    def __init__(self, data: bytes, path: Path) -> None:
        self.data, self.path, self.at, self.left, self.number = data, path, 0, MOST_VALUES, 0

    @property
    def where(self) -> str:
        """The line that was taken last."""
        return f"{self.path}, line {self.number}"

    def line(self) -> str | None:
        """The next line that is neither empty nor a comment; None at the end."""
        while self.at < len(self.data):
            end = self.data.find(b"\n", self.at)
            end, self.number = len(self.data) if end < 0 else end, self.number + 1
            content, self.at = decode(self.data[self.at : end], self.path).partition("# ")[0].strip(), end + 1
            if content and content != "#":
                return content
        return None

    def block(self) -> dict[str, str]:
        """What the lines before a block's values say; empty at the end of the file."""
        said: dict[str, str] = {}
        while (content := self.line()) is not None:
            key, _, value = content.partition(" ")
            said[key] = value.strip()
            if key == "DATA":
                return said
        if said and set(said) - {"VERSION", "SOFTWARE", "API", "DATE"}:
            raise DataError(f"{self.where}: the file ends before DATA")
        return {}

    def angles(self, block: dict[str, str], name: str, most: float) -> Floats:
        cells = block.get(name, "0" if name == "PARAM1_LIST" else "").split()
        if not cells and name in _LISTS[2:] and block.get("DATA_TYPE") in _SPECULAR:
            return np.zeros(1)
        found = np.array(numbers(cells, self.where, [name] * len(cells)))
        if not cells or found[0] < 0 or found[-1] > most or (np.diff(found) <= 0).any():
            raise DataError(f"{self.where}: {name} needs numbers that grow, from 0 to {most:g} at most")
        return found

    def values(self, block: dict[str, str], sizes: list[int], channels: int) -> Floats:
        """Values in the file's order, one row a pair of directions, shape (n, channels)."""
        count = math.prod(sizes)
        self.left -= count * channels
        if self.left < 0:
            raise DataError(f"{self.where}: has more than {MOST_VALUES} values, the most that are read")
        if block["DATA"] == "binary":
            chunk = self.data[self.at : self.at + 4 * count * channels]
            self.at, self.number = self.at + len(chunk), self.number + chunk.count(b"\n")
            found = np.frombuffer(chunk[: len(chunk) // 4 * 4], "<f4").astype(np.float64)
            if found.size != count * channels or not np.isfinite(found).all():
                raise DataError(f"{self.path}, byte {self.at}: {count * channels} finite float32 are needed")
            return found.reshape(count, channels)
        if block["DATA"] != "ascii":
            raise DataError(f'{self.where}: DATA is "{block["DATA"][:40]}"; ascii and binary are known')
        rows = []
        for k in range(count):
            cells = (self.line() or "").split()
            if len(cells) != channels:
                raise DataError(
                    f"{self.where}: {len(cells)} numbers for value {k + 1} of {count}; {channels} are needed"
                )
            rows.append(numbers(cells, self.where, ["a value"] * channels))
        return np.array(rows)


FORMAT = Format(
    name="ssdd",
    title="surface scattering distribution data (libbsdf)",
    endings=(".ssdd",),
    sniff=lambda head: head.startswith(b"VERSION ") and b"DATA_TYPE" in head,
    read=read,
    max_bytes=64 * 2**20,
)
