"""How often `gonio compare A B --change` says "changed" of two measurements of one model, half a step apart.

    python -m tools.studies.change_edges --pairs 60

Models of seven kinds are drawn in turn, most with edges: where masking begins, or at the normal. Sweeps in the plane at
3 drawn incidences are interpolated, with noise that is stated, and a reference of 0.3 % for each table.
"""

import argparse

import numpy as np
from gonio_analysis.changes.point_by_point import change
from gonio_analysis.changes.sides import of_table

from gonio.models import Model, build
from tests.gonio_analysis.synthetic import measure

KINDS = ("cook-torrance", "oren-nayar", "blinn", "ggx", "he-torrance", "phong", "lambert")
STEPS_DEG, NOISES = (2.5, 5.0), (0.0005, 0.002, 0.005)
LIMIT_DEG = 80.0


def draw(kind: str, rng: np.random.Generator) -> Model:
    """A model whose lobe is wider than the steps."""
    u = rng.uniform
    parameters: dict[str, float] = {}
    if kind == "cook-torrance":
        s = u(0.05, 0.8)
        parameters = {"s": s, "d": 1 - s, "m": u(0.15, 0.5), "diffuse_albedo": u(0.05, 0.9), "ior": u(1.3, 3.0)}
    elif kind == "oren-nayar":
        parameters = {"albedo": u(0.1, 0.95), "sigma_deg": u(5.0, 50.0)}
    elif kind == "blinn":
        parameters = {"k_d": u(0.1, 0.9), "k_s": u(0.05, 0.8), "c": u(0.25, 0.8), "ior": u(1.3, 10.0)}
    elif kind == "ggx":
        parameters = {"alpha": u(0.15, 0.6), "ior": u(1.3, 2.5), "diffuse_albedo": u(0.05, 0.7)}
    elif kind == "he-torrance":
        parameters = {"sigma0_um": u(0.05, 0.3), "tau_um": u(1.0, 3.0), "ior": u(1.3, 2.5)}
        parameters["diffuse_albedo"] = u(0.05, 0.7)
    elif kind == "phong":
        parameters = {"k_d": u(0.1, 0.9), "k_s": u(0.05, 0.8), "exponent": u(3.0, 60.0)}
    else:
        parameters = {"albedo": u(0.05, 0.95)}
    return build(kind, parameters)


def changed(seed: int, step_deg: float, noise: float) -> bool:
    """Whether a pair in which nothing changed is called changed; the same pair at every noise."""
    rng = np.random.default_rng([seed, int(step_deg * 10)])
    model = draw(KINDS[seed % len(KINDS)], rng)
    incidences = tuple(np.round(rng.uniform(5.0, 70.0, 3), 1))
    start = rng.uniform(0.0, step_deg) if (seed // len(KINDS)) % 2 else 0.0  # half of them with a value at the normal
    views = np.arange(start - LIMIT_DEG, LIMIT_DEG + 0.01, step_deg)
    between = views + 0.5 * step_deg
    tables = [
        measure(model, incidences=incidences, views=at, seed=int(own), noise=noise, floor=1e-6, reference=0.003)
        for at, own in zip((views, between[between <= LIMIT_DEG]), rng.integers(1 << 30, size=2), strict=True)
    ]
    verdict = change(of_table("A", "A", tables[0]), of_table("B", "B", tables[1])).verdict
    assert verdict is not None
    return verdict.changed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=60, help="for each step and noise")
    parser.add_argument("--first", type=int, default=0, help="number of the first pair")
    asked = parser.parse_args()
    for step in STEPS_DEG:
        for noise in NOISES:
            pairs = range(asked.first, asked.first + asked.pairs)
            found = [KINDS[seed % len(KINDS)] for seed in pairs if changed(seed, step, noise)]
            print(f"{step:g} degrees, noise {100 * noise:g} %: {len(found)} of {len(pairs)} {found}", flush=True)


if __name__ == "__main__":
    main()
