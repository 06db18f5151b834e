"""Zemax tabular BSDF (`.bsdf`, Radiant's interchange format): a grid of angles about the mirror direction.

For each sample rotation and angle of incidence a TIS line and a matrix: one row a `ScatterAzimuth`, one column a
`ScatterRadial` [degrees], values in 1/sr. Radial 0 is the mirror direction and grows outward; azimuth 0 points from
there toward the normal and grows counter-clockwise. "PlaneSymmetrical" files stop at azimuth 180; they are not mirrored
here. Zeros stand for directions below the surface, which are dropped, and for what was not measured, which is flagged
"not_measured". With `ScatterType` BTDF the grid is about the direction that the light goes on in, straight through the
sample, azimuth 0 points from there toward the normal of the back, and the rows are transmission. The rotation is taken
as the azimuth of incidence. `SpectralContent` XYZ has three blocks, TristimulusX, Y and Z: each is a sample, named
"<file> X", "<file> Y" and "<file> Z"; no such file was at hand to try. The format states no wavelength (files that we
write say theirs in a comment), no uncertainty, no solid angle.
"""

import itertools
import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gonio import geometry
from gonio.errors import DataError
from gonio.formats.reader import ANGLES, SAME, Format, single, table, wrap_deg, write_lines
from gonio.formats.text import Text, integer, number, numbers
from gonio.typing import DataFrame, Floats

_WORDS = {
    "Source": ("Measured",),
    "Symmetry": ("PlaneSymmetrical", "ASymmetrical", "ASymmetrical4D", "Asymmetrical", "Asymmetrical4D"),
    "SpectralContent": ("Monochrome", "XYZ"),
    "ScatterType": ("BRDF", "BTDF"),
}
_LISTS = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
_LIMITS = {
    "SampleRotation": (-360.0, 360.0),
    "AngleOfIncidence": (0.0, 90.0),
    "ScatterAzimuth": (0.0, 360.0),
    "ScatterRadial": (0.0, 180.0),
}
_COLOURS = ("X", "Y", "Z")
_OURS = re.compile(r"#\s*wavelength_nm\s+(\S+)")


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in a Zemax BSDF file; `DataError` says what is wrong with the file, and where."""
    text = Text(data, path)
    wavelength = math.nan
    for line, content in enumerate(text.lines):
        if match := _OURS.match(content):
            wavelength = number(match[1], text.where(line), "wavelength_nm")
    file = _Lines(text)
    words = {keyword: file.keyword(keyword, allowed) for keyword, allowed in _WORDS.items()}
    through = words["ScatterType"] == ["BTDF"]
    axes = {name: file.axis(name) for name in _LISTS}
    colours = _COLOURS if words["SpectralContent"] == ["XYZ"] else ("",)
    parts = []
    for colour in colours:
        file.keyword(f"Tristimulus{colour}" if colour else "Monochrome", ())
        file.keyword("DataBegin", ())
        rows = np.concatenate(list(_blocks(file, axes, path)))
        parts.append(rows[rows[:, 2] < 90] if through else rows)  # at the horizon a detector belongs to neither side
        file.keyword("DataEnd", ())
    rows = np.concatenate(parts)
    unmeasured = rows[:, 4] == 0
    notes = ["the format states no uncertainties and no solid angles"]
    if len(colours) > 1:
        notes.append("X, Y and Z are samples of their own, of which Y is the luminous one; no published file was tried")
    elif math.isnan(wavelength):
        notes.append("the file states no wavelength")
    if unmeasured.any():
        notes.append(f'{unmeasured.sum()} of {len(rows)} values are zero: flagged "not_measured"')
    return table(
        theta_i_deg=rows[:, 0],
        phi_i_deg=rows[:, 1],
        theta_r_deg=180.0 - rows[:, 2] if through else rows[:, 2],
        phi_r_deg=rows[:, 3],
        wavelength_nm=wavelength,
        side="transmission" if through else None,
        sample=np.repeat([f"{path.stem} {colour}" for colour in colours], [len(part) for part in parts]).astype(object)
        if len(colours) > 1
        else None,
        brdf=rows[:, 4],
        flag=np.where(unmeasured, "not_measured", ""),
        attrs={"source_file": str(path), "sample": path.stem, "notes": notes},
    )


def _blocks(file: "_Lines", axes: dict[str, Floats], path: Path) -> Iterator[Floats]:
    """The rows of each rotation and incidence, up to DataEnd."""
    azimuth, radial = axes["ScatterAzimuth"], axes["ScatterRadial"]
    first = dict[float, Floats]()
    for rotation, incidence in itertools.product(axes["SampleRotation"], axes["AngleOfIncidence"]):
        file.keyword("TIS", None)
        matrix = np.array([file.row(radial.size) for _ in azimuth])
        if rotation == axes["SampleRotation"][0]:
            first[incidence] = matrix
        elif rotation - axes["SampleRotation"][0] == 360.0:
            _require_same("SampleRotation", incidence, first[incidence], matrix, path)
            continue
        if azimuth[-1] - azimuth[0] == 360.0:
            _require_same("ScatterAzimuth", incidence, matrix[0], matrix[-1], path)
            yield _block(rotation, incidence, azimuth[:-1], radial, matrix[:-1])
        else:
            yield _block(rotation, incidence, azimuth, radial, matrix)


def _require_same(axis: str, incidence: float, first: Floats, last: Floats, path: Path) -> None:
    """`DataError` unless the values at both ends of a whole turn, which are one direction, agree."""
    for a, b in zip(first.ravel(), last.ravel(), strict=True):
        if not math.isclose(a, b, rel_tol=SAME):
            raise DataError(
                f"{path}: AngleOfIncidence {incidence:g}: both ends of {axis} are one direction, and a value is "
                f"{a:g} at one and {b:g} at the other"
            )


class _Lines:
    """The lines of a file that are no comments, taken one after the other."""

    def __init__(self, text: Text) -> None:
        self.end = text.where(len(text.lines) - 1)
        self.left = (
            (text.where(k), line.split()) for k, line in enumerate(text.lines) if line.strip()[:1] not in ("", "#")
        )

    def take(self, wanted: str) -> tuple[str, list[str]]:
        for where, words in self.left:
            return where, words
        raise DataError(f"{self.end}: the file ends before {wanted}")

    def keyword(self, name: str, allowed: tuple[str, ...] | None) -> list[str]:
        """A line that begins with a keyword; None allows any words after it, () allows none."""
        where, words = self.take(name)
        if words[0] != name:
            raise DataError(f'{where}: "{words[0][:40]}" where {name} is needed')
        if allowed is not None and words[1:] != [word for word in words[1:2] if word in allowed]:
            found = " ".join(words[1:])[:40]
            raise DataError(f'{where}: {name} is "{found}"; read is {", ".join(allowed) or "nothing after it"}')
        return words[1:]

    def axis(self, name: str) -> Floats:
        count = self.keyword(name, None)
        where, words = self.take(f"the angles of {name}")
        wanted = integer(count[0] if count else "", where, f"the count of {name}", 1, 10_000)
        if len(words) != wanted:
            raise DataError(f"{where}: {len(words)} angles, and {name} counts {wanted}")
        angles = np.array(numbers(words, where, [name] * wanted))
        low, high = _LIMITS[name]
        if ((angles < low) | (angles > high)).any() or (np.diff(angles) <= 0).any():
            raise DataError(f"{where}: {name} has to grow within [{low:g}, {high:g}] degrees")
        return angles

    def row(self, count: int) -> list[float]:
        where, words = self.take("the end of its data")
        if len(words) != count:
            raise DataError(f"{where}: {len(words)} values, and ScatterRadial counts {count}")
        return numbers(words, where, [f"value {k + 1}" for k in range(count)])


def _frame(incidence_deg: Floats | float) -> tuple[Floats, Floats, Floats]:
    """The mirror direction, the one from it toward the normal, and their cross product; the source is at azimuth 0."""
    a = np.deg2rad(np.asarray(incidence_deg, dtype=np.float64))
    zero = np.zeros_like(a)
    mirror = np.stack([-np.sin(a), zero, np.cos(a)], axis=-1)
    inward = np.stack([np.cos(a), zero, np.sin(a)], axis=-1)
    return mirror, inward, np.cross(mirror, inward)


def about_mirror(incidence: Floats | float, azimuth: Floats, radial: Floats) -> Floats:
    """Unit vectors at angles [degrees] about the mirror direction; the source is at azimuth 0. Shapes broadcast."""
    alpha, rho = (np.deg2rad(angle)[..., np.newaxis] for angle in (azimuth, radial))
    mirror, inward, side = _frame(incidence)
    return np.asarray(np.cos(rho) * mirror + np.sin(rho) * (np.cos(alpha) * inward + np.sin(alpha) * side))


def _direction(incidence: float, azimuth: Floats, radial: Floats) -> Floats:
    """Unit vectors (azimuths, radials, 3) on a grid of angles [degrees] about the mirror direction."""
    return about_mirror(incidence, *np.meshgrid(azimuth, radial, indexing="ij"))


def _block(rotation: float, incidence: float, azimuth: Floats, radial: Floats, matrix: Floats) -> Floats:
    """theta_i, phi_i, theta_r, phi_r, value of one incidence, without what lies below the surface."""
    x, y, z = np.moveaxis(_direction(incidence, azimuth, radial), -1, 0)
    # rounded far below any instrument's resolution, so that the plane of incidence is exactly 0 and 180 degrees
    theta = np.round(np.rad2deg(np.arctan2(np.hypot(x, y), z)), 9)
    phi = np.where(theta == 0, 180.0, np.round(np.rad2deg(np.arctan2(y, x)), 9))
    keep = theta <= 90
    if radial[0] == 0 and (matrix[:, 0] == matrix[0, 0]).all():
        keep[1:, 0] = False  # the same direction for every azimuth
    count = int(keep.sum())
    start = float(wrap_deg(rotation))
    columns = [np.full(count, incidence), np.full(count, start), theta[keep], wrap_deg(phi[keep] + start), matrix[keep]]
    return np.column_stack(columns)


def write(frame: DataFrame, path: Path) -> None:
    """A table that is a full grid in these angles, as this reader makes it; what is flagged becomes a zero.

    A grid with holes is refused, because every zero would count as a measured darkness.
    """
    single(frame, path, "a Zemax BSDF file")
    if frame["wavelength_nm"].nunique(dropna=False) != 1:
        raise DataError(f"{path}: a Zemax BSDF file holds one wavelength, and this table has several")
    sides = set(frame["side"]) if "side" in frame.columns else {"reflection"}
    if len(sides) > 1:
        raise DataError(
            f"{path}: a Zemax BSDF file holds reflection or transmission, and this table has both: write each side to "
            "a file of its own"
        )
    through = sides == {"transmission"}
    angles = frame[list(ANGLES)].to_numpy(np.float64)
    if through:
        angles[:, 2] = 180.0 - angles[:, 2]
    mirror, inward, side = _frame(angles[:, 0])
    theta, phi = np.deg2rad(angles[:, 2]), np.deg2rad(angles[:, 3] - angles[:, 1])
    omega = geometry.direction(theta, phi)
    along, toward, across = ((omega * axis).sum(axis=-1) for axis in (mirror, inward, side))
    rho = np.round(np.rad2deg(np.arctan2(np.hypot(toward, across), along)), 6)
    alpha = np.where(rho == 0, 0.0, np.round(wrap_deg(np.rad2deg(np.arctan2(across, toward))), 6) % 360.0)
    values = np.where(frame["flag"] == "", frame["brdf"].to_numpy(np.float64), 0.0)
    columns = (angles[:, 1], angles[:, 0], alpha, rho)
    axes = [np.unique(column) for column in columns]
    if max(axis.size for axis in axes) > 10_000 or math.prod(axis.size for axis in axes) > 8 * len(frame) + 1000:
        raise DataError(f"{path}: these directions are no grid of angles about the mirror direction")
    grid = np.full([axis.size for axis in axes], np.nan)
    grid[tuple(np.searchsorted(axis, column) for axis, column in zip(axes, columns, strict=True))] = values
    if axes[3][0] == 0:
        grid[..., 0] = grid[:, :, :1, 0]
    holes = 0
    for a, incidence in enumerate(axes[1].tolist()):
        below = _direction(incidence, axes[2], axes[3])[..., 2] < 1e-9
        holes += int(np.isnan(grid[:, a][:, ~below]).sum())
        grid[:, a][:, below] = np.nan_to_num(grid[:, a][:, below])
    if holes:
        raise DataError(f"{path}: these directions leave {holes} holes in a grid of angles about the mirror direction")
    symmetric = axes[2][-1] <= 180
    wavelength = float(frame["wavelength_nm"].iloc[0])
    lines = [] if math.isnan(wavelength) else [f"# wavelength_nm {wavelength!r}"]
    lines += ["Source\tMeasured", f"Symmetry\t{'PlaneSymmetrical' if symmetric else 'ASymmetrical'}"]
    lines += ["SpectralContent\tMonochrome", f"ScatterType\tB{'T' if through else 'R'}DF"]
    for name, axis in zip(_LISTS, axes, strict=True):
        lines += [f"{name}\t{axis.size}", "\t".join(f"{angle!r}" for angle in axis.tolist())]
    lines += ["", "Monochrome", "DataBegin"]
    for rotation in grid:
        for incidence, matrix in zip(axes[1].tolist(), rotation, strict=True):
            lines.append(f"TIS\t{_tis(incidence, axes[2], axes[3], matrix) * (2 if symmetric else 1):.6f}")
            lines += ["\t".join(repr(value) for value in row) for row in matrix.tolist()]
    write_lines(path, [*lines, "DataEnd"])


def _tis(incidence: float, azimuth: Floats, radial: Floats, matrix: Floats) -> float:
    """Integral of brdf cos(theta_r) over the grid, by trapezia."""
    z, rho = _direction(incidence, azimuth, radial)[..., 2], np.deg2rad(radial)
    return float(
        np.trapezoid(np.trapezoid(matrix * np.maximum(z, 0.0) * np.sin(rho), rho, axis=1), np.deg2rad(azimuth))
    )


FORMAT = Format(
    name="zemax",
    title="Zemax tabular BSDF",
    endings=(".bsdf",),
    sniff=lambda head: (
        b"ScatterRadial" in head
        and re.search(rb"^Source\s+Measured", head, re.MULTILINE) is not None
        and re.search(rb"^\s*AOI\s", head, re.MULTILINE) is None  # of LightTools
    ),
    read=read,
    write=write,
    carries=frozenset({"flag", "transmission"}),
)
