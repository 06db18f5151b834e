"""The least-squares problem of a rig's geometry: what is sought, what a rig would see, and how the fit is found.

A `Sighting` is what one frame (or two at one pose) showed: the middle of the lamp, in a mirror or straight through an
empty holder, and the corners of the printed markers. What a rig file says of the rig predicts both (`kinematics.view`,
`imaging.project`). The unknowns are numbers of the rig file, by their paths. So a new error of alignment is a line in
`unknowns`, and nothing else.

Between two counts an encoder tells nothing: at every pose each axis is off by up to half a step. With D the slopes of a
sighting by its axes, its covariance is S = sigma^2 1 + D diag(step^2 / 12) D^T, common to all that it shows.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio.config import numbers_in, parse, with_numbers
from gonio.lab.rig import Pose, imaging, kinematics
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.fiducials import corners_mm
from gonio.typing import Floats, TomlTable

ORDERS = (1, 2)
"""Orders of an encoder's errors within a turn: a disc off its centre; a bent one, or one with two reading heads."""
INK = "holder.fiducials.marker_mm"
"""Ink spreads, and a corner's window sees more black than white: both move corners, so this number is no result."""
KNOWN = 0.5
"""A number is known where its uncertainty is below this share of what was expected of it."""
CORNER_FLOOR_PX = 0.01
"""What corners of printed squares are off beyond their scatter: windows see neighbours, edges lie oblique."""
SPOT_FLOOR_PX = 0.1
"""What the middle of the lamp is off: brightness is not quite even over its image."""
STEP = 1e-3
"""Step of a numerical slope, in `Unknown.within`: the model is straight over it, and rounding is far below it."""
LOST_PX = 1e5
"""Residual of what a rig with some values would not see at all."""
LEAST_HARMONIC_DEG = 0.02
"""What is expected of an encoder's errors where none are seen."""
LEARNING_STEPS = 200
LEARNT = 0.1
"""Change of the logarithm of an expected variance below which no number moves by a tenth of its uncertainty."""
MOST_STEPS = 15
CLOSED = 0.03
"""Largest last step of a search that has converged, in standard deviations."""
Given = tuple[Sequence[str], Floats, Floats]
"""Paths, values and covariance of numbers that something else has determined: intrinsics from a board."""


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
    """Which corners of the markers (`gonio.lab.calibration.fiducials.detect`)."""
    corners_px: tuple[tuple[float, float], ...] = ()
    u_corner_px: float = 0.0

    @property
    def pixels(self) -> Floats:
        """The spot, where there is one, and the corners, shape (n, 2)."""
        return np.array([*([self.spot_px] if self.spot_px is not None else []), *self.corners_px]).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class Unknown:
    """A number of the rig file that is to be found."""

    path: str
    within: float
    """Standard deviation of what is expected around the rig file's value, in the unit of the path."""
    words: str


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
    tilt, spin, azimuth = ("tilt" in axes), ("spin" in axes), description.arms.azimuth is not None
    sought: list[tuple[bool, str, float, str]] = []
    for arm in ("light", "camera"):
        lamp, about = arm == "light", f"arms.{arm}"
        sought.append((True, f"{about}.zero_offset_deg", 10.0, f"zero of the {arm} arm"))
        for row, order in enumerate(orders(description, arm)):
            of = f"of order {order} of the {arm} arm's encoder"
            sought += [(True, f"{about}.harmonics_deg[{row}][1]", 0.5, f"cosine {of}"),
                       (True, f"{about}.harmonics_deg[{row}][2]", 0.5, f"sine {of}")]  # fmt: skip
        backlash = any(arm in s.against for s in sightings)
        sought += [
            (lamp or not tilt, f"{about}.axis_tilt_deg[0]", 1.0, f"tilt of the {arm} arm's axis about x"),
            (lamp or tilt or not spin, f"{about}.axis_tilt_deg[1]", 1.0, f"tilt of the {arm} arm's axis about z"),
            (not lamp, f"{about}.axis_offset_mm[0]", 2.0, f"offset of the {arm} arm's axis along x"),
            (not lamp, f"{about}.axis_offset_mm[1]", 2.0, f"offset of the {arm} arm's axis along z"),
            (True, f"{about}.elevation_deg", 1.0, f"elevation of the {arm} over its arm's plane"),
            (backlash, f"{about}.backlash_deg", 1.0, f"backlash of the {arm} arm"),
        ]
    far = description.geometry
    sought += [
        (azimuth, "arms.azimuth.zero_offset_deg", 10.0, "zero of the azimuth axis"),
        (azimuth, "arms.azimuth.axis_tilt_deg[0]", 1.0, "tilt of the azimuth axis about x"),
        (azimuth, "arms.azimuth.axis_tilt_deg[1]", 1.0, "tilt of the azimuth axis about y"),
        (tilt, "holder.tilt_zero_offset_deg", 10.0, "zero of the tilt"),
        (tilt, "holder.tilt_axis_offset_mm", 2.0, "distance between tilt and spin axis"),
        (tilt, "holder.surface_offset_mm", 2.0, "offset of the surface from the crossing of the axes"),
        (spin and marks, "holder.spin_zero_offset_deg", 10.0, "zero of the spin (of the markers' x axis)"),
        (spin and marks, "holder.sample_offset_mm[0]", 2.0, "centre of the markers beside the spin axis, along x"),
        (spin and marks, "holder.sample_offset_mm[1]", 2.0, "centre of the markers beside the spin axis, along y"),
        (spin, "holder.surface_tilt_deg[0]", 1.0, "tilt of the surface against the spin axis about x"),
        (spin, "holder.surface_tilt_deg[1]", 1.0, "tilt of the surface against the spin axis about y"),
        (spin and tilt, "holder.spin_axis_tilt_deg", 1.0, "lean of the spin axis toward the tilt axis"),
        (marks, INK, 0.1, "side of the markers, as ink spreads"),
        (True, "camera.roll_deg", 2.0, "roll of the camera"),
        (True, "camera.pointing_deg[0]", 0.5, "pointing of the camera along columns"),
        (True, "camera.pointing_deg[1]", 0.5, "pointing of the camera along rows"),
        (True, "geometry.light_distance_mm", 0.03 * far.light_distance_mm, "distance of the lamp"),
        (True, "geometry.camera_distance_mm", 0.03 * far.camera_distance_mm, "distance of the camera"),
    ]
    return [Unknown(path, within, words) for there, path, within, words in sought if there]


def orders(description: RigDescription, arm: str) -> list[int]:
    """Orders of an arm's harmonics: the rig file's own, then those of `ORDERS` that it lacks."""
    own = [row[0] for row in getattr(description.arms, arm).harmonics_deg]
    return own + [order for order in ORDERS if order not in own]


def start_of(description: RigDescription) -> TomlTable:
    """The rig file's tables, with a place for every number that may be sought."""
    tables = description.model_dump(mode="json")
    for arm in ("light", "camera"):
        own = {order: [order, *terms] for order, *terms in getattr(description.arms, arm).harmonics_deg}
        rows = [own.get(order, [order, 0.0, 0.0]) for order in orders(description, arm)]
        tables["arms"][arm]["harmonics_deg"] = rows
    for name in ("tilt", "spin"):
        if name in description.holder.axes:
            tables["holder"][f"{name}_zero_offset_deg"] = description.holder.of(name).zero_offset_deg
    return tables


def start_values(description: RigDescription, paths: Sequence[str]) -> Floats:
    """Some of the numbers in `start_of`."""
    there = numbers_in(start_of(description))
    return np.array([there[path] for path in paths], float)


class Predictor:
    """What a rig would see. What the readings of its axes mean is looked up once for all sightings."""

    def __init__(self, description: RigDescription) -> None:
        axes, approach = description.axes(), description.approach_deg()
        self._rig = description
        self._zero_deg = {name: axis.zero_offset_deg for name, axis in axes.items()}
        # with the sign in which an arm lags that arrived from the other side
        self._lag_deg = {name: math.copysign(axis.backlash_deg, approach[name] or 1.0) for name, axis in axes.items()}

    def __call__(self, s: Sighting, shift_deg: dict[str, float] | None = None) -> Floats:
        """The spot, if there is one, and the corners [px], shape (n, 2); `shift_deg`: of axes."""
        shifts = shift_deg or {}
        lags = {name: self._lag_deg[name] for name in s.against}
        rig, marks = self._rig, self._rig.holder.fiducials
        view = kinematics.view(rig, Pose(**{
            name: math.radians(encoder - self._zero_deg[name] + shifts.get(name, 0.0) + lags.get(name, 0.0))
            for name, encoder in s.encoder_deg.items()
        }))  # fmt: skip
        points = np.zeros((len(s.pixels), 3))
        if s.corners and marks is not None:
            points[-len(s.corners) :, :2] = corners_mm(marks).reshape(-1, 2)[list(s.corners)]
        if s.spot_px is not None:
            points[0] = np.asarray(view.source_mm) * [1.0, 1.0, -1.0 if s.holder == "mirror" else 1.0]
        return np.stack(imaging.project(rig, view, points), axis=1)


class SightingsProblem:
    """The least-squares problem of some sightings."""

    def __init__(
        self, description: RigDescription, sightings: Sequence[Sighting], sought: Sequence[Unknown],
        given: Given | None = None,
    ) -> None:  # fmt: skip
        """`given`: what something else has determined."""
        paths, values, covariance = given or ((), np.zeros(0), np.zeros((0, 0)))
        self.sightings = list(sightings)
        self.unknowns = [*sought, *(Unknown(path, 1.0, path) for path in paths)]
        self.x = np.zeros(len(self.unknowns))
        self.within = np.array([*(u.within for u in sought), *np.sqrt(np.diag(covariance))])
        self.start = start_values(description, [u.path for u in self.unknowns])
        self._tables = start_of(description)
        prior = np.diag(self.within**2)
        if given:
            n = len(sought)
            self.start[n:], prior[n:, n:] = values, covariance
        self._at_first = prior / np.outer(self.within, self.within)
        self._expected = self._at_first.copy()
        self._prior = _whitening(self._expected)
        self._pixels = [s.pixels.ravel() for s in self.sightings]
        self._whitening: list[Floats] = []

    def described(self, x: Floats) -> RigDescription:
        """The rig of some values, given in units of what is expected, from the start."""
        values = self.start + x * self.within
        named = {
            u.path: max(float(v), 0.0) if u.path.endswith("backlash_deg") else float(v)
            for u, v in zip(self.unknowns, values, strict=True)
        }
        return parse(RigDescription, with_numbers(self._tables, named), "calibration")

    def whiten(self, x: Floats) -> None:
        """Covariances of the sightings, with the slopes by the axes at some values."""
        rig = self.described(x)
        seen, axes = Predictor(rig), rig.axes()
        steps = {n: math.hypot(a.encoder_step_deg / math.sqrt(12.0), a.encoder_noise_deg) for n, a in axes.items()}
        self._whitening = []
        for s in self.sightings:
            base, corners = seen(s).ravel(), 2 * len(s.corners)
            spot, corner = math.hypot(s.u_spot_px, SPOT_FLOOR_PX), math.hypot(s.u_corner_px, CORNER_FLOOR_PX)
            covariance = np.diag(np.array([spot] * (len(base) - corners) + [corner] * corners) ** 2)
            for name in s.encoder_deg:
                if steps[name] > 0.0:
                    slope = (seen(s, {name: 0.01}).ravel() - base) / 0.01 * steps[name]
                    covariance += np.outer(slope, slope)
            self._whitening.append(_whitening(covariance))

    def of_sightings(self, rig: RigDescription) -> list[Floats]:
        """Whitened residuals, sighting by sighting; what would lie behind the camera is very far off."""
        seen, out = Predictor(rig), []
        for s, pixels, whitening in zip(self.sightings, self._pixels, self._whitening, strict=True):
            left = pixels - seen(s).ravel()
            out.append(whitening @ np.where(np.isfinite(left), left, LOST_PX))
        return out

    def residuals(self, x: Floats) -> Floats:
        """Residuals of all sightings, then of what was expected."""
        return np.concatenate([*self.of_sightings(self.described(x)), self._prior @ x])

    def jacobian(self, x: Floats) -> Floats:
        """Slopes of `residuals`."""
        base = self.residuals(x)
        return np.stack([(self.residuals(x + step) - base) / STEP for step in STEP * np.eye(len(x))], axis=1)

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
        harmonics = [(k, u.path.split(".")) for k, u in enumerate(self.unknowns) if "harmonics_deg" in u.path]
        orders = {
            k: self._tables["arms"][arm]["harmonics_deg"][int(rest.split("[")[1][:-1])][0]
            for k, (_, arm, rest) in harmonics
        }
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


def _whitening(covariance: Floats) -> Floats:
    """What makes numbers of this covariance independent, with variance 1."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance + 1e-12 * np.eye(len(covariance)))))
