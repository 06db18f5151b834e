"""--ior for each sample, and what is remembered beside its file."""

from pathlib import Path

import pytest
from gonio_analysis.fitting.optical_constants import Constants, NamedSample, TakenConstants

from gonio.errors import ConfigError


@pytest.fixture
def samples(tmp_path: Path) -> list[NamedSample]:
    for name in ("gold.csv", "plaster.csv"):
        (tmp_path / name).write_text("x")
    return [NamedSample(str(tmp_path / "gold.csv"), "leaf"), NamedSample(str(tmp_path / "plaster.csv"), "plaster")]


@pytest.mark.parametrize("name", ["gold.csv", "leaf", "gold"])
def test_one_sample_is_named_by_its_file_or_its_name(samples: list[NamedSample], name: str) -> None:
    assert TakenConstants.of(Constants.of([f"{name}=Au"]), samples).values == ["Au", None]
    assert TakenConstants.of(Constants.of([f"{samples[0].source}=Au", "1.5"]), samples).values == ["Au", 1.5 + 0j]
    assert TakenConstants.of(Constants.of(["Al"]), samples).values == ["Al", "Al"]


def test_names_that_are_none_are_told_with_those_that_are(samples: list[NamedSample]) -> None:
    with pytest.raises(ConfigError, match=r"--ior silver=Ag: no sample is called silver; .*gold\.csv, .*plaster\.csv"):
        TakenConstants.of(Constants.of(["silver=Ag"]), samples)
    with pytest.raises(ConfigError, match="given twice for gold"):
        Constants.of(["gold=Au", "gold=Al"])
    with pytest.raises(ConfigError, match="SAMPLE=NAME is needed"):
        Constants.of(["=Au"])
    with pytest.raises(ConfigError, match="a map has no samples to name"):
        Constants.of(["gold=Au"]).require_of_all("a map")


def test_what_is_given_is_remembered_and_not_written_over(samples: list[NamedSample]) -> None:
    (said,) = TakenConstants.of(Constants.of(["gold.csv=Au"]), samples).remember()
    assert "gold.ior.toml now has --ior Au" in said
    later = TakenConstants.of(Constants(), samples)
    assert later.values == ["Au", None]
    assert len(later.notes) == 1
    assert "--ior Au is taken from" in later.notes[0]
    assert later.remember() == []
    assert TakenConstants.of(Constants.of(["Au"]), samples[:1]).remember() == []  # it says the same
    before = samples[0].beside.read_bytes()
    other = TakenConstants.of(Constants.of(["gold.csv=0.3+2.5j"]), samples)
    assert other.values[0] == 0.3 + 2.5j
    assert "says otherwise" in other.remember()[0]
    assert samples[0].beside.read_bytes() == before


def test_samples_of_one_file_are_remembered_by_name(tmp_path: Path) -> None:
    (tmp_path / "metals.astm").write_text("x")
    both = [NamedSample(f"{tmp_path / 'metals.astm'}:{name}", name) for name in ("gold", "copper")]
    TakenConstants.of(Constants.of(["gold=Au", "copper=Cu"]), both).remember()
    assert TakenConstants.of(Constants(), both).values == ["Au", "Cu"]


@pytest.mark.parametrize("text", ["ior = 1.5", "n = 1.5", "ior =", 'ior = "Xx"', "ior = {gold = 3}"])
def test_a_file_that_says_something_else_is_refused(samples: list[NamedSample], text: str) -> None:
    samples[0].beside.write_text(text)
    with pytest.raises(ConfigError, match=r"gold\.ior\.toml"):
        TakenConstants.of(Constants(), samples)


def test_that_of_a_run_lies_in_its_folder(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "brdf.csv").write_text("x")
    run = [NamedSample(str(tmp_path / "run"), "plate")]
    TakenConstants.of(Constants.of(["Al"]), run).remember()
    assert (tmp_path / "run" / "brdf.ior.toml").is_file()
    assert TakenConstants.of(Constants(), run).values == ["Al"]
