"""What a scan asks a camera for: exposures, and the pixels that see nothing but black."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, cast

import numpy as np
import pytest

from gonio.errors import DeviceError
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.calibration.camera_scan import CameraScan
from gonio.lab.rig import Frame, Pose
from gonio.lab.rig.description import Holder, Reference, RigDescription
from gonio.lab.rig.imaging import pixel_on_sample_mm
from gonio.lab.rig.kinematics import view
from gonio.lab.rig.light_and_camera import Camera
from tests.gonio.numpy_rig import describe

RIG = describe(
    camera=Camera(width=64, height=48, pixel_um=40.0, exposure_limits_s=(1e-3, 10.0)),
    holder=Holder(axes=("tilt", "spin"), sample_diameter_mm=24.0),
    reference=Reference(diameter_mm=40.0),
)


def scan(capture: Any = None, rig: RigDescription = RIG) -> CameraScan:
    """A scan of a rig that stands still."""
    manual = SimpleNamespace(
        description=rig,
        arms=SimpleNamespace(read=Pose),
        camera=SimpleNamespace(capture=capture),
        pose=Pose,
        lamp=lambda lit: None,
    )
    return CameraScan(cast(ManualRig, manual), Path(), say=lambda text: None)


def test_exposures_are_those_of_the_camera_in_microseconds_and_once_each() -> None:
    wanted = np.array([20.0, 0.1234567, 1e-4, 2e-4, 0.5, 0.5000001])
    assert scan()._times(wanted).tolist() == [1e-3, 0.123457, 0.5, 10.0]


@pytest.mark.parametrize(("kind", "diameter_mm"), [("trap", 24.0), ("edge", 40.0)])
def test_black_is_a_square_of_six_tenths_of_the_aperture(kind: Literal["trap", "edge"], diameter_mm: float) -> None:
    """Of a trap all of it; behind an edge what lies more than half a millimetre beyond x = 0."""
    side = pixel_on_sample_mm(RIG, view(RIG, Pose()))
    rows, cols = scan()._black(kind)
    half = 0.3 * diameter_mm
    # the middle of the frame is at 23.5 and 31.5; a pixel more or less at either end
    assert (rows.stop - rows.start) * side == pytest.approx(min(2.0 * half, 48 * side), abs=1.01 * side)
    width = 2.0 * half if kind == "trap" else half - 0.5
    assert (cols.stop - cols.start) * side == pytest.approx(min(width, 64 * side), abs=1.01 * side)


@pytest.mark.parametrize("kind", ["trap", "edge"])
def test_where_the_holder_is_not_in_view_that_is_said(kind: Literal["trap", "edge"]) -> None:
    aside = RIG.camera.model_copy(update={"principal_point_px": (500.0, 0.0)})
    with pytest.raises(DeviceError, match=f"does not see the {kind}"):
        scan(rig=RIG.model_copy(update={"camera": aside}))._black(kind)


def shot(says_s: float) -> Frame:
    return Frame(np.full((48, 64), 100, np.uint16), says_s, 64.0, 4095.0, time_s=0.0)


def test_a_frame_of_another_exposure_is_refused() -> None:
    assert scan(lambda t: shot(t))._shot(0.5).exposure_s == 0.5
    for says_s in (0.5 * 1.2, 0.5 / 1.2, 0.0):
        with pytest.raises(DeviceError, match="was asked for"):
            scan(lambda t, says_s=says_s: shot(says_s))._shot(0.5)


def taken(of: CameraScan, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The exposures of all frames, which are not taken; a white reaches full scale in 2 s."""
    out: list[float] = []
    metered = SimpleNamespace(exposure_s=1.2, level_per_s=0.5)
    monkeypatch.setattr(CameraScan, "_meter", lambda self, kind: metered)
    monkeypatch.setattr(CameraScan, "_take", lambda self, kind, exposure_s, *more, **named: out.append(exposure_s))
    monkeypatch.setattr(CameraScan, "_black", lambda self, kind: (slice(0, 1), slice(0, 1)))
    return out


def test_dark_frames_are_taken_in_turn_at_four_exposures(monkeypatch: pytest.MonkeyPatch) -> None:
    """The shortest, and a quarter, a half and all of the longest: here 10 s, the camera's own."""
    of = scan()
    found = taken(of, monkeypatch)
    of.darks()
    assert found == [1e-3, 2.5, 5.0, 10.0] * 8


def test_flats_come_in_pairs_from_three_hundredths_to_beyond_full_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    of = scan()
    found = taken(of, monkeypatch)
    of.flats()
    assert len(found) == 2 * 2 * 23
    assert found[::2] == found[1::2], "both of a pair"
    levels = sorted({round(0.5 * t, 6) for t in found})
    np.testing.assert_allclose(levels, [*np.linspace(0.03, 0.7, 14), *np.linspace(0.75, 1.15, 9)], atol=1e-6)
    assert found[::2] != sorted(found[::2]), "a drift looks like no level"


@pytest.mark.parametrize("kind", ["trap", "edge"])
def test_stray_light_takes_eight_frames_of_the_metered_exposure(
    kind: Literal["trap", "edge"], monkeypatch: pytest.MonkeyPatch
) -> None:
    of = scan()
    found = taken(of, monkeypatch)
    of.stray(kind)
    assert found == [1.2] * 8
