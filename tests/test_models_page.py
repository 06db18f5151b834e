"""docs/reference/models_and_parameters.md has every model, and says of its parameters what the code says."""

import re
from pathlib import Path

import pytest
from gonio_analysis.fitting import parameters as fits

from gonio.models import Sum, build
from gonio.models.parameters import described
from gonio.samples.files import load_sample
from tests.places import ROOT
from tests.test_site import tool

TOOL = tool("models_page")
PAGE = (ROOT / "docs" / "reference" / "models_and_parameters.md").read_text(encoding="utf-8")
SAMPLES = TOOL.samples(PAGE)


def test_every_model_has_a_section_with_a_sample_and_a_picture() -> None:
    own = {name for name in fits.known() if fits.kind(name).__module__.startswith("gonio.models")}  # not tests' own
    assert own | {"sum", "diffuse-transmitter"} == set(SAMPLES)
    pictures = {path.stem for path in (ROOT / "docs" / "models").iterdir()}
    assert pictures == set(re.findall(r"\(\.\./models/([\w-]+)\.svg\)", PAGE)) == set(SAMPLES)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_sample_of_the_page_can_be_measured(name: str, tmp_path: Path) -> None:
    path = tmp_path / "sample.toml"
    path.write_text(SAMPLES[name], encoding="utf-8")
    sample = load_sample(path)
    assert sample.model == name
    assert build(name, sample.parameters).brdf(0.3, 0.0, 0.2, 3.0) > 0.0


def test_the_tables_are_what_the_code_says() -> None:
    assert TOOL.with_tables(PAGE) == PAGE, "run python tools/models_page.py"


@pytest.mark.parametrize("name", [*fits.known(), *fits.sums()])
def test_every_parameter_of_a_fit_is_told_in_words(name: str) -> None:
    kinds = [fits.kind(part) for part in fits.parts(name)]
    told = described(*kinds)
    names = dict(fits.family(name).parameters)
    if kinds[0].several_slopes:
        names |= fits.family(name, slopes=2).parameters
    assert all(told.get(one) for one in names), {one: told.get(one) for one in names}


def test_every_argument_of_a_model_is_told_in_words() -> None:
    for name in SAMPLES.keys() - {Sum.name}:
        model = TOOL.model_of(SAMPLES[name])
        assert model.parameters.keys() <= described(type(model)).keys(), name


def test_words_come_from_the_docstring_of_the_class_or_of_its_base() -> None:
    class Own:
        """A model.

        Parameters
        ----------
        width, `other` : float
            Not a name as numpydoc has it.
        width : float
            How wide `it` is,
            in [0, 1].

        Raises
        ------
        ArgumentError
            Never.
        """

    class Derived(Own):
        """Nothing more."""

    for kind in (Own, Derived):
        told = described(kind)
        assert told["width"] == "How wide it is, in [0, 1]."
        assert "ArgumentError" not in told
    assert described(Own)["k"], "what fits name beside them"
