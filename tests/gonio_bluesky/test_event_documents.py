"""A run as documents of Bluesky's event model: whole, checked, the same every time, and read back bit for bit."""

import gzip
import json
import math
import shutil
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_bluesky import Frames
from gonio_bluesky.event_documents import Document, documents
from gonio_bluesky.event_files import read, write

from gonio import plugins
from gonio.errors import ConfigError, DataError, DeviceError, Interrupted
from gonio.geometry import ANGLES_DEG
from gonio.lab.acquisition.journal import Journal, encode, now
from gonio.lab.acquisition.plan import Assessed
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.run_settings import RunRequest
from gonio.lab.reduction import brdf
from gonio.lab.rig.dng import read_raw
from tests.command_line import gonio
from tests.gonio.lab.acquisition.test_sampling import PLAN as GROWING
from tests.gonio.lab.acquisition.test_sampling import Chooses
from tests.gonio.numpy_rig import SAMPLE, Plugin, StopAfter, plan_in
from tests.gonio.numpy_rig import measured as measure

event_model = pytest.importorskip("event_model", reason="event-model is not installed (extra bluesky)")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reduced run of eight points, in two bands."""
    where = tmp_path_factory.mktemp("documents")
    run = measure(plan_in(where), where / "RUN")
    run.write_table(brdf.reduce(Run.open(run.path)))
    return run.path


def checked(of: list[Document]) -> list[Document]:
    """Documents that the event model's own schemas take, and that hang together."""
    for kind, document in of:
        event_model.schema_validators[event_model.DocumentNames[kind]].validate(document)
    assert (of[0][0], of[-1][0]) == ("start", "stop")
    uids = [document["uid"] for _, document in of if "uid" in document]
    assert len(set(uids)) == len(uids)
    start = of[0][1]["uid"]
    descriptors = {document["uid"]: document for kind, document in of if kind == "descriptor"}
    counted: Counter[str] = Counter()
    for kind, document in of:
        if kind in ("descriptor", "resource", "stop"):
            assert document["run_start"] == start
        if kind == "event":
            descriptor = descriptors[document["descriptor"]]
            counted[descriptor["name"]] += 1
            assert document["seq_num"] == counted[descriptor["name"]]
            assert list(document["data"]) == list(descriptor["data_keys"]) == list(document["timestamps"])
            for name, value in document["data"].items():
                key = descriptor["data_keys"][name]
                if key["dtype"] == "array" and "external" not in key and value is not None:
                    assert [len(value)] == key["shape"], name
    assert of[-1][1]["num_events"] == counted
    return of


def events(of: list[Document], name: str) -> list[dict[str, Any]]:
    """The data of a stream's events."""
    wanted = {d["uid"] for kind, d in of if kind == "descriptor" and d["name"] == name}
    return [d["data"] for kind, d in of if kind == "event" and d["descriptor"] in wanted]


def test_every_number_of_the_journal_and_the_table_reads_back(folder: Path, tmp_path: Path) -> None:
    (told,) = write(str(folder), tmp_path / "run.jsonl")
    of = checked(list(read(tmp_path / "run.jsonl")))
    assert told == f"{len(of)} documents"
    run = Run.open(folder)
    steps = {step.step: step for step in run.steps()}
    taken = [(name, data) for name in ("primary", "reference", "dark") for data in events(of, name)]
    assert {data["step"] for _, data in taken} == set(steps)
    for name, data in taken:
        step = steps[data["step"]]
        assert {"primary": "point", "reference": "reference", "dark": "dark"}[name] == step.kind
        assert data["time_s"] == step.time_s
        assert data["flag"] == step.flag
        for axis in run.description.axes():
            assert data[f"{axis}_deg"] == math.degrees(getattr(step.pose, axis))
        if name == "primary":
            assert [data[angle] for angle in ANGLES_DEG] == run.points.angles_deg[data["point"]].tolist()
            assert data["level_per_s"] == list((step.level_per_s or {}).values())
            assert data["exposure_s"] == [
                max(frame.exposure_s for frame in step.frames if frame.band == band.name) for band in run.bands
            ]
    table = brdf.reduce(run)
    rows = events(of, "reduced")
    assert list(rows[0]) == list(table.columns)
    for name in table.columns:
        column = [None if isinstance(v, float) and math.isnan(v) else v for v in table[name].tolist()]
        assert [row[name] for row in rows] == column, name


def test_start_and_stop_say_what_was_measured_and_how_it_ended(folder: Path) -> None:
    of = checked(list(documents(Run.open(folder))))
    start, stop = of[0][1], of[-1][1]
    assert (start["plan_name"], start["seed"], start["sample"]["parameters"]) == ("small", 1, {"albedo": 0.5})
    assert start["num_points"] == 5 == len(events(of, "primary")), "one of six lies behind the arm"
    assert start["versions"]["gonio"]
    assert (stop["exit_status"], stop["reason"]) == ("success", "")
    (rig,) = events(of, "baseline")
    assert (rig["camera_width"], rig["geometry_light_distance_mm"]) == (64, 1000.0)
    assert json.loads(rig["bands_list"])[1]["name"] == "red 650"


def test_the_frames_are_filled_in_by_the_event_models_own_filler(folder: Path) -> None:
    run = Run.open(folder)
    registry = {"GONIO_FRAMES": Frames}
    seen = 0
    names: dict[str, str] = {}
    with event_model.Filler(registry, inplace=False) as filler:
        for kind, document in documents(run):
            kind, filled = filler(kind, document)
            if kind == "descriptor":
                names[filled["uid"]] = filled["name"]
            if kind == "event" and names[filled["descriptor"]] in ("primary", "reference", "dark"):
                step = next(s for s in run.steps() if s.step == filled["data"]["step"])
                raw = [read_raw(run.frame_path(frame.file)).mosaic for frame in step.frames]
                assert filled["filled"]["frames"]
                np.testing.assert_array_equal(filled["data"]["frames"], raw)
                seen += 1
    assert seen == len(run.steps())


def test_the_same_run_gives_the_same_bytes_compressed_too(folder: Path, tmp_path: Path) -> None:
    for name in ("a.jsonl", "b.jsonl", "a.jsonl.gz", "c.jsonl.gz"):
        write(str(folder), tmp_path / name)
    plain, packed = (tmp_path / "a.jsonl").read_bytes(), (tmp_path / "a.jsonl.gz").read_bytes()
    assert (tmp_path / "b.jsonl").read_bytes() == plain
    assert (tmp_path / "c.jsonl.gz").read_bytes() == packed
    assert gzip.decompress(packed) == plain
    assert list(read(tmp_path / "a.jsonl.gz")) == list(read(tmp_path / "a.jsonl"))
    assert {path.name for path in tmp_path.iterdir()} == {"a.jsonl", "b.jsonl", "a.jsonl.gz", "c.jsonl.gz"}


def test_an_unfinished_run_says_so_and_keeps_its_identity_when_it_has_grown(tmp_path: Path) -> None:
    plan = plan_in(tmp_path)
    with pytest.raises(Interrupted):
        measure(plan, tmp_path / "RUN", progress=StopAfter(4))
    cut = checked(list(documents(Run.open(tmp_path / "RUN"))))
    assert (cut[-1][1]["exit_status"], cut[-1][1]["reason"]) == ("abort", "stopped")
    journal = tmp_path / "RUN" / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    assert b'"event":"interrupted"' in lines[-1]
    journal.write_bytes(b"".join(lines[:-1]) + b'{"torn')
    killed = checked(list(documents(Run.open(tmp_path / "RUN"))))
    assert killed[-1][1]["exit_status"] == "abort"
    assert "no end" in killed[-1][1]["reason"]
    measure(plan, tmp_path / "RUN", resume=True)
    whole = checked(list(documents(Run.open(tmp_path / "RUN"))))
    assert whole[-1][1]["exit_status"] == "success"
    assert whole[0] == killed[0]
    before = [d["uid"] for kind, d in killed if kind == "event"]
    assert before == [d["uid"] for kind, d in whole if kind == "event"][: len(before)]


def test_a_failed_device_is_a_failed_run(tmp_path: Path) -> None:
    with pytest.raises(DeviceError):
        measure(plan_in(tmp_path), tmp_path / "RUN", Plugin(options={"fails_at": 4}))
    of = checked(list(documents(Run.open(tmp_path / "RUN"))))
    assert of[-1][1]["exit_status"] == "fail"
    assert "no frame came within 5 s" in of[-1][1]["reason"]


def test_steps_without_frames_and_steps_that_were_lost(tmp_path: Path) -> None:
    plan, out = plan_in(tmp_path), tmp_path / "RUN"
    run = measure(plan, out, Plugin(options={"pushes": {3: 99}}))
    (moved,) = (step for step in run.steps() if step.flag == "moved")
    of = checked(list(documents(Run.open(out))))
    (flagged,) = (data for data in events(of, "primary") if data["flag"])
    assert (flagged["step"], flagged["flag"]) == (moved.step, "moved")
    assert flagged["exposure_s"] == [None, None], "what was not measured is not a number"
    assert any("moved" in data["message"] for data in events(of, "journal") if data["event"] == "remark")
    run.frame_path(next(iter(run.steps()[4].frames)).file).unlink()
    remarks: list[str] = []
    checked(list(documents(Run.open(out), remarks)))
    assert "not there" in remarks[0]
    with Run.open(out) as again:
        again.journal = Journal(out / "journal.jsonl")
        again.take_back({4: ["000004-x.dng: is missing"]})
    of = checked(list(documents(Run.open(out))))
    assert 4 not in {data["step"] for data in events(of, "primary")}
    assert of[-1][1]["exit_status"] == "abort"


def test_what_was_chosen_is_among_the_documents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Chooses, "opened", [])
    plugins.add("gonio.choosers", "brightest", Chooses)
    of = checked(list(documents(measure(plan_in(tmp_path, GROWING), tmp_path / "RUN"))))
    assert [data["point"] for data in events(of, "primary")] == list(range(9))
    told = [data["event"] for data in events(of, "journal")]
    assert (told.count("chosen"), told.count("enough")) == (3, 1)
    chosen = [json.loads(data["content"])["points"] for data in events(of, "journal") if data["event"] == "chosen"]
    rows = events(of, "primary")[3:]
    assert [[row[angle] for angle in ANGLES_DEG] for row in rows] == [point for batch in chosen for point in batch]


def test_a_long_run_reads_back_bit_for_bit(tmp_path: Path) -> None:
    """More than one page of steps; how long 10^4 take docs/interchange.md says, since machines differ."""
    count = 1200
    text = 'name = "long"\nwavelength_nm = [550]\n[[points]]\nfile = "points.csv"\n'
    (tmp_path / "points.csv").write_text(
        "\n".join([",".join(ANGLES_DEG), *(f"30,0,{k / 15},180" for k in range(count))])
    )
    plan = plan_in(tmp_path, text)
    short = measure(plan_in(tmp_path), tmp_path / "short")
    template = next(e for e in short.events() if e.get("kind") == "point")
    request = RunRequest(plan, short.description, SAMPLE, 1, "")
    pose = next(iter(short.steps())).pose
    request.__dict__["points"] = [Assessed(point, pose) for point in plan.points]  # not what is tested
    with Run.create(tmp_path / "RUN", request) as run:
        run.append({"event": "session", "gonio": "0", "steps": count, "left": count})
    rng = np.random.default_rng(3)
    with (tmp_path / "RUN" / "journal.jsonl").open("ab") as journal:
        for k in range(count):
            event = {**template, "n": k + 1, "step": k + 2, "point": k, "time_s": float(rng.normal()), "wall": now()}
            event["frames"] = [{**f, "file": f"{k + 2:06d}{f['file'][6:]}"} for f in template["frames"]]
            event.pop("crc", None)
            journal.write(encode(event))
    assert "not there" in write(str(tmp_path / "RUN"), tmp_path / "long.jsonl")[0]
    back = list(read(tmp_path / "long.jsonl"))
    told = documents(Run.open(tmp_path / "RUN"))
    assert all(one == other for one, other in zip(back, map(tuple, told), strict=True))
    assert len(events(back, "primary")) == count
    assert [data["time_s"] for data in events(back, "primary")] == np.random.default_rng(3).normal(size=count).tolist()


def test_what_the_command_says(folder: Path, tmp_path: Path) -> None:
    done = gonio(tmp_path, "convert", folder, "run.jsonl", "--to", "bluesky")
    assert (done.returncode, done.stderr) == (0, "")
    assert "documents" in done.stdout
    for arguments, what in (
        ((folder / "brdf.csv", "x.jsonl"), "takes a run"),
        ((tmp_path, "x.jsonl"), "no run.toml"),
        ((folder, tmp_path), "is a folder; name the file"),
        ((folder, tmp_path / "no" / "x.jsonl"), "cannot be written"),
        ((folder, "x.jsonl", "--from", "astm"), "goes with --to alone"),
    ):
        done = gonio(tmp_path, "convert", *arguments, "--to", "bluesky", expect=2)
        assert what in done.stderr
    assert not (tmp_path / "x.jsonl").exists()
    assert {path.name for path in tmp_path.iterdir()} == {"run.jsonl"}
    done = gonio(tmp_path, "convert", folder, "-", "--to", "bluesky", expect=0)
    assert done.stdout == (tmp_path / "run.jsonl").read_text(encoding="utf-8")
    assert "-: " in done.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"run.jsonl"}


def test_the_documents_of_a_run_do_not_replace_its_journal(tmp_path: Path) -> None:
    run = measure(plan_in(tmp_path), tmp_path / "RUN")
    before = run.path.joinpath("journal.jsonl").read_bytes()
    with pytest.raises(ConfigError, match=r"journal.jsonl: is a file of the run .*RUN, and is not replaced"):
        write(str(run.path), run.path / "journal.jsonl")
    assert run.path.joinpath("journal.jsonl").read_bytes() == before


def test_it_is_written_unchecked_where_the_event_model_is_missing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(str(folder), tmp_path / "a.jsonl")
    monkeypatch.setitem(sys.modules, "event_model", None)
    assert any("unchecked" in text and "gonio[bluesky]" in text for text in write(str(folder), tmp_path / "b.jsonl"))
    assert (tmp_path / "a.jsonl").read_bytes() == (tmp_path / "b.jsonl").read_bytes()


def test_a_table_that_somebody_has_changed_is_left_out(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "RUN")
    table = tmp_path / "RUN" / "brdf.csv"
    table.write_text(table.read_text().replace("unpolarised", "ss", 1))
    remarks: list[str] = []
    assert not events(checked(list(documents(Run.open(tmp_path / "RUN"), remarks))), "reduced")
    assert "was changed" in remarks[0]


def test_a_damaged_file_of_documents_is_named_with_its_line(folder: Path, tmp_path: Path) -> None:
    write(str(folder), tmp_path / "a.jsonl")
    lines = (tmp_path / "a.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "b.jsonl").write_bytes(b"".join(lines[:3]) + lines[3][:40])
    with pytest.raises(DataError, match=r"b\.jsonl: line 4: is no document"):
        list(read(tmp_path / "b.jsonl"))
    with pytest.raises(ConfigError, match="cannot be read"):
        list(read(tmp_path / "none.jsonl"))
