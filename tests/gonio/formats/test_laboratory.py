"""What a run states of its laboratory, from plan and rig file into the table, BiRD JSON and a DataCite record."""

import importlib.util
import json
import math
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gonio import measurement
from gonio.config import parse
from gonio.errors import ConfigError
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.rig.description import RigDescription
from tests.command_line import gonio
from tests.gonio import numpy_rig
from tests.gonio.formats.test_bird_json import validator
from tests.gonio.numpy_rig import PLAN, describe, plan_in

RIG: dict[str, Any] = {
    "organisation": "Institute of Optics",
    "contact": "Jane Doe",
    "email": "jane@example.org",
    "address": {"country": "Finland", "city": "Espoo", "street": "Maarintie", "building": "8", "postal_code": "02150"},
    "instrument": {
        "lamp": "xenon lamp",
        "lamp_type": "xenon arc",
        "lamp_power_w": 150.0,
        "lamp_range_nm": [250.0, 2000.0],
        "beam_diameter_mm": 10.0,
        "camera": "a camera",
        "camera_range_nm": [400.0, 1000.0],
    },
    "license": "CC-BY-4.0",
    "rights_holder": "Institute of Optics",
    "temperature_c": 20.0,
}
OF_PLAN = """
[laboratory]
temperature_c = 23.5
u_temperature_c = 0.5
description = "a tile"
publication_year = 2026
[laboratory.sample]
type = "diffuse reflectance standard"
shape = "disc"
diameter_mm = 50.0
zero_azimuth = "toward the mark on its edge"
[[laboratory.creators]]
name = "Doe, Jane"
orcid = "0000-0002-1825-0097"
"""


def measured(folder: Path, text: str, laboratory: dict[str, Any] | None = None, **more: Any) -> Run:
    described = describe(**({} if laboratory is None else {"laboratory": laboratory}))
    run = numpy_rig.measured(plan_in(folder, text), folder / "RUN", description=described, **more)
    run.write_table(brdf.reduce(Run.open(run.path)))
    return run


def run_of_a_bench(folder: Path) -> Path:
    """A table that says that it was measured, and not simulated."""
    table = measurement.read(measured(folder, PLAN + OF_PLAN, RIG).path)
    table.attrs["provenance"] = {**table.attrs["provenance"], "simulated": False}
    measurement.write(table, folder / "bench.csv")
    return folder / "bench.csv"


def test_a_plan_lies_over_the_rig_file_key_by_key(tmp_path: Path) -> None:
    run = measured(tmp_path, PLAN + OF_PLAN, RIG)
    kept = tomllib.loads((run.path / "run.toml").read_text())
    assert "laboratory" not in kept["rig"]
    assert kept["laboratory"]["temperature_c"] == 23.5, "the plan's"
    assert kept["laboratory"]["address"] == RIG["address"], "the rig's"
    stated = measurement.read(run.path).attrs["provenance"]["laboratory"]
    assert stated == kept["laboratory"] | {"measured": kept["run"]["created"], "plan": "small"}


def test_bird_json_without_a_placeholder_fits_the_schema_and_reads_back(
    tmp_path: Path, shared: Callable[[str], Path]
) -> None:
    schema = validator(shared)
    for source in ("RUN", "RUN/brdf.csv", run_of_a_bench(tmp_path).name):
        assert "unknown" not in gonio(tmp_path, "convert", source, "out.json", "--to", "bird-json", expect=0).stderr
        text = (tmp_path / "out.json").read_text(encoding="utf-8")
        assert '"unknown' not in text
        content = json.loads(text)
        assert [error.message for error in schema.iter_errors(content)] == []
        table, back = measurement.read(tmp_path / source), measurement.read(tmp_path / "out.json")
        assert back.drop(columns="flag").equals(table.drop(columns="flag"))
        assert back.attrs["provenance"]["laboratory"] == table.attrs["provenance"]["laboratory"]
    meta = content["metadata"]
    assert (meta["method"], meta["provenance"]["location"]["building_nr"]) == ("measurement", "8")
    assert meta["environment"]["temperature"] == {
        "value": 23.5, "unit": "°C", "uncertainty": 0.5, "uncertainty_unit": "°C",
    }  # fmt: skip
    assert meta["sample"]["dimensions"] == {"diameter": {"value": 50.0, "unit": "mm"}}
    assert meta["sample"]["name"] == "matte"
    assert meta["instrumentation"]["detection_system"]["sensors"][0]["spectral_response_range"]["max_value"] == 1000.0
    area = meta["instrumentation"]["illumination_system"]["beam"]["dimensions"]["area"]
    assert area == {"value": pytest.approx(math.pi * 5.0**2), "unit": "mm^2"}
    assert meta["license"] == {"type": "CC-BY-4.0", "rights_holder": "Institute of Optics"}
    assert meta["timestamp"] == Run.open(tmp_path / "RUN").settings.run.created


def test_every_missing_key_is_named_and_nothing_is_written(tmp_path: Path) -> None:
    measured(tmp_path, PLAN + '\n[laboratory]\norganisation = "Institute"\n[laboratory.sample]\nshape = "disc"\n')
    done = gonio(tmp_path, "convert", "RUN", "out.json", "--to", "bird-json", expect=2)
    assert [line.strip() for line in done.stderr.splitlines() if line.startswith("  laboratory.")] == [
        *(f"laboratory.{key}" for key in ("contact", "email")),
        *(f"laboratory.address.{key}" for key in ("country", "city", "street", "building", "postal_code")),
        "laboratory.sample.type",
        "laboratory.sample.diameter_mm (or sample.length_mm, sample.width_mm, sample.height_mm, sample.thickness_mm)",
        "laboratory.sample.zero_azimuth",
    ]
    assert "[laboratory] of the plan or of the rig file" in done.stderr
    done = gonio(tmp_path, "convert", "RUN", "out.json", "--to", "datacite", expect=2)
    named = [line.strip() for line in done.stderr.splitlines() if line.startswith("  laboratory.")]
    assert named == ["laboratory.creators", "laboratory.publication_year"]
    assert not (tmp_path / "out.json").exists()


def test_a_measured_table_needs_its_temperature_and_its_instrument(tmp_path: Path) -> None:
    table = measurement.read(run_of_a_bench(tmp_path))
    stated = dict(table.attrs["provenance"]["laboratory"])
    del stated["temperature_c"], stated["instrument"]
    table.attrs["provenance"] = {**table.attrs["provenance"], "laboratory": stated}
    with pytest.raises(ConfigError, match=r"(?s)laboratory\.temperature_c\n.*instrument\.lamp\n.*camera_range_nm\n"):
        measurement.write(table, tmp_path / "out.json", format="bird")


def test_a_run_that_states_nothing_is_converted_as_ever_and_says_so(tmp_path: Path) -> None:
    measured(tmp_path, PLAN)
    assert "laboratory" not in (tmp_path / "RUN" / "run.toml").read_text()
    assert "laboratory" not in (tmp_path / "RUN" / "brdf.meta.json").read_text()
    done = gonio(tmp_path, "convert", "RUN", "out.json", "--to", "bird-json", expect=0)
    assert 'stand as "unknown"' in " ".join(done.stderr.split())
    done = gonio(tmp_path, "convert", "RUN", "dc.json", "--to", "datacite", expect=2)
    assert "[laboratory]" in done.stderr


@pytest.mark.slow
def test_a_later_session_may_state_more_and_changes_no_step(tmp_path: Path) -> None:
    run = measured(tmp_path, PLAN)
    steps, table = list(run.steps()), (run.path / "brdf.csv").read_bytes()
    again = measured(tmp_path, PLAN + OF_PLAN, RIG, resume=True)
    assert list(again.steps()) == steps
    assert (run.path / "brdf.csv").read_bytes() == table
    stated = measurement.read(run.path).attrs["provenance"]["laboratory"]
    assert stated["sample"]["shape"] == "disc"
    assert [event["event"] for event in again.events()].count("remark") == 1
    measured(tmp_path, PLAN, resume=True)
    assert measurement.read(run.path).attrs["provenance"]["laboratory"] == stated, "what was stated stays"


def test_a_datacite_record_has_what_is_required(tmp_path: Path) -> None:
    measured(tmp_path, PLAN + OF_PLAN + '[[laboratory.funding]]\nfunder = "A fund"\naward = "7"\n', RIG)
    assert "no DOI yet" in gonio(tmp_path, "convert", "RUN", "dc.json", "--to", "datacite", expect=0).stderr
    content = json.loads((tmp_path / "dc.json").read_text(encoding="utf-8"))
    (creator,) = content["creators"]
    assert (creator["familyName"], creator["givenName"], creator["nameType"]) == ("Doe", "Jane", "Personal")
    assert (content["publisher"], content["publicationYear"]) == ({"name": "Institute of Optics"}, "2026")
    assert content["fundingReferences"] == [{"funderName": "A fund", "awardNumber": "7"}]
    assert "doi" not in content
    required = {"creators", "titles", "publisher", "publicationYear", "types", "schemaVersion"}
    assert required <= set(content), "what DataCite's schema 4.5 requires"


def test_the_record_fits_datacites_own_schema(tmp_path: Path) -> None:
    found = importlib.util.find_spec("datacite")
    if found is None or found.origin is None:
        pytest.skip("the package datacite, which holds the schema, is not installed")
    import jsonschema

    measured(tmp_path, PLAN + OF_PLAN + '[[laboratory.funding]]\nfunder = "A fund"\naward = "7"\n', RIG)
    assert gonio(tmp_path, "convert", "RUN", "dc.json", "--to", "datacite").returncode == 0
    content = json.loads((tmp_path / "dc.json").read_text(encoding="utf-8"))
    schema = json.loads((Path(found.origin).parent / "schemas" / "datacite-v4.5.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator(schema).validate(content)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('organization = "x"', 'unknown key laboratory.organization; did you mean "organisation"?'),
        ('email = "nobody"', "laboratory.email = 'nobody'"),
        ('contact = " "', "laboratory.contact"),
        ("temperature_c = -300", "laboratory.temperature_c = -300"),
        ('creators = [{ name = "x", orcid = "1234" }]', "laboratory.creators[1].orcid"),
        ("sample = { diameter_mm = 0 }", "laboratory.sample.diameter_mm = 0"),
    ],
)
def test_a_wrong_key_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "plan.toml").write_text(f"{PLAN}\n[laboratory]\n{text}\n")
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_plan(tmp_path / "plan.toml")
    values = describe().model_dump(mode="python") | {"laboratory": tomllib.loads(text)}
    with pytest.raises(ConfigError, match=re.escape(message)):
        parse(RigDescription, values, "rig.toml")


def test_it_is_no_part_of_what_tells_plans_apart(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(PLAN)
    (tmp_path / "b.toml").write_text(PLAN + OF_PLAN)
    assert load_plan(tmp_path / "a.toml").sha256 == load_plan(tmp_path / "b.toml").sha256
