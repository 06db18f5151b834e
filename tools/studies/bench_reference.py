"""Write the reference values of `gonio bench models`: the papers' formulas in 60 digits, at stated inputs.

    python -m tools.studies.bench_reference

Directions are taken as the exact values of their doubles, brought to unit length in 60 digits. Closed forms are the
papers' as they stand; He-Torrance's series is summed term by term, from its largest term to both sides, by logarithms.
Oren-Nayar's exact integral is taken from tests/reference (quadruple-precision quadrature).
Nothing of the package's own arithmetic enters.
"""

import itertools
import json
import math
from collections.abc import Callable, Sequence
from typing import Any

import mpmath as mp

from gonio.typing import JsonObject
from tests.gonio.models import oracles
from tests.places import ROOT

OUT = ROOT / "analysis" / "gonio_validation" / "bench" / "reference.json"
PI = math.pi
POLAR_I = (0.0, 10.0, 30.0, 45.0, 60.0, 75.0, 85.0)
POLAR_R = (0.0, 20.0, 45.0, 60.0, 80.0)
AZIMUTH = (0.0, 60.0, 120.0, 180.0)
PHI_I = 0.3  # rad: no vector of the grid lies along an axis
GRID = "theta_i 0 10 30 45 60 75 85, theta_r 0 20 45 60 80, dphi 0 60 120 180 degrees"

Pair = tuple[list[float], list[float]]


def attenuation(nl: Any, nv: Any, nh: Any, vh: Any) -> Any:
    return min(mp.mpf(1), 2 * nh * nv / vh, 2 * nh * nl / vh)


def cook_torrance(
    theta_i: Any,
    phi_i: Any,
    theta_r: Any,
    phi_r: Any,
    slopes: Sequence[tuple[float, float]],
    ior: complex,
    distribution: str,
) -> Any:
    """R_s as printed: (F/pi) D G/((N.L)(N.V))."""
    nl, nv, nh, vh = oracles.halfway(theta_i, phi_i, theta_r, phi_r)
    alpha = mp.acos(min(nh, mp.mpf(1)))
    d = mp.mpf(0)
    for m, w in slopes:
        m = mp.mpf(m)
        if distribution == "beckmann":
            d += w * mp.exp(-((mp.tan(alpha) / m) ** 2)) / (m**2 * mp.cos(alpha) ** 4)
        else:
            d += w * mp.exp(-((alpha / m) ** 2))
    return oracles.fresnel(vh, ior) / mp.pi * d * attenuation(nl, nv, nh, vh) / (nl * nv)


def blinn_1977(
    theta_i: Any,
    phi_i: Any,
    theta_r: Any,
    phi_r: Any,
    c: float,
    ior: complex,
    distribution: str,
    k_d: float = 0.0,
    k_s: float = 1.0,
) -> Any:
    """The BRDF (k_d + k_s s/(N.L))/pi with s = D G F/(N.E)."""
    nl, ne, nh, eh = oracles.halfway(theta_i, phi_i, theta_r, phi_r)
    c = mp.mpf(c)
    alpha = mp.acos(min(nh, mp.mpf(1)))
    d = {
        "phong": lambda: nh**c,
        "gaussian": lambda: mp.exp(-((alpha * c) ** 2)),
        "trowbridge-reitz": lambda: (c**2 / (nh**2 * (c**2 - 1) + 1)) ** 2,
    }[distribution]()
    s = d * attenuation(nl, ne, nh, eh) * oracles.fresnel(eh, ior) / ne
    return (k_d + k_s * s / nl) / mp.pi


def oren_nayar(theta_i: Any, phi_i: Any, theta_r: Any, phi_r: Any, albedo: float, sigma: Any) -> Any:
    """Eqs. 14 to 16 over E0 cos(theta_i)."""
    theta_i, theta_r, rho = mp.mpf(theta_i), mp.mpf(theta_r), mp.mpf(albedo)
    s2 = mp.mpf(sigma) ** 2
    alpha, beta = max(theta_i, theta_r), min(theta_i, theta_r)
    cosine = mp.cos(mp.mpf(phi_r) - mp.mpf(phi_i))
    c1 = 1 - s2 / (2 * (s2 + mp.mpf("0.33")))
    c2 = mp.mpf("0.45") * s2 / (s2 + mp.mpf("0.09"))
    c2 *= mp.sin(alpha) - (0 if cosine >= 0 else (2 * beta / mp.pi) ** 3)
    c3 = mp.mpf("0.125") * s2 / (s2 + mp.mpf("0.09")) * (4 * alpha * beta / mp.pi**2) ** 2
    one = c1 + cosine * c2 * mp.tan(beta) + (1 - abs(cosine)) * c3 * mp.tan((alpha + beta) / 2)
    two = mp.mpf("0.17") * rho * s2 / (s2 + mp.mpf("0.13")) * (1 - cosine * (2 * beta / mp.pi) ** 2)
    return rho / mp.pi * (one + two)


def vector(theta: float, phi: float) -> list[float]:
    """A double vector; its last digits are its own, for the reference takes it as it is."""
    return [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]


def grid() -> list[Pair]:
    out = []
    for ti, tr, d in itertools.product(POLAR_I, POLAR_R, AZIMUTH):
        if (ti == 0.0 or tr == 0.0) and d > 0.0:
            continue
        out.append(
            (vector(math.radians(ti), PHI_I), vector(math.radians(tr), PHI_I + math.radians(d))),
        )
    return out


def hard_pairs() -> dict[str, Pair]:
    """The geometries that break formulas, as vectors."""
    a = vector(0.6, 0.4)
    near = math.radians(89.9999)
    return {
        "normal incidence": ([0.0, 0.0, 1.0], vector(0.7, 1.0)),
        "both normal": ([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]),
        "exact mirror": (a, [-a[0], -a[1], a[2]]),
        "1e-9 from the mirror": (a, vector(0.6 + 1e-9, 0.4 + PI)),
        "exact retro": (a, a),
        "1e-9 from retro": (a, vector(0.6 + 1e-9, 0.4)),
        "incidence at 89.9999 degrees": (vector(near, 0.3), vector(0.5, 2.0)),
        "both at 89.9999 degrees, 2 rad apart": (vector(near, 0.3), vector(near, 2.3)),
        "forward grazing, 89.9999 degrees": (vector(near, 0.3), vector(near, 0.3 + PI)),
        "forward grazing, 89 and 88 degrees": (vector(math.radians(89.0), 0.3), vector(math.radians(88.0), 0.29 + PI)),
    }


# --- formulas over vectors ------------------------------------------------------------------------------------------


def angles(v: Any) -> tuple[Any, Any]:
    return mp.atan2(mp.sqrt(v[0] ** 2 + v[1] ** 2), v[2]), mp.atan2(v[1], v[0])


def of_angles(formula: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *c: formula(*angles(c[:3]), *angles(c[3:6]))


def condition(formula: Callable[..., Any], arguments: list[Any]) -> tuple[Any, float]:
    """The value, and the sum over the arguments of |d ln f / d ln argument|, the larger of two sides at kinks."""
    value = formula(*arguments)
    if value == 0:
        return value, 0.0
    total = mp.mpf(0)
    for k, x in enumerate(arguments):
        if x == 0:
            continue
        sides = []
        for sign in (1, -1):
            moved = list(arguments)
            moved[k] = x * (1 + sign * mp.mpf("1e-25"))
            sides.append(abs(formula(*moved) / value - 1) * mp.mpf("1e25"))
        total += max(sides)
    return value, float(total)


def log_series(g: Any, c: Any) -> tuple[Any, Any, Any]:
    """ln S(g, c), and its derivatives by ln g and ln c, term by term from the largest to both sides."""
    u = mp.lambertw(2 * c / g**2).real / 2
    top = max(1, int(mp.nint(g * mp.exp(u))))
    log_top = top * mp.log(g) - g - mp.loggamma(top + 1) - mp.log(top) - c / top
    total, mean, inverse = mp.mpf(1), mp.mpf(top), mp.mpf(1) / top
    for step in (1, -1):
        term, m = mp.mpf(1), top
        while term > 1e-32 and m + step >= 1:
            if step == 1:
                term *= g * m / (m + 1) ** 2 * mp.exp(c / (m * (m + 1)))
            else:
                term *= mp.mpf(m) ** 2 / (g * (m - 1)) * mp.exp(-c / (m * (m - 1)))
            m += step
            total += term
            mean += m * term
            inverse += term / m
    return log_top + mp.log(total), mean / total - g, -c * inverse / total


def he_torrance(pair: Pair, sigma0: float, tau: float, index: complex, wavelength_um: float) -> tuple[float, float]:
    """Eq. 71 with Smith's shadowing, and its condition number by vectors, roughness, correlation length."""

    def parts(*a: Any) -> tuple[Any, Any, Any]:
        """ln of everything but the series, g, c."""
        l, v, s0, t = unit(a[:3]), unit(a[3:6]), a[6], a[7]  # noqa: E741
        k0 = 2 * mp.pi / mp.mpf(wavelength_um)
        h = [x + y for x, y in zip(l, v, strict=True)]
        flat = h[0] ** 2 + h[1] ** 2
        hh = flat + h[2] ** 2
        shadow, k = mp.mpf(1), mp.mpf(0)
        for z in (l, v):
            s = mp.sqrt(z[0] ** 2 + z[1] ** 2)
            if s > 0:
                x = t * z[2] / s / (2 * s0)
                shadow *= (1 - mp.erfc(x) / 2) / (1 + (mp.exp(-(x**2)) / (mp.sqrt(mp.pi) * x) - mp.erfc(x)) / 2)
                k += s / z[2] * mp.erfc(x)
        narrowing = 1 / (1 + mp.lambertw(k**2 / (8 * mp.pi)).real)
        g = k0**2 * s0**2 * narrowing * h[2] ** 2
        c = k0**2 * flat * t**2 / 4
        geometric = (hh / h[2]) ** 2
        front = oracles.fresnel(mp.sqrt(hh) / 2, index) / mp.pi * geometric * shadow * k0**2 * t**2 / 16 / (l[2] * v[2])
        return mp.log(front), g, c

    arguments = [mp.mpf(x) for x in (*pair[0], *pair[1], sigma0, tau)]
    front, g, c = parts(*arguments)
    series, by_g, by_c = log_series(g, c)
    total = mp.mpf(0)
    for k, x in enumerate(arguments):
        if x == 0:
            continue
        sides = []
        for sign in (1, -1):
            moved = list(arguments)
            moved[k] = x * (1 + sign * mp.mpf("1e-25"))
            front_1, g_1, c_1 = parts(*moved)
            change = front_1 - front + by_g * (g_1 / g - 1) + (by_c * (c_1 / c - 1) if c > 0 else 0)
            sides.append(abs(change) * mp.mpf("1e25"))
        total += max(sides)
    return float(mp.exp(front + series)), float(total + abs(by_g) + abs(by_c))


def unit(v: Any) -> list[Any]:
    length = mp.sqrt(sum(x * x for x in v))
    return [x / length for x in v]


# --- the sets -------------------------------------------------------------------------------------------------------


def surface(sigma0: float, tau: float, index: complex, wavelength_nm: float) -> JsonObject:
    return {"sigma0_um": sigma0, "tau_um": tau, "n": index.real, "k": index.imag, "wavelength_nm": wavelength_nm}


def group(kind: str, parameters: JsonObject, labelled: dict[str, Pair], values: list[tuple[float, float]]) -> Any:
    return {
        "set": kind,
        "parameters": parameters,
        "cases": list(labelled),
        "omega_i": [p[0] for p in labelled.values()],
        "omega_r": [p[1] for p in labelled.values()],
        "value": [float(v) for v, _ in values],
        "condition": [round(c, 3) for _, c in values],
    }


def htsg() -> list[Any]:
    metal, glass = 0.77 + 6.08j, complex(1.5)
    plain = {str(j): p for j, p in enumerate(grid())}
    thinned = {str(j): p for j, p in enumerate(grid()[::4])}
    out = []

    def add(kind: str, labelled: dict[str, Pair], s0: float, tau: float, index: complex, wave: float = 500.0) -> None:
        values = [he_torrance(p, s0, tau, index, wave / 1000.0) for p in labelled.values()]
        out.append(group(kind, surface(s0, tau, index, wave), labelled, values))
        print("he-torrance", kind, s0, tau, len(labelled), flush=True)

    add("common", plain, 0.28, 1.77, metal)
    for s0, tau in ((0.001, 1.0), (0.02, 1.0), (0.1, 1.0), (0.28, 1.77), (0.6, 5.0), (2.0, 10.0), (20.0, 100.0)):
        add("whole", thinned, s0, tau, metal)
    hard = hard_pairs()
    add("hard", hard, 0.28, 1.77, metal)
    add("hard", {f"{k}, glass": p for k, p in hard.items()}, 2.0, 10.0, glass)
    mirror = hard["exact mirror"]
    off = (vector(0.6, 0.4), vector(0.5, 0.4 + PI + 0.02))
    wide = (vector(0.6, 0.4), vector(0.9, 2.0))
    add("hard", {"g near 1e-12, at the mirror": mirror, "g near 1e-12": off}, 4e-8, 1.0, metal)
    add("hard", {"g near 1e-6": off}, 4e-5, 1.0, metal)
    add("hard", {"g near 1e8, at the mirror": mirror, "g near 1e8": off}, 480.0, 4000.0, metal)
    add("hard", {"g near 1e4, far from the mirror": wide}, 4.8, 40.0, metal)
    add("hard", {"c near 1e10": off}, 50.0, 8e4, metal)
    add(
        "hard",
        {"tau/lambda = 1e4": off, "tau/lambda = 1e4, 1e-9 from the mirror": hard["1e-9 from the mirror"]},
        40.0,
        5e3,
        metal,
    )
    add("hard", {"k = 1e-12": off}, 0.28, 1.77, 1.5 + 1e-12j)
    add("hard", {"k = 0": off}, 0.28, 1.77, glass)
    add(
        "hard",
        {"n < 1 beyond the critical angle": (vector(1.2, 0.4), vector(1.1, 0.5 + PI))},
        0.28,
        1.77,
        complex(0.6667),
    )
    return out


def cook(p: JsonObject) -> Any:
    return lambda i, p_i, r, p_r: cook_torrance(i, p_i, r, p_r, p["slopes"], complex(p["n"], p["k"]), "beckmann")


def blinn(p: JsonObject) -> Any:
    return lambda i, p_i, r, p_r: blinn_1977(
        i, p_i, r, p_r, p["c"], p["ior"], p["distribution"], mp.mpf(p["k_d"]), mp.mpf(p["k_s"])
    )


def phong(p: JsonObject) -> Any:
    def formula(*a: Any) -> Any:
        nl, _, nh, _ = oracles.halfway(*a)
        return (mp.mpf(p["k_d"]) + mp.mpf(p["k_s"]) * nh ** mp.mpf(p["exponent"]) / nl) / mp.pi

    return formula


def oren(p: JsonObject) -> Any:
    return lambda i, p_i, r, p_r: oren_nayar(i, p_i, r, p_r, p["albedo"], mp.mpf(p["sigma_deg"]) * mp.pi / 180)


def closed() -> dict[str, list[Any]]:
    metal = 0.64 + 2.6j
    plain = {str(j): p for j, p in enumerate(grid())}
    hard = hard_pairs()

    def groups(make: Callable[..., Any], sets: list[tuple[str, JsonObject]]) -> list[Any]:
        out = []
        for kind, parameters in sets:
            labelled = plain if kind == "grid" else hard
            formula = of_angles(make(parameters))
            values = [condition(formula, [mp.mpf(x) for x in (*p[0], *p[1])]) for p in labelled.values()]
            out.append(group(kind, parameters, labelled, values))
        return out

    copper = {"slopes": [[0.4, 0.4], [0.2, 0.6]], "n": metal.real, "k": metal.imag}
    out = {
        "cook-torrance": groups(
            cook,
            [
                ("grid", copper),
                ("hard", copper),
                ("hard", {"slopes": [[1e-3, 1.0]], "n": 1.5, "k": 0.0}),
                ("hard", {"slopes": [[0.3, 1.0]], "n": 0.6667, "k": 1e-12}),
                ("hard", {"slopes": [[0.3, 1.0]], "n": 1.000000001, "k": 0.0}),
            ],
        ),
        "blinn": groups(
            blinn,
            [
                (kind, {"k_d": 0.6, "k_s": 0.4, "ior": ior, "distribution": d, "c": c})
                for kind, ior, d, c in (
                    ("grid", 200.0, "trowbridge-reitz", 0.5),
                    ("hard", 200.0, "trowbridge-reitz", 0.5),
                    ("hard", 1.8, "trowbridge-reitz", 1.0),
                    ("hard", 1.8, "trowbridge-reitz", 1e-3),
                    ("hard", 0.6667, "gaussian", 5.0),
                    ("hard", 1.8, "phong", 50.0),
                )
            ],
        ),
        "phong": groups(phong, [(k, {"k_d": 0.5, "k_s": 0.5, "exponent": 50.0}) for k in ("grid", "hard")]),
        "oren-nayar": groups(
            oren,
            [("grid", {"albedo": 0.9, "sigma_deg": 30.0})]
            + [("hard", {"albedo": 0.7, "sigma_deg": s}) for s in (1e-6, 30.0, 60.0)],
        ),
    }
    print({k: len(v) for k, v in out.items()}, flush=True)
    return out


def small() -> JsonObject:
    indices = {
        "copper-like, 450 nm": 1.17 + 2.40j,
        "copper-like, 550 nm": 1.02 + 2.58j,
        "copper-like, 650 nm": 0.21 + 3.67j,
        "aluminium-like": 0.77 + 6.08j,
        "glass": 1.5 + 0j,
    }
    cosines = [0.0, 1e-6, 1e-3] + [math.cos(math.radians(a)) for a in range(85, 0, -5)] + [1.0]
    fresnel = [
        {
            "name": name,
            "n": n.real,
            "k": n.imag,
            "cos": cosines,
            "value": [float(oracles.fresnel(mp.mpf(c), n)) for c in cosines],
        }
        for name, n in indices.items()
    ]
    tight = [0.6667 + 0j, 0.6667 + 1e-12j, 1.5 + 1e-12j, 1.000000001 + 0j]
    fresnel_hard = [
        {
            "name": f"{n}",
            "n": n.real,
            "k": n.imag,
            "cos": cosines,
            "value": [float(oracles.fresnel(mp.mpf(c), n)) for c in cosines],
        }
        for n in tight
    ]
    ks = [10.0 ** (j / 4) for j in range(-16, 41)] + [1e-30, 1e60, 1e150]
    rough = [float(1 / mp.sqrt(1 + mp.lambertw(mp.mpf(k) ** 2 / (8 * mp.pi)).real)) for k in ks]
    pairs = [
        (g, c)
        for g in (1e-12, 1e-6, 1e-2, 0.7, 5.0, 18.5, 40.0, 90.0, 800.0, 1e4, 1e6, 1e8)
        for c in (0.0, 1e-3, 1.0, 30.0, 1e3, 1e6, 1e10)
    ]
    series = [log_series(mp.mpf(g), mp.mpf(c)) for g, c in pairs]
    exact = json.loads((ROOT / "tests" / "reference" / "oren_nayar_exact_public.json").read_text(encoding="utf-8"))
    return {
        "fresnel": fresnel,
        "fresnel_hard": fresnel_hard,
        "roughness": {"K": ks, "value": rough},
        "series": {
            "g": [g for g, _ in pairs],
            "c": [c for _, c in pairs],
            "ln_S": [float(s) for s, _, _ in series],
            "condition": [float(abs(a) + abs(b)) for _, a, b in series],
        },
        "oren-nayar exact": {
            "source": exact["meta"]["method"],
            **{key: [c["in"][key] for c in exact["cases"]] for key in ("theta_i", "theta_r", "phi", "sigma", "rho")},
            "value": [float(c["out"]["f_r"]) for c in exact["cases"]],
        },
    }


def main() -> None:
    mp.mp.dps = 60
    made = {
        "made_by": "tools/studies/bench_reference.py",
        "with": f"mpmath {mp.__version__}, {mp.mp.dps} digits; values rounded to doubles",
        "grid": GRID,
        "condition": "sum of |d ln f / d ln x| over the components of both vectors (He-Torrance: and σ0, τ)",
        "he-torrance": htsg(),
        **closed(),
        **small(),
    }
    OUT.write_text(json.dumps(made, separators=(",", ":")).replace('{"set"', '\n{"set"') + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
