"""What each release wrote is read by this version: one run, with its table, an archive a release."""

import tarfile
from pathlib import Path

import numpy as np
import pytest

import gonio
from tests.command_line import gonio as command

RELEASES = sorted((Path(__file__).parent / "releases").glob("*.tar.xz"))


@pytest.mark.parametrize("archive", RELEASES, ids=lambda path: path.name.removesuffix(".tar.xz"))
def test_a_release_s_table_and_run_are_read(archive: Path, tmp_path: Path) -> None:
    with tarfile.open(archive) as stored:
        stored.extractall(tmp_path, filter="data")
    table = gonio.read(tmp_path / "run" / "brdf.csv")
    assert len(table) == 5
    assert np.isfinite(table["brdf"]).all()
    for words in (("reduce", "run"), ("fit", "run", "--model", "oren-nayar", "--fix", "sigma_deg=20")):
        done = command(tmp_path, *words)
        assert done.returncode == 0, done.stderr
    again = gonio.read(tmp_path / "run" / "brdf.csv")
    # the same frames: what later versions know better changes values by less than they are uncertain
    assert np.all(np.abs(again["brdf"] - table["brdf"]) < table["u_brdf"])
    # the sample's true albedo is 0.6
    assert "albedo" in done.stdout


def test_the_newest_closed_release_is_kept() -> None:
    """A version that the changelog has closed has its archive."""
    text = (Path(__file__).parents[2] / "CHANGELOG.md").read_text(encoding="utf-8")
    closed = [line.split()[1] for line in text.splitlines() if line.startswith("## 0.") and " - " in line]
    newest = next(version for version in closed if version != "0.1.0")
    assert any(path.name.startswith(newest) for path in RELEASES), f"tests/golden/releases/{newest}.tar.xz is missing"
