"""Text files of pab's gonio-photometers (pg2; the program Mountain): one direction of incidence a file, or several.

Lines that begin with "#" are a header, whose entries may stand in any order:

    #sample_name "white paint"
    #format: theta phi DSF          or BSDF, BRDF, BTDF
    #intheta 30                     polar angle of incidence [degrees]
    #inphi 180                      its azimuth; or both as: #incident_angle 30 180
    #colorimetry: CIE-XYZ           three values a line, where it is stated; CIE-Y: one

The others follow with polar angle and azimuth of the detector [degrees], and the value. Both directions leave the
surface, as ours do, so that the mirror half-plane is phi = inphi + 180. DSF is BSDF times cos(theta). Beyond 90 degrees
directions lie behind the sample: with light from the front such lines are transmission, which is left out. Light from
behind, with a detector behind, is reflection at the back: a sample of its own, seen against its own normal, whose
azimuths run the other way. Several files joined into one are read as one table: a header after values begins the next
direction of incidence. What the headers say, and how DSF is meant, is as Radiance's pabopto2bsdf reads these files.

That is version 2.41 of pabopto2bsdf; no measured file was at hand to try.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import Format, fold, one_value_a_direction, table, wrap_deg
from gonio.formats.text import Text, number, numbers
from gonio.typing import DataFrame

_FORMAT = re.compile(r"format:\s*theta\s+phi\s+(\S+)", re.IGNORECASE)
_CHANNELS = {"": ("value",), "cie-y": ("Y",), "cie-xyz": ("X", "Y", "Z")}
_TAKEN = {"": 0, "cie-y": 0, "cie-xyz": 1}
"""Which value of a line is the luminous one."""


@dataclass
class _Header:
    """What the lines before a block of values say."""

    theta_i: float | None = None
    phi_i: float | None = None
    is_dsf: bool | None = None
    colorimetry: str = ""

    def take(self, line: str, where: str) -> str | None:
        """Heed one line (without its "#"); the sample's name, where it states that."""
        key, rest = (*line.split(maxsplit=1), "", "")[:2]
        cells = rest.split()
        if key == "incident_angle" and len(cells) >= 2:
            self.theta_i, self.phi_i = (number(cell, where, f"#{key}") for cell in cells[:2])
        elif key in ("intheta", "inphi") and cells:
            setattr(self, {"intheta": "theta_i", "inphi": "phi_i"}[key], number(cells[0], where, f"#{key}"))
        elif key == "sample_name":
            name = rest.strip()
            return (name[1:-1].strip() if len(name) > 1 and name[0] == name[-1] == '"' else name) or None
        elif key == "colorimetry:":
            self.colorimetry = rest.strip().lower()
            if self.colorimetry not in _CHANNELS:
                raise DataError(f'{where}: colorimetry "{rest.strip()[:40]}" is not known; CIE-XYZ and CIE-Y are')
        elif found := _FORMAT.match(line.strip()):
            quantity = found[1].upper()
            if quantity not in ("DSF", "BSDF", "BRDF", "BTDF"):
                raise DataError(f'{where}: values are "{found[1][:40]}"; DSF, BSDF, BRDF and BTDF are known')
            self.is_dsf = quantity == "DSF"
        return None

    def incidence(self, where: str) -> tuple[float, float]:
        """Polar angle and azimuth [degrees]; `DataError` unless the header says what the values after it are."""
        if self.is_dsf is None:
            raise DataError(f'{where}: values before a line "#format: theta phi DSF" (or BSDF)')
        if self.theta_i is None or self.phi_i is None:
            raise DataError(f'{where}: values before the angle of incidence; "#intheta" and "#inphi" state it')
        if not -180.0 <= self.theta_i <= 180.0:
            raise DataError(f"{where}: #intheta is {self.theta_i:g} degrees; it lies between 0 and 180")
        return self.theta_i, self.phi_i


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in a file of Mountain's; `DataError` says what is wrong with it, and in which line."""
    rows, colorimetry, name = _rows(Text(data, path))
    if not rows:
        raise DataError(f"{path}: holds a header and no values")
    theta_i, phi_i, theta_r, phi_r, value, dsf = np.array(rows).T
    stated = np.column_stack([theta_i, phi_i, theta_r, phi_r])
    (theta_i, phi_i), (theta_r, phi_r) = fold(theta_i, phi_i), fold(theta_r, phi_r)
    front, behind = (theta_i <= 90.0) & (theta_r <= 90.0), (theta_i > 90.0) & (theta_r > 90.0)
    used = front | behind
    notes = []
    if not used.all():
        notes.append(f"{int((~used).sum())} of {used.size} values are transmission, and are left out")
    if not used.any():
        raise DataError(f"{path}: holds transmission alone (the detector behind the sample); reflection is read")
    if "cie-xyz" in colorimetry:
        notes.append("of X, Y and Z the values are Y, the luminous ones")
    if dsf.any():
        notes.append("the file states DSF, BSDF times cos(theta_r): values are divided by the cosine")
    notes.append("the file states no wavelength, no uncertainties and no solid angles")
    turned = (180.0 - theta_i, 360.0 - phi_i, 180.0 - theta_r, 360.0 - phi_r)  # the back against its own normal
    theta_i, phi_i, theta_r, phi_r = (
        np.where(behind, other, own)[used] for own, other in zip((theta_i, phi_i, theta_r, phi_r), turned, strict=True)
    )
    cosine = np.cos(np.deg2rad(theta_r))
    grazing = theta_r > 90.0 - 1e-6
    brdf = np.where(dsf[used] > 0.0, value[used] / np.where(grazing, 1.0, cosine), value[used])
    called = name or path.stem
    sides = np.where(behind[used], f"{called} back", f"{called} front") if front.any() and behind.any() else None
    frame = table(
        theta_i_deg=theta_i,
        phi_i_deg=wrap_deg(phi_i),
        theta_r_deg=theta_r,
        phi_r_deg=wrap_deg(phi_r),
        wavelength_nm=np.nan,
        brdf=brdf,
        flag=np.where(grazing, "grazing", ""),
        sample=sides,
        attrs={"source_file": str(path), "sample": called, "notes": notes},
    )
    return one_value_a_direction(frame, stated[used], path)


def _rows(text: Text) -> tuple[list[tuple[float, ...]], set[str], str | None]:
    """Angles [deg], value and whether it is a DSF of each line; kinds of values; and the sample's name."""
    header, begun, incidence = _Header(), False, (0.0, 0.0)
    name: str | None = None
    rows, colorimetry = list[tuple[float, ...]](), set[str]()
    for index, line in enumerate(text.lines):
        where = text.where(index)
        if line.startswith("#"):
            if begun:  # the next file of several joined into one
                header, begun = _Header(), False
            name = header.take(line[1:], where) or name
            continue
        cells = line.split()
        if not cells:
            continue
        if not begun:
            begun, incidence = True, header.incidence(where)
            colorimetry.add(header.colorimetry)
        channels = _CHANNELS[header.colorimetry]
        if len(cells) != 2 + len(channels):
            raise DataError(f"{where}: {len(cells)} numbers, and theta, phi, {', '.join(channels)} are needed")
        found = numbers(cells, where, ("theta", "phi", *channels))
        if not -180.0 <= found[0] <= 180.0:
            raise DataError(f"{where}: theta is {found[0]:g} degrees; it lies between 0 and 180")
        rows.append((*incidence, *found[:2], found[2 + _TAKEN[header.colorimetry]], float(bool(header.is_dsf))))
    return rows, colorimetry, name


FORMAT = Format(
    name="pab",
    title="pab gonio-photometer text",
    endings=(),
    sniff=lambda head: (
        b"#" in head
        and re.search(rb"^#((?i:format:\s*theta\s+phi)|intheta|incident_angle)\s", head, re.MULTILINE) is not None
    ),
    read=read,
)
