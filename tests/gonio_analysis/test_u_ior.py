"""Optical constants that are known only so well: a cause in the fit and in what follows from it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio import HeTorrance, materials, measurement
from gonio.errors import ArgumentError
from tests.command_line import gonio
from tests.gonio_analysis.synthetic import measure


@pytest.fixture
def aluminium(tmp_path: Path) -> Path:
    measurement.write(measure(HeTorrance(sigma0_um=0.28, tau_um=1.77, ior="Al")), tmp_path / "al.csv")
    return tmp_path


def fitted(folder: Path, *more: str) -> dict[str, Any]:
    done = gonio(folder, "fit", "al.csv", "--model", "he-torrance", "--ior", "Al", "--json", *more, expect=0)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_the_reflectance_is_no_longer_known_better_than_its_constants(aluminium: Path) -> None:
    given, held = fitted(aluminium), fitted(aluminium, "--u-ior", "0.02")
    u = [given["rho_dh"][0]["u_given"], held["rho_dh"][0]["u"]]  # at the measured level the constants say nothing
    assert u[1] > 2.0 * u[0]
    # d ln R / d ln k of aluminium, by its normal reflectance: R = 0.916 +- 0.005 for 2 % of k
    index = complex(materials.ior("Al")(550.0))
    n, k = index.real, index.imag

    def normal(n: float, k: float) -> float:
        return abs((n + 1j * k - 1) / (n + 1j * k + 1)) ** 2

    alone = np.hypot(normal(1.02 * n, k) - normal(n, k), normal(n, 1.02 * k) - normal(n, k))
    assert u[1] <= 1.5 * np.hypot(alone, u[0]), "values may tell n and k better than that, and not much worse"


def test_sources_of_a_material_differ_and_one_alone_says_nothing() -> None:
    u_n, u_k = materials.spread("Al", 633.0)
    # 1.45 + 7.54i (Rakic 1995) and 1.15 + 6.69i (McPeak 2015) are two of them
    assert 0.05 < u_n < 0.5
    assert 0.1 < u_k < 1.0
    with pytest.raises(ArgumentError, match="state its uncertainty as a number"):
        materials.spread("PC", 633.0)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--u-ior", "2"), "between 0 and 1, or: sources"),
        (("--u-ior", "few"), "between 0 and 1, or: sources"),
        (("--u-ior", "0.02", "--prior", "k=6+-0.1"), "--prior as well"),
        (("--u-ior", "0.02", "--joint"), "goes with --ior"),
    ],
)
def test_what_cannot_be_meant_is_said(aluminium: Path, more: tuple[str, ...], said: str) -> None:
    done = gonio(aluminium, "fit", "al.csv", "--model", "he-torrance", "--ior", "Al", *more, expect=2)
    assert said in done.stderr.replace("\n", " ")


def test_without_it_the_line_says_given_n_and_k(aluminium: Path) -> None:
    done = gonio(aluminium, "fit", "al.csv", "--model", "he-torrance", "--ior", "Al")
    assert "(given n, k)" in done.stderr + done.stdout
