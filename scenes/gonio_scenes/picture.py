"""What `gonio render` writes: radiance.npz, picture.png, picture.exr if asked for, and summary.json."""

from __future__ import annotations

import io
import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio import __version__
from gonio.disk import write_own
from gonio.errors import ConfigError
from gonio.typing import Floats
from gonio_scenes.lights import Disc
from gonio_scenes.render import Picture
from gonio_scenes.scene import Scene

Image = npt.NDArray[np.uint8]
VISIBLE_NM = (380.0, 780.0)
WHITE_QUANTILE = 0.99
"""Where the file gives no white, this share of the picture's lit pixels is at most white."""


def write(scene: Scene, picture: Picture, out: Path, *, exr: bool = False, command: str = "") -> None:
    """Write all files of a rendered scene into a folder.

    Raises
    ------
    ConfigError
        The folder cannot be written, or holds files of the same name that somebody else made; OpenEXR is missing.
    """
    shown, white = display(scene, picture.radiance)
    files = {
        "radiance.npz": _npz(scene, picture),
        "picture.png": _png(shown),
        "summary.json": (json.dumps(summary(scene, picture, white, command), indent=2) + "\n").encode(),
    }
    if exr:
        files["picture.exr"] = _exr(scene, picture)
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_own(out, files)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}") from None


def display(scene: Scene, radiance: Floats) -> tuple[Image, float]:
    """The picture as a screen shows it, and the luminance (or radiance) that is white.

    In colour from two visible wavelengths on, else in grey: the radiance at the middle wavelength.
    """
    from gonio import colour

    waves = scene.wavelength_nm
    white = scene.picture.white
    visible = (waves >= VISIBLE_NM[0]) & (waves <= VISIBLE_NM[1])
    if visible.sum() < 2:
        grey = radiance[..., waves.size // 2]
        white = white or _white(grey)
        return colour.encoded(np.repeat(np.clip(grey / white, 0.0, 1.0)[..., None], 3, axis=-1)), white
    xyz = radiance[..., visible] @ colour.weights_of_light(waves[visible])
    if white is None:
        white = _white(xyz[..., 1])
    if scene.picture.display == "1982":
        return colour.display_1982(xyz / white), white
    return colour.display_srgb(xyz / white), white


def _white(luminance: Floats) -> float:
    lit = luminance[luminance > 0.0]
    return float(np.quantile(lit, WHITE_QUANTILE)) if lit.size else 1.0


def _npz(scene: Scene, picture: Picture) -> bytes:
    arrays: dict[str, Any] = {
        "radiance": picture.radiance,
        "wavelength_nm": scene.wavelength_nm,
        "shape": picture.shape,
        "position_mm": picture.position,
        "normal": picture.normal,
        "samples": picture.samples,
    }
    if picture.error is not None:
        arrays["u_radiance"] = picture.error
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _png(image: Image) -> bytes:
    import cv2

    done, data = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))
    assert done
    return bytes(data)


def _exr(scene: Scene, picture: Picture) -> bytes:
    """A float EXR with one channel a wavelength, named as spectral renderers name them."""
    try:
        import OpenEXR
    except ImportError:
        raise ConfigError("--exr needs the package OpenEXR: pip install gonio[exr]") from None
    import tempfile

    channels = {
        f"S0.{wave:.3f}nm".replace(".", ",").replace("S0,", "S0."): np.ascontiguousarray(
            picture.radiance[..., k].astype(np.float32)
        )
        for k, wave in enumerate(scene.wavelength_nm)
    }
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "picture.exr")
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, channels) as file:
            file.write(path)
        return Path(path).read_bytes()


def left_out(scene: Scene) -> list[dict[str, str]]:
    """What was not computed, and why."""
    out = []

    def add(what: str, why: str) -> None:
        out.append({"what": what, "why": why})

    world = scene.world
    spikes = any(material.has_spike for material in scene.material)
    discs = [light for light in scene.lights if isinstance(light, Disc)]
    if not scene.lights:
        add("shadow rays", "no light comes from a direction")
    elif not world.casts_shadows:
        add("shadow rays", "one convex shape casts no shadow on itself")
    if not spikes:
        add("mirror rays", "no material has a specular spike")
    elif not (world.casts_shadows or discs or scene.ambient is not None):
        add("mirror rays", "there is nothing to see in the mirror: one convex shape, no disc of light, no ambient light")
    if scene.wavelength_nm.size == 1:
        add("colour", "one wavelength: the picture is grey")
    elif all(material.constant for material in scene.material):
        add("spectra of materials", "no BRDF depends on the wavelength: each is evaluated once")
    if scene.polariser_deg is None:
        add("polarisation", "no polariser before the camera: light and pictures are unpolarised")
    if scene.ambient is None:
        add("ambient light", "the scene names none")
    else:
        add("shadows of ambient light", "ambient light is taken as uniform at every point (He et al. 1991, eq. 12)")
    if not discs:
        add("sampling of lights", "every light has one direction at a point")
    if scene.camera.lens_radius == 0.0:
        add("depth of field", "the camera is a pinhole")
    if scene.camera.samples == 1 and scene.tolerance == 0.0:
        add("anti-aliasing", "one ray a pixel, through its centre")
    if any(shape for shape in world.shapes) and len(world.shapes) > 1:
        add("light between matte surfaces", "direct light and mirror rays alone are followed")
    return out


def summary(scene: Scene, picture: Picture, white: float, command: str) -> dict[str, Any]:
    """The numbers of a rendered scene, as `summary.json` holds them."""
    hit = picture.shape >= 0
    out: dict[str, Any] = {
        "name": scene.name,
        "gonio": __version__,
        "command": command,
        "seconds": picture.seconds,
        "rays": picture.rays,
        "width": scene.camera.width,
        "height": scene.camera.height,
        "wavelength_nm": scene.wavelength_nm.tolist(),
        "samples": {"mean": float(picture.samples.mean()), "most": int(picture.samples.max())},
        "share_of_pixels_on_shapes": float(hit.mean()),
        "radiance": {
            "largest": picture.radiance.max(axis=(0, 1)).tolist(),
            "mean": picture.radiance.mean(axis=(0, 1)).tolist(),
        },
        "white": white,
        "left_out": left_out(scene),
    }
    if picture.error is not None:
        known = picture.error[np.isfinite(picture.error)]
        out["standard_error"] = {
            "root_mean_square": float(math.sqrt(np.mean(known**2))) if known.size else None,
            "largest": float(known.max()) if known.size else None,
        }
    if scene.tolerance > 0:
        out["tolerance"] = scene.tolerance
        out["pixels_above_tolerance"] = picture.above_tolerance
    return out
