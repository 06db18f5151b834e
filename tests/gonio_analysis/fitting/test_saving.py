"""A fit as a sample file: the covariance of its parameters goes with it, and every command takes the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from gonio_analysis.appearance.of_models import of_fit
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.level import level
from gonio_analysis.fitting.saving import save
from gonio_analysis.report.appearance import of

from gonio.errors import ConfigError
from gonio.models import CookTorrance, HeTorrance, Lambert, Model, Sum
from gonio.samples.files import load_sample
from tests.command_line import gonio
from tests.gonio_analysis.appearance.simulated import measured, noisy, plane
from tests.gonio_analysis.synthetic import known

SIGNED = np.arange(-75.0, 75.1, 5.0)
PAINT = HeTorrance(sigma0_um=0.1, tau_um=2.0, ior=1.5, diffuse_albedo=0.1)
FACETS = CookTorrance(s=0.3, d=0.7, slopes=((0.3, 1.0),), ior=1.5, diffuse_albedo=0.4)
BOTH = Sum((HeTorrance(sigma0_um=0.3, tau_um=1.5, ior=1.5), 1.0), (Lambert(0.3), 1.0))


def fitted(model: Model, name: str, **options: Any) -> FitResult:
    """A fit to a noisy table of a model."""
    frame = measured(model, np.vstack([plane(t, SIGNED) for t in (20.0, 45.0, 60.0)]))
    return fit(noisy(frame, np.random.default_rng(3)), name, **options)


@pytest.mark.parametrize(
    ("model", "name", "options"),
    [
        pytest.param(PAINT, "he-torrance", {"ior": 1.5}, marks=pytest.mark.slow),
        (PAINT, "he-torrance", {}),  # n is fitted, too
        (FACETS, "cook-torrance", {"ior": 1.5}),  # d follows s, and m stands in a list
        pytest.param(BOTH, "lambert+he-torrance", {"ior": 1.5}, marks=pytest.mark.slow),
    ],
    ids=("paint", "index", "facets", "sum"),
)
def test_uncertainties_of_appearance_come_back_from_the_file(
    tmp_path: Path, model: Model, name: str, options: dict[str, Any]
) -> None:
    result = fitted(model, name, **options)
    save(result, tmp_path / "sample.toml", name="paint", source="a table")
    exact, stored = of_fit(result, name="paint"), of(str(tmp_path / "sample.toml"))
    measured_level = level(result) is not None  # the fit's numbers are at it, the file's are the model's own
    for key in ("gloss_20_gu", "gloss_60_gu", "gloss_85_gu", "rho_dh_8", "radiance_factor_45_0"):
        one, other = getattr(exact, key), getattr(stored, key)
        if measured_level:
            assert abs(known(other.value) - known(one.value)) < 3.0 * known(one.u), key  # by the noise of the level
            assert known(other.u) < 1.02 * known(one.u), key
            continue
        assert known(other.value) == pytest.approx(known(one.value), rel=1e-9), key  # the same arguments
        # arguments follow the search scale to first order, and a gloss is bent over a standard uncertainty
        assert known(other.u) == pytest.approx(known(one.u), rel=0.02), key
    assert any("as its file states them" in note for note in stored.notes)


def test_a_person_can_read_the_file_and_other_commands_take_it(tmp_path: Path) -> None:
    result = fitted(FACETS, "cook-torrance", ior=1.5)
    save(result, tmp_path / "sample.toml", name="paint", source="a table")
    sample = load_sample(tmp_path / "sample.toml")
    stated = dict(zip(known(sample.uncertainty).parameters, known(sample.uncertainty).u, strict=True))
    assert stated["s"] == pytest.approx(known(result.parameters["s"].u), rel=1e-4)
    assert stated["d"] == pytest.approx(stated["s"], rel=1e-4)  # d = 1 - s
    assert stated["slopes[0][0]"] == pytest.approx(known(result.parameters["m"].u), rel=1e-4)
    (tmp_path / "plan.toml").write_text(
        'name = "two"\nwavelength_nm = [550]\n[[sweep]]\ntheta_i_deg = [30]\ntheta_r_deg = [10, 20]\n'
    )
    arguments = ("measure", "plan.toml", "--rig", "sim-ideal", "--sample", "sample.toml", "--out", "run", "--yes")
    for command in (arguments, ("convert", "sample.toml", "paint.xml"), ("appearance", "sample.toml", "--json")):
        done = gonio(tmp_path, *command)
        assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["gloss_60_gu"]["u"] > 0.0


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"parameters": ["sigma"]}, 'there is no number "sigma" in [parameters]; there are albedo'),
        ({"u": [0.1, 0.2]}, "1 parameters, each once, need as many u"),
        ({"u": [-0.1]}, "uncertainty.u"),
        ({"correlation": [[0.5]]}, "1 on its diagonal"),
        ({"correlation": []}, "a correlation of 1 rows and columns"),
        (
            {
                "parameters": ["albedo", "a", "b"],
                "u": [0.1] * 3,
                "correlation": [[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]],
            },
            "it has a negative eigenvalue",
        ),
    ],
)
def test_what_is_wrong_with_a_stated_uncertainty_is_told(tmp_path: Path, changed: dict[str, Any], told: str) -> None:
    stated = {"parameters": ["albedo"], "u": [0.01], "correlation": [[1.0]]} | changed
    text = tomli_w.dumps({"name": "a", "model": "lambert", "parameters": {"albedo": 0.5}, "uncertainty": stated})
    (tmp_path / "sample.toml").write_text(text)
    with pytest.raises(ConfigError) as error:
        load_sample(tmp_path / "sample.toml")
    assert told in str(error.value)
    assert "sample.toml" in str(error.value)
