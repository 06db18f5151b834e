"""Cook-Torrance fits of pixels by jax, as one would write them there: batched, with its own derivatives."""

import importlib.util
import time
from typing import Any

import numpy as np

from gonio.typing import Floats

STEPS = 8
TOGETHER = 1000
"""Pixels that are fitted at a time."""


def there() -> bool:
    """Whether jax is installed."""
    return importlib.util.find_spec("jax") is not None


def fitted(source: Floats, camera: Floats, d: dict[str, Any], start: Floats) -> tuple[Floats, float]:
    """Parameters s, m and diffuse_albedo of each pixel, and processor time a pixel [s].

    Parameters
    ----------
    source, camera : (n, 3) array
        Where they stand [mm].
    d
        Pixels of `maps.drawn`.
    start : (P, 3) array
        Where each search begins.
    """
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    ior = d["fixed"]["ior"]

    def model(theta: Any, l: Any, v: Any) -> Any:  # noqa: E741
        s, m, albedo = theta
        h = l + v
        h2 = jnp.sum(h * h, axis=1)
        c, nh2, nl, nv = 0.5 * jnp.sqrt(h2), h[:, 2] ** 2 / h2, l[:, 2], v[:, 2]
        q = jnp.sqrt(ior * ior - 1.0 + c * c)
        f = 0.5 * ((q - c) / (q + c)) ** 2 * (1.0 + ((c * (q + c) - 1.0) / (c * (q - c) + 1.0)) ** 2)
        slopes = jnp.exp(-(1.0 - nh2) / (nh2 * m * m)) / (m * m * nh2 * nh2)
        g = jnp.minimum(1.0, 2.0 * jnp.sqrt(nh2) * jnp.minimum(nl, nv) / c)
        return s * f * slopes * g / (jnp.pi * nl * nv) + (1.0 - s) * albedo / jnp.pi

    def one(theta: Any, x: Any, y: Any, values: Any, u: Any) -> Any:
        spot = jnp.stack([x, y, 0.0])
        l, v = (p / jnp.linalg.norm(p, axis=1, keepdims=True) for p in (source - spot, camera - spot))  # noqa: E741

        def misses(theta: Any) -> Any:
            return (model(theta, l, v) - values) / u

        def step(_: int, state: Any) -> Any:
            theta, damping = state
            jacobian, left = jax.jacfwd(misses)(theta), misses(theta)
            normal = jacobian.T @ jacobian
            new = theta - jnp.linalg.solve(normal + damping * jnp.diag(jnp.diag(normal)), jacobian.T @ left)
            better = jnp.sum(misses(new) ** 2) <= jnp.sum(left**2)
            return jnp.where(better, new, theta), jnp.where(better, 0.1 * damping, 10.0 * damping)

        return jax.lax.fori_loop(0, STEPS, step, (theta, 1e-3))[0]

    batched = jax.jit(jax.vmap(one))
    arrays = (start, d["x"], d["y"], d["values"], d["u"])
    groups = [[a[first : first + TOGETHER] for a in arrays] for first in range(0, len(start), TOGETHER)]
    for group in (groups[0], groups[-1]):
        batched(*group).block_until_ready()  # compiles
    began = time.process_time()
    found = np.concatenate([np.asarray(batched(*group)) for group in groups])
    return found, (time.process_time() - began) / len(start)
