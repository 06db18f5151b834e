"""The sensor and the lens behind a photograph, and its simulated raw frame."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from gonio.config import Strict
from gonio.errors import ConfigError
from gonio.rig.light_and_camera import Camera as SensorModel
from gonio.rig.protocols import Frame
from gonio.rig.ranges import NonNegative, Positive
from gonio.typing import Floats
from gonio_scenes.camera import Camera

SMALLEST = 32
"""Rows and columns that a raw file has at least."""
SATURATED = 0.95
"""A pixel above this share of the range between black level and saturation is not used, as in `gonio reduce`."""


class SensorTable(Strict):
    """The table [photograph.sensor]: the terms of EMVA 1288 as in a rig file, and the lens's falloff."""

    responsivity_e_per_s: Positive
    """Electrons a second of a pixel on the optical axis that sees the radiance 1, in the scene's own units."""
    bits: Literal[8, 10, 12, 14, 16] = 12
    electrons_per_dn: Positive = 3.0
    black_level_dn: NonNegative | None = None
    """64 where a photograph is simulated; that of the raw file where one is read, unless it is given."""
    full_well_e: Positive = 11_000.0
    photon_noise: bool = True
    read_noise_e: NonNegative = 0.0
    dark_current_e_per_s: NonNegative = 0.0
    prnu: Annotated[float, Field(ge=0, lt=1)] = 0.0
    dsnu_e: NonNegative = 0.0
    cos4: bool = False
    """Whether the lens loses light with the fourth power of the field angle's cosine."""
    vignetting: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Relative loss at the picture's corner beyond cos^4, growing as the fourth power of the radius."""

    @model_validator(mode="after")
    def _sound(self) -> "SensorTable":
        black, white = 64.0 if self.black_level_dn is None else self.black_level_dn, float(2**self.bits - 1)
        if black >= white:
            raise ValueError(
                f"black_level_dn = {black:g} must lie below the highest value of {self.bits} bits, {white:g}"
            )
        return self

    def model(self, width: int, height: int) -> SensorModel:
        """The same as a rig's camera of a size."""
        own = self.model_dump(exclude={"responsivity_e_per_s", "cos4", "vignetting"}, exclude_none=True)
        return SensorModel.model_validate({"width": width, "height": height, **own})


def falloff(sensor: SensorTable, camera: Camera) -> Floats:
    """The lens's share of light at each pixel's centre, 1 on the axis, (height, width)."""
    u = (np.arange(camera.width) + 0.5 - 0.5 * camera.width) * camera.step
    v = (np.arange(camera.height) + 0.5 - 0.5 * camera.height) * camera.step
    squared = v[:, None] ** 2 + u[None, :] ** 2
    out = np.ones(squared.shape)
    if sensor.cos4:
        out /= (1.0 + squared) ** 2
    if sensor.vignetting:
        corner = 0.25 * camera.step**2 * (camera.width**2 + camera.height**2)
        out *= 1.0 - sensor.vignetting * (squared / corner) ** 2
    return out


def require_size(camera: Camera) -> None:
    """Raise `ConfigError` where a picture is too small for a raw file."""
    if min(camera.width, camera.height) < SMALLEST:
        raise ConfigError(
            f"photograph: camera.width = {camera.width} and camera.height = {camera.height}; a raw file has at least "
            f"{SMALLEST} x {SMALLEST} pixels"
        )


def expose(sensor: SensorTable, camera: Camera, radiance: Floats, exposure_s: float, seed: int) -> Frame:
    """The raw frame of radiances (height, width), with the noise of the simulated rig's camera."""
    from gonio_sim.camera import Sensor
    from gonio_sim.world import Stream, key

    model = sensor.model(camera.width, camera.height)
    chip = Sensor(model, lambda stream: key(seed, stream))
    rate = radiance * sensor.responsivity_e_per_s * falloff(sensor, camera)
    try:
        mosaic = chip.read_out(rate.astype(np.float32), exposure_s, 1.0, key(seed, Stream.SENSOR))
    finally:
        chip.close()
    return Frame(mosaic, exposure_s, model.black_level_dn, model.white_level_dn, time_s=0.0)
