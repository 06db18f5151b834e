"""Measure what error a picture of a scene has for its time, and write the report of the study `scenes`."""

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gonio_analysis.report import files
from gonio_analysis.report.files import write_csv
from gonio_scenes import mitsuba, picture
from gonio_scenes.render import Picture, render
from gonio_scenes.scene import Scene, SceneFile, build
from gonio_validation.bench import timing
from gonio_validation.bench.page import begun

from gonio import colour
from gonio.config import parse
from gonio.typing import Floats, JsonObject, TomlTable
from tools.studies import mitsuba_pictures, scenes_page

SceneTables = TomlTable
"""A scene file or a part of it, as tables of TOML."""

Step = Callable[[int, int], None]

CAMERA: SceneTables = {
    "position_mm": [150.0, -600.0, 420.0],
    "look_at_mm": [5.0, 0.0, 10.0],
    "up": [0.0, 0.0, 1.0],
    "vertical_field_deg": 14.0,
}
PLANE = {"kind": "plane", "material": "floor"}
SPHERE = {"kind": "sphere", "center_mm": [0.0, 0.0, 40.0], "radius_mm": 40.0, "material": "sample"}
SUN = {"kind": "directional", "toward": [-1.0, -0.5, 1.2], "irradiance": 3.0}
LAMP = {
    "kind": "disc", "center_mm": [300.0, -100.0, 400.0], "normal": [-3.0, 1.0, -4.0], "radius_mm": 80.0,
    "radiance": 20.0, "samples": 1,
}  # fmt: skip
FLOOR = {"model": "lambert", "parameters": {"albedo": 0.4}}
MATERIALS: dict[str, SceneTables] = {
    "Lambert": {"model": "lambert", "parameters": {"albedo": 0.7}},
    "He-Torrance, rough aluminium": {
        "model": "he-torrance",
        "parameters": {"sigma0_um": 0.28, "tau_um": 1.77, "ior": "Al"},
    },
    "Cook-Torrance": {
        "model": "cook-torrance",
        "parameters": {
            "s": 0.6, "d": 0.4, "slopes": 0.3, "ior": 1.5, "diffuse_albedo": 0.5, "convention": "normalised",
        },
    },
}  # fmt: skip
METALS: dict[str, SceneTables] = {
    "Cook-Torrance, copper": {"model": "cook-torrance", "parameters": {"slopes": 0.3, "ior": "Cu"}},
    "Cook-Torrance, gold": {"model": "cook-torrance", "parameters": {"slopes": 0.3, "ior": "Au"}},
    "He-Torrance, rough copper": {
        "model": "he-torrance",
        "parameters": {"sigma0_um": 0.28, "tau_um": 1.77, "ior": "Cu"},
    },
}
BINS = (3, 8, 16, 31)
REFERENCE_NM = tuple(np.arange(380.0, 780.1, 5.0))
"""81 wavelengths: the tables of CIE 15 themselves."""
WAYS: dict[str, dict[str, SceneTables]] = {
    "He-Torrance, rough aluminium": {
        f"tolerance {tolerance:g}": {
            "model": "he-torrance",
            "parameters": {"sigma0_um": 0.28, "tau_um": 1.77, "ior": "Al", "tolerance": tolerance},
        }
        for tolerance in (1e-12, 1e-6)
    },
    "Oren-Nayar, 35 degrees": {
        form: {"model": "oren-nayar", "parameters": {"albedo": 0.8, "sigma_deg": 35, "form": form}}
        for form in ("exact", "functional", "qualitative")
    },
}
"""Ways of evaluating a material; the first is what the others are held against."""
SHIFTED = ("Cu", "Au", "Al")
"""Metals whose colour is shifted toward white at grazing, by Cook and Torrance's short procedure."""


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    pixels: int
    """Along a side of a picture."""
    truth: int
    """Rays a pixel of the picture that errors are measured against."""
    samples: tuple[int, ...]
    tolerances: tuple[float, ...]
    repeats: int
    shared: int
    """Pixels along a side of the picture with many wavelengths."""
    peer_samples: int
    peer_runs: int


FULL = Effort(64, 4096, (1, 4, 16, 64, 256), (0.1, 0.05, 0.02, 0.01), 3, 512, 64, 16)
QUICK = Effort(24, 256, (1, 16), (0.05,), 1, 64, 16, 4)


def make(out: str | Path, *, quick: bool = False, command: str = "", step: Step = lambda done, total: None) -> Path:
    """Measure, and write the report: all of it or nothing.

    Parameters
    ----------
    out
        Folder of the report; an earlier report there is replaced.
    quick
        Small pictures: everything is run, and nothing is precise.
    command
        The command line, for the record.
    step
        Told how many pictures are rendered, of how many.

    Returns
    -------
    Path
        Where `index.html` is.

    Raises
    ------
    ConfigError
        The folder cannot be written, or holds something that is not a report.
    """
    with files.staged(out) as stage:
        summary = collect(QUICK if quick else FULL, quick=quick, command=command, step=step)
        for name in ("samples", "tolerances", "bins", "ways", "shared", "peers"):
            if rows := summary[name]:
                files.written(stage.work / "tables" / f"{name}.csv", partial(_table, rows))
        render = partial(scenes_page.render, summary)
        draw = partial(scenes_page.drawn, summary)
        files.write_page(stage.work, summary["title"], render, lambda _: summary, lambda: [draw()])
    return Path(out) / "index.html"


def _table(rows: Sequence[JsonObject], path: Path) -> None:
    write_csv(path, list(rows[0]), (list(row.values()) for row in rows))


def collect(effort: Effort, *, quick: bool, command: str, step: Step) -> JsonObject:
    """Every number of the report, as `summary.json` holds it."""
    started = timing.machine()
    found, variants = mitsuba_pictures.find()
    lights = {"parallel light": [SUN], "disc of light": [LAMP]}
    shared_by = {name: m for name, m in (MATERIALS | METALS).items() if name in SHARED}
    peers = [(m, name, v) for m in MATERIALS for name in lights for v in variants]
    total = (
        len(lights) * (len(effort.samples) + len(effort.tolerances))
        + len(METALS)
        + sum(map(len, WAYS.values()))
        + len(SHIFTED)
        + len(shared_by)
        + len(peers)
    )
    done = 0

    def counted(rows: Iterator[Any]) -> Iterator[Any]:
        nonlocal done
        for row in rows:
            done += 1
            step(done, total)
            yield row

    samples: list[JsonObject] = []
    tolerances: list[JsonObject] = []
    for name, light in lights.items():
        scene = _scene(effort.pixels, MATERIALS["Lambert"], light)
        truth = render(_with(scene, samples=effort.truth, seed=1)).radiance
        samples += counted(_samples(name, scene, truth, effort))
        tolerances += counted(_tolerances(name, scene, truth, effort))
    bins = [row for rows in counted(_bins(n, m, effort) for n, m in METALS.items()) for row in rows]
    ways = [*counted(row for n, w in WAYS.items() for row in _ways(n, w, effort)), *counted(map(_shift, SHIFTED))]
    shared = list(counted(_shared(name, m, effort) for name, m in shared_by.items()))
    rows = list(counted(_peer(m, n, lights[n], v, effort) for m, n, v in peers))
    return begun("Scenes: speed against error", command, quick) | {
        "machine": started, "pixels": effort.pixels, "samples": samples, "tolerances": tolerances, "bins": bins,
        "ways": ways, "shared": shared, "mitsuba": found, "peers": rows,
    }  # fmt: skip


SHARED = ("Lambert", "He-Torrance, rough aluminium", "Cook-Torrance, copper")


def _scene(
    pixels: int, material: SceneTables, light: Sequence[SceneTables], wavelength_nm: Sequence[float] = (550.0,)
) -> Scene:
    """A sphere on a floor. Mirror rays are left out: no two renderers here treat them alike."""
    tables = {
        "name": "bench",
        "wavelength_nm": list(wavelength_nm),
        "camera": CAMERA | {"width": pixels, "height": pixels},
        "shape": [PLANE, SPHERE],
        "material": {"floor": FLOOR, "sample": material},
        "light": list(light),
        "mirror_depth": 0,
    }
    return build(parse(SceneFile, tables, "bench"), Path("bench.toml"))


def _with(scene: Scene, *, samples: int = 1, **changes: Any) -> Scene:
    return replace(scene, camera=replace(scene.camera, samples=samples), **changes)


def _timed(scene: Scene, repeats: int) -> tuple[Picture, float]:
    """A picture, and the least time that it took."""
    pictures = [render(scene) for _ in range(repeats)]
    return pictures[-1], min(p.seconds for p in pictures)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _both(made: Picture, truth: Floats) -> dict[str, float]:
    """The error of the picture's mean, and that of a pixel over its radiance or the mean, whichever is larger."""
    level = np.maximum(truth, truth.mean())
    return {
        "mean": abs(float(made.radiance.mean() / truth.mean()) - 1.0),
        "pixel": _rms((made.radiance - truth) / level),
    }


def _samples(name: str, scene: Scene, truth: Floats, effort: Effort) -> Iterator[JsonObject]:
    level = truth.mean()
    for rays in effort.samples:
        made, seconds = _timed(_with(scene, samples=rays, seed=2), effort.repeats)
        stated = None if made.error is None else _rms(made.error / level)
        off = _rms((made.radiance - truth) / level)
        yield {"scene": name, "rays": rays, "seconds": seconds, "rms": off, "stated": stated} | _both(made, truth)


def _tolerances(name: str, scene: Scene, truth: Floats, effort: Effort) -> Iterator[JsonObject]:
    level = np.maximum(truth, truth.mean())
    for tolerance in effort.tolerances:
        made, seconds = _timed(_with(scene, tolerance=tolerance, seed=2), effort.repeats)
        assert made.error is not None
        off = np.abs(made.radiance - truth) / level
        error, stated, beyond = _rms(off), _rms(made.error / level), float((off > 3.0 * tolerance).mean())
        most = int(made.samples.max())
        for_all = render(_with(scene, samples=32, seed=2))
        # kept: stated is at most the tolerance, the error at most half as large again, and few lie beyond three
        yield {
            "scene": name, "tolerance": tolerance, "rays": float(made.samples.mean()), "most": most,
            "seconds": seconds, "rms": error, "stated": stated, "above": made.above_tolerance, "beyond_three": beyond,
            "holds": stated <= tolerance and error <= 1.5 * stated and beyond <= 0.01,
            "seconds_for_all": for_all.seconds * most / 32, **_both(made, truth),
        }  # fmt: skip


def _bins(name: str, material: SceneTables, effort: Effort) -> list[JsonObject]:
    def seen(waves: Sequence[float]) -> tuple[Floats, float]:
        scene = _scene(effort.pixels, material, [SUN | {"spectrum": "D65"}], waves)
        made, seconds = _timed(scene, effort.repeats)
        return picture.tristimulus(scene, made.radiance)[0][made.shape == 1], seconds

    truth, _ = seen(REFERENCE_NM)
    exposure = colour.exposure(truth)
    white = colour.white() / exposure
    out = []
    for count in BINS:
        waves = (450.0, 550.0, 650.0) if count == 3 else tuple(np.linspace(400.0, 700.0, count))
        xyz, seconds = seen(waves)
        off = np.linalg.norm(colour.lab(exposure * xyz) - colour.lab(exposure * truth), axis=-1)
        worst = float(np.abs((xyz - truth) / white).max())
        out.append({
            "scene": name, "wavelengths": count, "seconds": seconds, "xyz": worst, "delta_e": float(off.mean()),
            "delta_e_worst": float(off.max()),
        })  # fmt: skip
    return out


def _ways(name: str, ways: dict[str, SceneTables], effort: Effort) -> Iterator[JsonObject]:
    truth: Floats | None = None
    for way, material in ways.items():
        made, seconds = _timed(_scene(effort.shared, material, [SUN]), effort.repeats + 1)
        seen = made.radiance[made.shape == 1]
        truth = seen if truth is None else truth
        off = (seen - truth) / truth.mean()
        yield _way(name, way, seconds, _rms(off), float(np.abs(off).max()))


def _shift(metal: str) -> JsonObject:
    """Cook and Torrance's short procedure: the colour at grazing from that at normal incidence."""
    waves, angles = np.array(REFERENCE_NM), np.linspace(0.0, np.pi / 2, 10_000)
    taken = []
    for procedure in (colour.reflected_xyz, colour.shifted_xyz):
        began = time.perf_counter()
        procedure(angles, waves, metal)
        taken.append(time.perf_counter() - began)
    rms, largest = shift_error(waves, metal)
    note = f"10 000 angles; the full procedure takes {taken[0] * 1e3:.3g} ms. Error of linear RGB, in units of white"
    return _way(f"reflectance of {metal}", "colour shift", taken[1], rms, largest, note)


def shift_error(wavelength_nm: Floats, ior: str | float) -> tuple[float, float]:
    """How far the short procedure's linear RGB lies from the full one's, in units of white: rms, and at most.

    Over 0 to 90 degrees in steps of a quarter of a degree.
    """
    angles = np.radians(np.arange(0.0, 90.1, 0.25))
    short, full = (xyz(angles, wavelength_nm, ior) for xyz in (colour.shifted_xyz, colour.reflected_xyz))
    off = colour.SRGB.rgb(short) - colour.SRGB.rgb(full)
    return _rms(off), float(np.abs(off).max())


def _way(material: str, way: str, seconds: float, rms: float, worst: float, note: str = "") -> JsonObject:
    """A way of evaluating a material against the exact one; errors over the picture's mean radiance."""
    return {"material": material, "way": way, "seconds": seconds, "rms": rms, "worst": worst, "note": note}


def _shared(name: str, material: SceneTables, effort: Effort) -> JsonObject:
    waves = tuple(np.linspace(400.0, 700.0, 31))
    _, together = _timed(_scene(effort.shared, material, [SUN], waves), effort.repeats)
    each = [_scene(effort.shared, material, [SUN], [wave]) for wave in waves]
    began = [render(scene).seconds for scene in each]
    return {"material": name, "wavelengths": len(waves), "together_s": together, "apart_s": sum(began)}


def _peer(
    material: str, name: str, light: Sequence[SceneTables], variant: mitsuba_pictures.Variant, effort: Effort
) -> JsonObject:
    # other random numbers for each material: the floor's noise would be the same in all pictures
    seed = 10 + list(MATERIALS).index(material)
    scene = _with(_scene(effort.pixels, MATERIALS[material], light), samples=effort.peer_samples, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        made = mitsuba.export(scene)
        for file, data in made.files.items():
            (Path(folder) / file).write_bytes(data)
        (xml,) = made.scenes
        theirs = mitsuba_pictures.rendered(
            Path(folder) / xml, samples=effort.peer_samples, runs=effort.peer_runs, variant=variant
        )
    ours, ours_s = _timed(scene, effort.repeats)
    assert ours.error is not None
    score = mitsuba_pictures.scores(
        ours.radiance[..., 0], ours.error[..., 0], theirs.radiance[..., 0], theirs.error[..., 0]
    )
    level = float(ours.radiance.mean())
    theirs_s = float(theirs.seconds.min())
    # of one run, which is what is timed
    ours_rms, theirs_rms = _rms(ours.error) / level, _rms(theirs.error[..., 0]) * np.sqrt(effort.peer_runs) / level
    native = made.materials["sample"]
    return {
        "scene": f"{material}, {name}",
        "variant": variant.name,
        "tiles": score.size,
        "largest": float(np.abs(score).max()),
        "rms": _rms(score[score != 0.0]),
        "beyond_three": int((np.abs(score) > 3.0).sum()),
        "ours_s": ours_s,
        "ours_rays": effort.peer_samples,
        "ours_rms": ours_rms,
        "theirs_s": theirs_s,
        "theirs_rays": effort.peer_samples,
        "theirs_rms": float(theirs_rms),
        "ours_to_one_percent_s": ours_s * (ours_rms / 0.01) ** 2,
        "theirs_to_one_percent_s": float(theirs_s * (theirs_rms / 0.01) ** 2),
        "note": "the file of slices" if native == "measured" else f'the plug-in "{native}"',
    }
