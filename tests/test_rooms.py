"""Optional packages are taken away, one by one and all at once: the rest works, and what is missing says so."""

import subprocess
import sys
from pathlib import Path

import pytest

from gonio import measurement, plugins
from gonio.models import Lambert
from tests.gonio_analysis.synthetic import measure

ROOMS = sorted({package for names in plugins.ROOMS.values() for package in names.values()})
WITHOUT = """
import importlib.metadata as metadata, importlib.util as util, sys

class Away:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {away!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

found, of_name = metadata.entry_points, util.find_spec
metadata.entry_points = lambda **asked: (
    [p for p in found(**asked) if p.module.split(".")[0] not in {away!r}] if asked else found()
)
util.find_spec = lambda name, package=None: None if name.split(".")[0] in {away!r} else of_name(name, package)
sys.meta_path.insert(0, Away())
from gonio.cli import main
for words in {commands!r}:
    sys.argv = ["gonio", *words]
    try:
        main()
    except SystemExit as end:
        print("exit", end.code or 0, flush=True)
        sys.stdout = sys.__stdout__
"""
"""Commands in one process that cannot import some packages, and is not told of their entry points."""


def without(away: tuple[str, ...], *commands: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    code = WITHOUT.format(away=away, commands=commands)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rooms") / "white.csv"
    measurement.write(measure(Lambert(0.6), incidences=(20.0, 50.0)), path)
    return path


@pytest.mark.parametrize("away", [*((room,) for room in ROOMS), tuple(ROOMS)], ids="-".join)
def test_tables_are_read_fitted_compared_and_reported_without_a_room(
    away: tuple[str, ...], table: Path, tmp_path: Path
) -> None:
    commands = [
        ("--help",),
        ("fit", str(table), "--model", "lambert"),
        ("convert", str(table), str(tmp_path / "b.csv")),
    ]
    if away == tuple(ROOMS):  # import-linter sees that none needs another one
        commands.append(("compare", str(table), "--models", "lambert", "--out", str(tmp_path / "page")))
    done = without(away, *commands)
    assert done.stdout.count("exit 0") == len(commands), done.stdout + done.stderr
    assert (tmp_path / "page" / "index.html").is_file() == (away == tuple(ROOMS))
    hidden = [name for name, package in plugins.ROOMS["gonio.commands"].items() if package in away]
    assert not [name for name in hidden if f"\n  {name} " in done.stdout]


def test_what_is_missing_is_said_in_one_line_that_names_the_package(table: Path, tmp_path: Path) -> None:
    commands = (
        ("watch", "run"),
        ("render", "scene.toml", "--out", "x"),
        ("convert", str(table), str(tmp_path / "x"), "--to", "bluesky"),
        ("figures", "pictures", "--out", str(tmp_path / "figures")),
    )
    done = without(tuple(ROOMS), *commands)
    lines = done.stderr.splitlines()
    assert done.stdout.split() == ["exit", "2"] * len(commands), done.stdout + done.stderr
    assert len(lines) == len(commands), done.stderr
    for line, room in zip(lines, ("gonio_watch", "gonio_scenes", "gonio_bluesky", "gonio_scenes"), strict=True):
        assert line.endswith(f" the package {room}, which is not installed here")
