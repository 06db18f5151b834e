"""Warm-up, drift and noise of a lamp, from a series of frames of a white surface (docs/calibration.md).

    level(t) = L (1 - a exp(-t/tau) + d t)        t since the lamp was lit [s]

A frame's signal departs from it by shot noise, which the camera's data sheet tells, and by the lamp's own noise, which
is estimated from neighbouring frames without any model. So the model itself can be tested: by the chi-square of the
means of stretches of the series.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.typing import DataFrame, Figure, Floats, Series

COLUMNS = ("time_s", "signal_dn_per_s", "u_shot_dn_per_s", "exposure_s")
FEWEST = 24
"""A shorter series tells neither the noise nor whether the model holds."""
SETTLED = 5e-4
"""What may be left of the warm-up when a measurement begins, relative to the level."""
NEEDED = 16.0
"""By how much the warm-up's two parameters must lower chi-square to be there: a chance of 3e-4."""
TIME_CONSTANTS = 3.0
"""Time constants of the warm-up that a series must last: a shorter one cannot tell the warm-up from a drift."""
STRETCHES = 24
STEEPEST = 0.1
"""Gain an hour from which a rise without a bend is taken for the beginning of a warm-up: lamps that are warm lose."""
REJECTED = 1e-3
"""A series whose stretches depart from the model more rarely than this by chance is refused."""
CLIP = 4.0
"""Standard deviations beyond which a difference of neighbouring frames is no noise, and is left out of its estimate."""
OF_VARIANCE = 35.0 / 9.0
"""Variance of the estimate of a noise's variance sigma^2 from n frames, in sigma^4/n, for equal spacings."""


@dataclass(frozen=True, slots=True)
class Stability:
    """What a series tells of a lamp."""

    level: float
    """Level of the warm lamp, in the unit of the series, without drift."""
    loss: float
    """a: how far below that the lamp is when it is lit; 0 where no warm-up is seen."""
    time_constant_s: float
    """tau; NaN where no warm-up is seen."""
    drift_per_s: float
    covariance: Floats
    """Of level, loss, time_constant_s, drift_per_s; zero where a parameter is not there."""
    noise: float
    """Relative standard deviation of the lamp from frame to frame, shot noise apart."""
    u_noise: float
    shot: float
    """Typical relative shot noise of a frame."""
    chi_square: float
    """Of the stretches around the model."""
    freedom: int
    probability: float
    """Probability of a larger chi-square by chance, with a noise that is an estimate itself."""
    worst: tuple[float, float, float]
    """The stretch that departs most: time [s], relative departure, departure in standard deviations."""
    outliers: Floats
    """Times of single frames that depart by more than five standard deviations [s]."""
    duration_s: float

    def at(self, time_s: Floats) -> Floats:
        """The level at given times."""
        loss = self.loss * np.exp(-time_s / self.time_constant_s) if self.loss else 0.0
        return np.asarray(self.level * (1.0 - loss + self.drift_per_s * time_s))

    @property
    def warm_up_s(self) -> float:
        """How long to wait until less than `SETTLED` of the warm-up is left [s], its uncertainty (k = 2) added."""
        if abs(self.loss) <= SETTLED:
            return 0.0
        logarithm = math.log(abs(self.loss) / SETTLED)
        gradient = np.array([0.0, self.time_constant_s / self.loss, logarithm, 0.0])
        return self.time_constant_s * logarithm + 2.0 * math.sqrt(float(gradient @ self.covariance @ gradient))

    def require_model(self) -> None:
        """Raise `DataError` where the lamp does not follow the model; the message says where it departs."""
        per_hour = 3600.0 * self.drift_per_s
        if not self.loss and per_hour > STEEPEST + 3.0 * 3600.0 * math.sqrt(self.covariance[3, 3]):
            raise DataError(
                f"the lamp gains {100 * per_hour:.2g} % an hour over a series of {self.duration_s:.0f} s: that is the "
                "beginning of a warm-up, and no drift; measure for longer"
            )
        if self.probability >= REJECTED:
            return
        time_s, departure, deviations = self.worst
        raise DataError(
            f"the lamp drifts more than warm-up and steady drift allow: chi-square {self.chi_square:.0f} of "
            f"{self.freedom} degrees of freedom; around {time_s:.0f} s it is {100 * abs(departure):.3g} % "
            f"{'above' if departure > 0 else 'below'} the model ({abs(deviations):.1f} standard deviations). Let it "
            "warm up longer, look after its supply, or divide by a monitor (lamp.monitor)"
        )


def read_series(path: str | Path) -> DataFrame:
    """A series from a CSV with the columns of `COLUMNS`, and `monitor` where there is one.

    Raises
    ------
    DataError
        The file, a column, a time or an exposure is missing or wrong; the message names the first bad row.
    """
    from gonio.lab.calibration.tables import read_numbers

    table = read_numbers(path, COLUMNS, ("monitor",))
    _require(table, "exposure_s", table["exposure_s"] > 0, path, "is no exposure: it must be above 0")
    _require(table, "signal_dn_per_s", table["signal_dn_per_s"] > 0, path, "is no light: it must be above 0")
    _require(table, "u_shot_dn_per_s", table["u_shot_dn_per_s"] >= 0, path, "must not be below 0")
    _require(table, "time_s", table["time_s"].diff().fillna(1.0) > 0, path, "is not later than the row before it")
    _require(table, "time_s", table["time_s"] >= 0, path, "lies before the lamp was lit, from when it counts")
    return table


def _require(table: DataFrame, column: str, good: Series, path: str | Path, what: str) -> None:
    if not good.all():
        row = int(np.flatnonzero(~good.to_numpy())[0])
        raise DataError(f"{path}: row {row + 1}: {column} = {table[column].iloc[row]:g} {what}")


def fit(time_s: Floats, signal: Floats, u_shot: Floats) -> Stability:
    """Fit the model to a series, and test it.

    Parameters
    ----------
    time_s : (n,) array
        Since the lamp was lit [s], growing; n at least `FEWEST`.
    signal : (n,) array
        Of each frame, in any unit, above 0.
    u_shot : (n,) array
        Its standard uncertainty from shot noise and read noise, in the same unit.

    Raises
    ------
    DataError
        The series is too short: it has too few frames, or lasts less than `TIME_CONSTANTS` of the warm-up's.
    """
    if len(time_s) < FEWEST:
        raise DataError(f"the series has {len(time_s)} frames; at least {FEWEST} are needed, over the whole warm-up")
    scale = float(np.mean(signal))
    y, shot = np.asarray(signal, float) / scale, np.asarray(u_shot, float) / scale
    noise, u_noise = noise_of(time_s, y, shot)
    # noise below the rounding of doubles leaves no weights
    variance = shot**2 + np.maximum(noise, 1e-12) ** 2
    parameters, covariance, residuals = _line(time_s, y, variance)
    warm = _warm_up(time_s, y, variance)
    if warm is not None and np.sum(residuals**2) - np.sum(warm[2] ** 2) > NEEDED:
        parameters, covariance, residuals = warm
    level, loss, tau, drift = parameters
    duration = float(time_s[-1] - time_s[0])
    if loss and duration < TIME_CONSTANTS * tau:
        raise DataError(
            f"the series of {duration:.0f} s is too short: the lamp warms up with a time constant of {tau:.0f} s "
            f"(u = {math.sqrt(covariance[2, 2]):.0f} s), and takes {TIME_CONSTANTS:g} of them to be told from a drift; "
            "measure for longer"
        )
    chi_square, freedom, worst = _stretches(time_s, residuals, np.sqrt(variance), 4 if loss else 2)
    from scipy.stats import chi2, f

    # the lamp's noise is known from the frames alone: the variance's estimate has so many degrees of freedom
    known = 2.0 * len(time_s) / OF_VARIANCE
    by_chance = f.sf(chi_square / freedom, freedom, known) if noise > 0.0 else chi2.sf(chi_square, freedom)
    units = np.diag([scale, 1.0, 1.0, 1.0])
    return Stability(
        level=level * scale,
        loss=loss,
        time_constant_s=tau,
        drift_per_s=drift,
        covariance=units @ covariance @ units,
        noise=noise,
        u_noise=u_noise,
        shot=float(np.median(shot)),
        chi_square=chi_square,
        freedom=freedom,
        probability=float(by_chance),
        worst=worst,
        outliers=np.asarray(time_s)[abs(residuals) > 5.0],
        duration_s=duration,
    )


def noise_of(time_s: Floats, y: Floats, shot: Floats) -> tuple[float, float]:
    """Standard deviation of a signal's noise beyond shot noise, and its standard uncertainty.

    From what each frame departs from the line through its two neighbours (Gasser1986), so
    that no slow change counts. Where shot noise explains it all the noise is 0, and its uncertainty a bound.
    """
    a = (time_s[2:] - time_s[1:-1]) / (time_s[2:] - time_s[:-2])
    size = np.sqrt(a**2 + (1.0 - a) ** 2 + 1.0)
    pseudo = (a * y[:-2] + (1.0 - a) * y[2:] - y[1:-1]) / size
    explained = (a**2 * shot[:-2] ** 2 + (1.0 - a) ** 2 * shot[2:] ** 2 + shot[1:-1] ** 2) / size**2
    typical = float(np.median(abs(pseudo))) / 0.6745
    kept = abs(pseudo) <= CLIP * typical if typical > 0 else np.ones(pseudo.size, bool)
    total = float(np.mean(pseudo[kept] ** 2))
    variance = total - float(np.mean(explained[kept]))
    u_variance = math.sqrt(OF_VARIANCE / max(int(np.count_nonzero(kept)), 1)) * total
    noise = math.sqrt(max(variance, 0.0))
    return noise, u_variance / (2.0 * noise) if noise > 0.0 and variance > u_variance else math.sqrt(u_variance)


Fitted = tuple[tuple[float, float, float, float], Floats, Floats]


def _line(time_s: Floats, y: Floats, variance: Floats) -> Fitted:
    weight = 1.0 / np.sqrt(variance)
    design = np.stack([np.ones_like(time_s), time_s], axis=1)
    (level, slope), covariance = _solved(design * weight[:, None], y * weight)
    to = np.array([[1.0, 0.0], [-slope / level**2, 1.0 / level]])
    out = np.zeros((4, 4))
    out[np.ix_([0, 3], [0, 3])] = to @ covariance @ to.T
    return (level, 0.0, math.nan, slope / level), out, (y - design @ [level, slope]) * weight


def _warm_up(time_s: Floats, y: Floats, variance: Floats) -> Fitted | None:
    """The model with its warm-up; None where no time constant that the series could tell makes a fit."""
    from scipy.optimize import least_squares

    weight = 1.0 / np.sqrt(variance)
    shortest, longest = float(np.median(np.diff(time_s))), 3.0 * float(time_s[-1] - time_s[0])

    def linear(tau: float) -> tuple[Floats, Floats]:
        design = np.stack([np.ones_like(time_s), -np.exp(-time_s / tau), time_s], axis=1) * weight[:, None]
        found = _solved(design, y * weight)[0]
        return found, y * weight - design @ found

    taus = np.geomspace(shortest, longest, 40)
    best = float(taus[int(np.argmin([np.sum(linear(tau)[1] ** 2) for tau in taus]))])
    level, below, slope = (float(value) for value in linear(best)[0])

    def residuals(p: Floats) -> Floats:
        return np.asarray((y - p[0] * (1.0 - p[1] * np.exp(-time_s / math.exp(p[2])) + p[3] * time_s)) * weight)

    start = [level, below / level, math.log(best), slope / level]
    scale = [1.0, 0.1, 1.0, 1.0 / longest]
    found = least_squares(residuals, start, x_scale=scale, method="trf", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    level, loss, log_tau, drift = found.x
    tau = math.exp(min(log_tau, 700.0))
    try:
        units = np.array(scale)
        covariance = np.linalg.inv((found.jac * units).T @ (found.jac * units)) * np.outer(units, units)
    except np.linalg.LinAlgError:
        return None
    to = np.diag([1.0, 1.0, tau, 1.0])
    return (float(level), float(loss), tau, float(drift)), to @ covariance @ to, found.fun


def _solved(design: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Least squares with columns scaled to one length, and the covariance; a column of zeros gets 0."""
    length = np.linalg.norm(design, axis=0)
    length[length == 0.0] = 1.0  # a warm-up that was over before the first value
    q, r = np.linalg.qr(design / length)
    inverse = np.linalg.pinv(r) / length[:, None]
    return inverse @ (q.T @ y), inverse @ inverse.T


def _stretches(
    time_s: Floats, residuals: Floats, sigma: Floats, parameters: int
) -> tuple[float, int, tuple[float, float, float]]:
    """Chi-square of the means of stretches, its degrees of freedom, and the stretch that departs most."""
    parts = np.array_split(np.arange(len(time_s)), min(STRETCHES, len(time_s) // 3))
    z = np.array([float(np.sum(residuals[p])) / math.sqrt(p.size) for p in parts])
    worst = int(np.argmax(abs(z)))
    at = parts[worst]
    departure = float(np.mean(residuals[at] * sigma[at]))
    return float(np.sum(z**2)), len(parts) - parameters, (float(np.mean(time_s[at])), departure, float(z[worst]))


def values(found: Stability) -> tuple[dict[str, float], list[str], Floats]:
    """Keys of [lamp] with their values, which of them are uncertain, and their covariance."""
    out = {
        "noise": found.noise,
        "warm_up_s": math.ceil(found.warm_up_s / 10.0) * 10.0,
        "drift_per_hour": 3600.0 * found.drift_per_s,
    }
    names, at = ["drift_per_hour"], [3]
    if found.loss:
        out |= {"warm_up_loss": found.loss, "warm_up_time_constant_s": found.time_constant_s}
        names, at = ["warm_up_loss", "warm_up_time_constant_s", "drift_per_hour"], [1, 2, 3]
    units = np.diag([3600.0 if name == "drift_per_hour" else 1.0 for name in names])
    covariance = np.zeros((len(names) + 1, len(names) + 1))
    covariance[0, 0] = found.u_noise**2
    covariance[1:, 1:] = units @ found.covariance[np.ix_(at, at)] @ units
    return out, ["noise", *names], covariance


def draw(table: DataFrame, found: Stability) -> Figure:
    """The series with the model, and what it departs by."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    time_s, signal = table["time_s"].to_numpy(), table["signal_dn_per_s"].to_numpy()
    smooth = np.linspace(time_s[0], time_s[-1], 400)
    top.plot(time_s, signal, ".", color="0.6", ms=3, label="frames")
    top.plot(smooth, found.at(smooth), color="tab:blue", label="warm-up and drift" if found.loss else "drift")
    top.set(
        ylabel="signal [DN/s]", title=f"noise {100 * found.noise:.3g} %, drift {360000 * found.drift_per_s:+.3g} %/h"
    )
    if found.warm_up_s:
        for axes in (top, bottom):
            axes.axvline(found.warm_up_s, color="tab:orange", ls="--", lw=1, label="lamp.warm_up_s")
    top.legend(fontsize="small")
    bottom.plot(time_s, 100.0 * (signal / found.at(time_s) - 1.0), ".", color="0.6", ms=3)
    bottom.set(xlabel="time since the lamp was lit [s]", ylabel="departure from the model [%]")
    for axes in (top, bottom):
        axes.grid(alpha=0.3)
    return figure
