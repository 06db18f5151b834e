"""Models and sample files whose parameters are spectra: against the plain model at each wavelength."""

from pathlib import Path

import numpy as np
import pytest

from gonio.errors import ConfigError
from gonio.models import GGX, Phong, SpectralModel, Sum, build, examine
from gonio.samples.files import load_model
from gonio.spectra import RGB_NM, at_wavelength

K_D = {"red": 0.5, "green": 0.1, "blue": 0.3}
ANGLES = np.radians([[10.0, 0.0, 40.0, 170.0], [60.0, 20.0, 55.0, 200.0]]).T


@pytest.mark.parametrize(("nm", "k_d"), [(610, 0.5), (550, 0.1), (465, 0.3), (580, 0.3), (380, 0.3), (780, 0.5)])
def test_channels_hold_at_their_nominal_wavelengths_and_beyond_the_outer_ones(nm: float, k_d: float) -> None:
    model = build("phong", {"k_d": K_D, "k_s": 0.2, "exponent": 30.0})
    plain = Phong(k_d=k_d, k_s=0.2, exponent=30.0)
    # 580 nm is in the middle between two channels: a rounding of the sum is all that may differ
    assert model.brdf(*ANGLES, wavelength_nm=nm) == pytest.approx(plain.brdf(*ANGLES), rel=1e-14)
    assert float(model.directional_hemispherical(0.3, wavelength_nm=nm)) == pytest.approx(
        float(plain.directional_hemispherical(0.3)), rel=1e-12
    )


def test_every_way_to_evaluate_gives_the_plain_models_values() -> None:
    waves = np.array([400.0, 500.0, 700.0])
    n, k = [1.5, 0.5, 0.2], [2.0, 2.5, 4.0]
    ior = [{"wavelength_nm": waves.tolist(), "value": part} for part in (n, k)]
    model = build("he-torrance", {"sigma0_um": 0.1, "tau_um": 2.0, "ior": ior})
    assert isinstance(model, SpectralModel)
    plain = [
        build("he-torrance", {"sigma0_um": 0.1, "tau_um": 2.0, "ior": complex(*one)}) for one in zip(n, k, strict=True)
    ]
    expected = np.array([one.brdf(*ANGLES, wavelength_nm=w) for one, w in zip(plain, waves, strict=True)])
    assert np.array_equal(model.brdf(*(a[:, None] for a in ANGLES), wavelength_nm=waves).T, expected)
    assert np.array_equal([model.brdf(*ANGLES, wavelength_nm=w) for w in waves], expected)
    spikes = [one.specular_reflectivity(0.4, wavelength_nm=w) for one, w in zip(plain, waves, strict=True)]
    assert model.has_spike
    assert np.array_equal(model.specular_reflectivity(0.4, wavelength_nm=waves), spikes)
    assert examine(model, 500.0).reflected == examine(plain[1], 500.0).reflected
    assert np.array_equal(model.nodes_nm, waves)
    assert not model.of_channels


def test_a_term_of_a_sum_may_have_channels() -> None:
    model = build("sum", {"lambert": {"albedo": K_D, "weight": 0.5}, "ggx": {"alpha": 0.2, "ior": 1.5}})
    assert isinstance(model, SpectralModel)
    assert model.of_channels
    for channel, nm in RGB_NM.items():
        plain = Sum((build("lambert", {"albedo": K_D[channel]}), 0.5), (GGX(alpha=0.2, ior=1.5), 1.0))
        assert np.array_equal(model.brdf(*ANGLES, wavelength_nm=nm), plain.brdf(*ANGLES))


def test_a_sample_file_has_spectra_and_their_uncertainty(tmp_path: Path) -> None:
    path = tmp_path / "red.toml"
    path.write_text(
        'name = "red"\nmodel = "lambert"\n[parameters]\nalbedo = { red = 0.5, green = 0.1, blue = 0.3 }\n'
        '[uncertainty]\nparameters = ["albedo.red", "albedo.blue"]\nu = [0.01, 0.02]\ncorrelation = [[1, 0], [0, 1]]\n'
    )
    model, sample = load_model(path)
    assert float(model.brdf(0, 0, 0.5, 0, wavelength_nm=610)) == 0.5 / np.pi
    assert at_wavelength(sample.parameters, 550.0) == {"albedo": 0.1}


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ("albedo = { red = 0.5, green = 0.1 }", "albedo: the key blue is missing"),
        ("albedo = { red = 0.5, green = 0.1, bleu = 0.2, blue = 0.1 }", "albedo: unknown key bleu"),
        ("albedo = { red = 0.5, green = 0.1, blue = 1.3 }", "at 465 nm.*albedo = 1.3"),
        ("albedo = { wavelength_nm = [500, 400], value = [0.1, 0.2] }", "albedo.*must grow from entry to entry"),
        ("albedo = { wavelength_nm = [500], value = [0.1, 0.2] }", "albedo.*go together"),
    ],
)
def test_wrong_spectra_are_told_with_file_and_key(tmp_path: Path, parameters: str, message: str) -> None:
    path = tmp_path / "sample.toml"
    path.write_text(f'name = "s"\nmodel = "lambert"\n[parameters]\n{parameters}\n')
    with pytest.raises(ConfigError, match=rf"sample\.toml.*{message}"):
        load_model(path)


def test_a_word_is_no_spectrum(tmp_path: Path) -> None:
    path = tmp_path / "sample.toml"
    path.write_text(
        'name = "s"\nmodel = "blinn"\n[parameters]\ndistribution = { red = 0.1, green = 0.2, blue = 0.3 }\n'
    )
    with pytest.raises(ConfigError, match=r"sample\.toml.*at 465 nm.*distribution = 0\.3: must be one of"):
        load_model(path)


def test_a_wavelength_beyond_a_spectrum_has_no_value() -> None:
    model = build("lambert", {"albedo": {"wavelength_nm": [500.0, 600.0], "value": [0.1, 0.2]}})
    with pytest.raises(ConfigError, match="albedo: a spectrum from 500 to 600 nm has no value at 700 nm"):
        model.brdf(0, 0, 0.5, 0, wavelength_nm=700.0)
