"""What docs/interchange.md shows can be typed in."""

import json
import re
import tomllib
from pathlib import Path

import pytest
from gonio_bluesky.event_files import read

from gonio import measurement
from gonio.config import parse
from gonio.lab.rig.laboratory import Laboratory
from tests.command_line import gonio
from tests.places import ROOT, example

PAGE = (ROOT / "docs" / "interchange.md").read_text(encoding="utf-8")
PLAN = 'name = "two"\nwavelength_nm = [550]\n[[sweep]]\ntheta_i_deg = [20]\ntheta_r_deg = [0, 30]\n'
SAMPLE = 'name = "matte"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n'


def block(language: str, word: str) -> str:
    """The one code block of the page that holds a word."""
    (found,) = (text for text in re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL) if word in text)
    return found


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "sample.toml").write_text(SAMPLE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_its_python_runs_and_its_run_becomes_documents(here: Path) -> None:
    pytest.importorskip("bluesky", reason="bluesky is not installed (extra bluesky)")
    exec(compile(block("python", "from gonio_bluesky import measurement"), "interchange.md", "exec"), {})
    exec(compile(block("python", "from gonio_bluesky import devices"), "interchange.md", "exec"), {})
    for words in (("reduce", "RUN"), ("convert", "RUN", "run.jsonl", "--to", "bluesky")):
        assert gonio(here, *words).returncode == 0
    exec(compile(block("python", "event_model.Filler"), "interchange.md", "exec"), {})
    rows = [row["data"] for kind, row in read(here / "run.jsonl") if kind == "event" and "brdf" in row["data"]]
    assert [row["brdf"] for row in rows] == measurement.read(here / "RUN")["brdf"].tolist()


def test_its_laboratory_leaves_nothing_to_be_stated(here: Path) -> None:
    text = example("laboratory.toml")
    assert parse(Laboratory, tomllib.loads(text)["laboratory"], "interchange.md").address.city == "Espoo"
    with (here / "plan.toml").open("a") as plan:
        plan.write(text)
    gonio(here, "measure", "plan.toml", "--rig", "sim", "--sample", "sample.toml", "--out", "RUN", expect=0)
    assert gonio(here, "reduce", "RUN").returncode == 0
    for name in ("bird-json", "datacite"):
        gonio(here, "convert", "RUN", f"{name}.json", "--to", name, expect=0)
        assert "unknown" not in (here / f"{name}.json").read_text()


@pytest.mark.slow
def test_a_report_has_the_record_beside_it_and_the_laboratory_on_it(here: Path) -> None:
    with (here / "plan.toml").open("a") as plan:
        plan.write(example("laboratory.toml"))
    assert (
        gonio(here, "measure", "plan.toml", "--rig", "sim", "--sample", "sample.toml", "--out", "RUN").returncode == 0
    )
    assert gonio(here, "reduce", "RUN").returncode == 0
    assert gonio(here, "convert", "RUN", "datacite.json", "--to", "datacite").returncode == 0
    gonio(here, "report", "RUN", "--models", "lambert", expect=0)
    record = json.loads((here / "RUN" / "report" / "datacite.json").read_text())
    assert record == json.loads((here / "datacite.json").read_text())
    assert "Institute of Optics" in (here / "RUN" / "report" / "index.html").read_text()


def test_every_key_of_the_laboratory_is_on_the_page() -> None:
    def keys(schema: type) -> set[str]:
        found = set()
        for name, field in schema.model_fields.items():  # type: ignore[attr-defined]
            found.add(name)
            for inner in (field.annotation, *getattr(field.annotation, "__args__", ())):
                if hasattr(inner, "model_fields"):
                    found |= keys(inner)
        return found

    assert keys(Laboratory) <= set(re.findall(r"\w+", PAGE + example("laboratory.toml")))
