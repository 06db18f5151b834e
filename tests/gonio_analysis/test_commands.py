"""The commands as functions: options, output, and light imports."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_analysis import commands
from gonio_analysis.changes.sides import side
from gonio_analysis.commands import arguments, warm
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.optical_constants import read_ior
from gonio_analysis.fitting.parameters import declared
from gonio_analysis.fitting.saving import save as save_fit
from gonio_maps.models._batch_models import MODELS

from gonio import measurement
from gonio.errors import ConfigError
from gonio.models import build
from tests.command_line import gonio, says
from tests.gonio_analysis.synthetic import measure


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "paint.csv"
    measurement.write(measure(build("oren-nayar", {"albedo": 0.6, "sigma_deg": 20.0}), noise=0.005), path)
    return path


def test_fit_prints_json(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands.fit("oren-nayar", str(table), as_json=True)
    out = json.loads(capsys.readouterr().out)
    assert out["model"] == "oren-nayar"
    # six standard errors
    assert out["parameters"]["sigma_deg"]["value"] == pytest.approx(20.0, rel=0.02)
    assert out["table"] == str(table)


def test_fit_prints_a_table(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands.fit("oren-nayar", str(table), fix=["albedo=0.6"])
    says(capsys.readouterr().out, "sigma_deg", "fixed", "reduced chi-square")


@pytest.mark.parametrize("nm", ["-550", "nan", "inf"])
@pytest.mark.parametrize(
    "words",
    [
        ("fit", "--model", "lambert"), ("compare", "--models", "lambert", "--out", "o"),
        ("compare", "paint.csv", "--change", "--out", "o"), ("compare", "paint.csv", "--laboratories", "--out", "o"),
        ("remounts", "other.csv"), ("appearance",),
    ],
)  # fmt: skip
def test_a_wavelength_that_is_none_is_refused(table: Path, nm: str, words: tuple[str, ...]) -> None:
    (table.parent / "other.csv").write_bytes(table.read_bytes())
    done = gonio(table.parent, words[0], table.name, *words[1:], "--wavelength-nm", nm, expect=2)
    assert "a wavelength is above 0 nm" in done.stderr
    assert not (table.parent / "o").exists()


@pytest.mark.slow
def test_compare_prints_the_path(table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands.compare([str(table)], tmp_path / "out", models="lambert, oren-nayar", radius="2.5")
    assert Path(capsys.readouterr().out.strip()) == tmp_path / "out" / "index.html"
    figures = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))["figures"]
    polar = [one["caption"] for one in figures if "-polar-" in one["name"]]
    assert polar
    assert all("The rim is at 2.5, as asked for. Strokes on the rim" in caption for caption in polar)


def test_unknown_model_is_told_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no model named"):
        commands.compare([str(tmp_path / "absent.csv")], tmp_path / "out", models="no-such-model")
    for models in ("", "lambert,,"):
        with pytest.raises(ConfigError, match="a name is missing"):
            commands.compare([str(tmp_path / "absent.csv")], tmp_path / "out", models=models)
    with pytest.raises(ConfigError, match="no such folder"):
        commands.report(tmp_path / "absent")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.toml").write_text("")
    with pytest.raises(ConfigError, match="gonio reduce"):
        commands.fit("lambert", str(tmp_path / "run"))


@pytest.mark.parametrize(
    ("text", "value"),
    [("0.77+6.08j", 0.77 + 6.08j), ("1.5", 1.5 + 0j), ("1.37+7.6i", 1.37 + 7.6j), ("Al", "Al"), (None, None)],
)
def test_optical_constants(text: str | None, value: object) -> None:
    assert read_ior(text) == value


@pytest.mark.parametrize("text", ["-1+2j", "1.5-2j", "0", "nan", "Unobtainium"])
def test_wrong_optical_constants(text: str) -> None:
    with pytest.raises(ConfigError):
        read_ior(text)


def test_a_radius_is_a_number_above_0_or_auto() -> None:
    assert (arguments.read_radius("auto"), arguments.read_radius("1.6")) == (None, 1.6)
    for text in ("0", "-1", "nan", "inf", "wide", ""):
        with pytest.raises(ConfigError, match=f"--radius {text}: a number above 0, or: auto"):
            arguments.read_radius(text)


def test_fixed_values() -> None:
    assert arguments.read_fixed("tau_um=1.77") == ("tau_um", 1.77)
    assert arguments.read_fixed("form = exact") == ("form", "exact")
    for text in ("tau_um", "=3", "tau_um=", "tau_um=inf"):
        with pytest.raises(ConfigError, match="--fix"):
            arguments.read_fixed(text)


def test_bounds_and_priors() -> None:
    assert arguments.read_bound("tau_um = 0.5:5") == ("tau_um", (0.5, 5.0))
    assert arguments.read_prior("m=0.2+-0.01") == arguments.read_prior("m=0.2±0.01") == ("m", (0.2, 0.01))
    for text in ("m=0.2", "m=a:b", "0.1:0.2"):
        with pytest.raises(ConfigError, match=r"--bound tau_um=0\.5:5"):
            arguments.read_bound(text)


def test_fit_prints_intervals(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands.fit("oren-nayar", str(table), intervals=True, as_json=True)
    found = json.loads(capsys.readouterr().out)["intervals"]["sigma_deg"]
    assert found["low"] < 20.0 < found["high"]


def test_importing_the_commands_imports_nothing_heavy() -> None:
    code = (
        "import sys, gonio_analysis.commands;"
        "print([m for m in ('numpy', 'scipy', 'pandas', 'matplotlib', 'numba') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=True)
    assert done.stdout.strip() == "[]"


FITTED: dict[str, tuple[dict[str, Any], str | None]] = {
    "blinn": ({"k_d": 0.2, "k_s": 0.4, "c": 0.3, "ior": 1.5}, "1.5"),
    "cook-torrance": ({"s": 0.3, "m": 0.25, "diffuse_albedo": 0.2, "ior": [1.5, 0.2]}, "1.5+0.2j"),
    "he-torrance": ({"sigma0_um": 0.28, "tau_um": 1.77, "ior": "Al"}, "Al"),
    "oren-nayar+phong": (
        {"oren-nayar": {"albedo": 0.5, "sigma_deg": 25.0}, "phong": {"k_d": 0.0, "k_s": 0.8, "exponent": 60.0}},
        None,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FITTED)
def test_a_saved_fit_is_the_sample_of_another_measurement(name: str, tmp_path: Path) -> None:
    truth, given = FITTED[name]
    (tmp_path / "plan.toml").write_text(
        'name = "two incidences"\nwavelength_nm = [550]\n[[sweep]]\ntheta_i_deg = [10, 50]\n'
        "theta_r_deg = { start = -72, stop = 72, step = 8 }\n"
    )
    measurement.write(measure(build("sum" if "+" in name else name, truth), noise=0.01), tmp_path / "a.csv")
    say = ["--model", name, *(["--ior", given] if given else []), "--json"]
    done = gonio(tmp_path, "fit", "a.csv", *say, "--save", "sample.toml", expect=0)
    first = json.loads(done.stdout)["parameters"]
    built = side(str(tmp_path / "sample.toml")).model
    data = observations(measurement.read(tmp_path / "a.csv"))
    np.testing.assert_array_equal(apparent(built, data), fit(data, name, ior=read_ior(given)).predicted)
    gonio(tmp_path, "measure", "plan.toml", "--rig", "sim-ideal", "--sample", "sample.toml", "--out", "run", expect=0)
    assert gonio(tmp_path, "reduce", "run").returncode == 0
    done = gonio(tmp_path, "fit", "run", *say)
    for key, e in json.loads(done.stdout)["parameters"].items():
        # the ideal rig has no noise: what is left is the search's own tolerance, and the mean over pixels
        assert e["value"] == pytest.approx(first[key]["value"], rel=2e-3, abs=1e-4), key


@pytest.mark.parametrize(
    ("name", "truth", "options"),
    [
        ("phong", {"k_d": 0.2, "k_s": 0.8, "exponent": 40.0}, {}),
        (
            "cook-torrance",
            {"s": 0.5, "d": 0.5, "slopes": [[0.1, 0.3], [0.4, 0.7]], "ior": "Cu", "diffuse_albedo": 0.2},
            {"slopes": 2, "ior": "Cu"},
        ),
        (
            "lambert+he-torrance",
            {"lambert": {"albedo": 0.2}, "he-torrance": {"weight": 0.7, "sigma0_um": 0.3, "tau_um": 1.8, "ior": "Al"}},
            {"ior": "Al"},
        ),
    ],
)
def test_a_saved_fit_is_what_was_fitted(
    name: str, truth: dict[str, Any], options: dict[str, Any], tmp_path: Path
) -> None:
    data = observations(measure(build("sum" if "+" in name else name, truth), noise=0.01))
    result = fit(data, name, **options)
    save_fit(result, tmp_path / "a.toml", name="a sample", source="a table")
    np.testing.assert_array_equal(apparent(side(str(tmp_path / "a.toml")).model, data), result.predicted)


def test_what_cannot_be_saved_is_told_before_the_fit(table: Path, tmp_path: Path) -> None:
    for words, save in (("no folder", "absent/a.toml"), ("ending", "sample.txt")):
        with pytest.raises(ConfigError, match=words):
            commands.fit("oren-nayar", str(table), save=tmp_path / save)


def test_parameters_as_a_fit_names_them_make_a_cook_torrance_sample() -> None:
    fitted = build("cook-torrance", {"s": 0.3, "m": 0.25, "diffuse_albedo": 0.2, "ior": 1.5})
    told = build("cook-torrance", {"s": 0.3, "d": 0.7, "slopes": [[0.25, 1.0]], "diffuse_albedo": 0.2, "ior": 1.5})
    assert fitted == told
    with pytest.raises(ConfigError, match="both given"):
        build("cook-torrance", {"m": 0.25, "slopes": 0.3})


@pytest.mark.slow
def test_warm_compiles_a_fit_of_every_model_and_of_every_map(tmp_path: Path) -> None:
    names = [job.keywords.get("name") or job.args[0] for job in warm.jobs()]
    assert names == [*declared(), *MODELS]
    says(gonio(tmp_path, "warm", expect=0).stdout, f"{len(names)} kinds of fits are compiled")
