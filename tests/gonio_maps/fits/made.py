"""Map files made from models, with noise that is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from gonio_maps.files import Parts, Variable, tiles

from gonio import models
from gonio.geometry import Directions
from gonio.typing import Floats

FAR_MM = 300.0
CAMERA_MM = 500.0


def poses() -> tuple[Floats, Floats]:
    """Unit vectors to source and camera of 100 points: in plane at four incidences, and some out of it."""
    theta_i, theta_r, dphi = [], [], []
    for incidence in (10.0, 30.0, 50.0, 65.0):
        for view in np.arange(-70.0, 71.0, 7.0):
            theta_i.append(incidence)
            theta_r.append(abs(view))
            dphi.append(180.0 if view >= 0 else 0.0)
        for view, turn in ((20.0, 90.0), (40.0, 135.0), (55.0, 45.0), (55.0, 160.0)):
            theta_i.append(incidence)
            theta_r.append(view)
            dphi.append(turn)
    i, r, azimuth = (np.radians(a) for a in (theta_i, theta_r, dphi))

    def unit(theta: Floats, phi: Floats) -> Floats:
        return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)

    return unit(i, np.zeros_like(i)), unit(r, azimuth)


def write(
    path: Path,
    of: Callable[[float, float], Mapping[str, Any]],
    *,
    kind: Any = models.CookTorrance,
    rows: int = 64,
    cols: int = 64,
    noise: float = 0.01,
    common: float = 0.0,
    point: float = 0.0,
    seed: int = 0,
    waves: tuple[float, ...] = (550.0,),
    wrong: Callable[[Directions], Floats] | None = None,
    pixel_mm: float = 0.1,
) -> dict[str, Floats]:
    """Write a map whose parameters are `of` (x, y) [mm], the arguments of `kind`; the true parameters (rows, cols).

    `noise` is relative and independent, `common` relative and shared by all pixels and points, `point` relative and
    shared by all pixels of a point. `wrong` is a factor
    that the model lacks. Without a `pixel_mm` all pixels lie in one place, which is quick.
    """
    rng = np.random.default_rng(seed)
    x = np.asarray((np.arange(cols) - 0.5 * (cols - 1)) * pixel_mm, np.float64)
    y = np.asarray((np.arange(rows) - 0.5 * (rows - 1)) * pixel_mm, np.float64)
    to_source, to_camera = poses()
    source, camera = np.tile(FAR_MM * to_source, (len(waves), 1)), np.tile(CAMERA_MM * to_camera, (len(waves), 1))
    wavelength = np.repeat(waves, len(to_source))
    n = len(source)
    shift = (1.0 + common * rng.normal()) * (1.0 + (point * rng.normal(size=n) if point else np.zeros(n)))
    parts = Parts(path, {"made": str(path)})
    truth: dict[str, Floats] = {}
    before: Mapping[str, Any] | None = None
    true = np.empty(n)
    for tile in tiles(rows, cols):
        brdf, u = np.empty((*tile.shape, n), np.float32), np.empty((*tile.shape, n), np.float32)
        for a in range(tile.shape[0]):
            for b in range(tile.shape[1]):
                at_x, at_y = float(x[tile.cols.start + b]), float(y[tile.rows.start + a])
                arguments = of(at_x, at_y)
                for name, value in arguments.items():
                    if isinstance(value, float):
                        grid = truth.setdefault(name, np.empty((rows, cols)))
                        grid[tile.rows.start + a, tile.cols.start + b] = value
                spot = np.array([at_x, at_y, 0.0])
                where = Directions.from_vectors(source - spot, camera - spot)
                if pixel_mm or arguments != before:
                    before = arguments
                    true = np.asarray(kind(**arguments).brdf(*where.angles, wavelength_nm=wavelength))
                    true = true if wrong is None else true * wrong(where)
                u[a, b] = np.hypot(noise, point) * true
                brdf[a, b] = true * shift + noise * true * rng.normal(size=n)
        parts.write(tile, {"brdf": brdf, "u_random": u, "flag": np.zeros((*tile.shape, n), np.uint8)})
    _finish(parts, x, y, source, camera, wavelength, common, point)
    return truth


def _finish(
    parts: Parts, x: Floats, y: Floats, source: Floats, camera: Floats, wavelength: Floats, common: float, point: float
) -> None:
    at = Directions.from_vectors(source, camera)
    names = ("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg")
    variables = {"x": Variable(("x",), x, units="mm"), "y": Variable(("y",), y, units="mm")}
    for name, angle in zip(names, at.angles, strict=True):
        variables[name] = Variable(("point",), np.degrees(angle), units="degree")
    variables |= {
        "wavelength_nm": Variable(("point",), wavelength, units="nm"),
        "source_mm": Variable(("point", "xyz"), source, units="mm"),
        "camera_mm": Variable(("point", "xyz"), camera, units="mm"),
        "brdf": Variable(("y", "x", "point"), None, "f4", units="sr-1"),
        "u_random": Variable(("y", "x", "point"), None, "f4", units="sr-1"),
        "flag": Variable(("y", "x", "point"), None, "u1"),
    }
    if point:
        variables["u_point"] = Variable(("point",), np.full(len(source), point))
    if common:
        variables["s_reference"] = Variable(("point",), np.full(len(source), common))
    sizes = {"y": len(y), "x": len(x), "point": len(source), "xyz": 3}
    attrs = {"quantity": "brdf", "source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0, "sample": "made"}
    parts.assemble(sizes, variables, attrs)
