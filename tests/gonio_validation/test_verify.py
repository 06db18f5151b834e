"""`gonio verify`: it passes here, and names the part of an installation that is broken."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from gonio_validation import verify
from gonio_validation.verify import arithmetic, digits, finding, installation, line

from gonio import formats as of_files
from tests.command_line import gonio
from tests.places import ROOT


@pytest.mark.slow
def test_this_installation_passes_and_its_page_is_ready_to_sign(tmp_path: Path) -> None:
    done = gonio(tmp_path, "verify", "--out", "page")
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "page/summary.json").read_text(encoding="utf-8"))
    assert summary["passed"] is True
    assert [part["name"] for part in summary["parts"]] == [part.name for part in verify.PARTS]
    assert all(part["findings"] for part in summary["parts"])
    page = (tmp_path / "page/index.html").read_text(encoding="utf-8")
    assert "signature" in page
    assert "StRD Misra1a" in page


@pytest.mark.slow
def test_the_parts_of_a_broken_installation_are_named(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "gonio", tmp_path / "gonio")  # with what is compiled: only what differs is compiled anew
    kernel, table = tmp_path / "gonio/models/oren_nayar.py", tmp_path / "gonio/colour/observer.csv"
    text = kernel.read_text(encoding="utf-8")
    assert "* 0.125 *" in text
    kernel.write_text(text.replace("* 0.125 *", "* 0.126 *"), encoding="utf-8")
    table.write_text("\n".join(table.read_text(encoding="utf-8").splitlines()[:200]) + "\n", encoding="utf-8")  # cut
    env = os.environ | {"PYTHONPATH": str(tmp_path), "COLUMNS": "200"}
    code = f"import gonio; assert gonio.__file__.startswith({str(tmp_path)!r}); from gonio.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "verify"], env=env, capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == 1, done.stderr
    assert "models: FAILED" in done.stderr
    assert "OrenNayar, functional" in done.stderr
    assert "colour: FAILED" in done.stderr
    assert "fails in: models, colour" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_file_that_was_changed_after_its_release_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class File(type(Path())):  # type: ignore[misc]
        """As `importlib.metadata` tells of one."""

        hash: object

        def locate(self) -> Path:
            return tmp_path / "changed.py"

    (tmp_path / "changed.py").write_text("other")
    one = File("gonio/changed.py")
    one.hash = type("Hash", (), {"mode": "sha256", "value": "x"})()
    monkeypatch.setattr("importlib.metadata.files", lambda name: [one])
    (found,) = installation._checksums()
    assert not found.passed
    assert "gonio/changed.py" in found.found


def test_a_part_that_ends_with_an_error_fails_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def ends(folder: Path) -> list[finding.Finding]:
        raise ValueError("a table is cut")

    parts = (verify.VerifyPart("one", "x", ends), verify.VerifyPart("two", "y", digits.colour))
    monkeypatch.setattr(verify, "PARTS", parts)
    found = verify.verify(tmp_path)
    assert [part["passed"] for part in found["parts"]] == [False, True]
    assert "a table is cut" in found["parts"][0]["findings"][0].found
    assert "fails in: one" in found["conclusion"]


def test_a_wrong_number_does_not_pass() -> None:
    assert finding.near("x", 1.0 + 1e-6, 1.0, rel=1e-5).passed
    assert not finding.near("x", 1.0 + 1e-4, 1.0, rel=1e-5).passed
    assert not finding.near("x", float("nan"), 1.0, rel=1e-5).passed
    assert not finding.most("x", float("nan"), 1.0, "y").passed
    assert not finding.most("x", float("inf"), 1.0, "y").passed


@pytest.mark.parametrize(
    ("look", "promised"),
    [
        (arithmetic.look, {"GUM H.1", "GUM H.2", "StRD Misra1a", "StRD DanWood", "CCQM-K30 lead"}),
        (line.formats, {of_files.named(name).title for name in line.FORMATS}),
        (digits.colour, {"observer", "D65", "A", "D50"}),
        pytest.param(digits.models, {
            "HeTorrance", "CookTorrance", "Blinn", "OrenNayar", "Lambert", "Phong", "AnisotropicFacets",
            "Retroreflecting",
        }, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_parts_hold_what_they_promise(
    look: Callable[[Path], list[finding.Finding]], promised: set[str], tmp_path: Path
) -> None:
    found = look(tmp_path)
    assert {one.name.split(":")[0].split(",")[0] for one in found} >= promised
    assert not [one for one in found if not one.passed]
