"""A plan as one rig sees it, drawn: the rig from the side and from above at one of its steps, and a map of the points.

Drawn by matplotlib, which is imported when a picture is asked for.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import astuple
from itertools import pairwise
from typing import Any

import numpy as np

from gonio.errors import ConfigError
from gonio.lab.acquisition.plan import Assessed, Plan
from gonio.lab.rig import Pose, Step, motion_planning
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.kinematics import blocked_cone
from gonio.typing import Axes, Figure

COLOURS = {"light": "#e69f00", "camera": "#0072b2", "tilt": "#009e73", "spin": "#009e73", "bench": "#7f7f7f"}
"""Colours of what carries a body: Okabe and Ito's, which all eyes tell apart."""
CARRIED = {"light": "on the light arm", "camera": "on the camera arm", "tilt": "holder", "spin": "holder",
           "bench": "on the bench"}  # fmt: skip
LEFT_OUT = ("#d55e00", "#cc79a7", "#56b4e9", "#f0c419", "#000000", "#999999")
MARKS = ("x", "+", "v", "s", "^", "D")
SHOWN_CAUSES = 6
PANELS = 4
"""Polar maps, one an angle of incidence."""
CIRCLE = np.exp(2j * np.pi * np.arange(48) / 48)
SIDE, ABOVE = (0, 2), (0, 1)
"""Which coordinates of the lab a view shows, to the right and upward: x and z, or x and y."""
ON_THE_WAY = 24
"""Places on each move of the way, of lamp and lens."""


def most_crowded(steps: Sequence[Step], description: RigDescription) -> int:
    """The number of the step in whose pose two bodies are closest, or a cable is shortest."""
    lit = [step for step in steps if step.kind != "dark"]
    found = [
        min(each.values(), default=math.inf)
        for each in motion_planning.clearances(description, [step.pose for step in lit])
    ]
    return lit[int(np.argmin(found))].index


def draw(
    plan: Plan,
    points: Sequence[Assessed],
    steps: Sequence[Step],
    description: RigDescription,
    number: int | None = None,
) -> Figure:
    """The picture of a step, and of what is measured and what is not.

    Parameters
    ----------
    plan, points, steps, description
        What is measured, what `assess` made of it, what `schedule` made of that, and the rig.
    number
        Of the step; the one of `most_crowded` by default.

    Raises
    ------
    ConfigError
        There is no such step.
    """
    from matplotlib.figure import Figure

    number = most_crowded(steps, description) if number is None else number
    if not 0 <= number < len(steps):
        raise ConfigError(f"--step {number}: the steps of this plan are numbered 0 to {len(steps) - 1}")
    step = steps[number]
    before = steps[number - 1].pose if number > 1 else motion_planning.resting(description)
    pose = motion_planning.resting(description) if step.kind == "dark" else step.pose
    figure = Figure(figsize=(11.0, 9.4), layout="constrained")
    rows: Any = figure.subfigures(2, 1, height_ratios=(1.1, 1.0))
    side, above = rows[0].subplots(1, 2)
    for ax, view, words in ((side, SIDE, "from the side, along y"), (above, ABOVE, "from above, along z")):
        _view(ax, description, before, pose, view)
        ax.set_title(words, fontsize=10)
    rows[0].suptitle(_title(step, plan, points, description, pose), fontsize=11)
    unique = {label: each for ax in (side, above) for each, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    rows[0].legend(unique.values(), unique.keys(), loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    _map(rows[1], plan, points, step)
    return figure


def _title(step: Step, plan: Plan, points: Sequence[Assessed], description: RigDescription, pose: Pose) -> str:
    """What is shown, and what is closest there."""
    what = {"dark": "dark frames, at rest", "reference": "white reference"}.get(step.kind, "")
    if step.kind == "point" and step.point is not None:
        p = points[step.point].point
        what = (
            f"point {step.point + 1} of {len(points)}: θi {p.theta_i_deg:g}°, φi {p.phi_i_deg:g}°, "
            f"θr {p.theta_r_deg:g}°, φr {p.phi_r_deg:g}°"
        )
    axes = ", ".join(f"{n} {math.degrees(getattr(pose, n)) + 0.0:.1f}°" for n in description.axes())
    lines = [f"{description.name} — step {step.index}, {what}", axes]
    found = motion_planning.clearances(description, [pose])[0]
    if found:
        (one, other), gap = min(found.items(), key=lambda each: each[1])
        lines.append(f"closest: {one} and {other}, {gap:.0f} mm" if " end" not in one else
                     f"least to spare: {one.split(',')[0]}, {gap:.0f} mm of its length")  # fmt: skip
    return "\n".join(lines)


# ---- the rig ----


def _view(ax: Axes, description: RigDescription, before: Pose, pose: Pose, view: tuple[int, int]) -> None:
    from matplotlib.patches import Polygon

    for body, points in sorted(motion_planning.outlines(description, pose), key=lambda each: each[0].cable):
        ax.add_patch(
            Polygon(
                _hull(points, body.radius, view), closed=True, alpha=0.2 if body.cable else 0.55, lw=0.8,
                facecolor=COLOURS[body.on[0]] if not body.cable else "#b3b3b3", edgecolor="black",
                ls=":" if body.cable else "-",
                label="where a cable may hang" if body.cable else CARRIED[body.on[0]],
            )
        )  # fmt: skip
    lamp, lens = _heads(description, [pose])
    _cone(ax, description, lamp[0], lens[0], view)
    for hull, name, words in zip(
        motion_planning.beams(description, pose),
        ("light", "camera"),
        ("light to the sample", "sight of the camera"),
        strict=True,
    ):
        beam = _hull(hull, 0.5, view)
        ax.add_patch(Polygon(beam, closed=True, fc=COLOURS[name], ec=COLOURS[name], lw=1.0, label=words))
    for cable in description.cables:
        ends = motion_planning.cable_ends(description, pose, cable)
        ax.plot(*ends[:, view].T, color="black", lw=1.2, ls="--", label="cable, straight")
    try:
        legs = [before, *motion_planning.route(description, before, pose)] if before != pose else [pose]
    except motion_planning.Blocked:  # of a rig that stands elsewhere than the plan has it
        legs = [pose]
    way = [
        Pose(*((1.0 - t) * x + t * y for x, y in zip(astuple(a), astuple(b), strict=True)))
        for a, b in pairwise(legs)
        for t in np.linspace(0, 1, ON_THE_WAY)
    ]
    for name, track in zip(("light", "camera"), _heads(description, way or [pose]), strict=True):
        ax.plot(*track[:, view].T, ls=":", lw=1.4, color=COLOURS[name], label=f"way of the {name} head to here")
    _limits(ax, description, view)
    ax.plot(0, 0, marker="o", ms=3, color="black")
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.set_xlabel("x / mm")
    ax.set_ylabel(f"{'xyz'[view[1]]} / mm")
    ax.tick_params(labelsize=8)
    ax.grid(visible=True, lw=0.3)


def _heads(description: RigDescription, poses: Sequence[Pose]) -> tuple[np.ndarray, np.ndarray]:
    """Where lamp and lens are, shape (poses, 3) [mm]."""
    found = [motion_planning.beams(description, pose) for pose in poses]
    lamp, lens = (np.array([each[k][len(each[k]) // 2 :].mean(axis=0) for each in found]) for k in range(2))
    return lamp, lens


def _hull(corners: np.ndarray, radius: float, view: tuple[int, int]) -> np.ndarray:
    """The outline of a body in a view: the hull of circles around its corners, shape (n, 3) [mm]."""
    flat = corners[:, view]
    around = radius * np.stack([CIRCLE.real, CIRCLE.imag], axis=1) if radius else np.zeros((1, 2))
    every = sorted({(round(x, 6), round(y, 6)) for x, y in (flat[:, None] + around[None]).reshape(-1, 2).tolist()})
    out: list[tuple[float, float]] = []
    for points in (every, every[::-1]):  # Andrew's monotone chain
        chain: list[tuple[float, float]] = []
        for p in points:
            while len(chain) > 1 and _turns(chain[-2], chain[-1], p) <= 0.0:
                chain.pop()
            chain.append(p)
        out += chain[:-1]
    return np.array(out or every)


def _turns(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _cone(ax: Axes, description: RigDescription, lamp: np.ndarray, lens: np.ndarray, view: tuple[int, int]) -> None:
    """The cone around the light where the camera may not look from."""
    from matplotlib.patches import Polygon

    half = blocked_cone(description)
    if half <= 0.0:
        return
    far = float(np.linalg.norm(lens))
    axis = lamp / np.linalg.norm(lamp)
    x = np.cross(axis, (0.0, 1.0, 0.0) if abs(axis[1]) < 0.7 else (1.0, 0.0, 0.0))
    x /= np.linalg.norm(x)
    ring = np.outer(CIRCLE.real, x) + np.outer(CIRCLE.imag, np.cross(axis, x))
    rim = far * (math.cos(half) * axis + math.sin(half) * ring)
    cone = _hull(np.vstack([rim, far * axis, np.zeros(3)]), 0.0, view)
    ax.add_patch(Polygon(cone, closed=True, fc="#d55e00", alpha=0.15, ec="none", label="blocked cone around retro"))


def _limits(ax: Axes, description: RigDescription, view: tuple[int, int]) -> None:
    """Arcs of the arms' limits from the side, and of the azimuth's from above."""
    limits, geometry = description.limits_deg(), description.geometry
    far = max(geometry.light_distance_mm, geometry.camera_distance_mm)
    arcs = (("light", 1.13), ("camera", 1.19)) if view == SIDE else (("azimuth", 1.13),) if "azimuth" in limits else ()
    for name, scale in arcs:
        lower, upper = (math.radians(each) for each in limits[name])
        angle = np.linspace(lower, min(upper, lower + 2 * math.pi), 181)
        across, up = (np.sin(angle), np.cos(angle)) if view == SIDE else (np.cos(angle), np.sin(angle))
        colour = COLOURS.get(name, COLOURS["camera"])
        ax.plot(scale * far * across, scale * far * up, color=colour, lw=2.0, solid_capstyle="butt",
                label=f"limits of {name}")  # fmt: skip
        for k in (0, -1):
            ends = np.array([scale - 0.025, scale + 0.025]) * far
            ax.plot(ends * across[k], ends * up[k], color=colour, lw=2.0)


# ---- the points ----


def _map(rows: Any, plan: Plan, points: Sequence[Assessed], step: Step) -> None:
    """Where the detector is asked for: a line an angle of incidence in plane, or polar maps of some of them."""
    directions = plan.directions
    theta_i = np.array([each.point.theta_i_deg for each in points])
    dphi, theta_r = directions.dphi, np.degrees(np.asarray(directions.theta_r))
    why = ["" if each.pose is not None else f"{each.flag}: {each.cause or each.reason}" for each in points]
    causes = Counter(filter(None, why))
    named = [words for words, _ in causes.most_common(SHOWN_CAUSES - (len(causes) > SHOWN_CAUSES))]
    number = {"": -1} | {words: k for k, words in enumerate(named)}
    kinds = np.array([number.get(words, SHOWN_CAUSES - 1) for words in why])
    flat = np.abs(np.asarray(directions.out_of_plane)) < 1e-6
    here = step.point if step.kind == "point" else None
    if flat.all():
        ax = rows.subplots()
        x, y = np.degrees(np.asarray(directions.signed)), theta_i
        ax.set_xlabel("θr / °: retro side −, mirror side +")
        ax.set_ylabel("θi / °")
        ax.grid(visible=True, lw=0.3)
        ax.margins(0.03, 0.12)
        panels = [(ax, np.full(len(points), fill_value=True), x, y)]
    else:
        angles = np.unique(np.round(theta_i, 6))
        chosen = angles[np.unique(np.linspace(0, len(angles) - 1, min(PANELS, len(angles))).round().astype(int))]
        axes = np.atleast_1d(rows.subplots(1, len(chosen), subplot_kw={"projection": "polar"}))
        panels = []
        for ax, angle in zip(axes, chosen, strict=True):
            ax.set_theta_zero_location("W")  # retro to the left, the mirror direction to the right
            ax.set_theta_direction(-1)
            rim = 180.0 if theta_r.max() > 90.0 else 90.0
            ax.set_rlim(0, rim)
            ax.set_rgrids(rim * np.array([1 / 3, 2 / 3, 1.0]), angle=225.0)
            ax.set_xticks(np.radians([0, 90, 180, 270]), ["retro", "90°", "mirror", "270°"], fontsize=8)
            ax.tick_params(axis="y", labelsize=7)
            ax.set_title(f"θi = {angle:g}°", fontsize=10)
            panels.append((ax, np.abs(theta_i - angle) < 1e-5, dphi, theta_r))
    labelled = {}
    for ax, mine, x, y in panels:
        for kind in range(-1, SHOWN_CAUSES):
            at = mine & (kinds == kind)
            words = "measured" if kind < 0 else named[kind] if kind < len(named) else "other reasons"
            count = int((kinds == kind).sum())
            if count:
                drawn = ax.scatter(
                    x[at], y[at], s=12 if kind < 0 else 22, marker="o" if kind < 0 else MARKS[kind],
                    color="#3a9d5d" if kind < 0 else LEFT_OUT[kind], linewidths=1.0, zorder=3,
                )  # fmt: skip
                labelled[f"{count} {words if len(words) <= 130 else words[:127] + '...'}"] = drawn
        if here is not None and mine[here]:
            labelled["the step above"] = ax.scatter(
                x[here], y[here], s=110, marker="o", facecolors="none", edgecolors="black", zorder=4
            )
    heading = f"{plan.name}: {int((kinds < 0).sum())} of {len(points)} points are measured"
    incidences = len(np.unique(np.round(theta_i, 6)))
    if len(panels) < incidences and not flat.all():
        heading += f" (maps of {len(panels)} of {incidences} angles of incidence)"
    rows.suptitle(heading, fontsize=11)
    rows.legend(labelled.values(), labelled.keys(), loc="outside lower center", ncols=1, fontsize=8, frameon=False)
