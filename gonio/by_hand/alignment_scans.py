"""Scans for an alignment: find the spot, choose exposure and lamp level, scan until the spot lies whole in the scan."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gonio.acquisition import exposure
from gonio.by_hand.alignment import ALIGNED, COLUMNS, Peak, peak
from gonio.errors import ConfigError, DeviceError
from gonio.rig import Frame, Pose, kinematics, regions

if TYPE_CHECKING:
    import pandas as pd

    from gonio.by_hand.manual_rig import ManualRig

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
"""Of full scale: of frames that are darker, also the longest ones, nobody knows whether the lamp was lit."""
SEARCH_EXPOSURES = 0.01, 1.0, 20.0
"""In exposures of a matt white surface: a mirror is brighter by its cones, a spot may be fainter than it should."""
MARKED = 0.4
"""The longest where there are printed markers: their white stays below `BRIGHT`, and is not taken for the lamp."""
LONGEST_S = 2.0
DIMMED = (0.3, 0.1, 0.03, 0.01)
"""Levels of a lamp that saturates the camera at its shortest exposure."""
SLOWER_DEG = 0.1
"""Least half-width of a scan."""


class Scans:
    """Takes the scans of one alignment on an open rig; `table` has what was taken, also when one fails."""

    def __init__(self, manual: ManualRig, *, search_deg: float, say: Callable[[str], None]) -> None:
        self._manual, self._say, self._search_deg = manual, say, search_deg
        self._description = manual.description
        self._axes = [name for name in ALIGNED if name in self._description.axes()]
        self._roi = regions.roi(self._description, kinematics.view(self._description, Pose()))
        cones = self._description.lamp.half_angle_deg + self._description.camera.lens_half_angle_deg
        self._half = {"camera": max(1.6 * cones, 0.8), "tilt": max(0.8 * cones, 0.4), "azimuth": max(2 * cones, 1.0)}
        self._level: float | bool = True
        self._exposure_s = 0.0
        self._rows: list[dict[str, object]] = []
        self._number = 0

    @property
    def table(self) -> pd.DataFrame:
        """All accepted scans."""
        import pandas as pd

        return pd.DataFrame(self._rows, columns=list(COLUMNS))

    # ---- the two kinds ----

    def mirror(self) -> None:
        """A mirror is in the holder: scans of the camera arm at several light angles, of tilt and azimuth."""
        room = 2.0 * self._half["camera"]
        angles = [a for a in MIRROR_LIGHT_DEG if self._fits("light", a, 0.0) and self._fits("camera", -a, room)]
        if not angles:
            raise ConfigError("the limits of light and camera leave no mirror direction between 30 and 60 deg")
        self._begin_mirror(angles[0])
        self._meter()
        first = self._fine("mirror", "camera")
        for name in ("tilt", "azimuth"):
            if name in self._axes:
                self._fine("mirror", name)
        sum_deg = first.centre + self._encoder("light")
        for angle in (*angles[1:], angles[0]):  # the first once more: does it repeat?
            self._go(light=angle)
            self._go(camera=sum_deg - self._encoder("light") - self._offset("camera"))
            self._fine("mirror", "camera")

    def _begin_mirror(self, light: float) -> None:
        """Find the mirror image of the lamp with the light arm at an angle, and put it into the frame's middle."""
        others = {n: 0.0 for n in ("tilt", "spin", "azimuth") if n in self._description.axes()}
        self._go(light=light, **others)
        across = next((n for n in ("tilt", "azimuth") if n in self._axes), None)
        self._find("mirror", -light, across)
        self._coarse("camera")
        for name in ("tilt", "azimuth"):
            if name in self._axes:
                self._coarse(name)

    def _begin_straight(self) -> float:
        """Find the lamp itself; the difference of both encoders there, camera - light [deg]."""
        angles = self.facing()
        if not angles:
            raise ConfigError(self.why_not_facing())
        self._go(light=angles[0])
        self._find("empty", _face(angles[0]), None)
        self._coarse("camera")
        return self._encoder("camera") - self._encoder("light")

    def _camera_at(self, light: float, difference: float) -> float:
        """Where the lamp will be, as read, with the light arm at an angle as read."""
        turn = 360.0 * round((_face(light) - light - difference) / 360.0)
        return light + self._offset("light") + difference + turn - self._offset("camera")

    def straight_through(self) -> None:
        """The holder is empty: scans of the camera arm over the lamp itself, with both arms face to face."""
        difference = self._begin_straight()

        def camera_at(light: float) -> float:
            return self._camera_at(light, difference)

        room = 1.2 * self._half["camera"]
        angles = [a for a in self._facing_light() if self._fits("camera", camera_at(a), room)][:STRAIGHT]
        if not angles:
            raise ConfigError(
                f"camera - light = {difference:.1f} deg where they face each other: {self.why_not_facing()}"
            )
        for number, angle in enumerate(angles if len(angles) > 1 else 2 * angles):
            self._go(light=angle)
            self._go(camera=camera_at(angle))
            if number == 0:
                self._meter()
            found = self._fine("empty", "camera")
            if number == 0:
                difference = found.centre - self._encoder("light")

    def facing(self) -> list[float]:
        """Angles of the light arm [deg] at which the camera can be scanned over the lamp; empty where there is none."""
        room = 1.5 * self._half["camera"] + 0.5
        return [a for a in self._facing_light() if self._fits("camera", _face(a), room)]

    def _facing_light(self) -> list[float]:
        """Angles of the light arm that may do, the best first."""
        wanted = [sign * (90.0 + d) for d in (0.0, -2.0, 2.0, 1.0, -1.0, -3.0, 3.0) for sign in (1.0, -1.0)]
        wanted += [float(a) for a in range(-80, 81, 20)]
        return [a for a in wanted if self._fits("light", a, 0.0)]

    def why_not_facing(self) -> str:
        """What keeps the arms from facing each other, in words."""
        limits = self._description.limits_deg()
        said = " and ".join(f"{n} {limits[n][0]:g} to {limits[n][1]:g} deg" for n in ("light", "camera"))
        return (
            f"the arms cannot face each other within their limits ({said}): a straight-through scan needs light at 90 "
            "and camera around -90 deg, or the other way round. Widen limits_deg where nothing is in the way"
        )

    # ---- steps ----

    def _find(self, holder: str, guess: float, across: str | None) -> None:
        """Bring the camera to where the lamp is seen, anywhere in the frame."""
        white = exposure.expected_exposure_s(self._description, Pose(), 1.0)
        shortest, longest = self._description.camera.exposure_limits_s
        tried: list[float] = []
        seen = 0.0
        for factor in SEARCH_EXPOSURES:
            if self._description.holder.fiducials is not None:
                factor = min(factor, MARKED)
            exposure_s = round(min(max(factor * white, shortest), min(longest, max(LONGEST_S, shortest))), 6)
            if exposure_s in tried:
                continue
            tried.append(exposure_s)
            self._say(f"looking for the lamp: {exposure_s:.3g} s, camera {guess:g} +-{self._search_deg:g} deg")
            self._manual.lamp(True)
            for shift_across in _outward(self._search_deg / 2, 0.8) if across else [0.0]:
                if across:
                    self._go(**{across: shift_across})
                for shift in _outward(self._search_deg, 1.0):
                    if not self._fits("camera", guess + shift, 0.0):
                        continue
                    self._go(camera=guess + shift)
                    frame = self._manual.camera.capture(exposure_s)
                    self._require_size(frame)
                    if self._spot(frame) >= SPOT_PIXELS:
                        self._exposure_s = exposure_s
                        return
                    level = float(np.percentile(frame.mosaic, 99.0)) - frame.black_level_dn
                    seen = max(seen, level / exposure.full_scale_dn(self._description.camera, frame))
        there = "the mirror's reflection" if holder == "mirror" else "the lamp itself"
        remedy = (
            "is the mirror in the holder, its coated side up and flat on it"
            if holder == "mirror"
            else "is the holder empty, and nothing between the arms"
        )
        lit = (
            "light is seen, so the lamp shines"
            if seen > DIM
            else 'all frames are dark: does the lamp shine ("gonio rig lamp on"), and is the lens open'
        )
        raise DeviceError(
            f"{there} was not found with the camera arm within {self._search_deg:g} deg of {guess:g} deg: {remedy}; "
            f'{lit}; a coarser zero of an axis is set by "gonio rig set-zero", and --search looks farther'
        )

    def _require_size(self, frame: Frame) -> None:
        camera, (height, width) = self._description.camera, frame.mosaic.shape
        if (height, width) != (camera.height, camera.width):
            raise ConfigError(
                f"the frame has {width} x {height} pixels, and camera.width, camera.height of the rig file say "
                f"{camera.width} x {camera.height}"
            )

    def _spot(self, frame: Frame) -> int:
        full = exposure.full_scale_dn(self._description.camera, frame)
        return int(np.count_nonzero(frame.mosaic > frame.black_level_dn + BRIGHT * full))

    def _coarse(self, axis: str) -> None:
        """Put an axis where most of the spot is in the frame; the exposure is metered there."""
        self._meter(whole=True)
        centre, half = self._read(axis), 2.0 * self._half[axis]
        best: tuple[float, float] | None = None
        for _ in range(ATTEMPTS):
            rows = [self._point(axis, a) for a in self._between(axis, centre, half, 9)]
            weight = np.array([max(float(r["whole"]), 0.0) for r in rows])  # type: ignore[arg-type]
            x = np.array([float(r["read"]) for r in rows])  # type: ignore[arg-type]
            weight = weight - weight.min()
            if weight.max() <= 0:
                break
            top = float(x[weight.argmax()])
            inside = weight > 0.3 * weight.max()
            best = (float(np.average(x[inside], weights=weight[inside])), top)
            if weight.argmax() not in (0, len(x) - 1) or abs(top - centre) < 1e-9:
                break
            centre = top
        if best is not None:
            self._go(**{axis: best[0]})

    def _meter(self, *, whole: bool = False) -> None:
        """An exposure, and where the shortest one saturates a lamp level, at which the spot is in scale."""
        target, camera = self._description.acquisition.exposure_target, self._description.camera
        shortest, longest = camera.exposure_limits_s
        exposure_s, levels = self._exposure_s or shortest, iter(DIMMED if hasattr(self._manual.light, "dim") else ())
        for _ in range(24):
            frame = self._manual.camera.capture(exposure_s)
            used = np.asarray(frame.mosaic if whole else self._roi.of(frame.mosaic), float)
            level = float(np.percentile(used, 99.5)) - frame.black_level_dn
            level /= exposure.full_scale_dn(camera, frame)
            if level >= 0.9:
                if exposure_s > shortest:
                    exposure_s = max(round(exposure_s / 8, 6), shortest)
                    continue
                dimmer = next(levels, None)
                if dimmer is None:
                    self._say("the spot saturates at the shortest exposure: a grey filter makes its centre better")
                    break
                self._level = dimmer
                self._manual.lamp(dimmer)
                continue
            wanted = min(max(round(exposure_s * min(target / max(level, 0.02), 16.0), 6), shortest), longest, LONGEST_S)
            if level >= 0.25 or wanted <= exposure_s or exposure_s >= min(longest, LONGEST_S):
                exposure_s = wanted if level < 0.25 or wanted < exposure_s else exposure_s
                break
            exposure_s = max(wanted, shortest)
        self._exposure_s = exposure_s

    def _fine(self, holder: str, axis: str) -> Peak:
        """A scan that holds the spot whole, in its middle third; it is kept."""
        centre, half = self._read(axis), self._half[axis]
        step = self._description.axes()[axis].encoder_step_deg
        for _ in range(ATTEMPTS):
            rows = [self._point(axis, a) for a in self._between(axis, centre, half, POINTS)]
            x = np.array([float(r["read"]) for r in rows])  # type: ignore[arg-type]
            y = np.array([float(r["signal"]) for r in rows])  # type: ignore[arg-type]
            u = np.array([float(r["u_signal"]) for r in rows])  # type: ignore[arg-type]
            found = peak(x, y, u, step)
            if max(float(r["clipped"]) for r in rows) > 0 and self._shorten():  # type: ignore[arg-type]
                continue
            if found is None:
                if not self._brighten():
                    break
                continue
            edges = found.at(np.array([x.min(), x.max()])) - found.background
            top = float(x[y.argmax()])
            if top in (x.min(), x.max()) or abs(found.centre - centre) > 0.4 * half:
                centre = found.centre if x.min() < found.centre < x.max() else top
                continue
            if edges.max() > 0.1 * found.height:
                half = min(1.6 * half, 12.0)
            elif found.fwhm < 0.35 * half and half > SLOWER_DEG:
                half = max(1.6 * found.fwhm, SLOWER_DEG)
            else:
                self._keep(holder, axis, rows)
                self._half[axis] = half
                over = "mirror" if holder == "mirror" else "lamp"
                where = f"{axis} over the {over}, light at {self._read('light'):.1f} deg"
                self._say(f"{where}: centre at {found.centre:.3f} deg, u = {found.u:.3f} deg")
                self._go(**{axis: found.centre})
                return replace(found, centre=found.centre + self._offset(axis))
        raise DeviceError(
            f"the scan of {axis} around {centre:.2f} deg shows no spot that rises and falls in the frame's middle: "
            + (
                "is that a mirror, and not the sample; does the reflection pass above or below the middle (shim the "
                "mirror; gonio rig snap shows it); is the frame flooded by other light"
                if holder == "mirror"
                else "is the holder empty; is the lamp as high as the lens (gonio rig snap shows it)"
            )
        )

    def _shorten(self) -> bool:
        """A clipped scan: half the exposure, where there is one."""
        shortest = self._description.camera.exposure_limits_s[0]
        if self._exposure_s <= shortest:
            return False
        self._exposure_s = max(round(0.5 * self._exposure_s, 6), shortest)
        return True

    def _brighten(self) -> bool:
        """No spot in a scan: a longer exposure, where there is one."""
        most = min(self._description.camera.exposure_limits_s[1], LONGEST_S)
        if self._exposure_s >= most:
            return False
        self._exposure_s = min(round(8 * self._exposure_s, 6), most)
        return True

    # ---- one angle ----

    def _point(self, axis: str, angle: float) -> dict[str, object]:
        read = math.degrees(self._manual.move(**{axis: math.radians(angle)}).landed[axis])
        camera = self._description.camera
        frames = [self._manual.camera.capture(self._exposure_s) for _ in range(FRAMES)]
        black, exposure_s = frames[0].black_level_dn, frames[0].exposure_s
        used = [np.asarray(self._roi.of(f.mosaic), float) - black for f in frames]
        mean = float(np.mean(used))
        noise = math.hypot(mean * self._description.lamp.noise, camera.read_noise_e / camera.electrons_per_dn)
        scatter = abs(float(np.mean(used[0]) - np.mean(used[-1]))) / math.sqrt(2.0)
        full = exposure.full_scale_dn(camera, frames[0])
        clipped = float(np.mean([np.mean(u >= exposure.SATURATED * full) for u in used]))
        whole = float(np.mean([np.mean(f.mosaic) for f in frames])) - black
        u = max(noise, scatter, 0.3) / math.sqrt(FRAMES)
        return {"read": read, "signal": mean / exposure_s, "u_signal": u / exposure_s, "whole": whole,
                "exposure_s": exposure_s, "clipped": clipped}  # fmt: skip

    def _keep(self, holder: str, axis: str, rows: list[dict[str, object]]) -> None:
        self._number += 1
        others = {n: self._encoder(n) if n in self._axes else math.nan for n in ALIGNED}
        for row in rows:
            angles = {f"{n}_encoder_deg": round(v, 6) for n, v in others.items()}
            angles[f"{axis}_encoder_deg"] = round(float(row["read"]) + self._offset(axis), 6)  # type: ignore[arg-type]
            level = math.nan if self._level is True else self._level
            kept = {n: row[n] for n in ("signal", "u_signal", "exposure_s", "clipped")}
            about = {"scan": self._number, "holder": holder, "axis": axis, "lamp_level": level}
            self._rows.append(about | angles | kept)

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

    def _fits(self, axis: str, angle: float, room: float) -> bool:
        lower, upper = self._description.limits_deg()[axis]
        return lower + room <= angle <= upper - room

    def _between(self, axis: str, centre: float, half: float, points: int) -> list[float]:
        lower, upper = self._description.limits_deg()[axis]
        return [float(a) for a in np.linspace(max(centre - half, lower), min(centre + half, upper), points)]


def _face(light: float) -> float:
    """Where the camera looks into the lamp."""
    return light - 180.0 if light > 0 else light + 180.0


def _outward(most: float, step: float) -> Iterator[float]:
    yield 0.0
    for k in range(1, math.floor(most / step + 1e-9) + 1):
        yield k * step
        yield -k * step
