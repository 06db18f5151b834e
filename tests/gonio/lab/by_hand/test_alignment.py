"""Zeros from scans: the centre of a spot, what one kind of scan leaves open, and whole alignments of hidden rigs."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import tomlkit
from gonio_sim.rig import SIM, SimulatedRig

from gonio.config import parse
from gonio.errors import DataError
from gonio.lab.by_hand import alignment
from gonio.lab.by_hand.alignment import COLUMNS, align, peak
from gonio.lab.by_hand.alignment_scans import DIMMED, LONGEST_S, Scans
from gonio.lab.rig import Frame, Pose
from gonio.lab.rig.description import ArmAxis, Arms, RigDescription
from gonio.lab.rig.light_and_camera import Lamp
from gonio.typing import Floats
from tests.command_line import gonio, says, some
from tests.gonio.numpy_rig import describe

ZEROS = {"light": 1.3, "camera": -0.8, "tilt": 0.4}


def hidden(*, limit: float = 95.0, **changes: dict[str, Any]) -> dict[str, Any]:
    """A simulated rig whose zeros nobody knows, with a small sensor."""
    tables = tomllib.loads(SIM.toml)
    tables["camera"] |= {"width": 96, "height": 72, "pixel_um": 33.0}
    common = {"zero_offset_known": False, "zero_u_deg": 0.0}
    for name in ("light", "camera"):
        tables["arms"][name] |= common | {"zero_offset_deg": ZEROS[name], "limits_deg": [-limit, limit]}
    tables["holder"] |= common | {"tilt_zero_offset_deg": ZEROS["tilt"]}
    for name, table in changes.items():
        tables[name] |= table
    return tables


def described(**changes: Any) -> RigDescription:
    return parse(RigDescription, hidden(**changes), "hidden")


def written(folder: Path, **changes: Any) -> Path:
    path = folder / "my.toml"
    path.write_text("# of my laboratory\n" + tomlkit.dumps(hidden(**changes)))
    return path


def shared_area(d: Floats, a: float, b: float) -> Floats:
    """Area that two discs share, by counting points: what a lens sees of a lamp that passes by."""
    x, y = np.meshgrid(np.linspace(-a, a, 201), np.linspace(-a, a, 201))
    inside = x**2 + y**2 <= a**2
    return np.array([np.count_nonzero(inside & ((x - shift) ** 2 + y**2 <= b**2)) for shift in d], float)


def scan(number: int, holder: str, axis: str, at: float, centre: float) -> pd.DataFrame:
    x = centre + np.linspace(-1.7, 1.7, 19) + 0.013
    signal = 1e6 * shared_area(x - centre, 0.5, 0.4) / 1e4 + 50.0
    columns: dict[str, Any] = dict.fromkeys(COLUMNS, 0.0)
    columns |= {"light_encoder_deg": at, "signal": signal, "u_signal": 0.005 * signal + 1.0}
    columns |= {"scan": number, "holder": holder, "axis": axis, f"{axis}_encoder_deg": x}
    return pd.DataFrame(columns)


def mirror_and_straight() -> tuple[pd.DataFrame, pd.DataFrame]:
    total, difference = ZEROS["light"] + ZEROS["camera"], ZEROS["camera"] - ZEROS["light"]
    mirror = [scan(n, "mirror", "camera", at, total - at) for n, at in enumerate((30.0, -30.0, 60.0))]
    mirror.append(scan(8, "mirror", "tilt", 30.0, ZEROS["tilt"]))
    straight = [scan(10, "empty", "camera", 90.0, 90.0 + difference - 180.0)]
    straight.append(scan(11, "empty", "camera", -90.0, -90.0 + difference + 180.0))
    return pd.concat(mirror), pd.concat(straight)


# ---- the centre of a spot ----


@pytest.mark.parametrize(
    ("lamp", "lens", "centre"),
    [(0.5, 0.5, -0.21), (0.5, 0.5, 0.0), (0.8, 0.2, 0.34), (0.2, 0.8, -0.21), (0.2, 0.8, 0.34)],
)
def test_the_centre_of_a_lamp_of_any_size_is_found(lamp: float, lens: float, centre: float) -> None:
    rng = np.random.default_rng(3)
    step = 0.088
    x = np.linspace(-1.7, 1.7, 19)
    true = x + rng.uniform(-step / 2, step / 2, x.size)  # where the arm is when the encoder shows x
    signal = shared_area(true - centre, lamp, lens) * rng.normal(1.0, 0.008, x.size) + 20.0
    found = some(peak(x, signal, 0.008 * signal + 1.0, step))
    assert abs(found.centre - centre) < 3.0 * found.u  # one of five tries of a normal error is beyond it once in 70
    assert found.u < 0.07  # edges between two points of the scan are known to that


def test_noise_and_an_even_field_are_no_spot() -> None:
    x, rng = np.linspace(-2, 2, 19), np.random.default_rng(1)
    assert peak(x, rng.normal(1000.0, 10.0, x.size), np.full(x.size, 10.0), 0.088) is None
    assert peak(x, rng.normal(0.0, 1.0, x.size), np.ones(x.size), 0.088) is None


# ---- what the scans determine ----


def test_both_kinds_of_scan_fix_both_zeros() -> None:
    found = align(pd.concat(mirror_and_straight()), described())
    assert found.rank == 3
    for name, zero in found.zeros.items():
        assert zero.offset_deg == pytest.approx(ZEROS[name], abs=2e-3)  # the stand-in form is symmetric, as the spot is
        assert set(zero.parts) == {"scans", "backlash", "linearity"}, "the encoder's steps are in the scans, once"
        # scans of 0.088 deg steps that agree: far below one step, and not below what a hundred of their readings leave
        assert 0.088 / math.sqrt(12.0 * 100) < zero.u_deg < 0.088 / math.sqrt(12.0)
    assert found.covariance.shape == (3, 3)
    assert np.all(np.linalg.eigvalsh(found.covariance) >= -1e-15)


def test_scans_without_a_spare_one_say_little_of_the_encoders() -> None:
    """One of each kind fits exactly: a residual of 0 is no measure of what two encoders are off."""
    scans = pd.concat(mirror_and_straight())
    numbers = list(dict.fromkeys(scans["scan"]))
    straight = [n for n in numbers if (scans.loc[scans["scan"] == n, "holder"] != "mirror").any()]
    for zero in align(scans[scans["scan"].isin([numbers[0], straight[0]])], described()).zeros.values():
        assert zero.parts["linearity"] > 3 * 0.088 / math.sqrt(12.0) / math.sqrt(2.0)  # three steps of one scan


@pytest.mark.parametrize(
    ("which", "known", "missing"),
    [(0, "the sum of their zeros is 0.500", "straight-through"), (1, "difference camera - light", "mirror scan")],
)
def test_one_kind_alone_leaves_a_combination_open_and_says_which(which: int, known: str, missing: str) -> None:
    found = align(mirror_and_straight()[which], described())
    assert "light" not in found.zeros
    assert "camera" not in found.zeros
    assert known in found.open[0]
    assert missing in found.open[0]
    assert not {("arms", "light", "zero_offset_deg")} & set(alignment.zero_values(found, described()))


def test_backlash_that_the_approach_does_not_take_up_is_in_the_uncertainty() -> None:
    table = pd.concat(mirror_and_straight())
    long = align(table, described(holder={"backlash_deg": 0.3})).zeros["tilt"]
    short = align(table, described(holder={"backlash_deg": 0.3}, acquisition={"approach_deg": 0.1})).zeros["tilt"]
    assert long.parts["backlash"] == 0
    assert short.parts["backlash"] == pytest.approx(0.3 / math.sqrt(12.0))


def test_scans_that_disagree_widen_the_uncertainty() -> None:
    mirror, straight = mirror_and_straight()
    off = mirror.copy()
    off.loc[off["light_encoder_deg"] == -30.0, "camera_encoder_deg"] += 0.4
    good, bad = (align(pd.concat([m, straight]), described()).zeros["light"].u_deg for m in (mirror, off))
    assert bad > 2 * good


# ---- whole alignments ----


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer light angles: the arithmetic of many is tested above."""
    monkeypatch.setattr("gonio.lab.by_hand.alignment_scans.MIRROR_LIGHT_DEG", (30.0, -45.0))
    monkeypatch.setattr("gonio.lab.by_hand.alignment_scans.STRAIGHT", 2)
    monkeypatch.setattr("gonio.lab.by_hand.alignment_scans.POINTS", 11)


def always(there: Any) -> Callable[[SimulatedRig, str], bool]:
    """Somebody who puts the wrong thing into the holder."""

    def put(self: SimulatedRig, what: str) -> bool:
        self.world.target = there
        return True

    return put


def test_the_command_finds_hidden_zeros_and_writes_them_into_a_copy(
    tmp_path: Path, fast: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = written(tmp_path)
    done = gonio(tmp_path, "rig", "align", "--rig", rig, "--yes", "--seed", "4", expect=0)
    says(done.stdout, "rank 3 of 3", "not determined: spin")
    text = (tmp_path / "aligned.toml").read_text()
    assert text.startswith("# of my laboratory\n")
    tables = tomllib.loads(text)
    for name in ("light", "camera"):
        axis = tables["arms"][name]
        assert abs(axis["zero_offset_deg"] - ZEROS[name]) < 2 * axis["zero_u_deg"]
        assert axis["zero_offset_known"]
        assert 0.088 / math.sqrt(12.0 * 100) < axis["zero_u_deg"] < 0.06  # its encoders have errors of half a step
    assert abs(tables["holder"]["tilt_zero_offset_deg"] - ZEROS["tilt"]) < 2 * tables["holder"]["zero_u_deg"]
    assert (tmp_path / "aligned-residuals.png").read_bytes().startswith(b"\x89PNG")

    gonio(tmp_path, "rig", "align", "--rig", rig, "--from", "aligned-scans.csv", "--out", "again.toml", expect=0)
    assert tomllib.loads((tmp_path / "again.toml").read_text()) == tables

    monkeypatch.setattr(alignment, "draw", lambda *given: 1 / 0)
    lost = gonio(tmp_path, "rig", "align", "--rig", rig, "--from", "aligned-scans.csv", "--out", "lost.toml", expect=1)
    says(lost.stderr, "the picture lost-residuals.png", "ZeroDivisionError")
    assert tomllib.loads((tmp_path / "lost.toml").read_text()) == tables


def test_arms_that_cannot_face_each_other_leave_the_zeros_unwritten(tmp_path: Path, fast: None) -> None:
    rig = written(tmp_path, limit=80.0, holder={"axes": []})
    done = gonio(tmp_path, "rig", "align", "--rig", rig, "--yes", expect=1)
    assert "the arms cannot face each other within their limits (light -80 to 80 deg and camera -80" in done.stderr
    says(done.stdout, "rank 1 of 2", "a straight-through scan (empty holder) is missing")
    assert not (tmp_path / "aligned.toml").exists()
    assert (tmp_path / "aligned-scans.csv").exists()


def test_a_lamp_too_bright_for_the_shortest_exposure_is_dimmed(tmp_path: Path, fast: None) -> None:
    rig = written(tmp_path, camera={"width": 96, "height": 72, "pixel_um": 33.0, "exposure_limits_s": [2e-4, 60.0]})
    gonio(tmp_path, "rig", "align", "--rig", rig, "--yes", "--only", "mirror", expect=0)
    table = pd.read_csv(tmp_path / "aligned-scans.csv")
    assert (table["lamp_level"] < 1).all()
    assert (table["clipped"] == 0).all()


def test_a_matt_sample_in_place_of_the_mirror_is_said_to_be_none(
    tmp_path: Path, fast: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SimulatedRig, "put", always("reference"))
    assert "is that a mirror" in gonio(tmp_path, "rig", "align", "--rig", written(tmp_path), "--yes", expect=3).stderr
    assert not list(tmp_path.glob("aligned*"))


def test_nothing_in_the_holder_is_told_with_what_to_look_at(
    tmp_path: Path, fast: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SimulatedRig, "put", always("empty"))
    done = gonio(tmp_path, "rig", "align", "--rig", written(tmp_path), "--yes", "--search", "2", expect=3)
    assert "the mirror's reflection was not found with the camera arm within 2 deg of -30 deg" in done.stderr


def test_what_is_there_already_is_not_written_over(tmp_path: Path) -> None:
    rig = written(tmp_path)
    (tmp_path / "aligned.toml").write_text("mine")
    assert "aligned.toml: is there already" in gonio(tmp_path, "rig", "align", "--rig", rig, "--yes", expect=2).stderr
    assert (tmp_path / "aligned.toml").read_text() == "mine"


def test_scans_of_an_earlier_try_are_kept_beside_the_new_ones(tmp_path: Path) -> None:
    alignment.write(pd.concat(mirror_and_straight()), tmp_path / "first.csv")
    (tmp_path / "aligned-residuals.png").write_text("mine")
    gonio(tmp_path, "rig", "align", "--rig", written(tmp_path), "--from", "first.csv", expect=0)
    assert (tmp_path / "aligned-residuals.png").read_text() == "mine"
    assert (tmp_path / "aligned-residuals-2.png").exists()


def test_a_file_that_holds_no_scans_is_refused(tmp_path: Path) -> None:
    (tmp_path / "no.csv").write_text("a,b\n1,2\n")
    with pytest.raises(DataError, match=r"absent\.csv: cannot be read: No such file or directory$"):
        alignment.read(tmp_path / "absent.csv")
    with pytest.raises(DataError, match="the column scan is missing"):
        alignment.read(tmp_path / "no.csv")
    for holder, axis in (("clamp", "light"), ("mirror", "spin")):
        table = pd.DataFrame({name: [1.0] for name in COLUMNS}).assign(holder=holder, axis=axis)
        with pytest.raises(DataError, match=f'holder = "{holder}", axis = "{axis}": no such scan of this rig'):
            align(table, describe())


# ---- Scans on a bench of numbers: arms land where they are sent, and frames are as bright as the lamp looks
# there


SUM_DEG = 2.3
"""Of both angles as they are read, where the lamp is seen in a mirror."""


@dataclass
class Bench:
    """What `Scans` asks of a rig that is moved by hand."""

    description: RigDescription
    fwhm_deg: float = 1.4
    level_per_s: float = 50.0
    at: Pose = field(default_factory=Pose)
    dimmed: float = 1.0
    light = SimpleNamespace(dim=None)

    @property
    def camera(self) -> Bench:
        return self

    def lamp(self, level: float | bool) -> None:
        self.dimmed = float(level)

    def pose(self) -> Pose:
        return self.at

    def move(self, **goals: float) -> Any:
        self.at = replace(self.at, **goals)
        return SimpleNamespace(landed=goals)

    def capture(self, exposure_s: float) -> Frame:
        camera, off_deg = self.description.camera, math.degrees(self.at.camera + self.at.light) - SUM_DEG
        width = self.fwhm_deg / 2.0 / math.log(2.0) ** (1 / 3)
        level = exposure_s * self.dimmed * self.level_per_s * math.exp(-(abs(off_deg / width) ** 3))
        full = camera.saturation_e / camera.electrons_per_dn
        dn = np.full((camera.height, camera.width), camera.black_level_dn + min(level, 1.0) * full)
        return Frame(
            np.rint(dn).astype(np.uint16), exposure_s, camera.black_level_dn, camera.white_level_dn, time_s=0.0
        )


def scans(bench: Bench) -> Scans:
    return Scans(bench, search_deg=8.0, say=lambda text: None)  # type: ignore[arg-type]


@pytest.mark.parametrize("fwhm_deg", np.geomspace(0.4, 4.0, 6))
@pytest.mark.parametrize("beside", [0.0, 0.5, -0.8])
def test_a_scan_that_is_kept_holds_the_spot_whole_and_in_its_middle(fwhm_deg: float, beside: float) -> None:
    bench = Bench(describe(), fwhm_deg)
    work = scans(bench)
    work._half["camera"] = 1.5
    bench.move(light=math.radians(30.0), camera=math.radians(SUM_DEG - 30.0))
    work._meter()
    bench.move(camera=math.radians(SUM_DEG - 30.0 + beside))
    found = work._fine("mirror", "camera")
    assert found.centre == pytest.approx(SUM_DEG - 30.0, abs=0.01 * fwhm_deg)
    x, y = work.table["camera_encoder_deg"].to_numpy(), work.table["signal"].to_numpy()
    half = (x[-1] - x[0]) / 2
    assert max(y[0], y[-1]) < 0.11 * y.max()  # a tenth of a fitted height
    assert abs(found.centre - (x[0] + x[-1]) / 2) < 0.41 * half
    assert fwhm_deg > 0.34 * half, "at least five of fifteen points in its upper half"


@pytest.mark.parametrize("level_per_s", [1e-2, 0.3, 1.0, 30.0, 1e3, 6e3])
@pytest.mark.parametrize("begin_s", [0.0, 0.01, 1.0])
def test_metering_ends_between_a_quarter_and_what_is_aimed_at(level_per_s: float, begin_s: float) -> None:
    """Or with the longest exposure, or with the shortest and a lamp that is dimmed until it does not saturate."""
    bench = Bench(describe(), level_per_s=level_per_s)
    bench.move(camera=math.radians(SUM_DEG))
    work, target = scans(bench), bench.description.acquisition.exposure_target
    work._exposure_s = begin_s
    work._meter()
    level = work._exposure_s * bench.dimmed * level_per_s
    assert bench.dimmed in (1.0, *DIMMED)
    if level_per_s * LONGEST_S < 0.25:
        assert work._exposure_s == LONGEST_S
    else:
        assert 0.24 < level < 1.02 * target
    assert (bench.dimmed < 1.0) == (level_per_s * bench.description.camera.exposure_limits_s[0] >= 0.9)


class FaceToFace(Bench):
    """Its camera looks into the lamp where it reads 181.25 deg less than the light arm, or 178.75 deg more."""

    def capture(self, exposure_s: float) -> Frame:
        off = math.remainder(math.degrees(self.at.camera - self.at.light) + 181.25, 360.0)
        there = replace(self.at, light=0.0, camera=math.radians(SUM_DEG + off))
        return Bench(self.description, self.fwhm_deg, self.level_per_s, there, self.dimmed).capture(exposure_s)


def test_what_the_first_scan_tells_decides_where_the_others_have_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that was 2.7 deg off, as one is that a limit cuts short: with light at 88 deg there is no room."""
    axis = ArmAxis(limits_deg=(-95.0, 95.0), backlash_deg=0.25)
    lamp, camera = Lamp(half_angle_deg=1.5), {"lens_half_angle_deg": 0.75}
    bench = FaceToFace(describe(arms=Arms(light=axis, camera=axis), lamp=lamp, camera=camera), fwhm_deg=2.9)
    work = scans(bench)
    monkeypatch.setattr(work, "_begin_straight", lambda: -181.25 + 2.7)
    work.straight_through()
    table = work.table
    assert table.groupby("scan")["light_encoder_deg"].first().tolist() == [90.0, -90.0, 92.0, -92.0]
    assert table["camera_encoder_deg"].abs().max() <= 94.75 + 1e-9  # beyond, the backlash is not taken up
