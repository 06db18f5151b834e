"""Map files for tests: written with `gonio_maps.files.Parts`, as docs/maps.md describes them."""

from collections.abc import Mapping
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from gonio_maps.files import FIT_FLAGS, FLAGS, Parts, Variable, tiles

from gonio.typing import Floats

POINTS = (
    "theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "wavelength_nm",
)  # fmt: skip


def axes(rows: int, cols: int, pixel_mm: float = 0.1) -> tuple[Floats, Floats]:
    """x and y [mm] about 0."""
    x, y = (pixel_mm * (np.arange(n, dtype=np.float64) - (n - 1) / 2) for n in (cols, rows))
    return x, y


def fits(
    path: Path,
    values: Mapping[str, Floats],
    u: Mapping[str, Floats],
    *,
    model: str = "cook-torrance",
    flag: Any = 0,
    tau: Any = 0.0,
    pixel_mm: float = 0.1,
    more: Mapping[str, tuple[Variable, Any]] | None = None,
    attrs: Mapping[str, Any] | None = None,
    given: Mapping[str, Variable] | None = None,
    **sizes: int,
) -> Path:
    """A file of fits of these parameters (rows, columns); `given` are variables that do not come by tiles."""
    shape = next(iter(values.values())).shape
    x, y = axes(shape[0], shape[1], pixel_mm)
    pairs = list(combinations(values, 2))
    listed = " ".join(f"{a}:{b}" for a, b in pairs)
    at = ("y", "x")
    whole: dict[str, tuple[Variable, Any]] = dict(more or {})
    for name, value in values.items():
        unit = "deg" if name.endswith("_deg") else "um" if name.endswith("_um") else "1"
        whole |= {name: (Variable(at, units=unit), value), f"u_{name}": (Variable(at, units=unit), u[name])}
    meanings = {"flag_masks": [1 << k for k in range(len(FIT_FLAGS))], "flag_meanings": " ".join(FIT_FLAGS)}
    whole |= {
        "misfit": (Variable(at), np.broadcast_to(np.asarray(tau, float), shape)),
        "chi_square": (Variable(at), np.ones(shape)),
        "n_values": (Variable(at, dtype="i4"), np.full(shape, 100)),
        "flag": (Variable(at, dtype="u1", attrs=meanings), np.broadcast_to(np.asarray(flag, np.uint8), shape)),
    }
    if pairs and "correlation" not in whole:
        whole["correlation"] = (
            Variable(("y", "x", "pair"), dtype="f4", attrs={"pairs": listed}),
            np.zeros((*shape, len(pairs))),
        )
    return _written(path, whole, x, y, {"pair": len(pairs), **sizes}, {"model": model, **(attrs or {})}, given)


def values(
    path: Path,
    brdf: Floats,
    u: Floats,
    source_mm: Floats,
    camera_mm: Floats,
    nominal_deg: Floats,
    *,
    flag: Any = 0,
    pixel_mm: float = 0.1,
    attrs: Mapping[str, Any] | None = None,
) -> Path:
    """A map of values (rows, columns, points), their directions at the centre (4, points)."""
    rows, cols, count = brdf.shape
    x, y = axes(rows, cols, pixel_mm)
    point = dict(zip(POINTS, [*nominal_deg, np.full(count, 550.0)], strict=True))
    given = {name: Variable(("point",), value) for name, value in point.items()}
    given |= {"source_mm": Variable(("point", "xyz"), source_mm), "camera_mm": Variable(("point", "xyz"), camera_mm)}
    for name in ("footprint_mm", "shift_mm", "u_shift_mm"):
        given[name] = Variable(("point", "axis"), np.full((count, 2), 0.01))
    at, meanings = ("y", "x", "point"), {"flag_meanings": " ".join(FLAGS)}
    whole = {
        "brdf": (Variable(at, dtype="f4", units="sr-1"), brdf),
        "u_random": (Variable(at, dtype="f4", units="sr-1"), u),
        "flag": (Variable(at, dtype="u1", attrs=meanings), np.broadcast_to(np.asarray(flag, np.uint8), brdf.shape)),
    }
    sizes = {"point": count, "xyz": 3, "axis": 2}
    return _written(path, whole, x, y, sizes, attrs or {}, given)


def _written(
    path: Path, whole: Mapping[str, tuple[Variable, Any]], x: Floats, y: Floats, sizes: Mapping[str, int],
    attrs: Mapping[str, Any], given: Mapping[str, Variable] | None = None,
) -> Path:  # fmt: skip
    parts = Parts(path, {})
    for tile in tiles(y.size, x.size):
        parts.write(tile, {name: np.asarray(array)[tile.rows, tile.cols] for name, (_, array) in whole.items()})
    variables = {"x": Variable(("x",), x, units="mm"), "y": Variable(("y",), y, units="mm"), **(given or {})}
    variables |= {name: variable for name, (variable, _) in whole.items()}
    parts.assemble({"y": y.size, "x": x.size, **sizes}, variables, attrs)
    return path
