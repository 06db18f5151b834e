"""The page of one sample as a reader meets it: the answer on the first screen, all else folded, in a real browser."""

import re
from pathlib import Path

import pytest
from gonio_analysis.report import make

from gonio import measurement
from gonio.models import build
from tests.browser import CHROMIUM, Page
from tests.gonio_analysis.synthetic import measure

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the report is not rendered")

MOST_WORDS, MOST_PIXELS = 1200, 4500
"""What a page of one sample at one wavelength shows before anything is unfolded."""
DRAWN = "[...document.querySelectorAll('tr.drawn')].map(e => e.dataset.draws)"
CHOSEN = "[...document.querySelectorAll('[data-key=series]:checked')].map(e => e.value)"
OPEN = "[...document.querySelectorAll('details[open]')].map(e => e.id)"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    gloss = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30})
    measurement.write(measure(gloss, noise=0.01, reference=0.005, name="gloss"), folder / "gloss.csv")
    make([str(folder / "gloss.csv")], folder / "out", models=["lambert", "phong", "oren-nayar"])
    return folder / "out" / "index.html"


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_the_first_screen_has_verdict_plot_and_on_a_desk_the_table(
    report: Path, tab: Page, width: int, height: int
) -> None:
    tab.open(report, width, height)
    ends = {
        name: tab.run(f"document.querySelector('{selector}').getBoundingClientRect().bottom")
        for name, selector in (("verdict", ".lead"), ("plot", ".viewer .stage svg"), ("table", "table.picks"))
    }
    assert ends["verdict"] < ends["plot"] < height
    assert ends["table"] < height or width < 600
    assert tab.run("document.documentElement.scrollWidth") <= width
    assert len(re.findall(r"[.!?](?= [A-Z]|$)", tab.run("document.querySelector('.lead').innerText"))) <= 2


@pytest.mark.parametrize("width", [1280, 390])
def test_little_is_shown_before_anything_is_unfolded(report: Path, tab: Page, width: int) -> None:
    tab.open(report, width)
    assert tab.run("document.body.innerText.split(/\\s+/).length") <= MOST_WORDS
    assert tab.run("document.documentElement.scrollHeight") <= MOST_PIXELS
    assert tab.run("document.querySelectorAll('details:not([open])').length") >= 6
    empty = "[...document.querySelectorAll('details')].filter(e => !e.querySelector('.result')).map(e => e.id)"
    assert tab.run(empty) == [], "each fold carries its result"


def test_a_row_of_the_table_draws_its_model(report: Path, tab: Page) -> None:
    tab.open(report, 1280)
    assert tab.run(DRAWN) == ["phong"]
    tab.run("document.querySelector('tr[data-draws=lambert] td').click()")
    assert tab.run(DRAWN) == ["lambert"]
    assert tab.run(CHOSEN) == ["measured", "lambert"]
    tab.run("document.querySelector('tr[data-draws=oren-nayar] button').focus()")
    tab.press("Enter")
    tab.run("document.activeElement.click()")  # what Enter does to a button outside of a headless browser
    assert tab.run(DRAWN) == ["oren-nayar"]
    pressed = "[...document.querySelectorAll('table.picks button')].map(e => e.getAttribute('aria-pressed'))"
    assert sorted(tab.run(pressed)) == ["false", "false", "true"]
    assert tab.complaints == []


def test_the_address_keeps_what_a_reader_chose(report: Path, tab: Page) -> None:
    tab.open(report, 1280)
    assert tab.run("location.hash") == ""
    tab.run("document.querySelector('tr[data-draws=lambert] td').click()")
    tab.run("document.getElementById('gloss.checks').open = true")
    tab.run(
        "(s => { s.value = 'log'; s.dispatchEvent(new Event('change')); })(document.querySelector('[data-key=plot]'))"
    )
    tab.until("location.hash.includes('folds=') && location.hash.includes('log')")
    address = tab.run("location.href")
    tab.open("about:blank", 1280)
    tab.open(address, 1280)
    assert tab.run(DRAWN) == ["lambert"]
    assert tab.run(OPEN) == ["gloss.checks"]
    assert tab.run("document.querySelector('[data-key=plot]').value") == "log"
    assert "mirror side positive" in tab.run("document.querySelector('.viewer .stage svg').textContent")
    tab.run("document.querySelector('tr[data-draws=phong] td').click()")
    tab.run(
        "(s => { s.value = 'polar'; s.dispatchEvent(new Event('change')); })(document.querySelector('[data-key=plot]'))"
    )
    tab.run("document.getElementById('gloss.checks').open = false")
    tab.until("location.hash === ''")


@pytest.mark.parametrize(
    "rubbish", ["#x=1", "#folds=no-such", "#gloss-viewer=a_b_99_x_y", "#gloss-viewer=", "#%", "#a%20b"]
)
def test_an_address_of_rubbish_shows_the_page_as_it_is(report: Path, tab: Page, rubbish: str) -> None:
    tab.open("about:blank", 1280)
    tab.open(report.resolve().as_uri() + rubbish, 1280)
    assert tab.run(DRAWN) == ["phong"]
    assert tab.run(OPEN) == []
    assert tab.complaints == []


def test_a_link_opens_the_folds_around_its_place(report: Path, tab: Page) -> None:
    tab.open("about:blank", 1280)
    tab.open(report.resolve().as_uri() + "#gloss.checks", 1280)
    assert tab.run(OPEN) == ["gloss.checks"]


def test_on_paper_all_folds_are_open_and_the_drawing_stands_for_the_plot(report: Path, tab: Page) -> None:
    tab.open("about:blank", 1280)
    tab.open(report, 1280)
    tab.send("Emulation.setEmulatedMedia", media="print")
    assert tab.run("getComputedStyle(document.querySelector('.printed')).display") == "grid"
    tab.run("dispatchEvent(new Event('beforeprint'))")
    assert tab.run("document.querySelectorAll('details:not([open])').length") == 0
    tab.run("dispatchEvent(new Event('afterprint'))")
    tab.send("Emulation.setEmulatedMedia", media="")
    assert tab.run(OPEN) == []
    assert tab.run("location.hash") == ""
    assert tab.run("getComputedStyle(document.querySelector('.printed')).display") == "none"
    pages = len(re.findall(rb"/Type\s*/Page\b", tab.pdf()))
    assert pages >= 4, "the folds are printed: what is open at first fills two pages"


def test_a_term_is_explained_by_the_keyboard(report: Path, tab: Page) -> None:
    tab.open("about:blank", 1280)
    tab.open(report, 1280)
    assert tab.run("document.querySelector('.meaning').hidden")
    tab.run("document.querySelector('th .term').focus()")
    assert not tab.run("document.querySelector('.meaning').hidden")
    assert len(tab.run("document.querySelector('.meaning').innerText")) > 20
    tab.press("Escape")
    assert tab.run("document.querySelector('.meaning').hidden")
