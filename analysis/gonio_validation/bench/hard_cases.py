"""The hard cases: expected and achieved digits, and whether anything came out that must not."""

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from gonio.models import Blinn, CookTorrance, HeTorrance, Lambert, Model, OrenNayar, Phong, fresnel, htsg
from gonio.typing import JsonObject
from gonio_validation.bench.accuracy import NOTHING
from gonio_validation.bench.quantity import BenchQuantity, BenchSample, directions, reference

EXACT = 16.0
"""Digits where results are identical."""
DIGITS = {
    "he-torrance whole": 12.0,
    "cook-torrance": 13.0,
    "blinn": 13.0,
    "phong": 13.0,
    "oren-nayar": 13.0,
    "fresnel": 13.0,
}
SINGLE = 4.5
"""Digits of float32 results: 2.5e-5 of Cook-Torrance, less of the others (docs/reference/models_evaluation.md)."""
SMALL_IN_SINGLE = 1e-25
"""1/sr: what docs/reference/models_evaluation.md states of float32 holds above it."""


@dataclass
class _Case:
    models: set[str] = field(default_factory=set)
    points: int = 0
    spare: float = math.inf
    expected: float = math.nan
    achieved: float = math.nan
    nan: int = 0
    infinite: int = 0
    negative: int = 0
    warned: bool = False
    note: str = ""

    def add(self, model: str, got: Any, expected: Any, condition: Any, digits: float, warned: bool = False) -> None:
        got, expected = np.atleast_1d(np.asarray(got, float)), np.atleast_1d(np.asarray(expected, float))
        got, expected = np.broadcast_arrays(got, expected)
        self.models.add(model)
        self.points += got.size
        self.nan += int(np.sum(np.isnan(got)))
        self.infinite += int(np.sum(np.isinf(got) & ~np.isinf(expected)))
        self.negative += int(np.sum((got < 0.0) & (expected >= 0.0)))
        self.warned |= warned
        with np.errstate(all="ignore"):
            error = np.abs(got - expected) / np.abs(expected) / (1.0 + condition)
            nothing = np.abs(expected) < NOTHING
            error[nothing] = np.where(np.abs(got[nothing]) < 1e10 * NOTHING, 0.0, 1.0)
            error[got == expected] = 0.0  # infinities too
            error[~np.isfinite(error)] = 1.0
            worst = float(np.max(error)) if error.size else 0.0
        achieved = EXACT if worst <= 10.0**-EXACT else -math.log10(worst)
        if not achieved - digits >= self.spare:
            self.spare, self.expected, self.achieved = achieved - digits, digits, achieved

    def summary(self, name: str) -> JsonObject:
        """Digits at the point with the least to spare, and what must not come out."""
        good = self.spare >= 0.0 and not (self.nan or self.infinite or self.negative or self.warned)
        return {
            "case": name,
            "models": sorted(self.models),
            "points": self.points,
            "expected_digits": self.expected,
            "achieved_digits": round(self.achieved, 1),
            "nan": self.nan,
            "infinite": self.infinite,
            "negative": self.negative,
            "warning": self.warned,
            "holds": good,
            "note": self.note,
        }


def judged(found: list[BenchQuantity], huge: int) -> list[JsonObject]:
    """Every hard case.

    Parameters
    ----------
    found
        The quantities, whose hard samples are run through our way of evaluating them.
    huge
        How many pairs a huge array has.
    """
    cases: dict[str, _Case] = {}
    for quantity in found:
        if quantity.name not in DIGITS:
            continue
        way = quantity.ways[0]
        for s in quantity.samples:
            if s.kind == "hard":
                got, warned = _quietly(partial(way.prepare(s.parameters), *s.arrays))
                model, digits = quantity.name.split()[0], DIGITS[quantity.name]
                for name, here in _named(quantity.name, s):
                    case = cases.setdefault(name, _Case())
                    case.add(model, got[here], s.value[here], s.condition[here], digits, warned)
    _series(cases)
    _limits(cases)
    _arrays(cases, huge)
    return [case.summary(name) for name, case in cases.items()]


def _named(quantity: str, s: BenchSample) -> Iterable[tuple[str, Any]]:
    """Names of cases, and which points of the sample belong to them."""
    if quantity == "fresnel":
        n, k = s.parameters["n"], s.parameters["k"]
        yield f"Fresnel at n = {n:.10g}" + (f", k = {k:g}" if k else ", k = 0"), slice(None)
        return
    for j, label in enumerate(s.cases):
        yield label.removesuffix(", glass"), [j]
    p = s.parameters
    if p.get("c") == 1.0:
        yield "c3 = 1", slice(None)
    if p.get("slopes") == [[1e-3, 1.0]]:
        yield "m = 1e-3", slice(None)
    if p.get("n") == 1.000000001:
        yield "n = 1 + 1e-9", slice(None)
    if "sigma_deg" in p and p["sigma_deg"] != 30.0:
        yield f"Oren-Nayar, sigma = {p['sigma_deg']:g} degrees", slice(None)


def _quietly(work: Callable[[], Any]) -> tuple[Any, bool]:
    """The result, and whether there was a warning."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = work()
    return result, bool(caught)


def _series(cases: dict[str, _Case]) -> None:
    r = reference().series
    g, c, ln_s, condition = (np.array(x) for x in (r.g, r.c, r.ln_S, r.condition))
    got, warned = _quietly(lambda: htsg.log_series(g, c))
    for value in sorted(set(r.g)):
        here = g == value
        # an error of ln S is a relative one of S
        case = cases.setdefault(f"series, g = {value:g}, c from 0 to 1e10", _Case())
        case.add("he-torrance", 1.0 + (got - ln_s)[here], 1.0, condition[here], 13.0, warned)


def _limits(cases: dict[str, _Case]) -> None:
    half = math.pi / 2
    theta = np.radians(np.arange(85, 0, -5))

    def add(name: str, model: str, work: Callable[[], Any], expected: Any, digits: float, note: str = "") -> None:
        got, warned = _quietly(work)
        case = cases.setdefault(name, _Case())
        case.add(model, got, expected, 0.0, digits, warned)
        case.note = note or case.note

    smooth = HeTorrance(sigma0_um=0.0)
    metal = next(f for f in reference().fresnel if f.name == "aluminium-like")
    spike = "lobe 0, spike that of the smooth surface"
    add("sigma0 = 0", "he-torrance", partial(smooth.brdf, theta, 0.0, theta, math.pi), 0.0, EXACT)
    add("sigma0 = 0", "he-torrance", partial(smooth.specular_reflectivity, theta), metal.value[3:-1], 12.0, spike)

    off, at = "exactly 90 degrees, off the mirror", "exactly 90 degrees, at the mirror"
    model: Model
    for model in (Lambert(), CookTorrance(), Blinn(), OrenNayar(), OrenNayar(form="qualitative")):
        near = float(model.brdf(half - 1e-9, 0.0, 0.4, 1.0))
        grazing = partial(model.brdf, half, 0.0, 0.4, 1.0)
        add(off, model.name, grazing, near, 6.0, "against 1e-9 rad before it; He-Torrance: 0")
    for model in (CookTorrance(), Blinn(), Phong()):
        forward = partial(model.brdf, half, 0.0, half, math.pi)
        add(at, model.name, forward, np.inf, EXACT, "the formula's limit is infinite; He-Torrance: 0")
    add(off, "he-torrance", partial(HeTorrance().brdf, half, 0.0, 0.4, 1.0), 0.0, EXACT)
    add(at, "he-torrance", partial(HeTorrance().brdf, half, 0.0, half, math.pi), 0.0, EXACT)

    for model in (CookTorrance(ior=1.0), HeTorrance(ior=1.0)):
        add("n = 1", model.name, partial(model.brdf, theta, 0.0, 0.3, 2.0), 0.0, EXACT, "nothing is reflected")
    clear = CookTorrance(ior=1.5).brdf(theta, 0.0, 0.3, 2.0)
    lossy = partial(CookTorrance(ior=1.5 + 1e-14j).brdf, theta, 0.0, 0.3, 2.0)
    add("k = 0 against k = 1e-14", "cook-torrance", lossy, clear, 13.0)
    source, mirror = np.array([math.sin(0.5), 0.0, math.cos(0.5)]), np.array([-math.sin(0.5), 0.0, math.cos(0.5)])
    peak = fresnel.reflectance(math.cos(0.5), 1.5) / (math.pi * 1e-24 * math.cos(0.5) ** 2)
    narrow = partial(CookTorrance(slopes=1e-12, ior=1.5).brdf_vectors, source, mirror)
    add("m = 1e-12, at the mirror", "cook-torrance", narrow, peak, 13.0, "F/(π m² cos²)")
    flat = partial(OrenNayar(0.8, 1e-7, "exact").brdf, theta, 0.0, 0.3, 2.0)
    add("sigma = 1e-7 degrees", "oren-nayar", flat, 0.8 / math.pi, 8.0, "exact form, against Lambert")


def _arrays(cases: dict[str, _Case], huge: int) -> None:
    source, viewer = directions(1000)
    many = directions(huge)

    def add(name: str, model: Model, arrays: tuple[Any, Any], expected: Any) -> None:
        got, warned = _quietly(partial(model.brdf_vectors, *arrays))
        cases.setdefault(name, _Case()).add(model.name, got, expected, 0.0, EXACT, warned)

    for model in (Lambert(), Phong(), Blinn(), CookTorrance(), OrenNayar(), HeTorrance()):
        whole = model.brdf_vectors(source, viewer)
        single = source.astype(np.float32), viewer.astype(np.float32)
        exact = np.asarray(model.brdf_vectors(*(a.astype(float) for a in single)))
        found, warned = _quietly(partial(model.brdf_vectors, *single))
        far = exact < SMALL_IN_SINGLE
        found, exact = np.where(far & (found < 10.0 * SMALL_IN_SINGLE), 0.0, found), np.where(far, 0.0, exact)
        cases.setdefault("float32 input", _Case()).add(model.name, found, exact, 0.0, SINGLE, warned)
        add("empty arrays", model, (source[:0], viewer[:0]), np.empty(0))
        locked = source.copy(), viewer.copy()
        for a in locked:
            a.flags.writeable = False
        add("read-only arrays", model, locked, whole)
        strided = np.repeat(source, 2, axis=0)[::2], np.asfortranarray(viewer)
        add("arrays that are not contiguous", model, strided, whole)
        pieces = [slice(i, i + 100_000) for i in range(0, huge, 100_000)]
        add("huge arrays", model, many, np.concatenate([model.brdf_vectors(many[0][i], many[1][i]) for i in pieces]))
    cases["huge arrays"].note = f"{huge:,} pairs against pieces of 100 000".replace(",", " ")
