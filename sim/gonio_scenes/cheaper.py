"""A picture by the cheapest forms of its materials that hold an error in every pixel (docs/scenes.md)."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gonio.errors import ConfigError
from gonio.models.forms import Form, ModelDirections, forms
from gonio.typing import Bools, Floats, NDArray
from gonio_scenes.material import SceneMaterial
from gonio_scenes.render import Picture, radiance_of, render
from gonio_scenes.scene import Scene

WRITTEN = "as written"
STEPS = (8, 4, 2)
"""Pixels between those that are evaluated as written: everywhere, in doubtful squares of the first grid, of the second.
"""
TIMED = 2048
"""Most directions of a material that evaluations are timed in."""
WORTH = 0.5
"""A form whose error has to be looked for is tried where an evaluation takes less than this share of the time."""
EDGE, FLAT = 0.375, 0.01
"""From pixel to pixel a smooth radiance changes by an eighth of what it does over eight; what changes by three of these
is an edge, where another light may count. Less than `FLAT` of the radiance cannot move its error much."""
REPEATS = 3
BEYOND = 1e3
"""He-Torrance's bound is that of its series times 1 + conditioning, which no direction of a scene brought near this."""
MOSTLY = 0.5
"""A form is taken where it holds the error in more than this share of the pixels looked at."""
ALIKE = 0.01
"""Forms that fail in shares of the pixels closer than this are alike, and the cheaper one counts."""


@dataclass(frozen=True)
class Taken:
    """The form of a material that was taken, and what comes of it."""

    material: str
    form: str
    """`WRITTEN` where no cheaper one holds the error in enough pixels."""
    cost: float
    """Processor time of an evaluation in that form over that as written, in directions of the scene."""
    as_written: float
    """Share of the material's pixels that are as written nevertheless: there the form does not hold the error."""
    evaluated: float
    """Share of the material's pixels that were evaluated as written: these, and those that it was checked in."""
    worst: float
    """Largest relative error of a checked pixel."""
    mean: float
    """Relative error of the material's mean radiance over the checked pixels of an even grid."""

    @property
    def spent(self) -> float:
        """Evaluations of the whole picture, checks counted, over those as written."""
        return 1.0 if self.form == WRITTEN else self.cost + self.evaluated

    @property
    def words(self) -> str:
        """What was taken, what it saves, and how far off it is."""
        if self.form == WRITTEN:
            return f"{WRITTEN}: no cheaper form would do"
        part = f" in {1.0 - self.as_written:.1%} of its pixels, {WRITTEN} in the rest" if self.as_written else ""
        return (
            f"{self.form}{part}; worst checked pixel {self.worst:.2g}, mean {self.mean:.2g} off; an evaluation takes "
            f"{self.cost:.1%} of the time, all of them with the checks {self.spent:.1%}"
        )


class _Recorder(SceneMaterial):
    """A material that keeps the directions in which it is asked."""

    def __init__(self, of: SceneMaterial) -> None:
        self.__dict__.update(of.__dict__)
        self.asked: list[tuple[Floats, Floats, Floats]] = []

    def brdf(self, omega_i: Floats, omega_r: Floats, uv: Floats) -> Floats:
        self.asked.append((omega_i, omega_r, uv))
        return super().brdf(omega_i, omega_r, uv)

    def polarised(self, omega_i: Floats, omega_r: Floats, uv: Floats, field: Floats) -> Floats:
        self.asked.append((omega_i, omega_r, uv))
        return super().polarised(omega_i, omega_r, uv, field)

    def directions(self) -> tuple[Floats, Floats, Floats] | None:
        """Some of them, even over all; None where it was never asked."""
        if not sum(len(i) for i, _, _ in self.asked):
            return None
        i, r, uv = (np.concatenate(each) for each in zip(*self.asked, strict=True))
        some = slice(None, None, -(-len(i) // TIMED))
        return i[some], r[some], uv[some]


def render_to_error(scene: Scene, error: float) -> tuple[Picture, list[Taken]]:
    """Render a scene so that no pixel is farther off than `error`, relative to its radiance by the forms as written.

    Every pixel of a grid, and every pixel of the squares between where the error may be larger than at their corners,
    is evaluated as written, by the same rays; where the cheaper forms are off by more, that is what the picture holds.

    Raises
    ------
    ConfigError
        As `render`; the scene has a tolerance.
    """
    if scene.tolerance > 0.0:
        raise ConfigError(
            f"{scene.source}: tolerance = {scene.tolerance:g}: with --error both forms take the same rays, and a "
            "tolerance chooses rays by what comes back; set camera.samples instead"
        )
    names = np.array([shape.material for shape in scene.tables.shape])
    written = dict(zip(names, scene.material, strict=True))
    grid = _grid(scene, STEPS[0])
    at = np.flatnonzero(grid)
    recorders = {name: _Recorder(material) for name, material in written.items()}
    true = radiance_of(_with(scene, recorders), grid)[0][at]
    costs: dict[str, tuple[Form, float]] = {}
    chosen = dict(written)
    shapes = _shapes(scene)
    of_material = np.where(shapes >= 0, names[shapes], "").reshape(-1)
    for name, material in written.items():
        best = 1.0 - MOSTLY
        for form, cheap, cost in _cheaper(material, recorders[name]):
            off = _off(radiance_of(_with(scene, {**written, name: cheap}), grid)[0][at], true)
            own = of_material[at] == name
            failing = float(np.mean(off[own] > error)) if own.any() else 0.0
            if failing < best - ALIKE:
                best, chosen[name], costs[name] = failing, cheap, (form, cost)
    picture = replace(render(_with(scene, chosen)), scene=scene)
    return _mended(scene, picture, error, grid, shapes, of_material, costs)


def _cheaper(material: SceneMaterial, recorder: _Recorder) -> list[tuple[Form, SceneMaterial, float]]:
    """Cheaper forms of a material: form, material, cost over its own in directions of the scene."""
    asked = recorder.directions()
    if asked is None or material.tabulated is not None:
        return []
    toward, away, uv = asked
    out = []
    for form in forms(material.model, ModelDirections(toward, away)):
        cheap = material.in_form(form.change)
        cost = _cost(lambda: material.brdf(toward, away, uv), lambda: cheap.brdf(toward, away, uv))  # noqa: B023
        if cost < WORTH or form.bound < math.inf:
            out.append((form, cheap, cost))
    return out


def _cost(written: Callable[[], object], cheap: Callable[[], object]) -> float:
    """Processor time of one over the other, taken in turn; the first of each makes what is made once."""
    best = [np.inf, np.inf]
    for _ in range(1 + REPEATS):
        for k, evaluate in enumerate((written, cheap)):
            began = time.process_time()
            evaluate()
            best[k] = min(best[k], time.process_time() - began)
    return best[1] / best[0] if best[0] > 0.0 else 1.0


def _mended(
    scene: Scene, picture: Picture, error: float, grid: Bools, shapes: NDArray[np.int64], of_material: NDArray[np.str_],
    costs: dict[str, tuple[Form, float]],
) -> tuple[Picture, list[Taken]]:  # fmt: skip
    """The picture, with pixels as written where the forms taken are off by more than `error`."""
    radiance = picture.radiance.reshape(grid.size, -1).copy()
    stated = None if picture.error is None else picture.error.reshape(grid.size, -1).copy()
    names = list(dict.fromkeys(shape.material for shape in scene.tables.shape))
    if not costs:
        return picture, [Taken(name, WRITTEN, 1.0, 1.0, 1.0, 0.0, 0.0) for name in names]
    known, doubt = np.zeros_like(grid), np.ones_like(grid)
    true, u_true = np.zeros_like(radiance), np.zeros_like(radiance)
    for step in (*STEPS, 1):
        more = doubt & _grid(scene, step) & ~known
        if more.any():
            found, u_found = radiance_of(scene, more)
            true[more] = found[more]
            u_true[more] = 0.0 if u_found is None else u_found[more]
            known |= more
        signed = np.where(known[:, None], _signed(radiance, true), np.nan)
        if all(BEYOND * form.bound <= error for form, _ in costs.values()):
            break
        doubt &= _doubtful(picture, shapes, signed, error, step)
    at = np.flatnonzero(known)
    off = np.zeros(grid.size)
    off[at] = _off(radiance[at], true[at])
    failing = off > error
    radiance[failing] = true[failing]
    if stated is not None:
        stated[failing] = u_true[failing]
    taken = []
    for name in names:
        own = of_material == name
        form, cost = costs.get(name, (Form(WRITTEN, lambda m: m), 1.0))
        even = own & grid
        whole = float(true[even].sum())
        mean = abs(float(radiance[even].sum()) / whole - 1.0) if whole else 0.0
        share = [float(some[own].mean()) if own.any() else 0.0 for some in (failing, known)]
        worst = float(off[own & ~failing].max(initial=0.0))
        taken.append(Taken(name, form.name, cost, share[0], share[1], worst, mean))
    size = picture.radiance.shape
    error_of = None if stated is None else stated.reshape(size)
    return replace(picture, radiance=radiance.reshape(size), error=error_of), taken


# --- where the error is looked at ---------------------------------------------------------------------------------


def _lines(count: int, step: int) -> NDArray[np.int64]:
    return np.unique(np.append(np.arange(0, count, step), count - 1))


def _grid(scene: Scene, step: int) -> Bools:
    """Every so many pixels of every so many rows, and those at the picture's edges."""
    out = np.zeros((scene.camera.height, scene.camera.width), dtype=bool)
    out[np.ix_(_lines(scene.camera.height, step), _lines(scene.camera.width, step))] = True
    return out.reshape(-1)


def _doubtful(picture: Picture, shapes: NDArray[np.int64], signed: Floats, error: float, step: int) -> Bools:
    """The pixels of squares in which the error may be above `error` where it is not at the corners.

    In a square that sees one shape, with radiances like those of its corners, the error is that of the corners, and
    twice as much more as these and those of the squares around it scatter: a model's kink may lie between. All else is
    doubtful: outlines, edges of shadows, highlights, textures, and squares near the limit.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    rows, columns = _lines(shapes.shape[0], step), _lines(shapes.shape[1], step)
    if rows.size < 2 or columns.size < 2:
        return np.ones(shapes.size, dtype=bool)

    def over(values: NDArray[np.generic], largest: bool) -> Floats:
        pick = np.maximum if largest else np.minimum
        for axis, lines in enumerate((rows, columns)):
            last = values.take(lines[1:], axis=axis)
            values = pick(pick.reduceat(values, lines[:-1], axis=axis), last)
        return np.asarray(values)

    def corners(values: Floats) -> tuple[Floats, Floats]:
        grid = values[np.ix_(rows, columns)]
        four = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]])
        return four.min(axis=0), four.max(axis=0)

    size = (*shapes.shape, -1)
    one_shape = over(maximum_filter(shapes, 3), True) == over(minimum_filter(shapes, 3), False)
    low, high = corners(picture.radiance)
    room = (high - low) + 1e-12 * np.abs(high)
    smooth = (over(picture.radiance, False) >= low - room) & (over(picture.radiance, True) <= high + room)
    smooth &= over(_jumps(picture.radiance), True) <= EDGE * (high - low)
    least, most = corners(signed.reshape(size))
    with np.errstate(invalid="ignore"):
        apart = most - least  # NaN in squares that were sure before
        scatter = maximum_filter(np.where(np.isnan(apart), 0.0, apart), size=(3, 3, 1))
        near = np.maximum(np.abs(least), np.abs(most)) + 2.0 * scatter <= error
    doubt: Bools = ~(one_shape & (smooth & near).all(axis=-1))
    for axis, lines in enumerate((rows, columns)):
        doubt = np.repeat(
            doubt, np.diff(lines, append=lines[-1] + 1)[: lines.size - 1] + (lines[1:] == lines[-1]), axis
        )
    return doubt.reshape(-1)


def _jumps(radiance: Floats) -> Floats:
    """How far each pixel is off the next ones to the right and below, where that is more than `FLAT` of the larger."""
    out = np.zeros_like(radiance)
    for axis in (0, 1):
        a, b = np.moveaxis(radiance, axis, 0)[:-1], np.moveaxis(radiance, axis, 0)[1:]
        jump = np.where(np.abs(a - b) > FLAT * np.maximum(np.abs(a), np.abs(b)), np.abs(a - b), 0.0)
        into = np.moveaxis(out, axis, 0)[:-1]
        np.maximum(into, jump, out=into)
    return out


def _signed(radiance: Floats, true: Floats) -> Floats:
    """Relative errors, at every wavelength; infinite where it should be 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(radiance == true, 0.0, radiance / true - 1.0)


def _off(radiance: Floats, true: Floats) -> Floats:
    """The largest relative error of each pixel."""
    return np.asarray(np.abs(_signed(radiance, true)).max(axis=1))


def _shapes(scene: Scene) -> NDArray[np.int64]:
    """What the ray through the centre of each pixel meets, (height, width)."""
    pixels = np.arange(scene.camera.pixels)
    return scene.world.hit(*scene.camera.rays(pixels, 0, None)).shape.reshape(scene.camera.height, scene.camera.width)


def _with(scene: Scene, materials: dict[str, SceneMaterial] | dict[str, _Recorder]) -> Scene:
    return replace(scene, material=tuple(materials[shape.material] for shape in scene.tables.shape))
