"""Aligning a rig with a live picture: one loop that owns the devices, takes frames, and does what it is told in between.

    assistant = Assistant(bench, tell=page.tell, say=print, rig_file=Path("my.toml"), out=Path("aligned.toml"))
    with bench:
        assistant.run()

Orders are lines of text, put into `orders` by whatever thread; they are carried out between two frames, by the thread
that runs the loop. So drivers that are used by one thread alone need nothing else. The lamp is on a dead man's timer
(`gonio.by_hand.lamp_timer`), and `alive` is the sign of life.
"""

from __future__ import annotations

import math
import queue
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.acquisition import exposure
from gonio.by_hand import looking
from gonio.by_hand.lamp_timer import DeadMansTimer, LampTimeOver
from gonio.by_hand.live_picture import Pictures, pictures
from gonio.by_hand.rig_file import with_values, write_values, zero_values
from gonio.disk import write_whole
from gonio.errors import ConfigError, DataError, DeviceError, Disturbed
from gonio.rig import Frame, Pose, imaging, kinematics

if TYPE_CHECKING:
    from gonio.by_hand.bench import Bench
    from gonio.rig.kinematics import View

Tell = Callable[[dict[str, Any], Pictures | None], None]
"""Takes what is to be shown (what JSON can hold), and the pictures of a new frame."""

KEEP_S = 60.0
"""So long the lamp shines after a key press."""
PER_S = 8.0
"""Frames a second, at most."""
START_S = 0.5
"""The first exposure is not longer; one that a person asks for may be."""
CAMERA_S = 15.0
"""A frame that takes so much longer than its exposure and its readout counts as one that does not come."""
FAILURES = 2
"""Frames in a row that may fail before the session ends."""
HISTORY = 240
HISTORY_S = 0.25
"""The curve of the focus has a point so often, and so many points."""
FPS_OF = 20
STEADY_DEG = 0.1
"""An axis that reads so much elsewhere has moved: another scene, and another focus."""

HELP = """\
  jog AXIS DEG            by so much, as in jog camera -0.5
  go AXIS DEG ...         to a place; go theta_i 30 theta_r 30 moves all axes
  zero AXIS [DEG]         it stands at DEG (0) now: into the copy of the rig file
  park                    all axes to their rest position
  lamp on | off | LEVEL   LEVEL from 0 to 1; dark again if no key is pressed
  band NM                 the band that contains it
  exposure S              seconds
  auto                    the exposure that fits
  focus                   forget the best focus
  save FILE               a frame, .dng .tif or .png, with a picture of it
  quit                    lamp dark, arms hold"""


class Assistant:
    """A session at an open rig.

    Parameters
    ----------
    bench
        The rig; arms, light and camera are open while `run` runs.
    tell
        Is told what to show, at each frame and each change.
    say
        Takes lines for the person at the terminal.
    rig_file, out
        The rig file, and the copy of it that zeros are written into; None: a rig without a file takes no zeros.
    keep_s
        So long the lamp shines after a sign of life.
    clock
        Seconds, growing.
    """

    def __init__(
        self,
        bench: Bench,
        *,
        tell: Tell,
        say: Callable[[str], None],
        rig_file: Path | None = None,
        out: Path | None = None,
        keep_s: float = KEEP_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.orders: queue.SimpleQueue[str] = queue.SimpleQueue()
        """Lines, as a person types them."""
        self.timer = DeadMansTimer(bench.light, keep_s, clock)
        self.ended = False
        """Somebody has said `quit`."""
        self.exposure_s: float = 0.0
        """Of the next frame [s]; 0: what a matt white would need."""
        self._bench, self._tell, self._say, self._clock = bench, tell, say, clock
        self._rig_file, self._out = rig_file, out
        self._zeros: dict[tuple[str, ...], Any] = {}
        self._zeroed: dict[str, float] = {}
        self._doing = ""
        self._level: float | bool = True
        self._number = 0
        self._failures = 0
        self._last: Frame | None = None
        self._pose: Pose | None = None
        self._scene: tuple[Any, ...] | None = None
        self._view: dict[str, Any] = {}
        self._region: imaging.Roi | None = None
        self._times: deque[float] = deque(maxlen=FPS_OF)
        self._history: deque[tuple[float, float | None]] = deque(maxlen=HISTORY)
        self._best: float | None = None
        self._shown: dict[str, Any] = {}
        self._nudge: tuple[str, float] | None = None
        self._do = {
            "jog": self._jog, "go": self._go, "zero": self._zero, "park": self._park, "lamp": self._lamp,
            "band": self._band, "exposure": self._exposure, "auto": self._auto, "focus": self._refocus,
            "save": self._save, "help": lambda words: self._say(HELP), "quit": self._quit,
        }  # fmt: skip

    # ---- for the terminal, from whatever thread ----

    def alive(self) -> None:
        """A sign of life: the lamp, where it shines, goes on."""
        self.timer.keep()

    def nudge(self, axis: str, degrees: float) -> None:
        """Jog an axis; while one is on its way nothing is added, so that nothing goes on when a key is let go."""
        if not self._doing and self._nudge is None:
            self._nudge = axis, degrees
            self.orders.put("")

    @property
    def status(self) -> str:
        """One line: lamp, exposure, focus, angles."""
        left = self.timer.left_s
        said = [self._doing or ("lamp dark" if left is None else f"dark in {math.ceil(left)} s")]
        shown = self._shown
        if shown:
            said.append(
                f"{shown['exposure_s']:.4g} s, {100 * shown['advice']['level']:.0f} %: {shown['advice']['text']}"
            )
            value, best = shown["focus"]["value"], shown["focus"]["best"]
            said.append("focus -" if value is None else f"focus {value:.4f} (best {best:.4f})")
            said.append(" ".join(f"{name} {angle:.2f}" for name, angle in (shown["angles_deg"] or {}).items()))
        return " | ".join(part for part in said if part)

    # ---- the loop ----

    def run(self) -> None:
        """Take frames and orders until `quit`; the rig is open, and leaving it darkens the lamp.

        Raises
        ------
        DeviceError
            A device fails. The arms hold where they are.
        """
        with self.timer:
            while not self.ended:
                begun = self._clock()
                self.look()
                self.wait(max(1.0 / PER_S - (self._clock() - begun), 0.0))

    def wait(self, seconds: float) -> None:
        """Carry out what there is to do, and wait so long for more."""
        try:
            order = self.orders.get(timeout=seconds) if seconds > 0 else self.orders.get_nowait()
            while not self.ended:
                self.obey(order)
                order = self.orders.get_nowait()
        except queue.Empty:
            return

    def look(self) -> None:
        """Take a frame, and tell what it shows."""
        self._mind_lamp()
        camera = self._bench.description.camera
        self._see_pose()
        if not self.exposure_s:
            expected = exposure.expected_exposure_s(self._bench.description, self._pose or Pose(), 1.0)
            self.exposure_s = max(min(expected, START_S), camera.exposure_limits_s[0])
        try:
            frame = self._capture(self.exposure_s)
        except LampTimeOver:
            self._mind_lamp()
            return
        except Disturbed as pushed:
            self._say(f"{pushed}; the frame does not count")
            self._last = None
            return
        except DeviceError as failure:
            self._failures += 1
            if self._failures >= FAILURES:
                raise
            self._say(f"{failure}; trying once more, with the lamp dark")
            self._darken()
            return
        self._failures = 0
        self._mind_lamp()
        self._number += 1
        self._times.append(self._clock())
        told = self._told(frame)
        told["picture"], whole = self._pictures(frame)
        self._last, self._shown = frame, told
        self._tell(told, whole)

    def _capture(self, exposure_s: float) -> Frame:
        camera = self._bench.description.camera
        allowed_s = exposure_s + camera.frame_overhead_s + CAMERA_S
        with self.timer.within(allowed_s, "the camera"):
            frame = self._bench.camera.capture(exposure_s)
        imaging.require_frame(camera, frame, "camera")
        return frame

    def _mind_lamp(self) -> None:
        """Darken it where its time is over; and after the watch did, see that it is dark."""
        if self.timer.over:
            self.timer.why_dark = "its time is over"
            self._darken()
            self._say("lamp dark: its time is over")
        elif self.timer.why_dark and self.timer.left_s is None and not self._confirmed:
            self._darken()
            self._say(f"lamp dark: {self.timer.why_dark}")

    _confirmed = True
    """The lamp was darkened by its owner since it was lit."""

    def _darken(self) -> None:
        self.timer.dark()
        self._bench.lamp(False)
        self._confirmed = True
        self._last = None

    # ---- what is seen ----

    def _see_pose(self) -> None:
        """Read the arms; where they stand elsewhere, or the band is another, the scene is a new one."""
        before, self._pose = self._pose, self._bench.pose()
        scene = (self._pose, self._bench.band.name)
        if scene == self._scene:
            return
        self._scene = scene
        apart = [abs(math.degrees(getattr(before, n) - getattr(self._pose, n))) if before and self._pose else math.inf
                 for n in self._bench.description.axes()]  # fmt: skip
        if max(apart) > STEADY_DEG:
            self._refocus([])
            self._last = None
        self._view, self._region = self._predicted(self._pose)

    def _predicted(self, pose: Pose | None) -> tuple[dict[str, Any], imaging.Roi | None]:
        """Where the rig file has axis, centre and outlines in the frame, from a pose."""
        description = self._bench.description
        camera = description.camera
        offset = camera.principal_point_px
        out: dict[str, Any] = {
            "axis": [0.5 * (camera.width - 1) + offset[0], 0.5 * (camera.height - 1) + offset[1]],
            "centre": None, "sample": None, "reference": None, "beam": None, "angles_deg": None,
            "directions_deg": None, "region_pixels": None, "why": "",
        }  # fmt: skip
        if pose is None:
            out["why"] = "the arms do not say where they stand"
            return out, None
        out["angles_deg"] = {n: math.degrees(getattr(pose, n)) for n in description.axes()}
        seen = kinematics.directions(description, pose)
        out["directions_deg"] = {
            name: math.degrees(float(getattr(seen, name))) for name in ("theta_i", "phi_i", "theta_r", "phi_r")
        }
        view = kinematics.view(description, pose)
        try:
            region = imaging.roi(description, view, channel=self._bench.band.channel)
        except ConfigError as error:
            out["why"] = str(error)
            return out, None
        out["region_pixels"] = region.count
        out["centre"] = _places(*(np.array([x]) for x in imaging.place(description, view, "sample")))
        out["centre"] = out["centre"] and out["centre"][0]
        out["sample"] = _places(*imaging.outline(description, view))
        if description.reference.how == "beside":
            out["reference"] = _places(*imaging.outline(description, view, "reference"))
        out["beam"] = _beam_outline(self._bench, view)
        return out, region

    def _told(self, frame: Frame) -> dict[str, Any]:
        description, region = self._bench.description, self._region
        camera, last = description.camera, self._last
        box = looking.focus_box(camera, region)
        focus = looking.focus(camera, last, frame, box) if last is not None else None
        noise = looking.noise(camera, last, frame, region) if last is not None and region is not None else None
        over = looking.saturated(camera, frame)
        in_region = None if region is None else int(np.count_nonzero(region.of(over)))
        spot, said = looking.spot(camera, frame)
        span = self._times[-1] - self._times[0]
        return {
            "n": self._number, "exposure_s": frame.exposure_s, "width": camera.width, "height": camera.height,
            "pattern": frame.pattern, "fps": (len(self._times) - 1) / span if span > 0 else None,
            "doing": self._doing, "rig": description.name, "band": self._bench.band.name, "lamp": self._lamp_told(),
            "view": {k: v for k, v in self._view.items() if k not in ("angles_deg", "directions_deg")},
            "angles_deg": self._view["angles_deg"], "directions_deg": self._view["directions_deg"],
            "levels": [asdict(one) for one in looking.levels(camera, frame)],
            "scale_dn": {
                "black": frame.black_level_dn, "white": frame.white_level_dn,
                "saturated": frame.black_level_dn + exposure.SATURATED * exposure.full_scale_dn(camera, frame),
            },
            "saturated_in_region": in_region,
            "advice": asdict(looking.advice(description, frame, region)),
            "noise": noise and asdict(noise),
            "focus": self._focus_told(focus, box),
            "spot": self._spot_told(spot), "spot_said": said,
            "zeros_deg": self._zeroed, "zeros_in": str(self._out) if self._zeroed else None,
        }  # fmt: skip

    def _lamp_told(self) -> dict[str, Any]:
        left = self.timer.left_s
        return {
            "lit": left is not None, "left_s": left, "keep_s": self.timer.seconds,
            "level": 1.0 if self._level is True else float(self._level),
            "usual": self._level is True, "why_dark": self.timer.why_dark,
        }  # fmt: skip

    def _focus_told(self, found: looking.Focus | None, box: looking.Box) -> dict[str, Any]:
        now = self._clock()
        value = found.value if found is not None else None
        if value is not None:
            self._best = value if self._best is None else max(self._best, value)
        if found is not None and (not self._history or now - self._history[-1][0] >= HISTORY_S):
            self._history.append((now, value))
        rows, cols = box
        return {
            "value": value, "u": _number(found.u) if found is not None else None, "best": self._best,
            "why": found.why if found is not None else "waiting for two frames of one scene",
            "box": [cols.start - 0.5, rows.start - 0.5, cols.stop - cols.start, rows.stop - rows.start],
            "history": [[round(t - now, 2), v] for t, v in self._history],
        }  # fmt: skip

    def _spot_told(self, spot: looking.Spot | None) -> dict[str, Any] | None:
        if spot is None:
            return None
        out = asdict(spot) | {"from_centre_px": None, "from_centre_mm": None, "major_mm": None, "minor_mm": None}
        centre = self._view["centre"]
        if centre is None or self._pose is None:
            return out
        out["from_centre_px"] = [spot.column - centre[0], spot.row - centre[1]]
        description = self._bench.description
        view = kinematics.view(description, self._pose)
        x, y = imaging.spot(description, view, spot.column, spot.row)
        out["from_centre_mm"] = [_number(float(x)), _number(float(y))]
        along = math.cos(math.radians(spot.angle_deg)), math.sin(math.radians(spot.angle_deg))
        for name, length, (c, r) in (
            ("major_mm", spot.major_px, along), ("minor_mm", spot.minor_px, (-along[1], along[0]))
        ):  # fmt: skip
            ends = [imaging.spot(description, view, spot.column + k * length * c, spot.row + k * length * r)
                    for k in (-0.5, 0.5)]  # fmt: skip
            out[name] = _number(float(np.linalg.norm(ends[1] - ends[0])))
        return out

    def _pictures(self, frame: Frame) -> tuple[dict[str, Any], Pictures]:
        middle = self._view["centre"] or self._view["axis"]
        made = pictures(self._bench.description.camera, frame, (middle[0], middle[1]))
        return {"zoom_box": list(made.zoom_box), "white_dn": made.white_dn}, made

    # ---- orders ----

    def obey(self, order: str) -> None:
        """Carry out a line. What is wrong with it is said, and changes nothing.

        Raises
        ------
        DeviceError
            A device fails.
        """
        nudge, self._nudge = self._nudge, None
        words = order.replace("=", " ").split()
        try:
            if nudge is not None:
                self._move({nudge[0]: nudge[1]}, relative=True)
            if not words:
                return
            name = "quit" if words[0] in ("exit", "q") else words[0]
            if name not in self._do:
                raise ConfigError(f'there is no "{name}"; help lists what there is')
            self._do[name](words[1:])
        except (ConfigError, DataError, LampTimeOver) as wrong:
            self._say(str(wrong))
        finally:
            self._doing = ""

    def _quit(self, words: list[str]) -> None:
        self.ended = True

    def _jog(self, words: list[str]) -> None:
        self._move(_pairs(words, "jog camera -0.5"), relative=True)

    def _go(self, words: list[str]) -> None:
        self._move(_pairs(words, "go light 30, or go theta_i 30 theta_r 30"), relative=False)

    def _move(self, degrees: dict[str, float], *, relative: bool) -> None:
        goals = {name: math.radians(angle) for name, angle in degrees.items()}
        if relative:
            here = self._bench.arms.read()
            self._bench.check(dict.fromkeys(goals, 0.0) if any(not hasattr(here, n) for n in goals) else {
                name: getattr(here, name) + by for name, by in goals.items()})  # fmt: skip
            goals = {name: getattr(here, name) + by for name, by in goals.items()}
        self._bench.goals(**goals)  # whatever is wrong with them is said before anything moves
        said = ", ".join(f"{n} {round(math.degrees(a), 3) + 0.0:g}" for n, a in goals.items())
        self._busy(f"moving to {said} deg")
        moved = self._bench.move(**goals)
        self._last = None
        if moved.branch:
            self._say(moved.branch)
        self._say(", ".join(f"{name} {math.degrees(angle):.3f} deg" for name, angle in moved.landed.items()))

    def _park(self, words: list[str]) -> None:
        self._busy("parking")
        self._bench.arms.park()
        self._last = None
        self._say("arms parked")

    def _busy(self, what: str) -> None:
        """Say on the page what keeps the camera from its next frame."""
        self._doing = what
        if self._shown:
            self._tell(self._shown | {"doing": what, "lamp": self._lamp_told()}, None)

    def _lamp(self, words: list[str]) -> None:
        said = words[0] if len(words) == 1 else ""
        if said == "off":
            self._darken()
            self.timer.why_dark = ""
            self._say("lamp dark")
            return
        try:
            level = True if said == "on" else float(said)
        except ValueError:
            raise ConfigError(f'"lamp {" ".join(words)}": say on, off, or a level from 0 to 1') from None
        if not 0 <= level <= 1:
            raise ConfigError(f"lamp {level:g}: the lamp's level is a fraction from 0 to 1")
        if not level:
            return self._lamp(["off"])
        self._busy("lighting the lamp")
        self.timer.light_up()
        self._confirmed = False
        try:
            self._bench.lamp(level)
        except BaseException:
            self.timer.dark()
            raise
        self._level, self._last = level, None
        self._say(f"lamp lit, band {self._bench.band.name}; dark {self.timer.seconds:g} s after the last key press")

    def _band(self, words: list[str]) -> None:
        wavelength = _one_number(words, "band 550", ("nm",))
        self._bench.choose_band(wavelength)
        self._last = None
        if self.timer.left_s is not None:
            self._bench.light.select(self._bench.band)
        self._say(f"band {self._bench.band.name}")

    def _exposure(self, words: list[str]) -> None:
        milli = bool(words) and words[-1].endswith("ms")
        wanted = _one_number(words, "exposure 0.02", ("ms", "s")) * (1e-3 if milli else 1.0)
        self._bench.description.camera.require_exposure(wanted)
        self.exposure_s, self._last = wanted, None
        self._say(f"exposure {wanted:g} s")

    def _auto(self, words: list[str]) -> None:
        if self.timer.left_s is None:
            raise ConfigError("auto needs light: lamp on")
        self._busy("looking for the exposure")
        description, region = self._bench.description, self._region
        expected = exposure.expected_level_per_s(description, self._pose or Pose(), 1.0)
        used = region.of if region is not None else np.ravel
        try:
            found = exposure.meter(description, self._capture, used, expected)
        except DeviceError as failure:
            if isinstance(failure, LampTimeOver) or not str(failure).startswith("no exposure fits"):
                raise
            self._say(str(failure))
            return
        self.exposure_s, self._last = found.exposure_s, None
        where = "the region" if region is not None else "the frame"
        self._say(f"exposure {found.exposure_s:.4g} s" + (f"; {where} saturates there" if found.saturated else ""))

    def _refocus(self, words: list[str]) -> None:
        self._best = None
        self._history.clear()

    def _save(self, words: list[str]) -> None:
        if len(words) != 1:
            raise ConfigError("save FILE: one name that ends with .dng, .tif or .png")
        shot = self._bench.snap(words[0], exposure_s=self.exposure_s)
        self._say(", ".join(str(file) for file in shot.files))

    def _zero(self, words: list[str]) -> None:
        if self._rig_file is None or self._out is None:
            raise ConfigError("there is no rig file to write a copy of: gonio rig show R > my.toml, then --rig my.toml")
        if not 1 <= len(words) <= 2:
            raise ConfigError("zero AXIS [DEG]: as in zero light 30")
        axis, at = words[0], _one_number(words[1:] or ["0"], "zero light 30", ("deg",))
        limits = self._bench.description.limits_deg()
        self._bench.check({axis: 0.5 * math.radians(sum(limits.get(axis, (0.0, 0.0))))})
        health = self._bench.read()
        read = health.of(axis, "angle")
        if not isinstance(read, float):
            raise DataError(f"axis {axis}: {health.silent.get(axis, 'its angle is not known')}")
        if isinstance(apart := health.of(axis, "angle_spread"), float):
            raise DataError(f"axis {axis}: its readings at rest lie {apart:.2f} deg apart, and tell no zero")
        values, offset = zero_values(self._bench.description, axis, read_deg=read, true_deg=at)
        wanted = self._zeros | values
        if self._zeros:
            try:
                write_whole(self._out, with_values(self._rig_file, wanted).encode())
            except OSError as error:
                raise DataError(f"{self._out}: cannot be written: {error.strerror}") from None
        else:
            write_values(self._rig_file, wanted, out=self._out)
        self._zeros, self._zeroed = wanted, self._zeroed | {axis: offset}
        self._say(
            f"{axis} reads {read:.3f} deg and stands at {at:g} deg: zero_offset_deg = {offset:.3f} in {self._out}, which "
            "holds from the next command on; this session goes on with the zeros that it began with"
        )
        others = [name for name in self._bench.description.holder.axes if name != axis]
        if others and ("holder", "zero_offset_known") in values:
            self._say(f"holder.zero_offset_known = true holds for {others[0]} too: set its zero as well")


def _places(columns: Any, rows: Any) -> list[list[float]] | None:
    """Places for JSON; None where one of them is not in front of the camera."""
    if not (np.isfinite(columns).all() and np.isfinite(rows).all()):
        return None
    return [[round(float(c), 2), round(float(r), 2)] for c, r in zip(columns, rows, strict=True)]


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _beam_outline(bench: Bench, view: View) -> list[list[float]] | None:
    """The edge of the lamp's beam on the sample's plane, by the rig file; None for a beam without one."""
    diameter = bench.description.lamp.beam_diameter_mm
    source = np.asarray(view.source_mm, dtype=float)
    if diameter is None or source[2] <= 0:
        return None
    toward = source / np.linalg.norm(source)
    first = np.cross(toward, (0.0, 1.0, 0.0) if abs(toward[1]) < 0.9 else (1.0, 0.0, 0.0))
    first /= np.linalg.norm(first)
    second, turn = np.cross(toward, first), np.linspace(0.0, 2 * np.pi, 65)[:, None]
    circle = 0.5 * diameter * (np.cos(turn) * first + np.sin(turn) * second)
    down = source[2] - circle[:, 2:]
    if (down <= 0).any():
        return None
    return _places(*imaging.project(bench.description, view, source + (circle - source) * source[2] / down))


def _pairs(words: list[str], example: str) -> dict[str, float]:
    """`light 30 camera -30` as {"light": 30, "camera": -30}."""
    if not words or len(words) % 2:
        raise ConfigError(f"an axis and an angle in degrees are needed, as in {example}")
    out: dict[str, float] = {}
    for name, number in zip(words[::2], words[1::2], strict=True):
        if name in out:
            raise ConfigError(f"{name} is given twice")
        out[name] = _one_number([number], example, ("deg",))
    return out


def _one_number(words: list[str], example: str, units: tuple[str, ...]) -> float:
    text = "".join(words)
    for unit in units:
        text = text.removesuffix(unit)
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f'"{" ".join(words)}": a number is needed, as in {example}')
    return value
