"""Measurement tables made from a model, with noise whose covariance is known."""

from typing import Any, TypeVar

import numpy as np
import pandas as pd
from gonio_analysis.fitting.forward import seen
from gonio_analysis.fitting.value_covariance import Covariance
from gonio_analysis.report.comparison import summarise
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.selection.compare import Dataset

from gonio.formats.reader import table
from gonio.geometry import Directions
from gonio.typing import Floats

T = TypeVar("T")


def dense(covariance: Covariance) -> Floats:
    """The matrix diag(random^2) + common common^T itself, (n, n)."""
    return np.diag(covariance.random**2) + covariance.common @ covariance.common.T


def measure(
    model: Any,
    *,
    incidences: tuple[float, ...] = (10.0, 30.0, 60.0),
    views: Floats | None = None,
    seed: int = 0,
    noise: float = 0.01,
    floor: float = 1e-4,
    reference: float = 0.0,
    cone_sr: float = 0.0,
    wavelength_nm: float = 550.0,
    name: str = "synthetic",
) -> pd.DataFrame:
    """An in-plane sweep: independent noise of `noise` f and `floor`, and one common relative error `reference`."""
    rng = np.random.default_rng(seed)
    signed = np.arange(-80.0, 81.0, 5.0) if views is None else views
    theta_i, signed = (a.ravel() for a in np.meshgrid(incidences, signed, indexing="ij"))
    phi_r = np.where(signed >= 0, 180.0, 0.0)
    theta_r = np.abs(signed)
    true = seen(
        model,
        Directions.from_degrees(theta_i, 0.0, theta_r, phi_r),
        wavelength_nm=550.0 if np.isnan(wavelength_nm) else wavelength_nm,
        cones=(cone_sr, cone_sr),
    )
    random = np.hypot(noise * true, floor)
    measured = true * (1 + reference * rng.normal()) + random * rng.normal(size=true.size)
    frame = table(
        theta_i_deg=theta_i,
        phi_i_deg=0.0,
        theta_r_deg=theta_r,
        phi_r_deg=phi_r,
        wavelength_nm=wavelength_nm,
        brdf=measured,
        u_brdf=np.hypot(random, reference * measured),
        u_random=random,
        attrs={
            "source_solid_angle_sr": cone_sr or None,
            "receiver_solid_angle_sr": cone_sr or None,
            "sample": name,
            "source_file": f"{name}.csv",
        },
    )
    if reference:
        frame.insert(list(frame.columns).index("flag"), "s_reference", reference * measured)
    return frame


def joined(*parts: pd.DataFrame) -> pd.DataFrame:
    """One table of several, with what the first one says of itself."""
    whole = pd.concat(parts, ignore_index=True)
    whole.attrs = parts[0].attrs
    return whole


def facts_of(dataset: Dataset) -> DatasetSummary:
    """What a report says of a sample in numbers."""
    (facts,) = summarise([dataset], title="", normalise="mirror", command="").datasets
    return facts


def known(value: T | None) -> T:
    """A value that has to be there."""
    assert value is not None
    return value
