"""What a rig file may say: limits of its tables, each from both sides, and what follows from them."""

import math
from typing import Any

import pytest
from pydantic import ValidationError

from gonio.config import parse
from gonio.errors import ConfigError
from gonio.lab.rig.description import (
    ArmAxis,
    Body,
    Cable,
    Fiducials,
    Geometry,
    Holder,
    Reference,
    Suspender,
    approach_start,
)
from gonio.lab.rig.health import Reading
from gonio.lab.rig.laboratory import Laboratory, merged
from gonio.lab.rig.light_and_camera import Camera
from gonio.samples.description import SampleDescription
from tests.command_line import some
from tests.gonio.numpy_rig import describe


@pytest.mark.parametrize("count", [3, 8, 20])
def test_markers_fit_where_two_white_rims_have_room_however_they_stand(count: int) -> None:
    """Neighbours on the ring are 2 R sin(pi / n) apart; a square with a rim of a tenth each side has 1.2 sqrt(2) s."""
    marker_mm = 6.0
    ring_mm = 1.2 * math.sqrt(2.0) * marker_mm / (2.0 * math.sin(math.pi / count))
    Fiducials(count=count, marker_mm=marker_mm, ring_mm=1.001 * ring_mm)
    with pytest.raises(ValidationError, match=f"{count} markers of 6 mm do not fit"):
        Fiducials(count=count, marker_mm=marker_mm, ring_mm=0.999 * ring_mm)


def test_markers_keep_off_the_sample() -> None:
    """The corner of a square of 8 mm is 0.75 x 8 = 6 mm from its centre, with its rim; the sample reaches to 10 mm."""
    Holder(sample_diameter_mm=20.0, fiducials=Fiducials(count=4, marker_mm=8.0, ring_mm=16.01))
    with pytest.raises(ValidationError, match="reaches into the sample"):
        Holder(sample_diameter_mm=20.0, fiducials=Fiducials(count=4, marker_mm=8.0, ring_mm=15.99))


def test_an_axis_is_named_once() -> None:
    assert Holder(axes=("spin", "tilt")).axes == ("spin", "tilt")
    with pytest.raises(ValidationError, match="names an axis twice"):
        Holder(axes=("tilt", "tilt"))


@pytest.mark.parametrize(
    ("limits", "stops", "message"),
    [
        ((-10.0, 10.0), None, ""),
        ((-10.0, 10.0), (-10.0, 10.0), ""),
        ((10.0, 10.0), None, "lower < upper"),
        ((11.0, 10.0), None, "lower < upper"),
        ((-10.0, 10.0), (-9.9, 10.0), "must enclose"),
        ((-10.0, 10.0), (-10.0, 9.9), "must enclose"),
    ],
)
def test_limits_are_ordered_and_lie_between_the_stops(
    limits: tuple[float, float], stops: tuple[float, float] | None, message: str
) -> None:
    for make in (
        lambda: ArmAxis(limits_deg=limits, hard_stops_deg=stops),
        lambda: Holder(tilt_limits_deg=limits, tilt_hard_stops_deg=stops),
        lambda: Holder(spin_limits_deg=limits, spin_hard_stops_deg=stops),
    ):
        if not message:
            make()
            continue
        with pytest.raises(ValidationError, match=message):
            make()


@pytest.mark.parametrize(
    ("goal", "approach", "start"),
    [
        (10.0, 2.0, 8.0),
        (-89.0, 2.0, -90.0),  # the limit is in the way
        (-90.0, 2.0, -90.0),
        (-91.0, 2.0, -91.0),  # a goal beyond it is not left
        (10.0, -2.0, 12.0),
        (89.0, -2.0, 90.0),
        (91.0, -2.0, 91.0),
        (10.0, 0.0, 10.0),
    ],
)
def test_the_last_part_of_a_way_begins_inside_the_limits(goal: float, approach: float, start: float) -> None:
    assert approach_start(goal, approach, -90.0, 90.0) == start


def test_each_axis_has_its_own_zero_and_approach_or_the_common_one() -> None:
    rig = describe(
        holder=Holder(axes=("tilt", "spin"), zero_offset_deg=0.5, tilt_zero_offset_deg=-0.25, spin_approach_deg=-3.0)
    )
    assert list(rig.axes()) == ["light", "camera", "tilt", "spin"]
    assert [axis.zero_offset_deg for axis in rig.axes().values()] == [0.0, 0.0, -0.25, 0.5]
    assert rig.approach_deg() == {"light": 1.0, "camera": 1.0, "tilt": 1.0, "spin": -3.0}
    assert (rig.approach_starts_deg("spin", 20.0), rig.approach_starts_deg("tilt", -79.5)) == (23.0, -80.0)
    assert list(describe(holder=Holder(axes=("spin",))).axes()) == ["light", "camera", "spin"]


@pytest.mark.parametrize(
    "tables",
    [
        {"arms": {"light": {"axis_tilt_deg": (0.1, 0.0)}}},
        {"arms": {"camera": {"axis_offset_mm": (0.0, 0.1)}}},
        {"arms": {"camera": {"elevation_deg": 0.1}}},
        {"holder": {"surface_offset_mm": 0.1}},
        {"holder": {"spin_axis_tilt_deg": 0.1}},
        {"holder": {"tilt_axis_offset_mm": 0.1}},
        {"holder": {"surface_tilt_deg": (0.0, 0.1)}},
        {"holder": {"sample_offset_mm": (0.1, 0.0)}},
        {"camera": {"roll_deg": 0.1}},
        {"camera": {"pointing_deg": (0.0, 0.1)}},
    ],
)
def test_any_error_of_alignment_makes_a_rig_other_than_meant(tables: dict[str, Any]) -> None:
    assert describe().as_meant
    assert not describe(**tables).as_meant


def test_a_rig_looks_ahead_where_it_names_bodies_or_cables() -> None:
    body = Body(name="post", on="bench", from_mm=(0, 0, 0), to_mm=(0, 0, 1), radius_mm=5.0)
    cable = Cable(name="usb", from_on="bench", from_mm=(0, 0, 0), to_on="camera", to_mm=(0, 0, 1), length_mm=5.0)
    assert not describe().looks_ahead
    assert describe(bodies=(body,)).looks_ahead
    assert describe(cables=(cable,)).looks_ahead


@pytest.mark.parametrize(
    ("keys", "sound"),
    [
        (("from_mm", "to_mm", "radius_mm"), True),
        (("centre_mm", "size_mm"), True),
        (("from_mm", "to_mm"), False),
        (("centre_mm",), False),
        (("from_mm", "to_mm", "radius_mm", "centre_mm", "size_mm"), False),
        ((), False),
    ],
)
def test_a_body_is_a_capsule_or_a_box(keys: tuple[str, ...], sound: bool) -> None:
    given: dict[str, Any] = {key: 5.0 if key == "radius_mm" else (1.0, 2.0, 3.0) for key in keys}
    if sound:
        Body(name="post", on="bench", **given)
        return
    with pytest.raises(ValidationError, match="a capsule"):
        Body(name="post", on="bench", **given)


def test_a_cable_lies_between_two_parts() -> None:
    with pytest.raises(ValidationError, match='cable "usb": both ends are on "tilt"'):
        Cable(name="usb", from_on="tilt", from_mm=(0, 0, 0), to_on="tilt", to_mm=(0, 0, 1), length_mm=5.0)


def test_a_lens_focuses_on_what_lies_beyond_its_focal_length() -> None:
    camera = Camera(width=64, height=48, focal_length_mm=50.0)
    describe(camera=camera, geometry=Geometry(camera_distance_mm=50.1))
    with pytest.raises(ValidationError, match="cannot focus"):
        describe(camera=camera, geometry=Geometry(camera_distance_mm=50.0))


def test_a_reference_is_linear_between_the_wavelengths_of_its_certificate() -> None:
    white = Reference(spectrum=((500.0, 0.9, 0.01), (600.0, 0.8, 0.03)))
    assert white.at(500.0) == (0.9, 0.01)
    assert white.at(525.0) == pytest.approx((0.875, 0.015))
    assert white.at(600.0) == pytest.approx((0.8, 0.03))
    for beyond in (499.9, 600.1):
        with pytest.raises(ConfigError, match="certifies 500 to 600 nm"):
            white.at(beyond)
    assert Reference(albedo=0.95, u_rel=0.02).at(2000.0) == (0.95, 0.02)


@pytest.mark.parametrize("given", [{"albedo": 0.0}, {"spectrum": ((500.0, 0.0, 0.01),)}])
def test_a_white_that_reflects_nothing_is_refused_before_it_is_measured(given: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match="greater than 0"):
        Reference.model_validate(given)


@pytest.mark.parametrize(("how", "attenuation"), [("beam", None), ("swap", 0.5)])
def test_a_beam_and_its_attenuation_go_together(how: str, attenuation: float | None) -> None:
    Reference(how="beam", attenuation=0.5)
    with pytest.raises(ValidationError, match="go together"):
        Reference.model_validate({"how": how, "attenuation": attenuation})


# ---- what pauses a run ----


def test_a_rule_has_one_threshold() -> None:
    for keys in ({}, {"above": 1.0, "below": 0.0}, {"above": 1.0, "unless": "locked"}):
        with pytest.raises(ValidationError, match="one of above, below and unless"):
            Suspender.model_validate({"quantity": "temperature"} | keys)


@pytest.mark.parametrize(
    ("quantity", "device", "sound"),
    [("temperature", "camera", True), ("temperature", "lamp", False), ("monitor", None, False), ("lock", None, False)],
)
def test_what_needs_light_is_not_watched_in_the_dark(quantity: str, device: str | None, sound: bool) -> None:
    Suspender(quantity=quantity, device=device, above=1.0)
    if sound:
        Suspender(quantity=quantity, device=device, above=1.0, dark=True)
        return
    with pytest.raises(ValidationError, match="cannot be seen in the dark"):
        Suspender(quantity=quantity, device=device, above=1.0, dark=True)


def test_a_rule_concerns_its_quantity_and_the_extreme_on_its_side() -> None:
    hot, weak = Suspender(quantity="temperature", above=60.0), Suspender(quantity="load", device="light", below=11.0)
    assert hot.concerns(Reading("light", "temperature", 50.0, "C"))
    assert hot.concerns(Reading("camera", "temperature_max", 50.0, "C"))
    assert not hot.concerns(Reading("light", "temperature_min", 50.0, "C"))
    assert not hot.concerns(Reading("light", "load", 50.0, "C"))
    assert weak.concerns(Reading("light", "load_min", 5.0, ""))
    assert not weak.concerns(Reading("light", "load_max", 5.0, ""))
    assert not weak.concerns(Reading("camera", "load", 5.0, ""))


def test_badness_grows_beyond_the_threshold() -> None:
    hot, weak = Suspender(quantity="temperature", above=60.0), Suspender(quantity="load", below=11.0)
    assert hot.badness(Reading("light", "temperature", 70.0, "C")) == 70.0
    assert weak.badness(Reading("light", "load", 5.0, "")) == -5.0
    assert weak.badness(Reading("light", "load", "lost", "")) == math.inf


@pytest.mark.parametrize(
    ("value", "unit", "good"),
    [
        (60.0, "C", True),
        (60.1, "C", False),
        (-0.1, "C", False),
        (60.24, "deg", True),  # an axis may have landed a quarter of a degree beyond
        (60.26, "deg", False),
        (-0.24, "deg", True),
        (-0.26, "deg", False),
        ("hot", "C", True),
    ],
)
def test_a_reading_is_good_within_its_limits(value: float | str, unit: str, good: bool) -> None:
    assert Reading("light", "angle", value, unit, limit=(0.0, 60.0)).good is good
    assert Reading("light", "angle", value, unit).good


# ---- samples ----


def test_textures_lie_between_their_low_and_high() -> None:
    sample = SampleDescription.model_validate(
        {
            "name": "cloth", "model": "lambert", "parameters": {"albedo": 0.5},
            "texture": {"albedo": {"pattern": "edge", "low": 0.2, "high": 0.8}},
        }
    )  # fmt: skip
    assert sample.parameters_at({"albedo": 0.25}) == {"albedo": pytest.approx(0.35)}


def test_what_a_laboratory_states_is_laid_over_key_by_key() -> None:
    below, above = (parse(Laboratory, {"sample": stated}, "a.toml") for stated in (
        {"name": "a", "width_mm": 1.0}, {"name": "b", "height_mm": 1.0},
    ))  # fmt: skip
    assert some(merged(below, above)).stated() == {"sample": {"name": "b", "width_mm": 1.0, "height_mm": 1.0}}
    assert (merged(None, above), merged(below, None), merged(None, None)) == (above, below, None)


def test_a_range_of_wavelengths_rises() -> None:
    for wrong in ([2000.0, 250.0], [250.0, 250.0]):
        with pytest.raises(ConfigError, match=r"lamp_range_nm.*the shortest wavelength comes first"):
            parse(Laboratory, {"instrument": {"lamp_range_nm": wrong}}, "rig.toml")
    parse(Laboratory, {"instrument": {"lamp_range_nm": [250.0, 2000.0]}}, "rig.toml")
