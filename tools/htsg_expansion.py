"""Writes gonio/models/_htsg_expansion.py: the polynomials behind the fast HTSG series, from 50-digit arithmetic.

    python tools/htsg_expansion.py

The series is S(g, c) = sum over m >= 1 of exp(-g) g^m / (m! m) exp(-c/m) (He 1991 eq. 78). Its largest term lies at
m0 = g exp(u), 2u = W0(2c/g^2). With p = 1/(1 + 2u), Stirling's and Laplace's expansions about it give

    S = exp(phi) sqrt(p)/m0 (1 + A_1(p)/m0 + A_2(p)/m0^2 + ...),   phi = m0 (1 - u) - g - c/m0.

The sum over k up to the smallest term is fitted in 1/m0 and p by Chebyshev polynomials, one set for each range of m0
and each tolerance, and written as unrolled Horner forms, which a compiler turns into straight vector code.
"""

from __future__ import annotations

import math
from pathlib import Path

import mpmath as mp
import numpy as np

OUT = Path(__file__).resolve().parents[1] / "gonio" / "models" / "_htsg_expansion.py"
ORDERS = 32
P_NODES = 44
X_NODES = 14
# name, smallest m0, largest m0, largest absolute error of the fit
RANGES = [
    ("full_40_to_120", 40, 120, 3e-14),
    ("full_120_to_1536", 120, 1536, 1e-14),
    ("full_from_1536", 1536, None, 1e-14),
    ("nano_28_to_160", 28, 160, 2e-10),
    ("nano_from_160", 160, None, 1e-10),
    ("micro_18_to_104", 18, 104, 2e-7),
    ("micro_from_104", 104, None, 1e-7),
]
TERMS = (6, 8, 10, 12, 14, 16, 20, 24, 28, 32, 36, 40, 48, 56, 64, 72, 80, 88, 96, 104)
TERM_TOLERANCES = {"full": 1e-14, "nano": 1e-10, "micro": 1e-7}


def laplace_coefficients(p: mp.mpf, orders: int) -> list[mp.mpf]:
    """A_1(p) ... A_orders(p), with m = m0 (1 + t), t = sqrt(p/m0) s and s standard normal."""
    n_max = 2 * orders
    q = mp.sqrt(p)
    exponent: list[dict[int, mp.mpf]] = [{} for _ in range(n_max + 1)]  # by powers of m0^(-1/2), then of s
    for n in range(1, n_max + 1):
        j = n + 2  # phi_j t^j with phi_j = (-1)^(j+1) (1/(j (j-1)) + u) and u = (1/p - 1)/2
        sign = -1 if j % 2 == 0 else 1
        exponent[n][j] = sign * (q**j * (mp.mpf(1) / (j * (j - 1)) - mp.mpf(1) / 2) + q ** (j - 2) / 2)
        exponent[n][n] = exponent[n].get(n, 0) - mp.mpf(3) / 2 * (-1) ** (n + 1) / n * q**n  # m^(-3/2)
    for j in range(1, orders + 1):  # Stirling's series of ln m!
        term = -mp.bernoulli(2 * j) / (2 * j * (2 * j - 1))
        start = 2 * (2 * j - 1)
        for i in range(n_max - start + 1):
            exponent[start + i][i] = exponent[start + i].get(i, 0) + term * q**i
            term *= mp.mpf(1 - 2 * j - i) / (i + 1)
    series = [[mp.mpf(1)]] + [[mp.mpf(0)] * (3 * n + 1) for n in range(1, n_max + 1)]
    for n in range(1, n_max + 1):  # n E_n = sum_k k c_k E_(n-k), for E = exp(c)
        row = series[n]
        for k in range(1, n + 1):
            for power, value in exponent[k].items():
                for i, earlier in enumerate(series[n - k]):
                    if earlier:
                        row[i + power] += k * value * earlier
        series[n] = [value / n for value in row]
    moments = [mp.mpf(1)]
    for i in range(1, 3 * orders + 1):
        moments.append(moments[-1] * (2 * i - 1))
    return [sum(series[2 * k][2 * i] * moments[i] for i in range(3 * k + 1)) for k in range(1, orders + 1)]


def chebyshev_nodes(n: int) -> list[mp.mpf]:
    return [mp.cos(mp.pi * (2 * i + 1) / (2 * n)) for i in range(n)]


def chebyshev_transform(n: int) -> list[list[mp.mpf]]:
    """Rows: weights of the node values in each Chebyshev coefficient."""
    return [[mp.cos(mp.pi * a * (2 * i + 1) / (2 * n)) * (2 if a else 1) / n for i in range(n)] for a in range(n)]


def power_coefficients(chebyshev: list[mp.mpf]) -> list[mp.mpf]:
    """The same polynomial by powers, lowest first."""
    before, here = [mp.mpf(1)], [mp.mpf(0), mp.mpf(1)]
    out = [mp.mpf(0)] * max(2, len(chebyshev))
    for n, value in enumerate(chebyshev):
        basis = before if n == 0 else here
        for i, coefficient in enumerate(basis):
            out[i] += value * coefficient
        if n:
            following = [mp.mpf(0)] + [2 * b for b in here]
            for i, b in enumerate(before):
                following[i] -= b
            before, here = here, following
    return out[: len(chebyshev)]


def fit_chebyshev(function, n: int, tolerance: float) -> list[mp.mpf]:
    """Powers of t in [-1, 1], truncated where the Chebyshev coefficients fall below the tolerance."""
    values = [function(t) for t in chebyshev_nodes(n)]
    coefficients = [sum(w * v for w, v in zip(row, values, strict=True)) for row in chebyshev_transform(n)]
    keep = max(i for i, value in enumerate(coefficients) if abs(value) > tolerance) + 1
    return power_coefficients(coefficients[:keep])


def fit_range(
    table: list[list[mp.mpf]], low: int, high: int | None, tolerance: float
) -> tuple[list[list[mp.mpf]], mp.mpf, mp.mpf]:
    """Rows of powers of 2p - 1 for each power of the scaled 1/m0; its centre and half-width."""
    x_low, x_high = (mp.mpf(1) / high if high else mp.mpf(0)), mp.mpf(1) / low
    centre, half = (x_low + x_high) / 2, (x_high - x_low) / 2
    orders = min(ORDERS, low - 2)
    values = [
        [sum(row[k] * (centre + half * t) ** k for k in range(orders)) for row in table]
        for t in chebyshev_nodes(X_NODES)
    ]
    in_p = chebyshev_transform(P_NODES)
    in_x = chebyshev_transform(X_NODES)
    partial = [[sum(w * v for w, v in zip(row, line, strict=True)) for row in in_p] for line in values]
    two = [[sum(in_x[a][i] * partial[i][b] for i in range(X_NODES)) for b in range(P_NODES)] for a in range(X_NODES)]
    kept = []
    for line in two:
        large = [b for b, value in enumerate(line) if abs(value) * x_high > tolerance / 12]
        if not large:
            break
        kept.append(line[: max(large) + 1])
    by_p = [power_coefficients(line) for line in kept]
    width = max(len(line) for line in by_p)
    columns = [power_coefficients([line[b] if b < len(line) else mp.mpf(0) for line in by_p]) for b in range(width)]
    rows = [[columns[b][a] for b in range(width)] for a in range(len(by_p))]
    for row in rows:
        while len(row) > 1 and row[-1] == 0:
            row.pop()
    return rows, centre, half


def horner(coefficients: list[mp.mpf], variable: str) -> str:
    text = repr(float(coefficients[-1]))
    for value in reversed(coefficients[:-1]):
        text = f"{float(value)!r} + {variable} * ({text})"
    return text


def series_limit(terms: int, tolerance: float) -> float:
    """The largest m0 for which the terms past `terms` are below `tolerance` of the sum, whatever p is."""

    def tail(m0: float, u: float) -> float:
        g, c = m0 * math.exp(-u), u * m0 * m0
        m = np.arange(1, terms + 400)
        log_terms = m * math.log(g) - np.array([math.lgamma(i + 1) for i in m]) - np.log(m) - c / m
        part = np.exp(log_terms - log_terms.max())
        return float(part[terms:].sum() / part.sum())

    low, high = 1e-3, float(terms)
    while high / low > 1.001:
        middle = math.sqrt(low * high)
        if max(tail(middle, u) for u in (0.0, 0.1, 0.5, 1.0, 2.0, 4.0, 10.0, 20.0, 40.0)) < tolerance:
            low = middle
        else:
            high = middle
    return low


def lambert_start(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Powers 1..degree of numerator and denominator of W0(e^y - 1)/y for y in [0, 90] (Sanathanan and Koerner)."""
    y = np.concatenate([np.linspace(1e-6, 1, 200), np.linspace(1, 10, 400), np.geomspace(10, 90, 300)])
    ratio = np.array([float(mp.lambertw(mp.expm1(v)).real / v) for v in y])
    powers = y[:, None] ** np.arange(1, degree + 1)
    weight = np.ones_like(y)
    for _ in range(60):
        matrix = np.hstack([powers, -ratio[:, None] * powers]) * (weight / ratio)[:, None]
        found = np.linalg.lstsq(matrix, (ratio - 1.0) * weight / ratio, rcond=None)[0]
        weight = 1.0 / np.abs(1.0 + powers @ found[degree:])
    return found[:degree], found[degree:]


def elementary() -> list[str]:
    """The functions of one variable that the kernels need beside those of gonio.models._math."""
    top, k = mp.mpf("6.5"), mp.mpf(3)
    t_top = (top - k) / (top + k)

    def scaled_erfcx(s: mp.mpf) -> mp.mpf:
        t = -1 + (t_top + 1) * (s + 1) / 2
        h = k * (1 + t) / (1 - t)
        return (1 + 2 * h) * mp.exp(h * h) * mp.erfc(h)

    middle, half = 3 * mp.sqrt(2) / 4 - 1, mp.sqrt(2) / 4  # of the interval from sqrt(1/2) - 1 to sqrt(2) - 1
    erfcx = fit_chebyshev(scaled_erfcx, 40, 1e-17)
    log_powers = fit_chebyshev(lambda s: mp.log1p(middle + half * s) / (middle + half * s), 24, 4e-6)
    above, below = lambert_start(4)
    lines = [
        "",
        "",
        "@device",
        "def scaled_erfcx(t):",
        '    """(1 + 2h) exp(h^2) erfc(h) for t = (h - 3)/(h + 3), 0 <= h <= 6.5, within 3e-16 of itself."""',
        f"    s = (t + 1.0) * {float(2 / (t_top + 1))!r} - 1.0",
        f"    return {horner(erfcx, 's')}",
        "",
        "",
        "@device",
        "def rough_log1p(f):",
        '    """ln(1 + f) for f in [sqrt(1/2) - 1, sqrt(2) - 1], within 1e-5 of itself."""',
        f"    s = (f - {float(middle)!r}) * {float(1 / half)!r}",
        f"    return f * ({horner(log_powers, 's')})",
        "",
        "",
        "@device",
        "def lambert_start(y):",
        '    """Numerator and denominator of W0(e^y - 1)/y, within 1e-4 for y in [0, 90]."""',
        f"    above = {horner([mp.mpf(1), *above], 'y')}",
        f"    return above, {horner([mp.mpf(1), *below], 'y')}",
    ]
    for name, tolerance in (("full", 1e-17), ("micro", 3e-9)):
        powers = fit_chebyshev(lambda s: mp.mpf(2) ** (s / 2), 24, tolerance)
        powers = [value * 2**i for i, value in enumerate(powers)]
        lines += [
            "",
            "",
            "@device",
            f"def exp2_{name}(f):",
            f'    """2^f for f in [-1/2, 1/2], within {10 * tolerance:g} of itself."""',
            f"    return {horner(powers, 'f')}",
        ]
    return lines


def main() -> None:
    mp.mp.dps = 50
    nodes = [(1 + t) / 2 for t in chebyshev_nodes(P_NODES)]
    table = [laplace_coefficients(p, ORDERS) for p in nodes]
    lines = [
        '"""Polynomials of the HTSG series, written by tools/htsg_expansion.py; do not edit."""',
        "",
        "# ruff: noqa: E501",
        "# mypy: allow-untyped-defs, allow-untyped-calls",
        "",
        "from __future__ import annotations",
        "",
        "from gonio.models._compile import device",
        "",
        f"TERMS = {TERMS}",
    ]
    for name, tolerance in TERM_TOLERANCES.items():
        limits = ", ".join(f"{series_limit(n, tolerance):.4g}" for n in TERMS)
        lines.append(f"LIMITS_{name.upper()} = ({limits})  # m0 up to which that many terms hold {tolerance:g}")
    for name, low, high, tolerance in RANGES:
        rows, centre, half = fit_range(table, low, high, tolerance)
        lines += [
            "",
            "",
            "@device",
            f"def {name}(x, p):",
            f'    """1 + A_1(p) x + A_2(p) x^2 + ... for x = 1/m0, within {tolerance:g}."""',
            f"    y = (x - {float(centre)!r}) * {float(1 / half)!r}",
            "    t = 2.0 * p - 1.0",
        ]
        lines += [f"    r{a} = {horner(row, 't')}" for a, row in enumerate(rows)]
        nest = f"r{len(rows) - 1}"
        for a in range(len(rows) - 2, -1, -1):
            nest = f"r{a} + y * ({nest})"
        lines.append(f"    return 1.0 + x * ({nest})")
    lines += elementary()
    OUT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
