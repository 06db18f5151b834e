"""Aligning a rig with a live picture: one loop owns the devices, takes frames, and does what it is told in between.

    assistant = Assistant(manual, tell=page.tell, say=print, rig_file=Path("my.toml"), out=Path("aligned.toml"))
    with manual:
        assistant.run()

Orders are lines of text, put into `orders` by whatever thread; they are carried out between two frames, by the thread
that runs the loop. So drivers that are used by one thread alone need nothing else. The lamp is on a dead man's timer
(`gonio.lab.by_hand.lamp_timer`), and `alive` is the sign of life.
"""

import math
import queue
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gonio.disk import put
from gonio.errors import ConfigError, DataError, DeviceError, Disturbed, EmergencyStop
from gonio.lab.acquisition import exposure
from gonio.lab.by_hand.lamp_timer import DeadMansTimer, LampTimeOver
from gonio.lab.by_hand.live_view import FramePictures, Sight, pictures
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.by_hand.rig_file import read_zero, with_values, write_values
from gonio.lab.rig import Frame, Pose, Target, regions
from gonio.typing import JsonObject

Tell = Callable[[JsonObject, FramePictures | None], None]
"""Takes what is to be shown (what JSON can hold), and the pictures of a new frame."""

KEEP_S = 60.0
"""How long the lamp shines after a key press."""
PER_S = 8.0
"""Frames a second, at most."""
START_S = 0.5
"""The first exposure is not longer; one that a person asks for may be."""
CAMERA_S = 15.0
"""A frame that comes later than this after its exposure and its readout counts as one that does not come."""
FAILURES = 2
"""Frames in a row that may fail before the session ends."""
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
  show sample | reference what lies in the beam
  save FILE               a frame, .dng .tif or .png, with a picture of it
  quit                    lamp dark, arms hold"""


class Assistant:
    """A session at an open rig.

    Parameters
    ----------
    manual
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
        self, manual: ManualRig, *, tell: Tell, say: Callable[[str], None], rig_file: Path | None = None,
        out: Path | None = None, keep_s: float = KEEP_S, clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self.orders: queue.SimpleQueue[str] = queue.SimpleQueue()
        """Lines, as a person types them."""
        self.timer = DeadMansTimer(manual.light, keep_s, clock)
        self.ended = False
        """Somebody has said `quit`."""
        self.exposure_s: float = 0.0
        """Exposure of the next frame [s]; 0: what a matt white would need."""
        self._manual, self._tell, self._say, self._clock = manual, tell, say, clock
        self._rig_file, self._out = rig_file, out
        self._zeros: dict[tuple[str, ...], Any] = {}
        self._zeroed: dict[str, float] = {}
        self._doing = ""
        self._level: float | bool = True
        self._failures = 0
        self._confirmed = True  # by its owner, since it was lit: that the lamp is dark
        self._target: Target = "sample"
        self._sight = Sight(manual.description, clock)
        self._shown: JsonObject = {}
        self._nudge: tuple[str, float] | None = None
        self._do: dict[str, Callable[[list[str]], None]] = {
            "jog": self._jog, "go": self._go, "zero": self._zero, "park": self._park, "lamp": self._lamp,
            "band": self._band, "exposure": self._exposure, "auto": self._auto, "show": self._present,
            "save": self._save, "quit": self._quit, "help": lambda words: self._say(HELP),
            "focus": lambda words: self._sight.forget_focus(),
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
            said.append(
                " ".join(f"{name} {round(angle, 2) + 0.0:.2f}" for name, angle in (shown["angles_deg"] or {}).items())
            )
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
        """Carry out what there is to do, and wait for more for `seconds`."""
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
        camera = self._manual.description.camera
        pose = self._stand()
        if not self.exposure_s:
            expected = exposure.expected_exposure_s(self._manual.description, pose, 1.0)
            self.exposure_s = max(min(expected, START_S), camera.exposure_limits_s[0])
        try:
            frame = self._capture(self.exposure_s)
        except LampTimeOver:
            self._mind_lamp()
            return
        except Disturbed as pushed:
            self._say(f"{pushed}; the frame does not count")
            self._sight.changed()
            return
        except EmergencyStop:
            raise
        except DeviceError as failure:
            self._failures += 1
            if self._failures >= FAILURES:
                raise
            self._say(f"{failure}; trying once more, with the lamp dark")
            self._darken()
            return
        self._failures = 0
        if self._mind_lamp():
            return  # it was darkened during the exposure, or is from now on
        told = self._sight.told(frame)
        made = pictures(camera, frame, self._sight.middle)
        told["picture"] = {"zoom_box": list(made.zoom_box), "shown_white_dn": made.white_dn}
        self._shown = told
        self._tell(told | self._session(), made)

    def _stand(self) -> Pose:
        """Where the axes are, and so what is seen; normal incidence where they do not say."""
        pose = self._manual.pose()
        self._sight.stand(pose, self._manual.band, self._target)
        return pose or Pose()

    def _session(self) -> JsonObject:
        """What there is to show beside the frame."""
        left = self.timer.left_s
        return {
            "doing": self._doing, "band": self._manual.band.name, "target_exposure_s": self.exposure_s,
            "lamp": {
                "left_s": left, "keep_s": self.timer.seconds, "why_dark": self.timer.why_dark,
                "level": None if self._level is True else float(self._level),
            },
            "zeros_deg": self._zeroed, "zeros_in": str(self._out) if self._zeroed else None,
        }  # fmt: skip

    def _capture(self, exposure_s: float) -> Frame:
        camera = self._manual.description.camera
        allowed_s = exposure_s + camera.beside_s + CAMERA_S
        with self.timer.within(allowed_s, "the camera"):
            frame = self._manual.camera.capture(exposure_s)
        regions.require_frame(camera, frame, "camera")
        return frame

    def _mind_lamp(self) -> bool:
        """Darken it where its time is over, and where the watch did, see that it is dark; whether that was so."""
        if self.timer.over:
            self.timer.why_dark = "its time is over"
        elif self._confirmed or self.timer.left_s is not None:
            return False
        self._darken()
        self._say(f"lamp dark: {self.timer.why_dark}")
        return True

    def _darken(self) -> None:
        self.timer.dark()
        self._manual.lamp(False)
        self._confirmed = True
        self._sight.changed()

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
            here = self._manual.arms.read()
            goals = {name: getattr(here, name, 0.0) + by for name, by in goals.items()}
            self._manual.check(goals)
        self._manual.goals(**goals)  # whatever is wrong with them is said before anything moves
        said = ", ".join(f"{n} {round(math.degrees(a), 3) + 0.0:g}" for n, a in goals.items())
        self._busy(f"moving to {said} deg")
        moved = self._manual.move(**goals)
        self._sight.changed()
        if moved.branch:
            self._say(moved.branch)
        self._say(", ".join(f"{name} {math.degrees(angle):.3f} deg" for name, angle in moved.landed.items()))

    def _park(self, words: list[str]) -> None:
        self._busy("parking")
        self._manual.arms.park()
        self._sight.changed()
        self._say("arms parked")

    def _busy(self, what: str) -> None:
        """Say on the page what keeps the camera from its next frame."""
        self._doing = what
        if self._shown:
            self._tell(self._shown | self._session(), None)

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
            self._manual.lamp(level)
        except BaseException:
            self._darken()
            raise
        self._level = level
        self._sight.changed()
        self._say(f"lamp lit, band {self._manual.band.name}; dark {self.timer.seconds:g} s after the last key press")

    def _band(self, words: list[str]) -> None:
        self._manual.choose_band(_one_number(words, "band 550", ("nm",)))
        self._sight.changed()
        if self.timer.left_s is not None:
            self._manual.light.select(self._manual.band)
        self._say(f"band {self._manual.band.name}")

    def _exposure(self, words: list[str]) -> None:
        milli = bool(words) and words[-1].endswith("ms")
        wanted = _one_number(words, "exposure 0.02", ("ms", "s")) * (1e-3 if milli else 1.0)
        self._manual.description.camera.require_exposure(wanted)
        self.exposure_s = wanted
        self._sight.changed()
        self._say(f"exposure {wanted:g} s")

    def _auto(self, words: list[str]) -> None:
        if self.timer.left_s is None:
            raise ConfigError("auto needs light: lamp on")
        self._busy("looking for the exposure")
        pose = self._stand()
        description, region = self._manual.description, self._sight.region
        expected = exposure.expected_level_per_s(description, pose, 1.0)
        used = region.of if region is not None else np.ravel
        failed = []

        def shot(exposure_s: float) -> Frame:
            try:
                return self._capture(exposure_s)
            except DeviceError as failure:
                failed.append(failure)
                raise

        try:
            found = exposure.meter(description, shot, used, expected)
        except DeviceError as unfit:
            if failed:
                raise
            self._say(str(unfit))  # no exposure fits
            return
        self.exposure_s = found.exposure_s
        self._sight.changed()
        where = "the region" if region is not None else "the frame"
        self._say(f"exposure {found.exposure_s:.4g} s" + (f"; {where} saturates there" if found.saturated else ""))

    def _present(self, words: list[str]) -> None:
        targets: dict[str, Target] = {"sample": "sample", "reference": "reference"}
        target = targets.get(" ".join(words))
        if target is None:
            raise ConfigError("show sample, or show reference")
        self._busy(f"putting the {target} into the beam")
        self._manual.present(target)
        self._target = target
        self._sight.changed()
        self._say(f"the {target} is in the beam")

    def _save(self, words: list[str]) -> None:
        if len(words) != 1:
            raise ConfigError("save FILE: one name that ends with .dng, .tif or .png")
        shot = self._manual.snap(words[0], exposure_s=self.exposure_s)
        self._say(", ".join(str(file) for file in shot.files))

    def _zero(self, words: list[str]) -> None:
        if self._rig_file is None or self._out is None:
            raise ConfigError("there is no rig file to write a copy of: gonio rig show R > my.toml, then --rig my.toml")
        if not 1 <= len(words) <= 2:
            raise ConfigError("zero AXIS [DEG]: as in zero light 30")
        axis, at = words[0], _one_number(words[1:] or ["0"], "zero light 30", ("deg",))
        zero = read_zero(self._manual, axis, at, self._manual.read, DataError)
        wanted = self._zeros | zero.values
        if self._zeros:
            put(self._out, with_values(self._rig_file, wanted).encode())
        else:
            write_values(self._rig_file, wanted, out=self._out)
        self._zeros, self._zeroed = wanted, self._zeroed | {axis: zero.offset_deg}
        self._say(
            f"{zero} in {self._out}, which holds from the next command on; this session goes on with the zeros that it "
            "began with"
        )
        if zero.remark:
            self._say(zero.remark)


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
