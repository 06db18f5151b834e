"""Maps of fitted parameters as textures: pictures of 16 bits, and a file that says what they hold.

A picture is linear: its value v in [0, 1] stands for low + (high - low) v. Parameters that renderers take as they are
(albedos, widths) have the range [0, 1], so that v is the parameter. Row 0 is the largest y, as pictures have it.
"""

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from gonio.disk import require_name, require_own, write_own
from gonio.errors import ConfigError, DataError, os_error_as
from gonio.typing import Bools, Floats, NDArray
from gonio_maps.files import FitFile

LEVELS = 65535
"""Largest level of 16 bits."""
WIDTHS = {"cook-torrance": ("m", "beckmann"), "ggx": ("alpha", "ggx")}
"""The parameter that renderers call alpha, and the distribution it belongs to."""
USES = {
    "mitsuba": "bitmap textures with raw = true and filter_type = nearest: alpha of roughconductor and roughplastic is"
    " {name}.png with distribution = {distribution}",
    "gltf": "perceptualRoughness = sqrt(alpha) is roughness.png: put it into the green channel of"
    " metallicRoughnessTexture. glTF means GGX{not_ggx}",
}


def write(source: str, folder: Path) -> list[str]:
    """Write each fitted parameter of a map as a picture, with `textures.json` and `extrapolated.csv`.

    Parameters
    ----------
    source
        A map of fits.
    folder
        Where to; made if it is absent. Files of other programs there stay, and are never replaced.

    Returns
    -------
    list of str
        What a person should know: what was filled in, and what the pictures stand for.

    Raises
    ------
    ConfigError
        The folder cannot be written.
    DataError
        It is no map of fits, or a parameter is determined nowhere.
    """
    require_name(folder)
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder}: is a file; --to textures writes a folder")
    pictures: dict[str, bytes] = {}
    with FitFile(source) as file:
        up, right = file.y_mm[0] < file.y_mm[-1], file.x_mm[0] <= file.x_mm[-1]
        turn = np.s_[:: -1 if up else 1, :: 1 if right else -1]
        told, runs, remarks = {}, [], []
        for name in file.parameters:
            value = file.parameter(name)[0][turn]
            known = np.isfinite(value)
            if not known.any():
                raise DataError(f"{source}: {name} is determined in no pixel, and has no texture")
            filled = _filled(value, known)
            told[name] = _packed(pictures, name, filled, file.unit(name)) | {"extrapolated_pixels": int((~known).sum())}
            runs += [(name, *run) for run in _runs(~known)]
            if not known.all():
                remarks.append(f"{name}: {int((~known).sum())} of {known.size} pixels are filled by the nearest ones")
            if WIDTHS.get(file.model, ("",))[0] == name:
                root = np.sqrt(np.clip(filled, 0.0, 1.0))
                told["roughness"] = _packed(pictures, "roughness", root, "") | {"is": f"sqrt({name})"}
        about = _about(file, told)
    pictures["extrapolated.csv"] = _table(runs)
    pictures["textures.json"] = (json.dumps(about, indent=1, ensure_ascii=False) + "\n").encode()
    with os_error_as(ConfigError, f"{folder}: cannot be written"):
        folder.mkdir(parents=True, exist_ok=True)
        require_own(folder, pictures)
        write_own(folder, pictures)
    return [*remarks, f"{len(told)} textures of {about['width']} x {about['height']} pixels"]


def _packed(pictures: dict[str, bytes], name: str, value: Floats, unit: str) -> dict[str, Any]:
    """Add a picture of values; what the file says of it."""
    low, high = float(value.min()), float(value.max())
    if low >= 0.0 and high <= 1.0:
        low, high = 0.0, 1.0
    place = (value - low) / (high - low) if high > low else np.zeros(value.shape)
    pictures[f"{name}.png"] = _png(np.rint(LEVELS * place).astype(np.uint16))
    return {"file": f"{name}.png", "unit": unit, "low": low, "high": high}


def _about(file: FitFile, told: dict[str, Any]) -> dict[str, Any]:
    rows, cols = file.shape
    axis = file.x_mm if cols > 1 else file.y_mm
    pixel = abs(float(axis[-1] - axis[0])) / max(axis.size - 1, 1)
    name, distribution = WIDTHS.get(file.model, ("", ""))
    not_ggx = "" if distribution == "ggx" else f", {name} is Beckmann's: the widths agree, the tails do not"
    uses = {k: text.format(name=name, distribution=distribution, not_ggx=not_ggx) for k, text in USES.items()}
    return {
        "format": "gonio-textures-1",
        "model": file.model,
        "fixed": file.fixed,
        "wavelength_nm": _number(file.attrs.get("wavelength_nm")),
        "width": cols,
        "height": rows,
        "mm_per_pixel": pixel,
        "x_mm": [float(file.x_mm.min()), float(file.x_mm.max())],
        "y_mm": [float(file.y_mm.max()), float(file.y_mm.min())],
        "encoding": f"linear, 16 bits: value = low + (high - low) code/{LEVELS}; no gamma",
        "extrapolated": "extrapolated.csv lists, by parameter and row, the pixels that are not determined and have the"
        " value of the nearest one that is",
        "textures": told,
        "use": uses if name else {},
    }


def _number(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def _filled(value: Floats, known: Bools) -> Floats:
    """Values with those of the nearest known pixel where they are not known."""
    if known.all():
        return value
    from scipy.ndimage import distance_transform_edt

    row, col = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(value[row, col])


def _runs(missing: Bools) -> list[tuple[int, int, int]]:
    """Row, first and last column of each run of pixels."""
    edge = np.diff(np.pad(missing, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (rows, first), (_, after) = np.nonzero(edge == 1), np.nonzero(edge == -1)
    return list(zip(rows.tolist(), first.tolist(), (after - 1).tolist(), strict=True))


def _table(runs: list[tuple[Any, ...]]) -> bytes:
    stream = io.StringIO()
    out = csv.writer(stream, lineterminator="\n")
    out.writerow(("parameter", "row", "first_column", "last_column"))
    out.writerows(runs)
    return stream.getvalue().encode()


def _png(codes: NDArray[np.uint16]) -> bytes:
    import cv2

    return cv2.imencode(".png", codes)[1].tobytes()
