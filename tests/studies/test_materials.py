"""The study `materials`: the right model is nearest, what cannot be read is named, and a second call adds to it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gonio import measurement
from gonio.errors import ConfigError
from gonio.models import build
from tests.gonio_analysis.synthetic import measure
from tools.studies.materials import make

MODELS = ("lambert", "eon", "ggx")
OF = {"eon": {"rho": 0.7, "r": 0.9}, "ggx": {"alpha": 0.3, "ior": 1.6, "diffuse_albedo": 0.1}}


@pytest.mark.slow
def test_each_material_is_told_by_what_was_left_out(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    for name, parameters in OF.items():
        measurement.write(measure(build(name, parameters), noise=0.01, name=f"made of {name}"), data / f"{name}.csv")
    (data / "notes.txt").write_text("nothing measured")
    page = make([str(data)], tmp_path / "out", models=MODELS, jobs=1)
    results = json.loads((page.parent / "results.json").read_text(encoding="utf-8"))
    errors = {
        r["name"].partition(".")[0]: {m: one["left_out"] for m, one in r["models"].items()}
        for r in results["materials"]
    }
    assert set(errors) == {"eon", "ggx"}
    for name, own in errors.items():
        assert min(own, key=own.__getitem__) == name
        assert own[name] < 0.03  # 1 % of noise
    assert "notes.txt" in results["not_read"]
    assert "Passed over" in page.read_text(encoding="utf-8")
    before = {path: path.stat().st_mtime_ns for path in (page.parent / "records").iterdir()}
    measurement.write(measure(build("lambert", {"albedo": 0.4}), noise=0.01, name="dull"), data / "dull.csv")
    make([str(data)], tmp_path / "out", models=MODELS, jobs=1)
    after = {path: path.stat().st_mtime_ns for path in (page.parent / "records").iterdir()}
    assert len(after) == 3
    assert before.items() <= after.items(), "what was done is not done again"


def test_nothing_to_read_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(ConfigError, match="no measurement there can be read"):
        make([str(tmp_path)], tmp_path / "out", models=MODELS)
    with pytest.raises(ConfigError, match="gxx"):
        make([str(tmp_path)], tmp_path / "out", models=("gxx",))
    assert not (tmp_path / "out").exists()
