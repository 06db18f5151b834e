"""Nanoseconds of one core that rays take to meet each shape: python tools/time_shapes.py

Rays of a 512 x 512 picture from 1 m; the median of 25 calls, in processor time, so that a busy machine counts less.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from gonio_scenes.shapes import AnyShape, Shape
from pydantic import TypeAdapter

from gonio.typing import Floats

SHAPES: dict[str, dict[str, Any]] = {
    "plane": {"kind": "plane"},
    "disc": {"kind": "disc", "radius_mm": 30, "normal": [0, 1, 1]},
    "sphere": {"kind": "sphere", "radius_mm": 40},
    "cylinder": {"kind": "cylinder", "radius_mm": 20, "height_mm": 60, "axis": [0, 1, 0]},
    "box": {"kind": "box", "size_mm": [10, 20, 30], "axis": [1, 2, 3]},
    "revolution": {
        "kind": "revolution",
        "profile_mm": [[10, -30], [30, 0], [10, 30]],
        "axis": [0, 1, 0],
        "caps": True,
    },
    "smooth revolution": {
        "kind": "revolution",
        "profile_mm": [[0, -30], [30, 0], [10, 20], [15, 30]],
        "axis": [0, 1, 0],
        "smooth": True,
    },
    "mesh of 81920 triangles": {"kind": "mesh", "file": "sphere.stl", "normals": "smooth"},
    "field of 500 x 500": {"kind": "heightfield", "file": "field.npy", "size_mm": [100, 100], "height_mm": 0.5},
}


def picture() -> tuple[Floats, Floats]:
    """Origins and directions."""
    row, column = np.mgrid[:512, :512]
    direction = np.stack(
        [(column - 255.5) * 0.12 / 512, (row - 255.5) * 0.12 / 512, np.full((512, 512), -1.0)], axis=-1
    ).reshape(-1, 3)
    direction /= np.linalg.norm(direction, axis=1)[:, np.newaxis]
    return np.tile([0.0, 0.0, 1000.0], (len(direction), 1)), direction


def seconds(call: Any, *arguments: Any) -> float:
    """Processor time of a call."""
    call(*arguments)
    took = []
    for _ in range(25):
        start = process_time()
        call(*arguments)
        took.append(process_time() - start)
    return float(np.median(took))


def main() -> None:
    """Print one line a shape."""
    import trimesh

    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    origin, direction = picture()
    with tempfile.TemporaryDirectory() as folder:
        trimesh.creation.icosphere(subdivisions=6, radius=40.0).export(f"{folder}/sphere.stl")
        np.save(f"{folder}/field.npy", np.random.default_rng(1).random((500, 500)))
        print("                          hits  ns a ray   surface, ns a hit   shadow, ns a ray")
        for name, keys in SHAPES.items():
            shape: Shape = TypeAdapter[Any](AnyShape).validate_python({"material": "white", **keys}).build(Path(folder))
            distance, primitive = shape.intersect(origin, direction, 0.0)
            hit = np.isfinite(distance)
            there = origin[hit], direction[hit], distance[hit], primitive[hit]
            start = shape.surface(*there).position
            light = np.tile([0.6, 0.0, 0.8], (len(start), 1))
            print(
                f"{name:24s} {hit.mean():5.2f} {seconds(shape.intersect, origin, direction, 0.0) / hit.size * 1e9:9.0f}"
                f" {seconds(shape.surface, *there) / len(start) * 1e9:19.0f}"
                f" {seconds(shape.intersect, start, light, 1e-9 * shape.size_mm) / len(start) * 1e9:18.0f}"
            )


if __name__ == "__main__":
    main()
