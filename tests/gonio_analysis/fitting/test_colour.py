"""From a table of the channels red, green and blue to one sample file, against the model that made the values."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.fitting.saving import save
from gonio_analysis.fitting.spectrum import MOST_VALUES, fit_every

from gonio import measurement
from gonio.colour import SRGB
from gonio.config import numbers_in
from gonio.errors import DataError
from gonio.formats import channels
from gonio.models import SpectralModel, build
from gonio.samples.files import load_model
from gonio.spectra import RGB_NM, at_wavelength
from tests.command_line import gonio
from tests.gonio_analysis.synthetic import joined, known, measure

SHARED = {"exponent": 40.0, "k_s": 0.1, "k_d": {"red": 0.5, "green": 0.12, "blue": 0.05}}
APART = {**SHARED, "exponent": {"red": 20.0, "green": 40.0, "blue": 80.0}}


def colour_table(
    parameters: dict[str, Any], model: str = "phong", *, only: tuple[str, ...] = tuple(RGB_NM)
) -> pd.DataFrame:
    """Channels of one sample as a file in colour has them: samples, without a wavelength."""
    parts = []
    for k, colour in enumerate(only):
        one = measure(build(model, at_wavelength(parameters, RGB_NM[colour])), wavelength_nm=RGB_NM[colour], seed=k)
        parts.append(one.assign(wavelength_nm=np.nan, sample=f"paint {colour}"))
    table = joined(*parts)
    table.attrs = {**parts[0].attrs, "samples": [f"paint {colour}" for colour in only]}
    return table


@pytest.fixture
def painted(tmp_path: Path) -> Path:
    measurement.write(colour_table(SHARED), tmp_path / "paint.csv")
    return tmp_path / "paint.csv"


def test_three_channels_become_one_table_and_other_samples_stay() -> None:
    parts = measurement.samples(colour_table(SHARED))
    grey = parts["paint red"]
    found = channels.joined({"a": grey, **parts, "b red": grey})
    assert list(found) == ["a", "paint", "b red"]
    assert found["a"] is grey
    assert channels.is_joined(found["paint"])
    assert not channels.is_joined(grey)
    for colour, nm in RGB_NM.items():
        here = found["paint"][found["paint"]["wavelength_nm"] == nm]
        assert np.array_equal(here["brdf"], parts[f"paint {colour}"]["brdf"])


def test_a_name_takes_its_channels_from_a_file_of_several_samples(tmp_path: Path) -> None:
    whole = joined(colour_table(SHARED), measure(build("lambert", {"albedo": 0.5})).assign(sample="grey"))
    whole.attrs = {**whole.attrs, "samples": [*whole.attrs["samples"], "grey"]}
    measurement.write(whole, tmp_path / "two.csv")
    assert list(measurement.tables(tmp_path / "two.csv")) == ["paint", "grey"]
    (name, table), *none = measurement.tables(f"{tmp_path / 'two.csv'}:paint").items()
    assert (name, none) == ("paint", [])
    assert channels.is_joined(table)
    with pytest.raises(DataError, match='holds no sample "wood"'):
        measurement.tables(f"{tmp_path / 'two.csv'}:wood")


@pytest.mark.parametrize(("truth", "same"), [(SHARED, True), (APART, False)])
def test_a_colour_is_fitted_saved_and_read_within_its_uncertainty(
    tmp_path: Path, truth: dict[str, Any], same: bool
) -> None:
    """The exponent is one number where it is one in truth, and three where the channels have three."""
    measurement.write(colour_table(truth), tmp_path / "paint.csv")
    done = gonio(tmp_path, "fit", tmp_path / "paint.csv", "--model", "phong", "--save", tmp_path / "paint.toml")
    assert done.returncode == 0, done.stderr
    model, sample = load_model(tmp_path / "paint.toml")
    assert isinstance(model, SpectralModel)
    assert model.of_channels
    assert isinstance(sample.parameters["exponent"], float) == same
    u = dict(zip(known(sample.uncertainty).parameters, known(sample.uncertainty).u, strict=True))
    values = numbers_in(sample.parameters)
    assert set(u) == set(values)
    true = {n: at_wavelength(truth, RGB_NM[n.partition(".")[2] or "green"])[n.partition(".")[0]] for n in values}
    for name, value in values.items():
        # nine numbers at most within 3.5 standard errors each: by chance one in 240 times
        assert abs(value - true[name]) < 3.5 * u[name], name


def test_correlations_are_those_of_one_fit_of_all_values(tmp_path: Path) -> None:
    """Given what is shared, errors of channels are independent: so says a dense least squares, too."""
    table = channels.joined(measurement.samples(colour_table(SHARED)))["paint"]
    first, *others = fit_every(observations(table), FitRequest("phong"))
    save(first, tmp_path / "a.toml", name="a", source="a", others=others)
    dense = fit(table, FitRequest("phong", each=["k_d", "k_s"]))
    save(dense, tmp_path / "b.toml", name="b", source="b")
    blocks, whole = (tomllib.loads((tmp_path / f"{n}.toml").read_text()) for n in "ab")
    assert blocks["uncertainty"]["parameters"] == whole["uncertainty"]["parameters"]
    # as in test_spectrum.py: both searches end within a hundredth of an error, and errors follow
    u = np.array(whole["uncertainty"]["u"])
    a, b = ([numbers_in(t["parameters"])[n] for n in t["uncertainty"]["parameters"]] for t in (blocks, whole))
    assert np.abs(np.subtract(a, b)) == pytest.approx(0.0, abs=1e-2 * u.min())
    assert blocks["uncertainty"]["u"] == pytest.approx(u, rel=1e-2)
    assert np.array(blocks["uncertainty"]["correlation"]) == pytest.approx(
        np.array(whole["uncertainty"]["correlation"]), abs=1e-2
    )


def test_a_spectrum_is_saved_as_one(tmp_path: Path) -> None:
    parts = [
        measure(build("phong", {"k_d": k_d, "k_s": 0.1, "exponent": 40.0}), wavelength_nm=nm, seed=int(nm))
        for nm, k_d in {450.0: 0.1, 550.0: 0.2, 700.0: 0.4}.items()
    ]
    measurement.write(joined(*parts), tmp_path / "s.csv")
    for more in ([], ["--joint", "--each", "k_d"]):
        done = gonio(tmp_path, "fit", tmp_path / "s.csv", "--model", "phong", *more, "--save", tmp_path / "s.toml")
        assert done.returncode == 0, done.stderr
        model, sample = load_model(tmp_path / "s.toml")
        assert isinstance(sample.parameters["exponent"], float)
        assert sample.parameters["k_d"]["wavelength_nm"] == [450.0, 550.0, 700.0]
        u = dict(zip(known(sample.uncertainty).parameters, known(sample.uncertainty).u, strict=True))
        assert abs(sample.parameters["k_d"]["value"][2] - 0.4) < 3.5 * u["k_d.value[2]"]
        assert isinstance(sample.parameters["k_s"], float) == bool(more)
        assert isinstance(model, SpectralModel)


def test_two_channels_are_two_samples(tmp_path: Path) -> None:
    measurement.write(colour_table(SHARED, only=("red", "green")), tmp_path / "paint.csv")
    done = gonio(tmp_path, "fit", tmp_path / "paint.csv", "--model", "phong", "--save", tmp_path / "paint.toml")
    assert done.returncode == 2
    assert "paint has the channels red and green" in " ".join(done.stderr.split())
    assert not (tmp_path / "paint.toml").exists()


def test_one_channel_can_be_named_and_one_wavelength_asked_for(tmp_path: Path, painted: Path) -> None:
    for spec, more, colour in ((f"{painted}:paint red", [], "red"), (painted, ["--wavelength-nm", "465"], "blue")):
        done = gonio(tmp_path, "fit", spec, "--model", "phong", "--json", *more)
        found = json.loads(done.stdout)
        assert "series" not in found
        k_d = found["parameters"]["k_d"]
        assert abs(k_d["value"] - at_wavelength(SHARED, RGB_NM[colour])["k_d"]) < 3.5 * k_d["u"]


def test_many_values_without_uncertainties_are_thinned() -> None:
    table = channels.joined(measurement.samples(colour_table(SHARED)))["paint"].assign(u_brdf=np.nan, u_random=np.nan)
    many = pd.concat([table] * (MOST_VALUES // len(table) + 2), ignore_index=True)
    many.attrs = table.attrs
    fits = fit_every(observations(many), FitRequest("phong"))
    assert len(fits) == 3
    assert sum(len(one.data) for one in fits) <= MOST_VALUES
    assert any("evenly taken" in note for note in fits[0].notes)


def test_a_report_shows_one_sample_with_its_colour(tmp_path: Path, painted: Path) -> None:
    done = gonio(tmp_path, "compare", painted, "--models", "phong", "--out", tmp_path / "report", "--png")
    assert done.returncode == 0, done.stderr
    (sample,) = json.loads((tmp_path / "report" / "summary.json").read_text())["datasets"]
    assert sample["name"] == "paint"
    assert len(sample["models"]["phong"]["series"]) == 3
    picture = known(cv2.imread(str(tmp_path / "report" / "figures" / "paint-colour.png")))
    strip = SRGB.decode(picture[25, picture.shape[1] // 3, ::-1] / 255.0)  # a retro angle, away from the lobe
    # k_d beside a perfect white; the lobe's foot adds 0.003 and a step of the picture is 0.009 at 0.5
    assert strip == pytest.approx([0.5, 0.12, 0.05], abs=0.015)
