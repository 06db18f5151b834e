"""The bench of fits of maps: its numbers are what they say."""

from __future__ import annotations

import numpy as np
import pytest
from gonio_maps.models import batch

from tools.studies import maps, maps_jax

pytestmark = pytest.mark.slow  # the engine compiles for a minute where it is not yet on the disk


@pytest.mark.parametrize("name", ["cook-torrance", "ggx", "oren-nayar", "blinn"])
def test_fits_of_pixels_are_those_of_gonio_fit(name: str) -> None:
    row = maps.measured(name, 60)
    assert row["from_fit"] < 1e-3  # both searches end within 1e-4 u of the minimum
    assert row["beyond_5"] == row["worse_than_truth"] == 0
    assert min(row[key] for key in ("own_us", "shared_us", "rejected_us", "fit_ms", "scipy_ms")) > 0.0


def test_a_batched_fit_by_jax_finds_the_same() -> None:
    pytest.importorskip("jax", reason="jax is not installed (pip install gonio[peers])")
    d = maps.drawn("cook-torrance", 20, 3)
    start = np.stack([d["true"][one] for one in ("s", "m", "diffuse_albedo")], axis=1)
    found, _ = maps_jax.fitted(d["source"], d["camera"], d, start)
    ours = batch.fit("cook-torrance", d["x"], d["y"], d["source"], d["camera"], d["values"], d["u"], fixed=d["fixed"])
    # eight steps from the truth on end within 1e-4 u, and so do ours
    assert np.max(np.abs(found - ours.values[:, :3]) / ours.u) < 1e-3
