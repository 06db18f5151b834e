"""The commands as functions: options, output, and light imports."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from gonio_analysis import commands

from gonio import measurement
from gonio.errors import ConfigError
from gonio.models import build
from tests.gonio_analysis.synthetic import measure


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "paint.csv"
    measurement.write(measure(build("oren-nayar", {"albedo": 0.6, "sigma_deg": 20.0}), noise=0.005), path)
    return path


def test_fit_prints_json(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands.fit(str(table), "oren-nayar", as_json=True)
    out = json.loads(capsys.readouterr().out)
    assert out["model"] == "oren-nayar"
    # six standard errors
    assert out["parameters"]["sigma_deg"]["value"] == pytest.approx(20.0, rel=0.02)
    assert out["table"] == str(table)


def test_fit_prints_a_table(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands.fit(str(table), "oren-nayar", fix=["albedo=0.6"])
    out = capsys.readouterr().out
    assert "sigma_deg" in out
    assert "fixed" in out
    assert "reduced chi-square" in out


def test_compare_prints_the_path(table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands.compare([str(table)], tmp_path / "out", models="lambert, oren-nayar")
    assert Path(capsys.readouterr().out.strip()) == tmp_path / "out" / "index.html"


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
        commands.fit(str(tmp_path / "run"), "lambert")


@pytest.mark.parametrize(
    ("text", "value"),
    [("0.77+6.08j", 0.77 + 6.08j), ("1.5", 1.5 + 0j), ("1.37+7.6i", 1.37 + 7.6j), ("Al", "Al"), (None, None)],
)
def test_optical_constants(text: str | None, value: object) -> None:
    assert commands.read_ior(text) == value


@pytest.mark.parametrize("text", ["-1+2j", "1.5-2j", "0", "nan", "Unobtainium"])
def test_wrong_optical_constants(text: str) -> None:
    with pytest.raises(ConfigError):
        commands.read_ior(text)


def test_fixed_values() -> None:
    assert commands.read_fixed("tau_um=1.77") == ("tau_um", 1.77)
    assert commands.read_fixed("form = exact") == ("form", "exact")
    for text in ("tau_um", "=3", "tau_um=", "tau_um=inf"):
        with pytest.raises(ConfigError, match="--fix"):
            commands.read_fixed(text)


def test_bounds_and_priors() -> None:
    assert commands.read_bound("tau_um = 0.5:5") == ("tau_um", (0.5, 5.0))
    assert commands.read_prior("m=0.2+-0.01") == commands.read_prior("m=0.2±0.01") == ("m", (0.2, 0.01))
    for text in ("m=0.2", "m=a:b", "0.1:0.2"):
        with pytest.raises(ConfigError, match=r"--bound tau_um=0\.5:5"):
            commands.read_bound(text)


def test_fit_prints_intervals(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands.fit(str(table), "oren-nayar", intervals=True, as_json=True)
    found = json.loads(capsys.readouterr().out)["intervals"]["sigma_deg"]
    assert found["low"] < 20.0 < found["high"]


def test_importing_the_commands_imports_nothing_heavy() -> None:
    code = (
        "import sys, gonio_analysis.commands;"
        "print([m for m in ('numpy', 'scipy', 'pandas', 'matplotlib', 'numba') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=True)
    assert done.stdout.strip() == "[]"
