"""What polarised values say by themselves: ratios of states, in the plane of incidence, beside the nearest model.

A ratio holds nothing that all states share (reference, lamp, geometry): its uncertainty is that of the independent
parts, and of causes that one state has alone. Each follows from the Mueller matrix over its first element, and is
worked out so of a model, as the polarisers of the table show it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from gonio.geometry import IN_PLANE, Directions
from gonio.models.polarised import mueller
from gonio.polarisation import UNPOLARISED
from gonio.typing import Floats
from gonio_analysis.curves.in_plane import Line, curves, labels, selection
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.forward import known_wavelength, seen
from gonio_analysis.fitting.observations import Observations

SAME_DEG = 0.05
"""Angles of states of one direction differ by less: a polariser was turned, and no arm moved."""


@dataclass(frozen=True)
class Ratio:
    """One of the ratios: its words, what it is of a Mueller matrix, and what it is of measured states."""

    label: str
    words: str
    of_matrix: Callable[[Floats, Floats, Floats], Floats]
    """Of m01, m10 and m11, over the first element."""
    of_states: Callable[[Mapping[str, Floats], Mapping[str, Floats]], tuple[Floats, Floats]]
    """Of values and their standard uncertainties by state: the ratio and its own. `KeyError` where a state lacks."""


ByState = Mapping[str, Floats]


def _sum(of: ByState, u: ByState, *words: str) -> tuple[Floats, Floats]:
    return np.sum([of[w] for w in words], axis=0), np.sqrt(np.sum([u[w] ** 2 for w in words], axis=0))


def _contrast(a: tuple[Floats, Floats], b: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """(a - b)/(a + b)."""
    total = a[0] + b[0]
    return (a[0] - b[0]) / total, 2.0 * np.hypot(b[0] * a[1], a[0] * b[1]) / total**2


def _either(of: ByState, u: ByState, two: str, four: str, element: str) -> tuple[Floats, Floats]:
    """The contrast of two states, of sums over the other polariser, or an element of a matrix."""
    if element in of:
        return of[element] / of[UNPOLARISED], u[element] / np.abs(of[UNPOLARISED])
    a, b = two.split()
    if a in of and b in of:
        return _contrast(_sum(of, u, a), _sum(of, u, b))
    ss, sp, ps, pp = four.split()
    return _contrast(_sum(of, u, ss, sp), _sum(of, u, ps, pp))


def _crossed(of: ByState, u: ByState) -> tuple[Floats, Floats]:
    if "QQ" in of:
        return 0.5 * (1.0 - of["QQ"] / of[UNPOLARISED]), 0.5 * u["QQ"] / np.abs(of[UNPOLARISED])
    value, spread = _contrast(_sum(of, u, "sp", "ps"), _sum(of, u, "ss", "pp"))
    return 0.5 * (1.0 + value), 0.5 * spread


def _psi(of: ByState, u: ByState) -> tuple[Floats, Floats]:
    ratio = np.sqrt(of["pp"] / of["ss"])
    return ratio, 0.5 * ratio * np.hypot(u["pp"] / of["pp"], u["ss"] / of["ss"])


RATIOS = {
    "diattenuation": Ratio(
        "diattenuation",
        "(s - p)/(s + p) of the light that falls on the sample, m01",
        lambda m01, m10, m11: m01,
        lambda of, u: _either(of, u, "s p", "ss sp ps pp", "QI"),
    ),
    "polarisation": Ratio(
        "degree of linear polarisation",
        "(s - p)/(s + p) of what is reflected of unpolarised light, m10",
        lambda m01, m10, m11: m10,
        lambda of, u: _either(of, u, "us up", "ss ps sp pp", "IQ"),
    ),
    "crossed": Ratio(
        "crossed share",
        "(sp + ps)/(ss + sp + ps + pp): 0 of a mirror, 1/2 where all is depolarised",
        lambda m01, m10, m11: 0.5 * (1.0 - m11),
        _crossed,
    ),
    "ellipsometric": Ratio(
        "tan Ψ",
        "ellipsometric ratio, the root of pp/ss",
        lambda m01, m10, m11: np.sqrt((1.0 - m01 - m10 + m11) / (1.0 + m01 + m10 + m11)),
        _psi,
    ),
}
"""By name, in the order of the page."""


@dataclass(frozen=True)
class PolarisationRatios:
    """The ratios that a table's states give, and those of a model."""

    model: str | None
    lines: dict[str, list[Line]]
    """By name of the ratio: a line for each curve in the plane of incidence; `residual` is measured less model."""

    def summary(self) -> dict[str, object]:
        """As `summary.json` holds it: values, and how far the model is off, by ratio."""
        out: dict[str, object] = {"model": self.model}
        for name, lines in self.lines.items():
            value = np.concatenate([line.measured for line in lines])
            u = np.concatenate([line.u for line in lines])
            off = np.concatenate([np.full(x.u.size, np.nan) if x.residual is None else x.residual for x in lines])
            known = np.isfinite(off) & (u > 0)
            out[name] = {
                "points": value.size,
                "lowest": float(value.min()),
                "highest": float(value.max()),
                "u_median": float(np.median(u)),
                "rms_residual": float(np.sqrt(np.mean(off**2))) if np.isfinite(off).all() else None,
                "chi_square_per_value": float(np.mean((off[known] / u[known]) ** 2)) if known.any() else None,
            }
        return out


def ratios(data: Observations, best: FitResult | None, label: str | None) -> PolarisationRatios | None:
    """The ratios of the values at one wavelength; None where no direction was seen in the states of any.

    Parameters
    ----------
    data
        Values of every state, of one wavelength.
    best, label
        The fit whose model is drawn beside them, and what it is called.
    """
    import pandas as pd

    if data.light is None:
        return None
    flat = np.flatnonzero(np.abs(data.directions.out_of_plane) <= IN_PLANE)
    angles = np.round(np.degrees(np.stack(data.directions[flat].angles)) / SAME_DEG) * SAME_DEG
    u = _of_states(data)
    frame = pd.DataFrame({"state": data.states[flat], "value": data.brdf[flat], "u": u[flat]})
    frame[["ti", "pi", "tr", "pr"]] = angles.T
    wide = frame.pivot_table(index=["ti", "pi", "tr", "pr"], columns="state", values=["value", "u"])
    out: dict[str, list[Line]] = {}
    for name, ratio in RATIOS.items():
        of, spread = ({w: wide[kind][w].to_numpy() for w in wide[kind].columns} for kind in ("value", "u"))
        try:
            with np.errstate(divide="ignore", invalid="ignore"):
                value, own = ratio.of_states(of, spread)
        except KeyError:
            continue
        good = np.isfinite(value) & np.isfinite(own)
        at = Directions.from_degrees(*np.array(wide.index.tolist(), dtype=np.float64).reshape(-1, 4).T)[good]
        if lines := _lines(ratio, at, value[good], own[good], data, best):
            out[name] = lines
    return PolarisationRatios(label if best is not None else None, out) if out else None


def _of_states(data: Observations) -> Floats:
    """Standard uncertainties [1/sr] by what values of other states do not share."""
    known = data.covariance
    if known is None:
        return np.zeros(len(data))
    alone = [k for k, column in enumerate(known.common.T) if len(set(data.states[column != 0.0])) == 1]
    return np.asarray(np.sqrt(known.random**2 + np.sum(known.common[:, alone] ** 2, axis=1)))


def _lines(
    ratio: Ratio, at: Directions, value: Floats, u: Floats, data: Observations, best: FitResult | None
) -> list[Line]:
    wave = data.wavelength_nm[0]
    along = selection(curves(Observations(at, np.full(value.size, wave), value, None, np.arange(value.size))))
    cones = (data.source_solid_angle_sr, data.receiver_solid_angle_sr)

    def of_model(there: Directions) -> Floats:
        assert best is not None
        evaluate = partial(seen, at=there, wavelength_nm=known_wavelength(wave), cones=cones)
        matrix = mueller(best.model, there, wavelength_nm=known_wavelength(wave), evaluate=evaluate)
        light, receiver = (one.passed(np.array([1.0, 1.0, 0.0, 0.0]))[1] for one in data.polarisers)
        shares = {(0, 1): light, (1, 0): receiver, (1, 1): light * receiver}
        with np.errstate(divide="ignore", invalid="ignore"):
            return ratio.of_matrix(*(share * matrix[:, i, j] / matrix[:, 0, 0] for (i, j), share in shares.items()))

    out = []
    for curve, label in zip(along, labels(along), strict=True):
        angle = np.radians(np.linspace(-89.0, 89.0, 179)) if best is not None else np.zeros(0)
        theory = of_model(curve.directions(angle)) if best is not None else np.zeros(0)
        off = value[curve.rows] - of_model(at[curve.rows]) if best is not None else None
        out.append(Line(label, angle, theory, curve.angle, value[curve.rows], u[curve.rows], residual=off))
    return out
