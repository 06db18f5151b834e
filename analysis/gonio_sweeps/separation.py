"""How well points tell two things apart: the expected chi-square between them, and the rig time to five sigma.

Two predictions differ by d. What the measurement states of itself has the covariance C = diag(u^2) + S S^T, with a
column of S a common cause. Then chi-square of the wrong one exceeds that of the right one by d^T C^-1 d on average. A
rival whose parameters are fitted takes away what its own slopes can imitate: they are columns of S that nothing bounds
[Atkinson1975].
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.observations import DEFAULT_WAVELENGTH_NM, Observations
from gonio_analysis.fitting.optical_constants import read_ior
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.fitting.value_covariance import Covariance
from scipy.optimize import brentq

from gonio import models
from gonio.errors import GonioError
from gonio.geometry import Directions
from gonio.lab.acquisition.duration import Durations
from gonio.lab.reduction import angle_errors
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import SampleDescription
from gonio.typing import Figure, Floats
from gonio_sweeps import expected
from gonio_sweeps.candidates import read

if TYPE_CHECKING:
    from gonio.lab.acquisition.measure import Prepared

SIGMAS = 5.0
"""Standard deviations at which two things count as told apart."""
WIDE = 1e3
"""Standard deviations, of its own range, within which a rival's parameter may be anywhere."""
NOTHING_SEEN = 1e3
"""[1/sr] Uncertainty of a point that shows nothing."""


@dataclass(frozen=True)
class Gathered:
    """What values tell of a difference, common causes and the rival's parameters aside."""

    information: Floats
    """(q, q) of the columns, one standard deviation known beforehand."""
    against: Floats
    """(q,) sum of column times difference over u^2."""
    chi_square: float
    """As if every column were known."""

    @classmethod
    def nothing(cls, columns: int) -> Self:
        """Before the first value."""
        return cls(np.eye(columns), np.zeros(columns), 0.0)

    def with_values(self, difference: Floats, u: Floats, columns: Floats) -> Self:
        """After values with these differences (n,), independent uncertainties (n,) and columns (n, q)."""
        weighted = columns / u[:, None] ** 2
        return replace(
            self,
            information=self.information + weighted.T @ columns,
            against=self.against + weighted.T @ difference,
            chi_square=self.chi_square + float(np.sum((difference / u) ** 2)),
        )

    @property
    def apart(self) -> float:
        """d^T C^-1 d of all values so far."""
        return max(self.chi_square - float(self.against @ np.linalg.solve(self.information, self.against)), 0.0)

    def repeated(self, times: float) -> Self:
        """The same with all visits made `times` times."""
        none = np.eye(self.against.size)
        information = none + times * (self.information - none)
        return replace(self, information=information, against=times * self.against, chi_square=times * self.chi_square)

    def times_to(self, wanted: float) -> float:
        """How often all visits have to be made until `apart` reaches a value: 1 at least, infinite where it never does.

        What is common to all visits stays, so `apart` may have a limit.
        """
        low, high = 1.0, 1e9
        if self.apart >= wanted:
            return 1.0
        if self.repeated(high).apart < wanted:
            return math.inf
        return float(
            math.exp(brentq(lambda x: self.repeated(math.exp(x)).apart - wanted, math.log(low), math.log(high)))
        )

    def gains(self, difference: Floats, u: Floats, columns: Floats) -> Floats:
        """By how much one more value of each row raises `apart`."""
        inverse = np.linalg.inv(self.information)
        left = difference - columns @ (inverse @ self.against)
        return np.asarray(left**2 / (u**2 + np.einsum("nq,qp,np->n", columns, inverse, columns)))


@dataclass(frozen=True)
class Separation:
    """What the points of a plan tell of two samples."""

    names: tuple[str, str]
    directions: Directions
    values: tuple[Floats, Floats]
    """[1/sr] of both, through the instrument."""
    chi_square: Floats
    """(n,) expected of one visit."""
    common: Floats
    """(n,) standard uncertainties [1/sr] by what the whole run has in common."""
    seconds: Floats
    """(n,) rig time of a visit without the way there."""
    apart: float
    """Expected difference of chi-square of the whole plan, with its common causes."""
    apart_fitted: float | None
    """What is left of it where the model of B is fitted to A's values; None where it cannot be."""
    plan_s: float
    """Rig time [s] of the plan."""
    plan_five_sigma_s: float
    """Rig time [s] until the plan, repeated as a whole, tells them apart; infinite where it never does."""

    @property
    def five_sigma_s(self) -> Floats:
        """(n,) rig time [s] until visits to one point alone tell the two apart; infinite where they never do.

        What a run has in common stays however often a point is visited.
        """
        difference = (self.values[1] - self.values[0]) ** 2
        with np.errstate(divide="ignore", invalid="ignore"):
            noise = difference / self.chi_square - self.common**2
            visits = SIGMAS**2 * noise / (difference - (SIGMAS * self.common) ** 2)
            return np.where(visits > 0.0, np.maximum(visits, 1.0) * self.seconds, np.inf)


def separation(prepared: Prepared, a: SampleDescription, b: SampleDescription) -> Separation:
    """What a plan on a rig tells of two samples, if A lies in the holder.

    Parameters
    ----------
    prepared
        What `gonio.lab.acquisition.measure.assessed` made of the plan.
    a, b
        Samples with all their parameters.
    """
    plan, rig, points, _ = prepared
    description = rig.description
    bands = plan.bands(description)
    band = min(bands, key=lambda one: abs(one.centre_nm - DEFAULT_WAVELENGTH_NM))
    poses = [one.pose for one in points if one.pose is not None]
    durations = Durations(description, bands)
    sights = expected.sights_ahead(description, poses, band.centre_nm)
    rows = [sights.of_model(models.build(one.model, one.parameters)) for one in (a, b)]
    seen = expected.Expected(durations, poses).visits(rows[0].brdf)
    difference = rows[1].brdf - rows[0].brdf
    steps = list(rig.schedule(plan, points))
    reached = [row for row, one in enumerate(points) if one.pose is not None]
    level, times = expected.level(durations, steps, dict(zip(reached, rows[0].brdf.tolist(), strict=True)))
    at_s = np.array([times[row] for row in reached])
    wander = level.wander(at_s)
    of_lamp = rows[0].brdf[:, None] * wander.shared
    own = np.abs(rows[0].brdf) * np.sqrt(np.maximum(wander.u**2 - np.sum(wander.shared**2, axis=1), 0.0))
    of_level = level.changes(rows[0].brdf, at_s, description.reference.u_rel)
    columns = np.concatenate([np.stack([*of_level.values(), *rows[0].of_angles.values()], axis=1), of_lamp], axis=1)
    u = np.hypot(independent(seen, rows[0]), own)
    goals = Directions.stack([points[row].point.directions for row in reached])
    u = np.hypot(u, angle_errors.coarse_steps(description, read(description, poses), goals, rows[0].brdf, u))
    gathered = Gathered.nothing(columns.shape[1]).with_values(difference, u, columns)
    causes = tuple(f"common {k}" for k in range(columns.shape[1]))
    alike = replace(sights.at, brdf=rows[0].brdf, covariance=Covariance(u, columns, causes))
    common = np.asarray(np.linalg.norm(columns, axis=1))
    plan_s = durations.parts(steps).total_s
    return Separation(
        names=(a.name, b.name),
        directions=sights.at.directions,
        values=(rows[0].brdf, rows[1].brdf),
        chi_square=difference**2 / (u**2 + common**2),
        common=common,
        seconds=seen.seconds,
        apart=gathered.apart,
        apart_fitted=_fitted(alike, b),
        plan_s=plan_s,
        plan_five_sigma_s=plan_s * gathered.times_to(SIGMAS**2),
    )


def _fitted(values: Observations, b: SampleDescription) -> float | None:
    """Chi-square of B's model, fitted to exact values with their uncertainties."""
    ior = b.parameters.get("ior")
    index = read_ior(ior if isinstance(ior, str) else str(ior)) if ior is not None else None
    try:
        found = fit(values, FitRequest(b.model, ior=index), name=b.name).chi_square
    except GonioError:
        return None
    return None if found is None else float(found)


def independent(seen: expected.ExpectedVisits, rows: expected.PredictedRows) -> Floats:
    """Independent standard uncertainties [1/sr] of visits: noise, and where the axes land."""
    noise = np.where(np.isfinite(seen.u_rel), seen.u_rel * np.abs(rows.brdf), NOTHING_SEEN)
    return np.maximum(np.hypot(noise, rows.u_landing), 1e-12)


def about(s: Separation, most: int = 10) -> tuple[list[str], list[list[str]]]:
    """What is said of a separation; and of the best points angles, both values, chi-square of a visit, and time."""
    order = np.argsort(s.five_sigma_s, kind="stable")[:most]
    d = s.directions
    rows = []
    for k in order:
        angles = [f"{math.degrees(x[k]):.1f}" for x in (d.theta_i, d.theta_r)]
        angles.append(f"{math.degrees(float(d.dphi[k])) % 360.0:.0f}")
        values = [f"{one[k]:.4g}" for one in s.values]
        rows.append([*angles, *values, f"{s.chi_square[k]:.3g}", _duration(float(s.five_sigma_s[k]))])
    when = f"after {_duration(s.plan_five_sigma_s)}" if (s.plan_five_sigma_s > s.plan_s) else "within it"
    head = (
        f"the plan as a whole: expected chi-square between {s.names[0]} and {s.names[1]} {s.apart:.3g} in "
        f"{_duration(s.plan_s)}; five sigma (25) {when}"
    )
    left = "" if s.apart_fitted is None else f"; {s.apart_fitted:.3g} where the model of {s.names[1]} is fitted"
    quick = int(np.count_nonzero(s.five_sigma_s <= s.plan_s))
    return [head + left, f"{quick} of {s.chi_square.size} points alone tell them apart within the plan's time"], rows


def _duration(seconds: float) -> str:
    from gonio.progress import duration

    return duration(seconds) if math.isfinite(seconds) and seconds < 1e9 else "never"


def draw(s: Separation) -> Figure:
    """A map of the time that visits to one point alone take to five sigma."""
    from gonio_analysis.plots import in_plane
    from gonio_analysis.plots.maps import SEQUENTIAL
    from gonio_analysis.plots.style import FAINT
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    d, seconds = s.directions, s.five_sigma_s
    ever = np.isfinite(seconds)
    low, high = (float(seconds[ever].min()), float(seconds[ever].max())) if np.any(ever) else (1.0, 10.0)
    if np.all(d.in_plane):
        levels, y = np.unique(np.round(np.degrees(d.theta_i), 1), return_inverse=True)
        figure = Figure(figsize=(7.2, 1.5 + 0.3 * levels.size), layout="constrained")
        ax = figure.add_subplot()
        x = np.degrees(d.signed)
        in_plane.angle_axis(ax)
        ax.set_yticks(range(levels.size), [f"{v:g}°" for v in levels])
        ax.set(ylim=(-0.6, levels.size - 0.4), ylabel="θi", xlabel="θr: retro side negative, mirror side positive")
    else:
        figure = Figure(figsize=(5.4, 4.6), layout="constrained")
        ax = figure.add_subplot()
        x, y = (np.degrees(d.theta_r) * part for part in (-np.cos(d.dphi), -np.sin(d.dphi)))
        ax.set(aspect="equal", xlim=(-92, 92), ylim=(-92, 92), xlabel="θr: mirror direction to the right")
    ax.scatter(x[~ever], y[~ever], s=14, marker="x", c=FAINT, lw=0.8)
    dots = ax.scatter(
        x[ever], y[ever], s=24, c=seconds[ever], cmap=f"{SEQUENTIAL}_r", norm=LogNorm(low, max(high, 1.1 * low))
    )
    figure.colorbar(dots, ax=ax, label="seconds to five sigma", pad=0.02)
    never = "" if np.all(ever) else "; crosses: never"
    figure.suptitle(
        f"Measurements of one point alone, until {s.names[0]} and {s.names[1]} are told apart{never}", fontsize=10
    )
    return figure


def rival_columns(description: RigDescription, rows: expected.PredictedRows, ranges: Floats) -> Floats:
    """(n, q) changes of values [1/sr] by the reference and the zeros of the axes, and a rival's slopes.

    The slopes are multiplied by a large number, so that the rival's parameters are free.
    """
    common = np.stack([(rows.brdf * description.reference.u_rel), *rows.of_angles.values()], axis=1)
    return np.concatenate([common, rows.parameters * (WIDE * ranges)], axis=1)
