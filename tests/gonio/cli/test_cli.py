"""The command line: help, messages, exit codes, commands of other packages."""

import csv
import os
import re
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from gonio import plugins
from gonio.cli import application
from tests.command_line import beside, gonio, says
from tests.gonio.numpy_rig import PLAN


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a plan (`plan.toml`) and a matt sample (`good.toml`)."""
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "good.toml").write_text('name = "grey"\nmodel = "lambert"\n')
    return tmp_path


def process(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "from gonio.cli import main; main()", *arguments],
        cwd=folder,
        env=os.environ | {"COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"} | environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def installed(folder: Path, group: str, points: str, module: str) -> str:
    """Another package's package with entry points, as an installer would leave it; the path to put on PYTHONPATH."""
    site = folder / "site"
    info = site / "stranger-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{group}]\n{points}\n")
    (site / "stranger.py").write_text(module)
    return str(site)


def test_help_imports_nothing_heavy(tmp_path: Path) -> None:
    script = (
        "import sys\nfrom gonio.cli import main\nsys.argv = ['gonio', '--help']\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "heavy = {'numpy', 'pandas', 'scipy', 'numba', 'matplotlib', 'cv2', 'rawpy', 'pydantic'}\n"
        "print('heavy:', sorted(heavy & set(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=tmp_path, timeout=600
    )
    assert "heavy: []" in done.stdout


def test_blas_has_one_thread_unless_somebody_says_otherwise() -> None:
    code = (
        "import os, sys; from gonio.cli import main; sys.argv = ['gonio', '--version']\n"
        "try: main()\n"
        "except SystemExit: print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    bare = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    for given, expected in ((bare, "1"), ({**bare, "OPENBLAS_NUM_THREADS": "2"}, "2")):
        done = subprocess.run([sys.executable, "-c", code], env=given, capture_output=True, text=True, check=True)
        assert done.stdout.split()[-1] == expected


def test_plan_show_tells_what_cannot_be_measured_and_how_long_it_takes(folder: Path) -> None:
    says(gonio(folder, "plan", "show", "plan.toml", expect=0).stdout, "6 points", "550 nm, 650 nm")
    says(
        gonio(folder, "plan", "show", "plan.toml", "--rig", "sim", expect=0).stdout,
        "blocked: -20",
        "1 blocked: the bodies of source and detector block 3.2 deg around retro",
        "measurements of the white reference; about",
    )


GRID = """name = "grid"
wavelength_nm = [550]
order = "short"
reference_every = 50
[[half_vector]]
theta_i_deg = [20, 70]
theta_h_deg = { stop = 40, count = 30, spacing = "square" }
phi_h_deg = { start = 0, stop = 345, step = 15 }
[[sweep]]
theta_i_deg = [45]
theta_r_deg = [-45, 0, 45]
repeats = 2
"""


def test_plan_show_of_a_large_grid_is_a_page_that_can_be_read(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(GRID)
    done = gonio(tmp_path, "plan", "show", "plan.toml", "--rig", "sim", "--left-out", "lost.csv", expect=0)
    assert len(done.stdout.splitlines()) < 40
    assert max(map(len, done.stdout.splitlines())) <= 120
    says(
        done.stdout, "azimuths)", "3 points are measured 2 times each, spread over the run",
        "half vectors need a detector below the horizon; they are left out",
        "order: short; as written the travel would take",
    )  # fmt: skip
    says(done.stdout, "time: travel ", "frames ", "white reference ", "dark ")
    with open(tmp_path / "lost.csv", newline="") as file:
        lost = list(csv.DictReader(file))
    counted = [int(line.split()[0]) for line in done.stdout.splitlines() if re.match(r"\d+ (blocked|unreach)", line)]
    assert len(lost) == sum(counted) > 0
    assert all(row["flag"] in ("blocked", "unreachable") and row["reason"] for row in lost)
    assert ("45.0", "45.0", "0.0") in {(row["theta_i_deg"], row["theta_r_deg"], row["phi_r_deg"]) for row in lost}
    again = gonio(tmp_path, "plan", "show", "plan.toml", "--rig", "sim", "--left-out", "lost.csv", expect=2)
    assert "lost.csv is there already" in again.stderr
    alone = gonio(tmp_path, "plan", "show", "plan.toml", "--left-out", "other.csv")
    assert (alone.returncode, "--rig" in alone.stderr) == (2, True)


def test_many_angles_of_incidence_share_a_row(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(
        'name = "p"\nwavelength_nm = [550]\n'
        "[[sweep]]\ntheta_i_deg = { start = 0, stop = 60, step = 0.5 }\ntheta_r_deg = [10]\n"
    )
    done = gonio(tmp_path, "plan", "show", "plan.toml")
    says(done.stdout, "11.5 to 60", "(98 angles)")
    assert len(done.stdout.splitlines()) < 40


def test_a_dry_run_says_what_the_disk_needs(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text('name = "p"\nwavelength_nm = [550]\n[[sweep]]\n' + "theta_i_deg = [45]\n"
                                        "theta_r_deg = [0, 20]\n")  # fmt: skip
    (tmp_path / "s.toml").write_text('name = "grey"\nmodel = "lambert"\n')
    command = ("measure", "plan.toml", "--rig", "sim", "--sample", "s.toml", "--out", "run")
    dry = gonio(tmp_path, *command, "--dry-run")
    found = re.search(r"(\d+) frames, about ([\d.]+) MB on the disk; .* free there", dry.stdout)
    assert found is not None, dry.stdout
    assert "2 points" in dry.stdout
    assert "gonio plan show plan.toml --rig sim --picture" in dry.stderr
    assert not (tmp_path / "run").exists()
    assert gonio(tmp_path, *command).returncode == 0
    files = list((tmp_path / "run" / "frames").iterdir())
    assert len(files) == int(found[1])
    assert sum(file.stat().st_size for file in files) == pytest.approx(1e6 * float(found[2]), rel=0.01)  # of 3 digits


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('how = "swap"', 'how = "beside"', "offset_mm = [0, 0] puts the patch of the reference on the sample"),
        ("roi_radius_mm = 0.8", "roi_radius_mm = 11.0", "is larger than the sample (20 mm in diameter)"),
        ("diameter_mm = 20.0\n\n[bands]", "diameter_mm = 1.5\n\n[bands]", "is larger than the white reference (1.5 mm"),
    ],
)
def test_a_patch_that_is_not_on_its_surface_is_refused(folder: Path, old: str, new: str, words: str) -> None:
    shown = plugins.load("gonio.rigs", "sim").toml
    assert shown.count(old) == 1
    (folder / "mine.toml").write_text(shown.replace(old, new))
    out = gonio(folder, "measure", "plan.toml", "--rig", "mine.toml", "--sample", "good.toml", "--out", "run", expect=2)
    assert words in " ".join(out.stderr.split())
    assert not (folder / "run").exists()


def test_a_shown_rig_can_be_used_as_a_file(folder: Path) -> None:
    shown = gonio(folder, "rig", "show", "sim", expect=0)
    (folder / "my.toml").write_text(shown.stdout.replace("light_body_radius_mm = 25.0", "light_body_radius_mm = 200.0"))
    assert "block 13.3 deg around retro" in gonio(folder, "plan", "show", "plan.toml", "--rig", "my.toml").stdout
    assert gonio(folder, "rig", "show", "my.toml").stdout == (folder / "my.toml").read_text()


@pytest.mark.parametrize("rig", ["sim", "sim-uncalibrated"])  # the second rests a step beyond its limits
def test_rig_check_of_the_simulated_rig_is_good(tmp_path: Path, rig: str) -> None:
    done = gonio(tmp_path, "rig", "check", "--rig", rig, expect=0)
    assert "BAD" not in done.stdout
    assert done.stdout.count("good") >= 7


def test_a_dark_lamp_fails_the_check(tmp_path: Path) -> None:
    shown = plugins.load("gonio.rigs", "sim").toml
    (tmp_path / "dark.toml").write_text(
        shown.replace("exposure_limits_s = [1e-5, 60.0]", "exposure_limits_s = [1e-5, 1e-4]")
    )
    done = gonio(tmp_path, "rig", "check", "--rig", "dark.toml", expect=3)
    assert "lit frame" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("plan", "show", "absent.toml"), ["absent.toml", "no such file"]),
        (("plan", "show", "plan.toml", "--rig", "smi"), ["smi", 'did you mean "sim"']),
        (("plan", "show", "plan.toml", "--rig", "no/such.toml"), ["no/such.toml", "no such file"]),
        (("plan", "show", "plan.toml", "--rig", "other.toml"), ["other.toml", "nobody"]),
        (("measure", "plan.toml", "--rig", "sim"), ["--out"]),
        (("measure", "plan.toml", "--rig", "sim", "--out", "run", "--seed", "-1"), ["--seed"]),
        (("measure", "plan.toml", "--rig", "sim", "--out", "run"), ["--sample"]),
        (
            ("measure", "plan.toml", "--rig", "sim", "--out", "run", "--sample", "sample.toml"),
            ["sample.toml", "albedo"],
        ),
        (("measure", "plan.toml", "--rig", "sim", "--out", "/proc/none/run", "--sample", "good.toml"), ["/proc"]),
        (("measure", "plan.toml", "--rig", "sim", "--out", "plan.toml", "--sample", "good.toml"), ["plan.toml"]),
        (("reduce", "absent"), ["absent"]),
        (("reduce", "."), ["run.toml"]),
        (("nonsense",), ["nonsense"]),
        (("reduce", "od\udcffd"), ["od\\xffd", "UTF-8"]),  # the byte 255 in a file's name
    ],
)
def test_usage_and_configuration_end_with_2(folder: Path, arguments: tuple[str, ...], words: list[str]) -> None:
    (folder / "sample.toml").write_text('name = "s"\nmodel = "lambert"\n[parameters]\nalbdo = 1\n')
    (folder / "other.toml").write_text(plugins.load("gonio.rigs", "sim").toml.replace('"sim"', '"nobody"'))
    before = sorted(path.name for path in folder.iterdir())
    done = gonio(folder, *arguments, expect=2)
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) <= 12
    says(done.stderr, *words)
    assert sorted(path.name for path in folder.iterdir()) == before


def test_a_stranger_s_command_appears_and_a_broken_one_is_listed_with_its_error(tmp_path: Path) -> None:
    site = installed(
        tmp_path,
        "gonio.commands",
        "hello = stranger:hello\nwrong = stranger:absent\n",
        'def hello(name: str) -> None:\n    """Greet."""\n    print("hello", name)\n',
    )
    shown = beside(site, tmp_path, "--help")
    assert shown.returncode == 0
    says(shown.stdout, "Greet.", "AttributeError")
    assert beside(site, tmp_path, "hello", "you").stdout == "hello you\n"
    broken = beside(site, tmp_path, "wrong")
    assert broken.returncode == 2
    assert "stranger" in broken.stderr


@pytest.mark.parametrize(
    ("module", "said"),
    [
        ("import no_such_module\n", "no_such_module"),
        ("print('loud')\nraise SystemExit(0)\n", "ends the program on import"),
    ],
)
def test_a_broken_rig_is_listed_with_its_error(tmp_path: Path, module: str, said: str) -> None:
    site = installed(tmp_path, "gonio.rigs", "wreck = stranger:RIG\n", module)
    done = beside(site, tmp_path, "rig", "list")
    assert done.returncode == 0
    says(done.stdout, said, "sim-ideal")
    assert "loud" not in done.stdout
    called = beside(site, tmp_path, "rig", "show", "wreck")
    assert called.returncode == 2
    assert 'gonio: the rig "wreck" (stranger:RIG) cannot be loaded: ' in called.stderr


def test_what_should_not_happen_says_where_the_traceback_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = installed(tmp_path, "gonio.commands", "crash = stranger:crash\n", "def crash() -> None:\n    1 / 0\n")
    done = beside(site, tmp_path, "crash")
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    says(done.stderr, "GONIO_TRACEBACK", "ZeroDivisionError")
    monkeypatch.setenv("GONIO_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):  # which Python shows with its traceback
        beside(site, tmp_path, "crash")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("import sys; sys.exit()", "ends the program on import (sys.exit(None))"),
        ("import sys; sys.exit('no licence')", "sys.exit('no licence')"),
        ("raise GeneratorExit('odd')", "GeneratorExit: odd"),
        ("class Odd(BaseException): pass\nraise Odd('a\\nb')", "Odd: a b"),
        ("print('I am loud'); 1 / 0", "ZeroDivisionError"),
        ("cmd = 3", "3 is not a callable"),
        ("def cmd(x: 'Absent') -> None: ...", "Absent"),
    ],
)
def test_whatever_a_stranger_s_module_does_on_import_only_its_own_command_suffers(
    tmp_path: Path, line: str, said: str
) -> None:
    site = installed(tmp_path, "gonio.commands", "wreck = stranger:cmd\n", line + "\n")
    shown = beside(site, tmp_path, "--help")
    assert shown.returncode == 0, shown.stderr
    says(shown.stdout, "wreck", "cannot be loaded", "report")
    assert "loud" not in shown.stdout
    called = beside(site, tmp_path, "wreck", "sub", "--out", "b", "-x")
    assert called.returncode == 2
    message = called.stderr.splitlines()[-1]
    assert message.startswith('gonio: the command "wreck" (stranger:cmd) cannot be loaded: ')
    assert said in message


def test_a_stranger_s_module_is_imported_by_its_own_command_and_the_help_alone(tmp_path: Path) -> None:
    site = installed(tmp_path, "gonio.commands", "wreck = stranger:cmd\n", "import os; os._exit(9)\n")
    assert process(tmp_path, "plan", "show", "absent.toml", PYTHONPATH=site).returncode == 2
    assert process(tmp_path, "wreck", PYTHONPATH=site).returncode == 9


def test_a_wrong_name_is_answered_with_the_nearest_of_all_commands(tmp_path: Path) -> None:
    assert "Did you mean 'report'?" in gonio(tmp_path, "reprt").stderr
    assert "Did you mean 'measure'?" in gonio(tmp_path, "mesure").stderr


@pytest.mark.parametrize(
    ("redirected", "code", "words"),
    [
        ("rig show sim > /dev/full", 1, "standard output: No space left on device"),
        ("--help > /dev/full", 1, "standard output: No space left on device"),
        ("--version > /dev/full", 1, "standard output: No space left on device"),
        ("rig show sim 2> /dev/full | grep -c arms", 0, ""),
        ("plan show absent.toml 2> /dev/full", 2, ""),
        ("plan show absent.toml 2>&-", 2, ""),
        ("plan show absent.toml >&-", 2, "absent.toml: there is no such file"),
        ("plan show plan.toml <&- >&- 2>&-", 0, ""),
        ("rig show sim | head -n 1 > /dev/null", 0, ""),
    ],
)
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_streams_that_are_closed_or_full(folder: Path, redirected: str, code: int, words: str) -> None:
    program = f'"{sys.executable}" -c "from gonio.cli import main; main()"'
    done = subprocess.run(
        ["sh", "-c", f"{program} {redirected}"],
        cwd=folder, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    assert len(done.stderr.splitlines()) == (1 if words else 0), done.stderr
    assert words in done.stderr


def test_a_file_does_not_get_the_number_of_a_closed_stream(tmp_path: Path) -> None:
    """What is printed on a standard error that the caller had closed would end up in the next file that is opened."""
    site = installed(
        tmp_path, "gonio.commands", "leak = stranger:leak\n",
        textwrap.dedent("""
            import os
            def leak() -> None:
                with open("data", "w"):
                    os.write(2, b"a remark of a C library")
        """),
    )  # fmt: skip
    program = f'"{sys.executable}" -c "from gonio.cli import main; main()"'
    done = subprocess.run(
        ["sh", "-c", f"{program} leak 2>&-"], cwd=tmp_path, env=os.environ | {"PYTHONPATH": site}, check=False
    )
    assert done.returncode == 0
    assert (tmp_path / "data").read_bytes() == b""


LONG = "n" * 300


@pytest.mark.parametrize(
    "arguments",
    [
        ("fit", f"{LONG}.csv", "--model", "lambert"),
        ("fit", f"a:{LONG}", "--model", "lambert"),
        ("compare", LONG, "--out", "x"),
        ("compare", "good.csv", "--models", "lambert", "--out", LONG),
        ("report", LONG),
        ("convert", "good.csv", f"{LONG}.csv"),
        ("measure", LONG, "--rig", "sim", "--out", "x"),
        ("measure", "plan.toml", "--rig", LONG, "--out", "x"),
        ("figures", "htsg-8", "--out", LONG),
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_name_of_300_characters_is_named(folder: Path, arguments: tuple[str, ...]) -> None:
    (folder / "good.csv").write_text(
        "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf\n30,0,10,180,0.15\n30,0,20,180,0.15\n"
    )
    before = sorted(path.name for path in folder.iterdir())
    (line,) = gonio(folder, *arguments, expect=2).stderr.splitlines()
    assert LONG[:40] in line
    assert "too long" in line
    assert "should not happen" not in line
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize(
    ("raised", "code", "words"),
    [
        (MemoryError("Unable to allocate 8 TiB"), 1, "too little memory: Unable to allocate 8 TiB"),
        (MemoryError(), 1, "too little memory"),
        (ImportError("x.so: failed to map segment from shared object"), 1, "too little memory"),
        (OSError("Could not find/load shared object file 'libllvmlite.so'"), 1, "too little memory"),
        (RuntimeError("can't start new thread"), 1, "too little memory"),
        (OSError(12, "Cannot allocate memory"), 1, "too little memory"),
        (OSError(28, "No space left on device"), 1, "No space left on device"),
        (PermissionError(13, "Permission denied", "a/b"), 2, "a/b: Permission denied"),
        (RecursionError("maximum recursion depth exceeded"), 1, "nested too deeply"),
        (BrokenPipeError(32, "Broken pipe"), 1, "should not happen: BrokenPipeError"),
    ],
)
def test_errors_of_the_system_are_named(raised: BaseException, code: int, words: str) -> None:
    message, ended = application._explain(raised)
    assert ended == code
    assert words in message


def test_the_end_of_the_input_is_no_silent_abort(tmp_path: Path) -> None:
    site = installed(tmp_path, "gonio.commands", "ask = stranger:ask\n", "def ask() -> None:\n    input()\n")
    done = beside(site, tmp_path, "ask")
    assert done.returncode == 1
    assert "EOFError" in done.stderr
    assert "Aborted" not in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")
@pytest.mark.parametrize(
    ("number", "where"),
    [
        (signal.SIGINT, "import"), (signal.SIGTERM, "import"), (signal.SIGHUP, "import"),
        (signal.SIGTERM, "command"), (signal.SIGINT, "swallowed"), (signal.SIGTERM, "twice"),
    ],
)  # fmt: skip
def test_a_signal_ends_any_command_with_one_line(tmp_path: Path, number: signal.Signals, where: str) -> None:
    """While modules are imported too, and where a library makes an error of its own of the interruption."""
    raised = f"os.kill(os.getpid(), {int(number)})"
    lines = {
        "import": f"import os\n{raised}\ndef slow() -> None: ...\n",
        "command": f"import os\ndef slow() -> None:\n    {raised}\n",
        "swallowed": f"import os\ndef slow() -> None:\n    try:\n        {raised}\n"
        "    except BaseException:\n        raise ImportError('numpy is broken')\n",
        "twice": f"import os\ndef slow() -> None:\n    try:\n        {raised}\n    finally:\n        {raised}\n",
    }
    site = installed(tmp_path, "gonio.commands", "slow = stranger:slow\n", lines[where])
    inherited = signal.getsignal(number)
    if inherited is signal.SIG_IGN:  # of SIGHUP where the tests run under nohup: the command would be deaf to it too
        signal.signal(number, signal.SIG_DFL)
    try:
        done = process(tmp_path, "slow", PYTHONPATH=site)
    finally:
        signal.signal(number, inherited)
    assert (done.returncode, done.stderr) == (130, "gonio: interrupted\n")


def test_a_signal_that_is_set_to_be_ignored_stays_so(tmp_path: Path) -> None:
    site = installed(
        tmp_path, "gonio.commands", "slow = stranger:slow\n",
        "import os, signal\ndef slow() -> None:\n    os.kill(os.getpid(), signal.SIGHUP)\n    print('done')\n",
    )  # fmt: skip
    done = subprocess.run(
        ["nohup", sys.executable, "-c", "from gonio.cli import main; main()", "slow"],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": site}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "done\n")
