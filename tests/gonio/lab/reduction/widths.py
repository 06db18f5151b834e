"""How wide stated uncertainties are: errors of many seeds of one plan over what each of them states.

    python -m tests.gonio.lab.reduction.widths sim --seeds 100 --jobs 2
    python -m tests.gonio.lab.reduction.widths sim --long --seeds 100 --jobs 2
    python -m tests.gonio.lab.reduction.widths sim --pixels --seeds 100 --jobs 2

Printed are (value - truth)/u, root mean square over values and seeds, and chi-square over n with the stated covariance,
each with its standard error by the scatter between seeds. A hundred seeds would know the size of an error that all
values of a run share to 7 % alone. So the certificate of the reference has no error here, and its column is left out;
and zeros are off by just their standard uncertainty, in every combination of signs as often.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from gonio_maps.files import MapFile, Tile
from gonio_maps.reduction import maps

from gonio import instrument, models
from gonio.config import to_toml
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction.brdf import Reduction, reduce_in_parts
from gonio.lab.rig.description import Axis
from gonio.samples.description import SampleDescription
from gonio.typing import Floats
from tests.gonio.lab.reduction.drawn_runs import rig, truth

GLOSSY = SampleDescription(
    name="glossy", model="cook-torrance",
    parameters={"s": 0.5, "d": 0.5, "slopes": [[0.25, 1.0]], "diffuse_albedo": 0.5, "ior": 1.5},
)  # fmt: skip
MATTE = SampleDescription(name="matte", model="lambert", parameters={"albedo": 0.6})
SIGNED_DEG = tuple(range(-60, 61, 10))
"""Angles of reflection, positive on the mirror side."""


@dataclass(frozen=True, slots=True)
class Seed:
    """What one run says."""

    pulls: Floats
    """(value - truth) / u, shape (values,); of a map (pixels, values)."""
    chi_square: float
    """Over n, of the values that are not open."""
    open: Floats
    """Whether most of a value's variance is a bound: a slope or a spike that nothing tells; shape (values,)."""


@dataclass(frozen=True, slots=True)
class Width:
    """What many runs say; `u_` are standard errors by the scatter between seeds."""

    rms: float
    u_rms: float
    chi_square: float
    u_chi_square: float
    by_value: Floats
    """Root mean square of each value."""


def plan(theta_i_deg: tuple[int, ...], signed_deg: tuple[int, ...]) -> Plan:
    """Points in the plane of incidence."""
    points = [Point(float(i), 0.0, float(abs(r)), 180.0 if r >= 0 else 0.0) for i in theta_i_deg for r in signed_deg]
    return Plan("widths", (500.0,), tuple(points), 0, "test")


def without_certificate(chosen: RigChoice, **camera: float) -> RigChoice:
    """A rig whose reference is what its certificate says, and with another camera."""
    description = chosen.description
    reference = description.reference.model_copy(update={"error": "none"})
    seen = description.camera.model_copy(update=camera)
    return replace(chosen, description=description.model_copy(update={"reference": reference, "camera": seen}))


def with_even_zeros(chosen: RigChoice, file: Path, seed: int) -> RigChoice:
    """A rig whose zeros are off by one standard uncertainty, by the bits of the seed up or down."""
    described = chosen.description

    def true(axis: Axis, bit: int) -> dict[str, float]:
        return {"zero_offset_deg": axis.zero_offset_deg + axis.zero_u_deg * (1 - 2 * (seed >> bit & 1))}

    arms = {name: true(getattr(described.arms, name), bit) for bit, name in enumerate(("light", "camera"))}
    file.write_text(to_toml({"arms": arms, "holder": true(described.holder, 2)}))
    return replace(chosen, description=described.model_copy(update={"truth": str(file)}))


def of_table(name: str, folder: Path, seed: int, *, long: bool = False) -> Seed:
    """25 values of `GLOSSY`, and one that the arms block; or 66 of three incidences, with four visits."""
    out = folder / f"{name}-{seed}"
    chosen = with_even_zeros(without_certificate(rig(name=name)), out.with_suffix(".toml"), seed)
    chosen_plan = plan((20, 40, 55), tuple(range(-66, 67, 6))) if long else plan((20, 55), SIGNED_DEG)
    carry_out(chosen_plan, chosen, out, sample=GLOSSY, seed=seed, yes=True)
    found = reduce_in_parts(Run.open(out))
    used = (found.table["flag"] == "").to_numpy()
    table, parts = found.table[used], found.budget[used]
    table.attrs = found.table.attrs
    off = table["brdf"].to_numpy() - truth(table, GLOSSY)
    columns = table[[c for c in table.columns if c.startswith("s_") and c != "s_reference"]].to_numpy(dtype=float)
    own = table["u_random"].to_numpy(dtype=float) ** 2
    variance = own + np.sum(columns**2, axis=1)
    bounds = (parts[["coarse_steps", "spike_blur"]].to_numpy(dtype=float) ** 2).sum(axis=1)
    is_open = bounds > 0.5 * variance
    off_known, covariance = off[~is_open], (np.diag(own) + columns @ columns.T)[np.ix_(~is_open, ~is_open)]
    chi_square = float(off_known @ np.linalg.solve(covariance, off_known)) / off_known.size
    return Seed(off / np.sqrt(variance), chi_square, is_open)


def of_map(name: str, pixel_mm: float | None, folder: Path, seed: int) -> Seed:
    """Pixels of `MATTE`, 0.36 mm wide in the camera, in some points."""
    out = folder / f"{name}-{seed}"
    chosen = without_certificate(rig(name=name), width=32, height=32, pixel_um=40.0)
    holder = chosen.description.holder.model_copy(update={"sample_diameter_mm": 8.0})
    chosen = replace(chosen, description=chosen.description.model_copy(update={"holder": holder}))
    chosen = with_even_zeros(chosen, out.with_suffix(".toml"), seed)
    carry_out(plan((20, 55), SIGNED_DEG[1::2]), chosen, out, sample=MATTE, seed=seed, yes=True)
    run = Run.open(out)
    found = reduce_in_parts(run)
    maps.write(run, found, out.with_suffix(".h5"), pixel_mm, silent)
    return _pixels(out.with_suffix(".h5"), found)


@contextlib.contextmanager
def silent(_: str) -> Iterator[Callable[[int, int], None]]:
    """A counter of the work on a map that says nothing."""
    yield lambda done, of: None


def _pixels(path: Path, found: Reduction) -> Seed:
    with MapFile(path) as file:
        value, u = file.values(Tile(slice(0, file.shape[0]), slice(0, file.shape[1])))
        names = [name for name in file.names if name.startswith("s_") and name != "s_reference"]
        common = np.stack([file.array(name) for name in names], axis=1).astype(float)
        ends = [file.array(name).astype(float) for name in ("source_mm", "camera_mm")]
        x, y = np.meshgrid(file.x_mm, file.y_mm)
    good = np.isfinite(value).all(axis=-1)
    value, u = value[good], u[good]
    spot = np.stack([x[good], y[good], 0.0 * x[good]], axis=-1)[:, None]
    angles = []
    for end in ends:
        toward = (end - spot) / np.linalg.norm(end - spot, axis=-1, keepdims=True)
        angles += [np.arccos(toward[..., 2]), np.arctan2(toward[..., 1], toward[..., 0])]
    true = instrument.apparent_brdf(
        models.build(MATTE.model, MATTE.parameters), *angles, wavelength_nm=500.0, spike="exact",
        source_solid_angle_sr=found.table.attrs["source_solid_angle_sr"],
        receiver_solid_angle_sr=found.table.attrs["receiver_solid_angle_sr"],
    )  # fmt: skip
    off, columns = value - true, value[..., None] * common
    covariance = columns @ np.swapaxes(columns, 1, 2) + np.eye(value.shape[1]) * u[:, None] ** 2
    chi_square = np.mean(off[:, None] @ np.linalg.solve(covariance, off[..., None])) / value.shape[1]
    pulls = off / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return Seed(pulls, float(chi_square), np.zeros(value.shape[1], bool))


def width(seeds: list[Seed], *, without_open: bool = False) -> Width:
    """The seeds together; without the values that are open in any of them."""
    kept = ~np.any([seed.open for seed in seeds], axis=0) | (not without_open)
    squares = np.array([np.mean(np.atleast_2d(seed.pulls) ** 2, axis=0)[kept] for seed in seeds])
    of_seeds, chi = squares.mean(axis=1), np.array([seed.chi_square for seed in seeds])
    rms, root = math.sqrt(float(of_seeds.mean())), math.sqrt(len(seeds))
    return Width(
        rms, 0.5 * float(of_seeds.std(ddof=1)) / root / rms,
        float(chi.mean()), float(chi.std(ddof=1)) / root, np.sqrt(squares.mean(axis=0)),
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rig")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--long", action="store_true")
    parser.add_argument("--pixels", action="store_true")
    parser.add_argument("--pixel-mm", type=float)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(asked.jobs) as pool:
        one = partial(of_table, asked.rig, Path(folder), long=asked.long)
        if asked.pixels:
            one = partial(of_map, asked.rig, asked.pixel_mm, Path(folder))
        seeds = list(pool.map(one, range(asked.seeds)))
    for label, found in (("all", width(seeds)), ("without open ones", width(seeds, without_open=True))):
        print(f"{label}: scatter over u {found.rms:.3f} +- {found.u_rms:.3f}")
        print("  by value", np.round(found.by_value, 2).tolist())
    print(f"chi-square over n, without open ones {found.chi_square:.3f} +- {found.u_chi_square:.3f}")


if __name__ == "__main__":
    main()
