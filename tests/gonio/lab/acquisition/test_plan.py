"""Plans: their points in canonical angles, the steps they become, and what is said of a wrong one."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gonio.errors import ConfigError
from gonio.geometry import ANGLES_DEG
from gonio.lab.acquisition.plan import Plan, Point, assess, beside, said_beside
from gonio.lab.acquisition.plan_tables import Range
from gonio.lab.acquisition.schedule import schedule
from gonio.lab.rig.description import ArmAxis, Arms, Geometry, Holder, Reference
from tests.gonio.numpy_rig import PLAN, describe, plan_in

HEAD = 'name = "p"\nwavelength_nm = [550]\n'


def plan(tmp_path: Path, text: str) -> object:
    return plan_in(tmp_path, text)


def angles(found: object) -> list[tuple[float, ...]]:
    return [tuple(getattr(p, name) for name in ANGLES_DEG) for p in found.points]  # type: ignore[attr-defined]


def test_signed_angles_become_canonical(tmp_path: Path) -> None:
    sweep = "[[sweep]]\ntheta_i_deg = [30]\ntheta_r_deg = { start = -20, stop = 20, step = 20 }\n"
    assert angles(plan(tmp_path, HEAD + sweep)) == [(30, 0, 20, 0), (30, 0, 0, 180), (30, 0, 20, 180)]


def test_out_of_plane_is_every_combination(tmp_path: Path) -> None:
    sweep = "[[sweep]]\ntheta_i_deg = [30, 40]\ntheta_r_deg = [10, -10]\ndphi_deg = [90, -45]\n"
    found = angles(plan(tmp_path, HEAD + sweep))
    assert (len(found), found[:4]) == (8, [(30, 0, 10, 90), (30, 0, 10, 270), (30, 0, 10, 315), (30, 0, 10, 135)])


def test_points_from_a_table_beside_the_plan(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(
        "\ufeffbrdf,theta_i_deg, phi_i_deg,theta_r_deg,phi_r_deg\n1,10,20,-30,40\n2,0,0,50,-90\n", encoding="utf-8"
    )
    assert angles(plan(tmp_path, HEAD + '[[points]]\nfile = "points.csv"\n')) == [(10, 20, 30, 220), (0, 0, 50, 270)]


def test_the_same_directions_are_measured_once(tmp_path: Path) -> None:
    text = HEAD + "[[sweep]]\ntheta_i_deg = [0, 30]\ntheta_r_deg = [-10, 0, 0.0, 10]\n" * 2
    (found) = plan(tmp_path, text + "[[sweep]]\ntheta_i_deg = [30]\ntheta_r_deg = [0]\ndphi_deg = [45]\n")
    # at normal incidence -10 and 10 differ; seen along the normal the azimuth means nothing
    assert len(found.points) == 6  # type: ignore[attr-defined]
    assert found.repeated == 11  # type: ignore[attr-defined]


@settings(max_examples=50, deadline=None)
@given(st.integers(-900, 0), st.integers(1, 100), st.integers(0, 500))
def test_ranges_hold_both_ends_without_drift(start: int, step: int, count: int) -> None:
    values = Range(start=start / 10, stop=(start + step * count) / 10, step=step / 10).values()
    assert values == [round((start + k * step) / 10, 9) for k in range(count + 1)]


def test_a_range_stops_before_its_stop(tmp_path: Path) -> None:
    assert Range(start=0, stop=10, step=4).values() == [0, 4, 8]


def test_schedule_interleaves_visits_to_the_reference(tmp_path: Path) -> None:
    steps = schedule(plan(tmp_path, PLAN), describe())  # type: ignore[arg-type]
    # point 1 is retro and blocked; a visit every three points and at the end
    assert [(s.kind, s.point) for s in steps] == [
        ("dark", None),
        ("reference", None),
        ("point", 0),
        ("point", 2),
        ("point", 3),
        ("reference", None),
        ("point", 4),
        ("point", 5),
        ("reference", None),
    ]
    assert [s.index for s in steps] == list(range(9))


@pytest.mark.parametrize(("every", "visits"), [(0, 2), (1, 6), (5, 2), (4, 3)])
def test_the_last_visit_is_never_doubled(tmp_path: Path, every: int, visits: int) -> None:
    steps = schedule(plan(tmp_path, PLAN), describe(reference=Reference(every=every)))  # type: ignore[arg-type]
    assert sum(s.kind == "reference" for s in steps) == visits
    assert steps[-1].kind == "reference"


def test_every_point_is_kept_with_its_reason(tmp_path: Path) -> None:
    found = plan(
        tmp_path, HEAD + "[[sweep]]\ntheta_i_deg = [30, 90]\ntheta_r_deg = [-30, 20, 90]\ndphi_deg = [0, 90]\n"
    )
    points = assess(found, describe(holder=Holder()))  # type: ignore[arg-type]
    assert [a.flag for a in points] == [
        *["", "", "grazing"],  # dphi = 0: retro side; -30 is the mirror direction
        *["unreachable", "unreachable", "grazing"],  # dphi = 90 on a rig with arms alone
        *["grazing"] * 6,
    ]
    assert all(bool(a.flag) == (a.pose is None) == bool(a.reason) for a in points)


def test_name_and_layout_do_not_change_what_a_plan_is(tmp_path: Path) -> None:
    first = plan(tmp_path, PLAN)
    again = plan(
        tmp_path, "# a comment\n" + PLAN.replace("small", "other").replace("[20]", "{start=20,stop=20,step=1}")
    )
    other = plan(tmp_path, PLAN.replace("[20]", "[21]"))
    assert first.sha256 == again.sha256 != other.sha256  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAD, ["plan.toml", "[[sweep]]"]),
        (HEAD + "[[sweep]]\ntheta_i_deg = [-1]\ntheta_r_deg = [1]\n", ["plan.toml", "sweep[1].theta_i_deg", "0 to 90"]),
        (HEAD + "[[sweep]]\ntheta_i_deg = [1]\ntheta_r_deg = [91]\n", ["theta_r_deg", "91", "-90 to 90"]),
        (HEAD + "[[sweep]]\ntheta_i_deg = [1]\ntheta_r_deg = []\n", ["theta_r_deg", "empty"]),
        (HEAD + "[[sweep]]\ntheta_i_deg = [1]\ntheta_r_deg = 5\n", ["theta_r_deg", "list"]),
        (
            HEAD + "[[sweep]]\ntheta_i_deg = [1]\ntheta_r_deg = {start=5,stop=1,step=1}\n",
            ["theta_r_deg", "start <= stop"],
        ),
        (HEAD + "[[sweep]]\ntheta_i_deg = [1]\ntheta_r_deg = {start=1,stop=5,stp=1}\n", ["stp", "step"]),
        (HEAD + "[[sweep]]\ntheta_i_deg = [1]\ntheta_r_deg = {start=1,stop=5,step=1e-9}\n", ["larger step"]),
        (HEAD + "[[sweep]]\ntheta_i_deg = [nan]\ntheta_r_deg = [1]\n", ["theta_i_deg"]),
        (HEAD + "[[sweep]]\ntheta_i_deg = [true]\ntheta_r_deg = [1]\n", ["theta_i_deg", "number"]),
        (HEAD + "[[sweep]]\ntheta_i_deg = [1]\ntheta_r_deg = {start=false,stop=5,step=1}\n", ["theta_r_deg", "start"]),
        (HEAD + "[[swep]]\ntheta_i_deg = [1]\n", ["swep", "sweep"]),
        (HEAD + '[[points]]\nfile = "absent.csv"\n', ["absent.csv", "no such file"]),
        (HEAD + '[[points]]\nfile = "columns.csv"\n', ["columns.csv", "phi_i_deg"]),
        (HEAD + '[[points]]\nfile = "words.csv"\n', ["words.csv", "line 3", "theta_r_deg", "much"]),
        (HEAD + '[[points]]\nfile = "short.csv"\n', ["short.csv", "line 2", "phi_r_deg"]),
        (HEAD + '[[points]]\nfile = "steep.csv"\n', ["steep.csv", "theta_i_deg", "95", "90"]),
        (HEAD + '[[points]]\nfile = "empty.csv"\n', ["empty.csv", "no points"]),
        (HEAD + '[[points]]\nfile = "twice.csv"\n', ["twice.csv", "theta_i_deg", "2 times"]),
        (HEAD + '[[points]]\nfile = "long.csv"\n', ["long.csv", "line", "field"]),
        (
            HEAD + "[[sweep]]\ntheta_i_deg={start=0,stop=80,step=0.01}\ntheta_r_deg={start=0,stop=80,step=0.01}\n",
            ["plan.toml", "64016001 points", "1000000"],
        ),
        (HEAD.replace("550", "-5") + "[[sweep]]\ntheta_i_deg = [1]\ntheta_r_deg = [1]\n", ["wavelength_nm"]),
    ],
)
def test_a_wrong_plan_names_file_key_and_remedy(tmp_path: Path, text: str, words: list[str]) -> None:
    head = "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg\n"
    (tmp_path / "columns.csv").write_text("theta_i_deg,theta_r_deg,phi_r_deg\n1,2,3\n")
    (tmp_path / "words.csv").write_text(head + "1,2,3,4\n1,2,much,4\n")
    (tmp_path / "short.csv").write_text(head + "1,2,3\n")
    (tmp_path / "steep.csv").write_text(head + "95,2,3,4\n")
    (tmp_path / "empty.csv").write_text(head)
    (tmp_path / "twice.csv").write_text("theta_i_deg," + head + "1,2,3,4,5\n")
    (tmp_path / "long.csv").write_text(head + "1" * 200_000 + "\n")
    with pytest.raises(ConfigError) as caught:
        plan(tmp_path, text)
    for word in words:
        assert word in str(caught.value)


def test_a_band_that_the_rig_lacks_names_the_plan(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"plan\.toml: wavelength_nm = 450 .* green"):
        plan(tmp_path, PLAN.replace("550, 650", "450")).bands(describe())  # type: ignore[attr-defined]


def test_nothing_reachable_is_an_error_with_the_reasons(tmp_path: Path) -> None:
    found = plan(tmp_path, HEAD + "[[sweep]]\ntheta_i_deg = [20, 30]\ntheta_r_deg = [-25]\n")
    near = Geometry(light_distance_mm=300, camera_distance_mm=300)
    with pytest.raises(ConfigError, match=r"no point can be reached[^$]*2 blocked: .* 10\.5 deg"):
        schedule(found, describe(geometry=near))  # type: ignore[arg-type]


def test_a_reference_out_of_reach_names_the_rig_file(tmp_path: Path) -> None:
    rig = describe(reference=Reference(theta_i_deg=20, theta_r_deg=-20))
    with pytest.raises(ConfigError, match=r"\[reference\] theta_i_deg = 20"):
        schedule(plan(tmp_path, PLAN), rig)  # type: ignore[arg-type]


def test_an_azimuth_of_incidence_in_a_sweep_is_told_where_it_belongs(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"azimuth 0.*\[\[points\]\].*phi_i_deg") as refused:
        plan(tmp_path, "[[sweep]]\ntheta_i_deg = [20]\nphi_i_deg = [0, 45, 90]\ntheta_r_deg = [10]\n")
    assert "dphi_deg" not in str(refused.value)  # that is another angle


def test_points_that_errors_of_alignment_close_are_counted_and_said() -> None:
    """A lamp off the plane of its arm never stands on the normal of a rig with an azimuth axis."""
    arm = ArmAxis(limits_deg=(-89.0, 89.0), elevation_deg=0.2)
    arms = Arms(light=arm, camera=ArmAxis(limits_deg=(-89.0, 89.0)), azimuth=ArmAxis(limits_deg=(-190.0, 190.0)))
    rig = describe(arms=arms, holder=Holder(axes=("spin",)))
    asked = Plan("x", (550.0,), (Point(0.0, 0.0, 45.0, 180.0), Point(30.0, 0.0, 45.0, 180.0)), 0, "plan.toml")
    count, most_deg = beside(assess(asked, rig), rig)
    assert count == 1
    assert most_deg == pytest.approx(0.2, rel=0.01)  # the closest pose is off by the elevation
    assert "1 of the points that are measured lie up to 0.2 deg beside" in said_beside(assess(asked, rig), rig)[0]
    assert said_beside(assess(asked, describe()), describe()) == []
