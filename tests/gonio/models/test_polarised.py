"""Polarised light on models: against He-Torrance's own matrices, mirrors, and what polarisation does in general."""

import numpy as np
import numpy.typing as npt
import pytest

from gonio import polarisation
from gonio.geometry import Directions
from gonio.models import GGX, CookTorrance, GGXMultiscatter, HeTorrance, KCorrelation, Lambert, Model, OrenNayar, Sum
from gonio.models.fresnel import amplitudes
from gonio.models.polarised import Light, mueller

ROUNDING = 1e-14
"""Of some tens of operations, relative to the first element."""
BLACK = CookTorrance(s=0.6, d=0.4, slopes=0.2, ior=1.5, diffuse_albedo=0.3)


def somewhere(count: int = 300) -> Directions:
    rng = np.random.default_rng(4)
    theta, phi = rng.uniform(0.0, 1.5, (2, count)), rng.uniform(0.0, 6.2, (2, count))
    return Directions(theta[0], phi[0], theta[1], phi[1])


@pytest.mark.parametrize("ior", [1.5, 0.8 + 0.1j, 1.2 + 6.8j])
def test_facets_are_those_of_he_torrance(ior: complex) -> None:
    """Its kernels, which published digits hold, against the general way; also at the normal and in retro-reflection."""
    model, at = HeTorrance(0.2, 2.0, ior=ior, diffuse_albedo=0.3), somewhere()
    special = Directions([0.0, 0.3, 0.3, 0.0], [0.2, 0.1, 0.1, 0.0], [0.0, 0.3, 0.3, 0.5], [0.2, 0.1, 0.1 + np.pi, 1.0])
    for where in (at, special):
        wanted = model.mueller(*where.angles)
        assert np.max(np.abs(mueller(model, where) - wanted) / wanted[:, :1, :1]) < ROUNDING


@pytest.mark.parametrize("theta", [0.2, 0.9, 1.4])
def test_the_mirror_direction_is_that_of_a_smooth_surface(theta: float) -> None:
    """s and p of a facet that lies flat are the reflectances of a smooth surface."""
    at = Directions([theta], [0.0], [theta], [np.pi])
    f_s, f_p = (abs(f) ** 2 for f in amplitudes(np.cos(theta), 1.5 + 0.7j))
    light = Light(at, *polarisation.states(["ss"]))
    assert light.of_facets(1.5 + 0.7j)[0] == pytest.approx(2.0 * f_s / (f_s + f_p), rel=1e-13)
    cross = Light(at, *polarisation.states(["sp"])).of_facets(1.5 + 0.7j)[0]
    assert abs(cross) < 1e-15


@pytest.mark.parametrize(
    "model",
    [
        BLACK,
        GGX(0.3, 1.4 + 2j, 0.1),
        GGXMultiscatter(0.5, 1.5),
        KCorrelation(0.01, 3.0, 2.5, ior=1.5 + 2j),
        Sum((OrenNayar(0.4, 20.0), 0.7), (GGX(0.2, 1.5), 0.3)),
    ],
)
def test_every_matrix_takes_light_to_light(model: Model) -> None:
    """No reflected light is polarised by more than all of it, and no analyser sees less than nothing."""
    at = somewhere()
    matrix = mueller(model, at)
    assert matrix[:, 0, 0] == pytest.approx(model.brdf(*at.angles), rel=1e-12)
    for state in "spdarl":
        intensity, *rest = np.moveaxis(matrix @ np.array(polarisation.STATES[state]), -1, 0)
        assert np.all(np.sqrt(sum(x**2 for x in rest)) <= intensity * (1.0 + 1e-12))


def test_a_facet_alone_polarises_wholly_and_a_base_not_at_all() -> None:
    at = somewhere()
    for model, share in ((GGX(0.3, 1.5), 1.0), (Lambert(0.4), 0.0), (OrenNayar(0.3, 25.0), 0.0)):
        out = mueller(model, at) @ np.array(polarisation.STATES["d"])
        assert np.sqrt((out[:, 1:] ** 2).sum(axis=1)) == pytest.approx(share * out[:, 0], rel=1e-10, abs=1e-18)


def test_the_first_order_is_facets_near_the_mirror_direction() -> None:
    """Rayleigh and Rice's amplitudes, signs of mixed elements included, where slopes alone matter."""
    theta, off = np.linspace(0.1, 1.3, 20), 1e-5
    at = Directions(theta, np.zeros(20), theta + off, np.full(20, np.pi + off))
    model = KCorrelation(0.01, 3.0, 2.5, ior=1.5 + 2j)
    for word in ("dd", "ra", "sd", "pr"):
        light = Light(at, *polarisation.states([word] * 20))
        jones = model.jones_at(at, 550.0)
        assert jones is not None
        assert light.of_jones(jones) == pytest.approx(light.of_facets(1.5 + 2j), rel=1e-3, abs=1e-4)


def parts(words: str) -> npt.NDArray[np.float64]:
    at = somewhere()

    def of(word: str) -> npt.NDArray[np.float64]:
        light = Light(at, *polarisation.states([word] * len(at)))
        return BLACK.in_light(light, lambda m: np.asarray(m.brdf(*at.angles)), 550.0)

    return np.array([of(word) for word in words.split()])


def test_states_add_up() -> None:
    s, p, d, a, r, left = parts("s p d a r l")
    for pair in ((s, p), (d, a), (r, left)):
        assert 0.5 * sum(pair) == pytest.approx(BLACK.brdf(*somewhere().angles), rel=1e-12)
    ss, sp, sd, sa, sr, sl, su, q, u, v = parts("ss sp sd sa sr sl su sQ sU sV")
    for pair in ((ss, sp), (sd, sa), (sr, sl)):
        assert sum(pair) == pytest.approx(su, rel=1e-12)
    for difference, element in ((ss - sp, q), (sd - sa, u), (sr - sl, v)):
        assert difference == pytest.approx(element, rel=1e-11, abs=1e-15)


def test_words_of_states() -> None:
    assert len(set(polarisation.WORDS)) == len(polarisation.WORDS)
    assert {"unpolarised", "s", "ss", "us", "dQ", "rl", "VV"} < {*polarisation.WORDS}
    assert polarisation.MUELLER["m12"] == "UQ"  # row Q, column U


FACETS = {"type": "0", "sdf": {None: "Exponential_Slope_Distribution_Function", "s": "0.3"}, "stack": "No_StackModel"}
ROUGH = {"type": "0", "psd": {None: "ABC_PSD_Function", "A": "0.01", "B": "3", "C": "2.5"}}


@pytest.mark.parametrize(
    ("model", "name", "more"),
    [
        (GGX(0.3, 1.5 + 0.2j), "Facet_BRDF_Model", FACETS),
        (KCorrelation(0.001, 3.0, 2.5, ior=1.5 + 0.2j), "Microroughness_BRDF_Model", ROUGH),
    ],
    ids=["facets", "first order"],
)
def test_matrices_are_those_of_scatmech(model: Model, name: str, more: dict[str, object]) -> None:
    """Germer's SCATMECH at 300 geometries; its s, p and ray are right-handed, so that U and V have other signs."""
    brdf = pytest.importorskip("pySCATMECH.brdf", reason="the extra gonio[peers] is not installed")
    peer = brdf.BRDF_Model(name, {"lambda": "0.55", "substrate": "(1.5,0.2)", **more})
    rng = np.random.default_rng(5)
    theta_i, theta_r = rng.uniform(0.02, 1.4, (2, 300))
    dphi = rng.uniform(0.05, 2.0 * np.pi - 0.05, 300)
    pairs = zip(theta_i, theta_r, dphi - np.pi, strict=True)  # its azimuth 0 is the mirror side
    wanted = np.array([
        peer.MuellerBRDF(thetai=i, thetas=r, phis=phi, rotation=0, coords="psps") for i, r, phi in pairs
    ])  # fmt: skip
    signs = np.array([1.0, 1.0, -1.0, -1.0])
    ours = mueller(model, Directions(theta_i, np.zeros(300), theta_r, dphi)) * np.outer(signs, signs)
    assert np.max(np.abs(ours / ours[:, :1, :1] - wanted / wanted[:, :1, :1])) < ROUNDING
