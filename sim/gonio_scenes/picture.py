"""What `gonio render` writes: radiance.npz, picture.png, summary.json; picture.exr and photograph.dng if asked for."""

import json
import math
import os
import tempfile
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gonio import __version__, colour
from gonio.disk import require_own, work_folder, write_own
from gonio.errors import ConfigError, os_error_as
from gonio.lab.acquisition.exposure import USABLE
from gonio.lab.rig.dng import encode_dng
from gonio.lab.rig.protocols import Frame
from gonio.typing import Floats, JsonObject, NDArray
from gonio_scenes.camera import expose
from gonio_scenes.cheaper import Taken
from gonio_scenes.lights import DiscLight, relative_power
from gonio_scenes.render import Picture
from gonio_scenes.scene import Scene, tables

Image = NDArray[np.uint8]
WHITE_SHARE = 0.99
"""Where the file gives no white, this share of the picture's lit pixels is at most white."""


def write(
    scene: Scene, picture: Picture, out: Path, *, exr: bool = False, command: str = "",
    forms: Sequence[Taken] | None = None,
) -> None:  # fmt: skip
    """Write all files of a rendered scene into a folder; `forms` are those of `render_to_error`.

    Raises
    ------
    ConfigError
        The folder cannot be written, or holds files of the same name that somebody else made; OpenEXR is missing.
    """
    shown, white = display(scene, picture.radiance)
    told = summary(scene, picture, white, command)
    if forms is not None:
        told["forms"] = [asdict(form) | {"spent": form.spent} for form in forms]
    files: dict[str, bytes | Path] = {"picture.png": _png(shown)}
    del shown
    if _photographed(scene):
        frame = photograph(scene, picture)
        files["photograph.dng"] = encode_dng(frame)
        told["photograph"] = _of_frame(scene, frame)
    files["summary.json"] = (json.dumps(told, indent=2) + "\n").encode()
    if exr:
        files["picture.exr"] = _exr(scene, picture)
    with os_error_as(ConfigError, f"{out}: cannot be written"):
        out.mkdir(parents=True, exist_ok=True)
        with work_folder(out, "radiance") as folder:
            whole = folder / "radiance.npz"
            _write_npz(picture, whole)
            write_own(out, files | {"radiance.npz": whole})


def require_free(scene: Scene, out: Path, *, exr: bool) -> None:
    """Raise `ConfigError`, before any work, where the files cannot be written: somebody else's are there."""
    if exr:
        openexr()
    more = [name for name, asked in (("picture.exr", exr), ("photograph.dng", _photographed(scene))) if asked]
    require_own(out, ["radiance.npz", "picture.png", "summary.json", *more])


def photograph(scene: Scene, picture: Picture) -> Frame:
    """The raw frame that the scene's sensor gives of a picture.

    Raises
    ------
    ConfigError
        The scene file names no sensor or no exposure.
    """
    table = scene.tables.photograph
    if table is None or table.sensor is None or table.exposure_s is None:
        raise ConfigError("photograph: a raw frame needs photograph.exposure_s and the table [photograph.sensor]")
    return expose(table.sensor, scene.camera, picture.radiance[..., 0], table.exposure_s, table.seed)


def _photographed(scene: Scene) -> bool:
    return scene.tables.photograph is not None and scene.tables.photograph.simulated


def _of_frame(scene: Scene, frame: Frame) -> JsonObject:
    table = scene.tables.photograph
    assert table is not None
    assert table.sensor is not None
    full = min(frame.white_level_dn, frame.black_level_dn + table.sensor.full_well_e / table.sensor.electrons_per_dn)
    limit = frame.black_level_dn + USABLE * (full - frame.black_level_dn)
    return {
        "exposure_s": frame.exposure_s,
        "seed": table.seed,
        "largest_dn": int(frame.mosaic.max()),
        "saturated_share": float(np.mean(frame.mosaic > limit)),
    }


def display(scene: Scene, radiance: Floats) -> tuple[Image, float]:
    """The picture as a screen shows it, (height, width, 3) in RGB, and the luminance or radiance that is white.

    In colour from two visible wavelengths on, else in grey: the radiance at the middle wavelength.
    """
    waves, white = scene.wavelength_nm, scene.picture.white
    visible = (waves >= colour.wavelengths()[0]) & (waves <= colour.wavelengths()[-1])
    if visible.sum() < 2:
        grey = radiance[..., waves.size // 2]
        white = white or _white(grey)
        out = np.empty((*grey.shape, 3), np.uint8)
        for row, values in zip(out, grey, strict=True):
            row[:] = np.rint(255.0 * colour.SRGB.encode(values / white))[:, None]
        return out, white
    else:
        xyz, illuminant = tristimulus(scene, radiance)
        white = white or 1.0 / colour.exposure(xyz, WHITE_SHARE)
        shown = (
            colour.display_1982(xyz)
            if scene.picture.display == "1982"
            else colour.display_srgb(xyz, exposure=1.0 / white, illuminant=illuminant)
        )
    return np.rint(255.0 * shown).astype(np.uint8), white


def tristimulus(scene: Scene, radiance: Floats) -> tuple[Floats, str | None]:
    """XYZ of radiances (..., wavelengths), and the illuminant that all lights share, if they do.

    Those of channels are linear sRGB as they stand.

    Where they do, what is interpolated between the scene's wavelengths is the reflection alone, which is smooth: the
    illuminant's own structure stays whole, however few wavelengths there are.
    """
    waves = scene.wavelength_nm
    if scene.tables.of_channels:
        return radiance @ colour.channel_weights(), "D65"
    visible = (waves >= colour.wavelengths()[0]) & (waves <= colour.wavelengths()[-1])
    shared = {
        light.spectrum if isinstance(light.spectrum, str) else light.spectrum is None for light in scene.tables.light
    }
    first, last = np.flatnonzero(visible)[[0, -1]]
    within = slice(first, last + 1)  # a slice, since it copies none of the radiances, which are large
    seen, nm = radiance[..., within], waves[within]
    if len(shared) == 1 and (name := shared.pop()) is not False:
        illuminant = "E" if name is True else str(name)
        return seen @ (colour.weights(nm, illuminant) / relative_power(illuminant, nm)[:, None]), illuminant
    return seen @ colour.light_weights(nm), None


def _white(radiance: Floats) -> float:
    """The quantile `WHITE_SHARE` of what is lit, between neighbours linearly; 1 where nothing is."""
    count = int(np.count_nonzero(radiance > 0.0))
    if not count:
        return 1.0
    place = (count - 1) * WHITE_SHARE
    most = count - int(place)
    largest = np.zeros(0)
    for row in radiance:  # the largest so far: a copy of all of them would be as large as the picture
        largest = np.concatenate([largest, row[row > 0.0]])
        if largest.size > 4 * most + 4096:
            largest = np.partition(largest, -most)[-most:]
    largest = np.sort(largest)[-most:]
    return float(largest[0] + (place - int(place)) * (largest[min(1, most - 1)] - largest[0]))


def _write_npz(picture: Picture, path: Path) -> None:
    """The arrays of a picture, block by block, as `numpy.savez` would write them."""
    size = picture.radiance.shape[:2]
    members: dict[str, tuple[tuple[int, ...], str, Iterable[NDArray[Any]]]] = {
        "radiance": (picture.radiance.shape, "<f8", picture.radiance),
        "wavelength_nm": (picture.scene.wavelength_nm.shape, "<f8", [picture.scene.wavelength_nm]),
        "shape": (size, "<i8", (hits.shape for hits in picture.centres())),
        "position_mm": ((*size, 3), "<f8", (hits.position for hits in picture.centres())),
        "normal": ((*size, 3), "<f8", (hits.normal for hits in picture.centres())),
        "samples": (size, "<i8", picture.samples),
    }
    if picture.error is not None:
        members["u_radiance"] = (picture.error.shape, "<f8", picture.error)
    with open(path, "wb") as raw:
        with zipfile.ZipFile(raw, "w") as file:
            for name, (shape, kind, blocks) in members.items():
                with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                    header = {"descr": kind, "fortran_order": False, "shape": shape}
                    np.lib.format.write_array_header_1_0(member, header)
                    for block in blocks:
                        member.write(np.ascontiguousarray(block, kind).tobytes())
        raw.flush()
        os.fsync(raw.fileno())


def _png(image: Image) -> bytes:
    """As a PNG; the image's colours change places."""
    import cv2

    for row in image:
        row[:] = row[:, ::-1].copy()
    done, data = cv2.imencode(".png", image)
    assert done
    return bytes(data)


def openexr() -> Any:
    """The module OpenEXR, or `ConfigError` saying how to get it."""
    try:
        import OpenEXR
    except ImportError:
        raise ConfigError("EXR files need the package OpenEXR: pip install gonio[exr]") from None
    return OpenEXR


def _exr(scene: Scene, picture: Picture) -> bytes:
    """A float EXR with one channel a wavelength, named as spectral renderers name them."""
    module = openexr()
    channels = {
        f"S0.{wave:.3f}nm".replace(".", ",").replace("S0,", "S0."): np.ascontiguousarray(
            picture.radiance[..., k].astype(np.float32)
        )
        for k, wave in enumerate(scene.wavelength_nm)
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.exr"
        header = {"compression": module.ZIP_COMPRESSION, "type": module.scanlineimage}
        with module.File(header, channels) as file:
            file.write(str(path))
        return path.read_bytes()


def left_out(scene: Scene) -> list[dict[str, str]]:
    """What was not computed, and why."""
    world, camera = scene.world, scene.camera
    ambient, shadows = scene.ambient is not None, world.casts_shadows
    spikes = any(material.has_spike for material in scene.material)
    constant = all(material.constant for material in scene.material)
    discs = [light for light in scene.lights if isinstance(light, DiscLight)]
    one_ray = camera.samples == 1 and scene.tolerance == 0.0
    centres = camera.noiseless and scene.tolerance == 0.0 and all(disc.samples == 1 for disc in discs)
    to_mirror = shadows or discs or ambient
    one_wave = scene.wavelength_nm.size == 1
    polarised = any(light.polarisation is not None for light in scene.lights)
    shown = any(disc.polarisation is not None and disc.visible for disc in discs)
    rules: list[tuple[object, str, str]] = [
        (not scene.lights, "shadow rays", "no light comes from a direction"),
        (scene.lights and not shadows, "shadow rays", "one convex shape casts no shadow on itself"),
        (not spikes, "mirror rays", "no material has a specular spike"),
        (spikes and not to_mirror, "mirror rays",
         "there is nothing to see in the mirror: one convex shape, no disc of light, no ambient light"),
        (one_wave, "colour", "one wavelength: the picture is grey"),
        (constant and not one_wave, "spectra of materials",
         "no BRDF depends on the wavelength: each is evaluated once"),
        (not polarised, "polarisation", "no light is polarised"),
        (polarised and spikes and (shadows or discs), "polarisation of what a mirror shows",
         "what comes along a mirror ray is taken as unpolarised"),
        (shown, "polarisation of discs of light that the camera sees",
         "their own radiance is taken as unpolarised"),
        (not ambient, "ambient light", "the scene names none"),
        (ambient, "shadows of ambient light",
         "ambient light is taken as uniform at every point (He et al. 1991, eq. 12)"),
        (not discs, "sampling of lights", "every light has one direction at a point"),
        (discs and centres, "the size of discs of light",
         "samples = 1 and one ray a pixel: they light from their centre"),
        (not _photographed(scene), "a sensor's frame", "the scene names no photograph with a sensor and an exposure"),
        (camera.lens_radius == 0.0, "depth of field", "the camera is a pinhole"),
        (one_ray, "anti-aliasing", "one ray a pixel, through its centre"),
        (len(world.shapes) > 1, "light between matte surfaces",
         "direct light and mirror rays alone are followed"),
    ]  # fmt: skip
    return [{"what": what, "why": why} for applies, what, why in rules if applies]


def summary(scene: Scene, picture: Picture, white: float, command: str) -> JsonObject:
    """The numbers of a rendered scene, as `summary.json` holds them."""
    out: JsonObject = {
        "name": scene.name,
        "gonio": __version__,
        "command": command,
        "seconds": picture.seconds,
        "rays": picture.rays,
        "width": scene.camera.width,
        "height": scene.camera.height,
        "wavelength_nm": scene.wavelength_nm.tolist(),
        "samples": {"mean": float(picture.samples.mean()), "most": int(picture.samples.max())},
        "share_of_pixels_on_shapes": picture.share_on_shapes,
        "radiance": {
            "largest": picture.radiance.max(axis=(0, 1)).tolist(),
            "mean": picture.radiance.mean(axis=(0, 1)).tolist(),
        },
        "white": white,
        "left_out": left_out(scene),
    }
    if measured := tables(scene):
        out["tables"] = {
            name: {"extrapolated_share": picture.extrapolated[name], "remarks": list(one.remarks)}
            for name, one in measured.items()
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
