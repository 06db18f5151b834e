"""Compiled loops of `gonio.models.gaussian_process`: prior covariances of pairs of places, and their derivatives."""

from math import sqrt
from typing import Any

from gonio.compiled import FAST, njit
from gonio.models import _math
from gonio.models._compile import jit

exp = jit(_math.exp)

SQRT5 = sqrt(5.0)


@njit(error_model="numpy", nogil=True, fastmath=FAST, forceinline=True)
def _matern(x: float) -> Any:
    """Matern's function of 5/2 at a distance r, x = sqrt(5) r; and -(1/r) times its derivative by r."""
    decay = exp(-x)
    return (1.0 + x * (1.0 + x / 3.0)) * decay, 5.0 / 3.0 * (1.0 + x) * decay


@njit(error_model="numpy", nogil=True, fastmath=FAST, forceinline=True)
def _pair(a: Any, i: int, b: Any, j: int, lengths: Any) -> Any:
    """Of one pair: squares of the distances over the lobe, its own, the view and the incidence; then the parts there.

    Distances are in units of `lengths`. The smooth part is a number, the others have their slopes with them.
    """
    l_lobe, l_own, l_view, l_incidence = lengths
    r1 = ((a[0, i] - b[0, j]) / l_lobe) ** 2
    r2 = ((a[1, i] - b[1, j]) ** 2 + (a[2, i] - b[2, j]) ** 2) / l_own**2
    r3 = ((a[4, i] - b[4, j]) ** 2 + (a[5, i] - b[5, j]) ** 2) / l_view**2
    ri = ((a[6, i] - b[6, j]) ** 2 + (a[7, i] - b[7, j]) ** 2) / l_incidence**2
    like, own, incidence = _matern(SQRT5 * sqrt(r1)), _matern(SQRT5 * sqrt(r2)), _matern(SQRT5 * sqrt(ri))
    return (r1, r2, r3, ri), like, own, exp(-0.5 * r3), _matern(SQRT5 * abs(a[3, i] - b[3, j])), incidence


@njit(error_model="numpy", nogil=True, fastmath=FAST)
def covariances(a: Any, b: Any, lengths: Any, sizes: Any, of_lobe: Any, of_base: Any) -> None:
    """Fill prior covariances of lobe and base, (n, m).

    `a` and `b` are columns as `Pairs.columns` makes them; `sizes` are squares of the amplitudes of lobe, own, view,
    retro and facets.
    """
    for i in range(a.shape[1]):
        for j in range(b.shape[1]):
            _, like, own, smooth, back, incidence = _pair(a, i, b, j, lengths)
            both = sizes[2] * smooth * incidence[0] + a[9, i] * b[9, j] + a[10, i] * b[10, j]
            of_lobe[i, j] = sizes[0] * like[0] + sizes[1] * own[0] * incidence[0] + sizes[4] * a[8, i] * b[8, j] + both
            of_base[i, j] = sizes[3] * back[0] + both


@njit(error_model="numpy", nogil=True, fastmath=FAST | {"reassoc"})
def slopes(a: Any, shares: Any, bent: Any, weights: Any, lengths: Any, sizes: Any) -> Any:
    """Sums over pairs j >= i of weights[i, j] times derivatives by the logarithms of the 11 parameters, in their order.

    `shares` (2, n) are those of lobe and base; `bent` (4, n) what ln h changes of the first three columns, and ln d0 of
    the fourth. Sums may be taken in any order, so that the loop runs on vectors; `exp` keeps its own.
    """
    h = lobe = l_lobe = own = l_own = view = l_view = l_incidence = retro = d0 = facets = 0.0
    for i in range(a.shape[1]):
        for j in range(i, a.shape[1]):
            (r1, r2, r3, ri), like, single, smooth, back, incidence = _pair(a, i, a, j, lengths)
            of_lobe = weights[i, j] * shares[0, i] * shares[0, j]
            of_base = weights[i, j] * shares[1, i] * shares[1, j]
            k1, d1 = sizes[0] * of_lobe * like[0], sizes[0] * of_lobe * like[1]
            k2, d2 = sizes[1] * of_lobe * single[0], sizes[1] * of_lobe * single[1] * incidence[0]
            k3 = sizes[2] * (of_lobe + of_base) * smooth
            along = (a[0, i] - a[0, j]) * (bent[0, i] - bent[0, j])
            around = (a[1, i] - a[1, j]) * (bent[1, i] - bent[1, j]) + (a[2, i] - a[2, j]) * (bent[2, i] - bent[2, j])
            h -= d1 * along / lengths[0] ** 2 + d2 * around / lengths[1] ** 2
            lobe += 2.0 * (k1 + k2 * incidence[0])
            l_lobe += d1 * r1
            own += 2.0 * k2 * incidence[0]
            l_own += d2 * r2
            view += 2.0 * k3 * incidence[0]
            l_view += k3 * r3 * incidence[0]
            l_incidence += (k2 + k3) * incidence[1] * ri
            retro += 2.0 * sizes[3] * of_base * back[0]
            d0 -= sizes[3] * of_base * back[1] * (a[3, i] - a[3, j]) * (bent[3, i] - bent[3, j])
            facets += 2.0 * sizes[4] * of_lobe * a[8, i] * a[8, j]
    return h, lobe, l_lobe, own, l_own, view, l_view, l_incidence, retro, d0, facets
