"""Measured tables interpolated for renderers: exact where measured, and what is said of the rest; Mitsuba and Klems."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from gonio import geometry, measurement
from gonio.cli.tables import convert
from gonio.config import to_toml
from gonio.errors import ConfigError, DataError
from gonio.formats.reader import table
from gonio.formats.rgl import RglMeasured, tensors
from gonio.models import CookTorrance, Lambert, Model, OrenNayar, build
from gonio.renderers import channels, measured
from gonio.renderers.interpolated import Interpolated
from gonio.typing import Floats

GLOSSY = CookTorrance(0.5, 0.5, 0.2, 1.5, diffuse_albedo=0.3, convention="normalised")
NARROW = CookTorrance(0.5, 0.5, 0.02, 1.5, diffuse_albedo=0.3, convention="normalised")


def sampled(model: Model, theta_i_deg: list[float], step: float, *, dphi_deg: tuple[float, ...] = ()) -> pd.DataFrame:
    """A model measured in plane to 80 degrees, and at azimuths out of it."""
    signed = np.arange(-80.0, 80.1, step)
    parts = [(t, abs(s), 180.0 if s >= 0 else 0.0) for t in theta_i_deg for s in signed]
    parts += [(t, abs(s), d) for t in theta_i_deg for s in signed if s > 0 for d in dphi_deg]
    theta_i, theta_r, phi_r = np.array(parts).T
    brdf = model.brdf(*np.deg2rad([theta_i, 0 * theta_i, theta_r, phi_r]))
    return table(
        theta_i_deg=theta_i, phi_i_deg=0.0, theta_r_deg=theta_r, phi_r_deg=phi_r, wavelength_nm=550.0, brdf=brdf,
        attrs={"sample": "glossy"},
    )  # fmt: skip


def vectors(rows: channels.Rows) -> tuple[Floats, Floats]:
    """Unit vectors toward the source, at the azimuth 0, and the detector."""
    theta_i, theta_r, dphi = rows.angles.T
    return geometry.direction(theta_i, 0 * dphi), geometry.direction(theta_r, dphi)


@pytest.mark.parametrize("dphi", [(), (30.0, 60.0, 90.0, 120.0, 150.0)])
def test_a_filled_table_is_the_table_where_it_was_measured(dphi: tuple[float, ...]) -> None:
    rows = channels.rows(sampled(GLOSSY, [10, 30, 50], 5, dphi_deg=dphi), "g")
    # rounding of logarithms and weights
    np.testing.assert_allclose(Interpolated(rows).brdf(*vectors(rows)), rows.values, rtol=1e-9)


def test_a_lambertian_plane_of_incidence_is_a_lambertian_hemisphere() -> None:
    interpolated = Interpolated(channels.rows(sampled(Lambert(albedo=0.4), [0, 20, 60], 10), "white"))
    np.testing.assert_allclose(
        interpolated.reflectance(np.deg2rad([0.0, 40.0, 75.0])), 0.4, rtol=2e-3
    )  # the quadrature


def test_between_what_was_measured_the_model_comes_out() -> None:
    """Half a step beside every measured angle, out of plane too, and between the angles of incidence."""
    dphi = tuple(range(15, 180, 15))
    interpolated = Interpolated(
        channels.rows(sampled(GLOSSY, [*range(0, 71, 10)], 5, dphi_deg=tuple(map(float, dphi))), "g")
    )
    dice = np.random.default_rng(4)
    theta_i, theta_r, phi = dice.uniform(0, 1.2, 500), dice.uniform(0, 1.2, 500), dice.uniform(0, math.pi, 500)
    i, r = geometry.direction(theta_i, 0 * phi), geometry.direction(theta_r, phi)
    assert interpolated.measured(i, r).all()
    error = np.abs(interpolated.brdf(i, r)[:, 0] / GLOSSY.brdf(theta_i, 0.0, theta_r, phi) - 1)
    # steps of 10 degrees of incidence and 15 of azimuth against a lobe of 11 degrees' slope
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.95) < 0.1


def test_in_plane_tables_say_what_is_extrapolated() -> None:
    rows = channels.rows(sampled(GLOSSY, [10, 30, 50], 5), "g")
    interpolated = Interpolated(rows)
    said = " ".join(measured.remarks(rows, interpolated))
    assert "in the plane of incidence alone" in said
    assert interpolated.extrapolated() > 0.9
    assert "WARNING" not in said
    # the lobe is well sampled in plane; swung out of it the flux is the model's to some percent
    exact = GLOSSY.directional_hemispherical(np.deg2rad([10.0, 30.0]))
    np.testing.assert_allclose(interpolated.reflectance(np.deg2rad([10.0, 30.0]))[:, 0], exact, rtol=0.05)


def test_full_tables_extrapolate_the_edge_alone() -> None:
    interpolated = Interpolated(channels.rows(sampled(GLOSSY, [10, 40], 5, dphi_deg=tuple(range(15, 180, 15))), "g"))
    # beyond 80 degrees lies cos^2(80) = 3 % of the projected hemisphere
    assert 0.01 < interpolated.extrapolated() < 0.08


def test_a_lobe_narrower_than_the_step_is_named_and_energy_above_one_is_marked() -> None:
    frame = sampled(NARROW, [10, 30, 50], 5)
    rows = channels.rows(frame, "n")
    assert "narrower than the table's step" in " ".join(measured.remarks(rows, Interpolated(rows)))
    assert "narrower" not in " ".join(
        measured.remarks(*(lambda r: (r, Interpolated(r)))(channels.rows(sampled(GLOSSY, [30], 5), "g")))
    )
    rows = channels.rows(frame.assign(brdf=0.5), "n")
    assert "WARNING: more is reflected than received: 1.5" in " ".join(measured.remarks(rows, Interpolated(rows)))


def test_channels_are_one_wavelength_colours_or_a_spectrum() -> None:
    grey = sampled(Lambert(albedo=0.4), [0, 30], 20)
    assert channels.rows(grey, "x").values.shape[1] == 1
    white = pd.concat([grey.assign(wavelength_nm=w) for w in np.arange(400.0, 701.0, 20.0)], ignore_index=True)
    white.attrs = grey.attrs
    # equal reflectance is a neutral colour: sRGB's white is D65, whose tabulated chromaticity has four digits
    np.testing.assert_allclose(channels.rows(white, "x").values, 0.4 / math.pi, rtol=2e-3)
    red = white.assign(brdf=np.where(white["wavelength_nm"] > 600, 0.4, 0.1) / math.pi)
    r, _, b = channels.rows(red, "x").values[0]
    assert r > 2 * b
    np.testing.assert_array_equal(channels.rows(red, "x", wavelength_nm=640.0).values, 0.4 / math.pi)
    with pytest.raises(ConfigError, match="x has 400"):
        channels.rows(red, "x", wavelength_nm=645.0)
    two = white[white["wavelength_nm"] <= 420]
    with pytest.raises(DataError, match="--wavelength-nm"):
        channels.rows(two, "x")
    colours = pd.concat([grey.assign(sample=f"m {c}", brdf=k) for k, c in enumerate(("red", "green", "blue"), 1)])
    np.testing.assert_array_equal(channels.rows(colours, "x").values[0], [1.0, 2.0, 3.0])
    with pytest.raises(DataError, match="FILE:SAMPLE"):
        channels.rows(grey.assign(sample="a"), "x")


def test_azimuths_of_incidence_are_averaged_and_that_is_said() -> None:
    one = sampled(Lambert(albedo=0.4), [30], 20)
    turned = one.assign(phi_i_deg=90.0, phi_r_deg=(one["phi_r_deg"] + 90) % 360, brdf=one["brdf"] * 3)
    both = pd.concat([one, turned], ignore_index=True)
    both.attrs = one.attrs
    rows = channels.rows(both, "x")
    assert any("several azimuths" in note for note in rows.notes)
    assert not any("several azimuths" in note for note in channels.rows(one, "x").notes)
    # a mean of logarithms where all values are positive
    values = Interpolated(rows).brdf(*vectors(channels.rows(one, "x")))
    np.testing.assert_allclose(values, math.sqrt(3) * 0.4 / math.pi, rtol=1e-9)


def test_scattered_directions_are_refused(tmp_path: Path) -> None:
    theta_i, theta_r = np.random.default_rng(2).uniform(5, 80, (2, 40))
    frame = sampled(GLOSSY, [30], 4).iloc[:40].assign(theta_i_deg=np.sort(theta_i), theta_r_deg=theta_r)
    measurement.write(frame, tmp_path / "t.csv")
    with pytest.raises(DataError, match="gonio fit --save"):
        convert(str(tmp_path / "t.csv"), tmp_path / "o.bsdf", None, "mitsuba")
    assert not (tmp_path / "o.bsdf").exists()


def test_a_tensor_file_gives_the_table_back_and_carries_the_remarks(tmp_path: Path) -> None:
    frame = sampled(GLOSSY, [20, 60], 5)
    measurement.write(frame, tmp_path / "t.csv")
    convert(str(tmp_path / "t.csv"), tmp_path / "o.bsdf", None, "mitsuba")
    data = (tmp_path / "o.bsdf").read_bytes()
    assert b"is extrapolated" in tensors(data, tmp_path / "o.bsdf")["remarks"].tobytes()
    rows = channels.rows(frame, "g")
    theta_i, theta_r, dphi = rows.angles.T
    # the file's first direction is the viewer's
    f, _ = RglMeasured(data, tmp_path / "o.bsdf").brdf(theta_r, 0 * dphi, theta_i, dphi)
    np.testing.assert_allclose(f[:, 1], rows.values[:, 0], rtol=0.005)  # where rows share nodes, they are averaged


@pytest.mark.parametrize(
    ("own", "first", "last"),
    [
        (np.arange(0.0, 81.0, 10.0), 0.0, 89.0),
        (np.array([1.0, 30.0, 88.5]), 0.0, 89.0),  # the ends stay, however near the table comes to them
        (np.array([0.0, 50.0, 89.5]), 0.0, 89.5),
        (np.array([20.0, 20.0, 20.0 + 1e-7]), 0.0, 89.0),  # one direction
    ],
)
def test_views_are_the_tables_own_and_even_ones_in_their_gaps(own: Floats, first: float, last: float) -> None:
    views = np.rad2deg(measured._views(cast(Interpolated, SimpleNamespace(receivers=np.deg2rad(own)))))
    step = 89.0 / 32.0
    beside = [k * step for k in range(1, 32) if all(abs(k * step - angle) > 0.4 * step for angle in own)]
    np.testing.assert_allclose(views, sorted({round(angle, 6) for angle in (first, *beside, *own, last)}), atol=1e-6)


@pytest.mark.parametrize("count", [179, 500, 5000])
def test_of_very_many_directions_a_hundred_are_views(count: int) -> None:
    """In steps of half a degree, and in steps so fine that each direction is the same as the next one."""
    own = np.linspace(0.0, 89.0, count)
    views = np.rad2deg(measured._views(cast(Interpolated, SimpleNamespace(receivers=np.deg2rad(own)))))
    assert views.size in (100, 101)  # the end besides, where the last of the table's is not kept
    assert np.abs(views[:, None] - own).min(axis=1).max() < 1e-9
    assert np.diff(views).max() < 1.5  # even: 89 / 99 degrees, to half a degree


def flat(mitsuba: object, path: Path, theta_i: float, theta_r: float, dphi: float) -> Floats:
    """The radiance (3,) of a plane under unit irradiance across the beam, seen from a direction."""
    mi: object = mitsuba
    source, viewer = geometry.direction(theta_i, dphi), geometry.direction(theta_r, 0.0)
    scene = mi.load_dict(  # type: ignore[attr-defined]
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "plane": {"type": "rectangle", "bsdf": {"type": "measured", "filename": str(path)}},
            "sun": {"type": "directional", "direction": (-source).tolist(), "irradiance": 1.0},
            "sensor": {
                "type": "orthographic",
                "to_world": mi.ScalarTransform4f()  # type: ignore[attr-defined]
                .look_at(origin=(5 * viewer).tolist(), target=[0, 0, 0], up=[0, 1, 0])
                .scale([0.01, 0.01, 1]),
                "film": {"type": "hdrfilm", "width": 2, "height": 2, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": 4},
            },
        }
    )
    return np.array(mi.render(scene)).reshape(-1, 3).mean(axis=0)  # type: ignore[attr-defined]


def test_mitsuba_shows_the_radiance_that_the_table_says(tmp_path: Path) -> None:
    """Several incidences and colours, in plane and out of it, a well sampled lobe and one narrower than the step."""
    mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (pip install gonio[peers])")
    mitsuba.set_variant("scalar_rgb")
    for name, model, dphi in (("wide", GLOSSY, (60.0, 120.0)), ("narrow", NARROW, ())):
        part = sampled(model, [20, 60], 5, dphi_deg=dphi)
        colours = pd.concat(
            [
                part.assign(sample=f"m {c}", brdf=k * part["brdf"])
                for c, k in (("red", 1.0), ("green", 0.5), ("blue", 0.2))
            ],
            ignore_index=True,
        )
        colours.attrs = part.attrs | {"samples": ["m red", "m green", "m blue"]}
        rows = channels.rows(colours, name)
        measured.write(rows, tmp_path / f"{name}.bsdf", "mitsuba")
        chosen = np.random.default_rng(1).choice(len(rows.angles), 12, replace=False)
        chosen = np.append(chosen, np.argsort(rows.values[:, 0])[-3:])  # the peaks
        for angles, values in zip(rows.angles[chosen], rows.values[chosen], strict=True):
            shown = flat(mitsuba, tmp_path / f"{name}.bsdf", *angles.tolist())
            # parallel light on a plane has no noise: what is left is float32, and nodes that rows share
            np.testing.assert_allclose(shown, values * math.cos(angles[0]), rtol=0.01)


COLOURED = {"albedo": {"red": 0.7, "green": 0.4, "blue": 0.1}, "sigma_deg": 25.0}
ONE_SIDED = {"k_d": 0.3, "k_s": 0.4, "exponent": 8}


@pytest.mark.parametrize(("name", "parameters"), [("oren-nayar", COLOURED), ("phong", ONE_SIDED)])
def test_mitsuba_shows_the_radiance_that_a_sample_file_says(
    name: str, parameters: dict[str, Any], tmp_path: Path
) -> None:
    """A sample in three channels; and a model that is not reciprocal, so that source and viewer must not be changed."""
    mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (pip install gonio[peers])")
    mitsuba.set_variant("scalar_rgb")
    (tmp_path / "m.toml").write_text(to_toml({"name": "m", "model": name, "parameters": parameters}), encoding="utf-8")
    convert(str(tmp_path / "m.toml"), tmp_path / "m.bsdf", None, "mitsuba")
    for theta_i, theta_r, dphi in ((0.3, 0.8, 2.9), (0.9, 0.2, 1.0), (0.5, 0.5, math.pi)):
        right = []
        for channel in ("red", "green", "blue"):
            plain = {k: v[channel] if isinstance(v, dict) else v for k, v in parameters.items()}
            right.append(build(name, plain).brdf(theta_i, dphi, theta_r, 0.0) * math.cos(theta_i))
        shown = flat(mitsuba, tmp_path / "m.bsdf", theta_i, theta_r, dphi)
        np.testing.assert_allclose(shown, right, rtol=0.01)  # straight lines between 64 incidences


def test_radiances_file_holds_averages_over_patches(tmp_path: Path) -> None:
    """Read as the format is specified: a matrix in columns of incidence, by rings of patches; by random directions."""
    model = OrenNayar(albedo=0.6, sigma_deg=25)
    measurement.write(sampled(model, [*range(0, 81, 20)], 10, dphi_deg=(45.0, 90.0, 135.0)), tmp_path / "t.csv")
    convert(str(tmp_path / "t.csv"), tmp_path / "o.xml", None, "radiance")
    text = (tmp_path / "o.xml").read_text()
    assert "is extrapolated" in text
    root = ElementTree.fromstring(text)
    space = {"w": "http://windows.lbl.gov"}
    names = ("w:ThetaBounds/w:LowerTheta", "w:ThetaBounds/w:UpperTheta", "w:nPhis")
    blocks = root.iterfind(".//w:AngleBasisBlock", space)
    rings = [tuple(float(b.findtext(name, None, space) or "nan") for name in names) for b in blocks]
    patches = [(low, high, 360 * k / n, 360 / n) for low, high, n in rings for k in range(int(n))]
    words = (root.findtext(".//w:ScatteringData", None, space) or "").replace(",", " ").split()
    matrix = np.array(words, float).reshape(145, 145)
    assert root.findtext(".//w:IncidentDataStructure", None, space) == "Columns"
    dice = np.random.default_rng(3)

    def drawn(patch: tuple[float, float, float, float]) -> tuple[Floats, Floats]:
        low, high, phi, width = patch
        sines = dice.uniform(math.sin(math.radians(low)) ** 2, math.sin(math.radians(high)) ** 2, 4000)
        return np.arcsin(np.sqrt(sines)), np.deg2rad(phi + width * dice.uniform(-0.5, 0.5, 4000))

    for row, column in ((0, 0), (30, 5), (60, 100), (110, 20), (90, 90)):
        (theta_i, phi_i), (theta_r, phi_r) = drawn(patches[column]), drawn(patches[row])
        # incidence is given as the direction that light goes
        f = model.brdf(theta_i, np.mod(phi_i + math.pi, 2 * math.pi), theta_r, np.mod(phi_r, 2 * math.pi))
        assert matrix[row, column] == pytest.approx(f.mean(), rel=0.03)  # what straight lines leave of its kinks


def test_options_that_do_not_belong_are_refused(tmp_path: Path) -> None:
    measurement.write(sampled(GLOSSY, [30], 10), tmp_path / "t.csv")
    with pytest.raises(ConfigError, match="--wavelength-nm 550"):
        convert(str(tmp_path / "t.csv"), tmp_path / "o.astm", None, None, wavelength_nm=550.0)
    assert json.loads((tmp_path / "t.meta.json").read_text())["sample"] == "glossy"
