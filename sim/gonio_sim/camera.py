"""The simulated camera: the rendered scene through an EMVA 1288 sensor."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig import Frame
from gonio.lab.rig.light_and_camera import Band, Camera
from gonio.typing import Floats, NDArray
from gonio_sim.render import Floats32, Renderer
from gonio_sim.world import Stream, World

THREADS = max(1, min(2, os.cpu_count() or 1))
HIT_E = 3000.0
"""Mean charge that a hit of cosmic radiation leaves in a pixel of its track [e-]: some 80 e- in a micrometre."""


class Sensor:
    """A sensor with its own fixed differences between pixels; `key` gives the start of each one's random numbers.

    The order of effects is that of EMVA 1288: photo-electrons (with PRNU) and dark electrons are counted, with shot
    noise; the well fills up; dark offset (DSNU) and read noise are added; the gain makes DN above the black level; the
    converter rounds and clips.

    Raises
    ------
    ConfigError
        The description asks for unquantised levels in a raw file that cannot hold them.
    """

    def __init__(self, camera: Camera, key: Callable[[Stream], np.uint64]) -> None:
        if not camera.quantised and camera.bits != 16:
            raise ConfigError(
                f"camera.quantised = false with camera.bits = {camera.bits}: a raw file holds whole numbers; "
                "with bits = 16 one DN is 1.5e-5 of full scale"
            )
        self._camera = camera
        self._size = camera.width * camera.height
        self._pool: ThreadPoolExecutor | None = None
        self._key = key
        self._maps: tuple[Floats32, Floats32] | None = None
        self._dark = np.zeros(self._size, np.float32)
        self._plain = not (camera.nonlinearity or camera.response or camera.hot_pixels)
        self._hot: Floats | None = None

    def close(self) -> None:
        """End the threads; the next frame starts new ones."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def read_out(self, rate: Floats32 | None, exposure_s: float, level: float, key: np.uint64) -> NDArray[np.uint16]:
        """The mosaic of one frame [DN].

        Parameters
        ----------
        rate
            Expected photo-electrons a second of each pixel with a fresh lamp; None in the dark.
        exposure_s, level
            Exposure time, and the lamp's relative output during it.
        key
            Start of the frame's random numbers.
        """
        from gonio_sim.sensor import expose

        camera = self._camera
        gain, offset = self._fixed_maps()
        flat = self._dark if rate is None else rate.reshape(-1)
        if not self._plain:
            mosaic = self._read_out_bent(flat, exposure_s, level, key)
            return mosaic.reshape(camera.height, camera.width)
        out = np.empty(self._size, np.uint16)
        numbers = (
            exposure_s * level,
            camera.dark_current_e_per_s * exposure_s,
            camera.photon_noise,
            camera.read_noise_e,
            camera.full_well_e,
            1.0 / camera.electrons_per_dn,
            camera.black_level_dn,
            camera.white_level_dn,
        )
        single: list[Any] = [number if isinstance(number, bool) else np.float32(number) for number in numbers]
        self._in_parts(lambda first, last: expose(flat, gain, offset, out, first, last, key, *single))
        return out.reshape(camera.height, camera.width)

    def _read_out_bent(self, rate: Floats32, exposure_s: float, level: float, key: np.uint64) -> NDArray[np.uint16]:
        """The same chain with hot pixels, a signal that is not linear before the converter, and a response curve."""
        camera, (gain, offset) = self._camera, self._fixed_maps()
        random = np.random.default_rng(int(key))
        mean = exposure_s * level * rate.astype(float) * gain + exposure_s * self._dark_current()
        charge = random.poisson(np.minimum(mean, 1e12)).astype(float) if camera.photon_noise else mean
        charge = np.minimum(charge, camera.full_well_e) + offset
        if camera.read_noise_e:
            charge += camera.read_noise_e * random.standard_normal(self._size)
        signal = charge / camera.electrons_per_dn
        if camera.nonlinearity:
            signal *= 1.0 + np.polynomial.polynomial.polyval(
                signal / camera.white_level_dn, (0.0, *camera.nonlinearity)
            )
        signal += camera.black_level_dn
        if camera.response:
            signal = np.interp(signal, camera.response, np.arange(len(camera.response), dtype=float))
        levels: NDArray[np.uint16] = np.clip(np.floor(signal + 0.5), 0.0, camera.white_level_dn).astype(np.uint16)
        return levels

    def _dark_current(self) -> Floats:
        """Dark current of each pixel [e-/s]; hot pixels have more, by an exponential distribution."""
        if self._hot is None:
            random = np.random.default_rng(int(self._key(Stream.HOT)))
            hot = random.random(self._size) < self._camera.hot_pixels
            more = self._camera.hot_pixel_e_per_s * random.standard_exponential(self._size)
            self._hot = self._camera.dark_current_e_per_s + np.where(hot, more, 0.0)
        return self._hot

    def _fixed_maps(self) -> tuple[Floats32, Floats32]:
        """Relative responsivity (never negative) and dark offset [e-] of every pixel."""
        if self._maps is None:
            gain = np.maximum(self._fixed_map(Stream.PRNU, self._camera.prnu, 1.0), np.float32(0.0))
            self._maps = gain, self._fixed_map(Stream.DSNU, self._camera.dsnu_e, 0.0)
        return self._maps

    def _fixed_map(self, stream: Stream, deviation: float, centre: float) -> Floats32:
        from gonio_sim.sensor import normals

        out = np.full(self._size, centre, np.float32)
        if deviation > 0.0:
            key = self._key(stream)
            self._in_parts(lambda first, last: normals(key, first, last, deviation, centre, out))
        return out

    def _in_parts(self, work: Callable[[int, int], None]) -> None:
        """Run `work(first, last)` over all pixels in threads of our own; the kernels release the interpreter's lock."""
        from gonio_sim.sensor import BLOCK

        if THREADS == 1:
            return work(0, self._size)
        if self._pool is None:
            self._pool = ThreadPoolExecutor(THREADS, thread_name_prefix="gonio-sim-sensor")
        # whole blocks, so that a pixel goes through the same instructions for any number of threads
        edges = [self._size * k // THREADS // BLOCK * BLOCK for k in range(THREADS)] + [self._size]
        parts = [self._pool.submit(work, first, last) for first, last in pairwise(edges)]
        for done in parts:
            done.result()


class SimulatedCamera:
    """The camera of the simulated rig, as a `CameraDevice`."""

    def __init__(self, world: World, renderer: Renderer) -> None:
        self._world = world
        self._renderer = renderer
        self._sensor = Sensor(world.truth.camera, world.key)

    def capture(self, exposure_s: float) -> Frame:
        """One frame of what the world looks like now.

        Raises
        ------
        ConfigError
            The exposure is outside `camera.exposure_limits_s`.
        DeviceError
            The rig is not open, or the lamp is lit without a band.
        """
        return self._exposed(exposure_s, exposure_s + self._world.truth.camera.beside_s)

    def _exposed(self, exposure_s: float, busy_s: float) -> Frame:
        """`capture`, which takes the time `busy_s` [s]."""
        world, camera = self._world, self._world.truth.camera
        world.require_open("camera")
        camera.require_exposure(exposure_s)
        rate = self._renderer.rate(self._lit_band()) if world.lamp_on else None
        if world.ambient_e_per_s:
            room = np.float32(world.ambient_e_per_s)
            rate = np.full((camera.height, camera.width), room, np.float32) if rate is None else rate + room
        world.last_level = world.lamp_level()
        mosaic = self._sensor.read_out(
            rate, exposure_s, world.last_level, world.key(Stream.SENSOR, world.step, world.frame)
        )
        if camera.cosmic_per_s:
            self._hit(mosaic, exposure_s)
        time_s = world.frame_time_s()
        world.frame += 1
        world.spend(busy_s)
        return Frame(
            mosaic=mosaic,
            exposure_s=exposure_s,
            black_level_dn=camera.black_level_dn,
            white_level_dn=camera.white_level_dn,
            pattern=camera.pattern,
            time_s=time_s,
        )

    def _hit(self, mosaic: NDArray[np.uint16], exposure_s: float) -> None:
        """Add the charge of cosmic radiation: tracks of one to three pixels, thousands of electrons in each."""
        world, camera = self._world, self._world.truth.camera
        rng = world.generator(Stream.COSMIC, world.step, world.frame)
        full = min(camera.white_level_dn, camera.black_level_dn + camera.full_well_e / camera.electrons_per_dn)
        for _ in range(rng.poisson(camera.cosmic_per_s * exposure_s)):
            row, col = rng.integers(camera.height), rng.integers(camera.width)
            down, right = rng.integers(-1, 2), rng.integers(-1, 2)
            for k in range(rng.integers(1, 4)):
                at = (row + k * down) % camera.height, (col + k * right) % camera.width
                charge = rng.exponential(HIT_E) / camera.electrons_per_dn
                mosaic[at] = max(mosaic[at], int(min(mosaic[at] + charge, full)))

    def close(self) -> None:
        """Let go of threads."""
        self._sensor.close()

    def _lit_band(self) -> Band:
        if self._world.band is None:
            raise DeviceError("the lamp is lit, and no band was selected")
        return self._world.true_band(self._world.band)


@dataclass(frozen=True, slots=True)
class ReadOut:
    """A frame of a `SlowCamera` that is on its way."""

    world: World
    frame: Frame
    ready_s: float
    """When it is there, on `World.watch_s`."""

    def done(self) -> bool:
        """Whether the frame is there."""
        return self.world.watch_s >= self.ready_s

    def result(self) -> Frame:
        """Wait for the frame; that is nothing to the clock of the step which has begun meanwhile."""
        self.world.watch_s = max(self.world.watch_s, self.ready_s)
        return self.frame


class SlowCamera(SimulatedCamera):
    """A camera with `camera.readout_s`: it says when an exposure is over, as `gonio.lab.rig.Exposes`."""

    def expose(self, exposure_s: float) -> ReadOut:
        """One frame of what the world looks like now, `camera.beside_s` after its exposure."""
        frame = self._exposed(exposure_s, exposure_s)
        return ReadOut(self._world, frame, self._world.watch_s + self._world.truth.camera.beside_s)
