"""Tables of two laboratories as columns that --columns can name (docs/formats.md)."""

import numpy as np
import pandas as pd


def infrared(file, out):
    """Radiance in plane, 2 to 5.7 um: `sample_en`, `theta_o_deg`, `theta_i_deg` on opposite sides of the normal."""
    table = pd.read_csv(file)
    source = 3463.986 * np.pi * (5 / 315) ** 2  # W/m^2: its radiance in the band, and its disc seen from the sample
    f = table["L_reflected_W_m-2_sr-1"] / (source * np.cos(np.radians(table["theta_i_deg"])))
    table.assign(source_azimuth=0, receiver_azimuth=180, f=f).to_csv(out, index=False)


def reflectance_factors(file, out):
    """One column a wavelength; `Measure_angle` is positive on the mirror side, a zero stands where the beam is cut."""
    table = pd.read_csv(file, skipinitialspace=True)
    rows = table.melt(["Incident_angle", "Measure_angle"], var_name="nm", value_name="R")
    angle = rows["Measure_angle"]
    rows = rows.assign(
        nm=rows["nm"].str.strip().str.removesuffix("nm"),
        R=rows["R"].where(rows["R"] != 0),
        receiver=angle.abs(),
        source_azimuth=0,
        receiver_azimuth=np.where(angle < 0, 0, 180),
    )
    rows.to_csv(out, index=False)
