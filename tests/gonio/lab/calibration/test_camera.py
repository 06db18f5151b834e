"""`gonio calibrate camera` on a simulated bench whose camera is not what the rig file says, and on bad frames."""

import csv
import math
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from gonio_sim.rig import SIM

from gonio.config import read_toml
from gonio.lab.commands import calibrate_camera
from gonio.lab.rig.dng import read_raw, write_dng
from gonio.measurement import read
from tests.command_line import gonio

TRUTH: dict[str, Any] = {
    "electrons_per_dn": 3.3,
    "read_noise_e": 5.0,
    "nonlinearity": [-0.012, 0.004],
    "stray_light": 0.02,
    "stray_halo": 0.012,
    "stray_halo_px": 12.0,
    "hot_pixels": 0.002,
    "hot_pixel_e_per_s": 400.0,
    "dark_current_e_per_s": 7.0,
    "prnu": 0.01,
    "dsnu_e": 4.0,
    "full_well_e": 11500.0,
    "vignetting": 0.3,
}
SAMPLE = 'name = "grey"\nmodel = "lambert"\n[parameters]\nalbedo = 0.18\n'
PLAN = 'name = "p"\nwavelength_nm = [550]\n[[sweep]]\ntheta_i_deg = [20]\ntheta_r_deg = [-50, 5, 45]\n'


def small(toml: str) -> str:
    """A rig file with a sensor of fewer and larger pixels, which sees the same field."""
    toml = re.sub(r"(?m)^width = .*$", "width = 160", toml)
    toml = re.sub(r"(?m)^height = .*$", "height = 120", toml)
    return re.sub(r"(?m)^pixel_um = .*$", "pixel_um = 20.0", toml)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a rig, its truth, and `camera.toml` as the command makes it of them."""
    folder = tmp_path_factory.mktemp("camera")
    lines = [f"{key} = {value}" for key, value in TRUTH.items()]
    (folder / "truth.toml").write_text("[camera]\n" + "\n".join(lines) + "\n")
    (folder / "rig.toml").write_text('truth = "truth.toml"\n' + small(SIM.toml))
    gonio(
        folder, "calibrate", "camera", "--rig", "rig.toml", "--out", "camera.toml", "--pairs", "3", "--seed", "4",
        expect=0,
    )  # fmt: skip
    return folder


def test_the_truth_of_the_camera_is_found(bench: Path) -> None:
    file = read_toml(bench / "camera.toml")
    known, values = file["uncertainty"], file["values"]["camera"]
    u = dict(zip(known["parameters"], known["u"], strict=True))
    names = ("electrons_per_dn", "read_noise_e", "dark_current_e_per_s", "dsnu_e", "prnu", "stray_light", "stray_halo")
    for name in (*names, "vignetting"):
        # eight numbers and a fixed seed: 4 u
        assert values[name] == pytest.approx(TRUTH[name], abs=4 * u[f"camera.{name}"]), name
    assert u["camera.electrons_per_dn"] < 0.01 * 3.3
    assert u["camera.read_noise_e"] < 0.05 * 5.0
    s = np.array([0.3, 0.6, 0.8])
    found, true = (
        np.polynomial.polynomial.polyval(s, [0, *c]) for c in (values["nonlinearity"], TRUTH["nonlinearity"])
    )
    assert np.abs(found - true).max() < 2.5e-3  # 19 200 pixels; a sensor of 640 x 480 comes to 5e-4
    # gain and the numbers that are made with it go together
    at = known["parameters"].index("camera.electrons_per_dn"), known["parameters"].index("camera.read_noise_e")
    assert known["correlation"][at[0]][at[1]] > 0.3
    assert (bench / "camera-maps.npz").exists()
    assert (bench / "camera.png").exists()
    assert file["measured"]["defects"] >= 20  # 38 of 19 200 are hot, some of them hardly


@pytest.mark.slow
def test_frames_that_were_kept_give_the_same_file(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gonio(
        bench, "calibrate", "camera", "--rig", "rig.toml", "--frames", "camera-frames", "--out", "again.toml", expect=0
    )
    first, again = (read_toml(bench / name) for name in ("camera.toml", "again.toml"))
    for file, maps in ((first, "camera-maps.npz"), (again, "again-maps.npz")):
        assert file["values"]["camera"].pop("maps") == maps
    assert first == again
    monkeypatch.setattr(calibrate_camera, "draw", lambda *given: 1 / 0)
    said = gonio(
        bench, "calibrate", "camera", "--rig", "rig.toml", "--frames", "camera-frames", "--out", "lost.toml", expect=1
    ).stderr
    assert "the picture lost.png" in said
    assert read_toml(bench / "lost.toml")["uncertainty"] == first["uncertainty"]


def test_a_calibrated_run_states_the_causes_and_stands_alone(bench: Path, tmp_path: Path) -> None:
    rig = small(SIM.toml) + '\n[calibration]\nfiles = ["camera.toml"]\n'
    (bench / "calibrated.toml").write_text('truth = "truth.toml"\n' + rig)
    (bench / "s.toml").write_text(SAMPLE)
    (bench / "p.toml").write_text(PLAN)
    done = gonio(
        bench, "measure", "p.toml", "--rig", "calibrated.toml", "--sample", "s.toml", "--out", "alone", "--yes",
        expect=0,
    )  # fmt: skip
    shutil.copytree(bench / "alone", tmp_path / "run")
    done = gonio(tmp_path, "reduce", "run", expect=0)
    table = read(tmp_path / "run" / "brdf.csv")
    for cause in ("s_linearity", "s_stray_light"):
        assert (table[cause] != 0).all()
    maps = tmp_path / "run" / "camera_maps.npz"
    assert maps.read_bytes() == (bench / "camera-maps.npz").read_bytes()
    maps.write_bytes(b"no maps")
    done = gonio(tmp_path, "reduce", "run", expect=1)
    assert "camera_maps.npz: was changed after it was written" in " ".join(done.stderr.split())


Rows = list[dict[str, str]]


def without(kind: str) -> Callable[[Rows], Rows]:
    return lambda rows: [row for row in rows if row["kind"] != kind]


def changed(number: int, **columns: str) -> Callable[[Rows], Rows]:
    return lambda rows: [row | columns if k == number else row for k, row in enumerate(rows)]


def brightest(rows: Rows) -> Rows:
    return [row for row in rows if row["kind"] != "flat" or float(row["exposure_s"]) > 0.31]


def one_level(rows: Rows) -> Rows:
    first = next(row["exposure_s"] for row in rows if row["kind"] == "flat")
    return [row for row in rows if row["kind"] != "flat"] + [r for r in rows if r["exposure_s"] == first] * 4


def single(rows: Rows) -> Rows:
    first = {row["exposure_s"]: row for row in reversed(rows) if row["kind"] == "flat"}
    return [row for row in rows if row["kind"] != "flat"] + list(first.values())


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (without("dark"), 1, "there are 0 dark frames"),
        (without("flat"), 1, "there are 0 flat frames"),
        (brightest, 1, "full"),
        (one_level, 1, "flats of one level tell no line"),
        (single, 1, "two frames and more at each exposure"),
        (changed(40, exposure_s="0"), 1, "its exposure is 0 s"),
        (changed(40, exposure_s="0.05"), 1, "itself says"),
        (changed(40, asked_s="0.0001"), 1, "the camera does not do what it is told"),
        (changed(40, kind="sky"), 2, "line 42: needs file and kind"),
        (changed(40, file="nowhere.dng"), 2, "there is no file"),
        (changed(0, black_px="1,2"), 2, "write top:bottom,left:right"),
    ],
)
def test_bad_frames_are_refused_with_the_reason(
    bench: Path, tmp_path: Path, change: Callable[[Rows], Rows], code: int, words: str
) -> None:
    with (bench / "camera-frames" / "frames.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    folder = tmp_path / "frames"
    folder.mkdir()
    for file in (bench / "camera-frames").glob("*.dng"):
        (folder / file.name).symlink_to(file)
    with (folder / "frames.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0].keys())
        writer.writeheader()
        writer.writerows(change(rows))
    done = gonio(
        tmp_path, "calibrate", "camera", "--rig", bench / "rig.toml", "--frames", "frames", "--out", "bad.toml"
    )
    assert words in done.stderr
    assert done.returncode == code
    assert not list(tmp_path.glob("bad*"))


def copied(bench: Path, folder: Path, change: Callable[[str, npt.NDArray[np.uint16]], npt.NDArray[np.uint16]]) -> None:
    """The frames of `bench` with other pixels; those that stay as they are, are links."""
    folder.mkdir()
    shutil.copy(bench / "camera-frames" / "frames.csv", folder)
    for file in sorted((bench / "camera-frames").glob("*.dng")):
        frame = read_raw(file)
        mosaic = change(file.name, frame.mosaic)
        if mosaic is frame.mosaic:
            (folder / file.name).symlink_to(file)
        else:
            write_dng(replace(frame, mosaic=mosaic, file=None), folder / file.name)


def test_frames_of_another_camera_are_refused(bench: Path, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(SIM.toml)
    done = gonio(
        tmp_path, "calibrate", "camera", "--rig", "rig.toml", "--frames", bench / "camera-frames", "--out",
        "bad.toml", expect=1,
    )  # fmt: skip
    assert "160 x 120 pixels; the rig file says camera.width = 640" in done.stderr
    assert not list(tmp_path.glob("bad*"))


def test_black_that_is_cut_off_is_refused(bench: Path, tmp_path: Path) -> None:
    def cut(name: str, mosaic: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
        return mosaic - np.minimum(mosaic, 63).astype(np.uint16)

    copied(bench, tmp_path / "frames", cut)
    done = gonio(
        tmp_path, "calibrate", "camera", "--rig", bench / "rig.toml", "--frames", "frames", "--out", "bad.toml",
        expect=1,
    )  # fmt: skip
    assert "raise the camera's black level" in done.stderr


def darkened(bench: Path, folder: Path, count: int) -> Path:
    """The frames of `bench`, of which the first of `count` pairs of flats are darker."""
    taken: list[str] = []

    def darker(name: str, mosaic: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
        # the first of a pair: flats follow the 32 dark frames in twos
        if name.startswith("flat") and int(name[5:9]) % 2 == 0 and len(taken) < count:
            taken.append(name)
            return (0.8 * mosaic).astype(np.uint16)
        return mosaic

    copied(bench, folder, darker)
    return folder


def test_many_pairs_that_differ_are_refused(bench: Path, tmp_path: Path) -> None:
    folder = darkened(bench, tmp_path / "all", 400)
    done = gonio(
        tmp_path, "calibrate", "camera", "--rig", bench / "rig.toml", "--frames", folder, "--out", "bad.toml", expect=1
    )
    assert "the lamp drifts or flickers more than lamp.noise says" in " ".join(done.stderr.split())
    assert not list(tmp_path.glob("bad*"))


def test_a_response_is_refused_before_frames_are_taken_of_a_camera_that_has_none(tmp_path: Path) -> None:
    words = ("calibrate", "camera", "--rig", "sim", "--response", "--out", "camera.toml", "--yes")
    assert "camera.bits = 12: a response curve is for cameras of 8 bits" in gonio(tmp_path, *words, expect=2).stderr
    assert not list(tmp_path.iterdir())


def test_response_of_a_video_camera_goes_through_a_run(tmp_path: Path) -> None:
    """A gamma of 2.2: the bracket gives the curve, and a run with it gives the sample's BRDF."""
    gamma = (255.0 * (np.arange(256) / 255.0) ** 2.2).tolist()
    gamma[-1] = 255.0
    rig = re.sub(r"(?m)^bits = .*$", "bits = 8", small(SIM.toml))
    rig = re.sub(r"(?m)^black_level_dn = .*$", "black_level_dn = 4.0", rig)
    rig = re.sub(r"(?m)^electrons_per_dn = .*$", "electrons_per_dn = 43.0", rig)
    (tmp_path / "truth.toml").write_text(f"[camera]\nresponse = {gamma}\n")
    (tmp_path / "rig.toml").write_text('truth = "truth.toml"\n' + rig)
    light = np.exp(np.random.default_rng(5).uniform(-3.0, 0.5, (120, 160)))
    folder = tmp_path / "bracket"
    folder.mkdir()
    rows = ["file,kind,exposure_s"]
    for k, t in enumerate(np.geomspace(0.02, 4.0, 16)):
        values = np.interp(255.0 * np.minimum(light * t, 1.0), gamma, np.arange(256.0))
        cv2.imwrite(str(folder / f"{k}.png"), np.rint(values).astype(np.uint8))
        rows.append(f"{k}.png,flat,{float(t)!r}")
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
    here = partial(gonio, tmp_path, expect=0)
    here("calibrate", "camera", "--rig", "rig.toml", "--frames", "bracket", "--response", "--out", "camera.toml")
    (tmp_path / "with.toml").write_text('truth = "truth.toml"\n' + rig + '\n[calibration]\nfiles = ["camera.toml"]\n')
    (tmp_path / "s.toml").write_text(SAMPLE)
    (tmp_path / "p.toml").write_text(PLAN)
    for name in ("rig", "with"):
        here("measure", "p.toml", "--rig", f"{name}.toml", "--sample", "s.toml", "--out", name, "--yes")
        here("reduce", name)
    bent, straight = (read(tmp_path / name / "brdf.csv") for name in ("rig", "with"))
    away = [np.abs(t["brdf"].to_numpy() * math.pi / 0.18 - 1.0).max() for t in (bent, straight)]
    assert away[0] > 0.03
    assert away[1] < 0.02  # steps of 8 bits, and the reference's own error of 0.2 %
    assert any("taken for linear" in note for note in bent.attrs["notes"])
    assert not any("taken for linear" in note for note in straight.attrs["notes"])


def test_a_trap_that_is_none_is_refused(bench: Path, tmp_path: Path) -> None:
    shutil.copytree(bench / "camera-frames", tmp_path / "frames")
    rows = list(csv.DictReader((tmp_path / "frames" / "frames.csv").read_text().splitlines()))
    flat = next(row for row in rows if row["kind"] == "flat" and float(row["exposure_s"]) > 0.05)
    for row in rows:
        if row["kind"] == "trap":  # somebody left the white in the holder
            shutil.copy(tmp_path / "frames" / flat["file"], tmp_path / "frames" / row["file"])
            row["exposure_s"] = flat["exposure_s"]
    with (tmp_path / "frames" / "frames.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0])
        writer.writeheader()
        writer.writerows(row for row in rows if row["kind"] != "edge")
    done = gonio(tmp_path, "calibrate", "camera", "--rig", str(bench / "rig.toml"), "--frames", "frames")
    assert (done.returncode, (tmp_path / "camera.toml").exists()) == (1, False)
    assert "did a black trap lie in the holder" in done.stderr


def test_a_rig_that_turns_its_reference_into_the_beam_does_so() -> None:
    """Nobody is asked to put it into the holder, where it would not be what the flats show."""
    bench = MagicMock(spec=["description", "lamp", "present", "rig"])
    bench.rig = bench
    bench.description.reference.how = "axis"
    calibrate_camera.put(bench, "reference", yes=False)
    for what in ("trap", "edge"):
        calibrate_camera.put(bench, what, yes=True)
    assert [call.args for call in bench.present.call_args_list] == [("reference",), ("sample",), ("reference",)]


def test_a_list_of_frames_that_is_no_text_is_named(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    (tmp_path / "rig.toml").write_text(small(SIM.toml))
    (tmp_path / "frames" / "frames.csv").write_bytes(b"\xff\xfe\x00")
    done = gonio(tmp_path, "calibrate", "camera", "--rig", "rig.toml", "--frames", "frames", expect=2)
    assert "frames.csv: is no table of text" in done.stderr
