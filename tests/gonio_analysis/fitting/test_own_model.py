"""A model of another package: the guide's example, installed, simulated, fitted, chosen and saved."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting import parameters
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.profile_likelihood import profiles
from gonio_analysis.selection.choice import candidates, choose

from gonio import measurement, models
from gonio.errors import ArgumentError
from gonio.formats import reader
from gonio.models import ArrayModel, Fitted
from tests.command_line import gonio
from tests.gonio_analysis.synthetic import known

GUIDE = Path(__file__).parents[3] / "docs" / "writing_a_model.md"
TRUE = {"rho_d": 0.15, "rho_s": 0.3, "a_x": 0.12, "a_y": 0.35}


def block(language: str) -> str:
    """The first fenced block of a language in the guide."""
    found = known(re.search(rf"^```{language}\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE))
    return found[1]


@pytest.fixture
def ward(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The guide's package, installed."""
    site = tmp_path / "site"
    info = site / "brushed-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: brushed\nVersion: 1.0\n")
    points = tomllib.loads(block("toml"))["project"]["entry-points"]["gonio.models"]
    lines = "".join(f"{name} = {value}\n" for name, value in points.items())
    (info / "entry_points.txt").write_text(f"[gonio.models]\n{lines}bare = brushed:Bare\n")
    (site / "brushed.py").write_text(block("python") + "\n\nclass Bare(Ward):\n    fitted = {}\n")
    monkeypatch.syspath_prepend(site)


def measured(azimuths: tuple[float, ...], seed: int = 0) -> pd.DataFrame:
    """A brushed sample, in and across the plane of incidence, with 1 % of noise."""
    grid = np.meshgrid([15.0, 40.0], azimuths, np.arange(0.0, 71.0, 10.0), np.arange(0.0, 360.0, 30.0), indexing="ij")
    theta_i, phi_i, theta_r, dphi = (x.ravel() for x in grid)
    phi_r = (phi_i + dphi) % 360.0
    true = models.build("ward", TRUE).brdf(*map(np.radians, (theta_i, phi_i, theta_r, phi_r)))
    noise = np.random.default_rng(seed).normal(size=true.size)
    return reader.table(
        theta_i_deg=theta_i, phi_i_deg=phi_i, theta_r_deg=theta_r, phi_r_deg=phi_r, wavelength_nm=550.0,
        brdf=true * (1 + 0.01 * noise), u_brdf=0.01 * true, u_random=0.01 * true, attrs={},
    )  # fmt: skip


def test_the_guide_s_class_is_short() -> None:
    assert len([line for line in block("python").splitlines() if line.strip()]) <= 35  # imports and docstring included


def test_it_is_fitted_with_intervals(ward: None) -> None:
    result = fit(measured((0.0, 45.0, 90.0)), "ward")
    assert result.free == tuple(TRUE)
    for name, value in TRUE.items():
        e = result.parameters[name]
        assert abs(e.value - value) < 4 * known(e.u), name  # 4 parameters: by chance once in 4000
    assert known(result.p_value) > 1e-3
    (low, _), (high, _) = profiles(result, ("a_x",)).intervals["a_x"].ends
    u = known(result.parameters["a_x"].u)
    assert high - low == pytest.approx(2 * 1.96 * u, rel=0.1)  # linear near the solution


@pytest.mark.slow
def test_an_anisotropic_sample_is_described_by_it_and_by_no_other(ward: None) -> None:
    data = observations(measured((0.0, 45.0, 90.0)))
    tried = [c for c in candidates(["all"]) if c.model in ("lambert", "phong", "cook-torrance", "ward")]
    chosen = choose(data, tried, all_of_them=True)
    assert known(chosen.named).candidate.model == "ward"
    assert all(j.rejected for j in chosen.judged if j is not known(chosen.named))


def test_the_command_line_knows_it(ward: None, tmp_path: Path) -> None:
    measurement.write(measured((0.0, 90.0)), tmp_path / "a.csv")
    done = gonio(tmp_path, "fit", "a.csv", "--model", "ward", "--json", "--save", "steel.toml")
    assert done.returncode == 0, done.stderr
    found = {n: e["value"] for n, e in json.loads(done.stdout)["parameters"].items()}
    assert tomllib.loads((tmp_path / "steel.toml").read_text())["parameters"] == found
    done = gonio(tmp_path, "fit", "a.csv", "--model", "bare")
    assert done.returncode == 2
    assert "`fitted`" in done.stderr
    done = gonio(tmp_path, "fit", "a.csv", "--model", "wart")
    assert 'did you mean "ward"' in done.stderr


def test_only_models_that_declare_what_is_fitted_are_tried_unasked(ward: None) -> None:
    assert parameters.declared()[-1] == "ward"
    assert set(parameters.known()) - set(parameters.declared()) == {"bare"}


@pytest.mark.parametrize(
    "wrong",
    [
        {"lower": 1.0, "upper": 0.0},
        {"lower": 0.0, "upper": 1.0, "scale": "log"},
        {"lower": 0.0, "upper": 1.0, "starts": (2.0,)},
        {"lower": 0.0, "upper": 1.0, "fixed": -1.0},
        {"lower": 0.0, "upper": 1.0, "starts": "low"},
        {"lower": 0.0, "upper": float("inf")},
    ],
)
def test_a_wrong_declaration_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ArgumentError):
        Fitted(**wrong)  # type: ignore[arg-type]


def test_an_array_model_answers_as_the_others_do(ward: None) -> None:
    model = models.build("ward", TRUE)
    assert isinstance(model, ArrayModel)
    rng = np.random.default_rng(5)
    theta, phi = rng.uniform(0, 1.5, (2, 40)), rng.uniform(0, 6.0, (2, 40))
    by_angle = model.brdf(theta[0], phi[0], theta[1], phi[1])
    vectors = [
        np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], 1) for t, p in zip(theta, phi, strict=True)
    ]
    np.testing.assert_allclose(model.brdf_vectors(*vectors), by_angle, rtol=1e-12)  # rounding of the vectors
    assert isinstance(model.brdf(0.1, 0.2, 0.3, 0.4), float)
    assert model.brdf_vectors(vectors[0].astype(np.float32), vectors[1].astype(np.float32)).dtype == np.float32
    assert model.brdf_vectors(vectors[0] * [1, 1, -1], vectors[1]).max() == 0.0
    assert model.brdf(theta[0][:, None], 0.0, 0.3, 1.0, wavelength_nm=[450.0, 550.0]).shape == (40, 2)
    out = np.empty(40)
    assert model.brdf(theta[0], phi[0], theta[1], phi[1], out=out) is out
    assert np.array_equal(out, by_angle)
    with pytest.raises(ArgumentError):
        model.brdf_vectors([2.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    assert np.abs(model.brdf(theta[0], phi[0] + 0.5, theta[1], phi[1] + 0.5) / by_angle - 1).max() > 0.1
    assert float(model.directional_hemispherical(0.3)) < TRUE["rho_d"] + 1.2 * TRUE["rho_s"]
