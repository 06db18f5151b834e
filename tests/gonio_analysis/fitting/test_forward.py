"""What an instrument would measure of a model, as fits and theory curves ask for it."""

from __future__ import annotations

import numpy as np
from gonio_analysis.fitting.forward import seen

from gonio.geometry import Directions
from gonio.instrument import apparent_brdf
from gonio.models import HeTorrance

MODEL = HeTorrance(sigma0_um=0.1, tau_um=2.0, ior=1.5)
THETA_I, PHI_I, THETA_R, PHI_R = np.radians(
    [[30.0, 30.0, 60.0], [0.0, 0.0, 0.0], [30.0, 45.0, 20.0], [180.0, 180.0, 90.0]]
)


def test_without_cones_it_is_the_model() -> None:
    got = seen(MODEL, Directions(THETA_I, PHI_I, THETA_R, PHI_R), wavelength_nm=550.0, cones=(0.0, 0.0))
    want = MODEL.brdf(THETA_I, PHI_I, THETA_R, PHI_R, wavelength_nm=550.0)
    np.testing.assert_allclose(got, want, rtol=1e-13)  # alone or in a batch: roundings


def test_with_cones_it_is_the_average_over_them_spike_included() -> None:
    cone = 2.4e-4  # half-angles of 0.5 degrees
    got = seen(MODEL, Directions(THETA_I, PHI_I, THETA_R, PHI_R), wavelength_nm=550.0, cones=(cone, cone))
    want = apparent_brdf(
        MODEL, THETA_I, PHI_I, THETA_R, PHI_R, wavelength_nm=550.0,
        source_solid_angle_sr=cone, receiver_solid_angle_sr=cone, spike="exact",
    )  # fmt: skip
    np.testing.assert_allclose(got, want, rtol=1e-4)  # fits average with fewer directions
    lobe = MODEL.brdf(THETA_I, PHI_I, THETA_R, PHI_R, wavelength_nm=550.0)
    # in the mirror direction the whole spike comes in; He1991 eq. 6, with the cosine of the cones' middle
    spike = MODEL.specular_reflectivity(THETA_I[0], wavelength_nm=550.0) / (np.cos(THETA_I[0]) * cone)
    # 1 %: the cosine over half a degree at 30 degrees, and the lobe over the cones
    np.testing.assert_allclose(got[0], lobe[0] + spike, rtol=0.01)
