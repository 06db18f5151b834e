"""RGL's adaptive files: the container, and the formula against densities whose distribution is known."""

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError
from gonio.formats.rgl import RglMeasured


def container(fields: dict[str, Any]) -> bytes:
    """A tensor_file; float32 but for `description` and `valid`."""
    arrays = {
        name: np.asarray(value, dtype=np.uint8 if name in ("description", "valid") else "<f4")
        for name, value in fields.items()
    }
    size = 18 + sum(2 + len(name) + 11 + 8 * array.ndim for name, array in arrays.items())
    head, body = b"tensor_file\0\x01\x00" + struct.pack("<I", len(arrays)), b""
    for name, array in arrays.items():
        head += struct.pack("<H", len(name)) + name.encode()
        head += struct.pack(
            f"<HBQ{array.ndim}Q", array.ndim, 10 if array.itemsize == 4 else 1, size + len(body), *array.shape
        )
        body += array.tobytes()
    return head + body


def material(**changes: Any) -> bytes:
    """Visible normals of density 2 x, which the distribution maps to x^2; red is that square, green 1, blue y."""
    x, y = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 3))
    fields = {
        "description": list(b"test"),
        "phi_i": [0.0],
        "theta_i": [0.0, 0.8, np.pi / 2],
        "ndf": np.full((2, 4), 2.0),
        "sigma": np.full((2, 4), 0.25),
        "vndf": np.broadcast_to(3.0 * x, (1, 3, 3, 5)),
        "rgb": np.broadcast_to(np.stack([x, np.ones_like(x), y]), (1, 3, 3, 3, 5)),
        "valid": [0xFF] * 6,
    }
    return container({key: value for key, value in (fields | changes).items() if value is not None})


def test_the_warp_is_the_distribution_of_visible_normals() -> None:
    measured = RglMeasured(material(), Path("m.bsdf"))
    rng = np.random.default_rng(5)
    theta_i, theta_r = rng.uniform(0.05, 1.5, (2, 200))
    phi_i, phi_r = rng.uniform(-3, 3, (2, 200))
    brdf, valid = measured.brdf(theta_i, phi_i, theta_r, phi_r)
    # the half vector, independently: complex numbers in the plane of the surface
    h = np.sin(theta_i) + np.sin(theta_r) * np.exp(1j * (phi_r - phi_i))
    theta_m = np.arctan2(abs(h), np.cos(theta_i) + np.cos(theta_r))
    scale = 2.0 / (4 * 0.25) / np.cos(theta_r)
    np.testing.assert_allclose(brdf[:, 1], scale, rtol=1e-12)
    np.testing.assert_allclose(
        brdf[:, 0], theta_m * 2 / np.pi * scale, rtol=1e-6
    )  # u^2, u = sqrt(2 theta_m / pi); float32
    np.testing.assert_allclose(brdf[:, 2], (np.angle(h) / (2 * np.pi) + 0.5) * scale, rtol=1e-6)
    assert valid.all()


def test_the_table_lies_on_a_grid(tmp_path: Path) -> None:
    frame = measurement.parse(material(), Path("m.bsdf"))
    assert frame.attrs["samples"] == ["test red", "test green", "test blue"]
    green = measurement.samples(frame)["test green"]
    np.testing.assert_allclose(green["brdf"] * np.cos(np.deg2rad(green["theta_r_deg"])), 2.0, rtol=1e-12)  # rounding
    assert {0.0, 180.0} <= set(green["phi_r_deg"])
    assert (frame["flag"] == "").all()
    spectral = material(
        rgb=None, wavelengths=[500.0, 600.0], spectra=np.ones((1, 3, 2, 3, 5)) * np.array([1.0, 3.0]).reshape(2, 1, 1)
    )
    frame = measurement.parse(spectral, Path("m.bsdf"))
    ratio = frame.groupby("wavelength_nm")["brdf"].sum()
    assert ratio[600.0] == pytest.approx(3 * ratio[500.0], rel=1e-12)  # roundings of a sum
    assert "sample" not in frame.columns


def test_a_sample_with_mirror_symmetry_is_turned_into_the_measured_sector() -> None:
    x, _ = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 3))
    phi = np.linspace(-np.pi, 0, 5)
    values = np.broadcast_to(-phi.reshape(5, 1, 1, 1, 1), (5, 3, 3, 3, 5))  # the value is the azimuth of incidence
    vndf = np.broadcast_to(x + 1, (5, 3, 3, 5))
    measured = RglMeasured(material(phi_i=phi, vndf=vndf, rgb=values, valid=None), Path("m.bsdf"))
    angles = np.array([0.3, 1.0, 2.5])
    tilt = np.full(3, 0.5)
    for sign, expected in ((-1, angles), (1, math.pi - angles)):  # y > 0 is turned by half a turn
        brdf, _ = measured.brdf(tilt, sign * angles, tilt, sign * angles)
        np.testing.assert_allclose(brdf[:, 0] * np.cos(0.5) / 2, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (material()[:300], "byte 18|beyond the end"),
        (material()[:40], "byte 42|cut|byte"),
        (material(vndf=None), "the field vndf is missing"),
        (material(theta_i=[0.0, 0.8, 0.7]), "nodes of theta_i do not grow"),
        (material(vndf=np.zeros((1, 3, 3, 5))), "density of visible normals is zero"),
        (material(rgb=np.ones((1, 2, 3, 3, 5))), "shapes of vndf and rgb"),
        (material(sigma=np.full((2, 4), np.nan)), "sigma needs 2 dimensions and finite"),
        (material().replace(b"tensor_file\0\x01", b"tensor_file\0\x07"), "version 1"),
    ],
)
def test_damage_is_named(data: bytes, told: str) -> None:
    with pytest.raises(DataError, match=told) as caught:
        measurement.parse(data, Path("m.bsdf"))
    assert "m.bsdf" in str(caught.value)


@pytest.mark.slow
def test_damaged_files(survives: Callable[..., None]) -> None:
    survives(material(), "m.bsdf", format="rgl", most_rows=60_000)  # the table is a fixed grid


def test_against_an_independent_evaluation(shared: Callable[[str], Path]) -> None:
    """Values of Mitsuba's plug-in beside the file, which states them as BRDF; it works in float32."""
    path = shared("rgl/acrylic_felt_green_rgb.bsdf")
    reference = pd.read_csv(shared("rgl/acrylic_felt_green_mitsuba391_values.csv"))
    angles = (np.deg2rad(reference[f"{name}_deg"].to_numpy(float)) for name in ("theta_i", "theta_r", "phi_r"))
    theta_i, theta_r, phi_r = angles
    brdf, _ = RglMeasured(path.read_bytes(), path).brdf(theta_i, np.zeros_like(theta_i), theta_r, phi_r)
    np.testing.assert_allclose(brdf, reference[["brdf_r", "brdf_g", "brdf_b"]], rtol=3e-5)  # sums over 128 x 128 nodes
