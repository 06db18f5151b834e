"""Blind fits of polarised tables: do stated intervals hold the truth, and is u that of the Fisher information?

Tables are drawn from facets of a dielectric, facets of a metal, and He and Torrance's surface; light is s, p or at +45
degrees. The Fisher information is that of the true model, by differences of its values: no code of the fits is in it.
"""

import json
from collections.abc import Callable, Iterator
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from gonio_analysis.fitting.fit import FitResult, fit
from scipy import stats

from gonio import polarisation
from gonio.geometry import Directions
from gonio.models import GGX, CookTorrance, HeTorrance, Model
from gonio.models.polarised import Light
from gonio.typing import DataFrame, Floats

STATES = ("s", "p", "dd", "da")
INCIDENCES_DEG = (20.0, 45.0, 65.0)
WAVELENGTH_NM = 550.0
U_REL = 0.01
STEP = 1e-4
"""Of a parameter, relative, between the two values of a derivative."""


class Kind(NamedTuple):
    """One kind of surface: how its parameters are drawn and what makes a model of them."""

    name: str
    draw: Callable[[np.random.Generator], dict[str, float]]
    model: Callable[[dict[str, float]], Model]
    fix: dict[str, float] = {}  # noqa: RUF012


KINDS = {
    "dielectric facets": Kind(
        "ggx",
        lambda r: {"alpha": r.uniform(0.1, 0.4), "ior": r.uniform(1.35, 1.9), "diffuse_albedo": r.uniform(0.1, 0.6)},
        lambda p: GGX(p["alpha"], p["ior"], p["diffuse_albedo"]),
        {"k": 0.0},
    ),
    "metal facets": Kind(
        "cook-torrance",
        lambda r: {
            "s": r.uniform(0.3, 0.8), "m": r.uniform(0.15, 0.4), "diffuse_albedo": r.uniform(0.1, 0.6),
            "ior": r.uniform(0.6, 3.0), "k": r.uniform(2.0, 6.0),
        },
        lambda p: CookTorrance(
            p["s"], 1.0 - p["s"], p["m"], complex(p["ior"], p["k"]), diffuse_albedo=p["diffuse_albedo"]
        ),
    ),
    "He-Torrance": Kind(
        "he-torrance",
        lambda r: {
            "sigma0_um": r.uniform(0.08, 0.3), "tau_um": r.uniform(1.2, 3.0), "diffuse_albedo": r.uniform(0.02, 0.2),
            "ior": r.uniform(0.6, 3.0), "k": r.uniform(2.0, 6.0),
        },
        lambda p: HeTorrance(p["sigma0_um"], p["tau_um"], complex(p["ior"], p["k"]), p["diffuse_albedo"]),
    ),
}  # fmt: skip


class Blind(NamedTuple):
    """A parameter of one fit."""

    kind: str
    parameter: str
    true: float
    value: float
    u: float
    fisher: float
    """Standard uncertainty of an estimate that uses all that the values tell."""
    rejected: bool
    """Whether the fit was, by its chi-square: then it states more."""


def plan() -> DataFrame:
    """Directions in plane, each in all states."""
    import pandas as pd

    rows = [
        (theta_i, 0.0, abs(theta_r), 180.0 * (theta_r >= 0), word)
        for theta_i in INCIDENCES_DEG
        for theta_r in np.arange(-75.0, 76.0, 7.5)
        for word in STATES
    ]
    return pd.DataFrame(rows, columns=["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "polarisation"])


def seen(model: Model, rows: DataFrame) -> Floats:
    """The values of a model in the rows of a plan [1/sr]."""
    at = Directions.from_table(rows)
    light = Light(at, *polarisation.states(rows["polarisation"].tolist()))
    return model.in_light(light, lambda m: np.asarray(m.brdf(*at.angles, wavelength_nm=WAVELENGTH_NM)), WAVELENGTH_NM)


def measured(model: Model, rows: DataFrame, random: np.random.Generator) -> tuple[DataFrame, Floats]:
    """A table of the model with independent errors, and their standard deviations."""
    true = seen(model, rows)
    u = U_REL * np.abs(true) + 1e-5
    frame = rows.assign(
        wavelength_nm=WAVELENGTH_NM, brdf=true + u * random.standard_normal(len(rows)), u_brdf=u, u_random=u, flag=""
    )
    frame.attrs |= {"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0}
    return frame, u


def fisher(kind: Kind, true: dict[str, float], rows: DataFrame, u: Floats) -> dict[str, float]:
    """The standard uncertainties of the inverse of J^T W J."""
    columns = []
    for name, value in true.items():
        up, down = (seen(kind.model(true | {name: value * (1.0 + s * STEP)}), rows) for s in (1.0, -1.0))
        columns.append((up - down) / (2.0 * STEP * value * u))
    jacobian = np.stack(columns, axis=1)
    return dict(zip(true, np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))), strict=True))


def blind(fits: int, seed: int) -> Iterator[Blind]:
    """The parameters of as many fits, each kind in turn; everything follows from the seed."""
    rows = plan()
    for k in range(fits):
        name = list(KINDS)[k % len(KINDS)]
        kind, random = KINDS[name], np.random.default_rng((seed, k))
        true = kind.draw(random)
        frame, u = measured(kind.model(true), rows, random)
        found: FitResult = fit(frame, kind.name, fix=dict(kind.fix))
        bound = fisher(kind, true, rows, u)
        for parameter, value in true.items():
            e = found.parameters[parameter]
            yield Blind(
                name, parameter, value, e.value, np.nan if e.u is None else e.u, bound[parameter], found.rejected
            )


def summary(found: list[Blind]) -> dict[str, Any]:
    """Coverage of 95 % intervals with what it may be by chance, rms pulls, and u over Fisher's."""
    inside = [abs(b.value - b.true) <= stats.norm.ppf(0.975) * b.u for b in found]
    ratio = np.array([b.u / b.fisher for b in found])
    index = np.array([b.parameter in ("ior", "k") for b in found])
    kept = np.array([not b.rejected for b in found])
    pulls = np.array([(b.value - b.true) / b.u for b in found])
    spread = np.sqrt(0.95 * 0.05 / len(found))
    return {
        "parameters": len(found),
        "coverage": float(np.mean(inside)),
        "by_chance": [float(0.95 - 1.96 * spread), float(0.95 + 1.96 * spread)],
        "rms_pull": float(np.sqrt(np.mean(pulls**2))),
        "of_rejected_fits": int(np.count_nonzero(~kept)),
        "u_over_fisher": _range(ratio),
        "u_over_fisher_of_n_and_k": _range(ratio[index]),
        "u_over_fisher_not_rejected": _range(ratio[kept]),
    }


def _range(values: Floats) -> list[float]:
    """The smallest, the median and the largest."""
    return [float(q) for q in np.quantile(values, (0.0, 0.5, 1.0))]


def main(
    fits: Annotated[int, typer.Option(help="How many.")] = 60,
    seed: Annotated[int, typer.Option(help="What is drawn follows from it.")] = 1,
) -> None:
    """Print coverage, pulls, and u over that of the Fisher information, as JSON."""
    print(json.dumps(summary(list(blind(fits, seed))), indent=2))


if __name__ == "__main__":
    typer.run(main)
