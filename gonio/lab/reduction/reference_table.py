"""The BRDF of a white reference where a visit looks at it, from the table of its certificate."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.geometry import SAME_ANGLE, TWO_PI, Directions
from gonio.typing import ArrayLike, Bools, DataFrame, Floats

SAME_CURVE = 1e-6
"""Rows whose angles of incidence differ by less [rad] belong to one curve."""


def read(path: str) -> DataFrame:
    """The table of a reference's BRDF; `DataError` where it holds several samples, of which one is the reference."""
    from gonio import measurement

    table = measurement.read(path)
    if "sample" in table.columns:
        listed = "; ".join(table.attrs["samples"])
        raise DataError(
            f"{path}: reference.table holds {len(table.attrs['samples'])} samples, and one is the reference: write that"
            f" one with `gonio convert FILE:SAMPLE OUT.csv`; they are: {listed}"
        )
    table.attrs.setdefault("source_file", path)
    return table


def notes(path: str) -> list[str]:
    """What the reader of a reference's table has to say of it, as sentences."""
    from gonio import measurement

    return [f"reference table {Path(path).name}: {text}" for text in measurement.of_reader(read(path))]


def brdf_of_reference(table: DataFrame, directions: Directions, wavelength_nm: float) -> float:
    """BRDF [1/sr] of a reference in one visit's geometry, from a table of its BRDF.

    Linear in the signed angle of reflection on the curve of the table that has the visit's angle of incidence
    (within `geometry.SAME_ANGLE`) or between the two curves around it, and linear in wavelength. The reference is
    taken for isotropic; only rows without a flag, in the plane of incidence and unpolarised count.

    Raises
    ------
    DataError
        The visit lies outside of the angles or wavelengths of the table, or out of the plane of incidence.
    """
    return _certificate(table, directions).at_wavelength(
        wavelength_nm, float(directions.theta_i), float(_signed(directions))
    )


def u_of_reference(table: DataFrame, directions: Directions, wavelength_nm: float) -> float:
    """Standard uncertainty [1/sr] of `brdf_of_reference`: the table's own, and that of the interpolation.

    The table's is `u_brdf`, or what its `u_random` and `s_` columns make together; it is interpolated like the value,
    as if the values of a table were wrong all alike. The interpolation's is the difference between the straight line
    and a parabola through three values (where the table has but two, t (1 - t) of their difference, t of the way from
    one to the other).

    Raises
    ------
    DataError
        As `brdf_of_reference`; and where a value that is needed has no uncertainty, though others of the table have.
    """
    certificate = _certificate(table, directions)
    at = wavelength_nm, float(directions.theta_i), float(_signed(directions))
    line = certificate.at_wavelength(*at)
    bent = replace(certificate, bent=True).at_wavelength(*at)
    own = 0.0
    if np.isfinite(certificate.u_brdf).any():
        own = replace(certificate, brdf=certificate.u_brdf).at_wavelength(*at)
        if not math.isfinite(own):
            raise DataError(
                f"{certificate.source}: some values have an uncertainty, and those around the measurement of the "
                "reference have none: fill in u_brdf there"
            )
    return math.hypot(own, bent - line)


def stated(table: DataFrame) -> tuple[float, float] | None:
    """Smallest and largest relative standard uncertainty that a table of a reference states; None where it has none."""
    rows = table[(table["flag"] == "") & (table["brdf"] > 0)]
    u = _uncertainties(rows) / rows["brdf"].to_numpy(dtype=float)
    known = u[np.isfinite(u)]
    return (float(known.min()), float(known.max())) if known.size else None


def _certificate(table: DataFrame, directions: Directions) -> "_Certificate":
    source = table.attrs.get("source_file") or "the table of the white reference"
    if not _in_plane(directions):
        raise DataError(
            f"{source}: holds curves in the plane of incidence; the measurement of the reference lies out of it"
        )
    rows = table[table["flag"] == ""]
    if (rows["polarisation"] != "unpolarised").any():
        raise DataError(f"{source}: a table of a white reference must be unpolarised")
    at = Directions.from_table(rows)
    rows, at = rows[_in_plane(at)], at[_in_plane(at)]
    wavelength_nm, brdf = rows["wavelength_nm"].to_numpy(), rows["brdf"].to_numpy()
    return _Certificate(source, wavelength_nm, at.theta_i, _signed(at), brdf, _uncertainties(rows))


@dataclass(frozen=True, slots=True)
class _Certificate:
    """The rows of a reference's table that lie in the plane of incidence."""

    source: str
    wavelength_nm: Floats
    """NaN for a broad band."""
    theta_i: Floats
    signed_theta_r: Floats
    brdf: Floats
    u_brdf: Floats
    """NaN where the table states none."""
    bent: bool = False
    """Interpolate by parabolas instead of by straight lines."""

    def at_wavelength(self, wavelength_nm: float, theta_i: float, signed_theta_r: float) -> float:
        """Between the two wavelengths of the table around a wavelength; of a broad band, its only value."""
        tabulated = np.unique(self.wavelength_nm[np.isfinite(self.wavelength_nm)])
        if tabulated.size == 0:
            return self.at_incidence(math.nan, theta_i, signed_theta_r)
        used = np.array([wavelength_nm]) if wavelength_nm in tabulated else self._used(wavelength_nm, tabulated)
        values = [self.at_incidence(float(known), theta_i, signed_theta_r) for known in used]
        return self._interpolated(wavelength_nm, used, values, f"wavelength_nm = {wavelength_nm:g}")

    def at_incidence(self, tabulated_nm: float, theta_i: float, signed_theta_r: float) -> float:
        """On the curve of an angle of incidence, or between the two curves around it."""
        incidences = np.unique(self.theta_i)
        same = incidences[abs(incidences - theta_i) <= SAME_ANGLE]
        if same.size:
            return self.on_curve(tabulated_nm, float(same[np.argmin(abs(same - theta_i))]), signed_theta_r)
        used = self._used(theta_i, incidences)
        values = [self.on_curve(tabulated_nm, float(incidence), signed_theta_r) for incidence in used]
        return self._interpolated(theta_i, used, values, f"theta_i = {math.degrees(theta_i):g} deg")

    def on_curve(self, tabulated_nm: float, incidence: float, signed_theta_r: float) -> float:
        """On the curve of one of the table's wavelengths and angles of incidence."""
        of_wavelength = (self.wavelength_nm == tabulated_nm) | np.isnan(self.wavelength_nm)
        on = of_wavelength & (abs(self.theta_i - incidence) < SAME_CURVE)
        place = f"theta_r = {math.degrees(signed_theta_r):g} deg at theta_i = {math.degrees(incidence):g} deg"
        return self._interpolated(signed_theta_r, self.signed_theta_r[on], self.brdf[on], place)

    def _interpolated(self, x: float, at: Floats, values: ArrayLike, place: str) -> float:
        """Linear between the values at `at`; up to `SAME_ANGLE` beyond the ends, the value there."""
        _, first, same, count = np.unique(
            np.round(at / SAME_CURVE), return_index=True, return_inverse=True, return_counts=True
        )
        at, values = at[first], np.bincount(same, np.asarray(values)) / count  # of repeats, the mean
        if at.size == 0 or not at[0] - SAME_ANGLE <= x <= at[-1] + SAME_ANGLE:
            raise DataError(f"{self.source}: the measurement of the reference at {place} lies outside of this table")
        if self.bent:
            return _parabola(x, at, values)
        return float(np.interp(x, at, values))

    def _used(self, x: float, known: Floats) -> Floats:
        """Which of the table's curves count: those around x; the three nearest to it for a parabola."""
        around = _around(x, known)
        if not self.bent or around.size < 2 or known.size < 3:
            return around
        nearest: Floats = np.sort(known[np.argsort(abs(known - x), kind="stable")[:3]])
        return np.union1d(around, nearest)


def _parabola(x: float, at: Floats, values: Floats) -> float:
    """Through the three values nearest to x, of which two lie around it; at one of them, and beyond the ends, that."""
    above = int(np.searchsorted(at, x))
    if above in (0, at.size) or x == at[above]:
        return float(values[min(above, at.size - 1)])
    low, high = at[above - 1], at[above]
    t = (x - low) / (high - low)
    line = values[above - 1] + t * (values[above] - values[above - 1])
    thirds = [k for k in (above - 2, above + 1) if 0 <= k < at.size]
    if not thirds:
        return float(line + t * (1.0 - t) * (values[above] - values[above - 1]))
    third = min(thirds, key=lambda k: abs(at[k] - x))
    slope = (values[above] - values[above - 1]) / (high - low)
    curvature = ((values[third] - values[above]) / (at[third] - high) - slope) / (at[third] - low)
    return float(line + curvature * (x - low) * (x - high))


def _uncertainties(rows: DataFrame) -> Floats:
    """`u_brdf` of each row; where it is not stated, of `u_random` and the common causes together."""
    stated: Floats = np.full(len(rows), math.nan)
    if "u_brdf" in rows:
        stated = rows["u_brdf"].to_numpy(dtype=float)
    parts = [name for name in rows if name == "u_random" or str(name).startswith("s_")]
    if not parts:
        return stated
    squares = np.nansum(rows[parts].to_numpy(dtype=float) ** 2, axis=1)
    return np.where(np.isfinite(stated) | (squares == 0.0), stated, np.sqrt(squares))


def _around(x: float, known: Floats) -> Floats:
    """The values of an ascending array next to x: two, or the first or the last; none of an empty one."""
    if not known.size:
        return known
    above = int(np.searchsorted(known, x))
    return np.asarray(known[np.unique(np.clip([above - 1, above], 0, known.size - 1))])


def _in_plane(d: Directions) -> Bools:
    """Whether directions lie in the plane of incidence; every plane holds the normal."""
    turn = np.minimum(d.dphi, TWO_PI - d.dphi)
    at_normal = (d.theta_i < SAME_ANGLE) | (d.theta_r < SAME_ANGLE)
    return np.asarray((np.minimum(turn, np.pi - turn) <= SAME_ANGLE) | at_normal)


def _signed(d: Directions) -> Floats:
    """Signed angle of reflection [rad]; at normal incidence both sides of an isotropic reference are one."""
    return np.where(d.theta_i < SAME_ANGLE, d.theta_r, d.signed)
