"""A rig's geometry by one least-squares fit to everything that was seen: zeros, encoders, axes, holder, distances.

The gauge, which no measurement can tell: see `unknowns`. Every unknown is expected within a wide, stated range around
the rig file's value (`Unknown.within`). A direction that the sightings tell less of than that is not determined. A
number is known where its uncertainty is less than half of that range.
"""

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np

from gonio.errors import DataError
from gonio.lab.calibration.geometry_problem import (
    CORNER_FLOOR_PX,
    INK,
    KNOWN,
    Given,
    Predictor,
    Sighting,
    SightingsProblem,
    Unknown,
    orders,
    start_values,
    unknowns,
)  # fmt: skip
from gonio.lab.rig.description import RigDescription
from gonio.typing import Figure, Floats, TomlTable

ZERO_KNOWN = 0.15
"""As `KNOWN`, of zeros, of which next to nothing is expected: 1.5 deg. A rig without markers reaches about 1 deg, as
far as its camera points to the middle; a mirror alone, 2 deg and more."""
CONTRADICTS = 3.0
"""Combined standard uncertainties between what was measured and what the rig file says beyond which one is wrong."""
SAID_DEG = 3.0
"""A sum or difference of zeros that is known as well as this is reported in words."""
TOLD = 1.0
"""Singular value of the scaled, whitened Jacobian below which a direction is not determined: less than expected."""
HARMONIC_ROUNDS = 4
FEW = 3
"""Degrees of freedom up to which the variance of a Student distribution is not finite."""
REMEDIES = {
    "mirror frames": "a mirror in the holder (--holder mirror)",
    "straight-through frames": "an empty holder, and limits_deg of both arms that let them face each other (95 deg)",
    "frames of fiducials": "printed markers (--print-fiducials, [holder.fiducials])",
}
"""What would tell numbers that are open, by what is missing."""
REACH = "more poses (no --quick), and limits_deg of the arms that reach farther,"
FAR = 5.0
"""Standard deviations from the fit beyond which what was seen is not what was meant."""


@dataclass(frozen=True, slots=True)
class Fit:
    """What the sightings say."""

    description: RigDescription
    """The rig file with every value of the fit in it, also those that are not known."""
    unknowns: tuple[Unknown, ...]
    values: Floats
    covariance: Floats
    known: tuple[bool, ...]
    rank: int
    """Directions of the parameters' space that the sightings determine."""
    misfit: float
    """Chi-square over degrees of freedom."""
    freedom: float
    open: tuple[str, ...]
    """In words, what remains undetermined."""
    residuals_px: list[Floats] = field(default_factory=list)
    """A sighting each: what is left of the spot, where there is one, and of the corners, shape (n, 2)."""
    sightings: tuple[Sighting, ...] = ()
    """The sightings that were used."""
    dropped: tuple[str, ...] = ()
    """What was left out because it lies too far from all else."""
    warnings: tuple[str, ...] = ()
    """What the rig file says of its zeros, where that is better known than what was measured, or contradicts it."""

    def u(self, path: str) -> float:
        """Standard uncertainty of a number."""
        at = [each.path for each in self.unknowns].index(path)
        return math.sqrt(float(self.covariance[at, at]))

    def value(self, path: str) -> float:
        """The fitted number."""
        return float(self.values[[each.path for each in self.unknowns].index(path)])


def _solved(
    description: RigDescription,
    sightings: Sequence[Sighting],
    sought: list[Unknown],
    given: Given | None,
) -> tuple[SightingsProblem, Floats, list[Sighting], list[str]]:
    """The least squares of the sightings, those that are far off left out; which are kept, and which are not."""
    dropped: list[str] = []
    kept = list(sightings)
    for _ in range(4):
        problem = SightingsProblem(description, kept, sought, given)
        x = problem.solved()
        for _ in range(HARMONIC_ROUNDS):
            if not problem.expect_harmonics():
                break
            x = problem.solved()
        sizes = problem.of_sightings(problem.described(x))
        chi = np.array([float(r @ r) / len(r) if len(r) else 0.0 for r in sizes])
        typical = max(float(np.median(chi)), 1.0)
        bad = [
            k for k in range(len(kept)) if len(sizes[k]) and float(np.abs(sizes[k]).max()) > FAR * math.sqrt(typical)
        ]
        if not bad or len(bad) > 0.2 * len(kept):
            break
        dropped += [_said(kept[k]) for k in bad]
        kept = [s for k, s in enumerate(kept) if k not in bad]
    return problem, x, kept, dropped


def solve(
    description: RigDescription,
    sightings: Sequence[Sighting],
    given: Given | None = None,
) -> Fit:
    """Fit a rig's geometry.

    Parameters
    ----------
    description
        The rig as its file has it, from which the fit starts.
    sightings
        At least a few, of any kind.
    given
        Paths, values and covariance of numbers that something else has determined: intrinsics from a board.

    Raises
    ------
    DataError
        There are no sightings, or they do not fit the rig at all.
    """
    if not any(s.spot_px is not None or s.corners for s in sightings):
        raise DataError("nothing was seen: neither the lamp nor a marker")
    sought = unknowns(description, sightings)
    problem, x, kept, dropped = _solved(description, sightings, sought, given)
    rig = problem.described(x)
    sizes, seen = problem.of_sightings(rig), Predictor(rig)
    jacobian = problem.jacobian(x)
    rows = sum(map(len, sizes))
    data, prior = jacobian[:rows], jacobian[rows:]
    square = np.zeros((len(x), len(x)))
    triangle = np.linalg.qr(data, mode="r")  # which has the singular values of the whole
    square[: len(triangle)] = triangle
    _, singular, right = np.linalg.svd(square)
    freedom = rows - float(np.sum(singular**2 / (1.0 + singular**2)))
    chi_square = float(sum(r @ r for r in sizes))
    misfit = chi_square / freedom if freedom > 0 else 1.0
    student = freedom / (freedom - 2.0) if freedom >= FEW else float(FEW)
    covariance = np.asarray(np.linalg.inv(data.T @ data / (max(1.0, misfit) * student) + prior.T @ prior), float)
    _add_scale(covariance, problem, kept)
    ours = len(sought)
    enough = [ZERO_KNOWN if u.path.endswith("zero_offset_deg") else KNOWN for u in problem.unknowns]
    known = tuple(bool(covariance[k, k] < enough[k] ** 2) or k >= ours for k in range(len(x)))
    scale = np.outer(problem.within, problem.within)
    fit = Fit(
        description=rig,
        unknowns=tuple(problem.unknowns),
        values=problem.start + x * problem.within,
        covariance=np.asarray(covariance * scale, float),
        known=known,
        rank=int(np.count_nonzero(singular[: len(x)] >= TOLD)),
        misfit=misfit,
        freedom=freedom,
        open=(),
        residuals_px=[s.pixels - seen(s) for s in kept],
        sightings=tuple(kept),
        dropped=tuple(dropped),
    )
    return weighed(replace(fit, open=_open(fit, kept, right[singular < TOLD])), description)


def _add_scale(covariance: Floats, problem: SightingsProblem, sightings: Sequence[Sighting]) -> None:
    """What corners are off in the same way in all sightings changes the size of their picture, and so the distance."""
    sizes = [float(np.sqrt(np.var(s.corners_px, axis=0).sum())) for s in sightings if s.corners]
    for k, unknown in enumerate(problem.unknowns):
        if unknown.path == "geometry.camera_distance_mm" and sizes:
            covariance[k, k] += (CORNER_FLOOR_PX / np.median(sizes) * problem.start[k] / problem.within[k]) ** 2


def claims(filed: RigDescription) -> dict[str, float]:
    """Standard uncertainties [deg] of the zeros that a rig file says to know, by their paths."""
    return {
        f"arms.{name}.zero_offset_deg" if name not in ("tilt", "spin") else f"holder.{name}_zero_offset_deg":
        axis.zero_u_deg
        for name, axis in filed.axes().items() if axis.zero_offset_known and axis.zero_u_deg > 0.0
    }  # fmt: skip


def weighed(fit: Fit, filed: RigDescription) -> Fit:
    """A fit with what the rig file knows of its zeros (`zero_u_deg`), which is independent of the sightings.

    Where both agree, the mean by their weights is taken: nothing that is known is replaced by something worse. What the
    file says counts for less as it lies farther off: its uncertainty grows with the distance, in combined ones. Beyond
    `CONTRADICTS` of these it is not believed. A zero that the sightings do not determine stays as the file has it.
    A zero without `zero_u_deg`, or one that is hidden, claims nothing.
    """
    paths = [u.path for u in fit.unknowns]
    start = start_values(filed, paths)
    values, covariance, said = fit.values.copy(), fit.covariance.copy(), []
    for path, claimed in claims(filed).items():
        if path not in paths:
            continue
        k = paths.index(path)
        value, u = float(fit.values[k]), fit.u(path)
        apart = (value - float(start[k])) / math.hypot(u, claimed)
        both = f"{path}: measured {value:.3f} deg, u = {u:.2g}; the rig file says {start[k]:.3f} deg, u = {claimed:.2g}"
        if abs(apart) > CONTRADICTS:
            then = "the measured one is taken" if fit.known[k] else "neither is to be trusted"
            said.append(
                f"{both}. They contradict each other by {abs(apart):.1f} combined standard uncertainties, and {then}: "
                "was the axis taken off, or its zero set, since zero_u_deg was written"
            )
            continue
        if u > claimed:
            then = "their weighted mean is taken" if fit.known[k] else "that is not replaced, and it was not checked"
            said.append(
                f"{both}. They are {abs(apart):.1f} apart, in combined ones. The rig file knows it better: {then}"
            )
        if fit.known[k]:
            column = covariance[:, k] / ((claimed * max(1.0, abs(apart))) ** 2 + covariance[k, k])
            values += column * (start[k] - values[k])
            covariance -= np.outer(column, covariance[k])
    return replace(fit, values=values, covariance=covariance, warnings=tuple(said))


def _said(s: Sighting) -> str:
    return f"{s.holder} at {', '.join(f'{n} {v:.1f}' for n, v in s.encoder_deg.items())} deg"


# ---- what is not determined ----


def _open(fit: Fit, sightings: Sequence[Sighting], null: Floats) -> tuple[str, ...]:
    """In words: what the sightings leave open, and what is missing for it."""
    there = {
        "mirror frames": any(s.holder == "mirror" and s.spot_px for s in sightings),
        "straight-through frames": any(s.holder == "empty" and s.spot_px for s in sightings),
        "frames of fiducials": any(s.corners for s in sightings),
    }
    missing = [name for name, seen in there.items() if not seen]
    why = f": no {' and no '.join(missing)}" if missing else ""
    paths, out = [u.path for u in fit.unknowns], []
    unknown = {u.path: u.words for u, known in zip(fit.unknowns, fit.known, strict=True) if not known and u.path != INK}
    zeros = ["arms.light.zero_offset_deg", "arms.camera.zero_offset_deg"]
    if all(z in unknown for z in zeros):
        out.append(f"light zero and camera zero: {_zeros_together(fit, *map(paths.index, zeros))}{why}")
        unknown = {p: w for p, w in unknown.items() if p not in zeros}
    for direction in null:
        strong = [k for k in np.argsort(-np.abs(direction)) if abs(direction[k]) > 0.35 and paths[k] in unknown]
        if len(strong) > 1:
            out.append(f"only a combination is known of: {' and '.join(unknown.pop(paths[k]) for k in strong)}{why}")
    if unknown:
        out.append(f"not known any better than was expected{why}: {', '.join(unknown.values())}")
    if out:
        remedies = [REMEDIES[name] for name in missing] or [REACH]
        out.append(f"what is open is not written; {' and '.join(remedies)} would tell it")
    return tuple(out)


def _zeros_together(fit: Fit, light: int, camera: int) -> str:
    """What is known of the sum or the difference of two zeros, neither of which is known."""
    c, (zero, other) = fit.covariance, fit.values[[light, camera]]
    both, cross = c[light, light] + c[camera, camera], 2.0 * c[light, camera]
    together = [
        (both + cross, zero + other, "sum", "difference camera - light"),
        (both - cross, other - zero, "difference camera - light", "sum"),
    ]
    variance, value, best, rest = min(together, key=lambda one: one[0])
    if math.sqrt(variance) >= SAID_DEG:
        return "not known"
    return f"their {best} is {value:.3f} deg (u = {math.sqrt(variance):.3f}), their {rest} is not known"


# ---- what is written ----


def values_of(fit: Fit, filed: RigDescription) -> tuple[TomlTable, list[str], Floats]:
    """The tables of a calibration file, the paths of its uncertain numbers, and their covariance.

    A number that is not known is not written. Where it shares a list with one that is, it stands as in the rig file.
    Cosine and sine of an order of an encoder's harmonics are written together, or not at all.
    """
    keep = {u.path: k for k, u in enumerate(fit.unknowns) if fit.known[k] and u.path != INK}
    pairs = Counter(path.rsplit("[", 1)[0] for path in keep if "harmonics_deg" in path)
    keep = {path: k for path, k in keep.items() if pairs.get(path.rsplit("[", 1)[0], 2) == 2}
    tables: TomlTable = {}
    paths: list[str] = []
    for path, k in keep.items():
        name, value = path.split("[")[0], float(fit.values[k])
        *tops, last = name.split(".")
        place = [int(number) for number in re.findall(r"\[(\d+)\]", path)]
        below: TomlTable = reduce(lambda table, top: table.setdefault(top, {}), tops, tables)
        if len(place) == 2:
            row, column = place
            written = [r for r, _ in enumerate(orders(fit.description, tops[-1])) if pairs[f"{name}[{r}]"] == 2]
            table = below.setdefault(last, [[orders(fit.description, tops[-1])[r], 0.0, 0.0] for r in written])
            table[written.index(row)][column] = value
            path = f"{name}[{written.index(row)}][{column}]"
        elif place:
            below.setdefault(last, list(reduce(getattr, [*tops, last], filed)))[place[0]] = value
        else:
            below[last] = value
        paths.append(path)
    for table in tables.get("arms", {}).values():
        if "zero_offset_deg" in table:
            table |= {"zero_offset_known": True, "zero_u_deg": 0.0}  # the covariance says it
    at = list(keep.values())
    return tables, paths, fit.covariance[np.ix_(at, at)]


def draw(fit: Fit) -> Figure:
    """What the fit leaves: of the lamp against the light arm, and of the corners against the camera arm."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7), layout="constrained")
    panels = figure.subplots(2, 2, sharex="col")
    for left, s in zip(fit.residuals_px, fit.sightings, strict=True):
        lamp = int(s.spot_px is not None)
        spot, corners = left[:lamp], left[lamp:]
        colour = "tab:blue" if s.holder == "mirror" else "tab:orange"
        for row, what in ((0, "columns"), (1, "rows")):
            if len(spot):
                panels[row, 0].plot(s.encoder_deg["light"], spot[0, row], "o", ms=4, color=colour)
            if len(corners):
                x = np.full(len(corners), s.encoder_deg["camera"])
                panels[row, 1].plot(x, corners[:, row], ".", ms=3, color="tab:green", alpha=0.4)
            panels[row, 0].set_ylabel(f"lamp, {what}: seen - fit [px]")
            panels[row, 1].set_ylabel(f"corners, {what}: seen - fit [px]")
    panels[0, 0].set_title("middle of the lamp (blue: mirror; orange: straight through)\nencoder steps are part of it")
    panels[0, 1].set_title("corners of the printed markers")
    panels[1, 0].set_xlabel("encoder of the light arm [deg]")
    panels[1, 1].set_xlabel("encoder of the camera arm [deg]")
    for panel in panels.ravel():
        panel.grid(alpha=0.3)
        panel.axhline(0.0, color="0.3", lw=0.8)
    return figure
