"""A page of several samples opens with a line each, and with what tells them apart."""

from pathlib import Path

import pytest
from gonio_analysis.report import make

from gonio import measurement
from gonio.models import build
from tests.gonio_analysis.synthetic import measure


def table(folder: Path, name: str, albedo: float, sigma_deg: float) -> str:
    made = measure(
        build("oren-nayar", {"albedo": albedo, "sigma_deg": sigma_deg}), noise=0.005, seed=len(name), name=name
    )
    measurement.write(made, folder / f"{name}.csv")
    return str(folder / f"{name}.csv")


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_samples_have_a_line_each_and_what_tells_them_apart(tmp_path: Path) -> None:
    specs = [table(tmp_path, "dark", 0.2, 20.0), table(tmp_path, "bright", 0.8, 20.0)]
    page = text_of(make(specs, tmp_path / "out", models=["lambert", "oren-nayar"]))
    assert "The nearest model of each sample" in page
    assert page.index("The nearest model of each sample") < page.index("Every model on every sample")
    (said,) = [part for part in page.split("<p") if "they differ in" in part]
    said = said.partition("</p>")[0]
    assert "By oren-nayar they differ in albedo: 0." in said
    assert "(dark) to 0." in said
    assert "sigma_deg" not in said, "which is the same"
    assert "The brightest value of bright is " in page


@pytest.mark.slow
def test_one_sample_twice_is_not_told_apart(tmp_path: Path) -> None:
    specs = [table(tmp_path, "one", 0.5, 25.0), table(tmp_path, "other", 0.5, 25.0)]
    page = text_of(make(specs, tmp_path / "out", models=["oren-nayar"]))
    assert "By oren-nayar no parameter differs by more than 3 standard uncertainties" in page
