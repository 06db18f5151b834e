"""Published fits in the study `materials`: our names and units, widths, energy; a line that is none is named."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from gonio.errors import DataError
from tests.gonio.models.test_published_fits import low, ngan
from tests.places import measured
from tools.studies import published
from tools.studies.materials import make

LINES = """# comment
a = Aggregate(Lambertian(albedo = [0.1, 0.2, 0.1]), NganCookTorrance(albedo = [0.3, 0.2, 0.1], eta = 0.1, roughness = 0.2))
b = Aggregate(Lambertian(albedo = [0.0, 0.0, 0.0]), NganCookTorrance(albedo = [30, 0.2, 0.1], eta = 0.5, roughness = 0.1))
c = Aggregate(Lambertian(albedo = [0.1, 0.2, 0.1]), NganCookTorrance(albedo = [0.3, 0.2, 0.1], eta = 0.1, roughness = 0.4))

a = Aggregate(Lambertian(albedo = [0.1, 0.2, 0.1]), NganHe(albedo = [2, 1, 1], autocorrelation = 20, roughness = 2, eta = 1.05))
b = Aggregate(Lambertian(albedo = [0.1, 0.2, 0.1]), NganHe(albedo = [2, 1, 1], autocorrelation = 2, roughness = 0.1, eta = 1.5))
c = Aggregate(Lambertian(albedo = [0.1, 0.2, 0.1]), NganHe(albedo = [2, 1, 1], autocorrelation = 10, roughness = 2, eta = 1.5))
a = Aggregate(Lambertian(albedo = [0.1, 0.2, 0.1]), LowCookTorrance(albedo = [0.3, 0.2, 0.1], roughness = 0.2, eta = 1.5))
a = Aggregate(Lambertian(albedo = [0.1, 0.2, 0.1]), NganBlinnPhong(albedo = [0.3, 0.2, 0.1], sharpness = 50.0))
"""  # noqa: E501


def test_the_second_list_stands_on_the_page_and_in_the_results(tmp_path: Path) -> None:
    (tmp_path / "some.fit").write_text(LINES, encoding="utf-8")
    page = make([str(tmp_path / "some.fit")], tmp_path / "out", models=("lambert",), jobs=1)
    found = json.loads((page.parent / "results.json").read_text(encoding="utf-8"))["published"]
    rows = {(m["list"], m["name"]): m["fits"] for m in found["materials"]}
    assert set(rows) == {("Ngan", "a"), ("Ngan", "b"), ("Ngan", "c"), ("Low", "a")}
    facets = rows["Ngan", "a"]["NganCookTorrance"]
    assert facets["diffuse_albedo"] == pytest.approx([0.1, 0.23, 0.166])  # MERL's raw green and blue
    assert facets["weight"] == pytest.approx([0.3 / math.pi, 0.23 / math.pi, 0.166 / math.pi])
    assert (facets["m"], facets["f0"]) == (0.2, 0.1)
    assert rows["Low", "a"]["LowCookTorrance"]["weight"] == [0.3, 0.2, 0.1]
    he = rows["Ngan", "a"]["NganHe"]
    assert he["slope_m"] == pytest.approx(0.2)
    assert he["g_at_550_nm_if_um"] == pytest.approx((4 * math.pi * 2 / 0.55) ** 2)
    assert (found["he_fits"], found["he_with_g_above_18"], found["he_with_level_uncertain_by_a_tenth"]) == (3, 2, 1)
    widths = next(w for w in found["widths"] if w["of"] == "NganHe")
    assert widths["rank_correlation"] == pytest.approx(1.0)
    assert widths["ratio"] == pytest.approx(1.0)
    assert found["energy"]["NganCookTorrance"]["above_1"] == 1, "b is 30/pi times half of four"
    assert rows["Ngan", "b"]["NganCookTorrance"]["reflected"] > 4.0
    text = page.read_text(encoding="utf-8")
    assert "Published fits" in text
    assert "2 of 3 (67" in text


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("a = Lambertian(albedo = [1, 1, 1])", "must read NAME = Aggregate"),
        ("a = Aggregate(Lambertian(albedo = [1, 1]), NganBlinnPhong(albedo = [1, 1, 1], sharpness = 2))", "three"),
        ("a = Aggregate(Lambertian(albedo = [1, 1, 1]), NganWard(albedo = [1, 1, 1], alpha = 2))", '"NganWard"'),
        ("a = Aggregate(Lambertian(albedo = [1, 1, 1]), NganBlinnPhong(albedo = [1, 1, 1], alpha = 2))", "sharpness"),
        ("a = Aggregate(Lambertian(albedo = [1, x, 1]), NganBlinnPhong(albedo = [1, 1, 1], sharpness = 2))", "= x"),
        ("a = Aggregate(Lambertian(albedo = [1, 1, 1]), NganBlinnPhong(albedo = [1, 1, 1], sharpness = 0))", "above 0"),
        ("a = Aggregate(Lambertian(albedo = [2, 1, 1]), LowCookTorrance(albedo = [1, 1, 1], roughness = 1, eta = 2))",
         "albedo"),
    ],
)  # fmt: skip
def test_a_line_that_is_none_is_named_and_nothing_is_written(tmp_path: Path, line: str, said: str) -> None:
    (tmp_path / "bad.fit").write_text(f"# one\n{line}\n", encoding="utf-8")
    with pytest.raises(DataError, match=f"bad.fit: line 2: .*{said}"):
        make([str(tmp_path)], tmp_path / "out", models=("lambert",))
    assert not (tmp_path / "out").exists()


def test_fits_are_the_models_that_reproduce_the_papers_formulas() -> None:
    """`test_published_fits.py` holds those against the formulas."""
    for file, of in (("ngan_cooktorrance.fit", ngan), ("low_cooktorrance_E1.fit", low)):
        for fit in published.read(measured(f"fits/{file}"))[::17]:
            scale = published.LISTS[fit.listed]
            for k in range(3):
                wanted = of(scale[k] * fit.base[k], scale[k] * fit.gloss[k], dict(fit.numbers))
                model = fit.model(k)
                assert model is not None
                value = model.brdf(0.5, 0.0, 0.6, 3.0)
                assert value == pytest.approx(wanted.brdf(0.5, 0.0, 0.6, 3.0), rel=1e-14)  # the same constants
