"""The frames of a session as they come from the camera: each is checked, and the last one may be on its way.

A camera that says when an exposure is over (`gonio.lab.rig.Exposes`) is read out while the arms go on.
"""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np

from gonio.errors import DeviceError, PassingFault
from gonio.lab.acquisition import exposure
from gonio.lab.acquisition.repeats import REPEATED, cannot_be_alike
from gonio.lab.rig import Arrived, Exposed, Exposes, Frame, Rig
from gonio.lab.rig.protocols import Monitors
from gonio.lab.rig.regions import require_frame

log = logging.getLogger("gonio.devices")


@dataclass(frozen=True, slots=True)
class Coming:
    """A frame that is on its way, or there; what it says of itself is checked when it is asked for."""

    exposed: Exposed
    take: Callable[[], Frame]

    def done(self) -> bool:
        """Whether the frame is there."""
        return self.exposed.done()

    def result(self) -> Frame:
        """Wait for the frame; raises as `Shots.capture`."""
        return self.take()


class Shots:
    """The camera of a session.

    Parameters
    ----------
    rig
        Entered.
    last_s
        When the last frame of the sessions before was taken [s]; minus infinity where there is none.
    """

    def __init__(self, rig: Rig, last_s: float) -> None:
        self._rig, self._description = rig, rig.description
        self._source = f'the camera of the rig "{rig.description.name}"'
        self.last_s = last_s
        """When the last frame that counts was taken."""
        self.resumed = math.isfinite(last_s)
        """No frame of this session has come yet."""
        self.step = -1
        """The step that is being taken."""
        self._picture: tuple[Frame | None, int] = None, -1
        """The last frame that came, and of which step."""
        self._coming: Coming | None = None

    @property
    def coming(self) -> bool:
        """Whether a frame is on its way."""
        return self._coming is not None and not self._coming.done()

    def capture(self, exposure_s: float, *, lit: bool) -> Frame:
        """A frame, later than the one before it; raises `DeviceError` where its time does not say so."""
        frame = self._sound(self._rig.camera.capture(exposure_s), exposure_s, self.step)
        monitored = lit and self._description.lamp.monitor and frame.monitor is None
        return replace(frame, monitor=self._monitor()) if monitored else frame

    def expose(self, exposure_s: float, *, lit: bool) -> Exposed:
        """The same, once its exposure is over: the frame may come later. Before the next one it was asked for."""
        if not isinstance(self._rig.camera, Exposes):
            return Arrived(self.capture(exposure_s, lit=lit))
        exposed, step = self._rig.camera.expose(exposure_s), self.step
        monitor = self._monitor() if lit and self._description.lamp.monitor else None

        def take() -> Frame:
            self._coming = None
            frame = self._sound(exposed.result(), exposure_s, step)
            return replace(frame, monitor=monitor) if monitor is not None and frame.monitor is None else frame

        self._coming = Coming(exposed, take)
        return self._coming

    def drop(self) -> None:
        """Let a frame that is on its way come, and count for nothing."""
        coming, self._coming = self._coming, None
        if coming is not None:
            try:
                coming.exposed.result()
            except PassingFault as fault:
                log.warning("step %d: %s; that frame would have counted for nothing", self.step, fault)

    def forget(self) -> None:
        """A repetition gives the same frame once more, which is no fault of the camera."""
        self._picture = None, -1

    def _sound(self, frame: Frame, exposure_s: float, step: int) -> Frame:
        require_frame(self._description.camera, frame, self._source)
        exposure.require_asked(self._description.camera, frame, exposure_s, self._source)
        self._require_another_picture(frame, step)
        last_s = self.last_s
        sound = isinstance(frame.time_s, Real) and 0.0 <= frame.time_s < math.inf
        if sound and frame.time_s > last_s:
            self.last_s, self.resumed = float(frame.time_s), False
            return frame
        what = "a frame"
        if not sound:
            why = (
                ": seconds of at least 0 are needed. In the rig's driver, give each Frame the rig's time_s() at the "
                "start of its exposure"
            )
        elif self.resumed:
            what = "its first frame"
            why = (
                f", and this run holds a frame of {last_s!r} s: the rig's clock was set back, or starts anew at every "
                "session. Set the computer's clock right, or let the rig's time_s() go on from session to session; or "
                "measure into a new folder"
            )
        else:
            why = (
                f", and the one before it had {last_s!r} s: the drift of the lamp cannot be told from times that do "
                "not grow. In the rig's driver, give each Frame the rig's time_s() at the start of its exposure, from "
                "a clock that never goes back (time.monotonic)"
            )
        raise DeviceError(f"{self._source} stamps {what} with time_s = {frame.time_s!r}{why}")

    def _require_another_picture(self, frame: Frame, step: int) -> None:
        """Raise `DeviceError` where the camera hands out the picture before this one under a new header."""
        (before, of), self._picture = self._picture, (frame, step)
        row = frame.mosaic.shape[0] // 2
        if before is None or not np.array_equal(before.mosaic[row], frame.mosaic[row]):  # nearly always that tells
            return
        if cannot_be_alike(self._description.camera, before, frame):
            raise DeviceError(
                f"step {step}: {self._source} gives the same picture twice, "
                f"pixel by pixel, which noise makes impossible (the one before is of step {of}): {REPEATED}. Look "
                "after camera and driver, as what its buffer keeps, then go on with --resume"
            )

    def _monitor(self) -> float:
        """The reading of the lamp's monitor, where frames are divided by it."""
        read = self._rig.light.monitor() if isinstance(self._rig.light, Monitors) else None
        if read is None or not 0.0 < read < math.inf:
            raise DeviceError(
                f'the lamp of the rig "{self._description.name}" gives no reading of a monitor ({read}), and the rig '
                "file says lamp.monitor = true: name the question of its monitor in devices.light, or leave the key out"
            )
        return float(read)
