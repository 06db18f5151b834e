"""Configuration: what a user mistypes is named with its file, key, value and remedy."""

from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field

from gonio.config import Strict, load, parse, read_toml
from gonio.errors import ConfigError
from gonio.rig.bands import Bands
from gonio.rig.description import RigDescription

RIG: dict[str, Any] = {
    "rig": "sim",
    "name": "bench",
    "bands": {"tunable": {"start_nm": 400, "stop_nm": 700, "step_nm": 10, "fwhm_nm": 10}},
}


def message(values: dict[str, object]) -> str:
    with pytest.raises(ConfigError) as caught:
        parse(RigDescription, values, "bench.toml")
    assert caught.value.exit_code == 2
    return str(caught.value)


def test_unknown_key_names_the_nearest_one() -> None:
    assert message(RIG | {"lamp": {"half_angel_deg": 0.5}}) == (
        'bench.toml: unknown key lamp.half_angel_deg; did you mean "half_angle_deg"?'
    )


def test_unknown_key_in_an_arm_of_a_pair() -> None:
    text = message(RIG | {"arms": {"light": {"encoder_step": 0.1}}})
    assert text == 'bench.toml: unknown key arms.light.encoder_step; did you mean "encoder_step_deg"?'


def test_unknown_key_far_from_any_lists_the_known_ones() -> None:
    text = message(RIG | {"geometry": {"zzz": 1}})
    assert "geometry.zzz" in text
    assert "light_distance_mm" in text


def test_missing_key() -> None:
    assert message({"rig": "sim", "bands": RIG["bands"]}) == "bench.toml: the key name is missing"


def test_value_out_of_range_shows_key_value_and_limit() -> None:
    text = message(RIG | {"lamp": {"noise": -0.1}})
    assert "lamp.noise = -0.1" in text
    assert "greater than or equal to 0" in text


@pytest.mark.parametrize(("value", "said"), [("0.5", "not text"), (True, "not true or false")])
def test_text_and_true_are_no_numbers(value: Any, said: str) -> None:
    assert message(RIG | {"lamp": {"noise": value}}) == f"bench.toml: lamp.noise = {value!r}: must be a number, {said}"
    limits = message(RIG | {"arms": {"camera": {"limits_deg": [value, 80]}}})
    assert limits == f"bench.toml: arms.camera.limits_deg = {[value, 80]!r}: must be a number, {said}"


def test_a_list_that_is_too_short_is_one_message() -> None:
    text = message(RIG | {"arms": {"camera": {"limits_deg": []}}})
    assert text == "bench.toml: arms.camera.limits_deg = []: its entry 1 is missing"


def test_reversed_limits() -> None:
    text = message(RIG | {"arms": {"camera": {"limits_deg": [80, -80]}}})
    assert "arms.camera" in text
    assert "lower < upper" in text


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"holder": {"tilt_limits_deg": [10, -10]}}, ["holder", "tilt_limits_deg", "lower < upper"]),
        ({"holder": {"axes": ["tilt", "tilt"]}}, ["holder", "axes", "twice"]),
        ({"camera": {"exposure_limits_s": [60, 1e-5]}}, ["camera", "exposure_limits_s", "shortest < longest"]),
        ({"camera": {"black_level_dn": 300, "bits": 8}}, ["camera", "black_level_dn = 300", "255"]),
        ({"camera": {"focal_length_mm": 2000}}, ["focal_length_mm = 2000", "camera_distance_mm = 1000", "focus"]),
        ({"bands": {"tunable": RIG["bands"]["tunable"] | {"step_nm": 1e-9}}}, ["bands.tunable", "larger step_nm"]),
        ({"bands": {"tunable": RIG["bands"]["tunable"] | {"stop_nm": 300}}}, ["bands.tunable", "start_nm <= stop_nm"]),
        ({"bands": {"list": [{"name": "g", "centre_nm": 550, "fwhm_nm": 9}] * 2}}, ["bands", "two bands", '"g"']),
    ],
)
def test_keys_that_contradict_each_other(table: dict[str, object], words: list[str]) -> None:
    text = message(RIG | table)
    for word in ("bench.toml", *words):
        assert word in text


def test_nan_is_refused() -> None:
    assert "camera.read_noise_e" in message(RIG | {"camera": {"read_noise_e": float("nan")}})


def test_every_wrong_key_is_reported_at_once() -> None:
    assert len(message(RIG | {"lamp": {"a": 1, "b": 2}, "camera": {"c": 3}}).splitlines()) == 3


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is no such file"):
        read_toml(tmp_path / "nope.toml")


def test_folder_instead_of_a_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_toml(tmp_path)


def test_broken_toml_names_the_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_text('name = "x"\n[[oops\n')
    with pytest.raises(ConfigError, match=r"broken.toml: is not valid TOML.*line 2"):
        load(RigDescription, path)


def test_binary_instead_of_toml(tmp_path: Path) -> None:
    path = tmp_path / "junk.toml"
    path.write_bytes(b"a = \xff\xfe")
    with pytest.raises(ConfigError, match="is not UTF-8"):
        read_toml(path)


def test_tunable_bands_and_the_one_that_contains_a_wavelength() -> None:
    bands = parse(RigDescription, RIG, "bench.toml").bands
    assert len(bands.all()) == 31
    assert bands.all()[-1].centre_nm == 700
    assert bands.containing(503.0).centre_nm == 500
    assert bands.containing(700.0).centre_nm == 700
    with pytest.raises(ConfigError, match="wavelength_nm = 800 lies in no band"):
        bands.containing(800.0)


def test_gap_between_bands_is_said() -> None:
    bands = Bands.model_validate({"list": [{"name": "green", "centre_nm": 550, "fwhm_nm": 20}]})
    with pytest.raises(ConfigError, match="wavelength_nm = 600 lies in no band of the rig; it has: green"):
        bands.containing(600)


def test_a_rig_without_bands_is_refused() -> None:
    assert "at least one band" in message({"rig": "sim", "name": "x", "bands": {}})


def test_a_byte_order_mark_is_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "notepad.toml"
    path.write_bytes(b"\xef\xbb\xbf" + b'name = "x"\r\n')
    assert read_toml(path) == {"name": "x"}


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 100_000 + "]" * 100_000,
        "a = " + "{b = " * 100_000 + "1" + "}" * 100_000,
        ".".join(["a"] * 100_000) + " = 1",
        "[" + " . ".join(["a"] * 100_000) + "]",
        "a = " + "[" * 40 + "]" * 40,
        ".".join(["a"] * 40) + " = 1",
    ],
    ids=["lists", "tables", "key", "heading", "a few lists", "a few keys"],
)
def test_deep_nesting_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "deep.toml").write_text(text)
    with pytest.raises(ConfigError, match=r"deep\.toml: is nested too deeply: at most 32 levels"):
        read_toml(tmp_path / "deep.toml")


def test_a_number_of_thousands_of_digits_is_refused(tmp_path: Path) -> None:
    (tmp_path / "long.toml").write_text("a = " + "9" * 10_000)
    with pytest.raises(ConfigError, match=r"long\.toml: is not valid TOML: .*digits"):
        read_toml(tmp_path / "long.toml")


def test_prose_is_no_long_key(tmp_path: Path) -> None:
    prose = "e.g. a sentence. And i.e. one more, " * 200 + "x" * 100_000
    (tmp_path / "prose.toml").write_text(f'name = "{prose}"\n')
    assert read_toml(tmp_path / "prose.toml") == {"name": prose}


class Round(Strict):
    kind: Literal["round"]
    radius: float
    finish: Literal["matte", "gloss"] = "matte"


class Square(Strict):
    kind: Literal["square"]
    side: float


class Shapes(Strict):
    shape: list[Annotated[Round | Square, Field(discriminator="kind")]]


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"kind": "round", "radius": "x"}, "shape[1].radius = 'x': "),
        ({"kind": "square"}, "the key shape[1].side is missing"),
        ({"kind": "square", "side": 1, "sid": 2}, 'unknown key shape[1].sid; did you mean "side"?'),
        ({"kind": "square", "side": 1, "radius": 2}, "unknown key shape[1].radius; known here: kind, side"),
        ({"kind": "sqare", "side": 1}, "shape[1].kind = 'sqare': is unknown; did you mean \"square\"?"),
        ({"kind": "?"}, "shape[1].kind = '?': is unknown; known here: round, square"),
        ({"side": 1}, "the key shape[1].kind is missing; known here: round, square"),
    ],
)
def test_a_table_of_several_kinds_is_named_as_the_file_has_it(values: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError) as told:
        parse(Shapes, {"shape": [values]}, "scene.toml")
    assert str(told.value).startswith(f"scene.toml: {says}")


def test_a_number_of_hundreds_of_digits_is_one_message(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(f'name = "s"\n[parameters]\nalbedo = [0.1, {"1" * 400}]\n')
    with pytest.raises(ConfigError, match=r"s\.toml: parameters\.albedo\[2\] has 400 digits: at most 18 are read"):
        read_toml(tmp_path / "s.toml")
