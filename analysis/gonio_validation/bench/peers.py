"""Other people's programs on the same inputs, where they are installed (extra `[peers]`).

Each peer runs in a process of its own, one after the other, and never in the one that measures our ways: the idle
workers of Dr.Jit and Mitsuba spin and slow down what is measured after them, and both end the whole process where they
find an LLVM that they cannot use. So each first evaluates a few pairs there.
"""

import importlib.util
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from gonio.errors import DataError
from gonio.typing import Floats, JsonObject
from gonio_validation.bench import accuracy, timing
from gonio_validation.bench.evaluators import quantities
from gonio_validation.bench.quantity import (
    ErrorSummary,
    Evaluate,
    Parameters,
    PeerTime,
    Set,
    Way,
    directions,
    to_angles,
)

PACKAGES = {"Dr.Jit": "drjit", "Mitsuba": "mitsuba", "pySCATMECH": "pySCATMECH"}
LLVM = "DRJIT_LIBLLVM_PATH"


@dataclass(frozen=True)
class PeerProgram:
    """A program that was found to work here."""

    name: str
    way: Way
    environment: dict[str, str]
    """What its process needs besides ours."""


@dataclass(frozen=True)
class MeasuredPeer:
    """Errors by set, and times, of a peer: what its process prints as JSON."""

    errors: dict[Set, ErrorSummary]
    time: PeerTime


MEASURED = TypeAdapter(MeasuredPeer)
QUANTITY = "cook-torrance"
"""What the peers evaluate."""


def find() -> tuple[list[JsonObject], list[PeerProgram]]:
    """What was found of each peer, in words, and those that work."""
    words, found = list[JsonObject](), []
    for peer, package in PACKAGES.items():
        if importlib.util.find_spec(package) is None:
            state = "not installed"
        else:
            state, environment = _usable(peer)
            if environment is not None:
                found.append(PeerProgram(peer, _ways()[peer], environment))
        words.append({"peer": f"{peer} {_version(package)}".strip(), "state": state})
    return words, found


def measured(peer: PeerProgram, effort: timing.Effort) -> MeasuredPeer:
    """Measure a peer in a process of its own.

    Raises
    ------
    DataError
        The process failed.
    """
    code = (
        "from gonio_validation.bench import peers; from gonio_validation.bench.timing import Effort; "
        f"peers.report({peer.name!r}, {effort!r})"
    )
    made = process(code, peer.environment, timeout=600)
    if made is None or made.returncode:
        why = "took longer than 600 s" if made is None else (made.stderr.strip().splitlines() or ["no message"])[-1]
        raise DataError(f"{peer.name}: its process failed while it was measured: {why}")
    return MEASURED.validate_json(made.stdout.splitlines()[-1])


def report(peer: str, effort: timing.Effort) -> None:
    """In the peer's own process: measure it, and print errors and times as JSON."""
    way = _ways()[peer]
    quantity = next(q for q in quantities() if q.name == QUANTITY)
    errors = accuracy.by_set(quantity, way)
    taken = timing.times(replace(quantity, ways=(way,)), effort)[way.name]
    print(MEASURED.dump_json(MeasuredPeer(errors, PeerTime(**vars(taken), threads=_threads()))).decode())


def _threads() -> int | None:
    """How many threads this process has now, idle ones included."""
    tasks = Path("/proc/self/task")
    return len(list(tasks.iterdir())) if tasks.is_dir() else None


def _ways() -> dict[str, Way]:
    return {
        "Dr.Jit": Way(
            "Dr.Jit, float64",
            _drjit,
            note="the same formula, LLVM backend, columns already its own, nothing checked",
            convert=_to_drjit,
            peer=True,
        ),
        "Mitsuba": Way(
            "Mitsuba roughconductor, float32",
            _mitsuba,
            note="one slope, Smith's shadowing, times cos θr: time only",
            convert=_to_mitsuba,
            accurate=False,
            peer=True,
        ),
        "pySCATMECH": Way(
            "pySCATMECH",
            _scatmech,
            note="Shadowed_Facet_BRDF_Model, Torrance-Sparrow shadowing; a call a geometry",
            convert=to_angles,
            peer=True,
        ),
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def probe(peer: str) -> None:
    """Evaluate eight pairs; whatever goes wrong ends the process."""
    way = _ways()[peer]
    assert way.convert is not None
    way.prepare({"slopes": [[0.4, 0.4], [0.2, 0.6]], "n": 0.64, "k": 2.6})(*way.convert(*directions(8)))


def _usable(peer: str) -> tuple[str, dict[str, str] | None]:
    """In words: measured, with the LLVM library where one had to be named, or why not; and its environment."""
    for environment in llvm_libraries() if peer != "pySCATMECH" else [{}]:
        if _works(peer, environment):
            with_library = f" with {Path(environment[LLVM]).name}" if environment else ""
            return f"measured, in a process of its own{with_library}", environment
    if peer != "pySCATMECH" and LLVM not in os.environ:
        return f"installed; no LLVM library that it can use was found ({LLVM} can name one)", None
    return "installed, but fails on eight pairs", None


def llvm_libraries() -> Iterator[dict[str, str]]:
    """Environments that may give Dr.Jit an LLVM: what it finds itself, then each library here, the newest first."""
    yield {}
    if LLVM not in os.environ:
        patterns = ("*/libLLVM*.so*", "llvm-*/lib/libLLVM*.so*")
        found = {path.resolve() for pattern in patterns for path in Path("/usr/lib").glob(pattern)}
        for path in sorted(found, key=lambda p: p.name, reverse=True):
            yield {LLVM: str(path)}


def _works(peer: str, environment: dict[str, str]) -> bool:
    made = process(f"from gonio_validation.bench import peers; peers.probe({peer!r})", environment, timeout=120)
    return made is not None and made.returncode == 0


def process(code: str, environment: dict[str, str], timeout: float) -> subprocess.CompletedProcess[str] | None:
    """What became of Python code in a process of its own; None where it took too long."""
    try:
        return subprocess.run(
            [sys.executable, "-P", "-c", code],
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None


def _columns(v: Floats) -> list[Floats]:
    return [np.ascontiguousarray(v[..., k]) for k in range(3)]


def _to_drjit(omega_i: Floats, omega_r: Floats) -> tuple[Any, ...]:
    import drjit as dr
    from drjit.llvm import Float64

    arrays = tuple(Float64(column) for v in (omega_i, omega_r) for column in _columns(v))
    dr.eval(*arrays)
    dr.sync_thread()
    return arrays


def _drjit(p: Parameters) -> Evaluate:
    import drjit as dr

    n = complex(p["n"], p["k"])
    contrast, real, imag = abs(n * n - 1) ** 2, (n * n).real - 1, n.real * n.imag

    def evaluate(lx: Any, ly: Any, lz: Any, vx: Any, vy: Any, vz: Any) -> Any:
        sx, sy, sz = lx + vx, ly + vy, lz + vz
        flat = dr.fma(sx, sx, sy * sy)
        s2 = dr.fma(sz, sz, flat)
        c2 = 0.25 * s2
        tan2 = flat / (sz * sz)
        d = 0.0
        for m, w in p["slopes"]:
            d = d + (w / (m * m)) * dr.exp(tan2 * (-1.0 / (m * m)))
        d = d * dr.square(1.0 + tan2)
        # |F|^2 = R_s X/(X + Y) by q = a + ib, see gonio.models._facets.fresnel
        re = real + c2
        big = dr.sqrt(dr.fma(re, re, 4.0 * imag * imag))
        a = dr.sqrt(0.5 * dr.abs(big + re))
        c = dr.sqrt(c2)
        sin2 = 1.0 - c2
        x = dr.fma(c2, big, sin2 * sin2)
        y = 2.0 * c * a * sin2
        f = contrast * x / (dr.square(c2 + big + 2.0 * c * a) * (x + y))
        scale = 4.0 * sz / s2
        low = scale * dr.select(lz < vz, lz, vz)  # dr.minimum needs LLVM 16
        out = f * d * dr.select(low < 1.0, low, 1.0) / (np.pi * lz * vz)
        dr.eval(out)
        dr.sync_thread()
        return out

    return evaluate


def _to_mitsuba(omega_i: Floats, omega_r: Floats) -> tuple[Any, ...]:
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_mono")
    vectors = tuple(mi.Vector3f(*(column.astype(np.float32) for column in _columns(v))) for v in (omega_i, omega_r))
    dr.eval(*vectors)
    dr.sync_thread()
    return vectors


def _mitsuba(p: Parameters) -> Evaluate:
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_mono")
    slope = p["slopes"][0][0]
    facets = {"type": "roughconductor", "distribution": "beckmann", "alpha": slope, "eta": p["n"], "k": p["k"]}
    bsdf = mi.load_dict(facets)
    context = mi.BSDFContext()

    def evaluate(wi: Any, wo: Any) -> Any:
        surface = dr.zeros(mi.SurfaceInteraction3f, dr.width(wi))
        surface.wi = wi
        out = bsdf.eval(context, surface, wo)
        dr.eval(out)
        dr.sync_thread()
        return out

    return evaluate


def _scatmech(p: Parameters) -> Evaluate:
    from pySCATMECH.brdf import BRDF_Model

    def facets(m: float) -> dict[Any, str]:
        return {None: "Gaussian_Slope_Distribution_Function", "s": repr(m)}

    slopes = p["slopes"]
    two = {None: "Two_Slope_Distribution_Function", "s1": facets(slopes[0][0]), "s2": facets(slopes[-1][0])}
    parameters = {
        "lambda": "0.5",
        "substrate": f"({p['n']!r},{p['k']!r})",
        "stack": "No_StackModel",
        "shadow": "Torrance_Sparrow_Shadow_Function",
        "sdf": two | {"fract": repr(slopes[-1][1])} if len(slopes) == 2 else facets(slopes[0][0]),
    }
    model = BRDF_Model("Shadowed_Facet_BRDF_Model", parameters)

    def evaluate(theta_i: Floats, phi_i: Floats, theta_r: Floats, phi_r: Floats) -> Floats:
        dphi = phi_r - phi_i - math.pi  # 0 in the mirror direction
        points = zip(theta_i.tolist(), theta_r.tolist(), dphi.tolist(), strict=True)
        return 4.0 * np.array([model.BRDF(ti, tr, phi) for ti, tr, phi in points])  # normalised; the 1982 form has 4

    return evaluate
