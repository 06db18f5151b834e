"""Propagation of uncertainty, fits and consensus values against published numbers."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from gonio_analysis.changes.consensus import consensus
from gonio_analysis.fitting.solution import slopes_of
from gonio_analysis.report.notebook import fit

from gonio.formats.reader import table
from gonio.models import ArrayModel, Fitted
from gonio.typing import Floats
from gonio_validation.verify.finding import Finding, near

TURN = 1000.0
"""Predictors of the reference datasets are carried as azimuths, in units of 1/TURN rad."""


def look(_folder: Path) -> list[Finding]:
    """See `gonio_validation.verify`."""
    return [*_end_gauge(), *_impedance(), *_reference_datasets(), *_consensus()]


def _propagated(values: Any, at: Floats, covariance: Floats, steps: Floats) -> Floats:
    """The covariance of quantities by those of their inputs, to first order (GUM 5.1, 5.2)."""
    slopes = slopes_of(values, at, steps)
    return np.asarray(slopes @ covariance @ slopes.T)


def _end_gauge() -> list[Finding]:
    """GUM H.1: l = l_s + d - l_s (delta_alpha theta + alpha_s delta_theta) [nm], with table H.1."""

    def length(x: Floats) -> Floats:
        l_s, d, alpha_s, theta, delta_alpha, delta_theta = x
        return np.array([l_s + d - l_s * (delta_alpha * theta + alpha_s * delta_theta)])

    at = np.array([50_000_623.0, 215.0, 11.5e-6, -0.1, 0.0, 0.0])
    u = np.array([25.0, 9.7, 1.2e-6, 0.41, 0.58e-6, 0.029])
    found = float(np.sqrt(_propagated(length, at, np.diag(u**2), u)[0, 0]))
    # 31.7 in H.1.4, from numbers of two digits
    return [near("GUM H.1: l / nm", float(length(at)[0]), 50_000_838.0, rel=1e-12),
            near("GUM H.1: u(l) / nm", found, 31.7, rel=2e-3, digits=4)]  # fmt: skip


def _impedance() -> list[Finding]:
    """GUM H.2: resistance, reactance and impedance by five observations of three correlated quantities."""
    volt = np.array([5.007, 4.994, 5.005, 4.990, 4.999])
    current = np.array([19.663, 19.639, 19.640, 19.685, 19.678]) * 1e-3
    phase = np.array([1.0456, 1.0438, 1.0468, 1.0428, 1.0433])
    observed = np.array([volt, current, phase])
    at, covariance = observed.mean(axis=1), np.cov(observed) / volt.size

    def impedance(x: Floats) -> Floats:
        z = x[0] / x[1]
        return np.array([z * np.cos(x[2]), z * np.sin(x[2]), z])

    of_all = _propagated(impedance, at, covariance, np.sqrt(np.diag(covariance)))
    u = np.sqrt(np.diag(of_all))
    found = (*impedance(at), *u, of_all[0, 1] / u[0] / u[1], of_all[0, 2] / u[0] / u[2], of_all[1, 2] / u[1] / u[2])
    right = (127.732, 219.847, 254.260, 0.071, 0.295, 0.236, -0.588, -0.485, 0.993)
    names = ("R", "X", "Z", "u(R)", "u(X)", "u(Z)", "r(R, X)", "r(R, Z)", "r(X, Z)")
    # as printed in table H.4: half a unit of the last place
    rel = (4e-6, 4e-6, 4e-6, 8e-3, 2e-3, 3e-3, 1e-3, 2e-3, 6e-4)
    return [
        near(f"GUM H.2: {n}", float(f), r, rel=e, digits=6) for n, f, r, e in zip(names, found, right, rel, strict=True)
    ]


class _Dataset(ArrayModel):
    """A function of the receiver's azimuth, which stands for a predictor."""

    depends_on_azimuth: ClassVar[bool] = True
    convention = "One of NIST's reference datasets."

    def evaluate(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> Floats:
        """See `ArrayModel.evaluate`."""
        return self.of(TURN * np.arctan2(omega_r[:, 1], omega_r[:, 0]))

    def of(self, x: Floats) -> Floats:
        """The function."""
        raise NotImplementedError


@dataclass(frozen=True)
class Misra1a(_Dataset):
    """y = b1 (1 - exp(-b2 x)): monomolecular adsorption."""

    b1: float = 200.0
    b2: float = 1e-3
    name = "misra1a"
    fitted: ClassVar = {
        "b1": Fitted(1.0, 1e4, "log", starts=(250.0, 500.0)),
        "b2": Fitted(1e-6, 1.0, "log", starts=(1e-4, 5e-4)),
    }

    def of(self, x: Floats) -> Floats:
        """See `_Dataset.of`."""
        return self.b1 * -np.expm1(-self.b2 * x)


@dataclass(frozen=True)
class DanWood(_Dataset):
    """y = b1 x^b2: energy radiated by a filament."""

    b1: float = 1.0
    b2: float = 4.0
    name = "danwood"
    fitted: ClassVar = {"b1": Fitted(1e-3, 1e3, "log", starts=(0.7, 1.0)), "b2": Fitted(0.5, 10.0, starts=(4.0, 5.0))}

    def of(self, x: Floats) -> Floats:
        """See `_Dataset.of`."""
        return self.b1 * x**self.b2


class _Certified(NamedTuple):
    """A dataset of NIST's Statistical Reference Datasets, nonlinear regression, with its certified values."""

    model: type[_Dataset]
    x: tuple[float, ...]
    y: tuple[float, ...]
    values: dict[str, tuple[float, float]]
    """Certified estimates and standard deviations."""
    residual: float
    """Residual standard deviation."""


DATASETS = (
    _Certified(
        Misra1a,
        (77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0),
        (10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78),
        {"b1": (2.3894212918e02, 2.7070075241e00), "b2": (5.5015643181e-04, 7.2668688436e-06)},
        1.0187876330e-01,
    ),
    _Certified(
        DanWood,
        (1.309, 1.471, 1.490, 1.565, 1.611, 1.680),
        (2.138, 3.421, 3.597, 4.340, 4.882, 5.660),
        {"b1": (7.6886226176e-01, 1.8281973860e-02), "b2": (3.8604055871e00, 5.1726610913e-02)},
        3.2853114039e-02,
    ),
)


def _reference_datasets() -> list[Finding]:
    """Fits by the program's own fitter, each value with the residual standard deviation as its uncertainty."""
    out = []
    for data in DATASETS:
        y = np.array(data.y)
        frame = table(
            theta_i_deg=30.0, phi_i_deg=0.0, theta_r_deg=np.full(y.size, 40.0),
            phi_r_deg=np.degrees(np.array(data.x) / TURN), wavelength_nm=550.0, brdf=y, u_brdf=data.residual,
            u_random=data.residual, attrs={"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0},
        )  # fmt: skip
        result = fit(frame, data.model, name=data.model.name)
        for name, (value, u) in data.values.items():
            e = result.parameters[name]
            called = f"StRD {data.model.__name__}: {name}"
            # a fit ends where chi-square changes by 1e-8 of itself
            out += [near(called, e.value, value, rel=1e-6), near(f"{called}, u", e.u or 0.0, u, rel=1e-4, digits=8)]
    return out


def _consensus() -> list[Finding]:
    """The lead in CCQM-K30, laboratories included, by R's metRology."""
    x = (2.893, 2.936, 2.94, 2.96, 2.98, 3.0, 3.001, 3.07, 3.13)
    u = (0.020657276995305163, 0.0125, 0.0165, 1 / 30, 0.10050251256281408, 0.05, 0.068, 0.085, 0.06)
    right = {
        "weighted": (2.939597266711811, 0.008319483037083741, 1e-12),
        "dersimonian-laird": (2.9588158293090046, 0.01741386611329472, 1e-12),
        "reml": (2.9677372330356353, 0.022260582269506682, 1e-6),
    }
    out = []
    for method, (value, u_value, rel) in right.items():
        found = consensus(x, u, method)  # type: ignore[arg-type]
        out += [near(f"CCQM-K30 lead, {method}", found.value, value, rel=rel)]
        out += [near(f"CCQM-K30 lead, {method}, u", found.u, u_value, rel=rel)]
    return out
