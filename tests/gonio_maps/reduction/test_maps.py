"""`gonio reduce RUN --map`: a simulated plate whose BRDF is known, seen pixel by pixel."""

import math
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_maps.files import MapFile, Parts, Tile
from gonio_maps.reduction.map_planes import Planes

from gonio.geometry import ANGLES_DEG
from gonio.lab.acquisition.run import Run
from gonio.lab.rig.kinematics import view
from gonio.measurement import read
from tests.command_line import gonio, says
from tests.system.conftest import environment

pytest.importorskip("h5netcdf")
ALBEDO = 0.6
SAMPLE = f'name = "matt"\nmodel = "lambert"\n[parameters]\nalbedo = {ALBEDO}\n'
PLAN = """name = "some"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [30]
theta_r_deg = [-50, 15, 60]
[[sweep]]
theta_i_deg = [40]
theta_r_deg = [45]
dphi_deg = [60, 120]
"""
SMALLER = (
    ("width = 640", "width = 160"), ("height = 480", "height = 120"), ("pixel_um = 5.0", "pixel_um = 20.0"),
    ("dark_frames = 8", "dark_frames = 4"), ("frames = 16 ", "frames = 4 "),
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a small camera, with its map."""
    out = tmp_path_factory.mktemp("maps")
    rig = gonio(out, "rig", "show", "sim", expect=0).stdout
    for known, smaller in SMALLER:
        assert known in rig
        rig = rig.replace(known, smaller)
    for name, text in (("rig.toml", rig), ("plan.toml", PLAN), ("sample.toml", SAMPLE)):
        (out / name).write_text(text, encoding="utf-8")
    measured = ("--rig", "rig.toml", "--sample", "sample.toml", "--seed", "3", "--yes", "--out", "run")
    gonio(out, "measure", "plan.toml", *measured, expect=0)
    says(gonio(out, "reduce", "run", "--map", "map.h5", expect=0).stdout, "111 x 111 pixels of 0.18 mm, 5 points")
    return out


def test_every_pixel_has_the_samples_brdf_within_its_uncertainty(folder: Path) -> None:
    """Pulls by each value's own noise, and the mean of the table's region."""
    table = read(folder / "run" / "brdf.csv")
    with MapFile(folder / "map.h5") as found:
        x, y = np.meshgrid(found.x_mm, found.y_mm)
        value, u = found.values(Tile(slice(0, found.shape[0]), slice(0, found.shape[1])))
        shared = found.array("u_point")
    region = np.hypot(x, y) < 0.8
    for k, (brdf, u_brdf) in enumerate(table[["brdf", "u_brdf"]].to_numpy(dtype=float)):
        good = np.isfinite(value[..., k])
        # outside of the disc of 10 mm nothing is good; inside 95 % of its radius everything is: a pixel is at most
        # 0.36 mm wide here, and the lens's blur at the edge 0.16 mm
        assert not good[np.hypot(x, y) > 10.0].any()
        assert good[np.hypot(x, y) < 9.2].all()
        own = np.sqrt(u[..., k] ** 2 - (value[..., k] * shared[k]) ** 2)[good]
        pulls = (value[..., k][good] - value[..., k][good].mean()) / own
        # 9000 values of which each shares pixels with its neighbours, about 2000 independent ones: 1.00 +- 0.016;
        # six of these deviations, within what is asked for
        assert 0.9 < float(np.std(pulls)) < 1.1
        assert np.abs(pulls).max() < 6.0  # of 9000 normal numbers none lies beyond 6 (2e-5)
        # all pixels together: what they share, with the reference's certificate (0.2 %) and the drift; 4 u
        assert abs(value[..., k][good].mean() / (ALBEDO / math.pi) - 1.0) < 4.0 * u_brdf / brdf
        # 60 cells of 0.6 % noise that is theirs: the table's region has other weights at its rim; 4 of 0.1 %
        assert abs(value[..., k][region].mean() / brdf - 1.0) < 0.004


def test_directions_are_each_pixels_own(folder: Path) -> None:
    """Lamp and camera of the arms' angles, from the spot: written out with the distances of the rig, 1000 mm."""
    table = read(folder / "run" / "brdf.csv")
    with MapFile(folder / "map.h5") as found:
        row, col = 20, 70
        spot = np.array([found.x_mm[col], found.y_mm[row], 0.0])
        of_pixel = found.table(row, col)
    angles = [each[list(ANGLES_DEG)].to_numpy(dtype=float) for each in (table, of_pixel)]
    for centre, here in zip(*angles, strict=True):
        for k in (0, 2):
            (theta, phi), (own_theta, own_phi) = centre[k : k + 2], here[k : k + 2]
            t, p = math.radians(theta), math.radians(phi)
            toward = 1000.0 * np.array([math.sin(t) * math.cos(p), math.sin(t) * math.sin(p), math.cos(t)]) - spot
            # tables keep nine decimals of a degree
            assert own_theta == pytest.approx(math.degrees(math.acos(toward[2] / np.linalg.norm(toward))), abs=1e-7)
            assert own_phi % 360 == pytest.approx(math.degrees(math.atan2(toward[1], toward[0])) % 360, abs=1e-6)


def test_xarray_opens_it(folder: Path) -> None:
    import xarray

    with xarray.open_dataset(folder / "map.h5", engine="h5netcdf") as found:
        assert (found["brdf"].dims, found["brdf"].attrs["units"]) == (("y", "x", "point"), "sr-1")
        assert found["flag"].attrs["flag_meanings"].split()[0] == "outside"
        assert {"s_reference", "s_theta_i_zero"} <= set(found.data_vars)
        # certificate of 0.2 %, the same for every pixel and point
        np.testing.assert_allclose(found["s_reference"], 0.002, rtol=1e-6)
        assert np.isnan(found["u_shift_mm"]).all()  # a sample without texture tells no shift


KILLED = """
import os, signal, sys
from gonio.cli import main
from gonio_maps.reduction.map_planes import Planes
from gonio.lab.acquisition.run import Run
from gonio_maps.files import Parts

where, left = sys.argv.pop(1), [int(sys.argv.pop(1))]
owner, name = {"picture": (Planes, "make"), "tile": (Parts, "write")}[where]
work = getattr(owner, name)

def counted(*arguments):
    left[0] -= 1
    if left[0] < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return work(*arguments)

setattr(owner, name, counted)
main()
"""
"""The command `gonio`, which is killed as soon as it begins a picture, or a tile, after some of them."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_what_was_killed_goes_on_and_ends_the_same(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for where, after in (("picture", 3), ("tile", 2)):
        killed = subprocess.run(
            [sys.executable, "-c", KILLED, where, str(after), "reduce", "run", "--map", "again.h5"],
            cwd=folder, env=environment(), stdin=subprocess.DEVNULL, capture_output=True, check=False,
        )  # fmt: skip
        assert killed.returncode == -signal.SIGKILL, killed.stderr
    done = [path.name.partition("-")[0] for path in (folder / "again.h5.parts").glob("*-*.np?")]
    assert done.count("plane") == 5  # all pictures
    made: list[str] = []
    write = Parts.write
    monkeypatch.setattr(Planes, "make", lambda self, point: made.append("picture"))

    def counted(parts: Parts, tile: Tile, arrays: dict[str, Any]) -> None:
        made.append(tile.name)
        write(parts, tile, arrays)

    monkeypatch.setattr(Parts, "write", counted)
    gonio(folder, "reduce", "run", "--map", "again.h5", expect=0)
    assert len(made) == 4 - (len(done) - 5)  # of the four tiles those that were missing, and no picture
    assert (folder / "again.h5").read_bytes() == (folder / "map.h5").read_bytes()
    assert not (folder / "again.h5.parts").exists()


def test_coarse_cells_are_means_of_many_pixels(folder: Path) -> None:
    """A cell of 1 mm holds 30 pixels of 0.18 mm at normal view: the noise of each value falls accordingly."""
    gonio(folder, "reduce", "run", "--map", "coarse.h5", "--pixel-mm", "1", expect=0)
    with MapFile(folder / "coarse.h5") as found, MapFile(folder / "map.h5") as fine:
        assert found.shape == (21, 21)
        value_of_cells, u_of_cells = found.values(Tile(slice(0, 21), slice(0, 21)))
        relative = found.array("u_point")
        own = []
        for each in (found, fine):
            middle = each.shape[0] // 2
            value, u = (v[0, 0] for v in each.values(Tile(slice(middle, middle + 1), slice(middle, middle + 1))))
            own.append(np.sqrt(u**2 - (value * each.array("u_point")) ** 2) / value)
    step = next(step for step in Run.open(folder / "run").steps() if step.point == 1)
    electrons = sum(frame.exposure_s for frame in step.frames) * 40_000.0 * ALBEDO * math.cos(math.radians(30.0))
    single = math.sqrt(1.0 / electrons + 0.005**2)  # photons, and the pixels' responsivities; read noise is 1e-3 of it
    # at theta_r = 15 deg 29.9 pixels lie in a cell on average: 5 or 6 rows of as many columns
    assert 0.98 * single / 6.0 < own[0][1] < 1.02 * single / 5.0
    for k in range(value_of_cells.shape[2]):
        good = np.isfinite(value_of_cells[..., k])
        shared = value_of_cells[..., k] * relative[k]
        pulls = value_of_cells[..., k][good] / np.mean(value_of_cells[..., k][good]) - 1.0
        pulls *= value_of_cells[..., k][good] / np.sqrt(u_of_cells[..., k] ** 2 - shared**2)[good]
        assert 0.85 < float(np.std(pulls)) < 1.15  # 270 independent means: 1.00 +- 0.043
    # the camera's own cells lie between four pixels: at least the mean of all four, at most one alone
    assert 0.98 * single / 2.0 < own[1][1] < 1.02 * single


SPECKLED = """name = "speckled"
model = "lambert"
[parameters]
albedo = 0.5
[texture.albedo]
pattern = "speckle"
low = 0.3
high = 0.7
size_mm = [12.0, 12.0]
"""
POINTING_DEG = (0.015, -0.008)


@pytest.mark.slow
def test_pictures_that_lie_beside_are_found(folder: Path, tmp_path: Path) -> None:
    """A camera that points 0.015 deg aside, which nobody knows: 0.26 mm, stretched and turned from point to point."""
    rig = (folder / "rig.toml").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(rig.replace("\nname =", '\ntruth = "truth.toml"\nname =', 1), encoding="utf-8")
    (tmp_path / "truth.toml").write_text(f"[camera]\npointing_deg = {list(POINTING_DEG)}\n", encoding="utf-8")
    for name, text in (("plan.toml", PLAN), ("sample.toml", SPECKLED)):
        (tmp_path / name).write_text(text, encoding="utf-8")
    measured = ("--rig", "rig.toml", "--sample", "sample.toml", "--seed", "3", "--yes", "--out", "run")
    gonio(tmp_path, "measure", "plan.toml", *measured, expect=0)
    says(gonio(tmp_path, "reduce", "run", "--map", "map.h5", expect=0).stdout, "the shifts of 5 points are told")
    with MapFile(tmp_path / "map.h5") as found:
        shift, u, eyes = (found.array(name) for name in ("shift_mm", "u_shift_mm", "camera_mm"))
    truth = []
    steps = [step for step in Run.open(tmp_path / "run").steps() if step.kind == "point"]
    for step, eye in zip(steps, eyes, strict=True):
        # the middle pixel looks along the axis, which is turned toward growing columns and rows: 1000 mm away it sees
        # a spot that lies aside by the tangents, and geometry takes it for the centre
        seen = view(Run.open(tmp_path / "run").description, step.pose)
        across = sum(
            math.tan(math.radians(a)) * axis for a, axis in zip(POINTING_DEG, (seen.image_x, seen.image_y), strict=True)
        )
        line = -eye / np.linalg.norm(eye) + across
        truth.append(-(eye - line * (eye[2] / line[2]))[:2])
    wanted = np.array(truth) - np.mean(truth, axis=0)  # where the sample's frame lies nobody can tell
    # the largest is 0.17 mm, a pixel 0.18 mm; what is found has standard uncertainties of about 0.01 pixel; five
    # points make the mean itself out of noise, so that 6 u of each are allowed, and 0.003 mm where u is tiny
    assert np.abs(wanted).max() > 0.1
    assert (np.abs(shift - wanted) < np.maximum(6.0 * u, 0.003)).all()
    assert u.max() < 0.3 * 0.18  # errors of 0.3 pixel are found


OTHER = (
    ('pattern = "mono"', 'pattern = "RGGB"\nnonlinearity = [0.01]\nstray_light = 0.01\nstray_halo = 0.02\n'
     "stray_halo_px = 20.0\nhot_pixels = 0.002\nhot_pixel_e_per_s = 20000.0"),
    ("tunable = { start_nm = 400.0, stop_nm = 700.0, step_nm = 10.0, fwhm_nm = 10.0 }",
     'list = [{ name = "green", centre_nm = 550, fwhm_nm = 40, channel = "G" },'
     ' { name = "red", centre_nm = 620, fwhm_nm = 40, channel = "R" }]'),
    ("drift_per_hour = 0.005", "drift_per_hour = 0.005\nbeam_diameter_mm = 15.0\nmonitor = true\nmonitor_noise = 5e-4"),
    ("# cosmic_per_s = 0.5", "cosmic_per_s = 5.0 #"),
)  # fmt: skip


@pytest.mark.slow
def test_a_mosaic_with_hot_pixels_stray_light_and_the_edge_of_a_beam(folder: Path, tmp_path: Path) -> None:
    rig = (folder / "rig.toml").read_text(encoding="utf-8")
    for known, other in OTHER:
        assert known in rig
        rig = rig.replace(known, other)
    plan = PLAN.partition("[[sweep]]\ntheta_i_deg = [40]")[0].replace("[550]", "[550, 620]")
    for name, text in (("rig.toml", rig), ("plan.toml", plan), ("sample.toml", SAMPLE)):
        (tmp_path / name).write_text(text, encoding="utf-8")
    measured = ("--rig", "rig.toml", "--sample", "sample.toml", "--seed", "3", "--yes", "--out", "run")
    gonio(tmp_path, "measure", "plan.toml", *measured, expect=0)
    gonio(tmp_path, "reduce", "run", "--map", "map.h5", expect=0)
    with MapFile(tmp_path / "map.h5") as found:
        every = Tile(slice(0, found.shape[0]), slice(0, found.shape[1]))
        (value, u), flag, shared = found.values(every), found.array("flag"), found.array("u_point")
        x, y = np.meshgrid(found.x_mm, found.y_mm)
    assert value.shape[2] == 6
    assert 0.0 < np.mean(flag & 4 > 0) < 0.02  # hot: 0.2 % of the pixels, of which up to eight make a cell
    # a beam of 7.5 mm radius at 30 deg reaches as far along y, and 8.6 to 8.7 mm along x
    assert (flag[(np.abs(y) > 7.9) & (np.hypot(x, y) < 10.0)] & 8 > 0).all()
    assert (flag[(np.hypot(x, y) < 6.8)] & 8 == 0).all()
    for k in range(6):
        good = np.isfinite(value[..., k])
        own = np.sqrt(u[..., k] ** 2 - (value[..., k] * shared[k]) ** 2)[good]
        pulls = (value[..., k][good] - value[..., k][good].mean()) / own
        # 1300 values and more, some of which share pixels: 1.00 +- 0.03, within what is asked for
        assert 0.9 < float(np.std(pulls)) < 1.1
        assert np.abs(pulls).max() < 6.0  # a hit of cosmic radiation that stays in would be tens of u


def test_bad_input_is_one_message(folder: Path) -> None:
    """What cannot be is said before any work, and nothing is left behind."""
    before = sorted(path.name for path in folder.iterdir())
    cases = (
        (("reduce", "nowhere", "--map", "bad.h5"), "nowhere"),
        (("reduce", "run", "--map", "sample.toml"), "ends with .h5"),
        (("reduce", "run", "--map", "nowhere/bad.h5"), "does not exist"),
        (("reduce", "run", "--map", "bad.h5", "--pixel-mm", "0"), "larger than 0"),
        (("reduce", "run", "--map", "bad.h5", "--pixel-mm", "nan"), "larger than 0"),
        (("reduce", "run", "--map", "bad.h5", "--pixel-mm", "12"), "a quarter of the sample"),
        (("reduce", "run", "--map", "bad.h5", "--pixel-mm", "1e-5"), "cells along a side"),
        (("reduce", "run", "--pixel-mm", "0.1"), "--map"),
    )
    for command, words in cases:
        said = gonio(folder, *command, expect=2)
        says(said.stderr, words)
        assert len(said.stderr.strip().splitlines()) == 1
    assert sorted(path.name for path in folder.iterdir()) == before


def test_a_parts_folder_of_another_map_is_refused(folder: Path) -> None:
    parts = folder / "other.h5.parts"
    parts.mkdir()
    (parts / "settings.json").write_text("{}", encoding="utf-8")
    says(gonio(folder, "reduce", "run", "--map", "other.h5", expect=2).stderr, "another map")
    shutil.rmtree(parts)
