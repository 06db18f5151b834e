"""The next page of a run has the address of the last one, and nobody else can read it."""

import json
import os
from pathlib import Path

import pytest
from gonio_watch import shared

TOKEN = "abcDEF-_" * 5


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


def kept(home: Path) -> Path:
    (file,) = home.rglob("*.json")
    return file


def test_what_is_kept_comes_back_for_the_same_folder_alone(home: Path, tmp_path: Path) -> None:
    assert shared.recall(tmp_path / "run") == (0, None)
    shared.remember(tmp_path / "run", 40123, TOKEN)
    assert (shared.recall(tmp_path / "run"), shared.recall(tmp_path / "other")) == ((40123, TOKEN), (0, None))
    assert kept(home).stat().st_mode & 0o777 == 0o600
    assert kept(home).parent.stat().st_mode & 0o777 == 0o700


def test_a_file_that_others_could_read_is_not_trusted(home: Path, tmp_path: Path) -> None:
    shared.remember(tmp_path / "run", 40123, TOKEN)
    os.chmod(kept(home), 0o644)
    assert shared.recall(tmp_path / "run") == (0, None)


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", json.dumps({"port": 0, "token": TOKEN}), json.dumps({"port": 99999, "token": TOKEN}),
     json.dumps({"port": 4000, "token": "short"}), json.dumps({"port": 4000, "token": "x" * 40 + "\n"})],
)  # fmt: skip
def test_a_damaged_file_counts_for_nothing(home: Path, tmp_path: Path, text: str) -> None:
    shared.remember(tmp_path / "run", 40123, TOKEN)
    kept(home).write_text(text)
    assert shared.recall(tmp_path / "run") == (0, None)


def test_folders_that_were_open_to_others_are_closed(home: Path, tmp_path: Path) -> None:
    (home / "gonio" / "pages").mkdir(parents=True)
    os.chmod(home, 0o755)
    for one in (home / "gonio", home / "gonio" / "pages"):
        os.chmod(one, 0o755)
    shared.private(tmp_path / "run")
    shared.remember(tmp_path / "run", 40123, TOKEN)
    assert {p.stat().st_mode & 0o777 for p in (home / "gonio", *home.glob("gonio/**/")) if p.is_dir()} == {0o700}
    assert home.stat().st_mode & 0o777 == 0o755, "what is above is somebody else's"
