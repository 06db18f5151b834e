"""Arguments, shapes, threads and start-up of the evaluation engine, on models whose digits other tests hold."""

import inspect
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.errors import ArgumentError
from gonio.models import (
    GGX,
    AnisotropicFacets,
    Blinn,
    CookTorrance,
    Corrected,
    Hapke,
    HeTorrance,
    Lambert,
    OrenNayar,
    Phong,
    Retroreflecting,
    Sum,
    _loops,
    build,
    engine,
    fresnel,
    geometry,
)
from gonio.models._compile import _loop
from gonio.models.model import Model
from gonio.models.parameters import Levels
from tests.gonio.models.agreement import drawn_vectors

MODEL = CookTorrance()
RNG = np.random.default_rng(5)


pairs = partial(drawn_vectors, RNG)


@pytest.mark.parametrize("kind", [Model, Blinn, Corrected, CookTorrance, HeTorrance, Hapke, Sum])
def test_green_light_is_meant_where_no_wavelength_is_named(kind: type[Model]) -> None:
    told = [inspect.signature(one).parameters for _, one in inspect.getmembers(kind, inspect.isfunction)]
    wavelengths = {names["wavelength_nm"].default for names in told if "wavelength_nm" in names}
    assert 550.0 in wavelengths <= {550.0, inspect.Parameter.empty}


def test_scalars_give_scalars_and_shapes_broadcast() -> None:
    assert isinstance(MODEL.brdf(0.1, 0.0, 0.2, 1.0), np.float64)
    assert MODEL.at(geometry(0.1, 0.0, 0.2, 0.3)) == pytest.approx(float(MODEL.brdf(0.1, 0.0, 0.2, 0.3)), rel=1e-14)
    assert MODEL.brdf(np.zeros((3, 1)), 0.0, np.zeros(4), 1.0).shape == (3, 4)
    assert MODEL.brdf(np.zeros((2, 1)), np.zeros((1, 3)), 0.1, np.zeros((4, 1, 1))).shape == (4, 2, 3)
    light, view = pairs(6)
    assert MODEL.brdf_vectors(light[0], view).shape == (6,)
    assert MODEL.brdf_vectors(light.reshape(2, 3, 3), view[0]).shape == (2, 3)
    assert isinstance(MODEL.brdf_vectors(light[0], view[0]), np.float64)


def test_broadcasting_changes_no_digit() -> None:
    theta, phi = np.linspace(0.0, 1.5, 7), np.linspace(0.0, 6.0, 5)
    grid = MODEL.brdf(theta[:, None], 0.2, 0.4, phi)
    # a vector loop and its remainder contract products differently: one unit in the last place a factor
    np.testing.assert_allclose(grid, [[MODEL.brdf(t, 0.2, 0.4, p) for p in phi] for t in theta], rtol=1e-14)


@pytest.mark.parametrize("shape", [(0,), (3, 0), (0, 4)])
def test_empty_arrays(shape: tuple[int, ...]) -> None:
    assert MODEL.brdf(np.zeros(shape), 0.0, 0.1, 0.2).shape == shape
    assert MODEL.brdf_vectors(np.zeros((*shape, 3)), [0.0, 0.0, 1.0]).shape == shape
    with pytest.raises(ArgumentError, match="theta_r"):
        MODEL.brdf(np.zeros(shape), 0.0, 9.0, 0.2)


def test_kinds_of_arrays() -> None:
    light, view = pairs(500)
    expected = MODEL.brdf_vectors(light, view)
    frozen = light.copy()
    frozen.flags.writeable = False
    for other in (
        frozen,
        np.asfortranarray(light),
        np.repeat(light, 2, axis=0)[::2],
        light[::-1][::-1],
        light.astype(">f8"),
        np.frombuffer(b"x" + light.tobytes(), dtype=np.uint8)[1:].view(np.float64).reshape(-1, 3),
    ):
        np.testing.assert_array_equal(MODEL.brdf_vectors(other, view), expected)
    single = light.astype(np.float32)
    # float32 components are computed in float64 after taking their length out: the result for the rounded directions
    exact = single.astype(np.float64)
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    np.testing.assert_allclose(MODEL.brdf_vectors(single, view), MODEL.brdf_vectors(exact, view), rtol=1e-9)
    assert MODEL.brdf(np.float32(0.5), 0, 1, 2).dtype == np.float64
    np.testing.assert_array_equal(MODEL.brdf([0, 1], 0, 1, 2), MODEL.brdf(np.array([0.0, 1.0]), 0.0, 1.0, 2.0))


def test_large_arrays_are_split_over_threads_without_a_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "threads", lambda: 3)
    monkeypatch.setattr(engine, "_pool", None)
    light, view = pairs(3 * engine.SPLIT + 17)
    np.testing.assert_array_equal(MODEL.brdf_vectors(light, view)[-40:], MODEL.brdf_vectors(light[-40:], view[-40:]))
    light[-1] = np.nan  # in the last thread's part
    with pytest.raises(ArgumentError, match="omega_i"):
        MODEL.brdf_vectors(light, view)


def test_a_thread_that_is_alone_splits_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gonio.platform.processors", lambda: 3)
    light, view = pairs(3 * engine.SPLIT)
    expected, parts = MODEL.brdf_vectors(light, view), list[tuple[int, int]]()
    with engine.alone():
        engine.in_parts(lambda start, stop: parts.append((start, stop)), 3 * engine.SPLIT)
        np.testing.assert_array_equal(MODEL.brdf_vectors(light, view), expected)
    assert parts == [(0, 3 * engine.SPLIT)]
    assert engine.threads() == 3


THREADS = """
import os, threading
import numpy as np
from gonio.models import Blinn
model, theta = Blinn(), np.linspace(0.0, 1.5, 400_000)
out = []
workers = [threading.Thread(target=lambda: out.append(model.brdf(theta, 0.0, 0.3, 2.0))) for _ in range(3)]
[w.start() for w in workers]; [w.join() for w in workers]
assert len(out) == 3 and all(np.array_equal(o, out[0]) for o in out)
if hasattr(os, "fork"):
    child = os.fork()
    if child == 0:
        os._exit(0 if np.array_equal(model.brdf(theta, 0.0, 0.3, 2.0), out[0]) else 9)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
"""


@pytest.mark.parametrize("layer", ["workqueue", "default"])
def test_threads_and_a_fork_under_any_numba_threading_layer(layer: str) -> None:
    # Python 3.12 warns about a fork of a threaded process: it is what is tested
    environment = {**os.environ, "NUMBA_THREADING_LAYER": layer, "PYTHONWARNINGS": "ignore"}
    done = subprocess.run([sys.executable, "-c", THREADS], env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr


def test_importing_the_models_imports_no_numba() -> None:
    code = "import sys, gonio.models; assert not {'numba', 'scipy', 'pandas', 'matplotlib'} & set(sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr


def test_whole_registers_are_asked_for_unless_somebody_says_otherwise() -> None:
    said = "from gonio.compiled import numba; print(numba.config.CPU_FEATURES)"
    features = []
    for given in ({}, {"NUMBA_CPU_FEATURES": "+sse2"}):
        done = subprocess.run(
            [sys.executable, "-c", said], env=os.environ | given, capture_output=True, text=True, timeout=600
        )
        features.append(done.stdout.strip())
    assert features[0].endswith(",-prefer-256-bit")
    assert features[1] == "+sse2"


@pytest.mark.slow
@pytest.mark.parametrize("model", [MODEL, Blinn(distribution="phong"), OrenNayar()], ids=["exp2", "log", "Oren-Nayar"])
def test_loops_over_kernels_are_vectors(model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import numba

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))  # code that comes from the disk cannot be looked at
    kernel, constants = model._evaluation(550.0)
    (code,) = _loop(_loops.over_vectors, kernel, len(constants)).inspect_llvm().values()
    assert re.search(r"fdiv [a-z ]*<\d+ x double>", code)


@pytest.mark.slow
def test_loops_over_columns_and_in_float32_are_vectors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import numba

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    kernel, constants = MODEL._evaluation(550.0)
    (code,) = _loop(_loops.at_4, kernel, len(constants)).inspect_llvm().values()
    assert re.search(r"fdiv [a-z ]*<\d+ x double>", code)
    (code,) = _loop(_loops.over_vectors, kernel, len(constants), in_single=True).inspect_llvm().values()
    assert re.search(r"fdiv [a-z ]*<\d+ x float>", code)  # how wide, the processor says
    assert "double" not in code.split("define", 1)[1].split("}", 1)[0]  # nothing is widened on the way


BAD_ANGLES = [
    ("theta_i", (float("nan"), 0.0, 0.1, 0.0)),
    ("theta_i", (-1e-9, 0.0, 0.1, 0.0)),
    ("theta_r", (0.1, 0.0, [0.1, 1.6], 0.0)),
    ("phi_i", (0.1, float("inf"), 0.1, 0.0)),
    ("phi_r", (0.1, 0.0, 0.1, [0.0, float("nan")])),
    ("theta_i", (1j, 0.0, 0.1, 0.0)),
    ("theta_i", ("steep", 0.0, 0.1, 0.0)),
    ("theta_i", (None, 0.0, 0.1, 0.0)),
    ("theta_i", ([[0.1], [0.1, 0.2]], 0.0, 0.1, 0.0)),
    ("theta_i", (np.zeros(3), np.zeros(2), 0.1, 0.0)),
]


@pytest.mark.parametrize(("name", "angles"), BAD_ANGLES)
def test_bad_angles_are_named(name: str, angles: tuple[float, ...]) -> None:
    for model in (MODEL, OrenNayar(form="exact"), OrenNayar(form="single-slope", slope_deg=20, groove_azimuth_deg=0)):
        with pytest.raises(ArgumentError, match=name):
            model.brdf(*angles)
    with pytest.raises(ArgumentError, match=name):
        geometry(*angles)


def test_bad_vectors_are_named() -> None:
    up = [0.0, 0.0, 1.0]
    for bad in (
        [0.0, 0.0, 1.001],
        [0.0, 0.0, 0.0],
        [np.nan, 0.0, 1.0],
        [0.0, 1.0],
        1.0,
        [[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]],
    ):
        with pytest.raises(ArgumentError, match="omega_i"):
            MODEL.brdf_vectors(bad, up)
        with pytest.raises(ArgumentError, match="omega_r"):
            MODEL.brdf_vectors(up, bad)


def test_below_the_surface_nothing_is_reflected() -> None:
    closed = (MODEL, Lambert(), Phong(), Blinn(), OrenNayar(), OrenNayar(form="exact"), AnisotropicFacets())
    for model in (*closed, HeTorrance(diffuse_albedo=0.5)):
        below = model.brdf_vectors(
            [[0.6, 0.0, -0.8], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], [[0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [0.0, 0.0, -1.0]]
        )
        np.testing.assert_array_equal(below, 0.0)


def test_wavelengths_broadcast() -> None:
    model = CookTorrance(ior=lambda nm: complex(nm / 400.0, 1.0))
    waves = np.array([400.0, 500.0, 400.0])
    expected = [model.brdf(0.3, 0.0, 0.4, 2.0, wavelength_nm=w) for w in waves]
    # the same loop, in parts
    np.testing.assert_allclose(model.brdf(0.3, 0.0, 0.4, 2.0, wavelength_nm=waves), expected, rtol=1e-15)
    with pytest.raises(ArgumentError, match="wavelength_nm"):
        model.brdf(0.3, 0.0, 0.4, 2.0, wavelength_nm=-1.0)
    with pytest.raises(ArgumentError, match="wavelength_nm"):
        model.brdf(0.3, 0.0, 0.4, 2.0, wavelength_nm=[[500.0], [600.0, 700.0]])


@pytest.mark.parametrize(
    ("name", "parameters", "said"),
    [
        ("lambert", {"albedo": 1.5}, "albedo"),
        ("lambert", {"albdo": 0.5}, 'did you mean "albedo"'),
        ("lambert", {"albedo": "white"}, "albedo"),
        ("phong", {"exponent": -1}, "exponent"),
        ("phong", {"k_d": float("nan")}, "k_d"),
        ("blinn", {"distribution": "gausian"}, 'did you mean "gaussian"'),
        ("blinn", {"c": 0.0}, "c = 0"),
        ("blinn", {"c": 1.5}, "c = 1.5"),
        ("blinn", {"c": 0.5, "beta_deg": 10}, "beta_deg"),
        ("blinn", {"beta_deg": 90}, "beta_deg"),
        ("blinn", {"distribution": np.zeros(3)}, "distribution"),
        ("blinn", {"fresnel": "schlick"}, "fresnel"),
        ("cook-torrance", {"slopes": [[-0.1, 1.0]]}, "slopes"),
        ("cook-torrance", {"slopes": []}, "slopes"),
        ("cook-torrance", {"slopes": [[0.1, 0.5]]}, "weights"),
        ("cook-torrance", {"ior": -1.0}, "ior"),
        ("cook-torrance", {"ior": [1.0, -1.0]}, "ior"),
        ("cook-torrance", {"ior": True}, "ior"),
        ("cook-torrance", {"ior": "Unobtainium"}, "Unobtainium"),
        ("cook-torrance", {"f0": 1.0}, "f0"),
        ("cook-torrance", {"f0": 0.04, "ior": 1.5}, "f0"),
        ("cook-torrance", {"s": 0.8, "d": 0.3}, r"s \+ d"),
        ("cook-torrance", {"convention": "printed"}, "convention"),
        ("oren-nayar", {"sigma_deg": -1}, "sigma_deg"),
        ("oren-nayar", {"form": "single-slope"}, "slope_deg"),
        ("oren-nayar", {"slope_deg": 20}, "slope_deg"),
        ("oren-nayar", {"mean_slope_deg": 20}, 'mean_slope_deg belongs to form="exact", not to "functional"'),
        ("oren-nayar", {"form": "approximate"}, "form"),
        ("anisotropic", {"alpha_along": 0.0}, "alpha_along"),
        ("anisotropic", {"alpha_across": 11.0}, "alpha_across"),
        ("anisotropic", {"s": 1.1}, "s = "),
        ("anisotropic", {"diffuse_albedo": -0.1}, "diffuse_albedo"),
        ("retroreflecting", {"returned": 1.1}, "returned"),
        ("retroreflecting", {"width_deg": 0.0}, "width_deg"),
        ("retroreflecting", {"tail": 0.1}, "tail"),
        ("retroreflecting", {"entrance": -1.0}, "entrance"),
    ],
)
def test_bad_parameters_are_named(name: str, parameters: dict[str, Any], said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        build(name, parameters)


@pytest.mark.parametrize("value", ["1.5", [1.0, 2.0], None, float("nan"), True])
def test_an_index_function_that_gives_no_index_is_named(value: Any) -> None:
    with pytest.raises(ArgumentError, match="ior at 550 nm"):
        CookTorrance(ior=lambda nm: value).brdf(0.1, 0.0, 0.2, 0.3)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: HeTorrance().specular_reflectivity(np.zeros(3), wavelength_nm=np.full(2, 500.0)), "theta_i"),
        (lambda: fresnel.amplitudes(np.zeros(3), np.full(2, 1.5)), "cos_theta"),
        (lambda: fresnel.amplitudes(0.5, [[1.5], [1.5, 2.0]]), "ior"),
        (lambda: fresnel.colour_shift(0.5, 0.5, [np.nan], [1.0]), "colour_0"),
        (lambda: fresnel.colour_shift(0.5, 0.5, [1.0, 1.0, 1.0], [1.0, 1.0]), "colour_90"),
        (lambda: Blinn.textured_d3(np.zeros(3), 0.5, np.zeros(2)), "cos_alpha"),
    ],
)
def test_bad_arrays_are_named(call: Callable[[], object], said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        call()


@pytest.mark.parametrize(
    "model",
    [
        Lambert(0.3),
        Phong(),
        Blinn(distribution="gaussian", beta_deg=20),
        CookTorrance(f0=0.04, convention="normalised"),
        CookTorrance(ior="Cu"),
        OrenNayar(form="single-slope", slope_deg=20, groove_azimuth_deg=30),
    ],
    ids=repr,
)
def test_a_model_is_rebuilt_from_its_parameters(model: Model) -> None:
    assert build(model.name, model.parameters) == model
    assert model.convention.endswith(".")
    assert repr(model).startswith(type(model).__name__)


def test_masked_values_are_refused_and_not_computed_with() -> None:
    """numpy would go on with what lies under the mask, and drop the mask."""
    from gonio import materials
    from gonio.formats.reader import table
    from gonio.instrument import apparent_brdf
    from gonio.models import Lambert, fresnel, geometry

    some, none = np.ma.array([0.1, 0.2], mask=[False, True]), np.ma.array([0.1, 0.2])
    model = Lambert(0.5)
    assert np.all(model.brdf(none, 0.0, 0.3, 0.0) == model.brdf(none.data, 0.0, 0.3, 0.0))
    cones: dict[str, Any] = {"source_solid_angle_sr": 1e-4, "receiver_solid_angle_sr": 1e-4}
    calls: dict[str, Callable[[], object]] = {
        "theta_r": lambda: model.brdf(0.1, 0.0, some, 0.0),
        "phi_i": lambda: geometry(0.1, some, 0.1, 0.0),
        "omega_i": lambda: model.brdf_vectors(np.ma.array([0.0, 0.0, 1.0], mask=[True, False, False]), [0.0, 0.0, 1.0]),
        "wavelength_nm": lambda: model.brdf(0.1, 0.0, 0.2, 0.0, wavelength_nm=np.ma.array([500.0], mask=[True])),
        "theta_i": lambda: apparent_brdf(model, some, 0.0, 0.1, 0.0, wavelength_nm=550.0, **cones),
        "cos_theta": lambda: fresnel.amplitudes(some, 1.5),
        "albedo": lambda: Lambert(np.ma.masked),  # type: ignore[arg-type]
        "wavelength_nm ": lambda: materials.ior("Al")(np.ma.array([500.0], mask=[True])),
        "brdf": lambda: table(
            theta_i_deg=0, phi_i_deg=0, theta_r_deg=0, phi_r_deg=0, wavelength_nm=550, brdf=some, attrs={}
        ),
    }
    for name, call in calls.items():
        with pytest.raises(ArgumentError, match=f"{name.strip()} is a masked array"):
            call()


@pytest.mark.parametrize("slopes", [1, 2])
@pytest.mark.parametrize("ior", [None, 1.5])
@pytest.mark.parametrize(
    "kind", [AnisotropicFacets, Blinn, CookTorrance, GGX, HeTorrance, Lambert, OrenNayar, Phong, Retroreflecting]
)
def test_a_fit_starts_inside_the_bounds_from_the_level_that_was_measured(
    kind: type[Model], ior: float | None, slopes: int
) -> None:
    declared = kind.declaration(ior, slopes)
    at = np.array([0.2, 0.7, 1.1]), 0.0, np.array([0.9, 0.1, 1.2]), np.array([0.5, 2.0, 3.0])
    middle = {name: row.inside(0.4) for name, row in declared.parameters.items()} | dict(declared.fixed)
    for diffuse in (0.2, 7.0):
        starts = declared.starts(Levels(diffuse, diffuse, 4.0 * diffuse, 0.55))
        assert all(declared.parameters[name].inside(value) == value for one in starts for name, value in one.items())
        for start in (starts[0], starts[-1]):
            full = middle | start
            for name, slope in declared.flat(full).items():  # its effect is the same in every direction
                model, less = (kind(**declared.arguments(full | {name: full[name] * part})) for part in (1.0, 0.5))
                # differences of values that a lobe may make a thousand times as large
                change = np.asarray(model.brdf(*at)) - np.asarray(less.brdf(*at))
                np.testing.assert_allclose(change, slope * 0.5 * full[name], rtol=1e-10, atol=1e-13)
                if kind is not GGX:  # it takes tenths of the level, too
                    base = math.pi * slope * full[name]
                    assert base == pytest.approx(min(diffuse, math.pi * slope), rel=1e-12)


def test_what_a_fit_derives_of_its_parameters() -> None:
    of_metal = HeTorrance.declaration("Al").derived({"sigma0_um": 0.3, "tau_um": 2.0})
    assert of_metal == {"slope_m": pytest.approx(0.3)}
    two = CookTorrance.declaration(1.5, 2).derived({"s": 0.2, "w_1": 0.7})
    assert two == {"d": pytest.approx(0.8), "w_2": pytest.approx(0.3)}
    assert CookTorrance.declaration(1.5).derived({"s": 0.2}) == {"d": pytest.approx(0.8)}
