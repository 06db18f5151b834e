"""The house is what docs/architecture.md shows, and its folders hang together by few imports and no circle."""

import graphlib
import re
from collections.abc import Iterator
from pathlib import Path

import grimp
import pytest

from tests.places import ROOT

PACKAGES = {
    "gonio": ROOT / "gonio",
    "gonio_drivers": ROOT / "drivers" / "gonio_drivers",
    "gonio_sim": ROOT / "sim" / "gonio_sim",
    "gonio_scenes": ROOT / "sim" / "gonio_scenes",
    "gonio_analysis": ROOT / "analysis" / "gonio_analysis",
    "gonio_maps": ROOT / "analysis" / "gonio_maps",
    "gonio_watch": ROOT / "analysis" / "gonio_watch",
    "gonio_sweeps": ROOT / "analysis" / "gonio_sweeps",
    "gonio_validation": ROOT / "analysis" / "gonio_validation",
    "gonio_bluesky": ROOT / "drivers" / "gonio_bluesky",
}
GROUND = {
    *(f"gonio.{name}" for name in ("config", "disk", "errors", "geometry", "platform", "shown", "typing")),
    *(f"gonio.{name}" for name in ("canvas", "hdf5", "lost", "polarisation", "seals")),
    *(f"gonio_analysis.{name}" for name in ("processes", "result_records")),
}
"""What everything may stand on, and what is not counted."""
ALLOWED = {"gonio": 38, "gonio_analysis": 20}
"""Arrows among folders."""


def tree() -> Iterator[Path]:
    """Every folder that the tree in docs/architecture.md shows."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    (shown,) = (block for block in blocks if block.startswith("gonio/"))
    above: list[tuple[int, Path]] = [(-1, ROOT)]
    for line in filter(None, shown.splitlines()):
        depth = len(line) - len(line.lstrip())
        while above[-1][0] >= depth:
            above.pop()
        path = above[-1][1] / line.split()[0]
        above.append((depth, path))
        yield path


def test_the_tree_in_the_docs_is_what_ls_shows() -> None:
    shown = list(tree())
    assert len(shown) == len(set(shown)), "something stands twice in the tree"
    there = {
        path
        for package in PACKAGES.values()
        for path in (package, *package.rglob("*/"))
        if path.name != "__pycache__" and any(path.glob("*.*"))
    }
    there |= {ROOT / "tools", ROOT / "tests"}
    assert {str(p.relative_to(ROOT)) for p in shown} == {str(p.relative_to(ROOT)) for p in there}


@pytest.mark.parametrize("package", PACKAGES)
def test_tests_stand_as_the_house_does(package: str) -> None:
    for folder in (ROOT / "tests" / package).rglob("*/"):
        if folder.name != "__pycache__" and any(folder.glob("*.py")):
            assert (PACKAGES[package] / folder.relative_to(ROOT / "tests" / package)).is_dir(), folder


@pytest.mark.parametrize("package", PACKAGES)
def test_folders_hang_together_by_few_imports_and_no_circle(package: str) -> None:
    graph = grimp.build_graph(package, cache_dir=None)
    rooms = graph.find_children(package)
    for room in rooms:
        graph.squash_module(room)
    below = {room: graph.find_modules_directly_imported_by(room) & rooms - {room} for room in rooms}
    graphlib.TopologicalSorter(below).prepare()  # raises CycleError, which names a circle
    counted = sum(len(imported - GROUND) for room, imported in below.items() if room not in GROUND)
    assert counted <= ALLOWED.get(package, counted), {a: b - GROUND for a, b in below.items()}


@pytest.mark.parametrize("package", PACKAGES)
def test_files_import_each_other_in_no_circle(package: str) -> None:
    """Imports inside functions count too; those for annotations alone do not."""
    graph = grimp.build_graph(package, cache_dir=None, exclude_type_checking_imports=True)
    graphlib.TopologicalSorter({m: graph.find_modules_directly_imported_by(m) for m in graph.modules}).prepare()
