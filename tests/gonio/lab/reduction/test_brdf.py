"""The reduction on runs made by hand: exact without noise, honest with it."""

import functools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from gonio import geometry, measurement
from gonio.geometry import ANGLES_DEG, Directions
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf as radiometry
from gonio.lab.reduction import count_rates
from gonio.lab.reduction.table import angles_deg
from gonio.lab.rig import Frame, Pose
from gonio.lab.rig.description import ArmAxis, Arms
from gonio.lab.rig.dng import read_raw
from gonio.lab.rig.light_and_camera import Band, Lamp
from gonio.typing import Floats
from tests.command_line import some
from tests.gonio.lab.reduction.made_run import MadeRun, Maker, describe, in_plane

POINTS = [in_plane(i, r) for i in (10.0, 45.0, 70.0) for r in (-60.0, -30.0, 0.0, 25.0, 50.0, 80.0)]


def reduce(made: MadeRun) -> pd.DataFrame:
    return radiometry.reduce(cast(Run, made))


def glossy(d: Directions) -> float:
    """Smooth in all angles: a lobe half a radian wide on a matt ground."""
    offset = np.linalg.norm(geometry.direction(d.theta_i, d.phi_i)[:2] + geometry.direction(d.theta_r, d.phi_r)[:2])
    return float(0.1 + 0.4 * math.exp(-((offset / 0.5) ** 2)))


def truth(table: pd.DataFrame, brdf: Any) -> Floats:
    return np.array([brdf(Directions(*np.radians(row))) for row in table[list(ANGLES_DEG)].to_numpy()])


class Exact(Maker):
    """Keeps what the sensor would see as real numbers; files only carry the name."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.kept: list[Floats] = []

    def sensor(self, electrons: Floats) -> npt.NDArray[np.uint16]:
        camera = self.description.camera
        self.kept.append(electrons / camera.electrons_per_dn + camera.black_level_dn)
        return np.full(electrons.shape, len(self.kept) - 1, np.uint16)  # its number stands in the file

    def read(self, path: Path, data: bytes) -> Frame:
        frame = read_raw(path, data)
        return Frame(
            self.kept[int(frame.mosaic[0, 0])],  # type: ignore[arg-type]
            frame.exposure_s,
            frame.black_level_dn,
            frame.white_level_dn,
            time_s=frame.time_s,
        )


def test_noise_free_frames_reduce_exactly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Real-valued frames with dark current, per-pixel offsets and a steady drift: nothing but rounding is left."""
    description = describe(camera={"dark_current_e_per_s": 20.0, "electrons_per_dn": 2.0}, reference={"frames": 2})
    maker = Exact(tmp_path, description, glossy, lamp=lambda t: 1.0 - 2e-5 * t)
    monkeypatch.setattr(count_rates, "read_raw", maker.read)
    table = reduce(maker.make(POINTS, (0.25, 0.25, 0.0625)))
    # 1e-10: sums of 1000 doubles of 1e4, differences of 1e3 below them
    np.testing.assert_allclose(table["brdf"], truth(table, glossy), rtol=1e-10)
    account = table.attrs["provenance"]["reference"][0]
    assert account["drift_per_hour"] == pytest.approx(-2e-5 * 3600 / (1 - 2e-5 * centre(table)), rel=1e-6)


def centre(table: pd.DataFrame) -> float:
    """When the level is stated, from level = R pi (1 - 2e-5 t)."""
    level = table.attrs["provenance"]["reference"][0]["level_e_per_s_sr"]
    return float((1 - level / (40_000 * math.pi)) / 2e-5)


def test_whole_numbers_of_a_raw_file_cost_what_the_budget_says(tmp_path: Path) -> None:
    table = reduce(Maker(tmp_path, describe(), glossy).make(POINTS, (0.25, 0.0625)))
    # half a DN is 1.73 standard deviations of a rounding error; point and reference together at most 1.73 sqrt(2)
    assert np.all(abs(table["brdf"].to_numpy() - truth(table, glossy)) < 2.5 * table["u_brdf"])
    assert np.all(table["u_brdf"] < 4e-4 * table["brdf"])  # 0.29 DN of 1000


def test_the_table_is_a_valid_measurement_table_in_the_plan_s_order(tmp_path: Path) -> None:
    run = Maker(tmp_path, describe(lamp=Lamp(half_angle_deg=0.5), camera={"lens_half_angle_deg": 0.25}), glossy)
    made = run.make(POINTS, (0.25,))
    made.plan.loc[len(made.plan)] = pd.Series(
        [40.0, 0.0, 40.0, 0.0, "blocked", "in each other's way"], made.plan.columns
    )
    made.plan.loc[len(made.plan)] = pd.Series([40.0, 0.0, 41.0, 180.0, "", ""], made.plan.columns)
    table = reduce(made)
    measurement.write(table, tmp_path / "brdf.csv")
    back = measurement.read(tmp_path / "brdf.csv")
    pd.testing.assert_frame_equal(back, table, check_exact=True)
    assert not measurement.is_simulated(back)  # this run's frames count as a camera's: it names no sample
    assert back.attrs["source_solid_angle_sr"] == pytest.approx(  # 1 - cos cancels in the expectation: 1e-9
        2 * math.pi * (1 - math.cos(math.radians(0.5))), rel=1e-9
    )
    assert back.attrs["receiver_solid_angle_sr"] == pytest.approx(
        2 * math.pi * (1 - math.cos(math.radians(0.25))), rel=1e-9
    )
    assert list(table["flag"][-2:]) == ["blocked", "not_measured"]
    assert table["brdf"][-2:].isna().all()
    assert table["theta_r_deg"].tolist()[:6] == [60.0, 30.0, 0.0, 25.0, 50.0, 80.0]
    assert set(table["wavelength_nm"]) == {550.0}
    parts = [name for name in table.columns if name.startswith("s_")]
    combined = np.sqrt(table["u_random"] ** 2 + (table[parts] ** 2).sum(axis=1))
    np.testing.assert_allclose(table["u_brdf"][:-2], combined[:-2], rtol=1e-12)  # rounding of the same sum


NOISY = {
    "photon_noise": True, "read_noise_e": 8.0, "dark_current_e_per_s": 40.0, "electrons_per_dn": 3.0,
    "black_level_dn": 100.0, "full_well_e": 30_000.0, "bits": 14,
}  # fmt: skip


def pulls(table: pd.DataFrame, brdf: Any) -> Floats:
    return (table["brdf"].to_numpy() - truth(table, brdf)) / table["u_brdf"].to_numpy()


def flicker(rng: np.random.Generator, time_s: float) -> float:
    return 1.0 + 0.003 * float(rng.standard_normal())


@pytest.mark.slow
def test_pulls_of_sensor_and_lamp_noise_are_standard_normal(tmp_path: Path) -> None:
    """Independent frames from numpy's generators; dim and bright points, short and long frames."""
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        description = describe(camera=NOISY, lamp=Lamp(noise=0.003), reference={"frames": 8})
        maker = Maker(tmp_path, description, glossy, rng, lamp=functools.partial(flicker, rng))
        found.append(pulls(reduce(maker.make(POINTS, (0.25, 0.25, 0.0625))), glossy))
    z = np.concatenate(found)
    # 180 pulls, about 20 % of whose variance is common to the 18 of a run: the standard deviation of their mean is 0.16
    # (from 10 runs), that of their standard deviation 0.06; three of each
    assert abs(z.mean()) < 0.45
    assert 0.82 < z.std() < 1.18
    assert np.mean(abs(z) <= 2) > 0.90


def test_dim_points_keep_their_sign_and_their_scatter(tmp_path: Path) -> None:
    """A nearly black sample: the mean of many estimates is its BRDF, and many of them are negative."""
    rng = np.random.default_rng(1)
    black = 2e-6
    description = describe(camera=NOISY | {"read_noise_e": 30.0}, acquisition={"roi_radius_mm": 1.0, "dark_frames": 12})
    points = [in_plane(20.0, float(r)) for r in range(-10, 70)]
    table = reduce(Maker(tmp_path, description, lambda d: black, rng).make(points, (0.02,), every=40))
    assert set(table["flag"]) == {""}
    assert np.sum(table["brdf"] < 0) > 10
    z = (table["brdf"] - black) / table["u_brdf"]
    # the dark frames' noise is common to all points (about 15 % of the variance), so the mean of pulls may be 0.4 off
    assert abs(z.mean()) < 1.2
    assert 0.75 < z.std() < 1.2


def test_a_drifting_lamp_is_followed(tmp_path: Path) -> None:
    """0.5 %/h would be lost in this short run: 40 %/h is not."""
    rng = np.random.default_rng(3)
    description = describe(camera=NOISY, reference={"frames": 4})
    maker = Maker(tmp_path, description, glossy, rng, lamp=lambda t: 1.0 + 0.4 * t / 3600)
    table = reduce(maker.make(POINTS, (0.25, 0.0625), every=3))
    account = table.attrs["provenance"]["reference"][0]
    assert account["straight"]
    assert account["drift_per_hour"] == pytest.approx(0.4, abs=4 * account["u_drift_per_hour"])
    assert account["u_drift_per_hour"] < 0.1
    assert np.mean(abs(pulls(table, glossy)) <= 2) > 0.85
    drift = table["s_lamp_drift"] / table["brdf"]
    assert drift.iloc[0] > 0 > drift.iloc[-1]
    assert np.all(np.diff(drift) < 0)


def test_a_lamp_that_jumps_is_interpolated_and_said_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    description = describe(camera=NOISY, reference={"frames": 8})
    maker = Maker(tmp_path, description, glossy, rng, lamp=lambda t: 1.0 + 0.02 * math.sin(t / 12.0))
    table = reduce(maker.make(POINTS, (0.25,), every=1))
    assert not table.attrs["provenance"]["reference"][0]["straight"]
    assert any("straight line" in note for note in table.attrs["notes"])
    assert np.mean(abs(pulls(table, glossy)) <= 2) > 0.9


class Coded(Maker):
    """A camera of 8 bits whose values are coded by its curve."""

    def sensor(self, electrons: Floats) -> npt.NDArray[np.uint16]:
        assert self.rng is not None
        camera = self.description.camera
        read = self.rng.poisson(electrons) + self.rng.normal(0.0, camera.read_noise_e, electrons.shape)
        coded = np.interp(read / camera.electrons_per_dn, camera.response, np.arange(256.0))
        return np.rint(coded).astype(np.uint16)


@pytest.mark.parametrize("dark_e_per_s", [0.0, 5.0])
@pytest.mark.parametrize("coded", [False, True])
def test_where_noise_is_cut_off_at_black_u_holds_what_small_values_lack(
    tmp_path: Path, coded: bool, dark_e_per_s: float
) -> None:
    """Values from 0.3 to 60 electrons a pixel, with a read noise of 8, and a mean over 500 pixels."""
    c = np.arange(256) / 255.0
    curve = 255.0 * np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    bits = {"bits": 8, "electrons_per_dn": 39.0, "response": tuple(curve), "full_well_e": 10_000.0} if coded else {}
    camera = bits | {
        "black_level_dn": 0.0, "read_noise_e": 8.0, "dark_current_e_per_s": dark_e_per_s, "photon_noise": True,
    }  # fmt: skip
    description = describe(camera=camera, reference={"frames": 4, "albedo": 0.2 if coded else 0.99})
    points = [in_plane(10.0, r) for r in range(-80, 85, 10) if abs(r + 10) > 5]
    maker = (Coded if coded else Maker)(tmp_path, description, black_ramp, np.random.default_rng(4))
    table = reduce(maker.make(points, (0.5, 0.5, 0.5, 0.5), every=40))
    off = table["brdf"] - truth(table, black_ramp)
    # what is missing is at most one s_black; the rest has 1/10 of its size
    assert np.all(abs(off) < 1.3 * table["u_brdf"])
    assert np.max(-off / np.sqrt(table["u_brdf"] ** 2 - table["s_black"] ** 2)) > 3.0, "without it u holds nothing"
    assert np.all(table["s_black"] < 0)
    assert any("by about s_black" in note for note in table.attrs["notes"])


def black_ramp(d: Directions) -> float:
    """From 5e-6 to 1e-3 1/sr."""
    return float(5e-6 * 200.0 ** (math.degrees(d.theta_r) / 80.0))


def test_one_visit_says_that_the_drift_is_unknown(tmp_path: Path) -> None:
    run = Maker(tmp_path, describe(), glossy).make(POINTS[:3], (0.25,))
    run.taken = [e for e in run.taken if e.kind != "reference" or e.step < 3]
    table = reduce(run)
    assert "drift of the lamp is not in u_brdf" in table.attrs["notes"][0]
    assert np.all(table["s_lamp_drift"] == 0)
    account = table.attrs["provenance"]["reference"][0]
    assert account["drift_per_hour"] is None  # not 0 +- 0
    assert account["u_drift_per_hour"] is None


def test_visits_that_were_lost_are_told(tmp_path: Path) -> None:
    """One of the visits saturated, one was moved: the third serves alone."""
    run = Maker(tmp_path, describe(), glossy).make(POINTS[:2], (0.25,), every=1)
    visits = [k for k, step in enumerate(run.taken) if step.kind == "reference"]
    run.taken[visits[0]] = replace(run.taken[visits[0]], flag="moved", frames=())
    run.taken[visits[2]] = replace(run.taken[visits[2]], frames=())
    notes = reduce(run).attrs["notes"]
    assert notes[0].endswith("2 of 3 measurements of the white reference cannot be used (1 moved, 1 not_measured)")
    assert "one measurement of the white reference only" in notes[1]


def test_saturated_frames_are_left_out_and_saturated_points_flagged(tmp_path: Path) -> None:
    """theta_i = 10 saturates at 4 s and not at 1 s; at (45, 50) a bright spot saturates in both."""

    def bright(d: Directions) -> float:
        return 20.0 if abs(math.degrees(d.theta_i) - 45) < 1 and abs(math.degrees(d.theta_r) - 50) < 1 else glossy(d)

    maker = Maker(tmp_path, describe(camera={"full_well_e": 70_000.0}), bright)
    table = reduce(maker.make([in_plane(10.0, 25.0), in_plane(45.0, 50.0), in_plane(70.0, 80.0)], (4.0, 0.5)))
    assert list(table["flag"]) == ["", "saturated", ""]
    assert table[["brdf", "u_brdf", "u_random", "s_reference"]].iloc[1].isna().all()
    np.testing.assert_allclose(table["brdf"].iloc[[0, 2]], truth(table, bright)[[0, 2]], rtol=1e-4)  # whole DN


def test_flags_of_the_run_reach_the_table(tmp_path: Path) -> None:
    run = Maker(tmp_path, describe(), glossy).make(POINTS[:3], (0.25,))
    step, low = (next(k for k, step in enumerate(run.taken) if step.point == point) for point in (1, 2))
    run.taken[step] = replace(run.taken[step], flag="below_horizon", frames=())
    run.taken[low] = replace(run.taken[low], pose=replace(run.taken[low].pose, camera=math.radians(90.5)))
    assert list(reduce(run)["flag"]) == ["", "below_horizon", "below_horizon"]


def test_only_the_channel_of_the_band_counts(tmp_path: Path) -> None:
    description = describe(camera={"pattern": "GBRG"})
    green = Band(name="550 nm", centre_nm=550, fwhm_nm=80, channel="G")
    description = description.model_copy(update={"bands": description.bands.model_copy(update={"list": (green,)})})

    class Coloured(Maker):
        def sensor(self, electrons: Floats) -> npt.NDArray[np.uint16]:
            mosaic = super().sensor(electrons)
            mosaic[0::2, 1::2] = 65535  # blue, and red: of no use
            mosaic[1::2, 0::2] = 17
            return mosaic

    run = Coloured(tmp_path, description, glossy).make(POINTS, (0.25,))
    run.bands = (green,)
    table = reduce(run)
    np.testing.assert_allclose(table["brdf"], truth(table, glossy), rtol=2e-4)  # whole DN of 1000


def test_zeros_of_the_arms_are_common_causes_with_their_cosine(tmp_path: Path) -> None:
    """A matt sample feels the light's zero alone: d(cos)/cos, in the sense of the arm's turn."""
    arms = Arms(light=ArmAxis(zero_u_deg=0.05), camera=ArmAxis(zero_u_deg=0.05))
    run = Maker(tmp_path, describe(arms=arms, reference={"u_rel": 0.004}), lambda d: 0.2).make(POINTS, (0.5,))
    table = reduce(run)
    light = np.array([e.pose.light for e in run.taken if e.kind == "point"])
    expected = -table["brdf"] * np.tan(light) * math.radians(0.05)
    # 1e-4: the curve of a matt sample is flat but for whole DN
    np.testing.assert_allclose(table["s_theta_i_zero"], expected, rtol=1e-3, atol=2e-7)
    assert np.all(abs(table["s_theta_r_zero"]) < 1e-3 * abs(table["s_theta_i_zero"]).max())
    np.testing.assert_allclose(table["s_reference"], 0.004 * table["brdf"], rtol=1e-12)


def test_points_that_use_the_same_pixels_share_their_responsivities(tmp_path: Path) -> None:
    """Means of independent pixels over a point's region, less that over the reference's: their covariance."""
    at = [(0.0, 70.0), (30.0, 70.0), (0.0, 20.0), (30.0, 20.0), (0.0, 60.0), (0.0, 50.0)]
    run = Maker(tmp_path, describe(camera={"prnu": 0.01}), lambda d: 0.2).make([in_plane(*a) for a in at], (0.5,))
    found = radiometry.reduce_in_parts(cast(Run, run))
    frames = count_rates.RunFrames(cast(Run, run))
    regions = [some(frames.region(step, "mono")).lit for step in frames.steps() if step.point is not None]
    images = np.zeros((len(regions) + 1, 64, 64))
    for image, roi in zip(images, [*regions, frames.reference["mono"]], strict=True):
        image[roi.rows, roi.cols] = roi.mask / roi.count
    apart = (images[:-1] - images[-1]).reshape(len(regions), -1)
    columns = found.table[["s_prnu_1", "s_prnu_2", "s_prnu_3"]].to_numpy() / found.table[["brdf"]].to_numpy()
    stated = columns @ columns.T + np.diag((found.budget["prnu"] / found.table["brdf"]) ** 2)
    true = 1e-4 * apart @ apart.T
    np.testing.assert_allclose(np.diag(stated), np.diag(true), rtol=1e-6)
    # three columns leave little: the variance at 50 and 60 degrees, whose regions are nearly the reference's, is small
    np.testing.assert_allclose(stated, true, atol=0.05 * true.max())
    assert stated[0, 1] == pytest.approx(true[0, 1], rel=1e-3)


def test_a_lamp_that_flickers_more_than_the_rig_file_says_is_noticed(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    for noise, noted in ((0.005, False), (0.001, True)):
        description = describe(camera=NOISY, lamp=Lamp(noise=noise), reference={"frames": 4})
        maker = Maker(tmp_path, description, glossy, rng, lamp=lambda t: 1.0 + 0.005 * rng.standard_normal())
        table = reduce(maker.make(POINTS, (0.25, 0.25, 0.0625)))
        assert any("u_random is too small" in note for note in table.attrs["notes"]) is noted


def test_a_reference_known_by_a_table(tmp_path: Path) -> None:
    """40 % brighter toward the normal than at the visits' angle: the value at the visits' angle counts."""
    rows = pd.DataFrame(
        [(0.0, 0.0, float(r), 180.0, 0.45 - 0.003 * r) for r in range(0, 81, 10)],
        columns=[*ANGLES_DEG, "brdf"],
    )
    rows = rows.assign(wavelength_nm=550.0, polarisation="unpolarised", u_brdf=np.nan, u_random=np.nan, flag="")
    measurement.write(rows[list(measurement.COLUMNS)], tmp_path / "white.csv")
    run = Maker(tmp_path, describe(), glossy).make(POINTS, (0.25,))
    run.description = describe(reference={"albedo": None, "table": str(tmp_path / "white.csv")})
    found = reduce(run)
    at_visit = 0.45 - 0.003 * 45
    np.testing.assert_allclose(found["brdf"], truth(found, glossy) * at_visit / (0.99 / math.pi), rtol=1e-4)  # whole DN
    assert found.attrs["provenance"]["reference"][0]["brdf"] == pytest.approx(at_visit, rel=1e-9)


def test_a_zero_that_the_reference_feels_too_cancels(tmp_path: Path) -> None:
    """Sample and reference at one angle of incidence: the light's zero changes both alike."""
    arms = Arms(light=ArmAxis(zero_u_deg=0.05), camera=ArmAxis())
    description = describe(arms=arms, reference={"theta_i_deg": 60.0, "theta_r_deg": 0.0})
    points = [in_plane(i, r) for i in (30.0, 60.0) for r in (-20.0, 0.0, 20.0)]
    table = reduce(Maker(tmp_path, description, lambda d: 0.2).make(points, (0.5,)))
    expected = [math.tan(math.radians(t)) - math.tan(math.radians(60)) for t in (30, 60)]
    relative = table["s_theta_i_zero"] / table["brdf"] / math.radians(0.05)
    # 1e-3: whole DN in the curves' slopes
    np.testing.assert_allclose(np.abs(relative), np.abs(np.repeat(expected, 3)), atol=2e-3)


def test_dark_frames_of_one_exposure_take_the_data_sheet_s_dark_current(tmp_path: Path) -> None:
    class OneExposure(Maker):
        def darks(self) -> StepRecord:
            return self.record("dark", None, Pose(), [self.frame(None, "dark", 0.5) for _ in range(4)])

    description = describe(camera={"dark_current_e_per_s": 300.0})
    table = reduce(OneExposure(tmp_path, description, glossy).make(POINTS, (0.25, 0.0625)))
    np.testing.assert_allclose(table["brdf"], truth(table, glossy), rtol=3e-4)  # whole DN, three roundings


def test_a_run_without_a_single_usable_point_is_all_flags(tmp_path: Path) -> None:
    maker = Maker(tmp_path, describe(camera={"full_well_e": 60_000.0}), lambda d: 100.0)
    table = reduce(maker.make(POINTS[:3], (0.5,)))
    assert list(table["flag"]) == ["saturated"] * 3
    assert table["brdf"].isna().all()


def test_a_zero_that_nobody_knows_is_said(tmp_path: Path) -> None:
    arms = Arms(light=ArmAxis(zero_offset_known=False), camera=ArmAxis())
    table = reduce(Maker(tmp_path, describe(arms=arms), glossy).make(POINTS[:2], (0.25,)))
    assert table.attrs["notes"][0].startswith("the zero of the light arm is not known")


@pytest.mark.parametrize(("black_level", "noted"), [(100.0, False), (4.0, True)])
def test_dark_frames_that_are_cut_off_at_zero_are_said(tmp_path: Path, black_level: float, noted: bool) -> None:
    """A read noise of 2.7 DN below a black level of 4 DN."""
    description = describe(camera=NOISY | {"black_level_dn": black_level})
    table = reduce(Maker(tmp_path, description, glossy, np.random.default_rng(3)).make(POINTS[:2], (0.25,)))
    assert any("read 0 DN" in note for note in table.attrs["notes"]) is noted


def test_angles_of_a_table_are_rounded_within_their_ranges() -> None:
    """A grazing direction that rounds beyond 90 degrees is at 90; behind the sample the limit is 180."""
    over = math.pi / 2 + 1e-11
    points = [Directions.from_degrees(30.0, 350.0, 150.0, -10.0), Directions.from_degrees(60.0, 360.0, 90.0, 0.0),
              Directions(np.float64(over), np.float64(0.0), np.float64(math.pi), np.float64(0.1))]  # fmt: skip
    expected = [[30.0, 60.0, 90.0], [350.0, 0.0, 0.0], [150.0, 90.0, 180.0], [350.0, 0.0, round(math.degrees(0.1), 9)]]
    np.testing.assert_allclose(angles_deg(points), expected, rtol=0, atol=1e-9)  # the last decimal of a table
    assert angles_deg(points).max(axis=1).tolist()[0] == 90.0
