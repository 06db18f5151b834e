"""A tethered camera: a release box on a serial port, and a program that puts DNG files into a folder.

`EXPOSE seconds` is answered with OK when the shutter opens, and with DONE when it has closed. After `camera.readout_s`
the file is written under a temporary name and renamed, as a careful tethering program does.
"""

from collections.abc import Callable
from pathlib import Path

from gonio.errors import ConfigError
from gonio.lab.rig import Frame, clock
from gonio.lab.rig.dng import encode_dng, write_dng
from gonio_sim.wire.faults import CAMERA, FILE_LATE_S, Faults
from gonio_sim.wire.peer import Device, Send


class TetheredCamera(Device):
    """The peer behind the release box.

    Parameters
    ----------
    expose
        Takes a frame of an exposure [s] of what the world looks like now.
    folder
        Where the files go.
    scale
        How many times faster than wall time an exposure is over, and read out.
    readout_s
        How long a frame is read out and transferred [s].
    says_done
        Whether it says DONE.
    """

    def __init__(
        self,
        expose: Callable[[float], Frame],
        folder: Path,
        *,
        scale: float = 1.0,
        faults: Faults | None = None,
        readout_s: float = 0.0,
        says_done: bool = False,
    ) -> None:
        self._expose = expose
        self._folder = folder
        self._scale = scale
        self._readout_s, self._says_done = readout_s, says_done
        self.faults = faults or Faults()
        self._buffer = b""
        self._number = 0

    def receive(self, data: bytes, baud: int, send: Send) -> None:
        """Take bytes from the line."""
        self._buffer += data
        while b"\n" in self._buffer:
            line, _, self._buffer = self._buffer.partition(b"\n")
            word, _, argument = line.decode("ascii", "replace").strip().partition(" ")
            try:
                exposure_s = float(argument)
                if word != "EXPOSE" or not exposure_s > 0:
                    raise ValueError
            except ValueError:
                send(b"ERR\n")
                continue
            send(b"OK\n")
            self._shoot(exposure_s, send)

    def _shoot(self, exposure_s: float, send: Send) -> None:
        fault = self.faults.take(*CAMERA)
        clock.sleep(exposure_s / self._scale)
        try:
            frame = self._expose(2 * exposure_s if fault == "wrong-exposure" else exposure_s)
        except ConfigError:
            return  # the camera cannot expose that long: no file
        if self._says_done:
            send(b"DONE\n")
        clock.sleep(self._readout_s / self._scale)
        self._number += 1
        path = self._folder / f"IMG_{self._number:06d}.DNG"
        if fault == "file-missing":
            return
        if fault == "file-late":
            clock.sleep(FILE_LATE_S)
        if fault == "file-truncated":
            data = encode_dng(frame)
            path.write_bytes(data[: len(data) // 2])
            return
        write_dng(frame, path)
        if fault == "file-duplicate":
            write_dng(frame, path.with_stem(f"{path.stem}_1"))
