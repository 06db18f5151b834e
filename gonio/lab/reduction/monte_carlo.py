"""The uncertainty of a run by drawing its inputs: a check of the linear budget (GUM supplement 1, JCGM 101:2008).

Every input is drawn from its own distribution, and each value is computed anew from rates on: level of the white
reference, BRDF, and what the angles' errors do to it along curves through the measured values. None of the budget's
columns is drawn, except those that `DrawsCheck.as_columns` names. docs/budget.md says what is drawn, and how.

Limits of a value by drawing the inputs of any measurement equation (GUM supplement 1, JCGM 101:2008).

Numbers are drawn evenly: points of Sobol's sequence, scrambled. A measurement equation is mostly a product whose
factors have no input in common, as a camera's signal and a geometry. Each draw of one factor is then as good with any
draw of the other, so that n draws of both stand for n^2 values. Several scramblings tell how well limits are known.
"""

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import attrgetter

import numpy as np

from gonio.checks.values import NORMAL_95
from gonio.errors import ArgumentError
from gonio.geometry import ANGLES_DEG, Directions
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction.angle_errors import CAUSES, angle_axes, is_behind, turned_over, zero_uncertainties
from gonio.lab.reduction.angle_sensitivity import NARROWEST, from_above
from gonio.lab.reduction.brdf import Reduction
from gonio.lab.reduction.spikes import over_patch, overlap
from gonio.lab.reduction.step_rates import Reduced
from gonio.lab.reduction.table import COMMON, COMPONENTS, DARK, LAMP, PRNU
from gonio.lab.reduction.values import BandResult
from gonio.lab.rig import Pose, kinematics
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.regions import filling
from gonio.typing import ArrayLike, DataFrame, Floats

FEWEST = 100
"""Fewest draws: with fewer the ends of a 95 % interval are not told."""
KEPT = 2.5e7
"""Numbers of all draws that are kept: 200 MB."""
AT_ONCE = 50
"""Draws that are computed together."""
STEP = 1e-4
"""[rad]: of the differences that tell how directions follow the axes, which they do smoothly."""
FORMULA = (*CAUSES.values(), *COMMON, *DARK, *PRNU)
"""Columns whose causes are drawn as inputs."""
COMPUTED = {*COMPONENTS} - {"beam"}
"""Parts of `u_random` that a draw computes or takes by name; others are drawn by their standard uncertainties."""


@dataclass(frozen=True, slots=True)
class DrawsCheck:
    """What the draws say."""

    values: DataFrame
    """Rows as in the table: angles, `wavelength_nm`, `brdf`, `u_brdf`; `mc_mean`, `mc_u`, `mc_low`, `mc_high`, the
    ends of the 95 % interval with equal tails [1/sr]; `delta`, the numerical tolerance of `u_brdf` with one digit;
    `departs`, the larger distance of an end from brdf -+ 1.96 u_brdf; `agrees` ("yes", "no", "undecided" by so many
    draws, "" where there is no value)."""
    draws: int
    every: Floats
    """(draws, values) all draws [1/sr], NaN where there is no value; empty where they are more than `KEPT` numbers."""
    as_columns: list[str]
    """Causes that were drawn as columns of the table, linearly: how they enter the values is not known here."""

    def archive(self) -> bytes:
        """All draws as an npz file: `brdf` (draws, values), and the angles and wavelengths of the values."""
        buffer = io.BytesIO()
        columns = {name: self.values[name].to_numpy(float) for name in (*ANGLES_DEG, "wavelength_nm")}
        np.savez_compressed(buffer, brdf=self.every, **columns)  # type: ignore[arg-type]
        return buffer.getvalue()

    @property
    def verdict(self) -> str:
        """In words."""
        found = self.values["agrees"]
        yes, no, open_ = (int((found == word).sum()) for word in ("yes", "no", "undecided"))
        used = self.values[found != ""]
        ratio = float((used["mc_u"] / used["u_brdf"]).median()) if len(used) else math.nan
        most = f", {open_} are not decided by {self.draws} draws" if open_ else ""
        linear = f"; drawn as linear: {', '.join(self.as_columns)}" if self.as_columns else ""
        return (
            f"the linear budget agrees with {self.draws} draws at {yes} of {yes + no + open_} values{most}"
            f"{f', {no} do not agree' if no else ''} (JCGM 101, 8.1, one digit); u by drawing over u_brdf: median "
            f"{ratio:.3f}{linear}"
        )


def check(
    run: Run, reduction: Reduction, draws: int, seed: int = 0, progress: Callable[[int, int], None] | None = None
) -> DrawsCheck:
    """Draw the inputs of a reduced run, and hold its linear uncertainties against what comes out.

    Parameters
    ----------
    run, reduction
        The run, and what `gonio.lab.reduction.brdf.reduce_in_parts` made of it.
    draws
        How many, at least `FEWEST`.
    seed
        Of the draws.
    progress
        Told how many of the draws are done, and how many there are, over all bands.
    """
    import pandas as pd

    if draws < FEWEST:
        raise ValueError(f"a 95 % interval needs at least {FEWEST} draws, not {draws}")
    table, bands = reduction.table, reduction.bands
    found = np.full((4, len(table)), math.nan)
    kept = np.full((draws, len(table)) if draws * len(table) <= KEPT else (0, 0), math.nan)
    more = [name for name in table.columns if name.startswith("s_") and name not in FORMULA]
    for k, band in enumerate(bands):
        rows = band.rows * len(bands) + k
        if not rows.size:
            continue
        columns = table.loc[rows, more].to_numpy(dtype=float)
        inputs = _Inputs(run.description, Directions.from_table(run.plan)[band.rows], band, np.nan_to_num(columns))
        rng = np.random.default_rng([seed, k])
        drawn = []
        for start in range(0, draws, AT_ONCE):
            drawn.append(inputs.evaluate(rng, min(AT_ONCE, draws - start)))
            if progress is not None:
                progress(k * draws + min(start + AT_ONCE, draws), len(bands) * draws)
        every = np.concatenate(drawn)
        if kept.size:
            kept[:, rows] = every
        ends = np.quantile(every, [0.025, 0.975], axis=0)
        found[:, rows] = [every.mean(axis=0), every.std(axis=0, ddof=1), *ends]
    good = table["flag"].to_numpy() == ""
    mean, u, low, high = np.where(good, found, math.nan)
    value, stated = table["brdf"].to_numpy(dtype=float), table["u_brdf"].to_numpy(dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        delta = 0.5 * 10.0 ** np.floor(np.log10(stated))
        departs = np.maximum(abs(value - NORMAL_95 * stated - low), abs(value + NORMAL_95 * stated - high))
    # an end of the interval scatters by sqrt(p (1 - p) / draws) over the density there
    unsure = math.sqrt(0.025 * 0.975 / draws) / (math.exp(-0.5 * NORMAL_95**2) / math.sqrt(2 * math.pi)) * stated
    agrees = np.where(departs <= delta, "yes", np.where(departs > delta + 2.0 * unsure, "no", "undecided"))
    out = table[[*ANGLES_DEG, "wavelength_nm", "brdf", "u_brdf"]].assign(
        mc_mean=mean, mc_u=u, mc_low=low, mc_high=high, delta=delta, departs=departs
    )
    out["agrees"] = pd.Series(np.where(good, agrees, "").tolist(), dtype=str)
    out.attrs = {}
    if kept.size:
        kept[:, ~good] = math.nan
    return DrawsCheck(out, draws, kept, [name for name in more if name not in LAMP])


class _Inputs:
    """The inputs of one band with their distributions, and the values as a function of them."""

    def __init__(self, description: RigDescription, goals: Directions, band: BandResult, columns: Floats) -> None:
        self._points, self._visits, self._level = band.measured.points, band.measured.visits, band.measured.fitted
        of = band.values
        self._own, self._lobes, self._columns = of.own, of.lobes, columns
        self._geometry_slopes = of.of_readings["geometry_slopes"]
        of_reference = abs(of.common["s_reference"] / np.where(of.brdf != 0, of.brdf, np.inf))
        self._u_rel = float(np.max(of_reference, initial=0.0))
        self._prnu = band.measured.frames.prnu
        self._under = filling(description) == "under"
        self._cones = (
            math.radians(description.lamp.half_angle_deg),
            math.radians(description.camera.lens_half_angle_deg),
        )
        axes = angle_axes(description)
        self._steps = np.array([math.radians(axes[name].encoder_step_deg) for name in axes])
        self._trembles = np.array([math.radians(axes[name].encoder_noise_deg) for name in axes])
        zeros = zero_uncertainties(description)
        self._zeros = np.array([zeros.get(name, 0.0) for name in axes])
        azimuths = [float(goal.phi_i) for goal in goals]
        above = [partial(from_above, azimuth=a) for a in azimuths]
        seen = list(zip(self._points, above, strict=True))
        self._place = np.array([of(_seen(description, p.pose)) for p, of in seen])
        self._turns = np.array([[_by_axis(description, p.pose, axis, of) for axis in axes] for p, of in seen])
        # the lamp itself, seen whole, is as bright wherever it stands
        beam = description.reference.how == "beam"
        which = "theta_r" if self._under else "theta_i"
        self._visit_theta = np.array([0.0 if beam else float(getattr(v.directions, which)) for v in self._visits])
        self._visit_turns = np.array([
            [0.0 if beam else _turn_of(which, description, v, axis) for axis in axes] for v in self._visits
        ])  # fmt: skip
        numbers = [(p.rate, math.sqrt(p.variance), p.time_s, p.pixels, p.shared) for p in self._points]
        self._rate, self._sd, self._times, self._pixels, self._shared = np.array(numbers, dtype=float).T
        self._dark = np.array([p.dark.ravel() for p in self._points])
        self._visit_times = np.array([v.time_s for v in self._visits])
        self._visit_rel = np.array([math.sqrt(v.variance) / v.rate for v in self._visits])
        lobe = self._lobes.lobe
        # asinh(lobe / small) is the lobe's logarithm, and goes through zero
        self._small = max(6.0 * float(np.min(np.hypot(self._own["noise"], self._own["prnu"]))), 1e-300)
        self._log = np.arcsinh(lobe / self._small)
        self._size = np.hypot(lobe, self._small)
        errors = float(np.sum(self._zeros + self._steps + self._trembles))
        reach = sum(self._cones) + 6.0 * errors + math.radians(0.2)
        self._near = (self._lobes.spike > 0) & (_from_mirror(self._place)[1] < reach)
        g, radius = description.geometry, description.acquisition.roi_radius_mm
        patches = [over_patch(p.directions, radius, g.light_distance_mm, g.camera_distance_mm) for p in self._points]
        self._patch = np.array([patch @ _along_x(a) for patch, a in zip(patches, azimuths, strict=True)])
        values, vectors = np.linalg.eigh(self._lobes.u_slopes)
        self._doubts = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        self._curves = _curves(goals, self._place, self._log)

    def evaluate(self, rng: np.random.Generator, count: int) -> Floats:
        """Values [1/sr] of `count` draws, shape (count, points)."""
        own, points, axes = self._own, self._rate.size, self._zeros.size
        zeros = rng.standard_normal((count, axes)) * self._zeros
        level = self._levels(rng, count, zeros)
        rate = self._rate + self._sd * rng.standard_normal((count, points))
        rate = rate + rng.standard_normal((count, self._dark.shape[1])) @ self._dark.T
        value = rate / level * self._gains(rng, count) * (1.0 + self._u_rel * rng.standard_normal((count, 1)))
        errors = zeros[:, None, :] + self._readings(rng, (count, points, axes))
        value = value - self._changes(rng, np.einsum("dpa,pax->dpx", errors, self._turns))
        # what no input quantity stands for, by its standard uncertainty
        rest = [own["region"], own["visits"], np.where(self._lobes.spike > 0, 0.0, own["spike_blur"])]
        others = own["geometry"], self._geometry_slopes, *(own[name] for name in own if name not in COMPUTED)
        rest += [each for each in others if each.any()]
        value = value + sum(part * rng.standard_normal((count, points)) for part in rest)
        value = value + rng.standard_normal((count, self._columns.shape[1])) @ self._columns.T
        return np.asarray(value)

    def _readings(self, rng: np.random.Generator, shape: tuple[int, int, int]) -> Floats:
        """Errors of encoders: within a step, and their noise where there is any."""
        out = self._steps * rng.uniform(-0.5, 0.5, shape)
        return out + self._trembles * rng.standard_normal(shape) if self._trembles.any() else out

    def _levels(self, rng: np.random.Generator, count: int, zeros: Floats) -> Floats:
        """The signal per unit BRDF at the points' times, fitted anew to drawn visits; shape (count, points)."""
        fitted = self._level
        errors = zeros[:, None, :] + self._readings(rng, (count, len(self._visits), zeros.shape[1]))
        moved = np.einsum("dva,va->dv", errors, self._visit_turns)
        light = np.cos(self._visit_theta + moved) / np.cos(self._visit_theta)
        visits = fitted.line(self._visit_times) * (1.0 + self._visit_rel * rng.standard_normal(light.shape)) / light
        of_reading = self._steps**2 / 12.0 + self._trembles**2
        landing = np.sum((np.tan(self._visit_theta)[:, None] * self._visit_turns) ** 2 * of_reading, axis=1)
        weight = 1.0 / ((self._visit_rel**2 + landing) * fitted.line(self._visit_times) ** 2)
        mean = visits @ weight / weight.sum()
        if fitted.unknown:
            return np.asarray(np.repeat(mean[:, None], self._times.size, axis=1))
        after = self._visit_times - np.average(self._visit_times, weights=weight)
        slope = (visits - mean[:, None]) @ (weight * after) / np.sum(weight * after**2)
        line = mean[:, None] + slope[:, None] * (self._times - np.average(self._visit_times, weights=weight))
        # what the lamp may do besides is in the columns, and in the part "visits"
        return np.asarray(fitted.at(self._times) + line - fitted.line(self._times))

    def _gains(self, rng: np.random.Generator, count: int) -> Floats:
        """Mean responsivity of a point's pixels over that of the reference's, some of which are the same."""
        prnu, n, shared = self._prnu, self._pixels, self._shared
        m = max(int(shared.max(initial=0)), max((v.pixels for v in self._visits), default=1))
        reference = rng.standard_normal((count, 1)) / math.sqrt(m)
        own = np.sqrt(np.maximum(1.0 / n - shared**2 / (n**2 * m), 0.0)) * rng.standard_normal((count, n.size))
        return np.asarray((1.0 + prnu * (shared / n * reference + own)) / (1.0 + prnu * reference))

    def _changes(self, rng: np.random.Generator, moved: Floats) -> Floats:
        """What lobe and spike change by where the axes truly stand elsewhere [1/sr]; `moved`: x, y, theta_i, turn."""
        of = self._lobes
        dx, dy, di, _ = np.moveaxis(moved, -1, 0)
        along = dx - di
        log = np.empty(along.shape)
        for k, curve in enumerate(self._curves):
            at = self._place[k, 0] - self._place[k, 2]
            log[:, k] = (
                of.slope[k, 0] / self._size[k] * along[:, k] if curve is None else (curve(at + along[:, k]) - curve(at))
            )
        # beyond what the step along the curve does already
        log += np.einsum("dpx,px->dp", moved, of.slope / self._size[:, None]) - of.slope[:, 0] / self._size * along
        wrong = np.einsum("pxy,dpy->dpx", self._doubts, rng.standard_normal(moved.shape))
        log += np.einsum("dpx,dpx->dp", moved, wrong) / self._size
        before = self._small * np.sinh(self._log)
        after = self._small * np.sinh(self._log + log)
        near = np.flatnonzero(self._near)
        if near.size:
            amplitude = of.spike[near] + of.u_spike[near] * rng.standard_normal((len(along), near.size))
            before = np.broadcast_to(before, after.shape).copy()
            before[:, near] += amplitude * overlap(_from_mirror(self._place[near])[1], *self._cones)
            centre = _from_mirror(self._place[near] + moved[:, near])[0]
            spots = np.linalg.norm(centre[..., None, :] + self._patch[near], axis=-1)
            seen = overlap(2.0 * np.arcsin(np.minimum(0.5 * spots, 1.0)), *self._cones)
            after[:, near] += amplitude * seen.mean(axis=-1)
        if self._under:
            theta = np.hypot(self._place[:, 0], self._place[:, 1])
            turned = np.hypot(self._place[:, 0] + dx, self._place[:, 1] + dy)
        else:
            theta, turned = self._place[:, 2], self._place[:, 2] + di
        return np.asarray(after * np.cos(turned) / np.cos(theta) - before)


def _curves(goals: Directions, place: Floats, log: Floats) -> list[Callable[[Floats], Floats] | None]:
    """For each point the curve of its angle of incidence through the plane, over the distance from the mirror."""
    from scipy.interpolate import Akima1DInterpolator

    out: list[Callable[[Floats], Floats] | None] = [None] * len(place)
    in_plane = abs(place[:, 1]) < NARROWEST
    incidence = np.round(np.degrees(goals.theta_i), 3)
    for value in np.unique(incidence):
        line = np.flatnonzero((incidence == value) & in_plane)
        line = line[np.argsort(place[line, 0] - place[line, 2])]
        at = place[line, 0] - place[line, 2]
        if line.size < 4 or np.diff(at).min() < NARROWEST:
            continue  # points too near to each other tell noise; the reduction's own slopes are used
        curve = Akima1DInterpolator(at, log[line], method="makima", extrapolate=True)
        for k in line:
            out[k] = curve
    return out


def _from_mirror(place: Floats) -> tuple[Floats, Floats]:
    """`Directions.from_mirror` and `Directions.mirror_offset` of places (x, y, theta_i, turn)."""
    x, y, theta_i, _ = np.moveaxis(place, -1, 0)
    d = Directions(theta_i, np.full_like(x, math.pi), np.hypot(x, y), np.arctan2(y, x))
    return d.from_mirror, d.mirror_offset


def _along_x(azimuth: float) -> Floats:
    """Turns vectors of the sample's frame so that the source of a plane of incidence lies at the azimuth pi."""
    c, s = math.cos(math.pi - azimuth), math.sin(math.pi - azimuth)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _seen(description: RigDescription, pose: Pose) -> Directions:
    """Directions of a pose; behind the sample those mirrored at its plane."""
    d = kinematics.directions(description, pose)
    return turned_over(d, is_behind(d))


def _by_axis(description: RigDescription, pose: Pose, axis: str, of: Callable[[Directions], ArrayLike]) -> Floats:
    """How something of the directions follows an axis [1/rad]."""
    places = [replace(pose, **{axis: getattr(pose, axis) + step}) for step in (STEP, -STEP)]
    there, back = (np.asarray(of(_seen(description, place))) for place in places)
    return np.asarray((there - back) / (2.0 * STEP))


def _turn_of(which: str, description: RigDescription, visit: Reduced, axis: str) -> float:
    """How the angle that the signal of the reference has the cosine of follows an axis."""
    # at the normal both lead away from it, and the light does not change to first order
    if float(getattr(visit.directions, which)) < 2.0 * STEP:
        return 0.0
    return float(_by_axis(description, visit.pose, axis, attrgetter(which)))


SCRAMBLINGS = 8
MOST_INPUTS = 21201
"""Most inputs that Sobol's sequence has in scipy."""
TINY = 2.0**-40
"""Numbers are at least this far from 0 and 1, so that a normal number is finite."""
HALVINGS = 50
"""Times that the range in which a limit lies is halved."""

Factor = tuple[Callable[[Floats], Floats], int]
"""Makes numbers (m,) of uniform ones in (0, 1), shape (m, inputs); and how many inputs it has."""


@dataclass(frozen=True)
class Drawn:
    """What draws say of a value: every number of `first` times every number of `rest`."""

    first: Floats
    """(scramblings, m)"""
    rest: Floats
    """(scramblings, m), above 0."""

    @cached_property
    def _sorted(self) -> Floats:
        return np.sort(self.first, axis=None)

    @property
    def mean(self) -> float:
        """Mean of the value."""
        return float(self.first.mean() * self.rest.mean())

    @property
    def u(self) -> float:
        """Its standard deviation."""
        return math.sqrt(max(float((self.first**2).mean() * (self.rest**2).mean()) - self.mean**2, 0.0))

    def probability(self, value: float) -> float:
        """Probability that it is at most `value`."""
        return float(np.searchsorted(self._sorted, value / self.rest, "right").mean() / self.first.size)

    def quantile(self, probability: float) -> float:
        """What it exceeds with a probability of 1 - `probability`."""
        ends = np.outer((self.first.min(), self.first.max()), (self.rest.min(), self.rest.max()))
        low, high = float(ends.min()), float(ends.max())
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.probability(middle) < probability else (low, middle)
        return high


def drawn(factors: Sequence[Factor], *, draws: int = 2**16, seed: int = 0) -> Drawn:
    """Draw a value that is a product of factors which have no input in common.

    Parameters
    ----------
    factors
        One or more. An input of another distribution is the inverse of its cumulative one, as in
        ``scipy.special.ndtri(x[:, 0])`` for a normal number. Those that matter most come first, for the first columns
        are the most even. All factors but the first have to be positive.
    draws
        Of each factor, at least; rounded up to 8 times a power of two.
    seed
        The same one gives the same numbers.

    Raises
    ------
    ArgumentError
        A number is out of its range, or a factor returns another shape, NaN, or what is not positive.
    """
    from scipy.stats import qmc

    if draws < 100:
        raise ArgumentError(f"draws = {draws}: with fewer than 100 no limit is told")
    power = math.ceil(math.log2(draws / SCRAMBLINGS))
    found: list[Floats] = []
    for k, (equation, inputs) in enumerate(factors):
        if not 0 < inputs <= MOST_INPUTS:
            raise ArgumentError(f"factor {k}: inputs = {inputs}: must be from 1 to {MOST_INPUTS}")
        of_all = []
        for stream in np.random.SeedSequence((seed, k)).spawn(SCRAMBLINGS):
            points = qmc.Sobol(inputs, seed=np.random.default_rng(stream)).random_base2(power)
            values = np.asarray(equation(np.clip(points, TINY, 1.0 - TINY)), float)
            if values.shape != (len(points),) or np.isnan(values).any() or (k > 0 and (values <= 0.0).any()):
                what = "positive numbers" if k else "numbers"
                raise ArgumentError(f"factor {k}: must give {len(points)} {what} for inputs {points.shape}")
            of_all.append(values)
        found.append(np.array(of_all))
    if not found:
        raise ArgumentError("factors: name one at least")
    rest = np.prod(found[1:], axis=0) if len(found) > 1 else np.ones((SCRAMBLINGS, 1))
    return Drawn(found[0], rest)
