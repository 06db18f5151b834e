"""Writes gonio/models/_htsg_expansion.py: the polynomials behind the fast HTSG series, from 50-digit arithmetic.

    python tools/htsg_expansion.py

The series is S(g, c) = sum over m >= 1 of exp(-g) g^m / (m! m) exp(-c/m) (He 1991 eq. 78). Its largest term lies at
m0 = g exp(u), 2u = W0(2c/g^2). With p = 1/(1 + 2u), Stirling's and Laplace's expansions about it give

    S = exp(phi) sqrt(p)/m0 (1 + A_1(p)/m0 + A_2(p)/m0^2 + ...),   phi = m0 (1 - u) - g - c/m0.

Above m0 = 104 to 160 these few orders, below the sum itself, are fitted in 1/m0 and p (or a fraction of p) by
Chebyshev polynomials, one set for each band of m0 and each tolerance, and written as tables of powers.
"""

from __future__ import annotations

import math
from pathlib import Path

import mpmath as mp
import numpy as np

OUT = Path(__file__).resolve().parents[1] / "gonio" / "models" / "_htsg_expansion.py"
ORDERS = 10
Q_NODES = 40
X_NODES = 16
# smallest m0, largest m0, smallest m0 p, beta of q = 1/(1 + beta u) (2: q = p), error of the fit
BANDS = {
    "full": [
        (16, 20, 2.5, 6, 1e-13),
        (20, 28, 2.5, 8, 1e-13),
        (28, 40, 2.5, 6, 1e-13),
        (40, 120, 1.9, 4, 3e-14),
        (120, 1536, 0, 2, 1e-14),
        (1536, None, 0, 2, 1e-14),
    ],
    "nano": [
        (10, 14, 1.9, 4, 1e-10),
        (14, 20, 1.9, 6, 1e-10),
        (20, 40, 1.9, 6, 1e-10),
        (40, 160, 1.2, 4, 1e-10),
        (160, None, 0, 2, 1e-10),
    ],
    "micro": [
        (5, 7, 1.5, 2, 1e-7),
        (7, 10, 1.5, 2, 1e-7),
        (10, 14, 1.5, 4, 1e-7),
        (14, 20, 1.5, 6, 1e-7),
        (20, 104, 0.9, 4, 1e-7),
        (104, None, 0, 2, 1e-7),
    ],
}
TERMS = (8, 12, 16, 20, 24, 28, 32, 36, 40, 48, 56, 64, 72, 80, 88, 96, 104)
TERM_TOLERANCES = {"full": 5e-14, "nano": 1e-10, "micro": 1e-7}


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


def bracket(x: mp.mpf, p: mp.mpf) -> mp.mpf:
    """S m0/sqrt(p) exp(-phi) at x = 1/m0, term by term."""
    m0, u = 1 / x, (1 / p - 1) / 2
    g, c = m0 * mp.exp(-u), u * m0 * m0
    width = 9 * mp.sqrt(m0 * p) + 15
    first, last = max(1, int(m0 - width)), int(m0 + 1.3 * width) + 5
    phi = m0 * (1 - 2 * u) - g
    term = mp.exp(first * mp.log(g) - g - mp.loggamma(first + 1) - mp.log(first) - c / first - phi)
    total = term
    for m in range(first, last):
        term *= g * m / mp.mpf(m + 1) ** 2 * mp.exp(c / (mp.mpf(m) * (m + 1)))
        total += term
    return total * m0 / mp.sqrt(p)


def fit_range(
    low: int, high: int | None, least: float, beta: int, tolerance: float
) -> tuple[list[list[mp.mpf]], tuple[mp.mpf, mp.mpf], tuple[mp.mpf, mp.mpf]]:
    """Rows of powers of the scaled q for each power of the scaled 1/m0; centre and half-width of 1/m0 and of q."""
    x_low, x_high = (mp.mpf(1) / high if high else mp.mpf(0)), mp.mpf(1) / low
    p_low = mp.mpf(least) / low
    q_low = p_low / (p_low + mp.mpf(beta) / 2 * (1 - p_low))
    x_centre, x_half, q_centre, q_half = (x_low + x_high) / 2, (x_high - x_low) / 2, (q_low + 1) / 2, (1 - q_low) / 2
    in_x, in_q = chebyshev_transform(X_NODES), chebyshev_transform(Q_NODES)
    places = [x_centre + x_half * t for t in chebyshev_nodes(X_NODES)]
    values = [[mp.mpf(0)] * Q_NODES for _ in places]
    for j, t in enumerate(chebyshev_nodes(Q_NODES)):
        q = q_centre + q_half * t
        p = q / (q + mp.mpf(2) / beta * (1 - q))
        coefficients = laplace_coefficients(p, ORDERS) if least == 0 else []
        for i, x in enumerate(places):
            values[i][j] = (
                sum(row * x**k for k, row in enumerate(coefficients)) if least == 0 else (bracket(x, p) - 1) / x
            )
    partial = [[mp.fdot(row, line) for row in in_q] for line in values]
    columns = list(zip(*partial, strict=True))
    two = [[mp.fdot(row, column) for column in columns] for row in in_x]
    kept = []
    for line in two:
        large = [b for b, value in enumerate(line) if abs(value) * x_high > tolerance / 12]
        if not large:
            break
        kept.append(line[: max(large) + 1])
    by_q = [power_coefficients(line) for line in kept]
    width = max(len(line) for line in by_q)
    rising = [power_coefficients([line[b] if b < len(line) else mp.mpf(0) for line in by_q]) for b in range(width)]
    rows = [[rising[b][a] for b in range(width)] for a in range(len(by_q))]
    for row in rows:
        while len(row) > 1 and row[-1] == 0:
            row.pop()
    return rows, (x_centre, x_half), (q_centre, q_half)


def estrin(coefficients: list[mp.mpf], variable: str) -> str:
    """A polynomial as a tree of pairs in the powers that `powers` writes: short chains, which a processor overlaps."""
    terms = [repr(float(value)) for value in coefficients]
    power = 1
    while len(terms) > 1:
        name = variable if power == 1 else f"{variable}{power}"
        pairs = [f"({a} + {name} * {b})" for a, b in zip(terms[::2], terms[1::2], strict=False)]
        terms = pairs + terms[len(pairs) * 2 :]
        power *= 2
    return terms[0].removeprefix("(").removesuffix(")")


def powers(variable: str, count: int) -> list[str]:
    """Lines that compute the powers which `estrin` needs for that many coefficients."""
    lines, power = [], 2
    while power < count:
        below = variable if power == 2 else f"{variable}{power // 2}"
        lines.append(f"    {variable}{power} = {below} * {below}")
        power *= 2
    return lines


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
    """Powers 1..degree of numerator and denominator of W0(e^y - 1)/y for y in [0, 650] (Sanathanan and Koerner)."""
    y = np.concatenate([np.linspace(1e-6, 1, 200), np.linspace(1, 10, 400), np.geomspace(10, 650, 400)])
    ratio = np.array([float(mp.lambertw(mp.expm1(v)).real / v) for v in y])
    basis = y[:, None] ** np.arange(1, degree + 1)
    scale = basis.max(axis=0)
    basis /= scale
    weight, stress = np.ones_like(y), np.ones_like(y)
    best, found = np.inf, np.zeros(2 * degree)
    for step in range(80):
        weigh = stress * weight / ratio
        matrix = np.hstack([basis, -ratio[:, None] * basis]) * weigh[:, None]
        now = np.linalg.lstsq(matrix, (ratio - 1.0) * weigh, rcond=None)[0]
        below = 1.0 + basis @ now[degree:]
        error = np.abs((1.0 + basis @ now[:degree]) / below / ratio - 1.0)
        if error.max() < best:
            best, found = error.max(), now
        weight = 1.0 / np.abs(below)
        if step > 20:  # towards equal ripples
            stress *= np.sqrt(error / error.mean() + 0.1)
    return found[:degree] / scale, found[degree:] / scale


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
    above, below = lambert_start(5)
    lines = [
        "",
        "",
        "@device",
        "def scaled_erfcx(t):",
        '    """(1 + 2h) exp(h^2) erfc(h) for t = (h - 3)/(h + 3), 0 <= h <= 6.5, within 3e-16 of itself."""',
        f"    s = (t + 1.0) * {float(2 / (t_top + 1))!r} - 1.0",
        *powers("s", len(erfcx)),
        f"    return {estrin(erfcx, 's')}",
        "",
        "",
        "@device",
        "def rough_log1p(f):",
        '    """ln(1 + f) for f in [sqrt(1/2) - 1, sqrt(2) - 1], within 1e-5 of itself."""',
        f"    s = (f - {float(middle)!r}) * {float(1 / half)!r}",
        *powers("s", len(log_powers)),
        f"    return f * ({estrin(log_powers, 's')})",
        "",
        "",
        "@device",
        "def lambert_start(y):",
        '    """Numerator and denominator of W0(e^y - 1)/y, within 1e-4 for y in [0, 650]."""',
        *powers("y", len(above) + 1),
        f"    above = {estrin([mp.mpf(1), *above], 'y')}",
        f"    return above, {estrin([mp.mpf(1), *below], 'y')}",
    ]
    for name, tolerance in (("full", 1e-17), ("micro", 3e-9)):
        found = fit_chebyshev(lambda s: mp.mpf(2) ** (s / 2), 24, tolerance)
        found = [value * 2**i for i, value in enumerate(found)]
        lines += [
            "",
            "",
            "@device",
            f"def exp2_{name}(f):",
            f'    """2^f for f in [-1/2, 1/2], within {10 * tolerance:g} of itself."""',
            *powers("f", len(found)),
            f"    return {estrin(found, 'f')}",
        ]
    return lines


def band_lines(low: int, high: int | None, least: float, beta: int, tolerance: float) -> list[str]:
    """One band: where it holds, how its variables are scaled, and its rows, highest powers first."""
    rows, (x_centre, x_half), (q_centre, q_half) = fit_range(low, high, least, beta, tolerance)
    scales = ", ".join(repr(float(v)) for v in (low, least, beta / 2, x_centre, 1 / x_half, q_centre, 1 / q_half))
    lines = [f"    ({scales}, (  # within {tolerance:g}"]
    lines += [f"        ({', '.join(repr(float(v)) for v in reversed(row))},)," for row in reversed(rows)]
    return [*lines, "    )),"]


def main() -> None:
    mp.mp.dps = 40
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
    lines += [
        "# S m0/sqrt(p) exp(-phi) = 1 + x f, x = 1/m0, f a polynomial in x and q = p/(p + b (1 - p)). For each band:",
        "# smallest m0 and m0 p; b; centre and 1/half-width of x and of q; for each power of x a row of powers of q.",
        "# fmt: off",
    ]
    for name, bands in BANDS.items():
        lines += [f"{name.upper()} = (", *(line for band in bands for line in band_lines(*band)), ")"]
    lines.append("# fmt: on")
    lines += elementary()
    OUT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
