"""Configuration: what a user mistypes is named with its file, key, value and remedy."""

from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field

from gonio.config import Strict, load, parse, read_toml
from gonio.errors import ConfigError
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Bands

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


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"lamp": {"half_angel_deg": 0.5}}, 'unknown key lamp.half_angel_deg; did you mean "half_angle_deg"?'),
        (
            {"arms": {"light": {"encoder_step": 0.1}}},
            'unknown key arms.light.encoder_step; did you mean "encoder_step_deg"?',
        ),
        ({"lamp": {"noise": "0.5"}}, "lamp.noise = '0.5': must be a number, not text"),
        ({"lamp": {"noise": True}}, "lamp.noise = True: must be a number, not true or false"),
        (
            {"arms": {"camera": {"limits_deg": ["0.5", 80]}}},
            "arms.camera.limits_deg = ['0.5', 80]: must be a number, not text",
        ),
        (
            {"arms": {"camera": {"limits_deg": [True, 80]}}},
            "arms.camera.limits_deg = [True, 80]: must be a number, not true or false",
        ),
        ({"arms": {"camera": {"limits_deg": []}}}, "arms.camera.limits_deg = []: its entry 1 is missing"),
    ],
)
def test_a_wrong_key_or_value_is_one_message(values: dict[str, object], told: str) -> None:
    assert message(RIG | values) == f"bench.toml: {told}"


def test_missing_key() -> None:
    assert message({"rig": "sim", "bands": RIG["bands"]}) == "bench.toml: the key name is missing"


class Inner(Strict):
    """A table inside another."""

    a: float = 1.0


class Kinds(Strict):
    """A key of each kind."""

    angles: tuple[float, ...] = ()
    pair: tuple[float, float] = (1, 2)
    some: Annotated[tuple[float, ...], Field(min_length=1)] = (1.0,)
    text: str = ""
    yes: bool = False
    count: int = 0
    number: float = 0.0
    by_name: dict[str, float] | None = None
    inner: Inner = Inner()
    many: tuple[Inner, ...] = ()
    ior: str | float | tuple[float, float] | None = None


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"angles": 5}, "angles = 5: must be a list in square brackets"),
        ({"angles": {"from": 5}}, "angles: must be a list in square brackets (it is a table)"),
        ({"pair": [1, 2, 3]}, "pair = [1, 2, 3]: must hold at most 2, and holds 3"),
        ({"pair": list(range(9999))}, f"pair = {str(list(range(40)))[:100]}...: must hold at most 2, and holds 9999"),
        ({"some": []}, "some = []: must hold at least 1, and holds 0"),
        ({"text": 5}, "text = 5: must be text in quotes"),
        ({"yes": 5}, "yes = 5: must be true or false"),
        ({"count": 1.5}, "count = 1.5: must be a whole number"),
        ({"number": {"a": 1}}, "number: must be a number (it is a table)"),
        ({"number": float("nan")}, "number = nan: must be a finite number"),
        ({"by_name": 5}, "by_name = 5: must be a table"),
        ({"by_name": {"x": [1]}}, "by_name.x = [1]: must be a number"),
        ({"inner": 5}, "inner = 5: must be a table"),
        ({"many": {"a": 1}}, "many: must be a list of tables, each below [[many]]"),
        ({"many": [5]}, "many[1] = 5: must be a table"),
        ({"ior": float("nan")}, "ior = nan: must be text in quotes or a finite number or a list in square brackets"),
    ],
)
def test_a_value_of_another_kind_is_one_message_in_words_of_toml(values: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(Kinds, values, "x.toml")
    assert str(caught.value) == f"x.toml: {told}"


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"geometry": {"zzz": 1}}, ["geometry.zzz", "light_distance_mm"]),  # far from any: the known ones are listed
        ({"lamp": {"noise": -0.1}}, ["lamp.noise = -0.1", "greater than or equal to 0"]),
        ({"camera": {"read_noise_e": float("nan")}}, ["camera.read_noise_e"]),
        ({"bands": {}}, ["at least one band"]),
        ({"arms": {"camera": {"limits_deg": [80, -80]}}}, ["arms.camera", "lower < upper"]),
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
def test_values_out_of_range_and_keys_that_contradict_each_other(table: dict[str, object], words: list[str]) -> None:
    text = message(RIG | table)
    for word in ("bench.toml", *words):
        assert word in text


def test_every_wrong_key_is_reported_at_once() -> None:
    assert len(message(RIG | {"lamp": {"a": 1, "b": 2}, "camera": {"c": 3}}).splitlines()) == 3


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (None, "there is no such file"),
        (b'name = "x"\n[[oops\n', r"odd\.toml: is not valid TOML.*line 2"),
        (b"a = \xff\xfe", "is not UTF-8"),
        (b"a = " + b"9" * 10_000, r"odd\.toml: is not valid TOML: .*digits"),
        (
            b'name = "s"\n[parameters]\nalbedo = [0.1, ' + b"1" * 400 + b"]\n",
            r"odd\.toml: parameters\.albedo\[2\] has 400 digits: at most 18 are read",
        ),
    ],
)
def test_what_is_no_toml_is_named(tmp_path: Path, content: bytes | None, told: str) -> None:
    if content is not None:
        (tmp_path / "odd.toml").write_bytes(content)
    with pytest.raises(ConfigError, match=told):
        load(RigDescription, tmp_path / "odd.toml")


def test_a_file_that_is_not_there_may_be_misspelt(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").touch()
    with pytest.raises(ConfigError, match=r'benhc\.toml: there is no such file; did you mean "bench\.toml"\?'):
        read_toml(tmp_path / "benhc.toml")


def test_folder_instead_of_a_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_toml(tmp_path)


def test_tunable_bands_and_the_one_that_contains_a_wavelength() -> None:
    bands = parse(RigDescription, RIG, "bench.toml").bands
    assert (len(bands.all()), bands.all()[-1].centre_nm, bands.containing(503.0).centre_nm) == (31, 700, 500)
    assert bands.containing(700.0).centre_nm == 700
    with pytest.raises(ConfigError, match="wavelength_nm = 800 lies in no band"):
        bands.containing(800.0)


def test_gap_between_bands_is_said() -> None:
    bands = Bands.model_validate({"list": [{"name": "green", "centre_nm": 550, "fwhm_nm": 20}]})
    with pytest.raises(
        ConfigError, match=r"wavelength_nm = 600 lies in no band of the rig; it has: green \(540 to 560 nm\)"
    ):
        bands.containing(600)


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
