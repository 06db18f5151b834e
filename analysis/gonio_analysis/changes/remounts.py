"""What an instrument repeats to when a sample is taken out and put back: a scale, a zero and the rest.

Several tables of one sample, one a mount, are carried to common directions. Their relative deviations from the mean are
regressed on 1 and on the slope of the mean with the receiver's angle. What is left counts as independent from direction
to direction; `neighbours` says how far that is from true. The brightest directions alone are used (`SHARE`), as weak
signals tell of the instrument's noise. tools/studies/findings.md has figures.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from gonio.errors import DataError
from gonio.shown import finite
from gonio.typing import DataFrame, Figure, Floats
from gonio_analysis.changes.resampling import carry, slope_in_plane
from gonio_analysis.fitting.observations import Observations, observations

SHARE = 0.6
"""Share of the directions that is used, the brightest by their signal f cos(theta_r)."""
FEWEST = 10
"""Common directions that tell a shape."""
TO_SIGMA = 1.4826
"""Standard deviation of normal numbers over the median of their sizes."""
ROUNDING = 1e-9
"""Relative: deviations below this are rounding of the tables' numbers, and have nothing in common."""
CLOSE = math.radians(12.0)
"""Neighbours whose residuals are compared lie no farther apart."""


@dataclass(frozen=True)
class Remounts:
    """Standard uncertainties that a new mount adds to a measurement."""

    names: tuple[str, ...]
    at: Observations
    """The brightest directions; `brdf` is the mean of all mounts [1/sr]."""
    deviations: Floats
    """(mounts, n) relative, from that mean."""
    scales: Floats
    """(mounts,) relative."""
    zeros: Floats
    """(mounts,) [rad] by which the receiver's angle seems turned, toward the mirror direction."""
    u_zero: float
    """How well one such zero is known from the scatter [rad]."""
    typical: float
    """Median relative difference between two mounts."""
    scale: float
    """Standard uncertainty of one mount: relative."""
    zero: float
    """[rad]; 0 where the zeros are not told from none."""
    independent: float
    """Relative, from direction to direction."""
    neighbours: float
    """Correlation of what is left between neighbouring directions: 0 where it is independent; NaN where nothing is
    left, or too few directions have neighbours."""

    @property
    def freedom(self) -> int:
        """Degrees of freedom of scale and zero: one less than there are mounts."""
        return len(self.names) - 1

    def lines(self) -> list[str]:
        """What is said of them."""
        from scipy.stats import chi2

        low, high = (math.sqrt(self.freedom / chi2.ppf(p, self.freedom)) for p in (0.975, 0.025))
        degrees = f"{math.degrees(self.zero):.2g}" if self.zero else "0"
        of_zero = f"zero of the angle: {degrees} deg; one mount's is known to {math.degrees(self.u_zero):.2g} deg"
        alike = f"correlation of what is left between neighbours: {self.neighbours:.2f}"
        alike += "; it is smooth over the directions, and does not average out" * (self.neighbours > 0.3)
        wave = self.at.wavelength_nm[0]
        return [
            f"{len(self.names)} mounts in {len(self.at)} common directions{f' at {wave:g} nm' if wave == wave else ''},"
            f" the brightest {100 * SHARE:g} %",
            f"two mounts differ by {100 * self.typical:.2g} % (median)",
            f"scale: {100 * self.scale:.2g} %, with {self.freedom} degree{'s' * (self.freedom > 1)} of freedom: known "
            f"to a factor of {low:.2g} to {high:.2g} (95 %)",
            of_zero if math.isfinite(self.u_zero) else "zero of the angle: the values are flat, and do not tell it",
            f"independent: {100 * self.independent:.2g} % of each value",
            alike if math.isfinite(self.neighbours) else "nothing is left that neighbours could have in common",
        ]

    def to_json(self) -> dict[str, object]:
        """The numbers, with angles in degrees; None for what the tables do not tell."""
        return {
            "mounts": list(self.names),
            "directions": len(self.at),
            "typical": self.typical,
            "scale": self.scale,
            "zero_deg": math.degrees(self.zero),
            "independent": self.independent,
            "degrees_of_freedom": self.freedom,
            "scales": self.scales.tolist(),
            "zeros_deg": np.degrees(self.zeros).tolist(),
            "u_zero_deg": finite(math.degrees(self.u_zero)),
            "neighbours": finite(self.neighbours),
        }


def remounts(tables: Mapping[str, DataFrame], wavelength_nm: float | None = None) -> Remounts:
    """How mounts of one sample differ.

    Parameters
    ----------
    tables
        Measurement tables by names, one a mount: two at least.
    wavelength_nm
        Of tables with several; otherwise the nearest to 550 nm.

    Raises
    ------
    DataError
        A table has no usable value, or they have too few directions in common.
    """
    sides = {name: observations(table, name).nearest(wavelength_nm)[0] for name, table in tables.items()}
    first, *others = sides
    at, found = sides[first], {first: sides[first].brdf}
    rows = np.arange(len(at))
    for name in others:
        carried = carry(at, sides[name])
        values = np.full(len(at), np.nan)
        values[carried.rows] = carried.value
        found[name] = values
        rows = np.intersect1d(rows, carried.rows)
    values = np.stack([one[rows] for one in found.values()])
    mean = values.mean(axis=0)
    signal = mean * np.cos(at.directions[rows].theta_r)
    bright = np.flatnonzero((signal >= np.quantile(signal, 1.0 - SHARE)) & (mean > 0.0)) if rows.size else rows
    if bright.size < FEWEST:
        raise DataError(f"{' and '.join(sides)}: {bright.size} bright directions in common; {FEWEST} tell a shape")
    shape = replace(
        at.take(rows), brdf=mean, covariance=None, rows=np.arange(rows.size), u_angles=np.zeros(0), u_rel_assumed=None
    )
    slope = slope_in_plane(shape)[bright] / mean[bright]
    y = values[:, bright] / mean[bright] - 1.0
    scales, zeros, left = (np.array(x) for x in zip(*(_regressed(each, slope) for each in y), strict=True))
    independent = math.sqrt(len(sides) / (len(sides) - 1)) * TO_SIGMA * float(np.median(np.abs(left)))
    steep = float(np.linalg.norm(slope - slope.mean()))
    u_zero = independent / steep if steep > ROUNDING else math.inf
    pairs = [np.abs(a - b) for k, a in enumerate(y) for b in y[k + 1 :]]
    where = shape.take(bright)
    mounts = math.sqrt(len(sides) - 1)
    zero = float(np.linalg.norm(zeros)) / mounts
    return Remounts(
        names=tuple(sides), at=where, deviations=y, scales=scales, zeros=zeros, u_zero=u_zero,
        typical=float(np.median(np.concatenate(pairs))), scale=float(np.linalg.norm(scales)) / mounts,
        zero=zero if zero > 2.0 * u_zero else 0.0, independent=independent, neighbours=_alike(left, where),
    )  # fmt: skip


def _regressed(y: Floats, slope: Floats) -> tuple[float, float, Floats]:
    """A scale, a zero and what is left, by a regression that single directions do not pull far."""
    size = max(TO_SIGMA * float(np.median(np.abs(y - np.median(y)))), 1e-9)
    design = np.stack([np.ones(y.size), slope], axis=1)
    found = least_squares(lambda p: (design @ p - y) / size, np.zeros(2), loss="soft_l1", x_scale="jac").x
    return float(found[0]), float(found[1]), np.asarray(y - design @ found)


def _alike(left: Floats, at: Observations) -> float:
    """Correlation of residuals with those of the nearest other direction of the same incidence."""
    source, receiver = at.directions.vectors
    tree = cKDTree(np.concatenate([10.0 * source, receiver], axis=1))  # another incidence is far
    away, near = tree.query(tree.data, k=4)
    new = (away > 1e-6) & (away < CLOSE)
    has, first = new.any(axis=1), new.argmax(axis=1)
    one, other = np.flatnonzero(has), near[has, first[has]]
    clipped = np.clip(left, *np.quantile(left, [0.02, 0.98]))
    pairs = clipped[:, one].ravel(), clipped[:, other].ravel()
    if one.size < FEWEST or min(map(np.ptp, pairs)) < ROUNDING:
        return math.nan
    return float(np.corrcoef(*pairs)[0, 1])


def with_remount(table: DataFrame, known: Remounts) -> DataFrame:
    """A table with this scatter in its budget: columns `s_remount_scale` and `s_remount_zero`, and part of `u_random`.

    A table that states nothing of its own then states this alone, which a note of it says.
    """
    from gonio import measurement

    data = observations(table)
    alone = replace(data, covariance=None, rows=np.arange(len(data)), u_angles=np.zeros(0), u_rel_assumed=None)
    slope = np.zeros(len(table))
    if known.zero:
        slope[data.rows] = slope_in_plane(alone)
    random, common, _ = measurement.uncertainty(table)
    brdf = table["brdf"].to_numpy(float)
    columns = {"s_remount_scale": known.scale * brdf, "s_remount_zero": known.zero * slope}
    own = np.hypot(np.nan_to_num(random), known.independent * np.abs(brdf))
    total = np.sqrt(own**2 + (np.nan_to_num(common) ** 2).sum(axis=1) + sum(each**2 for each in columns.values()))
    out = table.assign(**columns, u_random=own, u_brdf=total)
    out.attrs = dict(table.attrs)
    stated = "" if np.isfinite(random).any() else "; the table states no other uncertainty"
    note = (
        f"a new mount is in the budget, from {len(known.names)} mounts: scale {100 * known.scale:.2g} %, zero "
        f"{math.degrees(known.zero):.2g} deg, independent {100 * known.independent:.2g} %{stated}"
    )
    old = [text for text in out.attrs.get("notes") or [] if not stated or "no uncertainties" not in text]
    out.attrs["notes"] = [*old, note]
    return out


def draw(known: Remounts) -> Figure:
    """Deviations of every mount over the receiver's angle, and what is left of them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[2, 1], sharey=True)
    angle = np.degrees(known.at.directions.along)
    dots = {}
    for name, y in zip(known.names, known.deviations, strict=True):
        dots[name] = left.scatter(angle, 100.0 * y, s=7, alpha=0.5, lw=0)
        right.hist(100.0 * y, bins=40, orientation="horizontal", histtype="step", lw=1.5)
    limit = 100.0 * max(float(np.quantile(np.abs(known.deviations), 0.99)) * 1.2, ROUNDING)  # of mounts that are alike
    left.axhline(0.0, color="0.8", lw=0.8)
    left.set(
        ylim=(-limit, limit), ylabel="deviation from the mean / %",
        xlabel="receiver along the plane of incidence / deg", xticks=range(-90, 91, 30),
    )  # fmt: skip
    right.set(xlabel="directions")
    left.legend(list(dots.values()), list(dots), fontsize=8, loc="best", markerscale=2)
    figure.suptitle(f"Two mounts differ by {100 * known.typical:.2g} % (median)", fontsize=10)
    return figure
