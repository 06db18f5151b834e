"""A spike by the overlap of two counted discs, spread by errors of the angles that are drawn, and where one is seen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gonio_sweeps.spike import TILT, Spike, suspected

from gonio.geometry import Directions
from gonio.typing import Floats

CONES = math.radians(0.5), math.radians(0.3)
THETA_I = math.radians(40.0)


def beside(off_deg: Floats, turn_deg: float = 0.0, theta_i: float = THETA_I) -> Directions:
    """In the plane of incidence, so far beyond the mirror direction."""
    n = np.full(len(off_deg), 1.0)
    turn = math.radians(turn_deg)
    return Directions(theta_i * n, turn * n, theta_i + np.radians(off_deg), (turn + math.pi) * n)


def seen(off_rad: float) -> float:
    """The part of the lens's disc that lies in the lamp's, by counting."""
    y, x = (np.indices((201, 201)) - 100) / 100 * CONES[1]
    lens = np.hypot(x, y) <= CONES[1]
    return np.count_nonzero(lens & (np.hypot(x - off_rad, y) <= CONES[0])) / np.count_nonzero(lens)


@pytest.mark.parametrize("turn_deg", [0.0, 120.0])
def test_a_spike_is_what_the_lens_sees_of_the_lamp_and_tilts_along_the_plane(turn_deg: float) -> None:
    """Columns: the heights of two spikes, then their slopes over the half vector's angle; far angles see the other."""
    spike = Spike(CONES, np.array([THETA_I, 1.0]), np.array([7.0, 3.0]))
    off = np.array([0.0, 0.15, 0.3, 0.6, -0.6, 0.79, 0.81])
    columns, scatter = spike.effects(beside(off, turn_deg))
    expected = 7.0 * np.array([seen(abs(math.radians(o))) for o in off])
    assert columns[:, 0] == pytest.approx(expected, abs=0.1)  # 201 points across
    assert columns[0, 0] == pytest.approx(7.0)
    assert columns[-1, 0] == 0.0, "beyond both cones"
    assert abs(columns[:, 2]) == pytest.approx(columns[:, 0] * TILT * abs(np.radians(off)) / 2, rel=1e-4)  # chords
    assert columns[3, 2] == pytest.approx(-columns[4, 2])
    assert not columns[:, [1, 3]].any()
    assert scatter == pytest.approx(0.0, abs=1e-6)
    assert spike.effects(beside(off[:1], turn_deg, 1.0))[0][0] == pytest.approx([0.0, 3.0, 0.0, 0.0])
    assert columns @ spike.base == pytest.approx(columns[:, 0])
    assert spike.scaled(2.0).effects(beside(off))[0] == pytest.approx(2.0 * spike.effects(beside(off))[0])


def test_errors_of_angles_make_a_spike_wider_and_uncertain() -> None:
    """Against errors that are drawn: of both polar angles along the plane, of one across it."""
    read, spike, rng = math.radians(0.05), Spike(CONES, np.array([THETA_I]), np.array([7.0])), np.random.default_rng(1)
    for off_deg in (0.0, 0.4, 0.6):
        mean, scatter = spike.effects(beside(np.array([off_deg])), read)
        drawn = np.array(
            [math.radians(off_deg) + read * rng.normal(0, math.sqrt(2), 3000), read * rng.normal(0, 1, 3000)]
        )
        known = np.radians(np.linspace(0.0, 0.9, 46))
        values = 7.0 * np.interp(np.hypot(*drawn), known, [seen(o) for o in known])
        # three nodes for a curve with bends; its width here is ten times the errors
        assert mean[0, 0] == pytest.approx(values.mean(), abs=0.12)
        assert scatter[0] == pytest.approx(values.std(), abs=0.12)


def test_a_spike_is_suspected_where_two_values_within_the_cones_stand_out() -> None:
    off = np.array([-8.0, -4.0, -0.6, 0.0, 0.6, 4.0, 8.0])
    values = np.array([0.1, 0.2, 4.0, 9.0, 4.0, 0.2, 0.1])
    found = suspected(beside(off), values, CONES)
    assert found is not None
    assert found.theta_i == pytest.approx([THETA_I])
    assert found.height == pytest.approx([9.0 - 0.2])
    assert suspected(beside(off), np.full(7, 0.3), CONES) is None, "it is flat"
    assert suspected(beside(off), np.where(abs(off) < 1, 0.21, 0.2), CONES) is None, "by a twentieth only"
    assert suspected(beside(off)[[0, 1, 3, 5, 6]], values[[0, 1, 3, 5, 6]], CONES) is None, (
        "one value is a lobe, or none"
    )
