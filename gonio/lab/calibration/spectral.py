"""Centres and widths of bands, from their measured spectra or from lines of known wavelength.

Derived in docs/calibration.md.

Degree and azimuth of polarisation, from a polariser that is turned (docs/calibration.md).

From a spectrum come the centroid and the width at half of the peak; below 2 % of the peak is baseline, and up to 6 %
counts in part. It has to fall below a tenth of its peak at both ends. Lines of known wavelength calibrate the scale of
a source: true = read + offset + slope (read - middle).

A polariser is turned in the beam, before a white that depolarises: the signal is I (1 + P cos 2(angle - azimuth)).
Angles count from the axis of the arms, counterclockwise as seen from the sample.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.lab.calibration.tables import read_numbers
from gonio.lab.rig.light_and_camera import Bands
from gonio.typing import Floats, TomlTable

FLOOR = 0.02
"""Part of the peak: what lies below is baseline, and not of the band. Of its centroid values up to three
times it are a growing part: a cut would move it by where single wavelengths lie."""
FEWEST = 7


@dataclass(frozen=True, slots=True)
class BandSpectrum:
    """A band's centroid, its full width at half maximum [nm], and their standard uncertainties."""

    name: str
    centre_nm: float
    fwhm_nm: float
    u_centre_nm: float
    u_fwhm_nm: float


@dataclass(frozen=True, slots=True)
class Scale:
    """A wavelength scale: true = read + offset + slope (read - middle), the first two uncertain."""

    middle_nm: float
    offset_nm: float
    slope: float
    covariance: Floats
    """Of offset and slope."""
    residual_nm: float
    """Standard deviation of the lines around it."""


def spectra(path: str | Path) -> list[BandSpectrum]:
    """The bands of a table `band, wavelength_nm, signal` and, where known, `u_signal`.

    Raises
    ------
    DataError
        The table is damaged, or the spectrum of a band does not hold it whole.
    """
    table = read_numbers(path, ("wavelength_nm", "signal"), ("u_signal",), words=("band",))
    out = []
    for name, rows in table.groupby("band", sort=False):
        rows = rows.sort_values("wavelength_nm")
        u = rows["u_signal"].to_numpy() if "u_signal" in rows else None
        try:
            out.append(spectrum(str(name), rows["wavelength_nm"].to_numpy(), rows["signal"].to_numpy(), u))
        except DataError as error:
            raise DataError(f"{path}: {error}") from None
    return out


def spectrum(name: str, wavelength_nm: Floats, signal: Floats, u_signal: Floats | None = None) -> BandSpectrum:
    """Centroid and width of a band.

    Without `u_signal` the noise is that by which values depart from the line through their neighbours: too large where
    the spectrum is coarse, never too small.
    """
    x, y = np.asarray(wavelength_nm, float), np.asarray(signal, float)
    if x.size < FEWEST or np.any(np.diff(x) <= 0):
        raise DataError(f'band "{name}": needs at least {FEWEST} wavelengths, each once')
    if u_signal is None:
        u_signal = np.full(x.size, float(np.sqrt(np.mean((0.5 * (y[:-2] + y[2:]) - y[1:-1]) ** 2) / 1.5)))
    top = int(np.argmax(y))
    half = 0.5 * y[top]
    below, above = np.flatnonzero(y[:top] < half), top + np.flatnonzero(y[top:] < half)
    if y[top] <= 0 or not below.size or not above.size or max(y[0], y[-1]) > 0.1 * y[top]:
        raise DataError(
            f'band "{name}": its spectrum from {x[0]:g} to {x[-1]:g} nm does not hold the band whole: it must fall '
            "below a tenth of its peak at both ends"
        )
    left, u_left, by_left = _crossing(x, y, u_signal, int(below[-1]), half)
    right, u_right, by_right = _crossing(x, y, u_signal, int(above[0]) - 1, half)
    # the peak may lie between two wavelengths
    u_half = 0.5 * math.hypot(float(u_signal[top]), 0.25 * float(y[top] - min(y[top - 1], y[top + 1])))
    u_fwhm = math.hypot(u_left, u_right, u_half * (by_left + by_right))
    over = y / (FLOOR * y[top])
    share = np.clip(0.5 * (over - 1.0), 0.0, 1.0)
    width = np.gradient(x)
    total = float(np.sum(y * share * width))
    centre = float(np.sum(x * y * share * width)) / total
    lever = (x - centre) * width * np.where((share > 0.0) & (share < 1.0), share + 0.5 * over, share)
    return BandSpectrum(name, centre, right - left, float(np.linalg.norm(lever * u_signal)) / total, u_fwhm)


def _crossing(x: Floats, y: Floats, u: Floats, k: int, half: float) -> tuple[float, float, float]:
    """Where the line from value k to the next crosses half of the peak, its standard uncertainty, and its shift for a
    change of that half by 1."""
    slope = float((y[k + 1] - y[k]) / (x[k + 1] - x[k]))
    return float(x[k] + (half - y[k]) / slope), float(max(u[k], u[k + 1])) / abs(slope), 1.0 / abs(slope)


def wavelength_scale(path: str | Path) -> Scale:
    """The wavelength scale of a source from a table `line_nm, read_nm` and, where known, `u_nm`.

    `read_nm` is what the source's own scale says where it matches a line of the known wavelength `line_nm`. With one
    line only the offset is found, and needs `u_nm`.

    Raises
    ------
    DataError
        The table is damaged, or holds too little.
    """
    table = read_numbers(path, ("line_nm", "read_nm"), ("u_nm",))
    line, read = table["line_nm"].to_numpy(), table["read_nm"].to_numpy()
    known = table["u_nm"].to_numpy() if "u_nm" in table else None
    if known is not None and (known <= 0).any():
        raise DataError(f"{path}: row {int(np.argmax(known <= 0)) + 1}: u_nm must be above 0")
    if known is None and line.size < 3:
        raise DataError(f"{path}: {line.size} lines without u_nm tell no uncertainty; give u_nm, or at least 3 lines")
    middle, count = float(np.mean(read)), line.size
    columns = 2 if count > 1 and np.ptp(read) > 0 else 1
    design = np.stack([np.ones(count), read - middle], axis=1)[:, :columns]
    weight = 1.0 / (known if known is not None else np.ones(count))
    found, *_ = np.linalg.lstsq(design * weight[:, None], (line - read) * weight, rcond=None)
    residuals = line - read - design @ found
    covariance = np.zeros((2, 2))
    covariance[:columns, :columns] = np.linalg.inv((design * weight[:, None]).T @ (design * weight[:, None]))
    freedom = count - columns
    reduced = float(np.sum((residuals * weight) ** 2)) / freedom if freedom else 1.0
    covariance *= reduced if known is None else max(reduced, 1.0)
    scatter = math.sqrt(float(np.sum(residuals**2)) / max(freedom, 1))
    return Scale(middle, float(found[0]), float(found[1]) if columns == 2 else 0.0, covariance, scatter)


def values(bands: Bands, measured: list[BandSpectrum], scale: Scale | None) -> tuple[TomlTable, list[str], Floats]:
    """Keys of [bands] with their values, which of their numbers are uncertain, and their covariance.

    A spectrum tells of the band that it names; the scale tells of all others.

    Raises
    ------
    DataError
        A spectrum is of no band that the rig file lists; one of a tunable source belongs to no key.
    """
    listed = [band.name for band in bands.list]
    for one in measured:
        if one.name not in listed:
            known = ", ".join(listed) or "none; a tunable source is calibrated by lines"
            raise DataError(f'a spectrum is of band "{one.name}", and the rig file lists: {known}')
    out: TomlTable = {}
    names: list[str] = []
    rows: list[Floats] = []  # of the Jacobian over offset and slope of the scale
    own: list[float] = []  # variances of their own
    spectrum_of = {one.name: one for one in measured}
    entries = []
    for k, band in enumerate(bands.list):
        entry = band.model_dump()
        if (of := spectrum_of.get(band.name)) is not None:
            entry |= {"centre_nm": of.centre_nm, "fwhm_nm": of.fwhm_nm}
            names += [f"bands.list[{k}].centre_nm", f"bands.list[{k}].fwhm_nm"]
            rows += [np.zeros(2), np.zeros(2)]
            own += [of.u_centre_nm**2, of.u_fwhm_nm**2]
        elif scale is not None:
            from_middle = band.centre_nm - scale.middle_nm
            entry["centre_nm"] += scale.offset_nm + scale.slope * from_middle
            names.append(f"bands.list[{k}].centre_nm")
            rows.append(np.array([1.0, from_middle]))
            own.append(0.0)
        entries.append(entry)
    if names:
        out["list"] = entries
    if bands.tunable is not None and scale is not None:
        t = bands.tunable
        from_middle, stretched = t.start_nm - scale.middle_nm, t.step_nm * (1.0 + scale.slope)
        start = t.start_nm + scale.offset_nm + scale.slope * from_middle
        count = round((t.stop_nm - t.start_nm) / t.step_nm)
        out["tunable"] = {"start_nm": start, "step_nm": stretched, "stop_nm": start + count * stretched}
        names += ["bands.tunable.start_nm", "bands.tunable.step_nm"]
        rows += [np.array([1.0, from_middle]), np.array([0.0, t.step_nm])]
        own += [0.0, 0.0]
    jacobian = np.array(rows).reshape(-1, 2)
    covariance = np.diag(np.array(own, dtype=float))
    if scale is not None:
        covariance = covariance + jacobian @ scale.covariance @ jacobian.T
    return out, names, covariance


FEWEST_ANGLES = 6


@dataclass(frozen=True, slots=True)
class Polarised:
    """What a turned polariser tells."""

    degree: float
    azimuth_deg: float
    """In [0, 180)."""
    covariance: Floats
    """Of degree and azimuth [deg]."""


def polarised(path: str | Path) -> Polarised:
    """From a table `polariser_deg, signal` and, where known, `u_signal`: signal = I (1 + P cos 2 (angle - azimuth)).

    Without `u_signal` all values count alike, and their scatter around the curve tells the uncertainty.

    Raises
    ------
    DataError
        The table is damaged, the angles cover too little, or the signal does not follow the curve.
    """
    table = read_numbers(path, ("polariser_deg", "signal"), ("u_signal",))
    angle, y = np.radians(table["polariser_deg"].to_numpy()), table["signal"].to_numpy()
    if len(y) < FEWEST_ANGLES:
        raise DataError(
            f"{path}: {len(y)} angles of the polariser; at least {FEWEST_ANGLES} over half a turn are needed"
        )
    weight = np.ones(len(y))
    if "u_signal" in table:
        if (table["u_signal"] <= 0).any():
            raise DataError(f"{path}: u_signal must be above 0")
        weight = 1.0 / table["u_signal"].to_numpy()
    design = np.stack([np.ones(len(y)), np.cos(2 * angle), np.sin(2 * angle)], axis=1) * weight[:, None]
    normal = design.T @ design
    if np.linalg.cond(normal / normal[0, 0]) > 100.0:
        raise DataError(f"{path}: the angles of the polariser cover too little: turn it over 180 deg in even steps")
    covariance = np.linalg.inv(normal)
    mean, cosine, sine = covariance @ design.T @ (y * weight)
    if mean <= 0:
        raise DataError(f"{path}: the signal is not above 0")
    reduced = float(np.sum((y * weight - design @ [mean, cosine, sine]) ** 2)) / (len(y) - 3)
    covariance *= reduced if "u_signal" not in table else max(reduced, 1.0)
    size = math.hypot(cosine, sine)
    degree, azimuth = size / mean, 0.5 * math.degrees(math.atan2(sine, cosine)) % 180.0
    if degree > 1.0:
        raise DataError(
            f"{path}: the signal would have a degree of polarisation of {degree:.3g}: was the dark left in?"
        )
    at = max(size, math.sqrt(covariance[1, 1]))  # the azimuth of no polarisation is any
    jacobian = np.array(
        [
            [-degree / mean, cosine / (at * mean), sine / (at * mean)],
            [0.0, -0.5 * math.degrees(sine / at**2), 0.5 * math.degrees(cosine / at**2)],
        ]
    )
    return Polarised(degree, azimuth, jacobian @ covariance @ jacobian.T)
