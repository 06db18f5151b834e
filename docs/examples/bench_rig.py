"""A whole rig: two arms, a filter wheel and a camera behind one controller (docs/writing_a_driver.md)."""

import math
import time
from contextlib import suppress

from gonio.config import Strict, parse
from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig import Frame, Pose, ask_for
from gonio.lab.rig.description import Positive

LANDED_DEG = 0.1


class Settings(Strict):  # the table [devices] of the rig file
    port: str
    timeout_s: Positive = 5.0


class File(Strict):  # so that messages name keys in full: devices.port
    devices: Settings


class BenchRig:
    repeatable = False

    def __init__(self, description, settings, confirm):  # touches no device
        self.description = description
        self.arms = self.light = self.camera = self  # three objects are as good
        self._settings, self._confirm = settings, confirm
        self._clock_starts = time.time() - time.monotonic()
        self._target = "sample"
        self._bench = None

    def __enter__(self):
        import bench_sdk  # here, and not at the top: `gonio --help` must not load it

        try:
            self._bench = bench_sdk.open(self._settings.port, self._settings.timeout_s)
        except OSError as error:
            raise DeviceError(f'devices.port = "{self._settings.port}": the bench does not open: {error}') from None
        try:
            self.off()
        except BaseException:
            self._bench.close()
            raise
        return self

    def __exit__(self, kind, error, trace):
        try:
            self.off()  # first dark, then parked
            if kind is None or not issubclass(kind, DeviceError):
                self.park()
        finally:
            self._bench.close()

    def begin(self, step):
        pass

    def present(self, target):
        if self._confirm and target != self._target:
            ask_for(target)
        self._target = target

    def time_s(self):
        return self._clock_starts + time.monotonic()

    # the arms

    def move(self, goal):
        wanted = {name: math.degrees(getattr(goal, name)) for name in self.description.axes()}
        for name, (lower, upper) in self.description.limits_deg().items():
            if not lower - 1e-9 <= wanted[name] <= upper + 1e-9:
                raise ConfigError(f"{name} = {wanted[name]:g} deg is outside the limits {lower:g} to {upper:g} deg")
        starts = {name: self.description.approach_starts_deg(name, angle) for name, angle in wanted.items()}
        for goals in (starts, wanted):  # every axis arrives from its side, and never from beyond a limit
            self._ask("go", {name: angle + self._zero_deg(name) for name, angle in goals.items()})
        landed = self.read()
        for name, angle in wanted.items():
            off = math.degrees(getattr(landed, name)) - angle
            if abs(off) > LANDED_DEG:
                self.stop()
                raise DeviceError(f"axis {name} landed {off:+.2f} deg from {angle:g} deg; is something in its way?")
        return landed

    def read(self):
        angles = self._ask("where")
        return Pose(**{name: math.radians(angles[name] - self._zero_deg(name)) for name in self.description.axes()})

    def stop(self):  # never raises
        with suppress(OSError):
            self._bench.halt()

    def park(self):
        self._ask("go", {"light": self.description.arms.light.limits_deg[0], "camera": 0.0})

    # the light

    def select(self, band):
        self._ask("filter", band.name)

    def on(self):
        self._ask("lamp", True)

    def off(self):
        self._ask("lamp", False)

    # the camera

    def capture(self, exposure_s):
        camera = self.description.camera
        camera.require_exposure(exposure_s)
        begun = self.time_s()
        mosaic = self._ask("expose", exposure_s)  # uint16, shape (height, width)
        return Frame(mosaic, exposure_s, camera.black_level_dn, camera.white_level_dn, camera.pattern, time_s=begun)

    def _zero_deg(self, name):
        axis = self.description.axes()[name]
        return axis.zero_offset_deg if axis.zero_offset_known else 0.0

    def _ask(self, what, *arguments):
        try:
            return getattr(self._bench, what)(*arguments)
        except OSError as error:
            raise DeviceError(f"the bench on {self._settings.port} does not do {what}: {error}") from None


class BenchPlugin:
    toml = ""  # no rig file of its own: `gonio measure --rig bench.toml`

    def open(self, description, *, sample, seed, confirm):
        table = parse(File, {"devices": description.devices}, f'rig "{description.name}"')
        return BenchRig(description, table.devices, confirm)


BENCH = BenchPlugin()
