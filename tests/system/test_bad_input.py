"""Bad input ends with one clear message, the right exit code, and nothing left behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.system.conftest import LAMBERT, PLAN, Command

USAGE, DATA = 2, 1


def said(done: object) -> str:
    text = str(getattr(done, "stderr", ""))
    assert 1 <= len(text.strip().splitlines()) <= 12, text
    return text


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        (PLAN.replace("theta_i_deg = [20, 50]", "theta_i_deg = [130]"), ["plan.toml", "theta_i_deg", "130"]),
        (PLAN.replace("theta_i_deg", "theta_i_degs"), ["plan.toml", "theta_i_degs", "theta_i_deg"]),
        (PLAN.replace("[550]", "[5500]"), ["wavelength_nm", "5500"]),
        (PLAN.replace("[550]", "[]"), ["plan.toml", "wavelength_nm"]),
        (PLAN.replace("theta_r_deg = [-60, -40, 0, 20, 40, 70]", "theta_r_deg = []"), ["plan.toml", "theta_r_deg"]),
        (PLAN.replace("[-60, -40, 0, 20, 40, 70]", "{ start = 0, stop = 10, step = 0 }"), ["plan.toml", "step"]),
        (
            PLAN.replace("[-60, -40, 0, 20, 40, 70]", "[-20]").replace("[20, 50]", "[20]"),
            ["blocked"],
        ),
        ("this is not toml [[", ["plan.toml", "TOML"]),
        (PLAN + '[[points]]\nfile = "absent.csv"\n', ["absent.csv"]),
    ],
    ids=["angle", "key", "band", "no wavelength", "no angle", "step 0", "nothing reachable", "not toml", "points file"],
)
def test_bad_plan(here: Command, files: Path, plan: str, words: list[str]) -> None:
    (files / "plan.toml").write_text(plan)
    text = said(here("measure", "plan.toml", "--rig", "sim", "--sample", "sample.toml", "--out", "run", expect=USAGE))
    for word in words:
        assert word in text
    assert not (files / "run").exists()


@pytest.mark.parametrize(
    ("sample", "words"),
    [
        (LAMBERT.replace("albedo", "albdo"), ["sample.toml", "albdo", "albedo"]),
        (LAMBERT.replace("0.5", "1.5"), ["sample.toml", "albedo", "1.5"]),
        (LAMBERT.replace("lambert", "lambrt"), ["lambrt", "lambert"]),
        (LAMBERT.replace("model =", "modle ="), ["sample.toml", "modle"]),
    ],
    ids=["parameter", "value", "model", "key"],
)
def test_bad_sample(here: Command, files: Path, sample: str, words: list[str]) -> None:
    (files / "sample.toml").write_text(sample)
    text = said(here("measure", "plan.toml", "--rig", "sim", "--sample", "sample.toml", "--out", "run", expect=USAGE))
    for word in words:
        assert word in text
    assert not (files / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("measure", "nope.toml", "--rig", "sim", "--sample", "sample.toml", "--out", "x"), USAGE, ["nope.toml"]),
        (("measure", "plan.toml", "--rig", "simm", "--sample", "sample.toml", "--out", "x"), USAGE, ["simm", "sim"]),
        (("measure", "plan.toml", "--rig", "no.toml", "--sample", "sample.toml", "--out", "x"), USAGE, ["no.toml"]),
        (("measure", "plan.toml", "--rig", "sim", "--sample", "sample.toml", "--out", "/proc/no/x"), USAGE, ["/proc"]),
        (("measure", "plan.toml", "--rig", "sim", "--out", "x"), USAGE, ["sample"]),
        (("reduce", "absent"), USAGE, ["absent"]),
        (("fit", "absent.csv", "--model", "lambert"), USAGE, ["absent.csv"]),
        (("fit", "columns.csv", "--model", "lambert"), DATA, ["columns.csv"]),
        (("fit", "good.csv", "--model", "lambrt"), USAGE, ["lambrt"]),
        (("fit", "good.csv", "--model", "lambert", "--fix", "albdo=1"), USAGE, ["albdo"]),
        (("compare", "columns.csv", "--models", "lambert", "--out", "x"), DATA, ["columns.csv"]),
        (("compare", "empty.csv", "--models", "lambert", "--out", "x"), DATA, ["empty.csv"]),
        (("compare", "junk.astm", "--models", "lambert", "--out", "x"), DATA, ["junk.astm"]),
        (("compare", "columns.csv", "--models", "nope", "--out", "x"), USAGE, ["nope"]),
        (("report", "absent", "--out", "x"), USAGE, ["absent"]),
        (("convert", "columns.csv", "x"), DATA, ["columns.csv"]),
        (("plan", "show", "absent.toml"), USAGE, ["absent.toml"]),
        (("rig", "show", "absent"), USAGE, ["absent"]),
        (("nonsense",), USAGE, ["nonsense"]),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, tuple) else None,
)
def test_bad_argument(here: Command, files: Path, arguments: tuple[str, ...], code: int, words: list[str]) -> None:
    (files / "columns.csv").write_text("a,b,c\n1,2,3\n")
    (files / "empty.csv").write_text("")
    (files / "junk.astm").write_bytes(bytes(range(256)) * 12)
    (files / "good.csv").write_text(
        "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,wavelength_nm,polarisation,brdf,u_brdf,u_random,flag\n"
        "30,0,10,180,550,unpolarised,0.15,0.001,0.001,\n30,0,20,180,550,unpolarised,0.15,0.001,0.001,\n"
    )
    text = said(here(*arguments, expect=code))
    for word in words:
        assert word in text
    assert not (files / "x").exists()


def test_a_terminal_that_knows_no_plus_minus_shows_something_else(
    gonio: Command, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = "".join(
        f"30,0,{theta},180,550,unpolarised,{0.15 + theta / 1e4},0.001,0.001,\n" for theta in range(10, 60, 10)
    )
    (files / "good.csv").write_text(
        "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,wavelength_nm,polarisation,brdf,u_brdf,u_random,flag\n" + rows
    )
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    assert "albedo" in gonio("fit", "good.csv", "--model", "lambert").stdout


def test_a_reference_outside_the_frame_is_found_by_every_command(here: Command, files: Path) -> None:
    """The frame of the shipped rig is 29 mm wide and 22 mm high."""
    shipped = here("rig", "show", "sim").stdout
    beside = shipped.replace('how = "swap"', 'how = "beside"\noffset_mm = [0.0, 15.0]', 1)
    (files / "my.toml").write_text(beside)
    measure = ("measure", "plan.toml", "--rig", "my.toml", "--sample", "sample.toml", "--out", "run")
    for command in (("plan", "show", "plan.toml", "--rig", "my.toml"), (*measure, "--dry-run"), measure):
        text = said(here(*command, expect=USAGE))
        for word in ("my.toml", "[reference] offset_mm = [0, 15]", "480 rows", "nearer"):
            assert word in " ".join(text.split())
        assert not (files / "run").exists()
