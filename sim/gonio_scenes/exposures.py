"""Pictures that can be measured: raw frames, and files of linear radiances, with the noise of each pixel."""

import io
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gonio.disk import content
from gonio.errors import ConfigError, DataError
from gonio.lab.acquisition.exposure import USABLE
from gonio.typing import Array, Bools, Floats, JsonObject
from gonio_scenes.camera import falloff
from gonio_scenes.scene import PhotographTable, Scene

Mask = Bools
PILE = 100
"""Pixels that are more at an end of what a frame holds than noise of half a DN leaves there: it was cut off."""
SAME_NM = 1e-3
"""Wavelengths are the same: EXR channels are named to a thousandth of a nanometre."""


# --- pictures --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Exposure:
    """A picture whose values are in proportion to radiance. Arrays are (height, width).

    The variance of a pixel that is expected to have the value s is `shot` s + `constant` + (`relative` s)^2; where
    `step` is above its noise, the rounding of neighbours is alike.
    """

    value: Floats
    """Electrons above the dark signal, or radiances."""
    per_radiance: Floats
    """Value of the radiance 1."""
    used: Mask
    """Pixels of the channel that is measured."""
    saturated: Mask
    clamped: Mask
    """Pixels at the lower end of what the file can hold, where noise is cut off."""
    shot: float
    constant: Floats | float
    relative: float
    step: float = 0.0
    """One DN, in units of `value`."""
    described: tuple[tuple[str, Any], ...] = ()
    """For the provenance."""


def read(scene: Scene, path: str | Path) -> Exposure:
    """Read the picture of a scene: a raw frame, or linear radiances as .npz, .exr, .npy or .tif.

    Raises
    ------
    ConfigError
        There is no such file, or the scene file does not say what the picture needs.
    DataError
        The file is damaged, of another size than the scene's camera, or holds no linear values.
    """
    path = Path(path)
    table = scene.tables.photograph
    if table is None:
        raise ConfigError("the table [photograph] is missing: it names the sensor, and the uncertainties of the scene")
    data = content(path, str(path), unreadable=DataError)
    kind = _READERS.get(path.suffix.lower())
    if kind is None:
        return _raw(scene, table, path, data)
    radiance, u = kind(scene, table, path, data)
    return _linear(scene, table, path, radiance, u)


def _raw(scene: Scene, table: PhotographTable, path: Path, data: bytes) -> Exposure:
    from gonio.lab.rig.dng import read_raw

    sensor = table.sensor
    if sensor is None:
        raise ConfigError(f"{path}: a raw frame needs the table [photograph.sensor], and the scene file has none")
    frame = read_raw(path, data)
    _require_size(scene, path, frame.mosaic.shape)
    used = np.ones(frame.mosaic.shape, dtype=bool)
    if frame.pattern != "mono":
        if table.channel is None:
            raise ConfigError(
                f"{path}: is a colour mosaic ({frame.pattern}): say which channel is measured, as in "
                'photograph.channel = "G"'
            )
        cell = np.array([letter == table.channel for letter in frame.pattern]).reshape(2, 2)
        rows, columns = frame.mosaic.shape
        used = np.tile(cell, (-(-rows // 2), -(-columns // 2)))[:rows, :columns]
    elif table.channel is not None:
        raise ConfigError(f'photograph.channel = "{table.channel}": {path} has no colours; leave the key out')
    black = frame.black_level_dn if sensor.black_level_dn is None else sensor.black_level_dn
    gain = sensor.electrons_per_dn
    full = min(frame.white_level_dn, black + sensor.full_well_e / gain)
    dark = sensor.dark_current_e_per_s * frame.exposure_s
    steady = sensor.read_noise_e**2 + sensor.dsnu_e**2 + (dark if sensor.photon_noise else 0.0)
    low, high = float(frame.mosaic[used].min()), float(frame.mosaic[used].max())
    light = max(high - black, 0.0) * gain
    bright = steady + (light if sensor.photon_noise else 0.0) + (sensor.prnu * light) ** 2
    top = frame.mosaic > black + USABLE * (full - black)
    if _piled(frame.mosaic[used], high, high - 1.0, bright / gain**2):
        top |= frame.mosaic == high
    bottom = frame.mosaic == 0
    if _piled(frame.mosaic[used], low, low + 1.0, steady / gain**2):
        bottom |= frame.mosaic == low
    return Exposure(
        value=np.asarray((frame.mosaic - black) * gain - dark, np.float64),
        per_radiance=sensor.responsivity_e_per_s * frame.exposure_s * falloff(sensor, scene.camera),
        used=used,
        saturated=top,
        clamped=bottom,
        shot=1.0 if sensor.photon_noise else 0.0,
        constant=steady,
        relative=sensor.prnu,
        step=gain,
        described=(("exposure_s", frame.exposure_s), ("black_level_dn", black), ("pattern", frame.pattern)),
    )


def _piled(values: Array, end: float, inside: float, variance: float) -> bool:
    """Whether more pixels have the value at an end than the one inside of it though they scatter: noise was cut off."""
    at, beside = (int(np.count_nonzero(values == value)) for value in (end, inside))
    return variance > 0.25 and at >= PILE and at - beside > 3.0 * np.sqrt(at + beside)


def _linear(scene: Scene, table: PhotographTable, path: Path, radiance: Any, u: Floats | None) -> Exposure:
    _require_size(scene, path, radiance.shape)
    if u is None and table.noise is None and table.noise_rel is None:
        raise ConfigError(
            f"{path}: does not say the noise of its values: give photograph.noise_rel or photograph.noise (0 for a "
            "picture without noise)"
        )
    constant = np.full(radiance.shape, (table.noise or 0.0) ** 2)
    if u is not None:
        constant += np.where(np.isfinite(u), u, 0.0) ** 2
    known = np.isfinite(radiance) & (True if u is None else np.isfinite(u))
    rounding = float(np.finfo(radiance.dtype).eps) / np.sqrt(12.0)
    radiance = np.asarray(radiance, np.float64)
    return Exposure(
        value=np.where(known, radiance, 0.0),
        per_radiance=np.ones(radiance.shape),
        used=np.ones(radiance.shape, dtype=bool),
        saturated=~known,
        clamped=known & ((radiance == 0.0) | ((radiance < 0.0) & (constant == 0.0))),
        shot=0.0,
        constant=constant,
        relative=float(np.hypot(table.noise_rel or 0.0, rounding)),
    )


def _require_size(scene: Scene, path: Path, shape: tuple[int, ...]) -> None:
    camera = scene.camera
    if shape != (camera.height, camera.width):
        raise DataError(
            f"{path}: has {shape[1]} x {shape[0]} pixels, and the scene's camera {camera.width} x {camera.height}: "
            "give camera.width and camera.height of the picture as it was taken, neither cropped nor scaled"
        )


# --- files of linear radiances ---------------------------------------------------------------------------------------


MOST_WAVES = 10_000
"""Most wavelengths of a file of radiances."""


def _npz(scene: Scene, table: PhotographTable, path: Path, data: bytes) -> tuple[Any, Floats | None]:
    """`radiance.npz` of `gonio render`."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            sizes = {part.filename.removesuffix(".npy"): part.file_size for part in archive.infolist()}
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            most = MOST_WAVES
            found: dict[str, Array] = {}
            for name in ("wavelength_nm", "radiance", "u_radiance"):
                if name == "u_radiance" and name not in arrays:
                    continue
                if sizes[name] > 16 * most + 4096:  # doubles, of any precision, and a header
                    raise DataError(f"{path}: {name} unpacks to {sizes[name]} bytes; at most {most} numbers are read")
                found[name] = np.asarray(arrays[name])
                if found[name].dtype.kind != "f":
                    raise DataError(f"{path}: {name} holds {found[name].dtype}; floating-point numbers are needed")
                most = found["wavelength_nm"].size * scene.camera.height * scene.camera.width
    except (ValueError, OSError, KeyError, EOFError, MemoryError, NotImplementedError, zipfile.BadZipFile, zlib.error):
        raise DataError(f"{path}: is no radiance.npz of gonio render, or is damaged") from None
    radiance, waves, u = found["radiance"], found["wavelength_nm"], found.get("u_radiance")
    if radiance.ndim != 3 or waves.shape != radiance.shape[2:] or (u is not None and u.shape != radiance.shape):
        raise DataError(f"{path}: radiance has the shape {radiance.shape}; (height, width, wavelengths) is needed")
    k = _wavelength(scene, path, waves)
    return radiance[..., k], None if u is None else u[..., k]


def _wavelength(scene: Scene, path: Path, waves: Floats) -> int:
    goal = float(scene.wavelength_nm[0])
    found = np.flatnonzero(np.abs(waves - goal) < SAME_NM)
    if not found.size:
        listed = ", ".join(f"{wave:g}" for wave in waves[:8])
        raise DataError(f"{path}: has no radiances at wavelength_nm = {goal:g} of the scene; it has {listed}")
    return int(found[0])


def _exr(scene: Scene, table: PhotographTable, path: Path, data: bytes) -> tuple[Any, None]:
    from gonio_scenes.picture import openexr

    module = openexr()
    try:
        with module.File(str(path), separate_channels=True) as file:
            channels = {name: np.asarray(channel.pixels) for name, channel in file.channels().items()}
    except (RuntimeError, OSError, ValueError, TypeError) as error:
        raise DataError(f"{path}: cannot be read as EXR: {error}") from None
    spectral = {name: _nanometres(name) for name in channels}
    waves = [(nm, name) for name, nm in spectral.items() if nm is not None]
    if waves:
        k = _wavelength(scene, path, np.array([nm for nm, _ in waves]))
        return channels[waves[k][1]], None
    return _one_of(channels, table, path), None


def _nanometres(channel: str) -> float | None:
    """The wavelength of a spectral channel, as in "S0.550,000nm"."""
    if not channel.endswith("nm"):
        return None
    try:
        return float(channel.removeprefix("S0.").removesuffix("nm").replace(",", "."))
    except ValueError:
        return None


def _one_of(channels: JsonObject, table: PhotographTable, path: Path) -> Any:
    """The channel that is measured, of a picture in colours or in one."""
    if len(channels) == 1:
        return next(iter(channels.values()))
    if table.channel is None or table.channel not in channels:
        raise ConfigError(
            f"{path}: has the channels {', '.join(sorted(channels))}: say which is measured, as in "
            'photograph.channel = "G"'
        )
    return channels[table.channel]


def _npy(scene: Scene, table: PhotographTable, path: Path, data: bytes) -> tuple[Any, None]:
    try:
        array = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError, MemoryError):
        raise DataError(f"{path}: is no NPY array of numbers, or is damaged") from None
    return _plane(table, path, array), None


def _tiff(scene: Scene, table: PhotographTable, path: Path, data: bytes) -> tuple[Any, None]:
    import cv2

    array = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if array is None:
        raise DataError(f"{path}: cannot be read as TIFF")
    return _plane(table, path, array[..., ::-1] if array.ndim == 3 else array), None  # OpenCV's order is B, G, R


def _plane(table: PhotographTable, path: Path, array: Any) -> Any:
    if not np.issubdtype(array.dtype, np.floating):
        raise DataError(
            f"{path}: holds {array.dtype}; linear radiances are floating-point numbers (what a camera's own JPEG or "
            "TIFF holds is not linear: take the raw file)"
        )
    if array.ndim == 3 and array.shape[2] == 3:
        return _one_of(dict(zip("RGB", np.moveaxis(array, 2, 0), strict=True)), table, path)
    if array.ndim != 2:
        raise DataError(f"{path}: has the shape {array.shape}; (height, width) or (height, width, 3) is needed")
    return array


_READERS = {".npz": _npz, ".exr": _exr, ".npy": _npy, ".tif": _tiff, ".tiff": _tiff}
