"""The report: self-contained, every number in summary.json, honest about what is missing, and all or nothing."""

import csv
import json
import os
import re
import subprocess
import sys
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_analysis.report import make
from gonio_analysis.report.files import staged
from gonio_analysis.report.text import difference, number, with_u
from gonio_analysis.report.verdict import misfit_words
from gonio_analysis.result_records import MisfitSummary

from gonio import measurement
from gonio.errors import ConfigError, DataError
from gonio.models import build
from tests.gonio_analysis.synthetic import joined, measure

GLOSS = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30})


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two samples: one as a bench measures it, one without mirror directions, uncertainties and a wavelength."""
    folder = tmp_path_factory.mktemp("report")
    good = measure(GLOSS, noise=0.01, reference=0.005, name="good")
    good.loc[3, "flag"] = "blocked"
    measurement.write(good, folder / "good.csv")
    poor = measure(
        GLOSS, incidences=(12.0, 33.0), views=np.arange(-70.0, 71.0, 10.0), wavelength_nm=float("nan"), name="poor <&>"
    )
    poor[["u_brdf", "u_random"]] = np.nan
    poor.attrs["bands"] = [{"name": "2-5 um", "lower_nm": 2000.0, "upper_nm": 5000.0}]
    measurement.write(poor, folder / "poor.csv")
    make(
        [str(folder / "good.csv"), str(folder / "poor.csv")],
        folder / "out",
        models=["lambert", "phong", "he-torrance"],
        command="gonio compare",
        png=True,
    )
    return folder / "out"


def summary(report: Path) -> dict[str, Any]:
    def no_constant(text: str) -> float:
        raise AssertionError(f"{text} is not JSON")

    return json.loads((report / "summary.json").read_text(encoding="utf-8"), parse_constant=no_constant)


def page(report: Path) -> str:
    return (report / "index.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_page_needs_no_other_file(report: Path) -> None:
    html = page(report)
    assert "<svg" in html
    assert not re.findall(r'(?:src|href)\s*=\s*"(?!#|data:)[^"]*"', html)
    assert not re.findall(r"url\((?!#|data:)", html)
    assert "@import" not in html
    assert not re.findall(r"fetch\(|XMLHttpRequest|import\(|https?://(?!www\.w3\.org/)", html)


class Wellformed(HTMLParser):
    VOID = ("meta", "br", "path", "use", "image", "link")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [str(v) for k, v in attrs if k == "id"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [str(v) for k, v in attrs if k == "id"]

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag


def test_page_is_well_formed_with_distinct_ids(report: Path) -> None:
    parser = Wellformed()
    parser.feed(page(report))
    assert not parser.open
    assert len(set(parser.ids)) == len(parser.ids)
    assert "poor &lt;&amp;&gt;" in page(report)


def test_every_figure_has_a_text_alternative_and_files(report: Path) -> None:
    facts = summary(report)
    html = page(report)
    assert html.count("<svg") == len(facts["figures"]) == html.count('role="img" aria-label="')
    for f in facts["figures"]:
        assert f["alt"]
        assert (report / "figures" / f"{f['name']}.svg").stat().st_size > 1000
        assert (report / "figures" / f"{f['name']}.png").read_bytes().startswith(b"\x89PNG")


def test_numbers_of_the_page_are_those_of_the_summary(report: Path) -> None:
    def plain(text: str) -> str:  # a number, its groups of digits and its uncertainty are kept on one line
        return text.replace("\u00a0", " ")

    html = plain(page(report))
    for d in summary(report)["datasets"]:
        for f in d["models"].values():
            for e in f["parameters"].values():
                if not e["fixed"]:
                    assert with_u(e["value"], e["u"]) in html
            if f["reduced_chi_square"] is not None:
                assert plain(number(f["reduced_chi_square"])) in html
            off, ratio = f["misfit"], f["metrics"]["log_ratio"]
            assert plain(escape(difference(ratio) if off is None else misfit_words(MisfitSummary(**off)))) in html
            assert plain(number(f["metrics"]["ngan"])) in html
            assert escape(f["convention"]) in html
    assert len(re.findall(r"<td class=n>([^<]*)</td>", html)) > 20


def test_tables_hold_the_summary(report: Path) -> None:
    facts = summary(report)
    assert sorted(facts["tables"]) == sorted(p.name for p in (report / "tables").iterdir())
    with open(report / "tables" / "parameters.csv", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    for row in rows:
        d = next(d for d in facts["datasets"] if d["name"] == row["sample"])
        assert float(row["value"]) == d["models"][row["model"]]["parameters"][row["parameter"]]["value"]
    with open(report / "tables" / "good-curves.csv", encoding="utf-8") as stream:
        rows = [r for r in csv.DictReader(stream) if r["kind"] == "measured" and r["model"] == "phong"]
    at_mirror = [r for r in rows if r["curve"] == "θi = 30°" and r["signed_angle_deg"] == "30.0"]
    assert float(at_mirror[0]["normalised"]) == 1.0
    intervals = facts["datasets"][0]["choice"]["intervals"]
    with open(report / "tables" / "good-profiles.csv", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert {r["parameter"] for r in rows} == set(intervals)
    assert len(rows) == sum(len(i["profile"]["values"]) for i in intervals.values())


def test_what_is_missing_is_said(report: Path) -> None:
    good, poor = summary(report)["datasets"]
    assert (good["left_out"], good["curves_without_mirror"]) == ({"flagged blocked": 1}, [])
    assert {c["normalised_by"] for c in good["models"]["phong"]["curves"]} == {"mirror"}
    assert poor["uncertainty_stated"] is False
    assert poor["wavelength_nm"] is None
    assert poor["curves_without_mirror"] == [12.0, 33.0]
    assert {c["normalised_by"] for c in poor["models"]["phong"]["curves"]} == {"max"}
    assert "--wavelength-nm" in poor["skipped"]["he-torrance"]
    html = page(report)
    for words in (
        "mirror direction was not measured",
        "none stated",
        "--wavelength-nm",
        "largest in-plane value",
        "Sparse plane",
    ):
        assert words in html


def test_truth_is_the_best_model_and_not_rejected(report: Path) -> None:
    good = summary(report)["datasets"][0]
    assert good["best"] == "phong"
    assert good["models"]["phong"]["p_value"] > 0.001
    assert good["models"]["lambert"]["verdict"].startswith("rejected")
    assert [b["cause"] for b in good["budget"]] == ["combined", "random (independent)", "reference"]
    assert good["budget"][2]["median"] == pytest.approx(0.005, rel=1e-12)  # through a CSV, with all digits


def test_a_spectrum_in_one_direction_is_reported_without_a_model(tmp_path: Path) -> None:
    """One value a wavelength, as BiRD's own example has it: no model follows from it, but the values are shown."""
    one = measure(build("lambert", {"albedo": 0.5}), incidences=(0.0,), views=np.array([10.0]), noise=0.0, floor=0.0)
    rows = [one.assign(wavelength_nm=nm, brdf=one["brdf"] * share) for nm, share in ((550.0, 1.0), (650.0, 1.2))]
    table = joined(*rows)
    table[["u_brdf", "u_random"]] = np.nan
    measurement.write(table, tmp_path / "spectrum.csv")
    make([str(tmp_path / "spectrum.csv")], tmp_path / "out", models=["lambert", "oren-nayar"], command="gonio compare")
    found = summary(tmp_path / "out")["datasets"][0]
    assert (found["models"], set(found["skipped"])) == ({}, {"lambert", "oren-nayar"})
    assert [v["brdf"] for v in found["values"]] == pytest.approx([0.5 / np.pi, 0.6 / np.pi], rel=1e-12)  # all digits
    text = page(tmp_path / "out")
    assert "No model was fitted. lambert could not be fitted (nor 1 with more parameters): 1 usable value" in text
    assert ">0.5<" in text or ">0.5000<" in text  # pi f
    assert ">0.6<" in text or ">0.6000<" in text


def test_failure_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "bad.csv").write_text("a,b,c\n1,2,3\n")
    with pytest.raises(DataError):
        make([str(tmp_path / "bad.csv")], tmp_path / "deep" / "out", models=["lambert"])
    with pytest.raises(ZeroDivisionError), staged(tmp_path / "other" / "out") as stage:
        (stage.work / "half.html").write_text(str(1 / 0))
    assert [p.name for p in tmp_path.iterdir()] == ["bad.csv"]


def test_what_a_killed_process_left_is_tidied_up(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        pass
    begun, moved = tmp_path / f".out.{gone.pid}.x1.part", tmp_path / f".out.{gone.pid}.x2.old"
    others = [tmp_path / f".out.{os.getpid()}.x3.part", tmp_path / f".out2.{gone.pid}.x4.part", tmp_path / ".out.part"]
    for folder in (begun, moved / "report", *others):
        folder.mkdir(parents=True)
    (moved / "report" / "index.html").write_text("the earlier one")
    with pytest.raises(ZeroDivisionError), staged(tmp_path / "out"):
        raise ZeroDivisionError
    assert sorted(tmp_path.iterdir()) == sorted([tmp_path / "out", *others])
    assert (tmp_path / "out" / "index.html").read_text() == "the earlier one"


def test_unwritable_folder_is_one_message(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(ConfigError, match=re.escape(str(out))), staged(out):
            pass


def test_a_full_disk_is_one_message_and_leaves_nothing(tmp_path: Path) -> None:
    with (
        pytest.raises(ConfigError, match=r"report: cannot be written: No space left"),
        staged(tmp_path / "new" / "report"),
    ):
        raise OSError(28, "No space left on device")  # as a write says it, without a file name
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("value", "u", "text"),
    [
        (0.28074, 0.00047, "0.28074 ± 0.00047"),
        (1234.5, 67.0, "1\u00a0234 ± 67"),
        (12345.0, 678.0, "12\u00a0340 ± 680"),
        (0.5, 0.0, "0.50000"),
        (0.5, None, "0.500 (not determined)"),
        (-0.25, 0.1, "−0.25 ± 0.10"),
        (1.709e-5, 2.4e-7, "(1.709 ± 0.024) × 10⁻⁵"),
        (4e-8, 2.5e-7, "(0.4 ± 2.5) × 10⁻⁷"),
        (0.0, 3e-7, "0 ± 3.0 × 10⁻⁷"),
        (0.163717, 0.0000999, "0.16372 ± 0.00010"),  # two digits after rounding, not three
        (-0.0004, 5.0, "0.0 ± 5.0"),
        (3.2e9, 4.1e7, "(3.200 ± 0.041) × 10⁹"),
    ],
)
def test_values_are_rounded_to_their_uncertainty(value: float, u: float | None, text: str) -> None:
    assert with_u(value, u) == text


def test_interactive_data_are_the_table(report: Path) -> None:
    html = page(report)
    for slug, wave in (("good", 550.0), ("poor", None)):
        found = re.search(rf'<script type="application/json" id="{slug}-viewer-data">(.*?)</script>', html)
        assert found
        view = json.loads(found[1])
        assert [w["nm"] for w in view["waves"]] == [wave]
        assert view["models"] == ["lambert", "phong", "he-torrance"][: len(view["models"])]
        embedded = [
            (c["label"], s["name"], a, b)
            for c in view["waves"][0]["curves"]
            for s in c["series"]
            for a, b in zip(s["angle"], s["brdf"], strict=True)
        ]
        with open(report / "tables" / f"{slug}-interactive.csv", encoding="utf-8") as stream:
            rows = [
                (r["curve"], r["series"], float(r["signed_angle_deg"]), float(r["brdf"]))
                for r in csv.DictReader(stream)
            ]
        assert embedded == rows
        assert {s["name"] for c in view["waves"][0]["curves"] for s in c["series"]} == {"measured", *view["models"]}


# ---- a page of several samples opens with a line each, and with what tells them apart ----


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
    lead = page[page.index('<p class="lead">') :].partition("</p>")[0].replace("\u00a0", " ")
    found = re.search(r"bright is ([\d.]+) times as bright as dark at all angles", lead)
    assert found
    assert 4.0 < float(found[1]) < 4.5  # interreflection adds a little to the four times of the albedo
    assert "they differ beyond their uncertainties" in lead
    items = [part.partition("</li>")[0] for part in page.split("<li")[1:]]
    (said,) = [part for part in items if "they differ in" in part]
    assert "albedo" in said
    assert "sigma_deg" not in said, "which is the same"
    assert 'id="page.samples-viewer"' in page


@pytest.mark.slow
def test_one_sample_twice_is_not_told_apart(tmp_path: Path) -> None:
    specs = [table(tmp_path, "one", 0.5, 25.0), table(tmp_path, "other", 0.5, 25.0)]
    page = text_of(make(specs, tmp_path / "out", models=["oren-nayar"]))
    assert "other does not differ from one beyond their uncertainties" in page.replace("\u00a0", " ")
