"""The command line as a process: help, messages, exit codes, commands of other packages."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gonio import plugins

from .bench import PLAN


def gonio(folder: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
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
    """A stranger's package with entry points, as an installer would leave it; the path to put on PYTHONPATH."""
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


def test_plan_show_tells_what_cannot_be_measured_and_how_long_it_takes(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    alone = gonio(tmp_path, "plan", "show", "plan.toml")
    assert alone.returncode == 0
    assert "6 points" in alone.stdout
    assert "550 nm, 650 nm" in alone.stdout
    on_rig = gonio(tmp_path, "plan", "show", "plan.toml", "--rig", "sim")
    assert on_rig.returncode == 0
    assert "blocked: -20" in on_rig.stdout
    assert "1 blocked: the bodies of source and detector block 3.2 deg around retro" in on_rig.stdout
    assert "visits to the white reference; about" in on_rig.stdout


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('how = "swap"', 'how = "beside"', "offset_mm = [0, 0] puts the patch of the reference on the sample"),
        ("roi_radius_mm = 0.8", "roi_radius_mm = 11.0", "is larger than the sample (20 mm in diameter)"),
        ("diameter_mm = 20.0\n\n[bands]", "diameter_mm = 1.5\n\n[bands]", "is larger than the white reference (1.5 mm"),
    ],
)
def test_a_patch_that_is_not_on_its_surface_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    shown = plugins.load("gonio.rigs", "sim").toml
    assert shown.count(old) == 1
    (tmp_path / "mine.toml").write_text(shown.replace(old, new))
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "s.toml").write_text('name = "grey"\nmodel = "lambert"\n')
    out = gonio(tmp_path, "measure", "plan.toml", "--rig", "mine.toml", "--sample", "s.toml", "--out", "run")
    assert out.returncode == 2
    assert words in " ".join(out.stderr.split())
    assert not (tmp_path / "run").exists()


def test_a_shown_rig_can_be_used_as_a_file(tmp_path: Path) -> None:
    shown = gonio(tmp_path, "rig", "show", "sim")
    assert shown.returncode == 0
    (tmp_path / "my.toml").write_text(
        shown.stdout.replace("light_body_radius_mm = 25.0", "light_body_radius_mm = 200.0")
    )
    (tmp_path / "plan.toml").write_text(PLAN)
    done = gonio(tmp_path, "plan", "show", "plan.toml", "--rig", "my.toml")
    assert "block 13.3 deg around retro" in done.stdout
    assert gonio(tmp_path, "rig", "show", "my.toml").stdout == (tmp_path / "my.toml").read_text()


def test_rig_check_of_the_simulated_rig_is_good(tmp_path: Path) -> None:
    done = gonio(tmp_path, "rig", "check", "--rig", "sim")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "BAD" not in done.stdout
    assert done.stdout.count("good") >= 7


def test_a_dark_lamp_fails_the_check(tmp_path: Path) -> None:
    shown = plugins.load("gonio.rigs", "sim").toml
    (tmp_path / "dark.toml").write_text(
        shown.replace("exposure_limits_s = [1e-5, 60.0]", "exposure_limits_s = [1e-5, 1e-4]")
    )
    done = gonio(tmp_path, "rig", "check", "--rig", "dark.toml")
    assert done.returncode == 3
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
def test_usage_and_configuration_end_with_2(tmp_path: Path, arguments: tuple[str, ...], words: list[str]) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "sample.toml").write_text('name = "s"\nmodel = "lambert"\n[parameters]\nalbdo = 1\n')
    (tmp_path / "good.toml").write_text('name = "s"\nmodel = "lambert"\n[parameters]\nalbedo = 1\n')
    (tmp_path / "other.toml").write_text(plugins.load("gonio.rigs", "sim").toml.replace('"sim"', '"nobody"'))
    before = sorted(path.name for path in tmp_path.iterdir())
    done = gonio(tmp_path, *arguments)
    assert done.returncode == 2, done.stdout + done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) <= 12
    for word in words:
        assert word in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_dry_run_checks_everything_and_writes_nothing(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "good.toml").write_text('name = "s"\nmodel = "lambert"\n[parameters]\nalbedo = 1\n')
    arguments = ("measure", "plan.toml", "--rig", "sim", "--sample", "good.toml", "--out", "run", "--dry-run")
    done = gonio(tmp_path, *arguments)
    assert done.returncode == 0, done.stderr
    assert "6 points" in done.stdout
    assert not (tmp_path / "run").exists()


def test_a_stranger_s_command_appears_and_a_broken_one_is_listed_with_its_error(tmp_path: Path) -> None:
    site = installed(
        tmp_path,
        "gonio.commands",
        "hello = stranger:hello\nwrong = stranger:absent\n",
        'def hello(name: str) -> None:\n    """Greet."""\n    print("hello", name)\n',
    )
    shown = gonio(tmp_path, "--help", PYTHONPATH=site)
    assert shown.returncode == 0
    assert "Greet." in shown.stdout
    assert "AttributeError" in shown.stdout
    assert gonio(tmp_path, "hello", "you", PYTHONPATH=site).stdout == "hello you\n"
    broken = gonio(tmp_path, "wrong", PYTHONPATH=site)
    assert broken.returncode == 2
    assert "stranger" in broken.stderr


def test_a_broken_rig_is_listed_with_its_error(tmp_path: Path) -> None:
    site = installed(tmp_path, "gonio.rigs", "wreck = stranger:RIG\n", "import no_such_module\n")
    done = gonio(tmp_path, "rig", "list", PYTHONPATH=site)
    assert done.returncode == 0
    assert "no_such_module" in done.stdout
    assert "sim-ideal" in done.stdout
    assert gonio(tmp_path, "rig", "show", "wreck", PYTHONPATH=site).returncode == 2


def test_what_should_not_happen_says_where_the_traceback_is(tmp_path: Path) -> None:
    site = installed(tmp_path, "gonio.commands", "crash = stranger:crash\n", "def crash() -> None:\n    1 / 0\n")
    done = gonio(tmp_path, "crash", PYTHONPATH=site)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "GONIO_TRACEBACK" in done.stderr
    assert "ZeroDivisionError" in done.stderr
    assert "Traceback" in gonio(tmp_path, "crash", PYTHONPATH=site, GONIO_TRACEBACK="1").stderr
