"""Which rows of a table a fit uses, why others are left out, and how well the values are known."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gonio import measurement, polarisation
from gonio.geometry import AT_HORIZON, Directions
from gonio.typing import Bools, DataFrame, Floats
from gonio_analysis.fitting.value_covariance import Covariance

TRANSMISSION = "of transmission"
"""Why rows behind the sample are not here."""
AT_ONCE = 1 << 17
"""Rows whose uncertainties are looked at together."""
RESOLUTION = 1e-15
"""Of a value, and of a middling one of its table: what is smaller than their rounding is no uncertainty."""
MOST_LISTED = 12
"""Rows that a note names."""
SEEN = 3.0
"""Standard uncertainties that a value is above zero by, for its neighbours to be measured by it."""
BEYOND, AROUND = 30.0, 3
"""A value with u beyond so many times the median of so many seen ones around it says nothing that they do not."""
STEEP = 3.0
"""What half vectors count, beside directions of the detector, where neighbours are sought: lobes follow them."""
DIRECT = 100_000
"""Pairs of places whose distances are all taken: more are worth the 0.3 s that the import of a tree takes."""
LARGEST = 1e30
"""[1/sr] No BRDF: a perfect mirror seen through a cone of a nanoradian has less. Squares of such values overflow."""

Some = npt.NDArray[np.int32] | slice
"""Rows of a table."""


@dataclass(frozen=True)
class UsableRows:
    """The rows of a table that count."""

    keep: npt.NDArray[np.int32]
    omitted: Mapping[str, Floats]
    """Wavelengths [nm] of the others, by the reason why they are left out."""
    unused: Bools
    """Which of the others might say something of their directions: all but those that are known too poorly."""
    notes: list[str]
    known: Callable[[Some], Covariance]
    stated: Bools
    """Which rows of the table state an uncertainty that can weigh them."""

    def covariance(self, some: Some) -> Covariance | None:
        """That of the rows that count, as `some`; None where not one of them states an uncertainty."""
        return self.known(some) if self.stated[self.keep].any() else None


def usable(
    table: DataFrame, directions: Directions, wavelength_nm: Floats, brdf: Floats, *, polarised: bool
) -> UsableRows:
    """Choose rows, and count by reason what is left out.

    Left out is what cannot be used (`_why_left_out`), rows without an uncertainty in a table that states one elsewhere,
    and rows that are known so poorly that they say nothing.
    """
    why, reasons = _why_left_out(table, directions, brdf, polarised)
    known, stated, seen = _stated(table, brdf, why == 0)
    notes = []
    if stated[why == 0].any() and (lacking := (why == 0) & ~stated).any():
        why[lacking] = len(reasons)
        reasons.append("without an uncertainty")
        notes.append(_lacking(np.flatnonzero(lacking)))
    unused = why != 0
    empty = _saying_nothing(directions, wavelength_nm, np.abs(brdf), (why == 0) & stated, seen, known)
    why[empty] = len(reasons)
    reasons.append(f"with u beyond {BEYOND:g} times the values around")
    keep = np.arange(len(table), dtype=np.int32)
    if why.any():
        keep = keep[why == 0]
    of_reasons = (
        (reasons[k], wavelength_nm[why == k]) for k in sorted(range(1, len(reasons)), key=reasons.__getitem__)
    )
    omitted = {reason: waves for reason, waves in of_reasons if waves.size}
    return UsableRows(keep, omitted, unused, notes, known, stated)


def _why_left_out(
    table: DataFrame, directions: Directions, brdf: Floats, polarised: bool
) -> tuple[npt.NDArray[np.int32], list[str]]:
    """Why each row of a table is not used, by its place among the reasons; 0 for those that may be.

    Transmission, which no model here describes; flagged rows, and polarised ones; values that are not finite or beyond
    any mirror; directions at or below the horizon.
    """
    import pandas as pd

    codes, flags = pd.factorize(table["flag"])
    empty = [str(flag) == "" for flag in flags] + [True]  # the last: a row without a flag
    why = np.array([0 if none else k for k, none in enumerate(empty, 1)], np.int32)[codes]
    del codes
    reasons = ["", *(f"flagged {flag}" for flag in flags)]

    def leave_out(which: npt.NDArray[np.bool_], reason: str) -> None:
        why[which] = len(reasons)
        reasons.append(reason)

    if "side" in table.columns:
        leave_out((table["side"] == "transmission").to_numpy(), TRANSMISSION)
    if not polarised:
        leave_out((why == 0) & (table["polarisation"] != polarisation.UNPOLARISED).to_numpy(), "polarised")
    leave_out((why == 0) & ~np.isfinite(brdf), "without a value")
    leave_out((why == 0) & (np.abs(brdf) > LARGEST), f"beyond {LARGEST:g} 1/sr")
    horizon = np.maximum(directions.theta_i, directions.theta_r) >= np.pi / 2 - AT_HORIZON
    leave_out((why == 0) & horizon, "at the horizon")
    return why, reasons


def _saying_nothing(
    directions: Directions,
    wavelength_nm: Floats,
    size: Floats,
    used: npt.NDArray[np.bool_],
    seen: npt.NDArray[np.bool_],
    known: Callable[[Some], Covariance],
) -> npt.NDArray[np.intp]:
    """Rows within 3 u of zero whose u is far beyond the values (of `size`) around them: they change no fit.

    They would count all the same: among the degrees of freedom, in the scale of logarithms, as blocks of directions.
    """
    rows, out = np.flatnonzero(used & ~seen), [np.zeros(0, np.intp)]

    def places(which: npt.NDArray[np.intp]) -> Floats:
        d = directions[which]
        omega_i, omega_r = Directions(d.theta_i, np.zeros(d.shape), d.theta_r, d.phi_r - d.phi_i).vectors
        half = omega_i + omega_r
        return np.hstack([STEEP * half / np.linalg.norm(half, axis=1, keepdims=True), omega_r])

    for wave in np.unique(wavelength_nm[rows]):
        same = np.isnan(wavelength_nm) if np.isnan(wave) else wavelength_nm == wave
        here, others = rows[same[rows]], np.flatnonzero(used & seen & same)
        if others.size >= AROUND:
            near = others[_nearest(places(here), places(others))]
            u = known(here.astype(np.int32)).total
            out.append(here[u > BEYOND * np.median(size[near], axis=1)])
    return np.concatenate(out)


def _nearest(places: Floats, others: Floats) -> npt.NDArray[np.intp]:
    """The `AROUND` nearest of other places (m, k) to each of some (n, k), in any order."""
    if len(places) * len(others) <= DIRECT:
        square = np.sum((places[:, None] - others) ** 2, axis=2)
        return np.argpartition(square, AROUND - 1, axis=1)[:, :AROUND]
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(others).query(places, AROUND)[1])


def _stated(
    table: DataFrame, brdf: Floats, used: npt.NDArray[np.bool_]
) -> tuple[Callable[[Some], Covariance], npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """What gives the covariance of some rows of a table, which rows state an uncertainty that can weigh them, and
    which are `SEEN`."""
    causes = [name.removeprefix("s_") for name in table.columns if name.startswith("s_")]
    random, common = np.empty(len(table)), np.empty((len(table), len(causes)))
    stated, seen = np.empty((2, len(table)), dtype=bool)
    sizes = brdf[used]
    middling = np.median(np.abs(sizes, out=sizes), overwrite_input=True) if sizes.size else 0.0
    del sizes
    for begin in range(0, len(table), AT_ONCE):
        some = slice(begin, begin + AT_ONCE)
        own, of_causes, _ = measurement.uncertainty(table if len(table) <= AT_ONCE else table.iloc[some])
        common[some] = np.where(np.isfinite(of_causes), of_causes, 0.0)
        total = np.sqrt(own**2 + (common[some] ** 2).sum(axis=1))
        with np.errstate(invalid="ignore"):
            stated[some] = np.isfinite(total) & (total > RESOLUTION * np.maximum(np.abs(brdf[some]), middling))
            seen[some] = np.abs(brdf[some]) > SEEN * total
        # a value whose independent part is 0 (an ideal rig) would have infinite weight
        random[some] = np.maximum(own, 1e-6 * total)
    return lambda rows: Covariance(random[rows], common[rows], tuple(causes)), stated, seen


def _lacking(rows: npt.NDArray[np.intp]) -> str:
    """What is said of rows that state no uncertainty in a table that does."""
    listed = ", ".join(str(row + 1) for row in rows[:MOST_LISTED]) + (", ..." if rows.size > MOST_LISTED else "")
    many = f"{rows.size} rows state" if rows.size > 1 else "1 row states"
    return (
        f"{many} no uncertainty that can weigh them (none, 0, or less than the rounding of the value), and no fit, "
        f"chi-square or verdict here counts them: row{'s' * (rows.size > 1)} {listed} of the table."
    )
