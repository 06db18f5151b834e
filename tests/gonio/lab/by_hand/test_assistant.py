"""A session of live alignment on a rig of numpy: one step after the other, with a clock that is the test's."""

import contextlib
import json
import math
import threading
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.config import to_toml
from gonio.errors import DeviceError, Disturbed
from gonio.lab.by_hand.assistant import CAMERA_S, Assistant
from gonio.lab.by_hand.live_view import FramePictures
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.rig import Frame, Pose, imaging, kinematics
from gonio.lab.rig.description import Body, Reference, RigDescription
from gonio.lab.rig.light_and_camera import Camera
from tests.command_line import says, some
from tests.gonio.lab.by_hand.test_lamp_timer import Clock
from tests.gonio.numpy_rig import NumpyRig, describe


@dataclass
class Scene(NumpyRig):
    """What it looks at: a disc of light on a dark plane [mm], where the true pose puts it in the frame."""

    at_mm: tuple[float, float] = (0.0, 0.0)
    radius_mm: float = 2.0
    rate: float = 20_000.0
    does: list[Any] = field(default_factory=list)
    """What the next frames do before they come: raise it, or call it."""
    fails_to_darken: bool = False
    asked_s: list[float] = field(default_factory=list)
    """Exposures of all frames."""

    def capture(self, exposure_s: float) -> Frame:
        self.asked_s.append(exposure_s)
        if self.does and (what := self.does.pop(0)) is not None:
            if isinstance(what, Exception):
                raise what
            what()
        camera = self.description.camera
        view = kinematics.view(self.description, self.pose)
        seen, pixel_mm = imaging.pixel_map(self.description, view), imaging.pixel_on_sample_mm(self.description, view)
        x, y = seen.x_mm - self.at_mm[0], seen.y_mm - self.at_mm[1]
        share = np.clip((self.radius_mm - np.hypot(x, y)) / pixel_mm + 0.5, 0.0, 1.0)  # of a pixel at the edge
        light = share * (self.rate * exposure_s if self.lit else 0.0)
        rng = np.random.default_rng([self.seed, self.frame])
        self.frame += 1
        charge = rng.poisson(np.nan_to_num(light)).clip(max=camera.full_well_e) + 5.0 * rng.standard_normal(x.shape)
        dn = np.clip(np.rint(charge / camera.electrons_per_dn + camera.black_level_dn), 0, camera.white_level_dn)
        return Frame(dn.astype(np.uint16), exposure_s, camera.black_level_dn, camera.white_level_dn, time_s=self.frame)

    def off(self) -> None:
        if self.fails_to_darken:
            raise DeviceError("the lamp does not answer")
        super().off()


CAMERA = Camera(width=160, height=120, pixel_um=40, exposure_limits_s=(1e-3, 10.0), photon_noise=True, read_noise_e=5.0)


def rig(**changes: Any) -> RigDescription:
    return describe(camera=CAMERA, **changes)


@dataclass
class Session:
    """An assistant at an open rig, and what it has told and said."""

    device: Scene
    manual: ManualRig
    assistant: Assistant
    clock: Clock
    told: list[tuple[dict[str, Any], FramePictures | None]]
    said: list[str]

    def look(self) -> dict[str, Any]:
        """What is shown of the next frame."""
        before = len(self.told)
        self.assistant.look()
        assert len(self.told) == before + 1, self.said
        self.clock.now += 0.125
        return self.told[-1][0]

    def obey(self, *orders: str) -> str:
        """What is said to orders."""
        before = len(self.said)
        for order in orders:
            self.assistant.obey(order)
        return "\n".join(self.said[before:])


def session(device: Scene, rig_file: Path | None = None, out: Path | None = None) -> Session:
    clock = Clock()
    told: list[tuple[dict[str, Any], FramePictures | None]] = []
    said: list[str] = []
    manual = ManualRig(device, str(rig_file))
    assistant = Assistant(
        manual,
        tell=lambda what, shown: told.append((what, shown)),
        say=said.append,
        rig_file=rig_file,
        out=out,
        clock=clock,
    )
    return Session(device, manual, assistant, clock, told, said)


@contextlib.contextmanager
def working(description: RigDescription, **scene: Any) -> Iterator[Session]:
    """A session at a rig that is open."""
    made = session(Scene(description, repeatable=False, **scene))
    with made.manual:
        yield made


@pytest.fixture
def at_work() -> Iterator[Session]:
    with working(rig()) as made:
        yield made


# ---- what is shown ----


def test_a_spot_is_told_from_the_centre_in_pixels_and_on_the_sample(at_work: Session) -> None:
    device = at_work.device
    device.at_mm, device.radius_mm = (1.0, -0.6), 4.0
    at_work.obey("go light 35 camera -25", "lamp on", "exposure 0.3")
    told = at_work.look()
    view = kinematics.view(device.description, Pose(light=math.radians(35), camera=math.radians(-25)))
    centre = imaging.place(device.description, view, "sample")
    spot = told["spot"]
    assert told["predicted"]["centre"] == pytest.approx(centre)
    assert spot["from_centre_px"] == pytest.approx([spot["column"] - centre[0], spot["row"] - centre[1]])
    # a pixel is 0.4 mm wide: a tenth of it for the centre, three quarters for a length
    assert spot["from_centre_mm"] == pytest.approx([1.0, -0.6], abs=0.04)
    assert spot["axes_mm"] == pytest.approx([8.0, 8.0], abs=0.3)
    # seen under 25 degrees, the disc is cos(25) as wide as it is high
    assert spot["minor_px"] / spot["major_px"] == pytest.approx(math.cos(math.radians(25)), abs=0.03)
    assert (told["angles_deg"]["light"], told["directions_deg"]["theta_r"]) == pytest.approx((35, 25))


def test_a_region_outside_the_frame_is_not_drawn_and_the_page_says_why() -> None:
    with working(rig(reference=Reference(how="beside", offset_mm=(90.0, 0.0)))) as at_work:
        told = at_work.look()
        assert told["predicted"]["centre"] == pytest.approx([79.5, 59.5])
        assert not any(0 <= column < 160 for column, _ in told["predicted"]["reference"])
        assert "reference is in the beam" in at_work.obey("show reference")
        told = at_work.look()
    assert (told["predicted"]["centre"], told["predicted"]["sample"]) == (None, None)
    assert "the centre of the reference at x = 90 mm" in told["predicted"]["why"]
    assert told["picture"]["zoom_box"] == [32, 12, 96, 96], "around the optical axis"


def test_focus_waits_for_a_second_frame_and_forgets_its_best_when_an_axis_moves(at_work: Session) -> None:
    at_work.obey("lamp on", "exposure 0.3")
    assert at_work.look()["focus"]["value"] is None
    seen = at_work.look()["focus"]
    assert seen["value"] == seen["best"] > 0
    assert at_work.look()["focus"]["best"] >= seen["best"]
    at_work.obey("exposure 0.2")
    assert at_work.look()["focus"]["value"] is None, "frames before and after are not compared"
    assert at_work.look()["focus"]["best"] >= seen["best"]
    at_work.obey("jog camera 5")
    told = at_work.look()["focus"]
    assert (told["value"], told["best"], told["history"]) == (None, None, [])


def test_pictures_come_with_each_frame_and_saturated_pixels_are_red(at_work: Session) -> None:
    import cv2

    at_work.obey("lamp on", "exposure 2")
    told = at_work.look()
    shown = some(at_work.told[-1][1])
    whole, zoom = (
        np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)) for data in (shown.whole, shown.zoom)
    )
    assert (whole.shape, zoom.shape) == ((120, 160, 3), (96, 96, 3))
    assert told["picture"]["zoom_box"] == [32, 12, 96, 96]
    blue, _, red = zoom[48, 48].astype(int)
    assert red > 200 > 100 > blue
    assert zoom[2, 2].max() - zoom[2, 2].min() == 0, "what is not saturated is grey"
    assert told["levels"][0]["saturated"] > 50
    assert told["advice"]["text"].startswith("saturated: shorter")


def test_what_is_told_is_json(at_work: Session) -> None:
    for order in ("go light 30 camera -30", "lamp on", "lamp off", "show reference"):
        at_work.obey(order)
        for _ in range(2):
            json.dumps(at_work.look(), allow_nan=False)


# ---- orders ----


def test_jog_is_by_so_much_and_go_is_to_a_place(at_work: Session) -> None:
    assert at_work.obey("go light 20 camera=-30") == "light 20.000 deg, camera -30.000 deg"
    assert at_work.obey("jog camera +5") == "camera -25.000 deg"
    assert at_work.obey("jog camera -0.5deg") == "camera -25.500 deg"
    assert at_work.device.pose.camera == pytest.approx(math.radians(-25.5))
    assert at_work.device.pose.light == math.radians(20)
    assert "taken: light" in at_work.obey("go theta_i 10 theta_r 40")
    assert kinematics.directions(at_work.device.description, at_work.device.pose).theta_r == pytest.approx(
        math.radians(40)
    )
    at_work.obey("park")
    assert at_work.device.pose == Pose()


@pytest.mark.parametrize(
    ("order", "message"),
    [
        ("jog camera 500", "camera = 500 deg is outside this axis's limits"),
        ("go light 500", "light = 500 deg is outside this axis's limits"),
        ("jog elbow 3", "has no axis elbow"),
        ("jog theta_i 3", "has no axis theta_i"),
        ("jog camera", "as in jog camera -0.5"),
        ("go light 3 light 4", "light is given twice"),
        ("go light nan", "a number is needed"),
        ("lamp 1.5", "the lamp's level is a fraction from 0 to 1"),
        ("lamp bright", "say on, off, or a level"),
        ("exposure 100", "100 s is outside"),
        ("exposure", "a number is needed, as in exposure 0.02"),
        ("band 1900nm", "wavelength_nm = 1900 lies in no band"),
        ("auto", "auto needs light: lamp on"),
        ("save a.jpg", "must end so"),
        ("save", "one name"),
        ("show mirror", "show sample, or show reference"),
        ("zero light", "there is no rig file"),
        ("focs", 'there is no "focs"; help lists'),
    ],
)
def test_an_order_that_is_wrong_is_said_and_changes_nothing(at_work: Session, order: str, message: str) -> None:
    pose = at_work.device.pose
    assert message in at_work.obey(order)
    assert (at_work.device.pose, at_work.device.lit) == (pose, False)
    assert "move" not in at_work.device.log


@pytest.mark.parametrize(
    ("angle_deg", "shortest_s", "first_s"), [(0, 1e-3, 0.165), (60, 1e-3, 0.33), (75, 1e-3, 0.5), (0, 0.2, 0.2)]
)
def test_the_first_exposure_suits_a_matt_white_and_is_no_longer_than_half_a_second(
    angle_deg: float, shortest_s: float, first_s: float
) -> None:
    """A white under normal incidence gives 40 000 e-/s: 0.6 of 11 000 e- take 0.165 s, and obliquely 1/cos of that."""
    camera = CAMERA.model_copy(update={"exposure_limits_s": (shortest_s, 10.0)})
    with working(
        rig().model_copy(update={"camera": camera}), pose=Pose(light=math.radians(angle_deg), camera=-0.5)
    ) as at_work:
        assert at_work.look()["exposure_s"] == pytest.approx(first_s)
        at_work.obey("lamp on", "auto")
        assert at_work.device.asked_s[1] == pytest.approx(
            max(0.165 / math.cos(math.radians(angle_deg)), shortest_s), abs=1e-6
        )


def test_auto_finds_the_exposure_that_advice_calls_good(at_work: Session) -> None:
    at_work.device.radius_mm = 20.0
    at_work.obey("go light 20 camera -30", "lamp on", "exposure 0.001")
    assert at_work.look()["advice"]["text"].startswith("longer")
    at_work.obey("auto")
    told = at_work.look()
    assert told["advice"]["text"] == "good"
    assert told["exposure_s"] == pytest.approx(0.6 * 11_000 / 20_000, rel=0.1)  # the brightest of many, by its noise
    at_work.device.radius_mm, at_work.device.at_mm = 4.0, (0.0, 0.0)
    at_work.obey("go camera 50", "auto")  # no frame was seen from there
    assert at_work.look()["advice"]["text"] == "good"


def test_bodies_that_would_touch_keep_the_arms_where_they_are() -> None:
    post = Body(name="post", on="bench", centre_mm=(0.0, 0.0, 300.0), size_mm=(2.0, 2.0, 2.0))  # in the way of both
    with working(rig(bodies=(post,)), pose=Pose(light=0.5, camera=-0.5)) as at_work:
        said = at_work.obey("go camera 40")
        assert "would touch" in said, said
        assert at_work.device.pose.camera == -0.5


def test_an_arrow_adds_nothing_while_a_jog_is_on_its_way(at_work: Session) -> None:
    for _ in range(5):
        at_work.assistant.nudge("camera", 0.5)
    at_work.assistant.wait(0.0)
    assert math.degrees(at_work.device.pose.camera) == pytest.approx(0.5)
    at_work.assistant.nudge("camera", 0.5)
    at_work.assistant.wait(0.0)
    assert math.degrees(at_work.device.pose.camera) == pytest.approx(1.0)


def test_zeros_go_into_a_copy_of_the_rig_file_one_after_the_other(tmp_path: Path) -> None:
    file, out = tmp_path / "my.toml", tmp_path / "aligned.toml"
    text = to_toml(rig().model_dump(mode="json", exclude_none=True))
    file.write_text(f"# a rig\n{text}")
    at_work = session(Scene(rig(), repeatable=False), file, out)
    with at_work.manual:
        at_work.obey("go light 29.5 camera -31 tilt 2")
        says(
            at_work.obey("zero light 30", "zero camera -30"),
            "light reads 29.500 deg and stands at 30 deg: zero_offset_deg = -0.500",
            "the zeros that it began with",
        )
        held = tomllib.loads(out.read_text())
        assert (held["arms"]["light"]["zero_offset_deg"], held["arms"]["camera"]["zero_offset_deg"]) == (-0.5, -1.0)
        at_work.obey("zero light 29")  # once more: the first one is replaced, and camera's stays
        held = tomllib.loads(out.read_text())
        assert (held["arms"]["light"]["zero_offset_deg"], held["arms"]["camera"]["zero_offset_deg"]) == (0.5, -1.0)
        assert at_work.look()["zeros_deg"] == {"light": 0.5, "camera": -1.0}
        assert "has no axis elbow" in at_work.obey("zero elbow")
    assert out.read_text().startswith("# a rig\n")
    assert file.read_text() == f"# a rig\n{text}"
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["aligned.toml", "my.toml"]


# ---- the lamp ----


def test_the_lamp_is_dark_when_its_time_is_over_and_a_key_keeps_it(at_work: Session) -> None:
    assert not at_work.device.lit
    at_work.obey("lamp on")
    assert at_work.look()["lamp"]["left_s"] == pytest.approx(60.0)
    at_work.clock.now += 50
    at_work.assistant.alive()
    at_work.clock.now += 50
    at_work.look()
    assert at_work.device.lit
    at_work.clock.now += 20
    told = at_work.look()
    assert not at_work.device.lit
    assert told["lamp"] | {"keep_s": 0} == {"left_s": None, "keep_s": 0, "why_dark": "its time is over", "level": None}
    assert at_work.said[-1] == "lamp dark: its time is over"
    at_work.assistant.alive()
    at_work.look()
    assert not at_work.device.lit, "a key keeps it lit, and lights nothing"
    at_work.obey("lamp on")
    assert at_work.device.lit


def test_a_camera_that_hangs_darkens_the_lamp_from_another_thread(at_work: Session) -> None:
    def hangs() -> None:
        at_work.clock.now += CAMERA_S + 1.0
        watch = threading.Thread(target=at_work.assistant.timer.look)
        watch.start()
        watch.join()
        assert not at_work.device.lit, "while the owner is still with the camera"

    at_work.obey("lamp on")
    at_work.device.does = [hangs]
    at_work.assistant.look()
    assert at_work.told == [], "a frame of a lamp that went dark is not shown"
    assert at_work.said[-1] == "lamp dark: the camera does not come back"
    at_work.look()
    assert not at_work.device.lit


def test_a_camera_that_fails_twice_ends_the_session_and_once_darkens_the_lamp(at_work: Session) -> None:
    at_work.obey("lamp on")
    lost = DeviceError("camera: no frame came within 5 s")
    at_work.device.does = [lost, None, lost, lost]
    at_work.assistant.look()
    assert not at_work.device.lit
    assert "trying once more" in at_work.said[-1]
    at_work.look()
    at_work.assistant.look()
    with pytest.raises(DeviceError, match="no frame came"):
        at_work.assistant.look()


def test_an_arm_that_is_pushed_costs_a_frame_and_no_more(at_work: Session) -> None:
    at_work.obey("lamp on")
    at_work.device.does = [Disturbed("axis camera was moved"), Disturbed("axis camera was moved")]
    at_work.assistant.look()
    at_work.assistant.look()
    assert at_work.said[-1] == "axis camera was moved; the frame does not count"
    at_work.look()
    assert at_work.device.lit


def test_a_level_that_the_lamp_does_not_have_leaves_it_dark(at_work: Session) -> None:
    assert "has no levels" in at_work.obey("lamp on", "lamp 0.5")
    assert not at_work.device.lit
    assert at_work.assistant.timer.left_s is None


def test_a_lamp_that_cannot_be_darkened_ends_the_session(at_work: Session) -> None:
    at_work.obey("lamp on")
    at_work.device.fails_to_darken = True
    at_work.clock.now += 61
    with pytest.raises(DeviceError, match="does not answer"):
        at_work.assistant.look()
    at_work.device.fails_to_darken = False


# ---- ways out ----


@pytest.mark.parametrize("ends", ["quit", "Ctrl-C", "error", "failure"])
def test_every_way_out_leaves_the_lamp_dark(ends: str) -> None:
    device = Scene(rig(), repeatable=False)
    at_work = session(device)

    def end() -> None:
        if ends == "Ctrl-C":
            raise KeyboardInterrupt
        if ends == "error":
            raise RuntimeError
        at_work.assistant.orders.put("quit")

    seen: list[bool] = []
    device.does = [None, lambda: seen.append(device.lit), end]
    if ends == "failure":
        device.does[2:] = [DeviceError("camera: gone"), DeviceError("camera: gone")]
    at_work.assistant.orders.put("lamp on")
    raised = ""
    try:
        with at_work.manual:
            at_work.assistant.run()
    except (KeyboardInterrupt, RuntimeError, DeviceError) as error:
        raised = type(error).__name__
    assert raised == {"Ctrl-C": "KeyboardInterrupt", "error": "RuntimeError", "failure": "DeviceError"}.get(ends, "")
    assert seen == [True]
    assert not device.lit
    assert at_work.assistant.timer.left_s is None
