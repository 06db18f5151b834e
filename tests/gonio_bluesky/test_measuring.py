"""A run that Bluesky drives is the run that `gonio measure` makes: the same steps, the same table."""

import contextlib
from pathlib import Path
from typing import Any

import pytest
from gonio_bluesky import measurement

from gonio.errors import ConfigError, DeviceError
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.rig.description import Acquisition
from tests.command_line import gonio
from tests.gonio.lab.acquisition.test_read_out import BESIDE, SlowRig
from tests.gonio.numpy_rig import PLAN, SAMPLE, Plugin, describe, measured

pytest.importorskip("bluesky", reason="bluesky is not installed (extra bluesky)")
from bluesky import RunEngine, protocols
from bluesky.plans import list_scan
from bluesky.utils import FailedStatus

IN_TIME_S = 60.0
"""What has not ended by then hangs: it takes milliseconds."""
SMALL = """name = "small"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [20]
theta_r_deg = [-60, -20, 0, 30]
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    (tmp_path / "plan.toml").write_text(PLAN)
    return tmp_path / "plan.toml"


def engine() -> RunEngine:
    """One that leaves signals alone."""
    return RunEngine({}, context_managers=[])


def choice(plugin: Plugin | None = None) -> RigChoice:
    return RigChoice(plugin or Plugin(), describe(), "numpy")


def test_a_list_scan_on_sim_gives_the_same_table(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(SMALL)
    (tmp_path / "sample.toml").write_text('name = "matte"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n')
    gonio(
        tmp_path,
        "measure",
        "plan.toml",
        "--rig",
        "sim",
        "--sample",
        "sample.toml",
        "--seed",
        "5",
        "--out",
        "A",
        expect=0,
    )
    given: dict[str, Any] = {"rig": "sim", "sample": tmp_path / "sample.toml", "seed": 5}
    with measurement(tmp_path / "plan.toml", **given, out=tmp_path / "B") as m:
        engine()(list_scan([m.camera], *m.points()))
    for out in ("A", "B"):
        assert gonio(tmp_path, "reduce", out).returncode == 0
    assert (tmp_path / "B" / "brdf.csv").read_bytes() == (tmp_path / "A" / "brdf.csv").read_bytes()


@pytest.mark.usefixtures("one_id")
def test_every_step_and_frame_is_that_of_the_engine(plan: Path, tmp_path: Path) -> None:
    whole = measured(load_plan(plan), tmp_path / "A")
    seen = []
    with measurement(plan, rig=choice(), sample=SAMPLE, seed=1, out=tmp_path / "B") as m:
        engine()(list_scan([m.camera], *m.points()), lambda kind, document: seen.append((kind, document)))
        assert m.complete
    driven = Run.open(tmp_path / "B")
    assert list(driven.steps()) == list(whole.steps())
    assert [event["event"] for event in driven.events()] == [event["event"] for event in whole.events()]
    assert brdf.reduce(driven).equals(brdf.reduce(whole))
    rows = [document["data"] for kind, document in seen if kind == "event"]
    taken = {step.step: step for step in whole.steps() if step.kind == "point"}
    assert len(rows) == 6
    assert [row["camera_step"] for row in rows] == [*taken, -1], "the point that is blocked comes last, and is no step"
    for row in rows[:-1]:
        step = taken[row["camera_step"]]
        assert row["camera_point"] == step.point
        assert row["camera_exposure_s"] == step.frames[-1].exposure_s
        point = whole.points.angles_deg[step.point]
        assert [row["theta_i"], row["phi_i"], row["theta_r"], row["phi_r"]] == point.tolist()


def test_no_frame_is_on_its_way_while_a_plan_may_wait(plan: Path, tmp_path: Path) -> None:
    plugin = Plugin(kind=SlowRig)
    with measurement(plan, rig=RigChoice(plugin, BESIDE, "numpy"), sample=SAMPLE, out=tmp_path / "B") as m:
        engine()(list_scan([m.camera], *m.points()))
        assert m.complete
    assert not any(step.overlapped for step in Run.open(tmp_path / "B").steps())
    assert not any(entry.startswith("frame") for entry in plugin.opened[0].log)


def test_they_are_what_the_protocols_say(plan: Path, tmp_path: Path) -> None:
    m = measurement(plan, rig=choice(), sample=SAMPLE, out=tmp_path / "B")
    for direction in m.directions:
        for protocol in (protocols.Movable, protocols.Readable, protocols.Locatable, protocols.Stoppable):
            assert isinstance(direction, protocol)
        assert direction.describe()[direction.name]["units"] == "deg"
    assert isinstance(m.camera, protocols.Triggerable)
    assert isinstance(m.camera, protocols.Readable)
    assert list(m.camera.read()) == list(m.camera.describe())


def aim(m: Any, *angles: float) -> Any:
    for direction, angle in zip(m.directions, angles, strict=True):
        direction.set(angle)
    return m.camera.trigger()


def test_points_are_taken_in_the_order_of_the_run(plan: Path, tmp_path: Path) -> None:
    with measurement(plan, rig=choice(), sample=SAMPLE, out=tmp_path / "B") as m:
        with pytest.raises(ConfigError, match=r"is no point of the plan .*plan\.toml"):
            aim(m, 20.0, 0.0, 61.0, 180.0)
        with pytest.raises(ConfigError, match="is not the next point of the run: that is"):
            aim(m, 20.0, 0.0, 30.0, 180.0)
        with pytest.raises(ConfigError, match=r"theta_i = 91 deg is outside 0 to 90 deg"):
            m.theta_i.set(91.0)
        aim(m, 20.0, 0.0, -60.0, 180.0).wait(IN_TIME_S)
        aim(m, 20.0, 0.0, 60.0, 0.0).wait(IN_TIME_S)
        assert len(m._done) == 1, "the same point, written otherwise, is not taken twice"
    assert [step.kind for step in Run.open(tmp_path / "B").steps()] == ["dark", "reference", "point"]


@pytest.mark.usefixtures("one_id")
def test_a_scan_that_ends_early_is_a_run_to_be_resumed(plan: Path, tmp_path: Path) -> None:
    whole = measured(load_plan(plan), tmp_path / "A")
    plugin = Plugin()
    m = measurement(plan, rig=choice(plugin), sample=SAMPLE, seed=1, out=tmp_path / "B")
    with contextlib.suppress(RuntimeError), m:
        aim(m, 20.0, 0.0, -60.0, 180.0).wait(IN_TIME_S)
        raise RuntimeError("the plan fails")
    (rig,) = plugin.opened
    assert (rig.lit, rig.inside, rig.log[-1]) == (False, False, "park")
    assert Run.open(tmp_path / "B").events()[-1]["event"] == "interrupted"
    with (
        pytest.raises(ConfigError, match="--resume"),
        measurement(plan, rig=choice(), sample=SAMPLE, seed=1, out=tmp_path / "B"),
    ):
        pass
    with measurement(plan, rig=choice(), sample=SAMPLE, seed=1, out=tmp_path / "B", resume=True) as m:
        engine()(list_scan([m.camera], *m.points()))
    assert list(Run.open(tmp_path / "B").steps()) == list(whole.steps())


def test_a_device_that_fails_fails_the_scan(plan: Path, tmp_path: Path) -> None:
    plugin = Plugin(options={"fails_at": 3})
    with (
        pytest.raises((FailedStatus, DeviceError)) as raised,
        measurement(plan, rig=choice(plugin), sample=SAMPLE, out=tmp_path / "B") as m,
    ):
        engine()(list_scan([m.camera], *m.points()))
    assert "no frame came within 5 s" in str(raised.value.__cause__ or raised.value)
    assert not plugin.opened[0].lit
    assert Run.open(tmp_path / "B").events()[-1]["event"] == "device_error"


def test_what_is_wrong_is_said_before_anything_is_made(plan: Path, tmp_path: Path) -> None:
    (tmp_path / "B").mkdir()
    (tmp_path / "B" / "notes.txt").write_text("mine")
    with (
        pytest.raises(ConfigError, match="is not empty"),
        measurement(plan, rig=choice(), sample=SAMPLE, out=tmp_path / "B"),
    ):
        pass
    assert [path.name for path in (tmp_path / "B").iterdir()] == ["notes.txt"]


@pytest.mark.slow
def test_a_step_that_is_taken_again_passes_the_gate_once(plan: Path, tmp_path: Path) -> None:
    tables = []
    for target in (None, 0.01):  # planned brackets have as many frames as they need
        described = describe(acquisition=Acquisition(frames=2, dark_frames=2, roi_radius_mm=3.0, u_rel_target=target))
        rigs = [RigChoice(Plugin(options={"pushes": {3: 1}}), described, "numpy") for _ in range(2)]
        out = tmp_path / str(target)
        out.mkdir()
        whole = carry_out(load_plan(plan), rigs[0], out / "A", sample=SAMPLE)
        with measurement(plan, rig=rigs[1], sample=SAMPLE, out=out / "B") as m:
            engine()(list_scan([m.camera], *m.points()))
        tables.append((brdf.reduce(whole), brdf.reduce(Run.open(out / "B"))))
    assert all(ours.equals(driven) for ours, driven in tables)
