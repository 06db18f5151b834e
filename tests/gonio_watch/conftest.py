"""One measured run for all tests of the live page."""

from pathlib import Path

import pytest

from tests.gonio.lab.live.runs import Played, measured


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Never changed."""
    return measured(tmp_path_factory.mktemp("whole"))


@pytest.fixture
def played(whole: Path, tmp_path: Path) -> Played:
    """Nothing of it has been measured yet."""
    return Played(whole, tmp_path / "played")


@pytest.fixture(autouse=True)
def state_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What watchers keep lies in no folder that outlives a test."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
