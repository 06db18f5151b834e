"""Raw files of an RT-300S goniometer as LOFT (University of Arizona) writes them: Excel 97 workbooks.

Column 0 of each worksheet holds labels, each further column one measurement: `Azimuth` A, `Incidence` I, signed
`Receive` R [degrees], and the signal `RT` of a red laser (650 nm). The laboratory's own evaluation is

    RT - RT of the blank at the same angles,  minus the smallest such difference,  brdf = that / (pi cos R)

The blank is a workbook `blank*.xls` beside the sample's: of several, the last one that is not dated after the sample.
The mirror half-plane is A = -90 with R > 0, and A = +90 with R < 0: dphi = 90 - A for positive R. Around retro the
receiver stands in the beam: within 10 degrees in R and 30 in azimuth, as the laboratory leaves out, rows are "blocked".
Directions measured twice are both there; those that the blank lacks are "no_blank". A blank that is named (`blank =
"FILE"` in `<name>.columns.toml`) has to have them all, and repeats of its directions count as their mean. The file
states no uncertainties and no solid angles. Where a sample repeats directions often enough, their scatter is the
uncertainty of its signals (the blank's, of its own repeats or else the same); without repeats it stays unknown.

Signals that reach further below zero than above it are refused: shifted to zero they would look like a BRDF. Ten
degrees of freedom of repeats are enough for the uncertainty. What the subtraction adds to the smallest signals is not
in it. `RT` is taken for pi f cos(R): white standard, solid angle and wavelength do not enter. The laboratory's
published list of points, the means of the two half-turns, is reproduced to the last printed digit, 1.1e-6 1/sr. Its
Zemax grid differs from these by up to 4 % in the mirror direction.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gonio.disk import read_file
from gonio.errors import ConfigError, DataError, os_error_as
from gonio.formats import workbook
from gonio.formats.reader import MAX_BYTES, Format, fold, table
from gonio.formats.sheets import Percent, Sheet, no_number, place
from gonio.formats.workbook import OLD, worksheets
from gonio.typing import DataFrame, Floats

_LABELS = ("Azimuth", "Incidence", "Receive", "RT")
_LIMITS = (360.0, 89.0, 89.0, math.inf)
FEWEST_REPEATS = 10
"""Degrees of freedom from which a scatter is stated: it is then known to about a quarter of itself."""

MOST_BELOW = 1.0
"""How far below zero signals may lie, of the largest: a blank by itself, which is noise, reaches 0.5 to 0.8."""


def read(data: bytes, path: Path, blank: Path | None = None) -> DataFrame:
    """The measurement table in an RT-300S workbook; `DataError` says what is wrong with the file, and where.

    `blank` is the blank's workbook, which has to have every direction; by default one beside the file.
    """
    sheets = worksheets(data, path)
    if not any(text.strip() in _LABELS for sheet in sheets for text in _labels(sheet)):
        return workbook.read(data, path)  # a table of somebody's own, whose error says which columns it lacks
    rows = _measurements(sheets, path)
    notes = ["wavelength: 650 nm, the instrument's laser; the file does not state it"]
    named, blank = blank is not None, blank or _blank_beside(path)
    signal = rows[:, 3].copy()
    u = np.full(len(rows), math.nan)
    if blank is None:
        notes.append("no blank measurement (blank*.xls) lies beside the file: none was subtracted")
    else:
        dark_rows = _blank(blank)
        means = {place: (sum(signals) / len(signals), len(signals)) for place, signals in _repeats(dark_rows).items()}
        dark = np.array([means.get(tuple(row), (math.nan, 1)) for row in rows[:, :3].tolist()])
        alone = int(np.isnan(dark[:, 0]).sum())
        if alone == len(signal):
            raise DataError(f"{path}: its blank {blank.name} was measured at none of the file's directions")
        if alone and named:
            a, i, r = rows[np.isnan(dark[:, 0])][0, :3]
            raise DataError(
                f"{path}: {alone} of {len(rows)} directions were not measured with the blank {blank}; the first is"
                f" azimuth {a:g}, incidence {i:g}, receive {r:g} degrees. Measure the blank at them, or lay it beside"
                " the file as blank*.xls and name none: such rows are then flagged"
            )
        signal -= dark[:, 0]
        notes.append(f"blank subtracted: {blank.name}")
        if alone:
            notes.append(f'{alone} of {len(rows)} directions were not measured with the blank: flagged "no_blank"')
        own, theirs = _scatter(rows), _scatter(dark_rows)
        if own is not None:
            u = np.sqrt(own**2 + (own if theirs is None else theirs) ** 2 / dark[:, 1])
            notes.append("uncertainties are from the scatter of directions that were measured several times")
    zero = _zero(signal, blank, path)
    notes.append(f"the smallest signal of the file, {zero:.3g}, is taken as zero, as the laboratory does")
    notes.append("the file states no uncertainties and no solid angles")
    cosine = np.cos(np.deg2rad(rows[:, 2]))
    azimuth, incidence, receive = rows[:, :3].T
    theta_i, phi_i = fold(incidence, 0.0)
    theta_r, phi_r = fold(receive, 90.0 - azimuth)
    blocked = (np.minimum(phi_r, 360.0 - phi_r) <= 30.0) & (np.abs(theta_r - theta_i) <= 10.0)
    return table(
        theta_i_deg=theta_i,
        phi_i_deg=phi_i,
        theta_r_deg=theta_r,
        phi_r_deg=phi_r,
        wavelength_nm=650.0,
        brdf=(signal - zero) / (np.pi * cosine),
        u_brdf=u / (np.pi * cosine),
        u_random=u / (np.pi * cosine),
        flag=np.select([blocked, np.isnan(signal)], ["blocked", "no_blank"], ""),
        attrs={"source_file": str(path), "sample": path.stem, "notes": notes},
    )


def _zero(signal: Floats, blank: Path | None, path: Path) -> float:
    """The smallest signal; `DataError` where it lies so far below zero that it is no noise of a dark detector."""
    low, high = float(np.nanmin(signal)), float(np.nanmax(signal))
    if low < 0 and -low > MOST_BELOW * high:
        less = f", less those of the blank {blank.name}," if blank is not None else ""
        raise DataError(
            f"{path}: its signals{less} go from {low:.4g} to {high:.4g}: below zero they are no reflected light, and"
            f" at most {MOST_BELOW:g} of the largest one is noise that can be taken as zero; "
            + (
                f"is this the sample's blank? Name another, blank = 'FILE', in {path.stem}.columns.toml"
                if blank is not None
                else "is RT exported as it is?"
            )
        )
    return low


def _measurements(sheets: Sequence[Sheet], path: Path) -> Floats:
    """Azimuth, incidence, receive [degrees] and RT of each measurement, over all worksheets."""
    rows = []
    for number, sheet in enumerate(sheets, start=1):
        labels = _labels(sheet)
        if not all(label in labels for label in _LABELS):
            if sheet:
                missing = ", ".join(label for label in _LABELS if label not in labels)
                raise DataError(f"{path}, worksheet {number}: column 0 has no label {missing}")
            continue
        for column in sorted({column for _, column in sheet if column > 0}):
            values = [sheet.get((labels[label], column)) for label in _LABELS]
            for label, value, limit in zip(_LABELS, values, _LIMITS, strict=True):
                if (
                    not isinstance(value, float)
                    or not math.isfinite(value)
                    or abs(value) > limit
                    or isinstance(value, Percent)
                ):
                    at = place(f"{path}, worksheet {number}", labels[label], column)
                    raise DataError(f"{at}: {label} is {no_number(value)}")
            rows.append(values)
    if not rows:
        raise DataError(f"{path}: the workbook holds no measurement")
    return np.array(rows, dtype=np.float64)


def _blank(path: Path) -> Floats:
    """The measurements of a blank."""
    with os_error_as(ConfigError, f"{path}: the blank cannot be read"):
        return _measurements(worksheets(read_file(path, MAX_BYTES), path), path)


def _repeats(rows: Floats) -> dict[tuple[float, ...], list[float]]:
    """Signals of each direction."""
    found: dict[tuple[float, ...], list[float]] = {}
    for *direction, signal in rows.tolist():
        found.setdefault(tuple(direction), []).append(signal)
    return found


def _scatter(rows: Floats) -> float | None:
    """Standard deviation of one signal, pooled over directions measured several times; None where those are few."""
    several = [np.array(signals) for signals in _repeats(rows).values() if len(signals) > 1]
    freedom = sum(len(signals) - 1 for signals in several)
    if freedom < FEWEST_REPEATS:
        return None
    return math.sqrt(sum(float(((signals - signals.mean()) ** 2).sum()) for signals in several) / freedom)


def _labels(sheet: Sheet) -> dict[str, int]:
    """Texts of column 0, and their rows."""
    return {text.strip(): row for (row, column), text in sheet.items() if column == 0 and isinstance(text, str)}


def _blank_beside(path: Path) -> Path | None:
    if path.name.lower().startswith("blank"):
        return None
    blanks = [p for p in path.parent.glob("*.xls") if p.name.lower().startswith("blank")]
    earlier = [p for p in blanks if _date(p) <= _date(path)]
    return max(earlier or blanks, key=lambda p: (_date(p), p.name), default=None)


def _date(path: Path) -> str:
    found = re.findall(r"(?<!\d)20\d{6}(?!\d)", path.stem)
    return found[-1] if found else ""


FORMAT = Format(
    name="rt300s",
    title="RT-300S workbook (LOFT)",
    endings=(".xls",),
    sniff=lambda head: head.startswith(OLD),
    read=read,
    max_bytes=64 * 2**20,
)
