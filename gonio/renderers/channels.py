"""The channels of a renderer's file: one grey, or linear sRGB from colours or from a spectrum."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio import colour, geometry
from gonio.errors import ConfigError, DataError
from gonio.formats import channels
from gonio.formats.reader import ANGLES
from gonio.spectra import CHANNELS_NM
from gonio.typing import DataFrame, Floats

COLOURS = ("red", "green", "blue")


@dataclass(frozen=True)
class Rows:
    """What was measured, a row a pair of directions."""

    name: str
    angles: Floats
    """(n, 3): theta_i, theta_r, and |phi_r - phi_i| in [0, pi] [rad]."""
    values: Floats
    """(n, 1) grey or (n, 3) linear sRGB [1/sr]; what was measured below zero is zero."""
    notes: tuple[str, ...]


def rows(table: DataFrame, name: str, *, wavelength_nm: float | None = None) -> Rows:
    """The unflagged, unpolarised reflection of a table in a renderer's channels.

    One wavelength, or one broad band, is grey. Samples named red, green and blue are the channels. A spectrum becomes
    linear sRGB under D65: a perfect white is 1 in each.

    Parameters
    ----------
    table
        A measurement table, as `gonio.measurement.unpolarised` leaves it.
    name
        Of the sample.
    wavelength_nm
        One of the table's wavelengths, which is then taken as grey.

    Raises
    ------
    ConfigError
        The table has no such wavelength.
    DataError
        Nothing is left, it holds several samples, or its wavelengths make no colour.
    """
    frame, notes, in_colours = _usable(table, name)
    waves = _wavelengths(frame)
    if wavelength_nm is not None:
        near = waves[np.abs(waves - wavelength_nm) < 0.5]
        if in_colours or not near.size:
            known = ", ".join(f"{w:g}" for w in waves) or "none"
            raise ConfigError(f"--wavelength-nm {wavelength_nm:g}: {name} has {known}")
        frame, waves = frame[frame["wavelength_nm"] == near[0]], near[:1]
    if in_colours:
        wide = _of_colours(frame)
        notes.append("the samples red, green and blue are the three channels, as they stand in the file")
        return _rows(name, wide, wide.to_numpy(), notes)
    wide = _of_wavelengths(frame)
    if wide.shape[1] == 1:
        notes.append(f"grey: {f'{waves[0]:g} nm' if waves.size else 'one band'} stands for all three channels")
        return _rows(name, wide, wide.to_numpy(), notes)
    return _in_colour(name, wide, waves, notes)


def spectral(table: DataFrame, name: str) -> tuple[Rows, Floats]:
    """The unflagged, unpolarised reflection of a table with a channel a wavelength, and the wavelengths [nm].

    They grow; samples named red, green and blue are at their nominal wavelengths, and one broad band is at none.
    Parameters and errors are those of `rows`.
    """
    frame, notes, in_colours = _usable(table, name)
    wide = _of_colours(frame)[["blue", "green", "red"]] if in_colours else _of_wavelengths(frame)
    waves = np.array(CHANNELS_NM) if in_colours else wide.columns.to_numpy(np.float64)
    wide = _at_all(wide, notes)
    if len(wide) == 0:
        raise DataError(f"{name}: no direction was measured at every wavelength")
    return _rows(name, wide, wide.to_numpy(), notes), waves[waves > 0.0]


def _usable(table: DataFrame, name: str) -> tuple[DataFrame, list[str], bool]:
    """The rows that count, what is said of them, and whether they are three samples named as colours."""
    notes = []
    samples = table["sample"].unique().tolist() if "sample" in table.columns else []
    parts = {str(s).rpartition(" ")[2]: table[table["sample"] == s] for s in samples}
    if samples and (set(parts) != set(COLOURS) or len(samples) != 3):
        part = channels.incomplete(map(str, samples), "FILE")
        several = f"holds several samples; name one as FILE:SAMPLE: {'; '.join(map(str, samples))}"
        raise DataError(f"{name}: {part or several}")
    usable = (table["flag"] == "") & (table["polarisation"] == "unpolarised") & np.isfinite(table["brdf"])
    usable &= (table["theta_i_deg"] < 90) & (table["theta_r_deg"] < 90)
    left_out = len(table) - int(usable.sum())
    if left_out:
        notes.append(f"{left_out} rows are left out: flagged, polarised, at the horizon or in transmission")
    if not usable.any():
        raise DataError(f"{name}: no row of the table can be used: all are flagged, polarised or in transmission")
    return table[usable], notes, bool(samples)


def _wavelengths(frame: DataFrame) -> Floats:
    waves = np.unique(frame["wavelength_nm"].to_numpy(np.float64))
    return np.asarray(waves[np.isfinite(waves)])


def _of_colours(frame: DataFrame) -> DataFrame:
    """A row a direction, and a column a colour."""
    frame = frame.assign(channel=frame["sample"].str.rpartition(" ")[2])
    return frame.pivot_table(index=list(ANGLES), columns="channel", values="brdf", sort=False)[list(COLOURS)]


def _of_wavelengths(frame: DataFrame) -> DataFrame:
    """A row a direction, and a column a wavelength; 0 where none is told."""
    frame = frame.assign(wavelength_nm=frame["wavelength_nm"].fillna(0.0))
    wide = frame.pivot_table(index=list(ANGLES), columns="wavelength_nm", values="brdf", sort=False)
    return wide.sort_index(axis=1)


def _at_all(wide: DataFrame, notes: list[str]) -> DataFrame:
    """The directions that were measured at every wavelength; a note counts the others."""
    whole = wide.notna().all(axis=1)
    if not whole.all():
        notes.append(f"{int((~whole).sum())} directions are left out, which were not measured at every wavelength")
    return wide[whole]


def _in_colour(name: str, wide: DataFrame, waves: Floats, notes: list[str]) -> Rows:
    """Directions that were measured at several wavelengths, a column each, in linear sRGB."""
    wide = _at_all(wide, notes)
    nm = wide.columns.to_numpy(np.float64)
    if len(wide) == 0 or (nm == 0).any() or ((nm > 380) & (nm < 730)).sum() < 3:
        raise DataError(
            f"{name}: {', '.join(f'{w:g}' for w in waves)} nm make no colour (three visible wavelengths do);"
            " take one with --wavelength-nm"
        )
    visible = (nm >= 360) & (nm <= 830)
    values = colour.SRGB.rgb(colour.xyz(wide.to_numpy()[:, visible], nm[visible]))
    notes.append(f"linear sRGB under D65 of {int(visible.sum())} wavelengths, {nm.min():g} to {nm.max():g} nm")
    return _rows(name, wide, values, notes)


def _rows(name: str, wide: DataFrame, values: Floats, notes: Sequence[str]) -> Rows:
    known = np.isfinite(values).all(axis=1)
    index = np.deg2rad(np.array(wide.index.tolist(), dtype=np.float64).reshape(-1, 4))[known]
    values = values[known]
    dphi = geometry.Directions(*index.T).settled_at_normal().dphi
    dphi = np.minimum(dphi, geometry.TWO_PI - dphi)
    said = list(notes)
    oblique = index[index[:, 0] > geometry.AT_NORMAL, 1]
    if oblique.size:
        turned = np.abs(np.mod(oblique - oblique[0] + np.pi / 2, np.pi) - np.pi / 2)  # of a half turn: the same plane
        if turned.max() > geometry.SAME_AZIMUTH:
            said.append("measured at several azimuths of incidence, which are averaged: a brushed sample loses its own")
    below = int((values < 0).any(axis=1).sum())
    if below:
        said.append(f"{below} of {len(values)} values are below zero (noise, or colours beyond sRGB) and become zero")
    return Rows(name, np.column_stack([index[:, 0], index[:, 2], dphi]), np.maximum(values, 0.0), tuple(said))
