"""What a table holds beside the unpolarised reflection: transmission, and Mueller matrices.

The rows of transmission are kept apart from all that is reflected. Measured Mueller matrices are compared with those of
a fitted model, element by element.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio import measurement, shown
from gonio.formats.reader import MUELLER
from gonio.geometry import Directions
from gonio.models.polarised import mueller
from gonio.typing import DataFrame, Floats
from gonio_analysis.curves.in_plane import Curve, Line, curves, labels, selection
from gonio_analysis.fitting import energy
from gonio_analysis.fitting.forward import NO_WAVELENGTH_NM
from gonio_analysis.fitting.observations import Observations, describe_left_out, observations
from gonio_analysis.result_records import MuellerElement, Reflectance

if TYPE_CHECKING:
    from gonio_analysis.fitting.fit import FitResult


@dataclass(frozen=True)
class Transmitted:
    """The usable rows of transmission of one sample at one wavelength.

    Directions toward the detector are turned over (`gonio.measurement.turned_over`): theta_r is counted from the normal
    of the back, and the mirror direction stands for straight through.
    """

    name: str
    rows: int
    """Rows of transmission in the table, at every wavelength."""
    data: Observations
    wavelength_nm: float
    curves: list[Curve]
    """The in-plane curves that are drawn."""
    tau_dh: list[Reflectance]
    source: str = ""
    simulated: bool = False
    """Whether a simulation made the values."""

    @property
    def title(self) -> str:
        """The name, with a mark where the values are simulated."""
        return shown.marked(self.name, self.simulated)

    def summary(self) -> dict[str, object]:
        """As `summary.json` holds it."""
        at = self.data
        return {
            "name": self.name,
            "source": self.source,
            "rows": self.rows,
            "used": len(at),
            "left_out_words": describe_left_out(at.left_out),
            "wavelength_nm": self.wavelength_nm,
            "theta_i_deg": np.unique(np.round(np.degrees(at.directions.theta_i), 1)),
            "btdf_min": at.brdf.min(),
            "btdf_max": at.brdf.max(),
            "tau_dh": self.tau_dh,
            "notes": self.notes,
        }

    @property
    def notes(self) -> list[str]:
        """What the table's reader says, where the sample's reflection is not on the page."""
        return list(self.data.notes) if self.source else []


def transmitted(
    table: DataFrame, name: str, wavelength_nm: float | None = None, u_rel: float | None = None
) -> Transmitted | None:
    """The transmission of a table at the wavelength nearest to the one asked for; None where it holds none.

    None as well where it holds some of which no row can be used.
    """
    through = measurement.transmission(table)
    if through is None or not (through["flag"].fillna("") == "").any():
        return None
    every = observations(measurement.turned_over(through), f"{name}, transmission", u_rel)
    at, wavelength = every.nearest(wavelength_nm)
    tau_dh, made = energy.of_table(at), measurement.is_simulated(table)
    return Transmitted(name, len(through), at, wavelength, selection(curves(at)), tau_dh, simulated=made)


@dataclass(frozen=True)
class MuellerFacts:
    """The Mueller matrices of a table's usable rows, and those of the model that has any."""

    measured: Floats
    """(n, 15): m01 to m33, over the first element; NaN where unknown."""
    u: Floats
    """Their standard uncertainties; NaN where none is stated."""
    model: str | None
    theory: Floats | None
    """As `measured`; None without a model that has a matrix."""
    lines: dict[str, list[Line]]
    """In the plane of incidence, by element, a line for each curve."""

    def summary(self) -> dict[str, object]:
        """As `summary.json` holds it."""
        return {"model": self.model, "points": self.points, "elements": self.elements}

    @property
    def points(self) -> int:
        """Values with a matrix."""
        return int(np.isfinite(self.measured).any(axis=1).sum())

    @property
    def elements(self) -> list[MuellerElement]:
        """Each of them against the model's."""
        return [self._element(k) for k in range(len(MUELLER))]

    def _element(self, k: int) -> MuellerElement:
        m, u = self.measured[:, k], self.u[:, k]
        known = np.isfinite(m)
        chi = None
        mean = rms = None
        if self.theory is not None and known.any():
            off = (m - self.theory[:, k])[known]
            mean, rms = float(off.mean()), float(np.sqrt(np.mean(off**2)))
            stated = known & (u > 0)
            if stated.any():
                chi = float(np.mean(((m - self.theory[:, k])[stated] / u[stated]) ** 2))
        return MuellerElement(
            name=MUELLER[k],
            points=int(known.sum()),
            rms=float(np.sqrt(np.mean(m[known] ** 2))) if known.any() else None,
            mean_residual=mean,
            rms_residual=rms,
            chi_square_per_value=chi,
        )


def polarisation(
    table: DataFrame, at: Observations, drawn: list[Curve], label: str | None, fit: FitResult | None
) -> MuellerFacts | None:
    """The Mueller matrices of a table; None where it holds none.

    Beside them is the model `fit`, called `label`: its matrix in single directions, without the cones of source and
    receiver.
    """
    known = [name for name in MUELLER if name in table.columns]
    if not known or not table[known].notna().to_numpy().any():
        return None
    measured, u = (_columns(table, names, at) for names in (MUELLER, [f"u_{name}" for name in MUELLER]))
    model = None if fit is None else fit.model
    wave = NO_WAVELENGTH_NM if fit is None or not np.isfinite(fit.wavelength_nm) else fit.wavelength_nm
    theory = None if model is None else _ratios(model, *at.directions.angles, wave)
    lines: dict[str, list[Line]] = {name: [] for name in MUELLER}
    for curve, name in zip(drawn, labels(drawn), strict=True):
        angle = np.empty(0) if model is None else np.radians(np.linspace(-89.0, 89.0, 179))
        along = None if model is None else _ratios(model, *curve.directions(angle).angles, wave)
        for k, element in enumerate(MUELLER):
            there = np.isfinite(measured[curve.rows, k])
            rows = curve.rows[there]
            path = np.empty(0) if along is None else along[:, k]
            lines[element].append(Line(name, angle, path, curve.angle[there], measured[rows, k], u[rows, k]))
    return MuellerFacts(measured, u, label, theory, lines)


def _columns(table: DataFrame, names: Any, at: Observations) -> Floats:
    out = np.full((len(at), len(names)), np.nan)
    for k, name in enumerate(names):
        if name in table.columns:
            out[:, k] = table[name].to_numpy(np.float64)[at.rows]
    return out


def _ratios(model: Any, theta_i: Floats, phi_i: Floats, theta_r: Floats, phi_r: Floats, wave: float) -> Floats:
    """m01 to m33 of a model over its first element, (n, 15)."""
    matrix = mueller(model, Directions(theta_i, phi_i, theta_r, phi_r), wavelength_nm=wave).reshape(-1, 16)
    return np.asarray(matrix[:, 1:] / np.where(matrix[:, :1] > 0, matrix[:, :1], np.nan))
