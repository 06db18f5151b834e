"""Klems matrices in the XML of LBNL's WINDOW: averages of the BSDF [1/sr] over pairs of patches of the hemisphere.

`AngleBasis` lists rings of patches by polar angle; patch k of a ring of n is centred at azimuth 360 k / n. A block of
`ScatteringData` is a matrix in row-major order; with `IncidentDataStructure` "Columns" a column is a direction of
incidence. Directions are those of propagation along the window, so that regular transmission and mirror reflection
both lie on the diagonal: light of incidence azimuth phi comes from phi + 180. Both sides share the window's x and y. As
in Radiance, whose normal side is "Back" in these files, azimuths of the front, seen against its own normal, run the
other way.

Each side that light falls on, and each band, becomes a sample named "<product> front Visible", with its reflection and
its transmission. The frame is that of the lit side: what is transmitted leaves at theta_r = 180 - Theta, with the
azimuth that it travels with. Bands are broad: there is no wavelength. A value is an average over two patches, which
the polar angles of their centres stand for.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from gonio.errors import DataError
from gonio.formats import xml_text
from gonio.formats.reader import ANGLES, NOT_XML, SIDES, Format, TableBand, require_held, table, wrap_deg, write_bytes
from gonio.formats.text import integer, number
from gonio.typing import DataFrame, Floats

if TYPE_CHECKING:
    from gonio.models import Model

_BANDS = {"Visible": (380.0, 780.0), "Solar": (300.0, 2500.0)}
_FULL = (
    (0, 5, 1),
    (5, 15, 8),
    (15, 25, 16),
    (25, 35, 20),
    (35, 45, 24),
    (45, 55, 24),
    (55, 65, 24),
    (65, 75, 16),
    (75, 90, 12),
)
_SAMPLES = 4
NAME = re.compile(r"(.*) (front|back) (\S+)")


@dataclass(frozen=True)
class Basis:
    """Centres of the patches, in the order of the matrix [degrees]."""

    theta: Floats
    phi: Floats


def _rings(rings: Iterator[tuple[float, int]]) -> Basis:
    parts = [(np.full(count, theta), 360.0 * np.arange(count) / count) for theta, count in rings]
    return Basis(np.concatenate([t for t, _ in parts]), np.concatenate([p for _, p in parts]))


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in WINDOW's XML; `DataError` says what is wrong with the file, and where."""
    layer = layer_of(data, path)
    definition = child(layer, "DataDefinition", path)
    structure = text_of(definition, "IncidentDataStructure", path)
    if structure not in ("Columns", "Rows"):
        raise DataError(
            f'{path}: IncidentDataStructure is "{structure[:40]}"; only Columns and Rows are matrices, and '
            "trees are read with --from tensor-tree"
        )
    bases = dict(_bases(definition, path))
    product = " ".join((layer.findtext("{*}Material/{*}Name") or path.stem).split()) or path.stem
    parts = []
    for element in layer.iterfind("{*}WavelengthData"):
        band = band_of(element, path)
        for block in element.iterfind("{*}WavelengthDataBlock"):
            kind, lit = direction_of(block, path)
            name = f"{product} {lit} {'_'.join(band.split())[:40]}"
            parts.append((name, kind, *_block(block, structure, bases, kind, lit, path)))
    if not parts:
        raise DataError(f"{path}: holds no block of reflection or of transmission")
    if len({(name, kind) for name, kind, *_ in parts}) < len(parts):
        raise DataError(f"{path}: a side and a band are there twice")
    angles = np.concatenate([a for *_, a, _ in parts])
    notes = ["values are averages over pairs of Klems patches, given at the patches' centres"]
    notes.append("broad bands; the file states no uncertainties")
    return table(
        theta_i_deg=angles[:, 0],
        phi_i_deg=angles[:, 1],
        theta_r_deg=angles[:, 2],
        phi_r_deg=angles[:, 3],
        wavelength_nm=math.nan,
        brdf=np.concatenate([v for *_, v in parts]),
        sample=[name for name, *_, values in parts for _ in values],
        side=[kind for _, kind, _, values in parts for _ in values],
        attrs={
            "source_file": str(path),
            "bands": known_bands(name for name, *_ in parts),
            "notes": notes,
        },
    )


def known_bands(names: Iterable[str]) -> list[TableBand]:
    """The bands that samples' names end with, and their limits where they are known."""
    return [
        {"name": b, "lower_nm": _BANDS[b][0], "upper_nm": _BANDS[b][1]} if b in _BANDS else {"name": b}
        for b in dict.fromkeys(name.rpartition(" ")[2] for name in names)
    ]


def direction_of(block: ElementTree.Element, path: Path) -> tuple[str, str]:
    """What a block holds, "reflection" or "transmission", and which side is lit, "front" or "back"."""
    direction = text_of(block, "WavelengthDataDirection", path)
    kind, _, lit = direction.partition(" ")
    kind, lit = kind.lower(), lit.strip().lower()
    if kind not in SIDES or lit not in ("front", "back"):
        raise DataError(
            f'{path}: WavelengthDataDirection is "{direction[:40]}"; read are Reflection and Transmission, '
            "Front and Back"
        )
    return kind, lit


def band_of(element: ElementTree.Element, path: Path) -> str:
    """The band that values are averages over; `DataError` where it is a single wavelength, or has no name."""
    band = text_of(element, "Wavelength", path)
    unit = child(element, "Wavelength", path).get("unit", "Integral")
    if unit.strip().lower() != "integral" or not band or re.fullmatch(r"[\d.,eE+-]+", band):
        raise DataError(
            f'{path}: Wavelength is "{band[:40]}", unit "{unit[:40]}"; read are bands, as Visible (unit "Integral")'
        )
    return band


def layer_of(data: bytes, path: Path) -> ElementTree.Element:
    """The element that holds the matrices."""
    root = xml_text.root(data, str(path))
    layer = root.find(".//{*}Layer")
    if layer is None:
        raise DataError(f"{path}: there is no element Layer; this is not a WINDOW file")
    return layer


def _bases(definition: ElementTree.Element, path: Path) -> Iterator[tuple[str, Basis]]:
    for basis in definition.iterfind("{*}AngleBasis"):
        name = text_of(basis, "AngleBasisName", path)
        rings = []
        for block in basis.iterfind("{*}AngleBasisBlock"):
            theta = number(text_of(block, "Theta", path), f"{path}, {name[:40]}", "Theta")
            if not 0 <= theta <= 90:
                raise DataError(f"{path}: {name[:40]}: Theta = {theta:g} lies outside [0, 90] degrees")
            _require_within(block, theta, f"{path}: {name[:40]}", path)
            rings.append((theta, integer(text_of(block, "nPhis", path), f"{path}, {name[:40]}", "nPhis", 1, 1000)))
        if not rings or sum(count for _, count in rings) > 4000:
            raise DataError(f"{path}: {name[:40]} has {sum(count for _, count in rings)} patches; 1 to 4000 are read")
        yield name, _rings(iter(rings))


def _require_within(block: ElementTree.Element, theta: float, where: str, path: Path) -> None:
    """`DataError` where a ring's polar angle does not lie within the bounds that it states."""
    bounds = block.find("{*}ThetaBounds")
    if bounds is None:
        return
    low, high = (number(text_of(bounds, name, path), where, name) for name in ("LowerTheta", "UpperTheta"))
    if not (0 <= low <= theta <= high <= 90 and low < high):
        raise DataError(f"{where}: Theta = {theta:g} lies outside its ThetaBounds, {low:g} to {high:g} degrees")


def _block(
    block: ElementTree.Element, structure: str, bases: dict[str, Basis], kind: str, side: str, path: Path
) -> tuple[Floats, Floats]:
    """Directions (n, 4) and values (n,) of one matrix, incidence by incidence."""
    pair = []
    for element in ("ColumnAngleBasis", "RowAngleBasis"):
        name = text_of(block, element, path)
        if name not in bases:
            raise DataError(f'{path}: {element} is "{name[:40]}", which DataDefinition does not define')
        pair.append(bases[name])
    columns, rows = pair
    words = text_of(block, "ScatteringData", path).replace(",", " ").split()
    if len(words) != columns.theta.size * rows.theta.size:
        wanted = f"{rows.theta.size} x {columns.theta.size}"
        raise DataError(f"{path}: ScatteringData of {side} {kind} has {len(words)} numbers; {wanted} are needed")
    where = f"{path}, ScatteringData of {side} {kind}"
    matrix = np.array([number(word, where, f"number {k + 1}") for k, word in enumerate(words)])
    matrix = matrix.reshape(rows.theta.size, columns.theta.size)
    incident, outgoing, values = (columns, rows, matrix.T) if structure == "Columns" else (rows, columns, matrix)
    turn = 1.0 if side == "back" else -1.0
    i, r = (
        a.ravel() for a in np.meshgrid(np.arange(incident.theta.size), np.arange(outgoing.theta.size), indexing="ij")
    )
    phi_i, phi_r = wrap_deg(turn * incident.phi[i] + 180.0), wrap_deg(turn * outgoing.phi[r])
    theta_r = _theta_r(outgoing, kind)[r]
    return np.column_stack([incident.theta[i], phi_i, theta_r, phi_r]), values.ravel()


def _theta_r(basis: Basis, kind: str) -> Floats:
    """Polar angles against the normal of the lit side: those of transmission are counted from the other one."""
    return 180.0 - basis.theta if kind == "transmission" else basis.theta


def child(element: ElementTree.Element, name: str, path: Path) -> ElementTree.Element:
    found = element.find(f"{{*}}{name}")
    if found is None:
        raise DataError(f"{path}: an element {name} is missing")
    return found


def text_of(element: ElementTree.Element, name: str, path: Path) -> str:
    return (child(element, name, path).text or "").strip()


def write(frame: DataFrame, path: Path) -> None:
    """A table whose directions are the 145 x 145 pairs of the full Klems basis, for each sample once.

    The side and the band are read from the sample's name ("<product> front Visible"), as this reader makes them; a
    table without a column `sample` is the back in the visible, which is the normal side in Radiance.
    """
    basis = _full()
    if (frame["polarisation"] != "unpolarised").any() or (frame["flag"] != "").any():
        raise DataError(f"{path}: a Klems matrix has no room for polarised or flagged rows")
    words = [name for name in ("sample", "side") if name in frame.columns]
    groups = frame.groupby(words, sort=False) if words else [((), frame)]
    product, blocks = "", []
    for known, group in groups:
        told = dict(zip(words, known, strict=True))
        name, kind = told.get("sample", frame.attrs.get("sample") or ""), told.get("side", "reflection")
        require_held(str(name), path, "XML", NOT_XML)
        match = NAME.fullmatch(str(name))
        product, side, band = match.groups() if match else (str(name), "back", "Visible")
        turn = 1.0 if side == "back" else -1.0
        given = {tuple(row): k for k, row in enumerate(np.round(group[list(ANGLES)].to_numpy(np.float64), 6).tolist())}
        phi_i, phi_r = wrap_deg(turn * basis.phi + 180.0), wrap_deg(turn * basis.phi)
        theta_r = _theta_r(basis, str(kind))
        lines = []
        values = group["brdf"].tolist()
        for r in range(basis.theta.size):
            keys = [
                tuple(np.round([basis.theta[i], phi_i[i], theta_r[r], phi_r[r]], 6).tolist())
                for i in range(basis.theta.size)
            ]
            absent = next((key for key in keys if key not in given), None)
            if absent is not None or len(given) != len(values) or len(values) != basis.theta.size**2:
                raise DataError(
                    f"{path}: a Klems matrix needs each pair of its 145 patches once, and this table has others"
                )
            lines.append(", ".join(repr(values[given[key]]) for key in keys))
        blocks.append(
            _XML_BLOCK.format(
                band=escape(band, quote=False),
                kind=str(kind).capitalize(),
                side=side.capitalize(),
                letter="T" if kind == "transmission" else "R",
                data=",\n".join(lines),
            )
        )
    rings = "".join(
        _XML_RING.format(theta=(low + high) / 2 if low else 0, low=low, high=high, count=count)
        for low, high, count in _FULL
    )
    said = "".join(f"<!-- {remark.replace('--', '- -')} -->\n" for remark in frame.attrs.get("remarks", ()))
    text = _XML.format(product=escape(product, quote=False), remarks=said, rings=rings, blocks="".join(blocks))
    write_bytes(path, text.encode())


def write_model(model: Model, name: str, path: Path) -> None:
    """A model at 550 nm, as `averaged`."""
    write(averaged(model.brdf, name), path)


def averaged(
    brdf: Callable[[Floats, Floats, Floats, Floats], Floats], name: str, *, samples: int = _SAMPLES
) -> DataFrame:
    """A BRDF of four angles [rad] averaged over pairs of patches of the full basis, as its back in the visible.

    Averages are over `samples` by `samples` directions of equal projected solid angle in each patch.
    """
    basis = _full()
    count = basis.theta.size
    shares = (np.arange(samples) + 0.5) / samples
    thetas, phis = np.empty((2, count, samples, samples))
    start = 0
    for low, high, patches in _FULL:
        s_low, s_high = np.sin(np.deg2rad([low, high])) ** 2
        these = slice(start, start + patches)
        thetas[these] = np.arcsin(np.sqrt(s_low + (s_high - s_low) * shares))[:, np.newaxis]
        phis[these] = np.deg2rad(basis.phi[these, np.newaxis, np.newaxis] + 360.0 / patches * (shares - 0.5))
        start += patches
    theta, phi = thetas.reshape(count, -1), phis.reshape(count, -1)
    matrix = np.empty((count, count))
    for row, incident, azimuth in zip(matrix, theta, phi, strict=True):
        pairs = brdf(incident[:, None, None], azimuth[:, None, None] + math.pi, theta, phi)
        row[:] = pairs.mean(axis=(0, 2))
    i, r = (a.ravel() for a in np.indices(matrix.shape))
    return table(
        theta_i_deg=basis.theta[i],
        phi_i_deg=wrap_deg(basis.phi[i] + 180.0),
        theta_r_deg=basis.theta[r],
        phi_r_deg=wrap_deg(basis.phi[r]),
        wavelength_nm=math.nan,
        brdf=matrix.ravel(),
        attrs={"sample": name},
    )


def _full() -> Basis:
    return _rings(iter([((low + high) / 2 if low else 0.0, count) for low, high, count in _FULL]))


_XML = """<?xml version="1.0" encoding="UTF-8"?>
{remarks}<WindowElement xmlns="http://windows.lbl.gov">
<WindowElementType>System</WindowElementType>
<FileType>BSDF</FileType>
<Optical>
<Layer>
<Material><Name>{product}</Name><Manufacturer></Manufacturer></Material>
<DataDefinition>
<IncidentDataStructure>Columns</IncidentDataStructure>
<AngleBasis>
<AngleBasisName>LBNL/Klems Full</AngleBasisName>
{rings}</AngleBasis>
</DataDefinition>
{blocks}</Layer>
</Optical>
</WindowElement>
"""
_XML_RING = (
    "<AngleBasisBlock><Theta>{theta:g}</Theta><nPhis>{count}</nPhis><ThetaBounds><LowerTheta>{low}</LowerTheta>"
    "<UpperTheta>{high}</UpperTheta></ThetaBounds></AngleBasisBlock>\n"
)
_XML_BLOCK = """<WavelengthData>
<LayerNumber>System</LayerNumber>
<Wavelength unit="Integral">{band}</Wavelength>
<WavelengthDataBlock>
<WavelengthDataDirection>{kind} {side}</WavelengthDataDirection>
<ColumnAngleBasis>LBNL/Klems Full</ColumnAngleBasis>
<RowAngleBasis>LBNL/Klems Full</RowAngleBasis>
<ScatteringDataType>B{letter}DF</ScatteringDataType>
<ScatteringData>
{data}
</ScatteringData>
</WavelengthDataBlock>
</WavelengthData>
"""

FORMAT = Format(
    name="klems",
    title="Klems XML (WINDOW)",
    endings=(".xml",),
    sniff=lambda head: b"<WindowElement" in head and b"tensortree" not in head.lower(),
    read=read,
    write=write,
    write_model=write_model,
    max_bytes=16 * 2**20,
    carries=frozenset({"transmission"}),
)
