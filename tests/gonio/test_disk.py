"""Only files that the program wrote are replaced: everything else is refused, by name, and stays as it is."""

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from gonio_analysis.report import make
from gonio_analysis.report.files import staged
from gonio_validation import papers
from gonio_validation.bench import speed_and_error
from gonio_validation.demonstration import PLAN as DEMO_PLAN
from gonio_validation.demonstration import SAMPLE as DEMO_SAMPLE
from gonio_validation.demonstration import _clear

from gonio import disk, measurement
from gonio.errors import ConfigError, GonioError
from gonio.lab.acquisition.run import Run
from tests.command_line import says
from tests.gonio.numpy_rig import measured, plan_in

Measure = Callable[..., Run]
SOMEBODYS = hashlib.sha256(b"somebody's").hexdigest()


@pytest.fixture
def measure(tmp_path: Path) -> Measure:
    plan = plan_in(tmp_path)
    return lambda out, **changes: measured(plan, tmp_path / out, **{"command": "gonio measure ..."} | changes)


def tree(folder: Path) -> dict[str, str | bytes]:
    """Everything in a folder: what links say, and what files hold."""
    out: dict[str, str | bytes] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        out[name] = os.readlink(path) if path.is_symlink() else path.read_bytes() if path.is_file() else "a folder"
    return out


def put(folder: Path, name: str, text: str = "somebody's") -> None:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


FOREIGN = [
    ["frames/IMG.CR2", "plan.csv"],
    ["plan.csv"],
    ["run.toml"],
    ["reference.csv"],
    ["frames/DSC 0001.NEF", "frames/more/notes"],
    ["frames/.hidden"],
    [".hidden"],
    ["journal.jsonl"],
    ["gonio.sha256"],
    [".run.toml.new"],
]


@pytest.mark.parametrize("names", FOREIGN, ids=lambda names: names[0])
@pytest.mark.parametrize("resume", [False, True])
def test_a_run_is_not_measured_into_other_people_s_files(
    measure: Measure, tmp_path: Path, names: list[str], resume: bool
) -> None:
    for name in names:
        put(tmp_path / "theirs", name, "my diary\nand more of it\n")
    before = tree(tmp_path / "theirs")
    with pytest.raises(GonioError, match=names[0].replace(".", r"\.")):
        measure("theirs", resume=resume)
    assert tree(tmp_path / "theirs") == before


@pytest.mark.parametrize("name", ["frames", "run.toml", "plan.csv", "journal.jsonl"])
def test_no_link_is_followed(measure: Measure, tmp_path: Path, name: str) -> None:
    put(tmp_path, "photos/IMG.CR2")
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / name).symlink_to(tmp_path / "photos" / ("" if name == "frames" else "IMG.CR2"))
    before = tree(tmp_path)
    with pytest.raises(GonioError, match=name):
        measure("theirs")
    assert tree(tmp_path) == before


def test_what_a_run_that_never_began_left_is_no_obstacle_unless_it_was_edited(measure: Measure) -> None:
    path = measure("run").path
    (path / "journal.jsonl").unlink()
    for frame in (path / "frames").iterdir():
        frame.unlink()
    (path / "plan.csv").write_text((path / "plan.csv").read_text() + "# mine\n")
    before = tree(path)
    with pytest.raises(ConfigError, match=r"plan\.csv"):
        measure("run")
    assert tree(path) == before
    (path / "plan.csv").unlink()
    assert len(measure("run").steps()) == 9


def test_a_manifest_is_what_sha256sum_reads(measure: Measure) -> None:
    path = measure("run").path
    words = (line.split("  ") for line in (path / "gonio.sha256").read_text().splitlines())
    lines = {name: digest for digest, name in words}
    assert lines == {name: hashlib.sha256((path / name).read_bytes()).hexdigest() for name in ("run.toml", "plan.csv")}


def table() -> pd.DataFrame:
    row = {"theta_i_deg": 30.0, "phi_i_deg": 0.0, "theta_r_deg": 10.0, "phi_r_deg": 180.0, "wavelength_nm": 550.0}
    known = {"polarisation": "unpolarised", "brdf": 0.1, "u_brdf": 0.01, "u_random": 0.01, "flag": ""}
    return pd.DataFrame([row | known])


def test_a_table_is_replaced_where_it_is_as_it_was_written(measure: Measure) -> None:
    run = measure("run")
    first = run.write_table(table()).read_bytes()
    run.write_table(table().assign(brdf=0.2))
    assert (run.path / "brdf.csv").read_bytes() != first
    for name in ("brdf.csv", "brdf.meta.json"):
        whole = (run.path / name).read_bytes()
        (run.path / name).write_bytes(whole + b" ")
        before = tree(run.path)
        for write in (run.check_table, lambda: run.write_table(table())):
            with pytest.raises(ConfigError, match=name):
                write()
        assert tree(run.path) == before
        (run.path / name).write_bytes(whole)


def test_a_process_that_dies_between_two_files_leaves_what_can_be_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk.write_own(tmp_path, {"a": b"1", "b": b"1"})
    write, count = disk.write_whole, 0

    def dies(path: Path, data: bytes) -> None:
        nonlocal count
        count += 1
        if count == 3:  # the manifest, the first file
            raise KeyboardInterrupt
        write(path, data)

    monkeypatch.setattr(disk, "write_whole", dies)
    with pytest.raises(KeyboardInterrupt):
        disk.write_own(tmp_path, {"a": b"2", "b": b"2"})
    monkeypatch.undo()
    disk.write_own(tmp_path, {"a": b"3", "b": b"3"})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes() == b"3"


def report(out: Path, text: str = "page") -> None:
    with staged(out) as stage:
        (stage.work / "figures").mkdir()
        (stage.work / "figures" / "one.svg").write_text(text)
        (stage.work / "index.html").write_text(text)
        (stage.work / "summary.json").write_text("{}")


@pytest.mark.parametrize(
    "names",
    [
        ["index.html", "summary.json", "thesis.tex"],
        ["index.html", "summary.json"],
        ["index.html", "summary.json", "gonio.sha256"],
        [".notes"],
        ["a folder/below/x y.txt"],
    ],
    ids=lambda names: names[-1],
)
def test_a_report_does_not_replace_somebody_else_s(tmp_path: Path, names: list[str]) -> None:
    for name in names:
        put(tmp_path / "out", name)
    before = tree(tmp_path)
    with pytest.raises(ConfigError, match=names[-1].split("/")[0].replace(".", r"\.")):
        report(tmp_path / "out")
    assert tree(tmp_path) == before


@pytest.mark.parametrize("name", ["notes.txt", "figures/mine.svg", ".hidden", "empty folder/", "index.html", "a link"])
def test_notes_beside_an_earlier_report_and_edited_pages_stay(tmp_path: Path, name: str) -> None:
    report(tmp_path / "out")
    report(tmp_path / "out", "again")
    assert (tmp_path / "out" / "index.html").read_text() == "again"
    put(tmp_path, "thesis/thesis.tex")
    if name.endswith("/"):
        (tmp_path / "out" / name).mkdir()
    elif name == "a link":
        (tmp_path / "out" / name).symlink_to(tmp_path / "thesis")
    else:
        put(tmp_path / "out", name)
    before = tree(tmp_path)
    with pytest.raises(ConfigError, match=name.rstrip("/").replace(".", r"\.")):
        report(tmp_path / "out")
    assert tree(tmp_path) == before


def test_what_comes_while_a_report_is_made_stays(tmp_path: Path) -> None:
    report(tmp_path / "out")
    making = staged(tmp_path / "out")
    (making.__enter__().work / "index.html").write_text("new")
    put(tmp_path / "out", "notes.txt")
    with pytest.raises(ConfigError, match=r"notes\.txt"):
        making.__exit__(None, None, None)
    assert (tmp_path / "out" / "notes.txt").read_text() == "somebody's"
    assert (tmp_path / "out" / "index.html").read_text() == "page"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_report_into_a_linked_folder_leaves_the_link(tmp_path: Path) -> None:
    (tmp_path / "disk" / "report").mkdir(parents=True)
    (tmp_path / "out").symlink_to(tmp_path / "disk" / "report")
    for text in ("one", "two"):
        report(tmp_path / "out", text)
        assert (tmp_path / "out").is_symlink()
        assert (tmp_path / "disk" / "report" / "index.html").read_text() == text
    assert [path.name for path in (tmp_path / "disk").iterdir()] == ["report"]


def test_a_stranger_s_folder_with_a_name_like_ours_is_not_tidied_up(tmp_path: Path) -> None:
    put(tmp_path, ".out.999999999.x.part/thesis.tex")
    put(tmp_path, ".out.999999999.x.old/thesis.tex")
    before = tree(tmp_path)
    report(tmp_path / "out")
    assert {k: v for k, v in tree(tmp_path).items() if not k.startswith("out")} == before


def test_a_demo_replaces_a_demo_and_nothing_else(measure: Measure, tmp_path: Path) -> None:
    out = tmp_path / "demo"
    out.mkdir()
    disk.write_own(out, {"sample.toml": DEMO_SAMPLE.encode(), "plan.toml": DEMO_PLAN.encode()})
    run = measure(out / "run")
    run.write_table(table())
    report(run.path / "report")
    for name in ("notes.txt", "run/notes.txt", "run/frames/IMG.CR2", "run/report/notes.txt"):
        put(out, name)
        before = tree(out)
        with pytest.raises(ConfigError, match=name.replace(".", r"\.")):
            _clear(out)
        assert tree(out) == before
        (out / name).unlink()
    changed = run.frame_path(run.steps()[2].frames[0].file)
    whole = changed.read_bytes()
    changed.write_bytes(whole + b"x")
    with pytest.raises(ConfigError, match=changed.name):
        _clear(out)
    changed.write_bytes(whole)
    _clear(out)
    assert sorted(path.name for path in out.iterdir()) == ["gonio.sha256", "plan.toml", "sample.toml"]


def test_what_lies_beside_a_table_is_replaced_only_if_it_is_a_table_s(tmp_path: Path) -> None:
    for _ in range(2):
        measurement.write(table(), tmp_path / "a.csv")  # named by the user
    put(tmp_path, "b.meta.json", '{"mine": 1}')
    with pytest.raises(ConfigError, match=r"b\.meta\.json"):
        measurement.write(table(), tmp_path / "b.csv")
    assert (tmp_path / "b.meta.json").read_text() == '{"mine": 1}'
    assert not (tmp_path / "b.csv").exists()


def _reduce(run: Path) -> None:
    opened = Run.open(run)
    opened.check_table()
    opened.write_table(table())


def _compare(out: Path) -> None:
    measurement.write(table(), out.parent / "t.csv")
    make([str(out.parent / "t.csv")], out, models=["lambert"])


WRITERS: dict[str, tuple[Callable[[Path], object], str]] = {
    "reduce": (_reduce, "brdf.csv"),
    "report": (lambda run: make([str(run)], run / "report", models=["lambert"]), "report"),
    "compare": (_compare, "page"),
    "demo": (_clear, "demo"),
    "figures": (lambda out: papers.make("htsg-8", out), "page"),
    "bench": (lambda out: speed_and_error.make(out, quick=True), "page"),
}


@pytest.mark.parametrize("command", WRITERS)
def test_output_without_a_manifest_is_refused_in_words_that_help(
    measure: Measure, tmp_path: Path, command: str
) -> None:
    """Earlier versions wrote none."""
    write, named = WRITERS[command]
    out = tmp_path / named
    if command in ("reduce", "report"):
        out = measure("run").path
        _reduce(out)
        report(out / "report")
    elif command == "demo":
        _reduce(measure(out / "run").path)
    else:
        report(out)
    for manifest in out.rglob("gonio.sha256"):
        manifest.unlink()
    before = tree(out)
    with pytest.raises(ConfigError) as raised:
        write(out)
    told = str(raised.value)
    says(told, "not written by this version of gonio", "or was changed since", "move it away, or ")
    assert "\n" not in told
    assert named in told
    assert tree(out) == before


@pytest.mark.parametrize("name", ["../x", "/etc/hosts", "a/../../x", "a\\b", "./x", "a//b", "a/", ".."])
def test_a_manifest_names_files_of_its_own_folder_alone(measure: Measure, tmp_path: Path, name: str) -> None:
    """Whoever is to remove or replace what it names stays inside."""
    (tmp_path / "x").write_text("somebody's")
    run = measure("run")
    manifest = run.path / disk.MANIFEST
    manifest.write_text(manifest.read_text() + f"{SOMEBODYS}  {name}\n")
    assert not disk.is_manifest(manifest)
    assert disk.read_manifest(run.path) == {}
    before = tree(tmp_path)
    for resume in (True, False):
        with pytest.raises(GonioError, match=r"gonio\.sha256|--resume"):
            measure("run", resume=resume)
    with pytest.raises(GonioError, match=r"gonio\.sha256"):
        Run.open(run.path)
    assert tree(tmp_path) == before


def test_a_folder_to_work_in_goes_at_its_end_and_those_of_dead_processes_go_with_it(tmp_path: Path) -> None:
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    dead, alive = tmp_path / f".radiance.{child.pid}.ab_1.work", tmp_path / f".radiance.{os.getpid()}.ab_1.work"
    others = [tmp_path / f".table.{child.pid}.ab_1.work", tmp_path / ".radiance.work"]
    for folder in (dead, alive, *others):
        folder.mkdir()
        (folder / "radiance.npz").write_bytes(b"begun")
    with disk.work_folder(tmp_path, "radiance") as work:
        assert work.parent == tmp_path
        assert work.name.startswith(f".radiance.{os.getpid()}.")
        (work / "radiance.npz").write_bytes(b"whole")
    assert sorted(tmp_path.iterdir()) == sorted([alive, *others])


def test_no_result_replaces_what_a_run_was_measured_into(measure: Measure, tmp_path: Path) -> None:
    run = measure("RUN")
    frame = next(iter(sorted((run.path / "frames").iterdir())))
    table = pd.DataFrame({"theta_i_deg": [30.0], "phi_i_deg": 0.0, "theta_r_deg": 10.0, "phi_r_deg": 180.0})
    table = table.assign(wavelength_nm=550.0, polarisation="unpolarised", brdf=0.2, u_brdf=0.01, u_random=0.01, flag="")
    before = tree(run.path)
    for path in (run.path / "run.toml", run.path / "plan.csv", run.path / "journal.jsonl", frame):
        for form in ("gonio", "astm"):
            with pytest.raises(ConfigError, match=rf"{path.name}: is a file of the run .*RUN, and is not replaced"):
                measurement.write(table, path, format=form)
        with pytest.raises(ConfigError, match="name another file"):
            disk.put(path, b"picture")
    assert tree(run.path) == before
    measurement.write(table, run.path / "frames" / "new.astm")  # replaces nothing
    measurement.write(table, tmp_path / "plan.csv")  # of no run
