"""Quantities of appearance of models that are not true: their uncertainties hold the misfit, or its curve is kept."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_analysis.appearance.of_models import of_fit, of_fits, of_model, of_sample
from gonio_analysis.commands import fit as fit_command
from gonio_analysis.fitting.energy import UNDETERMINED
from gonio_analysis.fitting.fit import fit
from gonio_analysis.result_records import Appearance

import gonio
from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.models import ArrayModel
from gonio.samples.files import load_sample
from gonio.typing import Floats
from tests.command_line import some

from ..fitting.test_misfit import facets, of_facets

pytestmark = pytest.mark.slow

POINTS = ("rho_dh_8", "gloss_20_gu", "haze_e430_20", "haze_e430_30", "radiance_factor_0_45", "radiance_factor_45_0")


class Facets(ArrayModel):
    """The sample of the tables: no model of the papers."""

    name = "facets"

    def __init__(self, of: dict[str, float]) -> None:
        self.of = of

    @property
    def convention(self) -> str:
        return "Facets after Trowbridge and Reitz."

    def evaluate(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> Floats:
        return facets(self.of["alpha"], self.of["f0"], self.of["rho"], Directions.from_vectors(omega_i, omega_r))


def numbers(found: Appearance) -> list[tuple[float, float]]:
    """Values and standard uncertainties of what lies among the measured angles."""
    picked: list[Any] = [getattr(found, key) for key in POINTS]
    picked += [r for r in found.rho_dh if r.theta_i_deg in (30.0, 45.0)]
    picked += [c.L for c in found.lab if c.theta_i_deg == 45.0]
    return [(float(q.value), 0.0 if q.u is None else float(q.u)) for q in picked]


@pytest.mark.parametrize("residual", [False, True])
def test_what_is_stated_holds(residual: bool) -> None:
    """Eight tables of samples that no model has, each with a model that comes near."""
    pulls, wide = [], []
    for seed in range(4):
        for plan, model in (("hemisphere", "cook-torrance"), ("in plane", "blinn")):
            table, of = of_facets(40 + seed, plan)
            stated = numbers(of_fit(fit(table, model), name="a sample", residual=residual))
            true = numbers(of_model(Facets(of), name="truth"))
            pulls += [(value - t) / u for (value, u), (t, _) in zip(stated, true, strict=True)]
            wide += [u / t for (_, u), (t, _) in zip(stated, true, strict=True)]
    # 95 % are stated; the numbers of one table are alike, so eight tables are worth some 27: 3 sigma below is 82 %
    assert np.mean(np.abs(pulls) < 1.96) >= 0.82
    assert np.sqrt(np.mean(np.square(pulls))) > 0.3, "nor are they so wide that they say nothing"
    assert np.median(wide) < 0.05


def test_models_that_cannot_be_told_apart_are_combined() -> None:
    table, _ = of_facets(41, "hemisphere")
    fits = [fit(table, model) for model in ("cook-torrance", "blinn")]
    one, other = (of_fit(f, name="a sample", residual=True) for f in fits)
    both = of_fits([(3.0, fits[0]), (1.0, fits[1])], name="a sample")
    for (a, u_a), (b, u_b), (mean, u) in zip(numbers(one), numbers(other), numbers(both), strict=True):
        assert mean == pytest.approx(0.75 * a + 0.25 * b)
        assert u**2 == pytest.approx(0.75 * u_a**2 + 0.25 * u_b**2 + 0.75 * 0.25 * (a - b) ** 2)


def test_a_saved_misfit_is_read_again(tmp_path: Path) -> None:
    table, _ = of_facets(42, "hemisphere")
    gonio.write(table, tmp_path / "t.csv")
    file = tmp_path / "sample.toml"
    fit_command("cook-torrance", str(tmp_path / "t.csv"), save=file, residual=True)
    read = numbers(of_sample(load_sample(file)))
    of_it = numbers(of_fit(fit(gonio.read(tmp_path / "t.csv"), "cook-torrance"), name="", residual=True))
    for (value, u), (other, known) in zip(read, of_it, strict=True):
        assert value == pytest.approx(other, rel=1e-4)  # parameters have six digits or more
        assert u == pytest.approx(known, rel=0.02)


def test_a_saved_model_knows_that_it_is_off(tmp_path: Path) -> None:
    """Without the curve the size of the misfit is in the file, and every value is off by so much."""
    table, _ = of_facets(42, "hemisphere")
    gonio.write(table, tmp_path / "t.csv")
    fit_command("lambert", str(tmp_path / "t.csv"), save=tmp_path / "sample.toml")
    found = of_sample(load_sample(tmp_path / "sample.toml"))
    tau = some(fit(table, "lambert").misfit)
    factor = found.radiance_factor_45_0
    assert some(factor.u) >= tau.tau * some(factor.value) * 0.99
    light = found.lab[0].L
    assert some(light.u) >= tau.tau * (some(light.value) + 16.0) / 3.0 * 0.99


def test_beyond_the_measured_angles_it_is_said() -> None:
    found = of_fit(fit(of_facets(43, "in plane")[0], "cook-torrance"), name="a sample")
    assert any("No value near tells the misfit of" in note and "gloss at 85°" in note for note in found.notes)
    gloss = found.gloss_85_gu  # nothing bounds a misfit there
    assert (gloss.value, gloss.u, gloss.why) == (None, None, UNDETERMINED)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "--save"),
        ({"joint": True}, "--joint"),
        ({"metric": "log"}, "--metric log"),
        ({"loss": "huber"}, "--loss huber"),
    ],
)
def test_where_there_is_no_misfit_to_keep_it_is_told(options: dict[str, Any], words: str, tmp_path: Path) -> None:
    gonio.write(of_facets(42, "hemisphere")[0], tmp_path / "t.csv")
    save = tmp_path / "s.toml" if options else None
    with pytest.raises(ConfigError, match=words):
        fit_command("lambert", str(tmp_path / "t.csv"), residual=True, save=save, **options)
    assert not (tmp_path / "s.toml").exists()
