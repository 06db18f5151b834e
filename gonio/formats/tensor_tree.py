"""Tensor trees in the XML of WINDOW and Radiance (`genBSDF -t3`, `-t4`): a BSDF [1/sr] in cells of varying size.

Directions are points of a unit square, by the mapping of Shirley and Chiu (1997) from the disk of (x, y): equal areas
are equal projected solid angles. A tree of rank 4 has the square of the direction in which light travels, and that of
the scattered one. Rank 3 is isotropic: its first coordinate is (1 - sin theta_i) / 2, so that half of it is used, and
scattered azimuths are counted from the direction of travel. `{ ... }` is either 2^rank branches, the first coordinate
in the lowest bit of their number, or a grid of 2^(rank k) values, the first coordinate slowest.

A row is a cell, with the directions of its centre; a value is the average over it. Each side that light falls on, and
each band, is a sample named "<product> back Visible". As in Radiance, whose normal side is "Back" in these files, both
sides share x and y, and azimuths of the front, seen against its own normal, run the other way. What is transmitted
leaves at 180 - theta. Colours (bands CIE-u and CIE-v) are left out.

Written are tables whose directions are centres of such cells, as this reader makes them, and isotropic models on a grid
of 32 incidences by 64 x 64 directions. Read as Radiance's bsdf_t.c does (2021), and tried with its programs.
"""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gonio.errors import DataError
from gonio.formats.klems_xml import NAME, band_of, child, direction_of, known_bands, layer_of, text_of
from gonio.formats.reader import ANGLES, NOT_XML, Format, require_held, table, wrap_deg, write_bytes
from gonio.formats.text import numbers
from gonio.typing import Array, DataFrame, Floats

if TYPE_CHECKING:
    from gonio.models import Model

_RANKS = {"tensortree3": 3, "tensortree4": 4}
MOST_CELLS = 3_000_000
"""Most cells of a file."""
DEEPEST = 12
"""Most branches within each other: a cell is then 0.014 degrees wide."""
_LOG2 = 6
"""A model's cells are 2^-6 wide."""


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in a tensor tree; `DataError` says what is wrong with the file, and where."""
    layer = layer_of(data, path)
    structure = text_of(child(layer, "DataDefinition", path), "IncidentDataStructure", path)
    rank = _RANKS.get(structure.lower())
    if rank is None:
        raise DataError(f'{path}: IncidentDataStructure is "{structure[:40]}"; TensorTree3 and TensorTree4 are trees')
    product = " ".join((layer.findtext("{*}Material/{*}Name") or path.stem).split()) or path.stem
    notes = ["values are averages over cells of the tree, given at the centres of the cells"]
    notes.append("broad bands; the file states no uncertainties")
    parts: list[tuple[str, str, Floats]] = []
    for element in layer.iterfind("{*}WavelengthData"):
        band = band_of(element, path)
        if band.lower() in ("cie-u", "cie-v"):
            if "colour" not in notes[-1]:
                notes.append("colours (bands CIE-u and CIE-v) are left out: values are the luminous ones")
            continue
        for block in element.iterfind("{*}WavelengthDataBlock"):
            kind, lit = direction_of(block, path)
            if (basis := text_of(block, "AngleBasis", path)).lower() != "lbnl/shirley-chiu":
                raise DataError(f'{path}: AngleBasis is "{basis[:40]}"; trees have LBNL/Shirley-Chiu')
            room = MOST_CELLS - sum(len(rows) for *_, rows in parts)
            cells = _cells(text_of(block, "ScatteringData", path), rank, f"{path}, {kind} {lit}", room)
            parts.append((f"{product} {lit} {'_'.join(band.split())[:40]}", kind, _rows(cells, rank, kind, lit)))
    if not parts:
        raise DataError(f"{path}: holds no block of reflection or of transmission")
    if len({(name, kind) for name, kind, _ in parts}) < len(parts):
        raise DataError(f"{path}: a side and a band are there twice")
    rows = np.concatenate([rows for *_, rows in parts])
    counts = [len(rows) for *_, rows in parts]
    return table(
        theta_i_deg=rows[:, 0],
        phi_i_deg=rows[:, 1],
        theta_r_deg=rows[:, 2],
        phi_r_deg=rows[:, 3],
        wavelength_nm=math.nan,
        brdf=rows[:, 4],
        sample=np.repeat(np.array([name for name, *_ in parts], dtype=object), counts),
        side=np.repeat(np.array([kind for _, kind, _ in parts], dtype=object), counts),
        attrs={"source_file": str(path), "bands": known_bands(name for name, *_ in parts), "notes": notes},
    )


@dataclass
class _Node:
    """A node of the tree whose bracket is open."""

    corner: Floats
    width: float
    branches: int = 0


def _cells(text: str, rank: int, where: str, room: int) -> Floats:
    """The cells of a tree: corner, width and value, shape (n, rank + 2)."""
    found, open_nodes, last, count = list[Floats](), list[_Node](), 0, 0
    for brace in re.finditer("[{}]", text):
        words = text[last : brace.start()].replace(",", " ").split()
        at, last = f"{where}, character {brace.start() + 1} of ScatteringData", brace.end()
        if brace[0] == "{":
            if words or len(open_nodes) > DEEPEST or (found and not open_nodes):
                raise DataError(f"{at}: numbers beside branches, a second tree, or more than {DEEPEST} levels")
            if open_nodes:
                parent = open_nodes[-1]
                half, bits = parent.width / 2, (parent.branches >> np.arange(rank)) & 1
                parent.branches += 1
                open_nodes.append(_Node(parent.corner + half * bits, half))
            else:
                open_nodes.append(_Node(np.zeros(rank), 1.0))
            continue
        if not open_nodes:
            raise DataError(f"{at}: a bracket closes that did not open")
        node = open_nodes.pop()
        if node.branches:
            if words or node.branches != 2**rank:
                raise DataError(
                    f"{at}: {node.branches} branches and {len(words)} numbers; {2**rank} branches are needed"
                )
            continue
        side = round(len(words) ** (1 / rank))
        count += len(words)
        if side**rank != len(words) or side & (side - 1) or count > room:
            raise DataError(
                f"{at}: {len(words)} numbers; a power of {2**rank} is needed, and at most {MOST_CELLS} cells"
            )
        grid = np.indices((side,) * rank).reshape(rank, -1).T
        values = numbers(words, at, ["a value"] * len(words))
        width = node.width / side
        found.append(np.column_stack([node.corner + width * grid, np.full(len(values), width), values]))
    if open_nodes or not found or text[last:].strip():
        raise DataError(f"{where}: ScatteringData is no whole tree")
    return np.concatenate(found)


def _rows(cells: Floats, rank: int, kind: str, lit: str) -> Floats:
    """theta_i, phi_i, theta_r, phi_r [degrees] and value of each cell."""
    low, width, values = cells[:, :rank], cells[:, rank, np.newaxis], cells[:, rank + 1]
    high = low + width
    if rank == 3:  # of its first coordinate only the lower half is used
        keep = low[:, 0] < 0.5
        low, high, values = low[keep], high[keep], values[keep]
        high[:, 0] = np.minimum(high[:, 0], 0.5)
    centre = (low + high) / 2
    travel = np.column_stack([1 - 2 * centre[:, 0], 0 * values]) if rank == 3 else disk(centre[:, :2])
    turn = 1.0 if lit == "back" else -1.0
    (theta_i, phi_i), (theta_r, phi_r) = (_polar(xy * [1.0, turn]) for xy in (travel, disk(centre[:, -2:])))
    theta_r = 180.0 - theta_r if kind == "transmission" else theta_r
    return np.column_stack([theta_i, wrap_deg(phi_i + 180.0), theta_r, wrap_deg(phi_r), values])


def _polar(xy: Floats) -> tuple[Floats, Floats]:
    """Polar angle and azimuth [degrees] of directions by their x and y."""
    radius = np.minimum(np.hypot(*xy.T), 1.0)
    return np.rad2deg(np.arcsin(radius)), np.rad2deg(np.arctan2(xy[:, 1], xy[:, 0]))


def disk(square: Floats) -> Floats:
    """Points of the unit disk, shape (n, 2), for those of the unit square (Shirley and Chiu 1997)."""
    a, b = (2.0 * square - 1.0).T
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    part = np.pi / 4 * np.where(wide, b, a) / np.where(radius == 0, 1.0, radius)
    phi = np.where(wide, part, np.pi / 2 - part)
    return np.column_stack([radius * np.cos(phi), radius * np.sin(phi)])


def square(xy: Floats) -> Floats:
    """The inverse of `disk`."""
    x, y = xy.T
    wide = np.abs(x) > np.abs(y)
    radius = np.copysign(np.hypot(x, y), np.where(wide, x, y))
    ratio = np.where(wide, y, x) / np.where(radius == 0, 1.0, np.where(wide, x, y))
    other = radius * 4 / np.pi * np.arctan(ratio)
    return np.asarray(np.column_stack([np.where(wide, radius, other), np.where(wide, other, radius)]) / 2 + 0.5)


def write(frame: DataFrame, path: Path) -> None:
    """A table whose directions are centres of a tree's cells, for each sample once.

    One azimuth of incidence makes a tree of rank 3, several of rank 4. The side and the band are read from the sample's
    name ("<product> back Visible"), as this reader makes them; a table without a column `sample` is the back, which is
    the normal side in Radiance, in the visible.
    """
    if (frame["polarisation"] != "unpolarised").any() or (frame["flag"] != "").any():
        raise DataError(f"{path}: a tensor tree has no room for polarised or flagged rows")
    rank = 3 if frame["phi_i_deg"].nunique() == 1 else 4
    words = [name for name in ("sample", "side") if name in frame.columns]
    product, blocks = "", []
    for known, group in frame.groupby(words, sort=False) if words else [((), frame)]:
        told = dict(zip(words, known, strict=True))
        name, kind = str(told.get("sample", frame.attrs.get("sample") or "")), str(told.get("side", "reflection"))
        require_held(name, path, "XML", NOT_XML)
        match = NAME.fullmatch(name)
        product, lit, band = match.groups() if match else (name, "back", "Visible")
        blocks.append(_block(kind, lit, band, _text(group, rank, kind, lit, path)))
    _write(rank, product, blocks, path)


def _text(group: DataFrame, rank: int, kind: str, lit: str, path: Path) -> str:
    """The tree of one block."""
    theta_i, phi_i, theta_r, phi_r = (group[name].to_numpy(np.float64) for name in ANGLES)
    turn = 1.0 if lit == "back" else -1.0
    travel, away = np.deg2rad(turn * (phi_i + 180.0)), np.deg2rad(turn * phi_r)
    sines = np.sin(np.deg2rad(theta_i)), np.sin(np.deg2rad(180.0 - theta_r if kind == "transmission" else theta_r))
    if rank == 3:
        away, first = away - travel, 0.5 - sines[0][:, np.newaxis] / 2
    else:
        first = square(sines[0][:, np.newaxis] * np.column_stack([np.cos(travel), np.sin(travel)]))
    scattered = square(sines[1][:, np.newaxis] * np.column_stack([np.cos(away), np.sin(away)]))
    place, values = np.column_stack([first, scattered]), group["brdf"].to_numpy(np.float64)
    if not np.isfinite(values).all():
        raise DataError(f"{path}: a tensor tree has no room for a value that is missing")

    def node(rows: Array, corner: Floats, width: float) -> str:
        points = place[rows]
        used = np.full(rank, width)
        if rank == 3:
            used[0] = min(width, 0.5 - corner[0])
        if len(points) == 1 and (np.abs(points[0] - corner - used / 2) < 1e-3 * width).all():
            return f"{{ {float(values[rows][0])!r} }}\n"
        if rank == 3 and corner[0] >= 0.5 and not len(points):
            return "{ 0 }\n"
        if len(points) < 2 or width < 2.0**-DEEPEST:
            raise DataError(f"{path}: these directions are no centres of a tensor tree's cells, or cells are missing")
        half = width / 2
        branch = ((points >= corner + half) << np.arange(rank)).sum(axis=1)
        bits = [(k >> np.arange(rank)) & 1 for k in range(2**rank)]
        return "{" + "".join(node(rows[branch == k], corner + half * bits[k], half) for k in range(2**rank)) + "}\n"

    return node(np.arange(len(place)), np.zeros(rank), 1.0)


def write_model(model: Model, name: str, path: Path) -> None:
    """An isotropic model at 550 nm: means over 2 x 2 x 2 directions in each cell of a grid."""
    count = 2**_LOG2
    parts = (np.arange(2) + 0.5) / 2
    sines = 1.0 - 2.0 * (np.arange(count // 2)[:, np.newaxis] + parts) / count
    axis = ((np.arange(count)[:, np.newaxis] + parts) / count).ravel()
    xy = disk(np.array(list(itertools.product(axis, axis))))
    theta_r, phi_r = (np.deg2rad(angle) for angle in _polar(xy))
    values = np.zeros((count, count, count))
    for row, sine in zip(values, sines, strict=False):
        found = np.mean([model.brdf(math.asin(s), math.pi, theta_r, phi_r) for s in sine], axis=0)
        row[:] = found.reshape(count, 2, count, 2).mean(axis=(1, 3))
    require_held(name, path, "XML", NOT_XML)
    text = "{ " + " ".join(f"{value:.6g}" for value in values.ravel().tolist()) + " }\n"
    _write(3, name, [_block("reflection", "back", "Visible", text)], path)


def _block(kind: str, lit: str, band: str, text: str) -> str:
    name, direction = escape(band, quote=False), f"{kind} {lit}".title()
    return _BLOCK.format(band=name, direction=direction, letter=kind[0].upper(), data=text)


def _write(rank: int, product: str, blocks: list[str], path: Path) -> None:
    write_bytes(path, _XML.format(product=escape(product, quote=False), rank=rank, blocks="".join(blocks)).encode())


_XML = """<?xml version="1.0" encoding="UTF-8"?>
<WindowElement xmlns="http://windows.lbl.gov">
<WindowElementType>System</WindowElementType>
<FileType>BSDF</FileType>
<Optical>
<Layer>
<Material><Name>{product}</Name><Manufacturer></Manufacturer></Material>
<DataDefinition><IncidentDataStructure>TensorTree{rank}</IncidentDataStructure></DataDefinition>
{blocks}</Layer>
</Optical>
</WindowElement>
"""
_BLOCK = """<WavelengthData>
<LayerNumber>System</LayerNumber>
<Wavelength unit="Integral">{band}</Wavelength>
<WavelengthDataBlock>
<WavelengthDataDirection>{direction}</WavelengthDataDirection>
<AngleBasis>LBNL/Shirley-Chiu</AngleBasis>
<ScatteringDataType>B{letter}DF</ScatteringDataType>
<ScatteringData>
{data}</ScatteringData>
</WavelengthDataBlock>
</WavelengthData>
"""

FORMAT = Format(
    name="tensor-tree",
    title="tensor tree XML (Radiance)",
    endings=(),
    sniff=lambda head: b"<WindowElement" in head and re.search(rb"TensorTree[34]", head, re.IGNORECASE) is not None,
    read=read,
    write=write,
    write_model=write_model,
    max_bytes=64 * 2**20,
    carries=frozenset({"transmission"}),
)
