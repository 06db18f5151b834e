"""Quantities of tables and models: right, with uncertainties that hold, and refused where angles are missing."""

import math
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from gonio_analysis.appearance import quantities, sampled
from gonio_analysis.appearance.glossmeter import GLOSSMETERS, gloss
from gonio_analysis.appearance.of_models import _mean, of_fit, of_model, of_sample
from gonio_analysis.appearance.quantities import of_table
from gonio_analysis.curves.in_plane import curves
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.level import level
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.report.appearance import listed
from gonio_analysis.result_records import Quantity

from gonio import colour
from gonio.models import CookTorrance, HeTorrance, Lambert, Model, OrenNayar, Sum
from gonio.samples.description import ParameterUncertainty, SampleDescription
from gonio.typing import Floats
from tests.gonio_analysis.appearance.simulated import hemisphere, measured, named, noisy, plane
from tests.gonio_analysis.synthetic import known

SIGNED = np.arange(-87.5, 87.6, 2.5)
GLOSSY = (20.0, 60.0, 85.0)
PAINT = HeTorrance(sigma0_um=0.1, tau_um=2.0, ior=1.5, diffuse_albedo=0.1)


def swept(*incidences: float) -> Any:
    """In-plane directions at some incidences."""
    return np.vstack([plane(theta, SIGNED) for theta in incidences])


@pytest.mark.parametrize(
    "model",
    [
        HeTorrance(sigma0_um=0.0, tau_um=1.0, ior=1.567),  # a spike alone
        HeTorrance(sigma0_um=0.28, tau_um=1.77, ior=1.5, diffuse_albedo=0.3),  # a lobe alone
        PAINT,  # both
        Lambert(0.9),
        OrenNayar(albedo=0.9, sigma_deg=30.0),
    ],
    ids=("glass", "rough", "paint", "white", "plaster"),
)
def test_sampled_and_exact_gloss_agree(model: Model) -> None:
    exact = of_model(model, name="exact")
    table = of_table(measured(model, swept(*GLOSSY, 30.0)), name="sampled")
    for key in ("gloss_20_gu", "gloss_60_gu", "gloss_85_gu", "haze_e430_20", "haze_e430_30"):
        assert known(getattr(table, key).value) == pytest.approx(known(getattr(exact, key).value), abs=0.5), key
    assert (table.haze_gu.value is None) == (exact.haze_gu.value is None)
    if exact.haze_gu.value is not None:
        assert known(table.haze_gu.value) == pytest.approx(known(exact.haze_gu.value), abs=0.5)


def test_values_out_of_the_plane_make_gloss_better() -> None:
    model = CookTorrance(s=1, d=0, slopes=((0.3, 1.0),), ior=1.5)
    flat = swept(60.0)
    exact = gloss(model, GLOSSMETERS[1], 550.0)[0]
    around = np.unique(np.vstack([flat, hemisphere(60.0, 2.5, 5.0, 87.5)]), axis=0)
    one, other = (of_table(measured(model, d), name="sampled").gloss_60_gu for d in (flat, around))
    assert abs(known(other.value) - exact) < 0.05  # GU; what the plane alone is off by is 0.3
    assert abs(known(other.value) - exact) < abs(known(one.value) - exact)
    assert known(other.error) < known(one.error)


def test_the_error_of_a_gloss_from_one_plane_covers_what_it_assumes() -> None:
    model = CookTorrance(s=1, d=0, slopes=((0.3, 1.0),), ior=1.5)
    sample = of_table(measured(model, swept(*GLOSSY)), name="sampled")
    for meter, q in zip(GLOSSMETERS, (sample.gloss_20_gu, sample.gloss_60_gu, sample.gloss_85_gu), strict=True):
        if q.value is None:
            assert "the measured directions do not say enough" in known(q.why)
        else:
            assert abs(q.value - gloss(model, meter, 550.0)[0]) <= known(q.error) + 0.01
    assert sample.gloss_85_gu.value is None


@pytest.mark.parametrize(
    ("slope", "convention"), [(0.3, "paper"), (0.2, "normalised"), (0.1, "paper")], ids=("rough", "plain", "smooth")
)
def test_gloss_at_85_of_facets_is_stated_within_its_error(
    slope: float, convention: Literal["paper", "normalised"]
) -> None:
    model = CookTorrance(s=1, d=0, slopes=((slope, 1.0),), ior=1.5, convention=convention)
    directions = np.unique(np.vstack([plane(85.0, SIGNED), hemisphere(85.0, 2.5, 5.0, 87.5)]), axis=0)
    found = of_table(measured(model, directions), name="facets").gloss_85_gu
    assert abs(known(found.value) - gloss(model, GLOSSMETERS[2], 550.0)[0]) <= known(found.error)
    assert known(found.error) < 0.07 * known(found.value)  # what depends on the half vector is told from the values
    flat = of_table(measured(model, plane(85.0, SIGNED)), name="facets").gloss_85_gu
    assert flat.value is None
    assert "values out of the plane of incidence within 25° of the mirror direction may tell" in known(flat.why)


@pytest.mark.parametrize("model", [Lambert(0.8), OrenNayar(0.9, 30.0), PAINT], ids=("white", "plaster", "paint"))
def test_a_reflectance_is_the_models_integral(model: Model) -> None:
    directions = np.vstack([hemisphere(8.0, 5.0, 15.0), hemisphere(45.0, 5.0, 15.0)])
    sample = of_table(measured(model, directions), name="sampled")
    for q in (sample.rho_dh_8, *sample.rho_dh):
        theta = math.radians(getattr(q, "theta_i_deg", 8.0))
        assert known(q.value) == pytest.approx(model.directional_hemispherical(theta), abs=known(q.error))
        assert known(q.error) < 0.01


def test_a_spike_is_in_the_reflectance() -> None:
    glass = HeTorrance(sigma0_um=0.0, tau_um=1.0, ior=1.567)
    sample = of_table(measured(glass, hemisphere(8.0)), name="glass")
    assert known(sample.rho_dh_8.value) == pytest.approx(glass.specular_reflectivity(math.radians(8.0)), rel=1e-4)


def test_half_a_hemisphere_gives_a_lower_bound() -> None:
    sample = of_table(measured(Lambert(0.8), hemisphere(8.0, end=60.0)), name="cut")
    assert sample.rho_dh_8.value is None
    assert "% of the projected hemisphere was measured" in known(sample.rho_dh_8.why)
    assert known(sample.rho_dh_8.at_least) == pytest.approx(0.8 * math.sin(math.radians(60.0)) ** 2, rel=0.05)


@pytest.mark.parametrize("sigma_um", [0.004, 0.008])
def test_roughness_is_that_of_a_smooth_surface(sigma_um: float) -> None:
    smooth = HeTorrance(sigma0_um=sigma_um, tau_um=5.0, ior=1.5)
    # the scatter theory holds to about the scattered share itself, at most 4 % here
    assert known(of_model(smooth, name="smooth").rms_roughness_nm.value) == pytest.approx(1e3 * sigma_um, rel=0.04)
    rough = of_model(PAINT, name="paint")
    assert rough.rms_roughness_nm.value is None
    assert "is scattered" in known(rough.rms_roughness_nm.why)


def test_colours_are_those_of_the_spectrum() -> None:
    waves = tuple(np.arange(400.0, 701.0, 20.0))
    model = HeTorrance(sigma0_um=0.3, tau_um=1.5, ior=lambda nm: 1.3 + 0.001 * (nm - 400.0), diffuse_albedo=0.1)
    directions = np.vstack(
        [plane(45.0, np.array([60.0, 30.0, 20.0, 0.0, -30.0, -65.0])), plane(15.0, np.array([30.0, 0.0]))]
    )
    sample = of_table(measured(model, directions, waves=waves, cone_sr=0.0), name="paint")
    for c in sample.lab:
        azimuth = math.pi if c.theta_r_deg >= 0.0 else 0.0
        f = model.brdf(
            math.radians(c.theta_i_deg), 0.0, abs(math.radians(c.theta_r_deg)), azimuth, wavelength_nm=np.array(waves)
        )
        wanted = colour.lab(colour.xyz(math.pi * f, waves))
        assert [c.L.value, c.a.value, c.b.value] == pytest.approx(wanted, abs=1e-9)  # rounding
    exact = of_model(model, name="paint")
    for ours, theirs in zip(sample.lab, exact.lab, strict=True):
        # a spectrum every 20 nm instead of every 10
        assert known(ours.L.value) == pytest.approx(known(theirs.L.value), abs=0.05)
    assert known(sample.flop_index.value) == pytest.approx(known(exact.flop_index.value), rel=2e-3)
    light = {c.aspecular_deg: known(c.L.value) for c in exact.lab if c.theta_i_deg == 45.0}
    assert known(exact.flop_index.value) == pytest.approx(2.69 * (light[15] - light[110]) ** 1.11 / light[45] ** 0.86)


def test_a_solid_colour_has_a_flop_index_of_zero_with_an_uncertainty() -> None:
    waves = np.arange(400.0, 701.0, 20.0)
    frame = measured(Lambert(0.5), plane(45.0, np.array([30.0, 0.0, -65.0])), waves=tuple(waves))
    flop = of_table(frame, name="grey").flop_index
    assert flop.value == pytest.approx(0.0, abs=1e-12)
    light = 116.0 * 0.5 ** (1.0 / 3.0) - 16.0
    # f is known to 1 % without what all values share, at each wavelength apart: Y, its weighted mean, to less
    parts = colour.weights(waves)[:, 1]
    u_rel = 0.01 * math.sqrt(float((parts**2).sum())) / float(parts.sum())
    # L* then to 116/3 (Y/Y_n)^(1/3) u_rel, twice, over L45^0.86
    u_difference = math.sqrt(2.0) * 116.0 / 3.0 * 0.5 ** (1.0 / 3.0) * u_rel
    # the formula's power 1.11 is a line to 15 % between a quarter and twice the step that its slope is taken over
    assert known(flop.u) == pytest.approx(2.69 * u_difference / light**0.86, rel=0.15)


@pytest.mark.parametrize(
    ("waves", "words"), [((550.0,), "has one, 550 nm"), ((450.0, 550.0, 650.0), "has 3, from 450 to 650 nm")]
)
def test_without_a_spectrum_there_is_neither_a_colour_nor_a_lightness(waves: tuple[float, ...], words: str) -> None:
    """One wavelength of a metal near its mirror direction had L* = 192."""
    directions = plane(45.0, np.array([60.0, 30.0, 0.0, -65.0]))
    sample = of_table(
        measured(HeTorrance(sigma0_um=0.28, tau_um=1.77, ior="Al"), directions, waves=waves), name="metal"
    )
    for c in sample.lab:
        assert c.L.value is c.a.value is c.b.value is None
        assert "steps of at most 20 nm" in known(c.L.why)
        assert known(c.L.why).endswith(words)
    assert known(sample.flop_index.why) == known(sample.lab[0].L.why)
    (row,) = (one for one in listed(sample) if "L*" in one.label)
    assert row.value == "–"
    assert row.remark.endswith(words)


def test_a_lightness_above_that_of_white_is_explained() -> None:
    sample = of_model(HeTorrance(sigma0_um=0.28, tau_um=1.77, ior="Al"), name="metal")
    above = [c for c in sample.lab if known(c.L.value) > 100.0]
    assert {(c.theta_i_deg, c.aspecular_deg) for c in above} >= {(45.0, 15.0), (45.0, -15.0)}
    for c in sample.lab:
        assert (c.L.note is not None) == (c in above)
    assert all("brighter than a perfect white diffuser" in known(c.L.note) for c in above)
    # 116 (Y/Y_n)^(1/3) - 16 of a surface whose radiance factor is above 1
    assert known(sample.lab[1].L.value) > 116.0 * 1.0 - 16.0


@pytest.mark.parametrize("nm", [float("nan"), 3500.0])
def test_what_is_not_known_to_be_visible_has_no_lightness(nm: float) -> None:
    frame = measured(Lambert(0.5), plane(45.0, np.array([30.0, 0.0, -65.0])))
    frame["wavelength_nm"] = nm
    sample = of_table(frame, name="infrared")
    for c in sample.lab:
        assert c.L.value is None
        assert "a colour needs a spectrum" in known(c.L.why)
        assert known(c.L.why).endswith("states none" if math.isnan(nm) else "has one, 3500 nm")
    assert any("visible light" in note for note in sample.notes)


def test_a_white_that_sends_light_back() -> None:
    first = of_table(measured(Lambert(0.9), plane(4.0, np.arange(-6.0, 6.1, 0.5))), name="white").retroreflection[0]
    cosines = math.cos(math.radians(4.0)) * math.cos(math.radians(4.2))
    assert known(first.R_A.value) == pytest.approx(0.9 / math.pi * cosines, rel=1e-9)
    assert known(first.R_L.value) == pytest.approx(0.9 / math.pi * math.cos(math.radians(4.0)), rel=1e-9)


def test_what_the_angles_do_not_give_is_null_and_says_why() -> None:
    sample = of_table(measured(Lambert(0.9), plane(30.0, np.array([20.0, 30.0, 40.0]))), name="white")
    for key, q in named(sample):
        assert q.value is None, key
        assert q.u is None
        assert known(q.why), key
    assert "no in-plane curve at 20°" in known(sample.gloss_20_gu.why)
    assert sample.haze_gu.why == sample.gloss_60_gu.why


def test_a_table_without_uncertainties_states_none() -> None:
    frame = measured(Lambert(0.9), swept(60.0)).drop(columns="s_reference")
    frame[["u_brdf", "u_random"]] = np.nan
    sample = of_table(frame, name="white")
    assert known(sample.gloss_60_gu.value) > 0.0
    assert sample.gloss_60_gu.u is None


def test_haze_of_a_matt_surface_is_none() -> None:
    haze = of_model(Lambert(0.9), name="white").haze_gu
    assert haze.value is haze.u is haze.error is None
    assert "above 70 GU" in known(haze.why)


@pytest.mark.parametrize(
    "metal",
    [
        HeTorrance(sigma0_um=0.05, tau_um=5.0, ior="Al"),
        HeTorrance(sigma0_um=0.02, tau_um=3.0, ior="Cu"),
        HeTorrance(sigma0_um=0.0, tau_um=1.0, ior=2.4),  # no metal, but off the scale of the standard glass as well
    ],
    ids=("aluminium", "copper", "diamond"),
)
def test_haze_of_a_metal_is_none(metal: Model) -> None:
    """The difference of two glosses far above that of glass was -132, and -453 of another metal."""
    for sample in (of_model(metal, name="metal"), of_table(measured(metal, swept(20.0, 60.0)), name="metal")):
        assert known(sample.gloss_20_gu.value) > known(sample.gloss_60_gu.value)  # else there is nothing to refuse
        assert sample.haze_gu.value is None
        assert "non-metals" in known(sample.haze_gu.why)
    assert known(of_model(metal, name="metal").haze_e430_20.value) >= 0.0  # which is a flux, and has no such limit


@pytest.mark.slow
def test_the_uncertainty_of_a_fit_is_that_of_its_parameters() -> None:
    result = fit(noisy(measured(PAINT, swept(20.0, 60.0)), np.random.default_rng(3)), "he-torrance", ior=1.5)
    stated = of_fit(result, name="paint")
    rng, at = np.random.default_rng(5), known(level(result))  # with n given the model has no level of its own
    levels = rng.normal(0.0, at.u, 60)
    drawn = rng.multivariate_normal(result.vector, result.spread, 60) - np.outer(levels, result.spread @ at.pull)
    values = [
        (1.0 + g) * gloss(result.problem.model(v), GLOSSMETERS[1], 550.0)[0] for g, v in zip(levels, drawn, strict=True)
    ]
    # 60 draws know their scatter to 9 %; three times that
    assert known(stated.gloss_60_gu.u) == pytest.approx(np.std(values, ddof=1), rel=0.27)
    assert known(stated.rho_dh_8.u) > 0.0


def test_a_sum_of_spike_and_base_keeps_the_spike() -> None:
    glass = HeTorrance(sigma0_um=0.0, tau_um=1.0, ior=1.567)
    sample = of_model(Sum((glass, 1.0), (Lambert(0.5), 0.5)), name="coated")
    assert known(sample.gloss_60_gu.value) > 100.0
    assert known(sample.rho_dh_8.value) == pytest.approx(
        0.25 + glass.specular_reflectivity(math.radians(8.0)), rel=1e-6
    )


def test_a_model_without_colour_is_grey_and_said_to_be() -> None:
    grey = of_model(CookTorrance(s=0.5, d=0.5, slopes=((0.2, 1.0),), ior=1.5, diffuse_albedo=0.3), name="grey")
    assert {q.value for key, q in named(grey) if key[:2] in ("a ", "b ")} == {0.0}
    assert any("same at every wavelength" in note for note in grey.notes)
    tinted = of_model(HeTorrance(sigma0_um=0.3, tau_um=1.5, ior=lambda nm: 1.3 + 0.001 * (nm - 400.0)), name="tinted")
    assert not any("same at every wavelength" in note for note in tinted.notes)


def test_a_peak_between_the_values_is_no_lower_bound() -> None:
    """One value of 600 among others of 0.02 made "at least 4.01" of a paint's reflectance."""
    frame = measured(Lambert(0.02 * math.pi), hemisphere(40.0, 10.0, 15.0, 60.0), cone_sr=0.0)
    far = (frame["theta_r_deg"] - 40.0).abs() + (frame["phi_r_deg"] - frame["phi_i_deg"] - 180.0).abs()
    frame.loc[far.idxmin(), ["brdf", "u_brdf", "u_random"]] = [600.0, 6.0, 6.0]
    (rho,) = of_table(frame, name="paint").rho_dh
    assert rho.value is None
    assert "needed" in known(rho.why)
    # the share of the hemisphere that was measured, sin(60)^2; nobody knows how wide the peak is
    assert rho.at_least is None or rho.at_least <= 0.02 * math.pi * 0.75


@pytest.mark.parametrize("albedo", [0.6, 1.0])
def test_what_a_sample_file_knows_of_its_parameters_is_propagated(albedo: float) -> None:
    """A Lambertian sample reflects its albedo at every incidence; at 1, its bound, the slope is of one side."""
    known_of = ParameterUncertainty(parameters=["albedo"], u=[0.02], correlation=[[1.0]])
    sample = SampleDescription(name="matt", model="lambert", parameters={"albedo": albedo}, uncertainty=known_of)
    found = of_sample(sample).rho_dh_8
    assert [known(found.value), known(found.u)] == pytest.approx([albedo, 0.02], rel=1e-6)
    exact = of_sample(sample.model_copy(update={"uncertainty": None})).rho_dh_8
    assert (exact.value, exact.u) == (found.value, None)


def test_of_several_models_the_scatter_among_them_counts() -> None:
    weights, values, u = np.array([0.25, 0.75]), (1.0, 3.0), (0.3, 0.4)
    mean = _mean(weights, [Quantity(v, s, None, "GU") for v, s in zip(values, u, strict=True)])
    assert mean.value == 2.5
    # the models' own variances, and 0.25 x 1.5^2 + 0.75 x 0.5^2 among them
    assert mean.u == pytest.approx(math.sqrt(0.25 * 0.09 + 0.75 * 0.16 + 0.75))
    assert _mean(weights, [Quantity(1.0, 0.1, None, "GU"), Quantity(None, None, None, "GU", "no spike")]).value is None


# ---- gradients of sampled quantities are their difference quotients, value by value ----


def moved(data: Observations, row: int, step: float) -> Observations:
    """The observations with one value changed."""
    brdf: Floats = data.brdf.copy()
    brdf[row] += step
    return replace(data, brdf=brdf)


@pytest.mark.slow
@pytest.mark.parametrize("around", [False, True], ids=("plane", "around"))
def test_gradient_of_gloss(around: bool) -> None:
    directions = plane(60.0, np.arange(0.0, 87.6, 2.5))
    if around:
        directions = np.unique(np.vstack([directions, hemisphere(60.0, 5.0, 10.0)]), axis=0)
    data = observations(measured(PAINT, directions))
    found = sampled.gloss(data, GLOSSMETERS[1])
    strongest = np.argsort(-np.abs(found.gradient) * data.brdf)[:12]
    assert around == bool(np.any(~data.directions.in_plane[strongest]))
    for row in strongest:
        step = 1e-5 * data.brdf[row]
        ahead, behind = (sampled.gloss(moved(data, row, s * step), GLOSSMETERS[1]).value for s in (1.0, -1.0))
        # the logarithm's curvature over a step of 1e-5, and rounding over it
        assert found.gradient[row] == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-5), row


def test_gradient_of_a_reflectance_is_exact() -> None:
    data = observations(measured(PAINT, hemisphere(8.0)))
    (found,) = quantities.reflectances(data).values()
    assert isinstance(found, sampled.Sampled)
    assert found.value == pytest.approx(float(found.gradient @ data.brdf), rel=1e-12)  # linear in every value


def test_reflectance_at_8_degrees_is_that_of_an_even_function_of_the_angle_between_two_others() -> None:
    """rho = a + b theta^2 exactly; what is seen nearer by is taken as it is, and nothing beyond 30 degrees."""

    def known(*degrees: float) -> dict[float, sampled.Sampled | sampled.NotMeasured]:
        rho = {t: 0.3 + 1e-4 * t**2 for t in degrees}
        return {np.radians(t): sampled.Sampled(r, np.array([r, 1.0]), 0.001) for t, r in rho.items()}

    mixed = quantities.reflectance_at_8(known(2.0, 20.0, 60.0))
    assert mixed.value == mixed.gradient[0] == pytest.approx(0.3 + 1e-4 * 64.0)
    assert mixed.error == pytest.approx(0.001 + 1e-4 * (400.0 - 4.0) / 4.0), "a quarter of what lies between"
    assert quantities.reflectance_at_8(known(2.0, 10.4, 20.0)).value == pytest.approx(0.3 + 1e-4 * 10.4**2)
    with pytest.raises(sampled.NotMeasured):
        quantities.reflectance_at_8(known(2.0, 31.0))


def test_a_value_between_two_others_is_linear_and_its_error_what_a_parabola_leaves() -> None:
    x = np.radians([2.0, 5.0, 10.0, 20.0, 35.0])
    f, still, between = 0.2 + 0.3 * x**2, math.radians(30.0), math.radians(7.0)
    every = curves(replace(observations(measured(Lambert(0.9), plane(30.0, np.degrees(x)))), brdf=f))
    line = 0.6 * f[1] + 0.4 * f[2]
    for at in ((still, between), (between, still)):  # by reciprocity, too
        found = sampled.in_plane_value(every, 5, *at)
        assert (found.value, found.error) == pytest.approx((line, line - 0.2 - 0.3 * between**2), rel=1e-9)
        np.testing.assert_allclose(found.gradient, [0.0, 0.6, 0.4, 0.0, 0.0], rtol=1e-9)
    there = sampled.in_plane_value(every, 5, still, float(x[3]))
    assert (there.value, there.error, there.gradient.tolist()) == (f[3], 0.0, [0.0, 0.0, 0.0, 1.0, 0.0])
    with pytest.raises(sampled.NotMeasured, match="no value within 10° of theta_i = 30°, theta_r = 27°"):
        sampled.in_plane_value(every, 5, still, math.radians(27.0))
    ratio = sampled.made_of(lambda a, b: a / b, found, there)
    expected = found.gradient / there.value - found.value / there.value**2 * there.gradient
    np.testing.assert_allclose(ratio.gradient, expected, rtol=1e-8, atol=1e-12)  # differences over a millionth
    assert ratio.error == pytest.approx(found.error / there.value, rel=1e-8)
    both = sampled.mean([found, there])
    assert (both.value, both.error) == pytest.approx((0.5 * (found.value + there.value), 0.5 * found.error))
