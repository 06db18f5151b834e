"""Every page has the frame of docs/page.md: verdict, picture, table, folds with results; it fits the window."""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from gonio_analysis import report
from gonio_analysis.report import appearance, change, html, laboratories
from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Footer,
    Group,
    Page,
    Paragraph,
    PixelViewer,
    Table,
    Viewer,
    plain,
    stamp,
)
from gonio_analysis.report.drawing import Figure
from gonio_maps.report import map_change, map_page
from gonio_validation import papers, verify
from gonio_validation.bench import results_page, timing
from gonio_validation.bench.quantity import QuantitySummary, TimeSummary, WaySummary
from gonio_validation.bench.which_model import Candidate, Compared
from gonio_validation.papers import figure_page
from gonio_validation.papers.figure import Claim
from gonio_validation.papers.pictures import catalogue
from gonio_validation.papers.pictures import page as pictures
from gonio_validation.verify.finding import Finding
from gonio_watch import serving as watching

from gonio import measurement
from gonio.geometry import direction
from gonio.lab.live.alignment import AlignmentPage
from gonio.lab.live.server import Request
from gonio.look import part
from gonio.models import build
from tests.browser import CHROMIUM
from tests.browser import Page as Tab
from tests.command_line import some
from tests.gonio_analysis.changes.test_laboratories import measured
from tests.gonio_analysis.synthetic import measure
from tests.gonio_maps.map_files import fits, values

SAMPLE = 'name = "gloss"\nmodel = "phong"\n[parameters]\nk_d = 0.3\nk_s = 0.5\nexponent = 30\n'
SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 400 300"><rect width="400" height="300"/></svg>'
MADE: dict[str, Any] = dict(stamp("gonio"))


def drawing(name: str, kind: str = "") -> Figure:
    return Figure(name, kind, "", f"{name}: a drawing.", "a drawing", SVG, b"")


def tables(folder: Path, *, uncertain: bool = True) -> list[str]:
    """Two measurements of one sample, the second one darker."""
    gloss = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30})
    out = []
    for name, factor, seed in (("before", 1.0, 5), ("after", 0.62, 6)):
        frame = measure(gloss, noise=0.01, reference=0.005, seed=seed, name=name)
        frame["brdf"] *= factor
        if uncertain:
            measurement.write(frame, folder / f"{name}.csv")
        else:
            stated = [c for c in frame.columns if c.startswith(("u_", "s_"))]
            frame.drop(columns=stated).to_csv(folder / f"{name}.csv", index=False)
        out.append(str(folder / f"{name}.csv"))
    return out


def one_sample(folder: Path) -> object:
    return report.make(tables(folder)[:1], folder / "out", models=["lambert", "phong"])


def two_sides(folder: Path) -> object:
    return change.make(tables(folder), folder / "out")


def two_with_a_zero(folder: Path) -> object:
    rng = np.random.default_rng(3)
    for name, zero in (("before", 0.0), ("after", 2.0)):
        measurement.write(measured(rng, zero_deg=zero), folder / f"{name}.csv")
    return change.make([str(folder / "before.csv"), str(folder / "after.csv")], folder / "out")


def two_that_state_nothing(folder: Path) -> object:
    return change.make(tables(folder, uncertain=False), folder / "out")


def two_that_are_one(folder: Path) -> object:
    return change.make(tables(folder)[:1] * 2, folder / "out")


def three_laboratories(folder: Path) -> object:
    rng = np.random.default_rng(15)
    for name, one in {"A": measured(rng), "B": measured(rng), "C": measured(rng, scale=1.06)}.items():
        measurement.write(one, folder / f"{name}.csv")
    return laboratories.make([str(folder / f"{name}.csv") for name in "ABC"], folder / "out")


def appearance_of_a_model(folder: Path) -> object:
    (folder / "gloss.toml").write_text(SAMPLE, encoding="utf-8")
    return appearance.make(appearance.of(str(folder / "gloss.toml")), folder / "out")


def fitted(folder: Path, name: str, by: float = 0.0) -> Path:
    albedo = 0.2 + 0.03 * np.arange(20.0) + 0.0 * np.arange(12.0)[:, None]
    albedo[:4] += by
    u = np.full(albedo.shape, 0.01)
    attrs = {"parameters": {"albedo": "1", "sigma_deg": "deg"}}
    known, uncertain = {"albedo": albedo, "sigma_deg": 5.0 + 0.0 * albedo}, {"albedo": u, "sigma_deg": u}
    return fits(folder / f"{name}.h5", known, uncertain, model="oren-nayar", attrs=attrs)


def a_map_of_fits(folder: Path) -> object:
    return map_page.make(fitted(folder, "a"), folder / "out")


def a_map_of_values(folder: Path) -> object:
    theta_r = np.arange(-60.0, 61.0, 10.0)
    n = theta_r.size
    nominal = np.array([np.full(n, 30.0), np.zeros(n), np.abs(theta_r), np.where(theta_r >= 0, 180.0, 0.0)])
    at, brdf = np.radians(nominal), np.full((5, 8, n), 0.25)
    where = 500 * direction(*at[:2]), 500 * direction(*at[2:])
    return map_page.make(values(folder / "v.h5", brdf, 0.02 * brdf, *where, nominal), folder / "out")


def two_maps(folder: Path) -> object:
    return map_change.make([str(fitted(folder, "a")), str(fitted(folder, "b", 0.2))], folder / "out")


def told_of_verification() -> dict[str, Any]:
    findings = [Finding("digits", True, "0.318", "0.318", "1e-12, relative")]
    part = {"name": "models", "what": "digits", "passed": True, "seconds": 1.0, "findings": findings}
    said = "All 1 checks of 1 parts passed: this installation computes what it should."
    told = {"passed": True, "conclusion": said, "parts": [part], "limits": verify.LIMITS}
    return {"title": "Verification of gonio", **MADE, **told}


def a_verification(folder: Path) -> object:
    return verify.make(folder / "out", told_of_verification())


def a_papers_figure(folder: Path) -> object:
    return papers.make("cook-torrance-4", folder / "out")


def every_papers_figure(folder: Path) -> Page:
    claim = Claim("it falls", False, "it rises", "monotone").summary
    return figure_page.index([{"figure": "cook-torrance-4", "title": "Fig. 4: D", "claims": [claim]}], "gonio figures")


def papers_pictures(folder: Path) -> Page:
    which = catalogue.SHOWN[:2]
    images = {name: np.zeros((40, 60, 3), np.uint8) for shown in which for name, _ in shown.pictures}
    judged = {shown.name: [Claim("it is brighter at the rim", True, "2 times", "above 1")] for shown in which}
    found = {"title": "Pictures", **MADE, "seconds": {"claims": 1.0}}
    return pictures._page(found, which, images, judged, [drawing("plot")])


def told_of_models(ways: int = 1) -> dict[str, Any]:
    time = TimeSummary(best_ns=1.0, median_ns=1.0, processor_ns=1.0, pairs=3, repeats=1)
    way = WaySummary("exact", True, False, "as printed", 1e-12, {}, time, True, False)
    chosen = Compared("clay", [Candidate("Phong", 0.1, 4.0, 0.0, True)], {"Blinn": "too few values"})
    fine = {"points": 3, "holds": True}
    none = dict.fromkeys(("nan", "infinite", "negative"), 0)
    digits = {"expected_digits": 15.0, "achieved_digits": 15.5, "warning": False, "note": ""}
    hard = {"case": "normal incidence", "models": ["phong"], **digits, **none, **fine}
    loose = {"family": "phong", "way": "exact", "stated": 1e-12, "worst": 1e-13, **fine}
    start = {"model": "Phong", "import_s": 0.1, "first_evaluation_s": 0.5, "together_s": 0.6}
    return {
        "title": "Speed and error", **MADE, "quick": True, "machine": timing.machine(), "hard_cases": [hard],
        "tolerances": [loose],
        "ratios": [{"what": "phong", "ratio": 3.0, "of": "processor_ns"}], "which_model": [chosen],
        "families": [QuantitySummary("phong", "Phong", "A lobe.", "pairs", [way] * ways)],
        "hand_over": None, "start_up": [start], "peers": [{"peer": "nobody", "state": "not installed"}],
        "single_calls": [{"model": "phong", "call": "brdf()", "best_us": 1.0, "median_us": 2.0}],
        "reference": {"made_by": "a tool", "with": "60 digits", "grid": "even", "condition": "relative"},
    }  # fmt: skip


def bench_of_models(folder: Path) -> Page:
    return results_page.render(told_of_models(), [replace(drawing("front"), model="phong")])


KINDS: tuple[Callable[[Path], object], ...] = (
    one_sample, two_sides, two_with_a_zero, two_that_state_nothing,
    two_that_are_one, three_laboratories, appearance_of_a_model,
    a_map_of_fits, a_map_of_values, two_maps, a_verification, a_papers_figure, every_papers_figure, papers_pictures,
    bench_of_models,
)  # fmt: skip


class Made(NamedTuple):
    """A page as blocks, and as a file."""

    page: Page
    file: Path


@pytest.fixture(scope="module", params=KINDS, ids=lambda kind: kind.__name__)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Every kind of page, in its smallest form."""
    folder, pages, document = tmp_path_factory.mktemp("page"), list[Page](), html.document

    def kept(page: Page) -> str:
        pages.append(page)
        return document(page)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(html, "document", kept)
        patch.setattr("gonio_validation.papers.pictures.cook_torrance.ambient_as_printed", lambda height: 1.0)
        found = request.param(folder)
    if isinstance(found, Page):
        pages.append(found)
    file = folder / "looked-at.html"
    file.write_text(document(pages[-1]), encoding="utf-8")
    return Made(pages[-1], file)


def within(blocks: tuple[Block, ...]) -> Iterator[Block]:
    """Every block, in order, with what it holds."""
    for block in blocks:
        yield block
        if isinstance(block, Group):
            yield from within(block.blocks)


def sentences(text: str) -> list[str]:
    return [one for one in re.split(r"(?<=[.!?])\s+(?=[A-ZÀ-ÞΑ-Ω])", text) if one]


def test_the_answer_comes_first(made: Made) -> None:
    head, first = made.page.blocks[:2]
    if isinstance(first, Group) and not first.look:  # of one sample the answer begins its section
        first = first.blocks[0]
    assert isinstance(head, Group)
    assert isinstance(first, Group)
    assert (head.tag, first.look) == ("header", "answer")
    inside = [block for block in within(first.blocks) if not isinstance(block, Group) and not block.empty]
    lead = inside[0]
    assert isinstance(lead, Paragraph)
    assert lead.look == "lead"
    assert 1 <= len(sentences(plain(lead.text))) <= 2, plain(lead.text)
    kinds = [type(block) for block in inside]
    drawn = [k for k, kind in enumerate(kinds) if kind in (Figures, Viewer, PixelViewer)]
    listed = [k for k, kind in enumerate(kinds) if kind is Table]
    assert listed or drawn
    assert not drawn or not listed or drawn[0] < listed[0]


def test_what_is_folded_tells_its_result(made: Made) -> None:
    folds = [block for block in within(made.page.blocks) if isinstance(block, Group) and block.tag == "details"]
    assert folds
    for fold in folds:
        assert fold.heading is not None
        assert plain(fold.heading.result).strip(), fold.heading.text
        assert fold.blocks


def test_one_title_and_identifiers_of_their_own(made: Made) -> None:
    text = made.file.read_text(encoding="utf-8")
    assert text.count("<h1>") == 1
    named = re.findall(r'<[a-z][^>]* id="([^"]+)"', text)
    assert len(named) == len(set(named)), sorted(name for name in named if named.count(name) > 1)
    inner = {target for target in re.findall(r'href="#([^"]+)"', text)}
    assert inner <= set(named)


def test_the_foot_names_files_that_are_there(made: Made) -> None:
    folder = made.file.parent / "out"
    if not folder.exists():
        pytest.skip("made without its files")
    foot = made.page.blocks[-1]
    assert isinstance(foot, Footer)
    text = plain(foot.text)
    named = re.findall(r"[\w/.-]+(?:\.(?:json|csv|toml|txt|h5)|/)(?=[\s.,;]|$)", text)
    assert named
    assert [name for name in named if not (folder / name).exists()] == []
    assert ("PNG" in text) == bool(list(folder.rglob("*.png")))


def test_a_comparison_has_one_factor(tmp_path: Path) -> None:
    """0.62 was made; the page once said another one beside it, by other weights."""
    two_sides(tmp_path)
    text = (tmp_path / "out" / "index.html").read_text(encoding="utf-8").replace("\u00a0", " ")
    words = re.sub(r"<[^>]+>|\s+", " ", re.sub(r"(?s)<(script|style|svg)\b.*?</\1>", "", text))
    stated = re.findall(r"common factor of B over A(?: is)? +([\d.]+) ± ([\d.]+)", words)
    assert len(stated) >= 2  # in the verdict and in the table
    assert len(set(stated)) == 1
    assert abs(float(stated[0][0]) - 0.62) < 4 * float(stated[0][1])
    assert not re.search(r"divided by [\d.]", words)


@pytest.mark.parametrize(
    ("page", "picture"),
    [
        (lambda: watching.page("nonce"), 'id="curves"'),
        (lambda: some(AlignmentPage().routes["/"](Request({}, "nonce"))).body, 'id="picture"'),
    ],
    ids=["watch", "alignment"],
)
def test_live_pages_have_the_frame_too(page: Callable[[], bytes], picture: str) -> None:
    """They fill themselves, so that their texts are looked at; their own tests look at them in a window."""
    whole = page().decode()
    assert "{{" not in whole.partition("</head>")[0]
    assert all(rule in whole for rule in (part("style.css"), part("live.css"), part("page.js")))
    text = whole.partition("<body>")[2].partition("<script")[0]
    parts = ("<h1", "</header>", 'class="answer"', 'class="lead"', picture, "<table", "<details", "<footer")
    assert [text.count(one) for one in parts[:4]] == [1, 1, 1, 1]
    at = [text.index(one) for one in parts]
    assert at == sorted(at)
    folds = re.findall(
        r"<details[^>]*>\s*<summary><h3>[^<]+</h3><span class=\"result\"[^>]*>[^<]+</span></summary>", text
    )
    assert len(folds) == text.count("<details")
    named = re.findall(r' id="([^"]+)"', text)
    assert len(named) == len(set(named))


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not rendered")
def test_it_fits_the_window_without_complaints(made: Made, tab: Tab) -> None:
    tab.complaints.clear()
    for width in (1280, 390):
        tab.open(made.file, width)
        for opened in ("false", "true"):
            tab.run(f"document.querySelectorAll('details').forEach((fold) => {{ fold.open = {opened}; }})")
            assert tab.run("document.documentElement.scrollWidth") <= width, (width, opened)
        told, listed = (
            tab.run(f"[...new Set([...document.querySelectorAll('{which}')].map((x) => x.textContent.trim()))].sort()")
            for which in (".term", ".terms dt")
        )
        assert listed == told  # what is explained at a touch stands at the end of the paper
    assert tab.complaints == []
