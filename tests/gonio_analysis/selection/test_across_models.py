"""What models say of several samples: only such as describe all of them about as well as the nearest to each."""

from dataclasses import replace

import pytest
from gonio_analysis.report.across_plot import draw, view
from gonio_analysis.report.comparison import summarise
from gonio_analysis.result_records import as_json
from gonio_analysis.selection.across_models import across_models, remedy
from gonio_analysis.selection.compare import Dataset, examine

from gonio.models import build
from tests.gonio_analysis.synthetic import known, measure

pytestmark = pytest.mark.slow


def sample(name: str, model: object, seed: int, *models: str) -> Dataset:
    return examine(measure(model, seed=seed, floor=1e-5), models, name=name, source=f"{name}.csv")


@pytest.fixture(scope="module")
def paints() -> list[Dataset]:
    made = {"dark": 0.2, "bright": 0.6}
    return [sample(name, build("lambert", {"albedo": albedo}), k, "lambert", "phong")
            for k, (name, albedo) in enumerate(made.items())]  # fmt: skip


def test_parameters_of_a_model_that_holds_for_both_are_compared(paints: list[Dataset]) -> None:
    found = across_models(paints)
    lambert = found.shared[0]
    assert lambert.label == "lambert"
    (albedo,) = lambert.apart
    assert (albedo.name, albedo.low, albedo.high) == ("albedo", "dark", "bright")
    assert albedo.value_low == pytest.approx(0.2, abs=4 * albedo.u_low)
    assert found.words[0].startswith("By lambert, which describes both about as well as the nearest model does,")
    assert "albedo: 0.2" in found.words[0]


def test_a_model_that_is_far_from_one_of_them_compares_nothing(paints: list[Dataset]) -> None:
    glossy = sample("glossy", build("phong", {"k_d": 0.2, "k_s": 2.0, "exponent": 60.0}), 5, "lambert", "phong")
    found = across_models([paints[0], glossy])
    assert "lambert" not in [one.label for one in found.shared]
    if not found.shared:
        assert "No model describes both samples" in found.words[0]


def test_a_metal_with_a_free_index_has_a_remedy() -> None:
    gold = build("cook-torrance", {"s": 1.0, "d": 0.0, "m": 0.3, "diffuse_albedo": 0.0, "ior": 20.0})
    leaf = sample("gold leaf", gold, 1, "cook-torrance")
    if leaf.models["cook-torrance"].fit.parameters["ior"].value > 3.0:
        (one,) = across_models([leaf, leaf]).remedies[:1]
        assert "--ior gold leaf.csv=Au takes the index of Au" in one.words
    given = examine(leaf.table, ["cook-torrance"], name="gold leaf", source="gold leaf.csv", ior="Au")
    assert across_models([given, given]).remedies == []


def test_an_index_that_is_not_known_is_not_called_a_metals(paints: list[Dataset]) -> None:
    """n = 7 with u = 27 "reflects as a metal does", beside a table that said 7 +- 27."""
    gold = build("cook-torrance", {"s": 1.0, "d": 0.0, "m": 0.3, "diffuse_albedo": 0.0, "ior": 20.0})
    leaf = sample("leaf", gold, 1, "cook-torrance")
    fitted = leaf.models["cook-torrance"]
    for n, u, words in (
        (7.0, 27.0, "n = 7 ± 27 with k = 0 may stand for"),
        (7.0, 1.0, "n = 7.0 ± 1.0 with k = 0 refl"),
    ):
        known_to = replace(fitted.fit.parameters["ior"], value=n, u=u)
        fit = replace(fitted.fit, parameters={**fitted.fit.parameters, "ior": known_to})
        said = remedy(replace(leaf, models={"cook-torrance": replace(fitted, fit=fit)}))
        assert words in known(said).words


def test_the_summary_and_the_plot_have_all_samples(paints: list[Dataset]) -> None:
    summary = summarise(paints, title="dark and bright", normalise="mirror", command="")
    facts = as_json(summary)["comparison"]
    assert facts["verdict"] == known(summary.comparison).verdict
    assert "bright is 3." in facts["verdict"][0]
    assert facts["across"]["pairs"][0]["beyond"] is True
    assert facts["models"]["shared"][0]["label"] == "lambert"
    shown = known(view(paints))
    assert shown["points"] == shown["chosen"] == ["dark", "bright"]
    assert [s["name"] for s in shown["waves"][0]["curves"][0]["series"]] == ["dark", "bright"]
    assert len(shown["labels"]) == 3
    (drawing,) = draw(paints)
    assert drawing.rendered().svg.startswith("<svg")
