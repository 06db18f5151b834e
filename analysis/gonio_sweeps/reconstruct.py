"""The curves of a measurement table between its points, with intervals."""

import numpy as np

from gonio.geometry import SAME_ANGLE, Directions, direction, half_angle_of_cone, unsigned, wrap
from gonio.typing import DataFrame
from gonio_sweeps.posterior import Posterior, bands

STEP_DEG = 0.5


def reconstruct(table: DataFrame, *, step_deg: float = STEP_DEG) -> DataFrame:
    """In-plane curves through the points of a table, by the Gaussian process of the sampler "curve".

    Parameters
    ----------
    table
        A measurement table with `u_random`, as `gonio reduce` writes it; flagged rows are left out. Points out of the
        plane count too. Where its `attrs` have the solid angles of source and receiver, a specular spike has the shape
        that these give it.
    step_deg
        Between angles of reflection [deg].

    Returns
    -------
    pandas.DataFrame
        A row for each band, angle of incidence and angle of reflection, between the outermost points of each curve:
        wavelength_nm, theta_i_deg, phi_i_deg, theta_r_deg (signed: positive on the mirror side), brdf, u_brdf (k = 1),
        lower and upper (the interval of 95 %) [1/sr]. Common causes of the table are in the intervals.

    Raises
    ------
    DataError
        The table states no uncertainties, or has fewer than three usable points in a band.
    """
    import pandas as pd

    solid = [table.attrs.get(f"{end}_solid_angle_sr") for end in ("source", "receiver")]
    cones = None
    if solid[0] and solid[1]:
        cones = float(half_angle_of_cone(solid[0])), float(half_angle_of_cone(solid[1]))
    out = []
    for band in bands(table):
        known = Posterior.of(band, cones)
        d = known.directions
        # whatever the azimuth of a source along the normal is, it has none
        azimuth = np.where(d.theta_i < SAME_ANGLE, 0.0, d.phi_i)
        source = direction(d.theta_i, azimuth)
        left = np.flatnonzero(d.in_plane | (d.theta_i < SAME_ANGLE))
        while left.size:
            near = np.linalg.norm(source[left] - source[left[0]], axis=-1) <= SAME_ANGLE
            curve, left = left[near], left[~near]
            if curve.size < 2:
                continue
            signed = np.degrees(d.signed[curve])
            theta_r = np.linspace(signed.min(), signed.max(), max(2, int(np.ceil(np.ptp(signed) / step_deg)) + 1))
            theta_i, phi_i = float(d.theta_i[curve].mean()), float(azimuth[curve[0]])
            theta, dphi = unsigned(np.radians(theta_r))
            same = np.ones(theta_r.size)
            brdf, u, lower, upper = known.at(Directions(theta_i * same, phi_i * same, theta, wrap(phi_i + dphi)))
            wavelength = band["wavelength_nm"].iloc[0] if "wavelength_nm" in band else np.nan
            columns = {
                "wavelength_nm": wavelength, "theta_i_deg": np.degrees(theta_i), "phi_i_deg": np.degrees(phi_i),
                "theta_r_deg": theta_r, "brdf": brdf, "u_brdf": u, "lower": lower, "upper": upper,
            }  # fmt: skip
            out.append(pd.DataFrame(columns))
    return pd.concat(out, ignore_index=True) if out else pd.DataFrame()
