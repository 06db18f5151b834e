"""Tables of known samples, in the directions that quantities of appearance need, with a known covariance."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from gonio_analysis.fitting.forward import seen
from gonio_analysis.result_records import Appearance, Quantity

from gonio.formats.reader import table
from gonio.geometry import Directions
from gonio.models import Model
from gonio.typing import Floats

CONE_SR = 2.4e-4
"""Half a degree."""


def hemisphere(theta_i_deg: float, step: float = 10.0, turn: float = 30.0, end: float = 85.0) -> Floats:
    """Directions (n, 4) [deg] of one incidence over half of the hemisphere, the mirror direction among them."""
    thetas = np.unique([*np.arange(0.0, end, step), end])
    grid = np.stack(np.meshgrid(thetas, np.arange(0.0, 180.1, turn), indexing="ij"), axis=-1).reshape(-1, 2)
    grid = np.unique(np.vstack([grid[(grid[:, 0] > 0.0) | (grid[:, 1] == 180.0)], [theta_i_deg, 180.0]]), axis=0)
    return np.column_stack([np.full(len(grid), theta_i_deg), np.zeros(len(grid)), grid])


def plane(theta_i_deg: float, signed_deg: Floats) -> Floats:
    """Directions (n, 4) [deg] of one incidence in the plane of incidence."""
    phi = np.where(signed_deg >= 0.0, 180.0, 0.0)
    return np.column_stack([np.full(phi.size, theta_i_deg), np.zeros(phi.size), np.abs(signed_deg), phi])


def measured(
    model: Model,
    directions: Floats,
    *,
    waves: tuple[float, ...] = (550.0,),
    cone_sr: float = CONE_SR,
    noise: float = 0.01,
    reference: float = 0.005,
) -> pd.DataFrame:
    """A table of a model without noise, whose stated uncertainty is `noise` f and one common cause of `reference` f."""
    parts = []
    for nm in waves:
        f = seen(model, Directions.from_degrees(*directions.T), wavelength_nm=nm, cones=(cone_sr, cone_sr))
        random = noise * f + 1e-7
        part = table(
            **dict(zip(("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"), directions.T, strict=True)),
            wavelength_nm=nm,
            brdf=f,
            u_brdf=np.hypot(random, reference * f),
            u_random=random,
            attrs={},
        )
        part.insert(list(part.columns).index("flag"), "s_reference", reference * f)
        parts.append(part)
    frame = pd.concat(parts, ignore_index=True)
    frame.attrs = {
        **parts[0].attrs,
        "source_solid_angle_sr": cone_sr or None,
        "receiver_solid_angle_sr": cone_sr or None,
        "sample": "simulated",
        "source_file": "simulated.csv",
    }
    return frame


def noisy(frame: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """The table with noise of its covariance; the common cause is proportional to what was measured, as in a run."""
    out = frame.copy()
    out.attrs = frame.attrs
    true, common = frame["brdf"].to_numpy(), frame["s_reference"].to_numpy()
    random = frame["u_random"].to_numpy()
    value = true + common * rng.normal() + random * rng.normal(size=true.size)
    out["brdf"], out["s_reference"] = value, common * value / true
    out["u_brdf"] = np.hypot(random, out["s_reference"])
    return out


def named(a: Appearance) -> Iterator[tuple[str, Quantity]]:
    """Every quantity by its name."""
    for key, one in vars(a).items():
        if isinstance(one, Quantity):
            yield key, one
    for rho in a.rho_dh:
        yield f"rho_dh {rho.theta_i_deg}", rho
    for r in a.retroreflection:
        yield f"R_A {r.entrance_deg}", r.R_A
        yield f"R_L {r.entrance_deg}", r.R_L
    for c in a.lab:
        yield from ((f"{letter} {c.theta_i_deg} {c.aspecular_deg}", getattr(c, letter)) for letter in "Lab")
