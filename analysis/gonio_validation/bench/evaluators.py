"""Every way of evaluating every quantity: ours, and what they are compared with in this process."""

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from gonio import geometry
from gonio.models import Blinn, CookTorrance, HeTorrance, Lambert, OrenNayar, Phong, engine, fresnel, htsg
from gonio.models._compile import loop
from gonio.models._facets import fresnel_constants
from gonio.typing import Floats
from gonio_validation.bench import naive, specification
from gonio_validation.bench.quantity import (
    BenchQuantity,
    BenchSample,
    Evaluate,
    FresnelValues,
    Inputs,
    ModelValues,
    Parameters,
    Set,
    Way,
    directions,
    reference,
    samples,
    to_angles,
)

EVEN = "directions even over the hemisphere"


def quantities() -> list[BenchQuantity]:
    """Every quantity, with every way that runs in this process (for others see `gonio_validation.bench.peers`)."""
    r = reference()
    return [
        *_he_torrance(),
        _closed(
            "cook-torrance",
            r.cook_torrance,
            "Cook-Torrance",
            "Beckmann facets, two slopes, complex index.",
            _cook,
            specification.cook_torrance,
        ),
        _closed("blinn", r.blinn, "Blinn", "D3 facets over a diffuse base.", lambda p: Blinn(**p), specification.blinn),
        _closed(
            "phong",
            r.phong,
            "Phong",
            "Blinn's form of it, over a diffuse base.",
            lambda p: Phong(**p),
            specification.phong,
        ),
        _lambert(),
        _closed(
            "oren-nayar",
            r.oren_nayar,
            "Oren-Nayar, functional form",
            "Eqs. 14 to 16: how well the formula itself is evaluated.",
            lambda p: OrenNayar(**p),
            specification.oren_nayar,
        ),
        _oren_nayar(),
        _fresnel(),
        _roughness(),
    ]


def _split(parameters: list[Parameters]) -> Callable[[int], Inputs]:
    def timed(count: int) -> Inputs:
        each = max(1, count // len(parameters))
        return [(p, directions(each, seed)) for seed, p in enumerate(parameters, 1)]

    return timed


# --- He-Torrance --------------------------------------------------------------------------------------------------


def he_torrance_model(p: Parameters, **more: Any) -> HeTorrance:
    """The model of a reference sample."""
    return HeTorrance(sigma0_um=p["sigma0_um"], tau_um=p["tau_um"], ior=complex(p["n"], p["k"]), **more)


def _ours(tolerance: float, call: str = "brdf_vectors") -> Callable[[Parameters], Evaluate]:
    def prepare(p: Parameters) -> Evaluate:
        return functools.partial(
            getattr(he_torrance_model(p, tolerance=tolerance), call), wavelength_nm=p["wavelength_nm"]
        )

    return prepare


def _summed(kernel: Any, terms: int = 0, beckmann_from: float = math.inf) -> Callable[[Parameters], Evaluate]:
    def prepare(p: Parameters) -> Evaluate:
        constants = (*he_torrance_model(p)._constants(p["wavelength_nm"]), float(terms), beckmann_from)
        return functools.partial(engine.over_vectors, kernel, constants, split=HeTorrance.grain)

    return prepare


def _mueller(p: Parameters) -> Evaluate:
    model = he_torrance_model(p)
    return lambda *angles: model.mueller(*angles, wavelength_nm=p["wavelength_nm"])[..., 0, 0]


def _he_torrance() -> list[BenchQuantity]:
    one, blocks = naive.from_one, naive.from_one_vectorised
    public = "from m = 1, pair by pair, as public code has it; vectorised: term by term over blocks of pairs"
    ways = (
        *(Way(f"ours, tolerance {t:.0e}".replace("e-0", "e-"), _ours(t), True, stated=t) for t in (1e-12, 1e-9, 1e-6)),
        *(Way(f"{n} terms", _summed(one, n), note=public if n == 10 else "") for n in (10, 40, 64)),
        *(Way(f"{n} terms, vectorised", _summed(blocks, n)) for n in (10, 40, 64)),
        Way(
            "Beckmann from g = 18.5",
            _summed(blocks, 64, naive.BECKMANN_FROM),
            note="exp(−c/g)/g above; 64 terms below, vectorised",
        ),
        Way("windowed sum", _summed(naive.windowed), note="from the largest term to both sides"),
    )
    more = (
        Way("ours, angles", _ours(1e-12, "brdf"), True, "brdf, tolerance 1e-12", to_angles, stated=1e-12),
        Way("ours, Mueller matrix", _mueller, True, "from angles; errors of I → I", to_angles, stated=1e-11),
    )
    common = samples(reference().he_torrance, {"common": "grid"})
    whole = samples(reference().he_torrance, {"whole": "grid", "hard": "hard"})
    about = "The unpolarised lobe with Smith's shadowing; the ways differ in how they sum the series S(g, c). "
    return [
        BenchQuantity(
            "he-torrance common",
            "He-Torrance, common range (g < 90)",
            about + "σ0 = 0.28 µm, τ = 1.77 µm, 500 nm: g up to 49.5.",
            common,
            _split([s.parameters for s in common]),
            EVEN,
            (*ways, *more),
        ),
        BenchQuantity(
            "he-torrance whole",
            "He-Torrance, whole domain",
            about
            + "Seven surfaces, σ0 from 1 nm to 20 µm at 500 nm, g up to 2.5e5; the hard set has g from 1e-12 to 1e8.",
            whole,
            _split([s.parameters for s in whole if s.kind == "grid"]),
            f"seven surfaces in turn, {EVEN}",
            ways,
        ),
    ]


# --- closed forms -------------------------------------------------------------------------------------------------


def _cook(p: Parameters) -> Any:
    return CookTorrance(slopes=p["slopes"], ior=complex(p["n"], p["k"]))


def _over_plain(function: Any) -> Callable[[Parameters], Evaluate]:
    def prepare(p: Parameters) -> Evaluate:
        def evaluate(omega_i: Floats, omega_r: Floats) -> Floats:
            with np.errstate(all="ignore"):
                result: Floats = function(p, omega_i, omega_r)
            return result

        return evaluate

    return prepare


def _vectors_and_angles(build: Callable[[Parameters], Any]) -> tuple[Way, ...]:
    return (
        Way("ours, vectors", lambda p: build(p).brdf_vectors, True, "brdf_vectors", stated=1e-13),
        Way("ours, angles", lambda p: build(p).brdf, True, "brdf", to_angles, stated=1e-13),
    )


def _closed(
    name: str, values: list[ModelValues], title: str, about: str, build: Callable[[Parameters], Any], form: Any
) -> BenchQuantity:
    found = samples(values, {"grid": "grid", "hard": "hard"})
    first = next(s for s in found if s.kind == "grid")
    ways = (
        *_vectors_and_angles(build),
        Way("plain numpy", _over_plain(form), note="the specification, written to be read"),
    )
    return BenchQuantity(name, title, about, found, _split([first.parameters]), EVEN, ways)


def _lambert() -> BenchQuantity:
    grid = samples(reference().cook_torrance, {"grid": "grid"})[0]
    p = {"albedo": 0.5}
    value = np.full(grid.value.shape, 0.5 / math.pi)
    return BenchQuantity(
        "lambert",
        "Lambert",
        "A constant: what reading the arrays, checking them and writing the result cost.",
        (BenchSample("grid", p, grid.arrays, value, 0.0 * value, grid.cases),),
        _split([p]),
        EVEN,
        _vectors_and_angles(lambda p: Lambert(**p)),
    )


def _oren_nayar() -> BenchQuantity:
    r = reference().oren_nayar_exact
    theta_i, theta_r, dphi, sigma, rho, value = (
        np.array(x) for x in (r.theta_i, r.theta_r, r.phi, r.sigma, r.rho, r.value)
    )
    found = []
    for slope, albedo in sorted(set(zip(r.sigma, r.rho, strict=True))):
        here = (sigma == slope) & (rho == albedo)
        source, viewer = geometry.Directions(theta_i[here], 0.0, theta_r[here], dphi[here]).vectors
        p = {"albedo": albedo, "sigma_deg": math.degrees(slope)}
        none, cases = np.zeros(np.count_nonzero(here)), ("",) * int(np.count_nonzero(here))
        found.append(BenchSample("grid", p, (source, viewer), value[here], none, cases))

    def way(form: str, note: str, stated: float | None = None) -> Way:
        return Way(form, lambda p: OrenNayar(**p, form=form).brdf_vectors, True, note, stated=stated)

    return BenchQuantity(
        "oren-nayar exact",
        "Oren-Nayar, against the exact integral",
        "Reference: the V-groove integral with two bounces by quadruple-precision quadrature. For the functional and "
        "the qualitative form the error is that of the approximation, for the exact form that of its quadrature.",
        tuple(found),
        _split([{"albedo": 0.9, "sigma_deg": 30.0}]),
        "albedo 0.9, sigma = 30 degrees, directions even over the hemisphere",
        (
            way("exact", "quadrature over facets", 1e-8),
            way("functional", "model error, eqs. 14 to 16"),
            way("qualitative", "model error, eq. 17"),
        ),
    )


def _over_pairs(kernel: Any, constants: tuple[float, ...], first: Floats) -> Floats:
    out = np.empty(first.size)
    run = loop(htsg.over_pairs, kernel, len(constants))
    engine.in_parts(lambda i, j: run(first, first, constants, out, i, j), first.size)
    return out


def _fresnel() -> BenchQuantity:
    r = reference()

    def over_cosines(values: list[FresnelValues], kind: Set) -> tuple[BenchSample, ...]:
        return tuple(
            BenchSample(
                kind,
                {"n": f.n, "k": f.k},
                (np.array(f.cos),),
                np.array(f.value),
                np.zeros(len(f.cos)),
                tuple(f"{f.name}, cos = {c:g}" for c in f.cos),
            )
            for f in values
        )

    average = complex(1.02, 2.58)

    def kernel(function: Any) -> Callable[[Parameters], Evaluate]:
        def prepare(p: Parameters) -> Evaluate:
            index = complex(p["n"], p["k"])
            f0 = float(fresnel.reflectance(1.0, index))
            mean = float(fresnel.reflectance(1.0, average))
            n = fresnel.n_from_f0(min(mean if function is naive.colour_interpolation else f0, 0.9999999))
            constants = (*fresnel_constants(index), n, f0, mean)
            return lambda c: _over_pairs(function, constants, c)

        return prepare

    return BenchQuantity(
        "fresnel",
        "Fresnel reflectance",
        "Unpolarised, for copper-like (three wavelengths), aluminium-like and glass-like indices, every 5 degrees. "
        "Schlick and the real n know only the normal reflectance; colours go by the copper-like average at 550 nm.",
        over_cosines(r.fresnel, "grid") + over_cosines(r.fresnel_hard, "hard"),
        lambda count: [({"n": 1.02, "k": 2.58}, (np.random.default_rng(1).random(count),))],
        "cosines even in [0, 1], n = 1.02 + 2.58i",
        (
            Way("complex, in a kernel", kernel(naive.fresnel_complex), True, "as in the models", stated=1e-13),
            Way(
                "complex, function",
                lambda p: lambda c: fresnel.reflectance(c, complex(p["n"], p["k"])),
                True,
                "fresnel.reflectance",
                stated=1e-13,
            ),
            Way("real n", kernel(naive.fresnel_real), note="Cook and Torrance's n from F0"),
            Way("Schlick", kernel(naive.schlick), note="Schlick 1994, from F0"),
            Way("colour interpolation", kernel(naive.colour_interpolation), note="from one average reflectance"),
        ),
    )


def _roughness() -> BenchQuantity:
    r = reference().roughness
    k, value = np.array(r.K), np.array(r.value)
    grid = (k >= 1e-4) & (k <= 1e10)

    def over_k(kind: Set, here: Any) -> BenchSample:
        cases = tuple(f"K = {x:.3g}" for x in k[here])
        return BenchSample(kind, {}, (k[here],), value[here], np.zeros(len(cases)), cases)

    def kernel(function: Any, *constants: float) -> Callable[[Parameters], Evaluate]:
        return lambda p: lambda k: _over_pairs(function, (*constants, 0.0), k)

    return BenchQuantity(
        "roughness",
        "Effective roughness",
        "sigma/sigma0 as a function of K = K_i + K_r (eqs. 80 to 82).",
        (over_k("grid", grid), over_k("hard", ~grid & (k < 1e139))),
        lambda count: [({}, (10.0 ** (np.random.default_rng(1).random(count) * 14.0 - 4.0),))],
        "K from 1e-4 to 1e10, even in its logarithm",
        (
            Way("closed form", kernel(naive.closed_roughness), True, "Lambert W, as in the model", stated=1e-15),
            Way(
                "closed form, function",
                lambda p: htsg.effective_roughness,
                True,
                "htsg.effective_roughness",
                stated=1e-15,
            ),
            Way("1 Newton step", kernel(naive.newton_roughness, 1.0), note="from sqrt(ln(1 + K²/8π))"),
            *(Way(f"{n} Newton steps", kernel(naive.newton_roughness, float(n))) for n in range(2, 7)),
        ),
    )
