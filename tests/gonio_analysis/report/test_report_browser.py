"""The page of one sample in a real browser: the answer on the first screen, the rest folded; numbers and keyboard."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from gonio_analysis.report import change, make
from PIL import Image

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
OUTPUT = "document.querySelector('.viewer output').textContent"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    gloss = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30})
    measurement.write(measure(gloss, noise=0.01, reference=0.005, name="gloss"), folder / "gloss.csv")
    make([str(folder / "gloss.csv")], folder / "out", models=["lambert", "phong", "oren-nayar"])
    return folder / "out"


def rows(report: Path) -> list[dict[str, str]]:
    with open(report / "tables" / "gloss-interactive.csv", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def plain(text: str) -> str:
    """Printed numbers as Python reads them."""
    return text.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")).replace(" × 10", "e")


@pytest.mark.slow
def test_a_table_wider_than_the_window_shows_that_it_scrolls(report: Path, tab: Page, tmp_path: Path) -> None:
    tab.open(report / "index.html", 400)
    tab.run("var wide = [...document.querySelectorAll('.scroll')].find(e => e.scrollWidth > e.clientWidth + 60); 0")

    def edges() -> tuple[int, int]:
        """Darkest grey of the space above the lines at the left and right end, out of the way of words."""
        at = tab.run(
            "wide.scrollIntoView({block: 'start', behavior: 'instant'});"
            "(r => [r.left, r.right, r.top, r.bottom])(wide.getBoundingClientRect())"
        )
        tab.screenshot(tmp_path / "shot.png")
        with Image.open(tmp_path / "shot.png") as shot:
            grey = np.asarray(shot.convert("L"))
        left, right, top, bottom = (round(x) for x in at)
        rows = grey[top + 1 : min(bottom, grey.shape[0]) - 1]
        # most rows are empty near the edge: their median is the background; two pixels in, fractions are past
        return int(np.median(rows[:, left + 2])), int(np.median(rows[:, right - 3]))

    left, right = edges()
    assert left == 255
    assert right < 235  # a shadow that an eye sees beside 255
    tab.run("wide.scrollLeft = wide.scrollWidth")
    left, right = edges()
    assert left < 235
    assert right == 255


def test_hover_says_what_the_table_says(report: Path, tab: Page) -> None:
    tab.open(report / "index.html", 1280)
    tab.run("document.querySelector('.viewer .stage').scrollIntoView({block: 'center'})")
    places = tab.run(
        "[...document.querySelectorAll('.viewer .stage g[clip-path] [transform]')]"
        ".map(e => e.getBoundingClientRect()).map(b => [b.x + b.width / 2, b.y + b.height / 2])"
    )
    known = {(r["curve"], float(r["signed_angle_deg"]), r["series"]): r for r in rows(report)}
    seen = set()
    for x, y in places[::7]:
        tab.move(x, y)
        text = plain(tab.run(OUTPUT))
        said = r"(θi = \d+°), θr = (-?[\d.]+)°, measured: \((\S+) ± (\S+)\) sr-1; divided: (\S+) ± (\S+); "
        found = re.match(said, text)
        assert found, text
        curve, angle = found[1], float(found[2])
        row = known[curve, angle, "measured"]
        value, u = float(row["brdf"]), float(row["u_brdf"])
        mirror = float(known[curve, float(curve[5:-1]), "measured"]["brdf"])
        theory = float(re.search(r"phong: (\S+), off by (\S+) u", text)[1])  # type: ignore[index]
        # half a unit of the last printed digit: the second one of the uncertainty, and 5 digits of theory
        assert float(found[3]) == pytest.approx(value, abs=5e-2 * u)
        assert float(found[4]) == pytest.approx(u, rel=5e-2)
        assert float(found[5]) == pytest.approx(value / mirror, abs=5e-2 * u / mirror)
        assert float(found[6]) == pytest.approx(u / mirror, rel=5e-2)
        assert theory == pytest.approx(float(known[curve, angle, "phong"]["brdf"]), rel=5e-5)
        seen.add((curve, angle))
    assert len(seen) >= 10
    assert tab.complaints == []


def test_keyboard_reaches_everything(report: Path, tab: Page) -> None:
    tab.open(report / "index.html", 1280)
    tab.run("document.querySelector('.viewer select').focus()")
    reached = []
    for _ in range(9):
        reached.append(tab.run("document.activeElement.value || document.activeElement.tagName"))
        tab.press("Tab")
        assert tab.run("getComputedStyle(document.activeElement).outlineStyle") == "solid"  # the focus can be seen
    shown = ["measured", "lambert", "oren-nayar", "phong"]
    assert reached == ["polar", "mirror", "θi = 10°", "θi = 30°", "θi = 60°", *shown]

    tab.run("document.querySelector('input[value=\"θi = 10°\"]').focus()")
    colour = 'document.querySelectorAll(\'.viewer .stage [stroke="#0072B2"], .viewer .stage [fill="#0072B2"]\').length'
    assert tab.run(colour) > 10
    tab.press(" ")
    assert tab.run(colour) == 0

    tab.run("document.querySelector('.viewer .stage svg').focus()")
    for key, start in (
        ("ArrowRight", "θi = 30°, θr = −80°"),
        ("ArrowRight", "θi = 30°, θr = −75°"),
        ("ArrowDown", "θi = 60°, θr = −75°"),
        ("Escape", "Point at a value"),
    ):
        tab.press(key)
        assert tab.run(OUTPUT).startswith(start)


def test_choices_draw_something_else(report: Path, tab: Page) -> None:
    tab.open(report / "index.html", 400)

    def choose(key: str, value: str) -> str:
        tab.run(
            f"(s => {{ s.value = '{value}'; s.dispatchEvent(new Event('change')); }})"
            f"(document.querySelector('[data-key={key}]'))"
        )
        text: str = tab.run("document.querySelector('.viewer .stage svg').textContent")
        return text

    assert "largest in-plane value" in choose("norm", "max")
    assert "BRDF [1/sr]" in choose("norm", "none")
    assert "model in the mirror direction" in choose("norm", "model")
    assert "BRDF / value in the mirror direction" in choose("norm", "mirror")
    assert "mirror side positive" in choose("plot", "log")
    assert tab.complaints == []


def test_where_no_curve_has_its_mirror_value_the_axis_names_what_divides(
    report: Path, tab: Page, tmp_path: Path
) -> None:
    """It was "BRDF / value in the mirror direction; 2 of 2 curves: / largest in-plane value"."""
    text = (report / "index.html").read_text(encoding="utf-8")
    bare = re.sub(r'("max": ?[^,{}]+, ?"mirror": ?)[\d.e+-]+', r"\1null", text)
    assert bare != text
    (tmp_path / "bare.html").write_text(bare, encoding="utf-8")
    tab.open(tmp_path / "bare.html", 1280)
    drawn = tab.run("document.querySelector('.viewer .stage svg').textContent")
    assert "BRDF / largest in-plane value" in drawn
    assert "mirror direction" not in drawn


def test_reads_without_javascript(report: Path, tab: Page) -> None:
    tab.open(report / "index.html", 1280, scripts=False)
    assert tab.run("getComputedStyle(document.querySelector('.viewer')).display") == "none"
    assert tab.run("document.querySelectorAll('figure svg').length") >= 4


@pytest.mark.slow
def test_change_report_shows_both(tab: Page, tmp_path: Path) -> None:
    gloss = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30})
    for name, seed in (("before", 1), ("after", 2)):
        measurement.write(measure(gloss, noise=0.01, seed=seed, name=name), tmp_path / f"{name}.csv")
    change.make([str(tmp_path / "before.csv"), str(tmp_path / "after.csv")], tmp_path / "out")
    tab.open(tmp_path / "out" / "index.html", 400)
    assert tab.run("document.documentElement.scrollWidth") <= 400
    names = tab.run("[...document.querySelectorAll('[data-key=series]')].map(e => e.value)")
    assert names == ["A: before", "B: after"]
    assert "model" not in tab.run("[...document.querySelectorAll('[data-key=norm] option')].map(e => e.value)")
    tab.run("document.querySelector('.viewer .stage svg').focus()")
    tab.press("ArrowRight")
    assert re.search(r"A: before: \S+ ± \S+ sr⁻¹; B: after: \S+, off by", tab.run(OUTPUT))
    assert tab.complaints == []


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_the_first_screen_has_verdict_plot_and_on_a_desk_the_table(
    report: Path, tab: Page, width: int, height: int
) -> None:
    tab.open(report / "index.html", width, height)
    ends = {
        name: tab.run(f"document.querySelector('{selector}').getBoundingClientRect().bottom")
        for name, selector in (("verdict", ".lead"), ("plot", ".viewer .stage svg"), ("table", "table.picks"))
    }
    assert ends["verdict"] < ends["plot"] < height
    assert ends["table"] < height or width < 600
    assert tab.run("document.documentElement.scrollWidth") <= width
    assert tab.run("document.querySelectorAll('.viewer .stage svg circle').length") > 10
    over = (
        "[...document.querySelectorAll('.viewer *')].filter(e => e.getBoundingClientRect().right > innerWidth).length"
    )
    assert tab.run(over) == 0
    assert tab.complaints == []
    assert len(re.findall(r"[.!?](?= [A-Z]|$)", tab.run("document.querySelector('.lead').innerText"))) <= 2


@pytest.mark.parametrize("width", [1280, 390])
def test_little_is_shown_before_anything_is_unfolded(report: Path, tab: Page, width: int) -> None:
    tab.open(report / "index.html", width)
    assert tab.run("document.body.innerText.split(/\\s+/).length") <= MOST_WORDS
    assert tab.run("document.documentElement.scrollHeight") <= MOST_PIXELS
    assert tab.run("document.querySelectorAll('details:not([open])').length") >= 6
    empty = "[...document.querySelectorAll('details')].filter(e => !e.querySelector('.result')).map(e => e.id)"
    assert tab.run(empty) == [], "each fold carries its result"


def test_a_row_of_the_table_draws_its_model(report: Path, tab: Page) -> None:
    tab.open(report / "index.html", 1280)
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
    tab.open(report / "index.html", 1280)
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
    tab.open((report / "index.html").resolve().as_uri() + rubbish, 1280)
    assert tab.run(DRAWN) == ["phong"]
    assert tab.run(OPEN) == []
    assert tab.complaints == []


def test_a_link_opens_the_folds_around_its_place(report: Path, tab: Page) -> None:
    tab.open("about:blank", 1280)
    tab.open((report / "index.html").resolve().as_uri() + "#gloss.checks", 1280)
    assert tab.run(OPEN) == ["gloss.checks"]


def test_on_paper_all_folds_are_open_and_the_drawing_stands_for_the_plot(report: Path, tab: Page) -> None:
    tab.open("about:blank", 1280)
    tab.open(report / "index.html", 1280)
    tab.send("Emulation.setEmulatedMedia", media="print")
    assert tab.run("getComputedStyle(document.querySelector('.printed')).display") == "grid"
    assert tab.run("getComputedStyle(document.querySelector('.viewer')).display") == "none"
    assert tab.run("document.querySelectorAll('figure svg').length") >= 4
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
    tab.open(report / "index.html", 1280)
    assert tab.run("document.querySelector('.meaning').hidden")
    tab.run("document.querySelector('th .term').focus()")
    assert not tab.run("document.querySelector('.meaning').hidden")
    assert len(tab.run("document.querySelector('.meaning').innerText")) > 20
    tab.press("Escape")
    assert tab.run("document.querySelector('.meaning').hidden")
