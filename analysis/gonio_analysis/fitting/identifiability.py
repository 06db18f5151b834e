"""What data cannot tell, in words: found from the curvature of chi-square at the solution.

Two parameters that replace each other leave a valley along which chi-square hardly rises. Its direction is the
eigenvector of the covariance with the largest variance, on a relative scale for each parameter; what the data do
determine is the combination across the valley, as sigma0/tau of a very rough surface (He et al. 1991, eq. 78: g >> 1).
"""

import math
from fractions import Fraction

import numpy as np

from gonio.shown import with_u
from gonio.typing import Floats

POOR = 0.05
"""Relative standard error above which a parameter counts as poorly known."""
MOST = 8.0
"""Ratio of relative errors beyond which a product of powers says nothing that the better known one does not."""
TIED = 0.98
"""Correlation above which two parameters count as tied."""


def tied(names: tuple[str, ...], values: Floats, covariance: Floats) -> list[str]:
    """Sentences about pairs of parameters that are tied, and about what is known of them nevertheless.

    Parameters
    ----------
    names, values
        Fitted parameters.
    covariance
        Theirs; infinite or zero entries belong to parameters that the data do not see.
    """
    u = np.sqrt(np.diag(covariance))
    out = []
    for i, a in enumerate(names):
        for j, b in enumerate(names[:i]):
            if not (np.isfinite(u[[i, j]]).all() and u[i] > 0 and u[j] > 0 and values[i] != 0 and values[j] != 0):
                continue
            r = float(covariance[i, j] / (u[i] * u[j]))
            if abs(r) <= TIED:
                continue
            relative = float(u[i] / abs(values[i])), float(u[j] / abs(values[j]))
            poor = max(relative) > POOR
            text = f"{b} and {a} " + ("can hardly be told apart by these data" if poor else "are strongly correlated")
            text += f" (correlation {r:+.4f})"
            known = _combination((b, a), (values[j], values[i]), (relative[1], relative[0]), r)
            if known:
                text += f"; {'what they determine is' if poor else 'better known than either is'} {known}"
            out.append(text + ".")
    return out


def _combination(names: tuple[str, str], values: tuple[float, float], u: tuple[float, float], r: float) -> str:
    """The best known product of powers of two parameters, with its standard error; "" where none is better known."""
    # d ln a and d ln b move together in the ratio u_a : sign u_b; a^p b^q stays where p u_a + q sign u_b = 0
    ratio = u[0] / u[1]
    if not 1 / MOST <= ratio <= MOST:
        return ""
    power = Fraction(ratio).limit_denominator(4)
    p, q = (1.0, -math.copysign(float(power), r)) if power > 0 else (1.0, -math.copysign(ratio, r))
    if power > 0 and abs(float(power) - ratio) > 0.1 * ratio:
        q = -math.copysign(ratio, r)
    spread = math.sqrt(max((p * u[0]) ** 2 + (q * u[1]) ** 2 + 2 * p * q * r * u[0] * u[1], 0.0))
    if spread > 0.5 * min(1.0, *u):  # of a half, and more, nothing is determined
        return ""
    value = values[0] ** p * abs(values[1]) ** q
    exponent = "" if abs(q) == 1.0 else f"^{abs(q):.3g}"
    sign = "/" if q < 0 else " "
    return f"{names[0]}{sign}{names[1]}{exponent} = {with_u(value, spread * abs(value))}"
