"""The newer models' formulas as their papers have them, in 60 digits: written without a look at the kernels."""

from typing import Any

import mpmath as mp

from tests.gonio.models.oracles import direction, fresnel

mp.mp.dps = 60


def ggx(i: Any, a: Any, r: Any, b: Any, *, alpha: float, ior: complex, alpha_y: float | None = None) -> Any:
    """D G F/(4 N.L N.V), G height-correlated [Walter2007, Heitz2014]."""
    ax, ay = mp.mpf(alpha), mp.mpf(alpha if alpha_y is None else alpha_y)
    light, view = direction(i, a), direction(r, b)
    s = [x + y for x, y in zip(light, view, strict=True)]
    length = mp.sqrt(sum(x * x for x in s))
    hx, hy, hz = (x / length for x in s)
    d = 1 / (mp.pi * ax * ay * ((hx / ax) ** 2 + (hy / ay) ** 2 + hz**2) ** 2)

    def smith(v: Any) -> Any:
        return (mp.sqrt(1 + ((ax * v[0]) ** 2 + (ay * v[1]) ** 2) / v[2] ** 2) - 1) / 2

    return d * fresnel(length / 2, ior) / (1 + smith(light) + smith(view)) / (4 * light[2] * view[2])


def eon(i: Any, a: Any, r: Any, b: Any, *, rho: float, r_: float) -> Any:
    """Fujii's form and the light that it loses, with the exact albedo [Portsmouth2025]."""
    rho, rough = mp.mpf(rho), mp.mpf(r_)
    full = mp.mpf(1) / 2 - 2 / (3 * mp.pi)
    af = 1 / (1 + full * rough)
    mean = af * (1 + (mp.mpf(2) / 3 - 28 / (15 * mp.pi)) * rough)

    def albedo(theta: Any) -> Any:
        s = mp.sin(theta)
        g = s * (theta - s * mp.cos(theta)) + mp.mpf(2) / 3 * (mp.tan(theta) * (1 - s**3) - s)
        return af * (1 + rough * g / mp.pi)

    s = mp.sin(i) * mp.sin(r) * mp.cos(b - a)
    t = max(mp.cos(i), mp.cos(r)) if s > 0 else mp.mpf(1)
    single = rho / mp.pi * af * (1 + rough * s / t)
    if rough == 0:
        return single
    several = rho**2 * mean / (1 - rho * (1 - mean))
    return single + several / mp.pi * (1 - albedo(i)) * (1 - albedo(r)) / (1 - mean)


def abg(i: Any, a: Any, r: Any, b: Any, *, A: float, B: float, g: float) -> Any:
    """A/(B + |beta - beta_0|^g)."""
    off = mp.hypot(mp.sin(i) * mp.cos(a) + mp.sin(r) * mp.cos(b), mp.sin(i) * mp.sin(a) + mp.sin(r) * mp.sin(b))
    return mp.mpf(A) / (mp.mpf(B) + (off ** mp.mpf(g) if g else 1))


def phase(i: Any, a: Any, r: Any, b: Any) -> Any:
    """Cosine of the angle between source and detector."""
    return mp.cos(i) * mp.cos(r) + mp.sin(i) * mp.sin(r) * mp.cos(b - a)


def rpv(i: Any, a: Any, r: Any, b: Any, *, rho_0: float, theta_g: float, k: float) -> Any:
    """M F (1 + R), the phase function with cos g of source and detector [Rahman1993]."""
    rho, q, k_ = mp.mpf(rho_0), mp.mpf(theta_g), mp.mpf(k)
    m = (mp.cos(i) * mp.cos(r) * (mp.cos(i) + mp.cos(r))) ** (k_ - 1)
    f = (1 - q**2) / mp.power(1 + q**2 + 2 * q * phase(i, a, r, b), mp.mpf(3) / 2)
    square = mp.tan(i) ** 2 + mp.tan(r) ** 2 - 2 * mp.tan(i) * mp.tan(r) * mp.cos(b - a)
    return rho / mp.pi * m * f * (1 + (1 - rho) / (1 + mp.sqrt(max(square, mp.mpf(0)))))


def hapke(
    i: Any, a: Any, r: Any, b: Any, *,
    w: float, h: float, b0: float, b_: float, theta_bar_deg: float = 0.0, h_function: str = "1981",
) -> Any:  # fmt: skip
    """r/mu_0 with macroscopic roughness by cases [Hapke1984], H the first or that of [Hapke2002]."""
    w, h, b0, b_ = (mp.mpf(x) for x in (w, h, b0, b_))
    g = mp.acos(min(phase(i, a, r, b), mp.mpf(1)))
    mu0, mu, shade = mp.cos(i), mp.cos(r), mp.mpf(1)
    if theta_bar_deg:
        mu0, mu, shade = _rough(i, r, abs((b - a + mp.pi) % (2 * mp.pi) - mp.pi), mp.radians(mp.mpf(theta_bar_deg)))

    def several(x: Any) -> Any:
        gamma = mp.sqrt(1 - w)
        if h_function == "1981":
            return (1 + 2 * x) / (1 + 2 * x * gamma)
        r0 = (1 - gamma) / (1 + gamma)
        return 1 / (1 - w * x * (r0 + (1 - 2 * r0 * x) / 2 * mp.log((1 + x) / x)))

    braces = (1 + b0 / (1 + mp.tan(g / 2) / h)) * (1 + b_ * mp.cos(g)) + several(mu0) * several(mu) - 1
    return w / (4 * mp.pi) * mu0 / (mu0 + mu) * braces * shade / mp.cos(i)


def _rough(i: Any, e: Any, psi: Any, slope: Any) -> tuple[Any, Any, Any]:
    """Effective cosines and S."""
    tan = mp.tan(slope)
    chi = 1 / mp.sqrt(1 + mp.pi * tan**2)

    def e1(x: Any) -> Any:
        return mp.exp(-2 / mp.pi / tan * mp.cot(x)) if x else mp.mpf(0)

    def e2(x: Any) -> Any:
        return mp.exp(-((mp.cot(x) / tan) ** 2) / mp.pi) if x else mp.mpf(0)

    def alone(x: Any) -> Any:
        return chi * (mp.cos(x) + mp.sin(x) * tan * e2(x) / (2 - e1(x)))

    f, turn = mp.exp(-2 * mp.tan(psi / 2)), mp.sin(psi / 2) ** 2
    small, large = (i, e) if i <= e else (e, i)
    down = 2 - e1(large) - psi / mp.pi * e1(small)
    of_small = chi * (mp.cos(small) + mp.sin(small) * tan * (mp.cos(psi) * e2(large) + turn * e2(small)) / down)
    of_large = chi * (mp.cos(large) + mp.sin(large) * tan * (e2(large) - turn * e2(small)) / down)
    mu0, mu = (of_small, of_large) if i <= e else (of_large, of_small)
    shade = mu / alone(e) * mp.cos(i) / alone(i) * chi / (1 - f + f * chi * mp.cos(small) / alone(small))
    return mu0, mu, shade


def k_correlation(
    i: Any, a: Any, r: Any, b: Any, *, sigma_um: float, b_um: float, c: float, ior: complex, nm: float
) -> Any:
    """Vector perturbation theory and the ABC spectrum, sigma^2 its integral over all frequencies [Stover2012]."""
    sigma, length, c, lam = mp.mpf(sigma_um), mp.mpf(b_um), mp.mpf(c), mp.mpf(nm) / 1000
    eps = mp.mpc(ior) ** 2
    turn = b - a - mp.pi  # his phi_s, 0 toward the mirror
    ri, rr = mp.sqrt(eps - mp.sin(i) ** 2), mp.sqrt(eps - mp.sin(r) ** 2)
    ss = (eps - 1) * mp.cos(turn) / ((mp.cos(i) + ri) * (mp.cos(r) + rr))
    sp = (eps - 1) * rr * mp.sin(turn) / ((mp.cos(i) + ri) * (eps * mp.cos(r) + rr))
    ps = (eps - 1) * ri * mp.sin(turn) / ((eps * mp.cos(i) + ri) * (mp.cos(r) + rr))
    pp = (eps - 1) * (rr * ri * mp.cos(turn) - eps * mp.sin(i) * mp.sin(r))
    pp /= (eps * mp.cos(i) + ri) * (eps * mp.cos(r) + rr)
    q = sum(abs(x) ** 2 for x in (ss, sp, ps, pp)) / 2
    f2 = (mp.sin(r) * mp.cos(turn) - mp.sin(i)) ** 2 + (mp.sin(r) * mp.sin(turn)) ** 2
    spectrum = sigma**2 * (c - 1) * length**2 / (2 * mp.pi) / (1 + length**2 * f2 / lam**2) ** ((c + 1) / 2)
    return 16 * mp.pi**2 / lam**4 * mp.cos(i) * mp.cos(r) * q * spectrum
