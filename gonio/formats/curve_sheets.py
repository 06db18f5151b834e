"""The curves of a table, for files that hold each by itself: NeXus and workbooks."""

from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gonio.errors import DataError
from gonio.typing import DataFrame, Floats

MOST = 500
"""Curves in one file: beyond, a table of all values is what a reader wants."""


@dataclass(frozen=True)
class CurveRows:
    """The rows of one curve: one incidence, one plane through the normal, one wavelength, one polarisation."""

    name: str
    """Name of the table, as in "550 nm, 45 deg"; each once."""
    rows: DataFrame
    """In the order of `signed_deg`."""
    signed_deg: Floats
    """Viewing angle in the plane [deg]: positive on the side of the mirror direction."""


def curves(frame: DataFrame, path: Path) -> Iterator[CurveRows]:
    """The curves of a table; `DataError` where there are more than `MOST`."""
    import pandas as pd

    theta_r, phi_i = (frame[name].to_numpy(np.float64) for name in ("theta_r_deg", "phi_i_deg"))
    dphi = np.round(np.mod(frame["phi_r_deg"].to_numpy(np.float64) - phi_i, 360.0), 6)
    keys = pd.DataFrame(
        {name: frame[name].to_numpy() if name in frame.columns else "" for name in ("sample", "side")}
        | {
            "polarisation": frame["polarisation"].to_numpy(),
            "nm": frame["wavelength_nm"].to_numpy(np.float64),
            "theta_i": frame["theta_i_deg"].to_numpy(np.float64),
            "phi_i": phi_i,
            # the normal itself belongs to every plane
            "plane": np.where(theta_r == 0.0, 0.0, np.mod(dphi, 180.0)),
        }
    )
    groups = keys.groupby(list(keys.columns), sort=False, dropna=False).indices
    if len(groups) > MOST:
        raise DataError(f"{path}: the table has {len(groups)} curves, and at most {MOST} are written one by one")
    for index in map(np.asarray, groups.values()):
        signed = np.where(dphi[index] >= 180.0, 1.0, -1.0) * theta_r[index]
        order = np.argsort(signed, kind="stable")
        yield CurveRows(_name(keys.iloc[int(index[0])].to_dict()), frame.take(index[order]), signed[order])


def _name(key: dict[Hashable, Any]) -> str:
    parts = [
        str(key["sample"]),
        f"{key['nm']:g} nm" if np.isfinite(key["nm"]) else "",
        f"{key['theta_i']:g} deg",
        f"from {key['phi_i']:g}" if key["phi_i"] else "",
        f"plane {key['plane']:g}" if key["plane"] else "",
        "" if key["polarisation"] == "unpolarised" else str(key["polarisation"]),
        "transmission" if key["side"] == "transmission" else "",
    ]
    return ", ".join(part for part in parts if part)
