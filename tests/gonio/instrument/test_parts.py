"""The parts of a model: together they are the whole, and each is what it is called."""

import math
from typing import Any

import numpy as np
import pytest

from gonio.instrument import apparent_brdf
from gonio.instrument.parts import DIRECTIONAL, SPECULAR, UNIFORM, parts
from gonio.models import Blinn, HeTorrance, Lambert, Model, OrenNayar, Phong, Sum

CONES: dict[str, Any] = {"source_solid_angle_sr": 0.003, "receiver_solid_angle_sr": 0.003}
SMOOTH = HeTorrance(sigma0_um=0.08, tau_um=1.5, ior=1.5, diffuse_albedo=0.3)
MIXED = Sum((Lambert(0.4), 0.5), (Phong(0.0, 0.3, 20.0), 1.0), (SMOOTH, 0.2))
THETA_R = np.radians([5.0, 29.5, 30.0, 60.0])
WHERE = (math.radians(30.0), 0.0, THETA_R, math.pi)


@pytest.mark.parametrize(
    ("model", "names"),
    [
        (SMOOTH, [SPECULAR, DIRECTIONAL, UNIFORM]),
        (Blinn(), [DIRECTIONAL, UNIFORM]),
        (OrenNayar(), [DIRECTIONAL]),
        (Lambert(), [UNIFORM]),
        (MIXED, ["lambert 1", "phong 2", "he-torrance 3"]),
    ],
    ids=lambda value: value.name if isinstance(value, Model) else "",
)  # fmt: skip
def test_the_sum_of_the_parts_is_the_whole(model: Model, names: list[str]) -> None:
    found = parts(model, *WHERE, **CONES)
    assert list(found) == names
    whole = apparent_brdf(model, *WHERE, **CONES)
    np.testing.assert_allclose(sum(p.seen for p in found.values()), whole, rtol=1e-12)  # roundings of three terms
    assert sum(p.reflected for p in found.values()) == pytest.approx(
        float(model.directional_hemispherical(WHERE[0])),
        rel=1e-12,  # the same integrals
    )


def test_a_lobe_is_that_of_the_surface_without_its_uniform_part() -> None:
    found = parts(SMOOTH, *WHERE, **CONES)
    bare = parts(HeTorrance(sigma0_um=0.08, tau_um=1.5, ior=1.5), *WHERE, **CONES)
    assert UNIFORM not in bare
    # what is left of a difference to 0.1, where the average over the cones is right to 1e-7
    np.testing.assert_allclose(found[DIRECTIONAL].seen, bare[DIRECTIONAL].seen, atol=1e-7)
    assert found[DIRECTIONAL].reflected == pytest.approx(bare[DIRECTIONAL].reflected, abs=1e-8)  # the integral's
    assert found[UNIFORM].reflected == pytest.approx(0.3)
