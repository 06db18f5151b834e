"""The uncertainty of each value in its parts, and what no part of it holds (docs/budget.md)."""

import math

import numpy as np

from gonio.acquisition.plan import ANGLES
from gonio.geometry import SAME_AZIMUTH, half_angle_of_cone
from gonio.reduction.values import BandResult
from gonio.rig import kinematics
from gonio.rig.description import RigDescription
from gonio.typing import DataFrame

COMPONENTS = (
    "noise", "dark", "prnu", "encoder", "zeros_even", "geometry", "beam", "spike_blur", "coarse_steps", "region",
    "visits",
)  # fmt: skip
"""The parts of `u_random`, standard uncertainties [1/sr]; their squares add up to its square."""
OPEN = {
    "stray_light": "stray light and inter-reflections were not measured (gonio calibrate camera)",
    "linearity": "the sensor's departure from a straight line was not measured (gonio calibrate camera)",
    "polarisation": "how far lamp and lens polarise was not measured (gonio calibrate light)",
    "wavelength": "the band's true centre and width were not measured (gonio calibrate light)",
    "geometry": "distances, and the axes' tilts and displacements, were not measured (gonio calibrate geometry)",
}
"""Causes that a run knows only where a calibration says so, by how the names of their columns begin after "s_"."""


WANDERS = 3
"""So many visits to the white reference tell something of a lamp that wanders."""


def assemble(table: DataFrame, bands: list[BandResult]) -> DataFrame:
    """The budget of every row of a table.

    Parameters
    ----------
    table
        Of the run (`gonio.reduction.brdf.reduce`), in its own order: rows by point, and by band within a point.
    bands
        What it was made from.

    Returns
    -------
    pandas.DataFrame
        The angles, wavelength, `brdf` and `u_brdf` of the table; `COMPONENTS` and the table's `s_` columns, whose
        squares add up to `u_brdf` squared; `nu_eff`, effective degrees of freedom (inf where no part rests on a
        scatter); `coarse`, whether steps leave a slope open by more than the noise; `cone_difference`, how far the
        value (a mean over the cones of lamp and lens) may depart from that of a pair of directions, for information
        alone; and `flag`. All [1/sr], NaN in rows that have a flag.
    """
    import pandas as pd

    causes = [name for name in table.columns if name.startswith("s_")]
    kept = [*ANGLES, "wavelength_nm", *(["side"] if "side" in table.columns else []), "brdf", "u_brdf"]
    parts = list(dict.fromkeys([*COMPONENTS, *(name for band in bands for name in band.values.own)]))
    rows, numbers = len(table), [*parts, "nu_eff", "coarse", "cone_difference"]
    values = np.full((len(numbers), rows), math.nan)
    cones = [half_angle_of_cone(table.attrs[f"{name}_solid_angle_sr"]) for name in ("source", "receiver")]
    # each disc has the variance of a quarter of its squared radius in each direction
    variance = 0.25 * sum(float(cone) ** 2 for cone in cones)
    for k, band in enumerate(bands):
        at, of = band.rows * len(bands) + k, band.values
        if not at.size:
            continue
        none = np.zeros(at.size)
        of_scatter = of.own["visits"] if band.level.scatter else none
        with np.errstate(divide="ignore", invalid="ignore"):
            freedom = np.where(of_scatter > 0, max(band.visits - 1, 1) * (of.u_brdf / of_scatter) ** 4, math.inf)
        of_cones = 0.5 * variance * of.lobes.curvature.sum(axis=1)
        values[:, at] = [*(of.own.get(name, none) for name in parts), freedom, of.coarse, of_cones]
    values[:, table["flag"].to_numpy() != ""] = math.nan
    found = dict(zip(numbers, values, strict=True))
    more = pd.DataFrame({name: found[name] for name in numbers[len(parts) :]})
    more["coarse"] = more["coarse"] > 0
    own = pd.DataFrame({name: found[name] for name in parts})
    out = pd.concat([table[kept], own, table[causes], more, table[["flag"]]], axis=1)
    out.attrs = {}
    return out


def left_out(description: RigDescription, table: DataFrame) -> list[dict[str, str]]:
    """Causes of uncertainty that are not in a table's budget, each with the reason; for provenance and reports."""
    out = [
        {"cause": name, "why": why}
        for name, why in OPEN.items()
        if not any(column.startswith(f"s_{name}") for column in table.columns)
    ]
    out += [
        {"cause": f"zero of the {kinematics.NAMES[name]}", "why": "zero_offset_known = false: nothing is known of it"}
        for name, axis in description.axes().items()
        if not axis.zero_offset_known
    ]
    if any(account["visits"] < WANDERS for account in table.attrs["provenance"]["reference"]):
        out.append({
            "cause": "lamp_wander",
            "why": f"fewer than {WANDERS} visits to the white reference do not tell whether the lamp wanders",
        })  # fmt: skip
    azimuth = np.radians(table["phi_i_deg"].to_numpy(dtype=float))
    turned = np.abs(np.sin(azimuth - azimuth[:1])) > math.sin(SAME_AZIMUTH)
    if "spin" in description.axes() and not turned.any():
        out.append({
            "cause": "direction",
            "why": "the sample was measured at one azimuth of incidence: whether it has a direction, and what an error "
            "of the spin does to its values then, is not known (measure it at three azimuths or more)",
        })  # fmt: skip
    out.append({
        "cause": "solid_angle",
        "why": "values are means over the cones of lamp and lens, and are stated as such; budget.csv has "
        "cone_difference, how far they may depart from the value of a pair of directions",
    })  # fmt: skip
    return out
