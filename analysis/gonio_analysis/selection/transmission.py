"""What a sample lets through: the rows of transmission of a table, apart from all that is reflected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gonio import measurement, shown
from gonio_analysis.curves.in_plane import Curve, curves, selection
from gonio_analysis.fitting import energy
from gonio_analysis.fitting.observations import Observations, describe_left_out, observations
from gonio_analysis.result_records import Reflectance

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Transmitted:
    """The usable rows of transmission of one sample at one wavelength.

    Directions toward the detector are turned over (`gonio.measurement.turned_over`): theta_r is counted from the normal
    of the back, and the mirror direction stands for straight through.
    """

    name: str
    rows: int
    """Of transmission in the table, at every wavelength."""
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
    table: pd.DataFrame, name: str, wavelength_nm: float | None = None, u_rel: float | None = None
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
