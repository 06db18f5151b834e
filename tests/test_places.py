"""Tests on measured data skip where the data are missing, and fail in continuous integration where they are broken."""

from pathlib import Path

import pytest

from tests import places


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(places, "SHARED_DATA", tmp_path / "data")
    (tmp_path / "data" / "empty").mkdir(parents=True)
    (tmp_path / "data" / "there.csv").write_text("1\n")
    return tmp_path / "data"


@pytest.mark.parametrize("ci", ["true", None])
def test_data_that_are_there_are_found(data: Path, monkeypatch: pytest.MonkeyPatch, ci: str | None) -> None:
    monkeypatch.setenv("CI", ci) if ci else monkeypatch.delenv("CI", raising=False)
    assert places.measured("there.csv") == data / "there.csv"


@pytest.mark.parametrize("name", ["missing.csv", "empty"])
def test_a_user_s_machine_skips_and_continuous_integration_fails(
    data: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.delenv("CI", raising=False)
    with pytest.raises(pytest.skip.Exception, match=name):
        places.measured(name)
    monkeypatch.setenv("CI", "true")
    with pytest.raises(pytest.fail.Exception, match=name):
        places.measured(name)


def test_continuous_integration_without_the_data_skips(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CI", "true")
    monkeypatch.setattr(places, "SHARED_DATA", data / "nowhere")
    with pytest.raises(pytest.skip.Exception):
        places.measured("there.csv")
