"""Bad input ends with one clear message, the right exit code, and nothing left behind."""

from pathlib import Path

import pytest

from tests.command_line import says
from tests.system.conftest import LAMBERT, PLAN, Command

USAGE, DATA = 2, 1


def said(done: object) -> str:
    text = str(getattr(done, "stderr", ""))
    assert 1 <= len(text.strip().splitlines()) <= 12, text
    return text


def plan(old: str, new: str) -> tuple[str, str]:
    return "plan.toml", PLAN.replace(old, new)


def sample(old: str, new: str) -> tuple[str, str]:
    return "sample.toml", LAMBERT.replace(old, new)


ANGLES = "[-60, -40, 0, 20, 40, 70]"


@pytest.mark.parametrize(
    ("file", "words"),
    [
        (plan("theta_i_deg = [20, 50]", "theta_i_deg = [130]"), ["plan.toml", "theta_i_deg", "130"]),
        (plan("theta_i_deg", "theta_i_degs"), ["plan.toml", "theta_i_degs", "theta_i_deg"]),
        (plan("[550]", "[5500]"), ["wavelength_nm", "5500"]),
        (plan("[550]", "[]"), ["plan.toml", "wavelength_nm"]),
        (plan(ANGLES, "[]"), ["plan.toml", "theta_r_deg"]),
        (plan(ANGLES, "{ start = 0, stop = 10, step = 0 }"), ["plan.toml", "step"]),
        (plan(f"[20, 50]\ntheta_r_deg = {ANGLES}", "[20]\ntheta_r_deg = [-20]"), ["blocked"]),
        (("plan.toml", "this is not toml [["), ["plan.toml", "TOML"]),
        (("plan.toml", PLAN + '[[points]]\nfile = "absent.csv"\n'), ["absent.csv"]),
        (sample("albedo", "albdo"), ["sample.toml", "albdo", "albedo"]),
        (sample("0.5", "1.5"), ["sample.toml", "albedo", "1.5"]),
        (sample("lambert", "lambrt"), ["lambrt", "lambert"]),
        (sample("model =", "modle ="), ["sample.toml", "modle"]),
    ],
    ids=["angle", "key", "band", "no wavelength", "no angle", "step 0", "nothing reachable", "not toml", "points file",
         "parameter", "value", "model", "key of a sample"],
)  # fmt: skip
def test_bad_plan_or_sample(here: Command, files: Path, file: tuple[str, str], words: list[str]) -> None:
    name, text = file
    (files / name).write_text(text)
    run = here("measure", "plan.toml", "--rig", "sim", "--sample", "sample.toml", "--out", "run", expect=USAGE)
    says(said(run), *words)
    assert not (files / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("measure", "nope.toml", "--rig", "sim", "--sample", "sample.toml", "--out", "x"), USAGE, ["nope.toml"]),
        (("fit", "absent.csv", "--model", "lambert"), USAGE, ["absent.csv"]),
        (("fit", "columns.csv", "--model", "lambert"), DATA, ["columns.csv"]),
        (("fit", "good.csv", "--model", "lambrt"), USAGE, ["lambrt"]),
        (("fit", "good.csv", "--model", "lambert", "--fix", "albdo=1"), USAGE, ["albdo"]),
        (("compare", "columns.csv", "--models", "lambert", "--out", "x"), DATA, ["columns.csv"]),
        (("compare", "empty.csv", "--models", "lambert", "--out", "x"), DATA, ["empty.csv"]),
        (("compare", "junk.astm", "--models", "lambert", "--out", "x"), DATA, ["junk.astm"]),
        (("compare", "columns.csv", "--models", "nope", "--out", "x"), USAGE, ["nope"]),
        (("report", "absent", "--out", "x"), USAGE, ["absent"]),
        (("convert", "columns.csv", "x.xlsx"), DATA, ["columns.csv"]),
        (("convert", "columns.csv", "x"), USAGE, ["no format is written"]),
        (("rig", "show", "absent"), USAGE, ["absent"]),
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
    says(said(here(*arguments, expect=code)), *words)
    assert not (files / "x").exists()


@pytest.mark.slow
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
        text = " ".join(said(here(*command, expect=USAGE)).split())
        says(text, "my.toml", "[reference] offset_mm = [0, 15]", "480 rows", "nearer")
        assert not (files / "run").exists()
