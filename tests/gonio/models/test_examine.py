"""Energy and reciprocity in one line, and where it is said; models in a file that is no package."""

from pathlib import Path

import pytest
from gonio_analysis.appearance.of_models import of_model
from gonio_analysis.selection.compare import examine as compared

from gonio import measurement, models
from gonio.errors import ConfigError
from gonio.models import build, examine
from tests.command_line import gonio
from tests.gonio_analysis.synthetic import facts_of, measure

BRIGHT = models.CookTorrance(s=1.0, m=0.2, ior="Al")
"""The paper's normalisation: four times what falls in, less what grooves and Fresnel take."""
WARD = (Path(__file__).parents[3] / "docs" / "writing_a_model.md").read_text(encoding="utf-8")


def ward(folder: Path) -> str:
    """The class of the page, in a file."""
    (folder / "mine.py").write_text(WARD.partition("```python\n")[2].partition("```")[0], encoding="utf-8")
    return "./mine.py:Ward"


def test_a_model_that_reflects_too_much_is_named_with_number_and_angle() -> None:
    found = examine(BRIGHT)
    assert found.reflected > 3.0
    assert found.too_bright.startswith("cook-torrance reflects 3.")
    assert "deg of incidence" in found.too_bright
    assert "reciprocal; reflects 3." in str(found)
    kept = examine(models.CookTorrance(s=1.0, m=0.2, ior="Al", convention="normalised"))
    assert kept.too_bright == ""
    assert "reflects at most 0.9" in str(kept)


@pytest.mark.parametrize(
    ("model", "wavelength_nm", "words"),
    [
        (models.HeTorrance(sigma0_um=0.3, tau_um=0.1), 550.0, "mean square slope, 2 (sigma0/tau)^2 = 18"),
        (models.HeTorrance(sigma0_um=4400.0, tau_um=1000.0), 550.0, "mean square slope"),  # the paper's sandpaper
        (models.HeTorrance(sigma0_um=0.05, tau_um=0.4), 1600.0, "radius of curvature, tau^2/(2 sqrt(3) sigma0) = 0.92"),
        (models.KCorrelation(sigma_um=0.1, b_um=20.0), 550.0, "has to be smooth"),
    ],
)
def test_outside_its_own_conditions_a_model_says_so(model: models.Model, wavelength_nm: float, words: str) -> None:
    found = examine(model, wavelength_nm)
    assert words in found.outside
    assert words in str(found)
    two = models.Sum((models.Lambert(0.1), 1.0), (model, 0.5))
    assert examine(two, wavelength_nm).outside == found.outside


@pytest.mark.parametrize(
    ("model", "wavelength_nm"),
    [
        (models.HeTorrance(sigma0_um=0.28, tau_um=1.77), 550.0),  # the paper's aluminium
        (models.HeTorrance(sigma0_um=0.05, tau_um=0.4), 550.0),  # outside at 1600 nm alone
        (models.HeTorrance(sigma0_um=0.0), 550.0),
        (models.KCorrelation(sigma_um=0.005), 550.0),
        (models.Lambert(0.5), 550.0),
    ],
)
def test_inside_them_nothing_is_said(model: models.Model, wavelength_nm: float) -> None:
    assert examine(model, wavelength_nm).outside == ""


def test_what_no_parameter_tells_is_said_of_facets_and_of_nothing_else() -> None:
    said = str(examine(models.CookTorrance()))
    assert "holds for facets that are large against the wavelength" in said
    assert "Oren and Nayar" in examine(models.OrenNayar()).assumes
    assert examine(models.Phong()).assumes == ""


@pytest.mark.slow
def test_fit_appearance_and_page_say_where_a_model_is_outside(tmp_path: Path) -> None:
    frame = measure(build("he-torrance", {"sigma0_um": 0.9, "tau_um": 0.8, "ior": 1.5, "diffuse_albedo": 0.2}))
    measurement.write(frame, tmp_path / "t.csv")
    done = gonio(tmp_path, "fit", "t.csv", "--model", "he-torrance", "--ior", "1.5", "--save", "s.toml")
    words = "he-torrance is used outside its validity"
    assert words in " ".join((done.stdout + done.stderr).split())
    done = gonio(tmp_path, "appearance", "s.toml")
    assert words in " ".join((done.stdout + done.stderr).split())
    facts = facts_of(compared(frame, ["he-torrance"], name="steep", ior=1.5))
    assert words in facts.conclusion


def test_phong_is_not_reciprocal() -> None:
    assert "not reciprocal" in str(examine(models.Phong()))


@pytest.mark.parametrize("ending", ["klems.xml", "rgl.bsdf", "merl.binary"])
def test_every_file_of_a_renderer_says_it(tmp_path: Path, ending: str) -> None:
    name, _, suffix = ending.partition(".")
    said = measurement.write_model(BRIGHT, tmp_path / f"bright.{suffix}", name="bright", format=name)
    assert any("cook-torrance reflects 3." in text for text in said)
    said = measurement.write_model(models.EON(), tmp_path / f"eon.{suffix}", name="eon", format=name)
    assert not any("reflects" in text for text in said)


def test_appearance_says_it() -> None:
    assert any("cook-torrance reflects 3." in note for note in of_model(BRIGHT, name="bright").notes)
    assert not any("reflects" in note for note in of_model(models.EON(), name="dull").notes)


@pytest.mark.slow
def test_a_class_in_a_file_is_fitted_saved_and_used(tmp_path: Path) -> None:
    name = ward(tmp_path)
    made = build("ggx", {"alpha": 0.2, "ior": 1.5, "diffuse_albedo": 0.2})
    measurement.write(measure(made), tmp_path / "t.csv")
    done = gonio(tmp_path, "fit", "t.csv", "--model", name, "--save", "ward.toml", expect=0)
    assert "rho_d" in done.stdout + done.stderr
    gonio(tmp_path, "appearance", "ward.toml", expect=0)


def test_what_is_wrong_with_a_file_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ward(tmp_path)
    with pytest.raises(ConfigError, match=r'has no class "Wrad"; it has: Ward'):
        build("./mine.py:Wrad", {})
    with pytest.raises(ConfigError, match="there is no such file"):
        build("./other.py:Ward", {})
    (tmp_path / "broken.py").write_text("1 / 0")
    with pytest.raises(ConfigError, match="ZeroDivisionError"):
        build("./broken.py:Ward", {})


@pytest.mark.slow
def test_the_normalisation_stands_beside_s(tmp_path: Path) -> None:
    measurement.write(measure(models.CookTorrance(s=0.3, m=0.2, ior=1.5, diffuse_albedo=0.3)), tmp_path / "t.csv")
    printed = gonio(tmp_path, "fit", "t.csv", "--model", "cook-torrance", "--ior", "1.5")
    assert "over π, as the paper prints it; over 4π, as today, s would be 4 times this" in " ".join(
        printed.stdout.split()
    )
    more = ("--fix", "convention=normalised")
    true = gonio(tmp_path, "fit", "t.csv", "--model", "cook-torrance", "--ior", "1.5", *more)
    assert "share of R_s over 4π" in " ".join(true.stdout.split())
