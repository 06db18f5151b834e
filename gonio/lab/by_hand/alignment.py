"""The zeros of a rig's axes, from scans of the camera over the lamp: in a mirror, and straight through an empty holder.

With L and C what the encoders of light and camera show, and z the zeros that are sought (what an encoder shows where
its axis truly stands at 0),

    mirror:            (C - z_camera) = -(L - z_light)            so that  L + C = z_light + z_camera
    straight through:  (C - z_camera) = (L - z_light) -+ 180 deg  so that  C - L +- 180 deg = z_camera - z_light

Either alone leaves one combination open; both fix both zeros, against the normal of the mirror. Tilt and azimuth are
scanned over the mirror's reflection, which is brightest where they stand at 0. Angles are degrees here: they are what a
person reads, and what stands in the file of scans.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gonio.disk import put
from gonio.errors import DataError
from gonio.lab.rig.description import RigDescription
from gonio.typing import DataFrame, Figure, Floats

HOLDERS = ("mirror", "empty")
ALIGNED = ("light", "camera", "tilt", "azimuth")
"""Axes that a mirror and an empty holder say something of; nothing here changes when the sample spins."""
COLUMNS = (
    "scan", "holder", "axis", "light_encoder_deg", "camera_encoder_deg", "tilt_encoder_deg", "azimuth_encoder_deg",
    "signal", "u_signal", "exposure_s", "lamp_level", "clipped",
)  # fmt: skip
"""Of the file of scans. Encoders: without any zero offset taken out. `signal`: mean of the patch in the middle of the
frame [DN/s]; `u_signal` its standard uncertainty; `lamp_level` is NaN for the rig file's own; `clipped`: the fraction
of the patch that was saturated."""
FEWEST = 7
FLANK = 6
"""Points on the flanks of a spot that are enough to tell where its edges are."""
FLAT = 1.3
"""A scan whose highest signal is less than this times its lowest shows no spot."""
FEW = 3
"""Degrees of freedom above which the variance of a Student distribution is finite: n / (n - 2)."""


@dataclass(frozen=True, slots=True)
class Peak:
    """The spot in one scan: A exp(-|(x - centre) / width|^power) + background, alike on both sides of its centre."""

    centre: float
    u: float
    """Standard uncertainty of the centre, of fit and encoder steps [deg]."""
    width: float
    power: float
    height: float
    background: float

    @property
    def fwhm(self) -> float:
        """Its full width at half height [deg]."""
        return 2.0 * self.width * float(math.log(2.0) ** (1.0 / self.power))

    def at(self, x: Floats) -> Floats:
        """The fitted signal at angles [deg]."""
        return _form(x, self.centre, self.width, self.power, self.height, self.background)


@dataclass(frozen=True, slots=True)
class AlignedZero:
    """The zero of one axis, and where its uncertainty comes from [deg]."""

    offset_deg: float
    """What the encoder shows where the axis stands at 0."""
    parts: dict[str, float]
    """Standard uncertainties by cause: scans (their encoder's steps included), backlash, linearity.

    Scans at a few angles do not show all errors of an encoder: those that they show stand for the others.
    """

    @property
    def u_deg(self) -> float:
        """Combined standard uncertainty."""
        return math.hypot(*self.parts.values())


@dataclass(frozen=True, slots=True)
class Alignment:
    """What the scans say of the zeros."""

    zeros: dict[str, AlignedZero]
    """Zeros of the axes that are determined."""
    axes: tuple[str, ...]
    """Axes of the rows and columns of `covariance`, which is that of the scans alone [deg^2]."""
    covariance: Floats
    rank: int
    departure_deg: float
    """Standard deviation of the scans about the zeros, beyond what their fits explain: encoders that are not linear,
    landings that do not repeat."""
    open: tuple[str, ...]
    """In words, what remains undetermined."""
    scans: DataFrame
    """A row a scan: `holder, axis, at_deg` (light), `centre_deg, u_deg, fwhm_deg, residual_deg`."""
    peaks: dict[int, Peak] = field(default_factory=dict)


def _form(x: Floats, centre: float, width: float, power: float, height: float, background: float) -> Floats:
    """A spot, as of `Peak`."""
    return np.asarray(height * np.exp(-((np.abs(x - centre) / width) ** power)) + background)


def peak(x: Floats, signal: Floats, u_signal: Floats, step_deg: float) -> Peak | None:
    """The spot in a scan, or None where there is none.

    Parameters
    ----------
    x
        Encoder angles [deg].
    signal, u_signal
        In any unit, with standard uncertainties.
    step_deg
        Of the encoder: a reading may be off by half of it, which moves a point along the flank of the spot.

    Notes
    -----
    The form is a stand-in for lamps and lenses of any size. It is symmetric as they are, which is what its centre rests
    on. Its misfit widens the uncertainty.
    """
    from scipy.optimize import least_squares

    order = np.argsort(x)
    x, signal, u_signal = x[order], signal[order], u_signal[order]
    low, high = float(signal.min()), float(signal.max())
    if len(x) < FEWEST or high - low < 5.0 * float(np.median(u_signal)) or high < FLAT * max(low, 0.0):
        return None
    bright = x[signal > 0.5 * (low + high)]
    spacing = float(np.ptp(x)) / (len(x) - 1)
    start = np.array([float(bright.mean()), 0.5 * max(float(np.ptp(bright)), spacing), 3.0, 1.0, 0.0])
    scaled, u_scaled = (signal - low) / (high - low), np.maximum(u_signal / (high - low), 1e-4)

    bounds = ([x[0] - spacing, 0.2 * spacing, 1.2, 0.2, -0.5], [x[-1] + spacing, float(np.ptp(x)), 30.0, 5.0, 0.8])
    sigma = np.hypot(u_scaled, 0.02)
    for _ in range(4):  # how much a step of the encoder matters depends on the slope, which the fit finds
        found = least_squares(lambda p, s=sigma: (_form(x, *p) - scaled) / s, np.clip(start, *bounds), bounds=bounds)
        start = found.x
        slope = (_form(x, start[0] + 1e-3, *start[1:]) - _form(x, *start)) / 1e-3
        sigma = np.hypot(u_scaled, np.hypot(slope, 0.1 / max(start[1], spacing)) * step_deg / math.sqrt(12.0))
        sigma = np.maximum(sigma, 1e-3)
    misfit = max(1.0, float(np.sum(found.fun**2)) / max(len(x) - 5, 1))
    try:
        u = math.sqrt(float(np.linalg.pinv(found.jac.T @ found.jac)[0, 0]) * misfit)
    except np.linalg.LinAlgError:
        return None
    shape = _form(x, *start) - start[4]
    flank = int(np.count_nonzero((shape > 0.05 * start[3]) & (shape < 0.95 * start[3])))
    known_steps = step_deg / math.sqrt(12.0 * max(flank, 1))
    unseen = spacing / math.sqrt(24.0) * max(0.0, 1.0 - flank / FLANK)  # two edges, anywhere between two points
    u = max(u, math.hypot(known_steps, unseen))
    centre, width, power, height, background = (float(v) for v in start)
    span = high - low
    return Peak(centre, u, width, power, height * span, background * span + low)


def _equation(axes: Sequence[str], axis: str, holder: str, at: float, centre: float) -> tuple[Floats, float]:
    """What a peak at `centre` says of the zeros: how they add up, and to what [deg]; `at` is where the light stood."""
    row = np.zeros(len(axes))
    if axis != "camera":
        row[axes.index(axis)] = 1.0
        return row, centre
    row[axes.index("camera")] = 1.0
    row[axes.index("light")] = 1.0 if holder == "mirror" else -1.0
    return row, centre + (at if holder == "mirror" else math.copysign(180.0, at - centre) - at)


def align(table: DataFrame, description: RigDescription) -> Alignment:
    """The zeros that a table of scans leads to.

    Parameters
    ----------
    table
        With the columns `COLUMNS`, of any number of scans.
    description
        The rig: its axes, encoder steps, backlash and approach.

    Raises
    ------
    DataError
        A column is missing, or a scan shows no spot.
    """
    import pandas as pd

    for name in COLUMNS:
        if name not in table:
            raise DataError(f"this is no file of scans: the column {name} is missing")
    known = description.axes()
    axes = tuple(name for name in ALIGNED if name in known)
    rows, values, variances, about, peaks = [], [], [], [], {}
    for number, scan in table.groupby("scan", sort=True):
        holder, axis = str(scan["holder"].iloc[0]), str(scan["axis"].iloc[0])
        if holder not in HOLDERS or axis not in axes:
            raise DataError(f'scan {number}: holder = "{holder}", axis = "{axis}": no such scan of this rig')
        x = scan[f"{axis}_encoder_deg"].to_numpy(float)
        signal, u_signal = scan["signal"].to_numpy(float), scan["u_signal"].to_numpy(float)
        found = peak(x, signal, u_signal, known[axis].encoder_step_deg)
        if found is None:
            raise DataError(f"scan {number} ({axis}, holder {holder}) shows no spot: take it again")
        at = float(scan["light_encoder_deg"].mean())
        row, value = _equation(axes, axis, holder, at, found.centre)
        steps = known["light"].encoder_step_deg / math.sqrt(12.0) if axis == "camera" else 0.0
        rows.append(row)
        values.append(value)
        variances.append(found.u**2 + steps**2)
        about.append({"scan": number, "holder": holder, "axis": axis, "at_deg": at, "centre_deg": found.centre,
                      "u_deg": found.u, "fwhm_deg": found.fwhm})  # fmt: skip
        peaks[int(str(number))] = found
    if not rows:
        raise DataError("the file of scans holds none")
    design, y, own = np.array(rows), np.array(values), np.array(variances)
    departure, solution, covariance, freedom = _solve(design, y, own)
    scans = pd.DataFrame(about)
    scans["residual_deg"] = y - design @ solution
    rank = int(np.linalg.matrix_rank(design))
    determined = np.diag(np.linalg.pinv(design) @ design) > 1 - 1e-9
    if freedom >= FEW:
        left = float(np.sqrt(np.mean(scans["residual_deg"] ** 2)))
        spread = max(departure * math.sqrt(freedom / (freedom - 2)), left)  # of two encoders
    else:  # too few scans to show what encoders are off
        spread = FEW * max(departure, math.sqrt(float(own.mean())))
    parts = {"linearity": spread / math.sqrt(2.0)}
    zeros = {}
    for k in np.flatnonzero(determined).tolist():
        own_parts = {"scans": math.sqrt(covariance[k, k]), "backlash": _backlash_deg(description, axes[k])}
        zeros[axes[k]] = AlignedZero(float(solution[k]), own_parts | parts)
    return Alignment(zeros, axes, covariance, rank, departure, _open(description, scans, zeros, y, own), scans, peaks)


def _solve(design: Floats, y: Floats, own: Floats) -> tuple[float, Floats, Floats, int]:
    """Least squares in which all scans share one more variance, as large as their scatter about the zeros asks for."""
    freedom = len(y) - int(np.linalg.matrix_rank(design))

    def solved(extra: float) -> tuple[Floats, Floats, float]:
        root = 1.0 / np.sqrt(own + extra)
        inverse = np.linalg.pinv(design * root[:, None])
        solution = inverse @ (y * root)
        return solution, inverse @ inverse.T, float(np.sum(((y - design @ solution) * root) ** 2))

    extra = 0.0
    if freedom > 0 and solved(0.0)[2] > freedom:
        low, high = 0.0, float(np.var(y) + np.sum(own)) + 1.0
        while high - low > 1e-9 * high + 1e-12:
            extra = 0.5 * (low + high)
            low, high = (extra, high) if solved(extra)[2] > freedom else (low, extra)
    solution, covariance, _ = solved(extra)
    student = freedom / (freedom - 2) if freedom >= FEW else FEW  # of few scans the scatter is hardly known
    return math.sqrt(extra), solution, covariance * (student if extra > 0 else 1.0), freedom


def _backlash_deg(description: RigDescription, name: str) -> float:
    """Where the approach is longer than the backlash the arm always ends on the same flank; else anywhere within it."""
    backlash = description.axes()[name].backlash_deg
    return 0.0 if description.acquisition.approach_deg > backlash else backlash / math.sqrt(12.0)


def _open(
    description: RigDescription, scans: DataFrame, zeros: dict[str, AlignedZero], y: Floats, own: Floats
) -> tuple[str, ...]:
    out = []
    if "light" not in zeros:
        for holder, what, other, missing in (
            ("mirror", "the sum", "the difference camera - light", "straight-through scan (empty holder)"),
            ("empty", "the difference camera - light", "the sum", "mirror scan"),
        ):
            mine = ((scans["holder"] == holder) & (scans["axis"] == "camera")).to_numpy()
            if mine.any():
                weights = 1.0 / own[mine]
                mean = float(weights @ y[mine] / weights.sum())
                out.append(
                    f"light and camera: {what} of their zeros is {mean:.3f} deg; {other} is not determined: "
                    f"a {missing} is missing"
                )
        out = out or ["light and camera: no scan of the camera arm was made"]
    out += [f"{name}: not scanned" for name in ("tilt", "azimuth") if name in description.axes() and name not in zeros]
    if "spin" in description.axes():
        out.append("spin: a mirror looks alike however it is turned; its zero is where you mark the sample's x axis")
    return tuple(out)


def zero_values(alignment: Alignment, description: RigDescription) -> dict[tuple[str, ...], object]:
    """What to write into the rig file (`gonio.lab.by_hand.rig_file.write_values`)."""
    from gonio.lab.by_hand import rig_file

    out: dict[tuple[str, ...], object] = {}
    for name, zero in alignment.zeros.items():
        known = description.axes()[name]
        taken_out = known.zero_offset_deg if known.zero_offset_known else 0.0
        values, _ = rig_file.zero_values(description, name, read_deg=zero.offset_deg - taken_out, true_deg=0.0)
        out |= values
        u = float(f"{zero.u_deg:.2g}")
        if name == "tilt":  # which shares its key with the spin
            if "spin" in description.holder.axes:
                u = max(u, description.holder.zero_u_deg)
                if not known.zero_offset_known:  # nothing was taken out of the spin, and nothing will be
                    out["holder", "spin_zero_offset_deg"] = 0.0
            out["holder", "zero_u_deg"] = u
        else:
            out["arms", name, "zero_u_deg"] = u
    return out


def draw(table: DataFrame, alignment: Alignment) -> Figure:
    """Every scan about its centre with the fitted spot, and how far each scan is from the zeros."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(1.4, 1))
    panels = {"mirror": figure.add_subplot(grid[0, 0]), "empty": figure.add_subplot(grid[0, 1])}
    for holder, panel in panels.items():
        titles = {"mirror": "mirror in the holder", "empty": "straight through the empty holder"}
        panel.set(
            title=titles[holder], xlabel="encoder - centre of the spot [deg]", ylabel="signal / height of the spot"
        )
        panel.grid(alpha=0.3)
    for number, scan in table.groupby("scan", sort=True):
        found = alignment.peaks[int(str(number))]
        axis, panel = str(scan["axis"].iloc[0]), panels[str(scan["holder"].iloc[0])]
        x = scan[f"{axis}_encoder_deg"].to_numpy(float)
        at = float(scan["light_encoder_deg"].mean())
        (dots,) = panel.plot(x - found.centre, (scan["signal"] - found.background) / found.height, ".", ms=5,
                             label=f"{axis}, light at {at:.1f}")  # fmt: skip
        fine = np.linspace(x.min(), x.max(), 200)
        panel.plot(
            fine - found.centre, (found.at(fine) - found.background) / found.height, lw=0.8, color=dots.get_color()
        )
    for panel in panels.values():
        if panel.lines:
            panel.legend(fontsize="x-small", loc="upper left", handletextpad=0.2)
        else:
            panel.text(0.5, 0.5, "not scanned", ha="center", transform=panel.transAxes)
    left = figure.add_subplot(grid[1, :])
    scans = alignment.scans
    places = np.arange(len(scans))
    errors = np.hypot(scans["u_deg"], alignment.departure_deg)
    left.errorbar(places, scans["residual_deg"], errors, fmt="o", ms=4, color="tab:blue", ecolor="0.6",
                  label="standard uncertainty, with the scans' common scatter")  # fmt: skip
    left.axhline(0.0, color="0.3", lw=0.8)
    names = [f"{r.holder}\n{r.axis}\n{r.at_deg:.0f}" for r in scans.itertuples()]
    left.set_xticks(places, names, fontsize="x-small")
    left.set(ylabel="scan - fit of the zeros [deg]", title="residuals (below: holder, scanned axis, light [deg])")
    left.grid(alpha=0.3)
    left.legend(fontsize="x-small")
    return figure


def write(table: DataFrame, path: Path) -> None:
    """Write scans, so that the fit can be done again."""
    put(path, table.to_csv(index=False).encode())


def read(path: Path) -> DataFrame:
    """Scans that `write` has written.

    Raises
    ------
    DataError
        It cannot be read, or is no such file.
    """
    import pandas as pd

    try:
        table = pd.read_csv(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise DataError(f"{path}: cannot be read as a file of scans: {error}") from None
    missing = [name for name in COLUMNS if name not in table]
    if missing:
        raise DataError(f"{path}: is no file of scans: the column {missing[0]} is missing")
    return table
