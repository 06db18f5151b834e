"""The tour's "Calibrate", word for word: its commands and files find what is true of the bench and hidden."""

import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_sim.rig import SIM_UNCALIBRATED

from gonio.config import numbers_in, read_toml
from gonio.measurement import read
from tests.command_line import gonio, says
from tests.places import ROOT

pytestmark = pytest.mark.slow

TRUTH: dict[str, Any] = tomllib.loads(
    (ROOT / "sim" / "gonio_sim" / "rigs" / "sim-uncalibrated.truth.toml").read_text(encoding="utf-8")
)
FILED = tomllib.loads(SIM_UNCALIBRATED.toml)
APART = ("camera.full_well_e",)
"""What has a test of its own (tests/gonio/lab/calibration/test_camera.py): it is no mean of independent readings."""


def blocks() -> list[tuple[str, str]]:
    """The fenced blocks of the section, in order: language and text."""
    text = (ROOT / "docs" / "tour.md").read_text(encoding="utf-8")
    section = text.split("\n## Calibrate\n")[1].split("\n## ")[0]
    return [(language, body) for language, body in re.findall(r"```(\w*)\n(.*?)```", section, re.S)]


def write_files(folder: Path) -> str:
    """Write the files that the section shows; the table that belongs into the rig file comes back."""
    table = ""
    for language, body in blocks():
        if language == "toml" and body.startswith("# in my-rig.toml"):
            table = body
        elif language == "toml":
            (folder / body.split("\n")[0].removeprefix("# ")).write_text(body, encoding="utf-8")
    return table


def follow(folder: Path) -> dict[str, str]:
    """Run the section's commands in order; what each has said, by its first words."""
    table, said = write_files(folder), {}
    files = tomllib.loads(table)["calibration"]["files"]
    for line in (one for language, body in blocks() if not language for one in body.splitlines() if one.strip()):
        words = shlex.split(line, comments=True)
        assert words[0] == "gonio"
        into = words[words.index(">") + 1] if ">" in words else ""
        words = words[1 : words.index(">")] if into else words[1:]
        done = gonio(folder, *words, expect=0)
        said[" ".join(words[:2])] = done.stdout + done.stderr
        if into:
            (folder / into).write_text(done.stdout, encoding="utf-8")
        if words[0] == "calibrate":
            there = [name for name in files if (folder / name).exists()]
            bare = (folder / "my-rig.toml").read_text(encoding="utf-8").split("\n# in my-rig.toml")[0]
            short = re.sub(r"files = \[.*\]", f"files = {there}".replace("'", '"'), table)
            (folder / "my-rig.toml").write_text(f"{bare}\n{short}", encoding="utf-8")
    assert there == files
    return said


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    folder = tmp_path_factory.mktemp("recipe")
    return folder, follow(folder)


def true_of(path: str) -> float:
    """What is true of a number of the rig file; harmonics by their order, which is their place in what is found."""
    harmonic = re.fullmatch(r"arms\.(\w+)\.harmonics_deg\[(\d)\]\[(\d)\]", path)
    if harmonic:
        rows = {row[0]: row for row in TRUTH["arms"][harmonic[1]]["harmonics_deg"]}
        return float(rows.get(int(harmonic[2]) + 1, [0, 0.0, 0.0])[int(harmonic[3])])
    return float(numbers_in(TRUTH).get(path, numbers_in(FILED).get(path, 0.0)))


def test_what_is_found_is_what_is_true(followed: tuple[Path, dict[str, str]]) -> None:
    folder, _ = followed
    pulls = {}
    for kind in ("geometry", "camera", "light"):
        file = read_toml(folder / f"{kind}.toml")
        values, known = numbers_in(file["values"]), file["uncertainty"]
        for path, u in zip(known["parameters"], known["u"], strict=True):
            if path not in APART:
                pulls[path] = (values[path] - true_of(path)) / u
    for arm in ("light", "camera"):
        assert f"arms.{arm}.zero_offset_deg" in pulls
    # some fifty numbers of one seed: 3.5 standard deviations, and a mean square of 1 within 0.2 and a half
    assert {path: pull for path, pull in pulls.items() if abs(pull) > 3.5} == {}
    assert np.mean(np.square(list(pulls.values()))) < 1.5
    zeros = read_toml(folder / "geometry.toml")["uncertainty"]
    u = dict(zip(zeros["parameters"], zeros["u"], strict=True))
    # encoder steps of 0.088 deg, that is 0.025 deg a pose, and zero and cosine look alike
    assert max(u[f"arms.{arm}.zero_offset_deg"] for arm in ("light", "camera")) < 0.03


def test_a_gain_that_is_wrong_is_said_before_anything_rests_on_it(followed: tuple[Path, dict[str, str]]) -> None:
    said = " ".join(followed[1]["calibrate geometry"].split())
    says(
        said,
        "WARNING: a quick look at the camera contradicts the rig file",
        "camera.electrons_per_dn = 2.7",
        "camera.black_level_dn = 64",
        "charge clips at",
    )
    gain = float(re.search(r"a DN is ([\d.]+) electrons", said)[1])  # type: ignore[index]
    # some thousand pixels in ten pairs, and a camera that is not linear by 0.8 %: the quick look says 3 %
    assert gain == pytest.approx(TRUTH["camera"]["electrons_per_dn"], rel=0.03)


def test_the_white_as_a_sample_is_white(followed: tuple[Path, dict[str, str]]) -> None:
    assert "No sign that the two disagree" in followed[1]["compare white"]
    table = read(followed[0] / "white" / "brdf.csv")
    table = table[table["flag"] == ""]
    pulls = ((table["brdf"] - 0.99 / np.pi) / table["u_brdf"]).to_numpy()
    assert len(pulls) > 35
    assert np.abs(pulls).max() < 3.5  # of some forty
    assert np.mean(pulls**2) < 1.6  # 1 and half of it: part of each is common to all
    assert (table["u_brdf"] / table["brdf"]).median() < 0.005  # a certificate of 0.2 %, and 0.4 % of the lamp's noise
