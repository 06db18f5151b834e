"""What a run refuses before anything moves, and what it leaves where it was."""

import math
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from gonio.config import to_toml
from gonio.errors import ConfigError, DataError, GonioError, Interrupted
from gonio.lab.acquisition.measure import RigChoice, carry_out, check
from gonio.lab.acquisition.plan import Plan
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.rig import Pose, Step
from gonio.lab.rig.description import Body, Geometry, Holder, Reference, RigDescription
from tests.gonio.lab.acquisition.conftest import Measure
from tests.gonio.numpy_rig import SAMPLE, NumpyRig, Plugin, StopAfter, describe


def test_a_run_that_has_begun_needs_resume(run: Run, measure: Measure) -> None:
    before = (run.path / "journal.jsonl").read_bytes()
    with pytest.raises(ConfigError, match="--resume"):
        measure("run")
    assert (measure("run", resume=True).path / "journal.jsonl").read_bytes() == before


@pytest.mark.parametrize("journal", [None, b"", b'{"n":0,"event":"ses'])
@pytest.mark.parametrize("resume", [True, False])
def test_without_a_whole_line_it_starts_anew(
    run: Run, measure: Measure, journal: bytes | None, resume: bool, whole: list[StepRecord]
) -> None:
    out = run.path  # and its process died before it took a frame
    for frame in (out / "frames").iterdir():
        frame.unlink()
    (out / "journal.jsonl").unlink()
    if journal is not None:
        (out / "journal.jsonl").write_bytes(journal)
    assert list(measure("run", resume=resume).steps()) == whole


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"seed": 2}, "seed: 1 in the run, 2 now"),
        ({"sample": SAMPLE.model_copy(update={"parameters": {"albedo": 0.6}})}, r"sample\.parameters\.albedo: 0\.5"),
        ({"description": describe(reference=Reference(every=4, frames=2))}, r"rig\.reference\.every: 3 in the run, 4"),
        ({"plan": "other"}, "plan: "),
    ],
    ids=["seed", "sample", "rig", "plan"],
)
def test_what_differs_is_named(
    run: Run, measure: Measure, plan: Plan, changes: dict[str, object], word: str, tmp_path: Path
) -> None:
    if "plan" in changes:
        changes = {"plan": replace(plan, points=plan.points[:-1])}
    before = (tmp_path / "run" / "journal.jsonl").read_bytes()
    with pytest.raises(ConfigError, match=word):
        measure("run", resume=True, **changes)
    assert (tmp_path / "run" / "journal.jsonl").read_bytes() == before


def test_nothing_is_left_of_a_run_that_cannot_be_made(
    measure: Measure, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gonio.lab.acquisition.run.sync_folder", full)
    with pytest.raises(ConfigError, match="No space left"):
        measure("deep/er/run")
    assert not (tmp_path / "deep").exists()


@pytest.mark.parametrize("name", ["plan.csv", "run.toml"])
def test_a_process_that_died_while_it_made_the_folder_is_no_obstacle(
    measure: Measure, tmp_path: Path, name: str, whole: list[StepRecord]
) -> None:
    (tmp_path / "run" / "frames").mkdir(parents=True)
    (tmp_path / "run" / "journal.jsonl").touch()
    (tmp_path / "run" / f".{name}.4711.new").write_text("half")
    run = measure()
    assert not (run.path / f".{name}.4711.new").exists()
    assert list(run.steps()) == whole


def test_a_folder_of_other_things_is_left_alone(measure: Measure, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "holiday.jpg").write_bytes(b"x")
    with pytest.raises(ConfigError, match=r"holiday\.jpg"):
        measure("photos")
    assert [p.name for p in (tmp_path / "photos").iterdir()] == ["holiday.jpg"]
    (tmp_path / "file").write_text("x")
    for out in ("file", "file/run"):
        with pytest.raises(ConfigError, match="not a folder"):
            measure(out)


def test_no_device_is_opened_before_everything_is_checked(plan: Plan, tmp_path: Path) -> None:
    rig = Plugin()
    choice = RigChoice(rig, describe(), "numpy")
    options = {"seed": 0, "resume": False, "yes": False}
    with pytest.raises(ConfigError, match="--sample"):
        check(plan, choice, tmp_path / "run", sample=None, **options)  # type: ignore[arg-type]
    check(plan, choice, tmp_path / "run", sample=SAMPLE, **options)  # type: ignore[arg-type]
    assert all(not opened.inside and not opened.log for opened in rig.opened)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("changes", "words"),
    [  # the frame of this bench is 23 mm wide and 17 mm high
        ({"reference": {"how": "beside", "offset_mm": [0.0, 14.0]}}, r"\[reference\] offset_mm = \[0, 14\].*rows"),
        ({"reference": {"how": "beside", "offset_mm": [30.0, 0.0]}}, r"\[reference\] offset_mm = \[30, 0\].*nearer"),
        # its centre is in the frame, and its patch is cut
        ({"reference": {"how": "beside", "offset_mm": [0.0, -8.0]}, "holder": {"sample_diameter_mm": 8.0}},
         r"\[reference\] offset_mm = \[0, -8\].*focal_length_mm"),
        ({"acquisition": {"roi_radius_mm": 9.0}}, r"\[acquisition\] roi_radius_mm = 9 .*smaller patch"),
    ],
    ids=["above", "beside", "cut", "patch"],
)  # fmt: skip
def test_what_the_frame_does_not_hold_is_refused_before_anything_is_opened(
    plan: Plan, tmp_path: Path, changes: dict[str, dict[str, object]], words: str
) -> None:
    tables = describe().model_dump(exclude_none=True)
    for name, keys in changes.items():
        tables[name] |= keys
    rig = Plugin()
    choice = RigChoice(rig, RigDescription.model_validate(tables), "my.toml")
    options = {"sample": SAMPLE, "seed": 0, "resume": False, "yes": True}
    with pytest.raises(ConfigError, match=f"my.toml: {words}"):
        check(plan, choice, tmp_path / "run", **options)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=f"my.toml: {words}"):
        carry_out(plan, choice, tmp_path / "run", **options)  # type: ignore[arg-type]
    assert rig.opened == []
    assert not (tmp_path / "run").exists()


def test_a_patch_counts_in_the_poses_that_are_used(plan: Plan) -> None:
    """14 mm beside the centre, along the arms' plane, fits into 23 mm only foreshortened: at 60 degrees, not at 0."""
    for theta_r_deg, good in ((60.0, True), (0.0, False)):
        reference = Reference(
            how="beside", offset_mm=(14.0, 0.0), theta_r_deg=theta_r_deg, theta_i_deg=20.0, every=3, frames=2
        )
        choice = RigChoice(Plugin(), describe(reference=reference, holder=Holder(axes=("tilt", "spin"))), "my.toml")
        if good:
            assert choice.schedule(plan)[1].kind == "reference"
        else:
            with pytest.raises(ConfigError, match="theta_r = 0 deg"):
                choice.schedule(plan)


def test_the_reference_s_table_travels_with_the_run(measure: Measure, tmp_path: Path) -> None:
    table = tmp_path / "spectralon.csv"
    table.write_text("theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf\n")
    rig = describe(reference=Reference(every=3, frames=2, table=str(table)))
    with pytest.raises(Interrupted):
        measure("run", description=rig, progress=StopAfter(3))
    run = measure("run", description=rig, resume=True)
    table.unlink()
    stored = Run.open(run.path).description.reference.table
    assert stored == str(run.path / "reference.csv")
    assert Path(stored).exists()
    with pytest.raises(ConfigError, match=r"spectralon\.csv"):
        measure("other", description=rig)
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("name", "damage", "kind"),
    [
        ("run.toml", b"", DataError),
        ("run.toml", b"[run]\n", DataError),
        ("run.toml", b"\xff\xfe", DataError),
        ("run.toml", None, ConfigError),
        ("plan.csv", b"a,b\n1,2\n", DataError),
        ("plan.csv", None, DataError),
    ],
)
def test_a_damaged_run_is_said_to_be(run: Run, name: str, damage: bytes | None, kind: type[GonioError]) -> None:
    path = run.path
    if damage is None:
        (path / name).unlink()
    else:
        (path / name).write_bytes(damage)
    with pytest.raises(kind, match=name):
        _ = Run.open(path).plan


def test_toml_comes_back() -> None:
    import tomllib

    values = {
        "a": 1,
        "b": {
            "x.y": 'quo"te\n\x7f\\',
            "list": [1.5, True, "ü"],
            "deep": {"tables": [{"k": [1, 2]}, {"k": []}], "e": 1e-300},
        },
        "empty": {},
    }
    assert tomllib.loads(to_toml(values)) == values


def test_arms_that_stand_where_no_way_leads_out_are_said_before_anything_moves(
    measure: Measure, tmp_path: Path
) -> None:
    """Planning knows the ways between the points; where somebody left the arms it does not know."""
    fence = Body(name="fence", on="bench", centre_mm=(520, 0, 300), size_mm=(60, 300, 60))
    far = Geometry(light_distance_mm=600.0, camera_distance_mm=430.0)
    rig = Plugin(options={"pose": Pose(light=math.radians(80.0), camera=math.radians(20.0))})
    with pytest.raises(ConfigError, match=r"where the axes stand now .* touch: source head and fence"):
        measure("run", rig=rig, description=describe(bodies=(fence,), geometry=far))
    assert "move" not in rig.opened[0].log
    assert not (tmp_path / "run").exists()


def test_nobody_is_asked_for_the_reference_once_a_stop_was_asked_for(
    measure: Measure, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin = NumpyRig.begin

    def begin_and_stop(rig: NumpyRig, step: Step) -> None:
        begin(rig, step)
        if step.kind == "reference":
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(NumpyRig, "begin", begin_and_stop)
    rig = Plugin(options={"repeatable": False})
    with pytest.raises(Interrupted, match="after 1 of"):
        measure("run", rig=rig, sample=None, yes=True)
    assert "present reference" not in rig.opened[0].log
