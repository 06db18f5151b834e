"""Plots out of plane and of diagnostics: what is drawn is what was measured, on the axes that were given."""

from typing import Any

import numpy as np
import pytest
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.fitting.profile_likelihood import Interval
from gonio_analysis.plots import diagnostics, maps
from matplotlib.figure import Figure

from gonio.models import build
from tests.gonio_analysis.changes.test_point_by_point import hemisphere

GLOSS = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30})


@pytest.fixture(scope="module")
def data() -> Observations:
    """Over the hemisphere; not on import, where each worker would compile the model."""
    return observations(hemisphere(GLOSS))


def axes(**how: Any) -> Any:
    return Figure().add_subplot(**how)


def test_heat_map_shows_each_value_in_its_direction(data: Observations) -> None:
    theta_r, phi_r = data.directions.theta_r, data.directions.phi_r
    ax = axes()
    # after the triangles
    points = maps.heat_map(ax, theta_r, phi_r, data.brdf, label="BRDF [1/sr]", theta_i=np.radians(30.0))[1]
    xy, shown = np.asarray(points.get_offsets()), np.asarray(points.get_array())
    assert xy[np.argmax(shown)] == pytest.approx([30.0, 0.0], abs=1e-9)  # the mirror direction, on the right
    assert np.hypot(*xy.T) == pytest.approx(np.degrees(theta_r), rel=1e-14, abs=1e-14)  # sine and cosine, and back
    assert ax.figure.axes[1].get_ylabel() == "BRDF [1/sr]"


def test_heat_map_leaves_holes_empty(data: Observations) -> None:
    theta_r, phi_r = data.directions.theta_r, data.directions.phi_r
    kept = ~((np.radians(80.0) < phi_r) & (np.radians(130.0) > phi_r))
    mesh = maps.heat_map(axes(), theta_r[kept], phi_r[kept], data.brdf[kept], label="")[0]
    x, y = -30 * np.cos(np.radians(105.0)), -30 * np.sin(np.radians(105.0))
    assert not [p for p in mesh.get_paths() if p.contains_point((x, y))]


def test_no_change_points_neither_up_nor_down() -> None:
    """Identical inputs were all drawn "above 0"."""
    artists = maps.plane_map(
        axes(), np.zeros(3), np.zeros(3), np.array([0.0, 2.0, -1.0]), label="", top=4.0, y_label=""
    )
    assert [len(a.get_offsets()) for a in artists[:3]] == [1, 1, 1]


def test_change_maps_ring_what_changed() -> None:
    angle, still = np.radians([-30.0, 0.0, 30.0]), np.radians([10.0, 10.0, 45.0])
    marked = np.array([False, True, False])
    for artists in (
        maps.plane_map(
            axes(), angle, still, np.array([0.0, 5.0, -1.0]), label="", top=4.0, y_label="θi", marked=marked
        ),
        maps.change_map(axes(), np.abs(angle), still, np.array([0.0, 5.0, -1.0]), label="", top=4.0, marked=marked),
    ):
        ring = artists[-1]
        assert len(ring.get_xdata()) == 1
        assert ring.get_markerfacecolor() == "none"


def test_changes_carry_error_bars_and_the_limit() -> None:
    nothing = np.empty(0)
    line = Line("a", nothing, nothing, np.radians([-10.0, 10.0]), np.array([1.0, -2.0]), np.array([0.5, 0.25]))
    low, high = maps.changes(axes(), [line], [None])[1].lines[2][0].get_segments()
    assert [low[0][1], low[1][1], high[0][1], high[1][1]] == [0.5, 1.5, -2.25, -1.75]
    ax = axes()
    maps.significance(ax, [line], 3.5)
    assert ax.get_ylim()[1] > 3.5


def test_slices_are_signed_half_planes(data: Observations) -> None:
    lines = maps.slices(data, np.arange(len(data)))
    assert [line.label for line in lines][:2] == ["Δφ = 10°/190°", "Δφ = 20°/200°"]
    assert lines[0].angle.min() < 0 < lines[0].angle.max()
    made = float(GLOSS.brdf(np.radians(30.0), 0.0, np.radians(70.0), np.radians(190.0)))
    # azimuths went to degrees and back: 1e-15, and the highlight's 30th power of a cosine
    assert lines[0].measured[np.argmax(lines[0].angle)] == pytest.approx(made, rel=1e-12)
    assert np.all(lines[0].u > 0)


def test_lobe_is_as_long_as_its_values() -> None:
    value = (np.array([0.3]), np.array([1.0]), np.array([0.125]))
    mesh = maps.lobe(axes(projection="3d"), lambda theta, dphi: 0.25 + 0 * theta, measured=value)
    segments = np.concatenate([np.asarray(s) for s in mesh[0]._segments3d])
    assert np.linalg.norm(segments, axis=1) == pytest.approx(1.0, rel=1e-14)  # of a direction
    assert np.linalg.norm([c[0] for c in mesh[1]._offsets3d]) == pytest.approx(0.5, rel=1e-14)


def test_profile_is_zero_at_the_value_and_marks_the_interval() -> None:
    x = np.array([0.8, 0.9, 1.0, 1.1, 1.2])
    walked = Interval("m", 0.804, 1.196, False, False, 0.95, x, ((x - 1) / 0.1) ** 2)
    curve = diagnostics.profile(axes(), walked, value=1.0, threshold=3.84)[1]
    assert np.interp(1.0, *curve.get_data()) == pytest.approx(0.0, abs=1e-12)
    # a parabola comes out as one: its root is a straight line
    assert np.interp(1.15, *curve.get_data()) == pytest.approx(2.25, rel=0.01)


def test_budget_over_angle_is_in_percent() -> None:
    lines = diagnostics.budget_over_angle(
        axes(), np.radians([-10.0, 0.0, 10.0]), [("combined", np.full(3, 0.01)), ("random", np.full(3, 0.004))]
    )
    assert [line.get_ydata()[0] for line in lines] == pytest.approx([1.0, 0.4], rel=1e-14)
    assert len({line.get_linestyle() for line in lines} | {line.get_color() for line in lines}) > 2


def test_a_lobe_s_points_lie_inside_its_box_and_far_ones_are_left_out() -> None:
    mesh = maps.lobe_mesh(lambda theta, dphi: np.full(theta.shape, 0.1))
    theta, dphi = np.radians([0.0, 80.0, 45.0]), np.radians([0.0, 180.0, 180.0])
    value = np.array([0.14, 0.13, 5.0])  # above the mesh, beside it, and a spike that would shrink both to a dot
    ax = axes(projection="3d")
    maps.lobe(ax, mesh, measured=(theta, dphi, value))
    scatter = next(c for c in ax.collections if type(c).__name__ == "Path3DCollection")
    x, y, z = (np.asarray(a) for a in scatter._offsets3d)
    assert x.size == 2
    for points, limits in ((x, ax.get_xlim()), (y, ax.get_ylim()), (z, ax.get_zlim())):
        assert limits[0] - 1e-12 <= points.min()  # a rounding
        assert points.max() <= limits[1] + 1e-12
    assert maps.beyond(mesh, value).tolist() == [False, False, True]


def test_two_sides_are_both_whole_and_a_model_has_no_markers() -> None:
    angle = np.radians([-10.0, 0.0, 10.0])
    a, b = np.array([1.0, 2.0, 1.0]), np.array([1e-4, 2.0, 300.0])
    line = Line("θi = 10°", angle, b, angle, a, np.full(3, 0.1))
    ax = axes()
    first, _, second = maps.both(ax, [line], (True, True))
    assert (first.get_marker(), second.get_marker()) == ("o", "o")
    assert second.get_markerfacecolor() == "white"
    assert ax.get_ylim()[0] < 1e-4
    assert ax.get_ylim()[1] > 300.0
    _, _, second = maps.both(axes(), [line], (True, False))
    assert second.get_marker() == "None"
    assert not second.is_dashed()


def test_angles_on_a_hemisphere_stand_on_a_patch_of_their_own(data: Observations) -> None:
    theta_r, phi_r = data.directions.theta_r, data.directions.phi_r
    ax = axes()
    maps.heat_map(ax, theta_r, phi_r, data.brdf, label="f")
    rings = [text for text in ax.texts if text.get_text() in ("30°", "60°", "90°")]
    assert len(rings) == 3
    assert all(text.get_bbox_patch() is not None and text.get_position()[1] < 0 for text in rings)
