"""Scenes in Mitsuba 3, where it is installed: pictures, their standard errors and times; and whether ours agree.

Mitsuba runs in a process of its own, as every peer does (`peers`).
"""

import importlib.util
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from gonio_validation.bench import peers

from gonio.errors import DataError
from gonio.typing import Floats

SCALAR, COMPILED = "scalar_rgb", "llvm_ad_rgb"
"""The variant that runs wherever Mitsuba does, and the one that compiles with LLVM."""
TILE = 8
"""Pixels along a side of a tile."""
FLOAT32 = 2e-6
"""Part of a tile's radiance that Mitsuba's float32 may be off without noise: some thirty roundings of 6e-8."""
HELP = (
    f"{COMPILED} needs LLVM 16 or newer, and none was found: install it (Debian 12: libllvm19), or name its library in "
    f"{peers.LLVM}"
)


@dataclass(frozen=True)
class Variant:
    """A variant of Mitsuba that works here."""

    name: str
    environment: dict[str, str]
    """What its process needs besides ours."""


@dataclass(frozen=True)
class MitsubaPicture:
    """A scene as Mitsuba renders it."""

    radiance: Floats
    """(height, width, 3), the mean of all runs."""
    error: Floats
    """Its standard error, from the scatter of runs."""
    seconds: Floats
    """Of each run; the first of a compiled variant, which compiles, is not among them."""


def find() -> tuple[str, list[Variant]]:
    """What was found of Mitsuba, in words, and the variants that work."""
    if importlib.util.find_spec("mitsuba") is None:
        return "not installed (pip install 'gonio[peers]')", []
    found = [Variant(SCALAR, {})] if _works(SCALAR, {}) else []
    if not found:
        return f"installed, but {SCALAR} fails", []
    for environment in peers.llvm_libraries():
        if _works(COMPILED, environment):
            found.append(Variant(COMPILED, environment))
            return f"{SCALAR} and {COMPILED}", found
    return f"{SCALAR}; {HELP}", found


def rendered(xml: Path, *, samples: int, runs: int, variant: Variant) -> MitsubaPicture:
    """Render an XML file several times, with other random numbers each time, in a process of its own.

    Parameters
    ----------
    xml
        The scene.
    samples
        Rays a pixel of one run.
    runs
        At least two.
    variant
        One of `find`.

    Raises
    ------
    DataError
        The process failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "runs.npz"
        code = (
            "from tools.studies.mitsuba_pictures import report; "
            f"report({str(xml)!r}, {samples}, {runs}, {variant.name!r}, {str(out)!r})"
        )
        made = peers.process(code, variant.environment, timeout=600)
        if made is None or made.returncode:
            why = "took longer than 600 s" if made is None else (made.stderr.strip().splitlines() or ["no message"])[-1]
            raise DataError(f"{xml}: Mitsuba's process failed: {why}")
        with np.load(out) as arrays:
            pictures, seconds = arrays["pictures"], arrays["seconds"]
    error = pictures.std(axis=0, ddof=1) / np.sqrt(runs)
    return MitsubaPicture(pictures.mean(axis=0), error, seconds)


def report(xml: str, samples: int, runs: int, variant: str, out: str) -> None:
    """In Mitsuba's own process: render, and write every run's picture and time."""
    import mitsuba

    mitsuba.set_variant(variant)
    scene = mitsuba.load_file(xml)
    if variant != SCALAR:
        np.array(mitsuba.render(scene, spp=samples, seed=runs))  # compiles
    pictures, seconds = [], []
    for seed in range(runs):
        began = time.perf_counter()
        pictures.append(np.array(mitsuba.render(scene, spp=samples, seed=seed), dtype=np.float64))
        seconds.append(time.perf_counter() - began)
    np.savez(out, pictures=np.array(pictures), seconds=np.array(seconds))


def _works(variant: str, environment: dict[str, str]) -> bool:
    code = (
        f"import mitsuba; mitsuba.set_variant({variant!r}); "
        "film = {'type': 'hdrfilm', 'width': 8, 'height': 8}; sensor = {'type': 'perspective', 'film': film}; "
        "scene = {'type': 'scene', 'i': {'type': 'direct'}, 's': {'type': 'sphere'}, 'sensor': sensor}; "
        "print(mitsuba.render(mitsuba.load_dict(scene), spp=1).shape)"
    )
    made = peers.process(code, environment, timeout=120)
    return made is not None and made.returncode == 0


def scores(ours: Floats, our_error: Floats, theirs: Floats, their_error: Floats) -> Floats:
    """How far two pictures are apart in each tile of 8 x 8 pixels, in standard errors of the tiles' difference.

    Parameters
    ----------
    ours, theirs
        Radiances (height, width); what does not fill a tile at the right and lower edge is left out.
    our_error, their_error
        Standard errors of each pixel, of the same shape. Float32's rounding is added to theirs.
    """
    a, b = _tiles(ours), _tiles(theirs)
    rounding = FLOAT32 * np.maximum(np.abs(a), np.abs(b)).mean(axis=(1, 3))
    noise = np.sqrt((_tiles(our_error) ** 2 + _tiles(their_error) ** 2).sum(axis=(1, 3))) / TILE**2
    known = np.hypot(noise, rounding)
    with np.errstate(invalid="ignore"):
        return np.where(known > 0.0, (a.mean(axis=(1, 3)) - b.mean(axis=(1, 3))) / known, 0.0)


def _tiles(picture: Floats) -> Floats:
    rows, columns = picture.shape[0] // TILE, picture.shape[1] // TILE
    return picture[: rows * TILE, : columns * TILE].reshape(rows, TILE, columns, TILE)
