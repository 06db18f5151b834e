"""Where the axis of a polariser has to stand for a state, and what a rig refuses."""

import math
from typing import Any

import numpy as np
import pytest

from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.lab.reduction.polarised import FACET, of_glass
from gonio.lab.rig import Pose, kinematics
from gonio.lab.rig.light_and_camera import Band
from gonio.lab.rig.polariser_axes import axes, azimuth, linear, on_rays
from gonio.lab.rig.polarisers import PolariserMounts, in_states
from gonio.models.polarised import Light
from gonio.polarisation import STATES, ray_axes
from tests.gonio_sim.conftest import describe

IN_PLANE = Pose(light=math.radians(40.0), camera=math.radians(-25.0))
OUT_OF_PLANE = Pose(light=math.radians(35.0), camera=math.radians(20.0), tilt=math.radians(50.0), spin=0.3)
BOTH: dict[str, Any] = {"light": {"empty": True}, "receiver": {}}


@pytest.mark.parametrize("side", ["light", "receiver"])
def test_in_the_plane_of_the_arms_s_lies_along_their_axis(side: Any) -> None:
    view = kinematics.view(describe("sim-ideal"), IN_PLANE)
    found = [math.degrees(azimuth(view, side, letter)) for letter in "sp"]
    assert [found[0], abs(found[1])] == pytest.approx([0.0, 90.0], abs=1e-9)
    # d lies between s and p; seen from the sample s turns toward p clockwise before the lamp (docs/conventions.md)
    assert math.degrees(azimuth(view, side, "d")) == pytest.approx(-45.0 if side == "light" else 45.0, abs=1e-9)


@pytest.mark.parametrize("side", ["light", "receiver"])
@pytest.mark.parametrize("letter", "spda")
def test_out_of_plane_the_axis_is_the_state_s_own(side: Any, letter: str) -> None:
    """Written out: the axis in the sample's frame, against s and p of the ray there."""
    description = describe("sim-ideal")
    view, d = kinematics.view(description, OUT_OF_PLANE), kinematics.directions(description, OUT_OF_PLANE)
    theta, phi = (d.theta_i, d.phi_i) if side == "light" else (d.theta_r, d.phi_r)
    turned = azimuth(view, side, letter)
    first, second = axes(view, side)
    field = math.cos(turned) * first + math.sin(turned) * second
    _, s, p = ray_axes(theta, phi, incident=side == "light")
    wanted = {"s": s, "p": p, "d": (s + p) / math.sqrt(2.0), "a": (s - p) / math.sqrt(2.0)}[letter]
    assert abs(float(field @ wanted)) == pytest.approx(1.0, abs=1e-12)
    assert abs(turned) > math.radians(5.0), "or the pose tells nothing"
    # and light along it has the Stokes vector of the word
    stokes = on_rays(view, side, linear(1.0, turned), np.atleast_1d(theta), np.atleast_1d(phi))[0]
    np.testing.assert_allclose(stokes, STATES[letter], atol=1e-12)


def test_the_matrix_of_glass_is_that_of_the_models_facets() -> None:
    rng = np.random.default_rng(5)
    for theta_i, phi_i, theta_r, phi_r in rng.uniform(0.0, [1.5, 6.0, 1.5, 6.0], (30, 4)):
        at = Directions(*(np.full(16, angle) for angle in (theta_i, phi_i, theta_r, phi_r)))
        rows, columns = np.divmod(np.arange(16), 4)
        expected = Light(at, np.eye(4)[columns], np.eye(4)[rows]).of_facets(FACET)
        np.testing.assert_allclose(of_glass(Directions(theta_i, phi_i, theta_r, phi_r)).ravel(), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("word", "why"),
    [
        ("us", "receiver"), ("rs", r"\[polarisers.light\] of the rig cannot do \"r\": it has no retarder"),
        ("s", r"\[polarisers.receiver\] .* cannot do \"u\": it has no empty place"), ("sQ", "no state that a rig can"),
        ("unpolarised", "cannot do \"u\""), ("sx", "no state"),
    ],
)  # fmt: skip
def test_what_a_rig_cannot_do_is_refused(word: str, why: str) -> None:
    mounts = PolariserMounts.model_validate(BOTH)
    mounts.require("ss")
    mounts.require("ud")
    if word == "us":
        mounts = PolariserMounts.model_validate({"light": {}})
        why = "no polariser before the camera"
        word = "ss"
    with pytest.raises(ConfigError, match=why):
        mounts.require(word)


def test_a_band_in_a_state_is_a_band_of_its_own() -> None:
    band = Band(name="green", centre_nm=550.0, fwhm_nm=10.0)
    assert in_states((band,), ()) == (band,)
    s, p = in_states((band,), ("s", "p"))
    assert (s.name, s.polarisation, p.polarisation) == ("green (s)", "s", "p")
    assert s.alone == band == band.alone
    assert band.polarisation == "unpolarised"
