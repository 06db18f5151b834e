"""Examples in docstrings run and print what they say; each function that a notebook calls has one."""

import doctest
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gonio_analysis
import matplotlib
import numpy as np
import pandas as pd
import pytest

import gonio
from gonio import materials, models
from gonio.models import parameters
from gonio.models.model import Model

EXAMPLES: list[Callable[..., Any]] = [
    gonio.read,
    gonio.write,
    gonio.apparent_brdf,
    materials.ior,
    models.build,
    models.examine,
    parameters.parameter,
    Model.brdf,
    Model.btdf,
    Model.directional_hemispherical,
    *(getattr(gonio_analysis, name) for name in ("change", "compare", "consensus", "fit", "polar", "semilog")),
]


@pytest.fixture
def clay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with clay.csv: two incidences in the plane, values with 1 %."""
    theta_i, theta_r = (a.ravel() for a in np.meshgrid([20.0, 50.0], np.arange(0.0, 80.0, 10.0)))
    f = gonio.OrenNayar(albedo=0.6, sigma_deg=20.0).brdf(np.radians(theta_i), 0.0, np.radians(theta_r), np.pi)
    angles = {"theta_i_deg": theta_i, "phi_i_deg": 0.0, "theta_r_deg": theta_r, "phi_r_deg": 180.0}
    values = {"brdf": f, "u_brdf": 0.01 * f, "u_random": 0.01 * f, "flag": ""}
    monkeypatch.chdir(tmp_path)
    gonio.write(pd.DataFrame({**angles, "wavelength_nm": 550.0, "polarisation": "unpolarised", **values}), "clay.csv")
    matplotlib.use("agg")


@pytest.mark.usefixtures("clay")
@pytest.mark.parametrize("of", EXAMPLES, ids=lambda of: f"{of.__module__}.{of.__qualname__}")
def test_an_example_runs(of: Callable[..., Any]) -> None:
    module = importlib.import_module(of.__module__)
    (example,) = doctest.DocTestFinder(recurse=False).find(of, of.__qualname__, module, globs={})
    assert example.examples, "no example"
    said: list[str] = []
    failed, _ = doctest.DocTestRunner().run(example, out=said.append)
    assert not failed, "".join(said)
