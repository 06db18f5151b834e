"""The page of live alignment in a browser: what it shows of frames that are known, and that it controls nothing."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from gonio.lab.live.alignment import AlignmentPage
from gonio.lab.live.server import Request, Server
from gonio.lab.rig.light_and_camera import Lamp
from tests.browser import CHROMIUM, Page
from tests.gonio.lab.by_hand.test_assistant import Scene, Session, rig, session

needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


@pytest.fixture
def at_work() -> Iterator[Session]:
    made = session(Scene(rig(lamp=Lamp(beam_diameter_mm=4.0)), repeatable=False, at_mm=(1.0, -0.6)))
    with made.manual:
        yield made


def shown(at_work: Session, page: AlignmentPage) -> int:
    """The number of the newest frame, which the page is told of."""
    at_work.look()
    told, pictures = at_work.told[-1]
    page.tell(told, pictures)
    return int(told["n"])


def colour(tab: Page, column: float, row: float) -> list[int]:
    """Red, green and blue of a place of the picture."""
    here: list[int] = tab.run(
        "(() => { const copy = document.createElement('canvas'), brush = copy.getContext('2d');"
        f"brush.drawImage(document.getElementById('picture'), {-round(column)}, {-round(row)});"
        "return [...brush.getImageData(0, 0, 1, 1).data].slice(0, 3); })()"
    )
    return here


def text(tab: Page, of: str) -> str:
    said: str = tab.run(f"document.getElementById('{of}').textContent")
    return said


@needs_chromium
def test_frames_are_shown_as_they_come_with_what_is_in_them(at_work: Session, tab: Page) -> None:
    tab.complaints.clear()
    page = AlignmentPage()
    at_work.obey("go light 35 camera -25", "lamp on", "exposure 0.2")
    with Server(page.routes, page.events) as server:
        shown(at_work, page)
        tab.open(server.address, 1400)
        number = shown(at_work, page)
        tab.until(f"document.body.dataset.frame == '{number}'")
        spot = at_work.told[-1][0]["spot"]
        assert min(colour(tab, spot["column"], spot["row"])) > 150
        assert max(colour(tab, 3, 3)) < 90
        off = spot["from_centre_px"]
        assert text(tab, "spot") == f"{(off[0] ** 2 + off[1] ** 2) ** 0.5:.1f} px from the centre"
        assert "−0.6" in text(tab, "spot-facts")
        assert text(tab, "advice") == at_work.told[-1][0]["advice"]["text"]
        assert text(tab, "lamp").startswith("lamp lit, dark in ")
        assert "light35.00°" in text(tab, "angles")
        assert "% of the best" in text(tab, "focus")
        for kind in ("axis", "centre", "sample", "beam", "spot", "box"):
            assert tab.run(f"document.querySelectorAll('#overlay .{kind}').length") >= 1, kind
        at_work.obey("exposure 5")
        number = shown(at_work, page)
        tab.until(f"document.body.dataset.frame == '{number}'")
        red, _, blue = colour(tab, spot["column"], spot["row"])
        assert red > 180 > 110 > blue, "saturated pixels are red"
        assert text(tab, "advice").startswith("saturated: shorter by 4x")
        at_work.obey("lamp off")
        number = shown(at_work, page)
        tab.until(f"document.body.dataset.frame == '{number}'")
        assert text(tab, "lamp") == "lamp dark"
        assert "no spot" in text(tab, "spot")
        page.end(dark=True)
        tab.until("document.getElementById('state').textContent == 'the session has ended'")
        assert text(tab, "lamp") == "lamp dark"
    assert tab.complaints == []


@needs_chromium
@pytest.mark.parametrize("width", [1400, 1000, 420])
def test_the_page_fits_its_window_and_controls_nothing(at_work: Session, tab: Page, width: int) -> None:
    tab.complaints.clear()
    page = AlignmentPage()
    at_work.obey("lamp on")
    with Server(page.routes, page.events) as server:
        number = shown(at_work, page)
        tab.open(server.address, width)
        tab.until(f"document.body.dataset.frame == '{number}'")
        assert tab.run("document.documentElement.scrollWidth <= innerWidth")
        inside = "[...document.querySelectorAll('td *, details *')].filter(e => e.clientWidth)"
        assert tab.run(f"{inside}.filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.id).join()") == ""
        assert tab.run("document.querySelectorAll('button, input, select, textarea, form, a').length") == 0
        page.end(dark=False)
        tab.until("document.getElementById('lamp').textContent.startsWith('whether the lamp is dark is not known')")
    assert tab.complaints == []


@needs_chromium
def test_a_page_whose_server_has_died_claims_nothing_of_the_lamp(at_work: Session, tab: Page) -> None:
    page = AlignmentPage()
    at_work.obey("lamp on")
    with Server(page.routes, page.events) as server:
        number = shown(at_work, page)
        tab.open(server.address, 1000)
        tab.until(f"document.body.dataset.frame == '{number}'")
    tab.until("document.getElementById('lamp').textContent == 'lamp: not known'")
    assert text(tab, "state") == "no connection: look at the terminal"
    tab.open("about:blank", 1000)  # which asks nobody any more


def test_pictures_are_of_the_frame_that_is_asked_for_or_of_the_newest(at_work: Session, tmp_path: Path) -> None:
    page = AlignmentPage()
    frame, zoom = page.routes["/frame"], page.routes["/zoom"]
    assert frame(Request({"n": "1"}, "")) is None
    assert zoom(Request({}, "")) is None
    numbers = [shown(at_work, page) for _ in range(6)]
    of = {told["n"]: pictures for told, pictures in at_work.told}
    for asked, given in ((numbers[-1], 6), (numbers[-2], 5), (numbers[0], 6), ("../x", 6), ("", 6)):
        pictures, content = of[given], frame(Request({"n": str(asked)}, ""))
        assert pictures is not None
        assert content == (pictures.whole, "image/jpeg")
        assert zoom(Request({"n": str(asked)}, "")) == (pictures.zoom, "image/png")
    assert len(page._pictures) <= 4, "old ones are let go"
