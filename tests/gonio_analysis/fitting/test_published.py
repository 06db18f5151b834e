"""Published fits come back: tables made from their parameters, in MERL's directions, by the metric of their authors.

Ngan, Durand and Matusik (2005) sum (F - f)^2 cos^2 theta_i over MERL's directions, each with its solid angle, and leave
out angles beyond 80 degrees. Their Fresnel factor is Schlick's. Low et al. (2012) take the exact one.
"""

from __future__ import annotations

import math
import random

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting.fit import fit

from gonio.formats.reader import table
from gonio.models import CookTorrance, Lambert, Model, Sum
from gonio.typing import Floats
from tests.gonio.models.test_published_fits import low, ngan, published

NOISE = 0.03


def merl() -> tuple[tuple[Floats, Floats, Floats, Floats], Floats]:
    """Angles [deg] of every second theta_h of MERL's, of few theta_d and phi_d, and the solid angle that each has."""
    theta_h = np.radians(90 * (np.arange(0, 90, 2.0) / 90) ** 2)
    theta_d, phi_d = np.radians(np.arange(2.0, 80.0, 10.0)), np.radians([20.0, 60.0, 90.0, 130.0, 160.0])
    h, d, p = (x.ravel() for x in np.meshgrid(theta_h, theta_d, phi_d, indexing="ij"))
    ends = []
    for sign in (1, -1):
        x, y, z = sign * np.sin(d) * np.cos(p), sign * np.sin(d) * np.sin(p), np.cos(d)
        x, z = np.cos(h) * x + np.sin(h) * z, np.cos(h) * z - np.sin(h) * x  # tilted by theta_h about y
        ends.append((np.degrees(np.arccos(np.clip(z, -1, 1))), np.degrees(np.arctan2(y, x)) % 360))
    (theta_i, phi_i), (theta_r, phi_r) = ends
    keep = (theta_i < 80) & (theta_r < 80)
    # theta_h goes with the square of the number: d(theta_h) with its root; dw_i dw_r = 4 cos(theta_d) dw_h dw_d
    solid = np.sin(h) * np.sqrt(h) * np.sin(d) * np.cos(d)
    return (theta_i[keep], phi_i[keep], theta_r[keep], phi_r[keep]), solid[keep]


def measured_like(model: Model, *, by_solid_angle: bool = False) -> pd.DataFrame:
    """A table in MERL's directions with noise; or in as many that are drawn from them by their solid angles."""
    rng = np.random.default_rng(11)
    angles, solid = merl()
    if by_solid_angle:
        rows = np.sort(rng.choice(solid.size, size=4 * solid.size, p=solid / solid.sum()))
        angles = (angles[0][rows], angles[1][rows], angles[2][rows], angles[3][rows])
    f = np.asarray(model.brdf(*np.radians(angles)))
    return table(
        theta_i_deg=angles[0], phi_i_deg=angles[1], theta_r_deg=angles[2], phi_r_deg=angles[3], wavelength_nm=550.0,
        brdf=f * (1 + NOISE * rng.normal(size=f.size)),
        attrs={"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0},
    )  # fmt: skip


def fitted(frame: pd.DataFrame, **fix: str) -> tuple[float, float, float]:
    """m, the albedo of the Lambertian part, and s F(0), the size of the lobe."""
    v = {n: e.value for n, e in fit(frame, "cook-torrance", metric="ngan", fix=fix).parameters.items()}
    return v["m"], (1 - v["s"]) * v["diffuse_albedo"], v["s"] * ((v["ior"] - 1) / (v["ior"] + 1)) ** 2


def test_materials_at_random_come_back_with_their_authors_fresnel_factor() -> None:
    """Also narrow ones: the published m go down to 0.003."""
    for name, (d, s, p) in random.Random(4).sample(sorted(published("ngan_cooktorrance.fit").items()), 4):
        m, _, size = fitted(measured_like(ngan(d[0], s[0], p)), fresnel="schlick")
        # noise of 3 % on the highest values, which are tens: one or two per cent; four of them
        assert m == pytest.approx(p["roughness"], rel=0.06), name
        assert size == pytest.approx(s[0] / math.pi * p["eta"], rel=0.06), name


@pytest.mark.parametrize("name", ["steel", "aluminium"])
def test_lobes_of_thousandths_are_not_cut_by_a_bound(name: str) -> None:
    d, s, p = published("low_cooktorrance_E1.fit")[name]
    assert p["roughness"] < 0.005
    m, _, size = fitted(measured_like(low(d[0], s[0], p)))
    assert m == pytest.approx(p["roughness"], rel=0.06)  # as above
    assert size == pytest.approx(s[0] * ((p["eta"] - 1) / (p["eta"] + 1)) ** 2, rel=0.06)


def test_the_albedo_comes_back_where_directions_count_by_their_solid_angle() -> None:
    """MERL's directions crowd at the lobe. Counted once each, haze fills the diffuse part."""
    d, s, p = published("ngan_cooktorrance.fit")["nickel"]
    m = p["roughness"]
    hazy = CookTorrance(slopes=((m, 0.9), (3 * m, 0.1)), f0=p["eta"], fresnel="schlick")
    model = Sum((Lambert(albedo=d[0]), 1.0), (hazy, s[0] / math.pi))
    counted, weighed = (fitted(measured_like(model, by_solid_angle=by), fresnel="schlick") for by in (False, True))
    for found, _, size in (counted, weighed):
        # a tenth of the lobe is elsewhere: form and size are those of the rest, within that tenth
        assert found == pytest.approx(m, rel=0.1)
        assert size == pytest.approx(s[0] / math.pi * p["eta"], rel=0.15)
    assert counted[1] > 2 * d[0]
    assert weighed[1] == pytest.approx(d[0], rel=0.4)
