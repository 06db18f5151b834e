"""Fits of every pixel of a map, and the command that makes them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from gonio_analysis import fit
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.fitting.spectrum import fit_table
from gonio_maps.files import FitFile, MapFile, Parts
from gonio_maps.fits import fits
from gonio_maps.fits.pixels import AT_BOUND, REJECTED, TOO_FEW, UNDETERMINED

from gonio import materials, models
from gonio.errors import ConfigError, DataError
from gonio.geometry import Directions
from gonio.typing import Floats
from tests.command_line import gonio, no_room_beyond, some
from tests.gonio_maps import map_files
from tests.gonio_maps.fits.made import write

NAMES = ("s", "m", "diffuse_albedo", "ior")
PLASTIC = {"s": 0.4, "d": 0.6, "m": 0.3, "diffuse_albedo": 0.5, "ior": 1.5}


def textures(x: float, y: float) -> dict[str, Any]:
    """A gradient of gloss along x, one of roughness along y."""
    return {"s": float(0.5 + 0.05 * x), "d": float(0.5 - 0.05 * x), "m": float(0.25 + 0.02 * y),
            "diffuse_albedo": 0.4, "ior": 1.5}  # fmt: skip


def made(path: Path, out: Path, model: str = "cook-torrance", **options: Any) -> list[str]:
    """Fit a map; what was said."""
    said: list[str] = []
    fits.make(path, out, FitRequest(model, **options), count=lambda done, total: None, say=said.append)
    return said


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[str, Floats]]:
    """A map of 4480 pixels in two tiles, its fits, and the true parameters."""
    folder = tmp_path_factory.mktemp("maps")
    truth = write(folder / "map.h5", textures, rows=70, cols=64)
    made(folder / "map.h5", folder / "fits.h5")
    return folder / "map.h5", folder / "fits.h5", truth


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """Six tiles of equal pixels."""
    write(tmp_path / "map.h5", lambda x, y: PLASTIC, rows=130, cols=128, pixel_mm=0.0)
    return tmp_path / "map.h5"


@pytest.mark.slow
def test_pulls_of_all_pixels_have_the_spread_of_their_uncertainties(
    mapped: tuple[Path, Path, dict[str, Floats]],
) -> None:
    _, out, truth = mapped
    with MapFile(out) as found:
        flag = found.array("flag")
        assert not (flag & (TOO_FEW | AT_BOUND | UNDETERMINED)).any()
        # 1 % by chance, of 4480: 0.15 % of spread, and four of them
        assert (flag & REJECTED).astype(bool).mean() == pytest.approx(0.01, abs=0.006)
        for name in NAMES:
            pulls = (found.array(name) - truth[name]) / found.array(f"u_{name}")
            # the spread of 4480 normal pulls is uncertain by 1/sqrt(2 4480) = 1.06 %: 0.03 is 2.8 of them
            assert 0.97 < pulls.std() < 1.03, name
            # the mean by 1.5 %, and the second order of the model is of the size of u over the value, 1 %
            assert abs(pulls.mean()) < 0.06, name
            assert np.abs(pulls).max() < 5.0, name


@pytest.mark.slow
def test_pixels_are_those_of_the_ordinary_fit(mapped: tuple[Path, Path, dict[str, Floats]]) -> None:
    path, out, _ = mapped
    rng = np.random.default_rng(3)
    with MapFile(path) as values, MapFile(out) as found:
        flag = found.array("flag")
        for at in rng.choice(np.flatnonzero(flag.ravel() == 0), 30, replace=False):
            row, col = np.unravel_index(at, flag.shape)
            alone = fit(values.table(int(row), int(col)), "cook-torrance")
            assert alone.chi_square == pytest.approx(found.array("chi_square")[row, col], rel=1e-5)  # float32
            pairs = found.array("correlation")[row, col]
            assert pairs == pytest.approx(alone.correlation[np.triu_indices(4, 1)][[0, 1, 3, 2, 4, 5]], abs=1e-3)
            for name in NAMES:
                one = alone.parameters[name]
                assert one.u is not None
                # both end where a step is below 1e-4 u
                assert found.array(name)[row, col] == pytest.approx(one.value, abs=1e-3 * one.u)
                assert found.array(f"u_{name}")[row, col] == pytest.approx(one.u, rel=1e-3)


@pytest.mark.slow
def test_a_cause_that_pixels_share_is_in_their_uncertainties_as_in_the_ordinary_fit(tmp_path: Path) -> None:
    write(tmp_path / "map.h5", textures, rows=2, cols=5, common=0.02)
    made(tmp_path / "map.h5", tmp_path / "fits.h5", fix={"ior": 1.5})
    with MapFile(tmp_path / "map.h5") as values, MapFile(tmp_path / "fits.h5") as found:
        alone = fit(values.table(1, 3), "cook-torrance", fix={"ior": 1.5})
        for name in NAMES[:3]:
            one = alone.parameters[name]
            assert one.u is not None
            assert found.array(name)[1, 3] == pytest.approx(one.value, abs=1e-3 * one.u)
            assert found.array(f"u_{name}")[1, 3] == pytest.approx(one.u, rel=1e-3)
        assert found.array("u_s")[1, 3] > 0.02 * found.array("s")[1, 3]  # a level is known no better than the cause


KILLED = """
import os, signal, sys
from pathlib import Path
from gonio_maps import files as maps
from gonio_analysis.fitting.problem import FitRequest
from gonio_maps.fits import fits
where, left = sys.argv[3], [int(sys.argv[4])]
owner, name = {"tile": (maps.Parts, "write"), "file": (maps, "_put"), "name": (Path, "replace"),
               "tidy": (Path, "unlink"), "end": (maps.shutil, "rmtree")}[where]
work = getattr(owner, name)
def dies(*arguments, **named):
    if named:  # of somebody else: a folder of tempfile's
        return work(*arguments, **named)
    if left[0] == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    left[0] -= 1
    return work(*arguments)
setattr(owner, name, dies)
fits.make(Path(sys.argv[1]), Path(sys.argv[2]), FitRequest("cook-torrance"), count=lambda a, b: None, say=print)
"""
"""A fit that is killed when it begins a tile, a part of the file, its name, the removal of a tile or of the folder."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is of POSIX")
@pytest.mark.parametrize(
    ("where", "after", "done"),
    [("tile", 2, (1, 2)), ("file", 20, (6,)), ("name", 0, (6,)), ("tidy", 2, (4,)), ("end", 0, (0,))],
)
def test_what_was_killed_goes_on_and_is_the_same_to_the_byte(
    small: Path, where: str, after: int, done: tuple[int, ...]
) -> None:
    whole, broken = small.with_name("whole.h5"), small.with_name("broken.h5")
    made(small, whole)
    ended = subprocess.run([sys.executable, "-c", KILLED, small, broken, where, str(after)], check=False)
    assert ended.returncode == -9
    assert broken.exists() == (where in ("tidy", "end"))
    assert not broken.exists() or broken.read_bytes() == whole.read_bytes()
    said = " ".join(made(small, broken))  # of two threads one may be in the middle of a tile
    assert any(f"{count} of 6 tiles were done before" in said for count in done) or done == (0,)
    assert broken.read_bytes() == whole.read_bytes()
    assert not list(small.parent.glob("*.parts"))


@pytest.mark.slow
def test_a_killed_fit_is_not_continued_with_other_options(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Parts, "assemble", stop)
        with pytest.raises(KeyboardInterrupt):
            made(small, small.with_name("fits.h5"), fix={"ior": 1.5})
    with pytest.raises(ConfigError, match="parts of another map"):
        made(small, small.with_name("fits.h5"))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="limits of a process are of POSIX")
def test_a_full_disk_is_one_message_and_costs_nothing(small: Path) -> None:
    """In the middle of a tile, of a variable of the file, and where HDF5 writes its last bytes."""
    folder, whole = small.parent, small.with_name("whole.h5")
    command: list[str | Path] = ["fit", small, "--model", "cook-torrance", "--out"]
    gonio(folder, *command, whole, expect=0)
    size = whole.stat().st_size
    for room, done in ((100_000, 0), (size // 2, 6), (size - 100, 6)):
        out = folder / f"{room}.h5"
        with no_room_beyond(room):
            said = gonio(folder, *command, out, expect=2).stderr
        assert f"gonio: {out}: cannot be written: File too large; the tiles that are done stay" in said
        assert "Traceback" not in said
        left = [path.name for path in Path(f"{out}.parts").iterdir()]
        assert not out.exists()
        assert sorted(left) == sorted(["settings.json", *(name for name in left if name.endswith(".npz"))])
        said = gonio(folder, *command, out, expect=0).stderr
        assert (f"{done} of 6 tiles were done before" in said) == (done > 0)
        assert out.read_bytes() == whole.read_bytes()
        assert not Path(f"{out}.parts").exists()


@pytest.mark.slow
def test_flags_say_what_is_not_known(tmp_path: Path) -> None:
    path, out = tmp_path / "map.h5", tmp_path / "fits.h5"
    matte = {"s": 0.0, "d": 1.0, "m": 0.3, "diffuse_albedo": 0.5, "ior": 1.5}
    write(path, lambda x, y: matte if x > 0 else PLASTIC, rows=1, cols=8)
    with h5py.File(path, "r+") as file:
        file["flag"][0, 0, 4:] = 2  # saturated but for four values
    made(path, out)
    with MapFile(out) as found:
        flag = found.array("flag")[0]
        assert flag[0] == TOO_FEW
        assert found.array("n_values")[0, 0] == 4
        assert np.isnan(found.array("s")[0, 0])
        assert not flag[1:4].any()
        # without a lobe its width and index are unknown, or stand at a bound
        assert ((flag[4:] & (UNDETERMINED | AT_BOUND)) != 0).all()
        for name in NAMES:
            assert (np.isnan(found.array(name)[0, 4:]) <= ((flag[4:] & UNDETERMINED) != 0)).all()
            known = np.isfinite(found.array(f"u_{name}"))
            assert (found.array(f"u_{name}")[known] > 0).all()
    said = fits.summary(out)
    assert (said.pixels, said.fitted) == (8, 7)
    assert sum(one.undetermined for one in said.parameters.values()) > 0


@pytest.mark.slow
def test_a_wrong_model_has_a_misfit_in_every_pixel(tmp_path: Path) -> None:
    def ripple(at: Directions) -> Floats:
        return np.asarray(1.0 + 0.1 * np.cos(7.0 * at.theta_r + 3.0 * at.theta_i))

    write(tmp_path / "map.h5", textures, rows=4, cols=4, wrong=ripple)
    made(tmp_path / "map.h5", tmp_path / "fits.h5")
    with MapFile(tmp_path / "map.h5") as values, MapFile(tmp_path / "fits.h5") as found:
        assert ((found.array("flag") & REJECTED) != 0).all()
        alone = fit(values.table(2, 1), "cook-torrance")
        assert alone.misfit is not None
        # the two end their turns of parameters and misfit where ln tau moves by 1e-3
        assert found.array("misfit")[2, 1] == pytest.approx(alone.misfit.tau, rel=3e-3)
        for name in NAMES:
            one = alone.parameters[name]
            assert one.u is not None
            assert found.array(name)[2, 1] == pytest.approx(one.value, abs=0.02 * one.u)


@pytest.mark.slow
def test_the_file_opens_in_xarray_with_units_and_meanings(mapped: tuple[Path, Path, dict[str, Floats]]) -> None:
    xarray = pytest.importorskip("xarray")
    _, out, _ = mapped
    with xarray.open_dataset(out, engine="h5netcdf") as found:
        assert found["m"].dims == ("y", "x")
        assert found["correlation"].dims == ("y", "x", "pair")
        assert found["correlation"].attrs["pairs"].split()[:3] == ["s:m", "s:diffuse_albedo", "m:diffuse_albedo"]
        assert found["x"].attrs["units"] == "mm"
        assert found["flag"].attrs["flag_meanings"] == "too_few at_bound undetermined rejected"
        assert found.attrs["model"] == "cook-torrance"
        assert len(found.attrs["map_sha256"]) == 64


@pytest.mark.slow
def test_constants_of_a_material_are_those_at_the_wavelength_of_the_points(tmp_path: Path) -> None:
    of = {"s": 0.9, "d": 0.1, "m": 0.2, "diffuse_albedo": 0.2, "ior": "Al"}
    write(tmp_path / "map.h5", lambda x, y: of, rows=2, cols=2, waves=(450.0, 650.0))
    said = made(tmp_path / "map.h5", tmp_path / "fits.h5", ior="Al", separate=True)
    assert said == ["The map has values at 450, 650 nm; those at 450 nm are fitted (--wavelength-nm)."]
    made(tmp_path / "map.h5", tmp_path / "red.h5", ior="Al", wavelength_nm=650.0)
    for name, wave in (("fits", 450.0), ("red", 650.0)):
        with MapFile(tmp_path / f"{name}.h5") as found:
            index = complex(materials.ior("Al")(wave))
            assert found.attrs["fixed"] == {"ior": index.real, "k": index.imag}
            assert found.attrs["wavelength_nm"] == wave
            assert (found.array("n_values") == 100).all()
            # three parameters of four pixels within five standard errors
            assert (np.abs(found.array("m") - 0.2) < 5 * found.array("u_m")).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "kind", "arguments", "asked", "wrong"),
    [
        ("cook-torrance", models.CookTorrance, PLASTIC, {}, 0.0),
        ("cook-torrance", models.CookTorrance, PLASTIC, {"fix": {"ior": 1.5}}, 0.06),
        ("oren-nayar", models.OrenNayar, {"albedo": 0.6, "sigma_deg": 20.0}, {}, 0.0),
        ("he-torrance", models.HeTorrance,
         {"sigma0_um": 0.15, "tau_um": 2.0, "diffuse_albedo": 0.3, "ior": 1.5}, {}, 0.0),
    ],
)  # fmt: skip
def test_wavelengths_share_the_geometry_as_in_the_ordinary_fit(
    tmp_path: Path, model: str, kind: Any, arguments: dict[str, float], asked: dict[str, Any], wrong: float
) -> None:
    factor = (lambda at: 1.0 + wrong * np.sin(9.0 * at.theta_r)) if wrong else None
    write(tmp_path / "map.h5", lambda x, y: arguments, kind=kind, rows=2, cols=2, waves=(450.0, 550.0, 650.0),
          common=0.01, wrong=factor)  # fmt: skip
    said = made(tmp_path / "map.h5", tmp_path / "fits.h5", model, **asked)
    assert "3 wavelengths (450, 550, 650 nm) are fitted together" in said[-1]
    with MapFile(tmp_path / "map.h5") as values, FitFile(tmp_path / "fits.h5") as found:
        alone = fit_table(values.table(1, 0), FitRequest(model, **asked))
        shared = some(alone[0].shared)
        assert found.array("chi_square")[1, 0] == pytest.approx(shared.chi_square, rel=1e-5)  # float32, and 1e-3
        assert found.array("n_values")[1, 0] == 300
        assert (found.array("flag") == (REJECTED if wrong else 0)).all()
        names = []
        for at in alone:
            for name in at.free:
                same = name in shared.parameters or at is alone[0]
                names.append(name if same else f"{name}@{at.wavelength_nm:g}")
                one, u = at.parameters[name], found.array(f"u_{names[-1]}")[1, 0]
                # both end where a step is below 1e-4 u; the ordinary fit has the causes as of a solution without
                # them, which changes u by 3.3e-3, as scipy's least squares tells with either
                assert found.array(names[-1])[1, 0] == pytest.approx(one.value, abs=2e-3 * some(one.u))
                # a misfit's errors by blocks: one linear step a block here, whole fits there
                assert u == pytest.approx(one.u, rel=0.5 if wrong else 5e-3)
        assert sorted(found.parameters) == sorted(set(names))
        if wrong:
            assert found.array("misfit")[1, 0] == pytest.approx(some(alone[0].misfit).tau, rel=1e-3)


@pytest.mark.slow
def test_pulls_of_what_wavelengths_share_and_of_what_is_their_own(tmp_path: Path) -> None:
    truth = write(tmp_path / "map.h5", textures, rows=40, cols=40, waves=(450.0, 650.0))
    made(tmp_path / "map.h5", tmp_path / "fits.h5", fix={"ior": 1.5})
    with MapFile(tmp_path / "fits.h5") as found:
        for name in ("m", "s", "s@650", "diffuse_albedo", "diffuse_albedo@650"):
            pulls = (found.array(name) - truth[name.partition("@")[0]]) / found.array(f"u_{name}")
            # the spread of 1600 normal pulls is uncertain by 1.8 %: 0.05 is 2.8 of them
            assert 0.95 < pulls.std() < 1.05, name
            assert np.abs(pulls).max() < 5.0, name


@pytest.mark.slow
def test_a_wavelength_with_too_few_values_in_a_pixel_is_left_out_there(tmp_path: Path) -> None:
    path, out = tmp_path / "map.h5", tmp_path / "fits.h5"
    write(path, lambda x, y: PLASTIC, rows=1, cols=3, waves=(450.0, 550.0))
    with h5py.File(path, "r+") as file:
        file["flag"][0, 0, 3:100] = 2
        file["flag"][0, 1, 3:] = 2
    made(path, out, fix={"ior": 1.5})
    made(path, tmp_path / "alone.h5", fix={"ior": 1.5}, wavelength_nm=550.0)
    with MapFile(out) as found, MapFile(tmp_path / "alone.h5") as alone:
        assert list(found.array("flag")[0]) == [UNDETERMINED, TOO_FEW, 0]
        assert list(found.array("n_values")[0]) == [100, 0, 200]
        assert np.isnan(found.array("s@450")[0]).tolist() == [True, True, False]
        for name in ("m", "u_m", "s", "u_s"):  # both end within 1e-4 u
            assert found.array(name)[0, 0] == pytest.approx(alone.array(name)[0, 0], rel=1e-5), name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "kind", "arguments"),
    [
        ("oren-nayar", models.OrenNayar, {"albedo": 0.6, "sigma_deg": 20.0}),
        ("ggx", models.GGX, {"alpha": 0.3, "diffuse_albedo": 0.2, "ior": 1.6}),
        ("blinn", models.Blinn, {"k_d": 0.3, "k_s": 0.5, "c": 0.3, "ior": 1.5}),
    ],
)
def test_other_models(tmp_path: Path, model: str, kind: Any, arguments: dict[str, float]) -> None:
    write(tmp_path / "map.h5", lambda x, y: arguments, rows=2, cols=2, kind=kind)
    made(tmp_path / "map.h5", tmp_path / "fits.h5", model)
    with MapFile(tmp_path / "map.h5") as values, MapFile(tmp_path / "fits.h5") as found:
        alone = fit(values.table(0, 1), model)
        for name in alone.free:
            one = alone.parameters[name]
            assert one.u is not None
            assert found.array(name)[0, 1] == pytest.approx(one.value, abs=1e-3 * one.u), name


# --- the command ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_prints_a_summary(tmp_path: Path) -> None:
    write(tmp_path / "map.h5", textures, rows=3, cols=3)
    command: list[str | Path] = ["fit", tmp_path / "map.h5", "--model", "cook-torrance", "--out", tmp_path / "fits.h5"]
    shown = gonio(tmp_path, *command, expect=0)
    assert "fitted 9 of 9 pixels" in shown.stdout
    assert shown.stdout.rstrip().endswith("fits.h5")
    told = json.loads(gonio(tmp_path, *command, "--json", expect=0).stdout)
    assert set(told["parameters"]) == set(NAMES)
    assert told["parameters"]["m"]["median"] == pytest.approx(0.25, abs=0.01)


def test_what_has_no_part_in_a_map_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "map.h5", lambda x, y: PLASTIC, rows=1, cols=1)
    command: list[str | Path] = ["fit", tmp_path / "map.h5", "--model"]
    cases: dict[tuple[str | Path, ...], str] = {
        ("cook-torrance",): "name the file of its fits with --out",
        ("cook-torrance", "--out", "fits.csv"): "ends in .h5",
        ("cook-torrance", "--out", tmp_path / "map.h5"): "is the map itself",
        ("lambert", "--out", "fits.h5"): "maps are fitted with one of",
        ("cook-torrance", "--out", "fits.h5", "--free", "k"): "--free: has no part in the fit of a map",
        ("cook-torrance", "--out", "fits.h5", "--intervals"): "--intervals: has no part",
        ("cook-torrance", "--out", "fits.h5", "--fix", "n=2"): "n",
    }
    for options, message in cases.items():
        assert message in gonio(tmp_path, *command, *options, expect=2).stderr, options


def test_foreign_and_damaged_files_are_one_message(tmp_path: Path) -> None:
    path = tmp_path / "map.h5"
    write(path, lambda x, y: PLASTIC, rows=1, cols=1)
    whole = path.read_bytes()
    (tmp_path / "cut.h5").write_bytes(whole[: len(whole) // 2])
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = 1.0
    for name, message, code in (
        ("cut", "cut.h5: is damaged", 1), ("other", "is no map", 2), ("none", "there is no such file", 2)
    ):  # fmt: skip
        ended = gonio(tmp_path, "fit", f"{name}.h5", "--model", "ggx", "--out", "fits.h5", expect=code)
        assert message in ended.stderr
        assert "Traceback" not in ended.stderr
    with h5py.File(path, "r+") as file:
        del file["brdf"]
    with pytest.raises(DataError, match="without values"):
        made(path, tmp_path / "fits.h5")
    assert not (tmp_path / "fits.h5.parts").exists()


def test_fits_of_earlier_versions_are_read_whose_misfit_was_called_tau(tmp_path: Path) -> None:
    path = map_files.fits(tmp_path / "fits.h5", {"m": np.full((2, 3), 0.2)}, {"m": np.full((2, 3), 0.01)}, tau=0.05)
    with h5py.File(path, "r+") as file:
        file.move("misfit", "tau")
    with FitFile(path) as found:
        assert "misfit" in found.names
        assert "tau" not in found.names
        for name in ("misfit", "tau"):
            assert found.array(name) == pytest.approx(0.05)
