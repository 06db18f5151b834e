"""Fits of polarised rows: what made them comes back, one polariser is enough, and matrices are fitted whole."""

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.curves.in_plane import curves
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.observations import observations
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.viewer import viewer
from gonio_analysis.selection.compare import examine

from gonio import measurement, polarisation
from gonio.errors import DataError
from gonio.formats.reader import MUELLER
from gonio.geometry import Directions
from gonio.models import GGX, CookTorrance, HeTorrance, Model, OrenNayar, Sum
from gonio.models.polarised import Light, mueller

METAL = HeTorrance(0.15, 2.0, ior=2.9 + 3.1j, diffuse_albedo=0.05)


def polarised(model: Model, words: str, *, seed: int = 1, u_rel: float = 0.01) -> pd.DataFrame:
    """In-plane values of a model in some states, with independent errors."""
    plan = [
        (theta_i, 0.0, abs(theta_r), 180.0 * (theta_r >= 0), word)
        for theta_i in (10.0, 30.0, 50.0, 65.0)
        for theta_r in np.arange(-75.0, 76.0, 5.0)
        for word in words.split()
    ]
    frame = pd.DataFrame(plan, columns=["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "polarisation"])
    at = Directions.from_table(frame)
    light = Light(at, *polarisation.states(frame["polarisation"].tolist()))
    true = model.in_light(light, lambda m: np.asarray(m.brdf(*at.angles)), 550.0)
    u = u_rel * np.abs(true) + 1e-5
    noise = np.random.default_rng(seed).standard_normal(len(frame))
    frame = frame.assign(wavelength_nm=550.0, brdf=true + u * noise, u_brdf=u, u_random=u, flag="")
    frame.attrs |= {"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0}
    return frame


def holds(found: FitResult, **true: float) -> None:
    """Not rejected, and within 4 u: of some tens of numbers here none lies beyond by chance."""
    assert not found.rejected, found.verdict
    for name, value in true.items():
        e = found.parameters[name]
        assert e.u is not None
        assert abs(e.value - value) < 4.0 * e.u, (name, e)


@pytest.mark.parametrize("words", ["s", "p", "s p", "ss sp ps pp", "dd da", "us up", "sI sQ dU dV", "r rl unpolarised"])
def test_he_torrance_comes_back_from_any_states(words: str) -> None:
    holds(fit(polarised(METAL, words), "he-torrance"), sigma0_um=0.15, tau_um=2.0, diffuse_albedo=0.05)


def test_polarisation_tells_n_from_k() -> None:
    """Unpolarised values leave them open, light at 45 degrees with an analyser does not."""
    open_ = fit(polarised(METAL, "unpolarised"), "he-torrance", free=("k",)).parameters["ior"]
    found = fit(polarised(METAL, "dd da"), "he-torrance")
    holds(found, ior=2.9, k=3.1)
    told = found.parameters["ior"]
    assert open_.u is not None
    assert told.u is not None
    assert told.u < 0.1 * open_.u


@pytest.mark.parametrize(
    ("model", "name", "true"),
    [
        (GGX(0.2, 1.5, 0.1), "ggx", {"alpha": 0.2, "ior": 1.5, "diffuse_albedo": 0.1}),
        (
            CookTorrance(0.3, 0.7, 0.25, 1.2 + 6j, diffuse_albedo=0.4),
            "cook-torrance",
            {"m": 0.25, "ior": 1.2, "k": 6.0},
        ),
        (
            Sum((OrenNayar(0.4, 20.0), 1.0), (GGX(0.15, 1.5), 0.3)),
            "oren-nayar+ggx",
            {"albedo": 0.4, "sigma_deg": 20.0, "alpha": 0.15},
        ),
    ],
)
def test_facets_and_sums_come_back(model: Model, name: str, true: dict[str, float]) -> None:
    holds(fit(polarised(model, "ss sp ps pp dd"), name), **true)


def test_a_mueller_matrix_is_fitted_element_by_element() -> None:
    frame = polarised(METAL, "unpolarised")
    at = Directions.from_table(frame)
    matrix = mueller(METAL, at).reshape(-1, 16)
    noise = np.random.default_rng(3).normal(0.0, 0.01, (len(frame), 15))
    for k, element in enumerate(MUELLER):
        frame[element] = matrix[:, k + 1] / matrix[:, 0] + noise[:, k]
        frame[f"u_{element}"] = 0.01
    data = observations(frame, polarised=True)
    assert len(data) == 16 * len(frame)
    assert int(data.differences.sum()) == np.isfinite(data.first).sum() == 15 * len(frame)
    holds(fit(data, "he-torrance"), sigma0_um=0.15, ior=2.9, k=3.1)
    assert len(curves(data)) == 4  # an incidence each: elements are no curves


def test_states_have_curves_of_their_own_and_unpolarised_light_is_their_mean() -> None:
    frame = polarised(METAL, "s p")
    found = curves(observations(frame, polarised=True))
    assert [c.state for c in found] == ["p", "s"] * 4
    assert found[0].label == "θi = 10°, p"
    plain = observations(frame)
    assert len(plain) == len(frame) // 2
    s = frame.loc[frame["polarisation"] == "s", "brdf"].to_numpy()
    p = frame.loc[frame["polarisation"] == "p", "brdf"].to_numpy()
    assert plain.brdf == pytest.approx(0.5 * (s + p), rel=1e-12)


def test_every_state_leaves_an_unpolarised_table_alone() -> None:
    frame = polarised(METAL, "unpolarised")
    assert measurement.every_state(frame) is frame
    assert observations(frame, polarised=True).light is None


IMPERFECT = {
    "light": {"extinction": 0.02, "azimuth_deg": 2.0, "u_extinction": 0.005, "u_azimuth_deg": 0.5},
    "receiver": {"extinction": 0.01, "azimuth_deg": -1.0, "u_azimuth_deg": 0.5},
}


def test_imperfect_polarisers_are_in_the_model_and_in_the_budget() -> None:
    """Values through them are not the model's through perfect ones; what is uncertain of them widens n and k."""
    frame = polarised(METAL, "ss sp ps pp dd da")
    at, words = Directions.from_table(frame), frame["polarisation"].tolist()
    stated = polarisation.Polarisers.of({"polarisers": IMPERFECT})
    seen, perfect = (
        METAL.in_light(Light(at, *polarisation.states(words, one)), lambda m: np.asarray(m.brdf(*at.angles)), 550.0)
        for one in (stated, polarisation.PERFECT)
    )
    frame["brdf"] += seen - perfect
    assert fit(frame, "he-torrance").rejected
    frame.attrs["polarisers"] = {k: {n: x for n, x in v.items() if n[0] != "u"} for k, v in IMPERFECT.items()}
    exact = fit(frame, "he-torrance")
    holds(exact, ior=2.9, k=3.1, sigma0_um=0.15)
    frame.attrs["polarisers"] = IMPERFECT
    wider = fit(frame, "he-torrance")
    holds(wider, ior=2.9, k=3.1, sigma0_um=0.15)
    assert wider.data.covariance is not None
    assert wider.data.covariance.causes == ("light_azimuth", "light_extinction", "receiver_azimuth")
    for name in ("ior", "k"):
        one, other = wider.parameters[name].u, exact.parameters[name].u
        assert one is not None
        assert other is not None
        assert one > other


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({"lamp": {}}, "a table for light, for receiver"),
        ({"light": {"azimuth": 0.1}}, "'azimuth' = 0.1; a number for each of extinction, azimuth_deg"),
        ({"light": {"extinction": 2.0}}, r"extinction = 2 is outside \[0, 1\]"),
    ],
)
def test_polarisers_that_are_none_are_named(stated: object, said: str) -> None:
    frame = polarised(METAL, "s")
    frame.attrs["polarisers"] = stated
    with pytest.raises(DataError, match=said):
        observations(frame, polarised=True)


def test_the_page_s_plot_has_a_curve_a_state_with_its_own_theory() -> None:
    """s and p of a dielectric differ near Brewster's angle: a line of the other is far off."""
    d = examine(polarised(HeTorrance(0.15, 2.0, 1.5), "s p", u_rel=1e-4), ["he-torrance"], name="lacquer")
    view = viewer(DatasetSummary.of(d, "lacquer", {}), "max")
    assert len(view["labels"]) == 8
    assert {label.split(", ")[1] for label in view["labels"]} == {"s", "p"}
    for curve in view["waves"][0]["curves"]:
        values, theory = curve["series"]
        near = np.array([np.argmin(np.abs(np.array(theory["angle"]) - angle)) for angle in values["angle"]])
        smooth = np.abs(np.array(values["angle"]) - curve["mirror"]) > 3.0  # beside the spike
        # lines have a point every degree or so, at which a lobe changes by a tenth
        ratio = np.array(theory["brdf"])[near] / np.array(values["brdf"])
        np.testing.assert_allclose(ratio[smooth & (np.array(values["brdf"]) > 1e-3)], 1.0, atol=0.2)


def test_drawn_curves_are_seen_through_the_table_s_polarisers() -> None:
    """In the plane facets turn no s into p: a crossed analyser of extinction e shows e/(1 + e) of what "ss" does."""
    model, angle = HeTorrance(0.15, 2.0, 1.5), np.radians([10.0, 40.0])
    shown = {}
    for word, receiver in (("ss", {}), ("sp", {"extinction": 0.01})):
        table = polarised(model, word)
        table.attrs["polarisers"] = {"receiver": receiver}
        data = observations(table, "lacquer", polarised=True)
        shown[word] = curves(data)[0].theory(model, angle, data)
    np.testing.assert_allclose(shown["sp"], shown["ss"] * 0.01 / 1.01, rtol=1e-9)  # rounding, beside 1
