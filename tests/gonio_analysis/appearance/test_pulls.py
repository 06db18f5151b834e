"""Pulls of every quantity of simulated tables, (quantity - its value without noise) / u: their spread is 1.

`GONIO_PULLS=200 pytest -s tests/gonio_analysis/appearance/test_pulls.py` prints them for 200 tables a sample.
"""

import math
import os
from typing import Any

import numpy as np
import pytest
from gonio_analysis.appearance.quantities import of_table

from gonio.models import CookTorrance, HeTorrance, Lambert, Model, OrenNayar, Sum
from tests.gonio_analysis.appearance.simulated import hemisphere, measured, named, noisy, plane
from tests.gonio_analysis.synthetic import known

pytestmark = pytest.mark.slow

RUNS = int(os.environ.get("GONIO_PULLS", "32"))
SCATTER = 4.0 / math.sqrt(2.0 * RUNS)
"""Four standard deviations of a standard deviation of so many draws: 138 values are looked at, of which one lies beyond
three in a third of all sets of draws, and beyond four in one of a hundred."""
SIGNED = np.arange(-87.5, 87.6, 2.5)
HALF = np.concatenate([np.arange(-75.0, 0.0, 15.0), SIGNED[SIGNED >= 0.0]])
WAVES = tuple(np.arange(420.0, 681.0, 20.0))
GRAZED = [hemisphere(8.0), *(plane(t, HALF) for t in (20.0, 30.0, 60.0, 85.0)), plane(45.0, SIGNED[::2])]
NORMAL = [plane(0.0, np.array([45.0])), plane(0.0, np.array([-45.0]))]
AROUND_SOURCE = [plane(t, np.arange(-8.0, 0.1, 0.5)) for t in (4.0, 5.0)]
EVERYTHING = np.vstack([*GRAZED, *NORMAL, *AROUND_SOURCE])
GLOSSES = {"gloss_20_gu", "gloss_60_gu", "haze_e430_20", "haze_e430_30"}
REFLECTANCES = {"rho_dh_8", "radiance_factor_45_0", "radiance_factor_0_45", "R_A 4.0", "R_L 5.0"}


def tinted(nm: Any) -> Any:
    """An index that changes with the wavelength [nm]."""
    return 1.3 + 0.001 * (nm - 400.0)


SAMPLES: dict[str, tuple[Model, Any, tuple[float, ...], set[str]]] = {
    "rough dielectric": (
        HeTorrance(sigma0_um=0.28, tau_um=1.77, ior=1.5),
        EVERYTHING,
        (550.0,),
        GLOSSES | REFLECTANCES,
    ),
    "rough metal": (
        HeTorrance(sigma0_um=0.28, tau_um=1.77, ior=0.96 + 6.69j),
        EVERYTHING,
        (550.0,),
        GLOSSES | REFLECTANCES,
    ),
    "facets": (
        CookTorrance(s=1, d=0, slopes=((0.3, 1.0),), ior=1.5, convention="normalised"),
        EVERYTHING,
        (550.0,),
        GLOSSES | REFLECTANCES,
    ),
    "matte paint": (OrenNayar(albedo=0.8, sigma_deg=25.0), EVERYTHING, (550.0,), GLOSSES | REFLECTANCES),
    "glossy paint": (
        Sum((HeTorrance(sigma0_um=0.05, tau_um=5.0, ior=1.5), 1.0), (Lambert(0.5), 0.9)),
        EVERYTHING,
        (550.0,),
        REFLECTANCES | {"gloss_60_gu", "gloss_85_gu"},
    ),
    "smooth metal": (
        HeTorrance(sigma0_um=0.006, tau_um=5.0, ior=0.96 + 6.69j),
        np.vstack([hemisphere(8.0, 2.5, 15.0), *(plane(t, SIGNED) for t in (20.0, 60.0, 85.0))]),
        (550.0,),
        {"tis_8", "rms_roughness_nm", "gloss_20_gu", "gloss_60_gu", "gloss_85_gu"},
    ),
    "colours": (
        HeTorrance(sigma0_um=0.3, tau_um=1.5, ior=tinted, diffuse_albedo=0.1),
        np.vstack([plane(45.0, np.array([60.0, 30.0, 20.0, 0.0, -30.0, -65.0])), plane(15.0, np.array([30.0, 0.0]))]),
        WAVES,
        {"flop_index", "L 45.0 15.0", "a 45.0 45.0", "b 45.0 110.0", "L 15.0 -15.0"},
    ),
}


def pulls(model: Model, directions: Any, waves: tuple[float, ...] = (550.0,)) -> dict[str, Any]:
    """(quantity - its value without noise) / u over simulated measurements, by the name of the quantity."""
    rng = np.random.default_rng(1)
    frame = measured(model, directions, waves=waves)
    truth = dict(named(of_table(frame, name="truth")))
    found: dict[str, list[float]] = {key: [] for key, q in truth.items() if q.value is not None}
    for _ in range(RUNS):
        sample = dict(named(of_table(noisy(frame, rng), name="noisy")))
        for key, values in found.items():
            if sample[key].value is not None:
                values.append((known(sample[key].value) - known(truth[key].value)) / known(sample[key].u))
    return {key: np.array(values) for key, values in found.items()}


@pytest.mark.slow
@pytest.mark.parametrize("sample", SAMPLES)
def test_pulls_have_a_standard_deviation_of_one(sample: str) -> None:
    model, directions, waves, wanted = SAMPLES[sample]
    found = pulls(model, directions, waves)
    assert wanted <= set(found)
    if "GONIO_PULLS" in os.environ:
        for key, values in found.items():
            print(f"{sample:18s} {key:24s} {len(values):4d} {values.mean():6.2f} {values.std(ddof=1):6.3f}")
    for key, values in found.items():
        assert len(values) > 0.9 * RUNS, f"{key}: refused too often where it is stated without noise"
        assert abs(values.std(ddof=1) - 1.0) < SCATTER, key
