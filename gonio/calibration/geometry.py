"""A rig's geometry by one least-squares fit to everything that was seen: zeros, encoders, axes, holder, distances.

A `Sighting` is what one frame (or two at one pose) showed: the middle of the lamp, in a mirror or straight through an
empty holder, and the corners of the printed markers. What a rig file says of the rig predicts both (`kinematics.view`,
`imaging.project`). The unknowns are numbers of the rig file, by their paths. So a new error of alignment is a line in
`unknowns`, and nothing else.

Between two counts an encoder tells nothing: at every pose each axis is off by up to half a step. With D the slopes of a
sighting by its axes, its covariance is S = sigma^2 1 + D diag(step^2 / 12) D^T, common to all that it shows.

The gauge, which no measurement can tell: see `unknowns`. Every unknown is expected within a wide, stated range around
the rig file's value (`Unknown.within`). A direction that the sightings tell less of than that is not determined. A
number is known where its uncertainty is less than half of that range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gonio.config import numbers_in, parse, with_numbers
from gonio.documents import TomlTable
from gonio.errors import DataError
from gonio.rig import Pose, imaging, kinematics
from gonio.rig.description import RigDescription
from gonio.rig.fiducials import corners_mm
from gonio.typing import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ORDERS = (1, 2)
"""Of an encoder's errors within its turn: a disc off its centre, and one that is bent or has two reading heads."""
INK = "holder.fiducials.marker_mm"
"""Ink spreads, and a corner's window sees more black than white: both move corners, so this number is no result."""
KNOWN = 0.5
"""A number is known where its uncertainty is below this share of what was expected of it."""
ZERO_KNOWN = 0.15
"""The same of zeros, of which next to nothing is expected: 1.5 deg. A rig without markers reaches about 1 deg, as far
as its camera points to the middle; a mirror alone, 2 deg and more."""
CONTRADICTS = 3.0
"""Combined standard uncertainties between what was measured and what the rig file says beyond which one is wrong."""
SAID_DEG = 3.0
"""A sum or difference of zeros that is known as well as this is reported in words."""
TOLD = 1.0
"""Singular value of the scaled, whitened Jacobian below which a direction is not determined: less than expected."""
CORNER_FLOOR_PX = 0.01
"""What corners of printed squares are off beyond their scatter: windows see neighbours, edges lie oblique."""
SPOT_FLOOR_PX = 0.1
"""What the middle of the lamp is off: brightness is not quite even over its image."""
STEP = 1e-3
"""Of a numerical slope, of `Unknown.within`: a nonlinear model is straight over it, and rounding is far below it."""
LOST_PX = 1e5
"""Of what a rig with some values would not see at all."""
LEAST_HARMONIC_DEG = 0.02
"""What is expected of an encoder's errors where none are seen."""
HARMONIC_ROUNDS = 4
LEARNING_STEPS = 200
LEARNT = 0.1
"""Of the logarithm of an expected variance: a change below it moves no number by a tenth of what it is uncertain."""
MOST_STEPS = 15
CLOSED = 0.03
"""Of the last step, in standard deviations."""
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
class Sighting:
    """What was seen at one pose."""

    holder: str
    """What was in it: "mirror" or "empty"."""
    encoder_deg: dict[str, float]
    """By axis, without any zero taken out."""
    against: tuple[str, ...] = ()
    """Axes that arrived from the other side than `acquisition.approach_deg` says: the arm lags by its backlash."""
    spot_px: tuple[float, float] | None = None
    """Column and row of the middle of the lamp."""
    u_spot_px: float = 0.0
    corners: tuple[int, ...] = ()
    """Which corners of the markers (`gonio.calibration.fiducials.detect`)."""
    corners_px: tuple[tuple[float, float], ...] = ()
    u_corner_px: float = 0.0


@dataclass(frozen=True, slots=True)
class Unknown:
    """A number of the rig file that is to be found."""

    path: str
    within: float
    """Standard deviation of what is expected around the rig file's value, in the unit of the path."""
    words: str


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
    residuals_px: list[tuple[Floats, Floats]] = field(default_factory=list)
    """A sighting each: what is left of the spot (n, 2), and of the corners (m, 2)."""
    sightings: tuple[Sighting, ...] = ()
    """Those that were used."""
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


def unknowns(description: RigDescription, sightings: Sequence[Sighting]) -> list[Unknown]:
    """What is sought on a rig, with the gauge that fixes the lab frame.

    The lab's origin is where the sample's axes cross, and its x axis is the tilt axis. Its y axis has no turn about x
    against the camera arm's axis: `arms.camera.axis_tilt_deg[0]` stays as the rig file has it, and the zero of the tilt
    counts from there. A rig without a tilt has the spin axis for its z axis; one without either has the normal of the
    surface. The sample's x axis goes through the first marker; without markers, the zero of the spin stays as it is.

    Of the lamp only the direction is seen. An axis of its arm that lies x, z off the crossing turns that direction by
    (x cos a - z sin a) / distance, as an encoder's error of order 1 does: the harmonics hold it, and
    `arms.light.axis_offset_mm` stays as the rig file has it.
    """
    axes, marks = description.axes(), any(s.corners for s in sightings)
    geometry = description.geometry
    out: list[Unknown] = []

    def add(path: str, within: float, words: str) -> None:
        out.append(Unknown(path, within, words))

    tilt, spin = "tilt" in axes, "spin" in axes
    for arm in ("light", "camera"):
        add(f"arms.{arm}.zero_offset_deg", 10.0, f"zero of the {arm} arm")
        for row, order in enumerate(_orders(description, arm)):
            add(f"arms.{arm}.harmonics_deg[{row}][1]", 0.5, f"cosine of order {order} of the {arm} arm's encoder")
            add(f"arms.{arm}.harmonics_deg[{row}][2]", 0.5, f"sine of order {order} of the {arm} arm's encoder")
        if arm == "light" or not tilt:
            add(f"arms.{arm}.axis_tilt_deg[0]", 1.0, f"tilt of the {arm} arm's axis about x")
        if arm == "light" or tilt or not spin:
            add(f"arms.{arm}.axis_tilt_deg[1]", 1.0, f"tilt of the {arm} arm's axis about z")
        if arm == "camera":
            add(f"arms.{arm}.axis_offset_mm[0]", 2.0, f"offset of the {arm} arm's axis along x")
            add(f"arms.{arm}.axis_offset_mm[1]", 2.0, f"offset of the {arm} arm's axis along z")
        add(f"arms.{arm}.elevation_deg", 1.0, f"elevation of the {arm} over its arm's plane")
        if any(arm in s.against for s in sightings):
            add(f"arms.{arm}.backlash_deg", 1.0, f"backlash of the {arm} arm")
    if description.arms.azimuth is not None:
        add("arms.azimuth.zero_offset_deg", 10.0, "zero of the azimuth axis")
        add("arms.azimuth.axis_tilt_deg[0]", 1.0, "tilt of the azimuth axis about x")
        add("arms.azimuth.axis_tilt_deg[1]", 1.0, "tilt of the azimuth axis about y")
    if tilt:
        add("holder.tilt_zero_offset_deg", 10.0, "zero of the tilt")
        add("holder.tilt_axis_offset_mm", 2.0, "distance between tilt and spin axis")
        add("holder.surface_offset_mm", 2.0, "offset of the surface from the crossing of the axes")
    if spin:
        if marks:
            add("holder.spin_zero_offset_deg", 10.0, "zero of the spin (of the markers' x axis)")
            add("holder.sample_offset_mm[0]", 2.0, "centre of the markers beside the spin axis, along x")
            add("holder.sample_offset_mm[1]", 2.0, "centre of the markers beside the spin axis, along y")
        add("holder.surface_tilt_deg[0]", 1.0, "tilt of the surface against the spin axis about x")
        add("holder.surface_tilt_deg[1]", 1.0, "tilt of the surface against the spin axis about y")
        if tilt:
            add("holder.spin_axis_tilt_deg", 1.0, "lean of the spin axis toward the tilt axis")
    if marks:
        add(INK, 0.1, "side of the markers, as ink spreads")
    add("camera.roll_deg", 2.0, "roll of the camera")
    add("camera.pointing_deg[0]", 0.5, "pointing of the camera along columns")
    add("camera.pointing_deg[1]", 0.5, "pointing of the camera along rows")
    add("geometry.light_distance_mm", 0.03 * geometry.light_distance_mm, "distance of the lamp")
    add("geometry.camera_distance_mm", 0.03 * geometry.camera_distance_mm, "distance of the camera")
    return out


def _orders(description: RigDescription, arm: str) -> list[int]:
    """Orders of an arm's harmonics: the rig file's own, then those of `ORDERS` that it lacks."""
    own = [row[0] for row in getattr(description.arms, arm).harmonics_deg]
    return own + [order for order in ORDERS if order not in own]


def start_of(description: RigDescription) -> TomlTable:
    """The rig file's tables, with a place for every number that may be sought."""
    tables = description.model_dump(mode="json")
    for arm in ("light", "camera"):
        own = list(getattr(description.arms, arm).harmonics_deg)
        rows = own + [(order, 0.0, 0.0) for order in _orders(description, arm)[len(own) :]]
        tables["arms"][arm]["harmonics_deg"] = [list(row) for row in rows]
    for name in ("tilt", "spin"):
        if name in description.holder.axes:
            tables["holder"][f"{name}_zero_offset_deg"] = description.holder.of(name).zero_offset_deg
    return tables


def predicted(description: RigDescription, s: Sighting, shift: dict[str, float] | None = None) -> tuple[Floats, Floats]:
    """Where a rig would see the spot (n, 2) and the corners (m, 2) of a sighting [px]; `shift`: of axes [deg]."""
    at = _seen(description, _Axes.of(description), s, shift or {})
    lamp = int(s.spot_px is not None)
    return at[:lamp], at[lamp:]


@dataclass(frozen=True, slots=True)
class _Axes:
    """What the readings of a rig's axes mean: looked up once for all sightings."""

    zero_deg: dict[str, float]
    backlash_deg: dict[str, float]
    """With the sign in which an arm lags that arrived from the other side."""

    @classmethod
    def of(cls, description: RigDescription) -> _Axes:
        axes, approach = description.axes(), description.approach_deg()
        return cls(
            {name: axis.zero_offset_deg for name, axis in axes.items()},
            {name: math.copysign(axis.backlash_deg, approach[name] or 1.0) for name, axis in axes.items()},
        )

    def pose(self, s: Sighting, shift: dict[str, float]) -> Pose:
        """What the axes read where the encoders did, the zeros taken out; backlash is added where it is open."""
        backlash = {name: self.backlash_deg[name] for name in s.against}
        return Pose(**{
            name: math.radians(encoder - self.zero_deg[name] + shift.get(name, 0.0) + backlash.get(name, 0.0))
            for name, encoder in s.encoder_deg.items()
        })  # fmt: skip


def _seen(rig: RigDescription, axes: _Axes, s: Sighting, shift: dict[str, float]) -> Floats:
    """The spot, if there is one, and the corners [px], shape (n, 2)."""
    view = kinematics.view(rig, axes.pose(s, shift))
    points = np.zeros((int(s.spot_px is not None) + len(s.corners), 3))
    if s.corners:
        assert rig.holder.fiducials is not None
        points[-len(s.corners) :, :2] = corners_mm(rig.holder.fiducials).reshape(-1, 2)[list(s.corners)]
    if s.spot_px is not None:
        points[0] = view.source_mm
        if s.holder == "mirror":
            points[0, 2] *= -1.0
    return np.stack(imaging.project(rig, view, points), axis=1)


class Problem:
    """The least-squares problem of some sightings."""

    def __init__(
        self, description: RigDescription, sightings: Sequence[Sighting], sought: Sequence[Unknown],
        given: tuple[Sequence[str], Floats, Floats] | None = None,
    ) -> None:  # fmt: skip
        """`given`: paths, values and covariance of numbers that something else has determined (intrinsics)."""
        self.x = np.zeros(len(sought) + (len(given[0]) if given else 0))
        self.sightings = list(sightings)
        self._tables = start_of(description)
        self._fixed = description
        self.unknowns = [*sought, *(Unknown(p, 1.0, p) for p in (given[0] if given else ()))]
        start = _numbers(self._tables, [u.path for u in self.unknowns])
        self.within = np.array([u.within for u in self.unknowns])
        prior = np.diag(self.within**2)
        if given:
            n = len(sought)
            start[n:] = given[1]
            prior[n:, n:] = given[2]
            self.within[n:] = np.sqrt(np.diag(given[2]))
        self.start = start
        self._at_first = prior / np.outer(self.within, self.within)
        self._expected = self._at_first.copy()
        self._prior = _whitening(self._expected)
        self._whitening: list[Floats] = []
        self._pixels = [
            np.array([*([s.spot_px] if s.spot_px is not None else []), *s.corners_px], float).ravel()
            for s in self.sightings
        ]

    def described(self, x: Floats) -> RigDescription:
        """The rig of some values, given in units of what is expected, from the start."""
        values = self.start + x * self.within
        named = {u.path: float(v) for u, v in zip(self.unknowns, values, strict=True)}
        for name in named:
            if name.endswith("backlash_deg"):
                named[name] = max(named[name], 0.0)
        return parse(RigDescription, with_numbers(self._tables, named), "calibration")

    def whiten(self, x: Floats) -> None:
        """Covariances of the sightings, with the slopes by the axes at some values."""
        rig = self.described(x)
        axes = _Axes.of(rig)
        steps = {
            n: math.hypot(a.encoder_step_deg / math.sqrt(12.0), a.encoder_noise_deg) for n, a in rig.axes().items()
        }
        self._whitening = []
        for s in self.sightings:
            base = _seen(rig, axes, s, {}).ravel()
            sigma = np.concatenate([
                np.full(2 * (s.spot_px is not None), math.hypot(s.u_spot_px, SPOT_FLOOR_PX)),
                np.full(2 * len(s.corners), math.hypot(s.u_corner_px, CORNER_FLOOR_PX)),
            ])  # fmt: skip
            covariance = np.diag(sigma**2)
            for name in s.encoder_deg:
                if steps[name] > 0.0:
                    slope = (_seen(rig, axes, s, {name: 0.01}).ravel() - base) / 0.01 * steps[name]
                    covariance += np.outer(slope, slope)
            self._whitening.append(_whitening(covariance))

    def of_sightings(self, rig: RigDescription) -> list[Floats]:
        """Whitened residuals, sighting by sighting; what would lie behind the camera is very far off."""
        axes = _Axes.of(rig)
        out = []
        for s, seen, whitening in zip(self.sightings, self._pixels, self._whitening, strict=True):
            left = seen - _seen(rig, axes, s, {}).ravel()
            left[~np.isfinite(left)] = LOST_PX
            out.append(whitening @ left)
        return out

    def residuals(self, x: Floats) -> Floats:
        """Of all sightings, then of what was expected."""
        return np.concatenate([*self.of_sightings(self.described(x)), self._prior @ x])

    def jacobian(self, x: Floats) -> Floats:
        """Slopes of `residuals`."""
        base = self.residuals(x)
        out = np.empty((len(base), len(x)))
        for k in range(len(x)):
            step = np.zeros(len(x))
            step[k] = STEP
            out[:, k] = (self.residuals(x + step) - base) / STEP
        return out

    def solved(self) -> Floats:
        """Gauss-Newton's method with steps halved where they lead up.

        The weights follow: slopes by the axes are those of the fit.
        """
        x = self.x
        for _ in range(MOST_STEPS):
            self.whiten(x)
            left, slopes = self.residuals(x), self.jacobian(x)
            step = -np.linalg.solve(slopes.T @ slopes, slopes.T @ left)
            size, cost = float(np.linalg.norm(slopes @ step)), float(left @ left)
            for _ in range(8):
                if float(np.sum(self.residuals(x + step) ** 2)) <= cost * (1.0 + 1e-9):
                    break
                step = 0.5 * step
            x = x + step
            if size < CLOSED:
                break
        self.whiten(x)
        self.x = x
        return x

    def expect_harmonics(self) -> bool:
        """Learn from the encoders' errors that are seen how large they are; False where that changes nothing.

        Those of one order have one standard deviation in all arms (an empirical prior): without it a cosine and the
        zero, which look alike over the range of an arm, would hide in each other also on a rig that has none.
        The numbers follow along the slopes at the fit, so that what is learnt and what is fitted close in together.
        Of an order with a number that the sightings do not determine nothing is learnt: few data would make it small.
        """
        rows = sum(map(len, self._pixels))
        left, slopes = self.residuals(self.x)[:rows], self.jacobian(self.x)[:rows]
        information, pull, x = slopes.T @ slopes, slopes.T @ (slopes @ self.x - left), self.x
        orders = {
            k: self._order(u.path) for k, u in enumerate(self.unknowns) if "harmonics_deg" in u.path
        }  # fmt: skip
        before = np.diag(self._expected).copy()
        alone = np.diag(np.linalg.inv(information + np.linalg.inv(self._at_first)))
        learnt = {o for o in orders.values() if all(alone[k] < KNOWN**2 for k, its in orders.items() if its == o)}
        for _ in range(LEARNING_STEPS):
            covariance = np.linalg.inv(information + np.linalg.inv(self._expected))
            x, last = covariance @ pull, np.diag(self._expected).copy()
            for order in learnt:
                mine = [k for k, its in orders.items() if its == order]
                squares = float(np.sum(x[mine] ** 2 + np.diag(covariance)[mine]))
                least = (LEAST_HARMONIC_DEG / self.within[mine[0]]) ** 2
                self._expected[mine, mine] = min((squares + least) / len(mine), 1.0)
            if np.abs(np.log(np.diag(self._expected) / last)).max() < 0.01:
                break
        self._prior = _whitening(self._expected)
        self.x = np.asarray(x, float)
        return bool(np.abs(np.log(np.diag(self._expected) / before)).max() > LEARNT)

    def _order(self, path: str) -> int:
        _, arm, rest = path.split(".")
        return int(self._tables["arms"][arm]["harmonics_deg"][int(rest.split("[")[1][:-1])][0])


def _whitening(covariance: Floats) -> Floats:
    """What makes numbers of this covariance independent, with variance 1."""
    out: Floats = np.linalg.inv(np.linalg.cholesky(covariance + 1e-12 * np.eye(len(covariance))))
    return out


def _solved(
    description: RigDescription,
    sightings: Sequence[Sighting],
    sought: list[Unknown],
    given: tuple[Sequence[str], Floats, Floats] | None,
) -> tuple[Problem, Floats, list[Sighting], list[str]]:
    """The least squares of the sightings, those that are far off left out; which are kept, and which are not."""
    dropped: list[str] = []
    kept = list(sightings)
    for _ in range(4):
        problem = Problem(description, kept, sought, given)
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
    given: tuple[Sequence[str], Floats, Floats] | None = None,
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
    sizes = problem.of_sightings(rig)
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
        residuals_px=[_left(rig, s) for s in kept],
        sightings=tuple(kept),
        dropped=tuple(dropped),
    )
    return weighed(replace(fit, open=_open(fit, kept, right[singular < TOLD])), description)


def _add_scale(covariance: Floats, problem: Problem, sightings: Sequence[Sighting]) -> None:
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
    start = _numbers(start_of(filed), paths)
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
            variance = (claimed * max(1.0, abs(apart))) ** 2 + covariance[k, k]
            column = covariance[:, k] / variance
            values += column * (start[k] - values[k])
            covariance -= np.outer(column, covariance[k])
    return replace(fit, values=values, covariance=covariance, warnings=tuple(said))


def _said(s: Sighting) -> str:
    angles = ", ".join(f"{n} {v:.1f}" for n, v in s.encoder_deg.items())
    return f"{s.holder} at {angles} deg"


def _left(rig: RigDescription, s: Sighting) -> tuple[Floats, Floats]:
    spot, corners = predicted(rig, s)
    seen = np.array([s.spot_px]) if s.spot_px is not None else np.zeros((0, 2))
    return seen - spot, np.array(s.corners_px).reshape(-1, 2) - corners


def _numbers(tables: TomlTable, paths: Sequence[str]) -> npt.NDArray[np.float64]:

    there = numbers_in(tables)
    return np.array([there[path] for path in paths], float)


# ---- what is not determined ----


def _open(fit: Fit, sightings: Sequence[Sighting], null: Floats) -> tuple[str, ...]:
    """In words: what the sightings leave open, and what is missing for it."""
    out = []
    mirror = any(s.holder == "mirror" and s.spot_px for s in sightings)
    straight = any(s.holder == "empty" and s.spot_px for s in sightings)
    marks = any(s.corners for s in sightings)
    missing = [
        text
        for there, text in (
            (mirror, "mirror frames"), (straight, "straight-through frames"), (marks, "frames of fiducials"),
        )
        if not there
    ]  # fmt: skip
    why = f": no {' and no '.join(missing)}" if missing else ""
    paths = [u.path for u in fit.unknowns]
    zeros = ["arms.light.zero_offset_deg", "arms.camera.zero_offset_deg"]
    unknown = {u.path: u.words for u, known in zip(fit.unknowns, fit.known, strict=True) if not known and u.path != INK}
    if all(z in unknown for z in zeros):
        i, j = (paths.index(z) for z in zeros)
        c = fit.covariance
        together = {
            "sum": (fit.values[i] + fit.values[j], c[i, i] + c[j, j] + 2.0 * c[i, j]),
            "difference camera - light": (fit.values[j] - fit.values[i], c[i, i] + c[j, j] - 2.0 * c[i, j]),
        }
        best = min(together, key=lambda name: together[name][1])
        other = next(name for name in together if name != best)
        value, variance = together[best]
        if math.sqrt(variance) < SAID_DEG:
            out.append(
                f"light zero and camera zero: their {best} is {value:.3f} deg (u = {math.sqrt(variance):.3f}), their "
                f"{other} is not known{why}"
            )
        else:
            out.append(f"light zero and camera zero: not known{why}")
        unknown = {p: w for p, w in unknown.items() if p not in zeros}
    for direction in null:
        strong = [k for k in np.argsort(-np.abs(direction)) if abs(direction[k]) > 0.35 and paths[k] in unknown]
        if len(strong) > 1:
            names = " and ".join(fit.unknowns[k].words for k in strong)
            out.append(f"only a combination is known of: {names}{why}")
            for k in strong:
                unknown.pop(paths[k], None)
    if unknown:
        out.append(f"not known any better than was expected{why}: {', '.join(unknown.values())}")
    remedies = [remedy for text, remedy in REMEDIES.items() if text in missing]
    if out:
        out.append(f"what is open is not written; {' and '.join(remedies or [REACH])} would tell it")
    return tuple(out)


# ---- what is written ----


def values_of(fit: Fit) -> tuple[TomlTable, list[str], Floats]:
    """The tables of a calibration file, the paths of its uncertain numbers, and their covariance.

    A number that is not known is not written. Where it shares a list with one that is, it stands as in the rig file.
    """
    keep = [k for k, known in enumerate(fit.known) if known and fit.unknowns[k].path != INK]
    rows: dict[str, list[int]] = {}
    for k, u in enumerate(fit.unknowns):  # cosine and sine of an order belong together
        if "harmonics_deg" in u.path:
            rows.setdefault(u.path.rsplit("[", 1)[0], []).append(k)
    for pair in rows.values():
        if not all(k in keep for k in pair):
            keep = [k for k in keep if k not in pair]
    tables: TomlTable = {}
    paths: list[str] = []
    for k in keep:
        path = fit.unknowns[k].path
        *tops, last = path.split("[")[0].split(".")
        below = tables
        for top in tops:
            below = below.setdefault(top, {})
        if "harmonics_deg" in path:
            row = int(path.split("[")[1][:-1])
            written = [r for r in range(8) if all(i in keep for i in rows.get(f"{path.split('[')[0]}[{r}]", [-1]))]
            order = _orders(fit.description, tops[-1])
            at = written.index(row)
            table = below.setdefault(last, [[order[r], 0.0, 0.0] for r in written])
            column = int(path.rsplit("[", 1)[1][:-1])
            table[at][column] = float(fit.values[k])
            paths.append(f"{path.split('[')[0]}[{at}][{column}]")
            continue
        if "[" in path:
            place = int(path.split("[")[1][:-1])
            whole = fit.description
            for name in (*tops, last):
                whole = getattr(whole, name)
            table = below.setdefault(last, [None] * len(whole))  # type: ignore[arg-type]
            table[place] = float(fit.values[k])
        else:
            below[last] = float(fit.values[k])
        paths.append(path)
    return tables, paths, fit.covariance[np.ix_(keep, keep)]


def filled(tables: TomlTable, rig: RigDescription) -> TomlTable:
    """Lists of which only some numbers are known, with the rest as the rig file has it; and that zeros are known."""
    as_filed = rig.model_dump(mode="python")

    def fill(values: TomlTable, there: TomlTable) -> TomlTable:
        out: TomlTable = {}
        for name, value in values.items():
            if isinstance(value, dict):
                out[name] = fill(value, there[name])
            elif isinstance(value, list):
                out[name] = [there[name][i] if v is None else v for i, v in enumerate(value)]
            else:
                out[name] = value
        return out

    out = fill(tables, as_filed)
    for arm, table in out.get("arms", {}).items():
        if "zero_offset_deg" in table:
            del arm
            table |= {"zero_offset_known": True, "zero_u_deg": 0.0}  # the covariance says it
    return out


def draw(fit: Fit) -> Figure:
    """What the fit leaves: of the lamp against the light arm, and of the corners against the camera arm."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7), layout="constrained")
    panels = figure.subplots(2, 2, sharex="col")
    for (spot, corners), s in zip(fit.residuals_px, fit.sightings, strict=True):
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
