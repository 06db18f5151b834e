"""Scans for an alignment: find the spot, choose exposure and lamp level, scan until the spot lies whole in the scan."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from gonio.errors import ConfigError, DeviceError
from gonio.lab.acquisition import exposure
from gonio.lab.by_hand.alignment import ALIGNED, COLUMNS, Peak, peak
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.rig import Frame, Pose, kinematics, regions
from gonio.lab.rig.protocols import Dims

MIRROR_LIGHT_DEG = (30.0, -30.0, 45.0, -45.0, 60.0, -60.0)
STRAIGHT = 4
"""Scans over the lamp itself."""
POINTS = 15
FRAMES = 2
ATTEMPTS = 7
BRIGHT = 0.3
"""Level of a pixel that belongs to the spot, of full scale."""
SPOT_PIXELS = 12
DIM = 0.02
"""Part of full scale: where all frames are darker, also the longest ones, nobody knows whether the lamp was lit."""
SEARCH_EXPOSURES = 0.01, 1.0, 20.0
"""Exposures of a search, in that of a matt white: a mirror is brighter by its cones, a spot may be too faint."""
MARKED = 0.4
"""The longest where there are printed markers: their white stays below `BRIGHT`, and is not taken for the lamp."""
LONGEST_S = 2.0
DIMMED = (0.3, 0.1, 0.03, 0.01)
"""Levels of a lamp that saturates the camera at its shortest exposure."""
SLOWER_DEG = 0.1
"""Least half-width of a scan."""
SOUGHT = {"mirror": "the mirror's reflection", "empty": "the lamp itself"}
REMEDIES = {
    "mirror": "is the mirror in the holder, its coated side up and flat on it",
    "empty": "is the holder empty, and nothing between the arms",
}
SHAPELESS = {
    "mirror": "is that a mirror, and not the sample; does the reflection pass above or below the middle (shim the "
    "mirror; gonio rig snap shows it); is the frame flooded by other light",
    "empty": "is the holder empty; is the lamp as high as the lens (gonio rig snap shows it)",
}


class Scans:
    """Takes the scans of one alignment on an open rig; `table` has what was taken, also when one fails."""

    def __init__(self, manual: ManualRig, *, search_deg: float, say: Callable[[str], None]) -> None:
        self._manual, self._say, self._search_deg = manual, say, search_deg
        rig = self._description = manual.description
        self._axes = [name for name in ALIGNED if name in rig.axes()]
        self._crossing = [name for name in ("tilt", "azimuth") if name in self._axes]
        self._roi = regions.roi(rig, kinematics.view(rig, Pose()))
        cones = rig.lamp.half_angle_deg + rig.camera.lens_half_angle_deg
        self._half = {"camera": max(1.6 * cones, 0.8), "tilt": max(0.8 * cones, 0.4), "azimuth": max(2 * cones, 1.0)}
        self._shortest_s, self._longest_s = rig.camera.exposure_limits_s
        self._level: float | bool = True
        self._exposure_s = 0.0
        self._scans: list[pd.DataFrame] = []

    @property
    def table(self) -> pd.DataFrame:
        """All accepted scans."""
        return pd.concat(self._scans, ignore_index=True) if self._scans else pd.DataFrame(columns=list(COLUMNS))

    # ---- the two kinds ----

    def mirror(self) -> None:
        """A mirror is in the holder: scans of the camera arm at several light angles, of tilt and azimuth."""
        room = 2.0 * self._half["camera"]
        angles = [a for a in MIRROR_LIGHT_DEG if self._fits("light", a) and self._fits("camera", -a, room)]
        if not angles:
            raise ConfigError("the limits of light and camera leave no mirror direction between 30 and 60 deg")
        self._begin_mirror(angles[0])
        self._meter()
        first = self._fine("mirror", "camera")
        for name in self._crossing:
            self._fine("mirror", name)
        sum_deg = first.centre + self._encoder("light")
        for angle in (*angles[1:], angles[0]):  # the first once more: does it repeat?
            self._go(light=angle)
            self._go(camera=sum_deg - self._encoder("light") - self._offset("camera"))
            self._fine("mirror", "camera")

    def _begin_mirror(self, light: float) -> None:
        """Find the mirror image of the lamp with the light arm at an angle, and put it into the frame's middle."""
        self._go(light=light, **{n: 0.0 for n in ("tilt", "spin", "azimuth") if n in self._description.axes()})
        self._find("mirror", -light, *self._crossing[:1])
        for name in ("camera", *self._crossing):
            self._coarse(name)

    def _begin_straight(self) -> float:
        """Find the lamp itself; the difference of both encoders there, camera - light [deg]."""
        angles = self.facing()
        if not angles:
            raise ConfigError(self.why_not_facing())
        self._go(light=angles[0])
        self._find("empty", _face(angles[0]))
        self._coarse("camera")
        return self._encoder("camera") - self._encoder("light")

    def _camera_at(self, light: float, difference: float) -> float:
        """Where the lamp will be, as read, with the light arm at an angle as read."""
        turn = 360.0 * round((_face(light) - light - difference) / 360.0)
        return light + self._offset("light") + difference + turn - self._offset("camera")

    def straight_through(self) -> None:
        """The holder is empty: scans of the camera arm over the lamp itself, with both arms face to face."""
        difference, room = self._begin_straight(), 1.2 * self._half["camera"]
        taken: list[float] = []
        while len(taken) < STRAIGHT:
            # the first scan tells better than the search which angles leave room for one
            angles = [a for a in self._facing_light() if self._fits("camera", self._camera_at(a, difference), room)]
            if not angles and not taken:
                raise ConfigError(
                    f"camera - light = {difference:.1f} deg where they face each other: {self.why_not_facing()}"
                )
            left = [a for a in angles if a not in taken] or (taken if len(taken) == 1 else [])
            if not left:
                break
            self._go(light=left[0])
            self._go(camera=self._camera_at(left[0], difference))
            if not taken:
                self._meter()
            found = self._fine("empty", "camera")
            if not taken:
                difference = found.centre - self._encoder("light")
            taken.append(left[0])

    def facing(self) -> list[float]:
        """Angles of the light arm [deg] at which the camera can be scanned over the lamp; empty where there is none."""
        room = 1.5 * self._half["camera"] + 0.5
        return [a for a in self._facing_light() if self._fits("camera", _face(a), room)]

    def _facing_light(self) -> list[float]:
        """Angles of the light arm that may do, the best first."""
        wanted = [sign * (90.0 + d) for d in (0.0, -2.0, 2.0, 1.0, -1.0, -3.0, 3.0) for sign in (1.0, -1.0)]
        return [a for a in (*wanted, *map(float, range(-80, 81, 20))) if self._fits("light", a)]

    def why_not_facing(self) -> str:
        """What keeps the arms from facing each other, in words."""
        limits = self._description.limits_deg()
        said = " and ".join(f"{n} {limits[n][0]:g} to {limits[n][1]:g} deg" for n in ("light", "camera"))
        return (
            f"the arms cannot face each other within their limits ({said}): a straight-through scan needs light at 90 "
            "and camera around -90 deg, or the other way round. Widen limits_deg where nothing is in the way"
        )

    # ---- steps ----

    def _find(self, holder: str, guess: float, across: str | None = None) -> None:
        """Bring the camera to where the lamp is seen, anywhere in the frame."""
        white = exposure.expected_exposure_s(self._description, Pose(), 1.0)
        longest = min(self._longest_s, max(LONGEST_S, self._shortest_s))
        most = math.inf if self._description.holder.fiducials is None else MARKED
        exposures = [round(min(max(min(f, most) * white, self._shortest_s), longest), 6) for f in SEARCH_EXPOSURES]
        seen = 0.0
        for exposure_s in dict.fromkeys(exposures):
            self._say(f"looking for the lamp: {exposure_s:.3g} s, camera {guess:g} +-{self._search_deg:g} deg")
            self._manual.lamp(True)
            for shift_across in _outward(self._search_deg / 2, 0.8) if across else [0.0]:
                if across:
                    self._go(**{across: shift_across})
                for shift in _outward(self._search_deg, 1.0):
                    if not self._fits("camera", guess + shift):
                        continue
                    self._go(camera=guess + shift)
                    frame = self._captured(exposure_s)
                    if self._is_bright(frame):
                        self._exposure_s = exposure_s
                        return
                    seen = max(seen, self._level_of(frame, 99.0, whole=True))
        lit = (
            "light is seen, so the lamp shines"
            if seen > DIM
            else 'all frames are dark: does the lamp shine ("gonio rig lamp on"), and is the lens open'
        )
        raise DeviceError(
            f"{SOUGHT[holder]} was not found with the camera arm within {self._search_deg:g} deg of {guess:g} deg: "
            f'{REMEDIES[holder]}; {lit}; a coarser zero of an axis is set by "gonio rig set-zero", and --search looks '
            "farther"
        )

    def _captured(self, exposure_s: float) -> Frame:
        """A frame that has the size that the rig file says."""
        camera, frame = self._description.camera, self._manual.camera.capture(exposure_s)
        height, width = frame.mosaic.shape
        if (height, width) != (camera.height, camera.width):
            raise ConfigError(
                f"the frame has {width} x {height} pixels, and camera.width, camera.height of the rig file say "
                f"{camera.width} x {camera.height}"
            )
        return frame

    def _level_of(self, frame: Frame, percentile: float, *, whole: bool) -> float:
        """Level of the bright pixels of a frame, or of its middle alone."""
        of: exposure.Used = np.asarray if whole else self._roi.of
        return exposure.level(
            self._description.camera, frame, lambda m: np.percentile(of(m).astype(float), [percentile])
        )

    def _is_bright(self, frame: Frame) -> bool:
        """Whether as many pixels as a spot has are as bright as one."""
        full = exposure.full_scale_dn(self._description.camera, frame)
        return int(np.count_nonzero(frame.mosaic > frame.black_level_dn + BRIGHT * full)) >= SPOT_PIXELS

    def _coarse(self, axis: str) -> None:
        """Put an axis where most of the spot is in the frame; the exposure is metered there."""
        self._meter(whole=True)
        centre, best = self._read(axis), math.nan
        for _ in range(ATTEMPTS):
            points = self._points(axis, centre, 2.0 * self._half[axis], 9)
            x, weight = points["read"].to_numpy(), np.maximum(points["whole"].to_numpy(), 0.0)
            weight = weight - weight.min()
            if weight.max() <= 0:
                break
            inside, top = weight > 0.3 * weight.max(), float(x[weight.argmax()])
            best = float(np.average(x[inside], weights=weight[inside]))
            if weight.argmax() not in (0, len(x) - 1) or abs(top - centre) < 1e-9:
                break
            centre = top
        if math.isfinite(best):
            self._go(**{axis: best})

    def _meter(self, *, whole: bool = False) -> None:
        """An exposure, and where the shortest one saturates a lamp level, at which the spot is in scale."""
        target, shortest, most = (
            self._description.acquisition.exposure_target, self._shortest_s, min(self._longest_s, LONGEST_S),
        )  # fmt: skip
        exposure_s, levels = self._exposure_s or shortest, iter(DIMMED if isinstance(self._manual.light, Dims) else ())
        for _ in range(24):
            level = self._level_of(self._manual.camera.capture(exposure_s), 99.5, whole=whole)
            if level >= 0.9 and exposure_s > shortest:
                exposure_s = max(round(exposure_s / 8, 6), shortest)
            elif level >= 0.9:
                dimmer = next(levels, None)
                if dimmer is None:
                    self._say("the spot saturates at the shortest exposure: a grey filter makes its centre better")
                    break
                self._level = dimmer
                self._manual.lamp(dimmer)
            else:
                wanted = min(max(round(exposure_s * min(target / max(level, 0.02), 16.0), 6), shortest), most)
                if level >= 0.25 or wanted <= exposure_s or exposure_s >= most:
                    exposure_s = wanted if level < 0.25 or wanted < exposure_s else exposure_s
                    break
                exposure_s = max(wanted, shortest)
        self._exposure_s = exposure_s

    def _fine(self, holder: str, axis: str) -> Peak:
        """A scan that holds the spot whole, in its middle third; it is kept."""
        centre, half = self._read(axis), self._half[axis]
        step = self._description.axes()[axis].encoder_step_deg
        for _ in range(ATTEMPTS):
            points = self._points(axis, centre, half, POINTS)
            x, y, u = (points[name].to_numpy() for name in ("read", "signal", "u_signal"))
            found = peak(x, y, u, step)
            if points["clipped"].max() > 0 and self._shorten():
                continue
            if found is None:
                if not self._brighten():
                    break
                continue
            edges, top = found.at(np.array([x.min(), x.max()])) - found.background, float(x[y.argmax()])
            if top in (x.min(), x.max()) or abs(found.centre - centre) > 0.4 * half:
                centre = found.centre if x.min() < found.centre < x.max() else top
            elif edges.max() > 0.1 * found.height:
                half = min(1.6 * half, 12.0)
            elif found.fwhm < 0.35 * half and half > SLOWER_DEG:
                half = max(1.6 * found.fwhm, SLOWER_DEG)
            else:
                self._keep(holder, axis, points)
                self._half[axis] = half
                where = f"{axis} over the {'mirror' if holder == 'mirror' else 'lamp'}"
                self._say(
                    f"{where}, light at {self._read('light'):.1f} deg: centre at {found.centre:.3f} deg, u = "
                    f"{found.u:.3f} deg"
                )
                self._go(**{axis: found.centre})
                return replace(found, centre=found.centre + self._offset(axis))
        raise DeviceError(
            f"the scan of {axis} around {centre:.2f} deg shows no spot that rises and falls in the frame's middle: "
            + SHAPELESS[holder]
        )

    def _shorten(self) -> bool:
        """A clipped scan: a quarter of the exposure, where there is one; a level of a quarter is as well metered."""
        before_s, self._exposure_s = self._exposure_s, max(round(0.25 * self._exposure_s, 6), self._shortest_s)
        return before_s > self._shortest_s

    def _brighten(self) -> bool:
        """No spot in a scan: a longer exposure, where there is one."""
        before_s, most = self._exposure_s, min(self._longest_s, LONGEST_S)
        self._exposure_s = min(round(8 * before_s, 6), most) if before_s < most else before_s
        return before_s < most

    # ---- the angles of a scan ----

    def _points(self, axis: str, centre: float, half: float, count: int) -> pd.DataFrame:
        """What is seen at angles around one, within the limits of the axis: so far that its backlash is taken up."""
        (lower, upper), of = self._description.limits_deg()[axis], self._description.axes()[axis]
        play = of.backlash_deg + of.encoder_step_deg  # whole steps are landed on
        angles = np.linspace(max(centre - half, lower + play), min(centre + half, upper - play), count).tolist()
        return pd.DataFrame([self._point(axis, angle) for angle in angles])

    def _point(self, axis: str, angle: float) -> dict[str, float]:
        read = math.degrees(self._manual.move(**{axis: math.radians(angle)}).landed[axis])
        camera = self._description.camera
        frames = [self._manual.camera.capture(self._exposure_s) for _ in range(FRAMES)]
        black, exposure_s = frames[0].black_level_dn, frames[0].exposure_s
        used = np.array([self._roi.of(f.mosaic) for f in frames], float) - black
        means = used.mean(axis=1)
        mean = float(used.mean())
        noise = math.hypot(mean * self._description.lamp.noise, camera.read_noise_e / camera.electrons_per_dn)
        u = max(noise, abs(float(means[0] - means[-1])) / math.sqrt(2.0), 0.3) / math.sqrt(FRAMES)
        full = exposure.full_scale_dn(camera, frames[0])
        whole = float(np.mean([np.mean(f.mosaic) for f in frames])) - black
        return {"read": read, "signal": mean / exposure_s, "u_signal": u / exposure_s, "exposure_s": exposure_s,
                "clipped": float(np.mean(used >= exposure.SATURATED * full)), "whole": whole}  # fmt: skip

    def _keep(self, holder: str, axis: str, points: pd.DataFrame) -> None:
        encoders = {f"{n}_encoder_deg": round(self._encoder(n), 6) if n in self._axes else math.nan for n in ALIGNED}
        level = math.nan if self._level is True else self._level
        kept = points.assign(scan=len(self._scans) + 1, holder=holder, axis=axis, lamp_level=level, **encoders)
        kept[f"{axis}_encoder_deg"] = (points["read"] + self._offset(axis)).round(6)
        self._scans.append(kept[list(COLUMNS)])

    # ---- axes ----

    def _go(self, **angles: float) -> None:
        self._manual.move(**{n: math.radians(a) for n, a in angles.items()})

    def _offset(self, axis: str) -> float:
        known = self._description.axes()[axis]
        return known.zero_offset_deg if known.zero_offset_known else 0.0

    def _read(self, axis: str) -> float:
        pose = self._manual.pose()
        if pose is None:
            raise DeviceError("the axes do not say where they stand")
        return math.degrees(getattr(pose, axis))

    def _encoder(self, axis: str) -> float:
        return self._read(axis) + self._offset(axis)

    def _fits(self, axis: str, angle: float, room: float = 0.0) -> bool:
        lower, upper = self._description.limits_deg()[axis]
        return lower + room <= angle <= upper - room


def _face(light: float) -> float:
    """Where the camera looks into the lamp."""
    return light - 180.0 if light > 0 else light + 180.0


def _outward(most: float, step: float) -> Iterator[float]:
    """0, then farther and farther to both sides."""
    yield 0.0
    for k in range(1, math.floor(most / step + 1e-9) + 1):
        yield k * step
        yield -k * step
