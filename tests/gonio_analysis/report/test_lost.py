"""What fails late takes nothing along: a section, a figure, a table, the PDF, the page itself."""

import json
import os
from collections.abc import Callable
from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.report import (
    appearance,
    change,
    change_page,
    facts,
    figures,
    files,
    html,
    laboratories,
    page,
    sample,
    verdict,
    viewer,
)
from gonio_analysis.report import making as report
from gonio_analysis.report.blocks import Block, Figures, Heading, Paragraph, Table
from gonio_analysis.report.drawing import Drawing, FigureWorkers, figure_workers
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.section import Section
from gonio_analysis.selection.compare import Dataset
from gonio_maps.fits import fits as map_fits
from gonio_maps.report import map_layers, map_page, map_view

from gonio import lost, measurement, plugins
from gonio.errors import DataError, Incomplete
from gonio.models import OrenNayar, build
from tests.gonio_analysis.synthetic import measure
from tests.gonio_maps.fits import made as made_map


def fails(*given: Any, **named: Any) -> Any:
    raise ZeroDivisionError("<of the\nstranger>")


def says(d: DatasetSummary, figures: Any) -> list[Block]:
    return [Heading(3, "Words of a stranger"), *(Figures(f) for kind, f in figures.items() if kind == "strange")]


def on_nothing(figure: Any) -> None:
    figure.subplots()


def on_error(figure: Any) -> None:
    raise KeyError("no curve")


def on_end(figure: Any, *, here: int) -> None:
    if os.getpid() != here:
        os._exit(3)
    raise DataError("here, too")


def drawings(on: Callable[[Any], None], *names: str) -> Callable[[Dataset, DatasetSummary], list[Drawing]]:
    def draw(d: Dataset, f: DatasetSummary) -> list[Drawing]:
        return [Drawing(name, "strange", "", "A strange figure: its caption.", "alt", (3.0, 2.0), on) for name in names]

    return draw


class Loop:
    """A summary of itself."""

    def summary(self) -> "Loop":
        return self


BROKEN = (
    Section("blocks", fails),
    Section("draw", says, fails),
    Section("facts", says, facts=fails),
    Section("an object in facts", says, facts=lambda d: {"x": object()}),
    Section("a complex number in facts", says, facts=lambda d: {"x": 1j}),
    Section("no text in facts", says, facts=lambda d: "\ud800"),
    Section("facts without an end", says, facts=lambda d: Loop()),
    Section("no blocks", lambda d, f: [None]),  # type: ignore[list-item]
    Section("blocks of None", lambda d, f: None),  # type: ignore[arg-type, return-value]
    Section("a table without rows", lambda d, f: [Table("", (), None, frozenset(), ())]),  # type: ignore[arg-type]
    Section("a figure", says, drawings(on_error, "one", "two")),
    Section("a figure that ends its process", says, drawings(partial(on_end, here=os.getpid()), *"abcdefgh")),
    Section("a name of a figure elsewhere", says, drawings(on_nothing, "../../one")),
    Section("a name of a figure twice", says, drawings(on_nothing, "three", "three")),
    Section("no drawing", says, lambda d, f: [3]),  # type: ignore[list-item]
)
OF_FIGURES = {"a figure": "one", "a figure that ends its process": "a"}
"""Sections of which a figure is named that failed, and not the section."""
GOOD = Section("good", says, drawings(on_nothing, "whole"), lambda d: {"values": len(d.data)})
SEVERAL = (GOOD, Section("besides", lambda d, f: [Paragraph("Words besides.")]))
TWICE = (Section("twice", says), Section("twice", says))
NO_SECTION = 5


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> str:
    frame = measure(build("lambert", {"albedo": 0.5}), incidences=(30.0,), name="matte")
    path = tmp_path_factory.mktemp("tables") / "t.csv"
    measurement.write(frame, path)
    return str(path)


@pytest.fixture
def brought(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Lets a package bring something to the group `gonio.sections`."""

    def bring(name: str, value: str) -> None:
        point = EntryPoint(name, value, "gonio.sections")
        monkeypatch.setitem(plugins._added, ("gonio.sections", name), point)

    return bring


def made(table: str, out: Path, *said: str, whole: bool = False) -> tuple[dict[str, Any], str]:
    """A report of which something is missing: what is on the terminal, on the page and in the summary."""
    if whole:
        report.make([table], out, models=("lambert",))
    else:
        with pytest.raises(Incomplete) as raised:
            report.make([table], out, models=("lambert",))
        assert raised.value.exit_code == 1
        assert raised.value.written == out / "index.html"
        for words in said:
            assert words in str(raised.value)
    page = (out / "index.html").read_text(encoding="utf-8")
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert [one["error"] for one in summary.get("failed", [])] or whole
    assert page.count("What is missing") == (not whole)
    assert not list(out.glob("**/.*"))
    return summary, page


def test_sections_of_a_stranger_that_fail(table: str, tmp_path: Path, brought: Any) -> None:
    """In what they say, draw and count, at once or when it is printed, drawn or written, here or elsewhere."""
    brought("strange", f"{__name__}:BROKEN")
    brought("well", f"{__name__}:SEVERAL")
    summary, page = made(table, tmp_path / "out", "Error: ")
    lost = [one["part"] for one in summary["failed"]]
    for one in BROKEN:
        named = f'figure "{OF_FIGURES[one.name]}"' if one.name in OF_FIGURES else f'"{one.name}"'
        assert any(named in part for part in lost), one.name
    assert "Words besides." in page
    assert summary["datasets"][0]["sections"]["good"] == {"values": 33}
    assert (tmp_path / "out" / "figures" / "whole.svg").is_file()
    assert "parameters.csv" in summary["tables"]
    assert page.index("Words of a stranger") > page.index('<section id="matte">')
    assert page.rindex("Missing: ") > page.index('<section id="matte">')


def test_in_the_place_and_at_the_top_stands_the_error(table: str, tmp_path: Path, brought: Any) -> None:
    brought("strange", f"{__name__}:WRONG")
    _, page = made(
        table, tmp_path / "out", 'section "first" of matte could not be made: ZeroDivisionError: <of the stranger>'
    )
    assert page.count("ZeroDivisionError: &lt;of the stranger&gt;") == 2
    assert page.count("KeyError: &#x27;no curve&#x27;") == 2
    assert "A strange figure" in page
    assert not (tmp_path / "out" / "figures" / "one.svg").exists()


WRONG = (Section("first", fails), Section("second", says, drawings(on_error, "one")))


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("no_such_module_of_mine:X", "ModuleNotFoundError"), (f"{__name__}:NO_SECTION", "TypeError"),
        (f"{__name__}:TWICE", 'a section named "twice" already'),
    ],
)  # fmt: skip
def test_a_plug_in_that_is_no_section_is_named(value: str, said: str, table: str, tmp_path: Path, brought: Any) -> None:
    brought("strange", value)
    made(table, tmp_path / "out", 'section plug-in "strange"', said)


def test_one_section_or_several_of_other_packages(table: str, tmp_path: Path, brought: Any) -> None:
    brought("one", f"{__name__}:GOOD")
    summary, page = made(table, tmp_path / "out", whole=True)
    assert "failed" not in summary
    assert "Words of a stranger" in page
    assert summary["datasets"][0]["sections"]["good"] == {"values": 33}


TOGETHER = [
    (files, "_parameters", "tables/parameters.csv"), (files, "_curves", "tables/matte-curves.csv"),
    (viewer, "viewer", "interactive plot"), (report, "_cite", "datacite.json"),
    (sample, "_energy", "energy and symmetry"), (page, "_provenance", "provenance"),
    (facts, "of_table", "quantities of appearance"), (verdict, "headline", "the headline"),
]  # fmt: skip
"""Parts of which none hides another."""


@pytest.mark.parametrize(
    "wrong",
    [
        TOGETHER,
        [(page, "render", "the page")],
        [(figures, "draw", "figures of matte")],
        [(html, "document", "the page")],
        [(files, "plain", "summary.json")],
    ],
    ids=["together", "page", "figures", "document", "summary"],
)
def test_parts_of_our_own_that_fail(
    wrong: list[tuple[Any, str, str]], table: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = html.document
    calls = []

    def second(*given: Any) -> Any:
        calls.append(1)
        # the first is for the size, those after the second stand in for it
        return real(*given) if len(calls) != 2 else fails()

    for where, name, _ in wrong:
        monkeypatch.setattr(where, name, second if name == "document" else fails)
    summary, page = made(table, tmp_path / "out", "ZeroDivisionError", *(part for *_, part in wrong))
    for *_, part in wrong:
        assert any(part in one["part"] for one in summary["failed"]), part
    assert "ZeroDivisionError" in page
    assert (tmp_path / "out" / "tables" / "metrics.csv").is_file()
    assert (tmp_path / "out" / "tables" / "parameters.csv").is_file() == (wrong is not TOGETHER)


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, MemoryError, OSError(28, "No space left on device")])
def test_what_ends_everything_is_not_swallowed(
    error: Any, table: str, tmp_path: Path, brought: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ends(*given: Any) -> Any:
        raise error

    monkeypatch.setitem(globals(), "NOW", Section("broken", ends))
    brought("strange", f"{__name__}:NOW")
    kind = error if isinstance(error, type) else Exception
    with pytest.raises(kind) as raised:
        report.make([table], tmp_path / "out", models=("lambert",))
    assert not isinstance(raised.value, Incomplete)
    assert not (tmp_path / "out").exists()


def test_outside_of_a_page_an_error_is_raised() -> None:
    with pytest.raises(ZeroDivisionError):
        lost.kept("x", fails, lambda loss: None)


@pytest.mark.parametrize("kind", ["change", "laboratories", "appearance"])
@pytest.mark.parametrize("broken", ["page", "figure"])
def test_other_pages(kind: str, broken: str, table: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = {"change": change, "laboratories": laboratories, "appearance": appearance}[kind]
    if broken == "page":
        monkeypatch.setattr(*((change_page, "page") if kind == "change" else (module, "_page")), fails)
    else:
        monkeypatch.setattr(Drawing, "rendered", fails)
    other = tmp_path / "other.csv"
    measurement.write(measurement.read(table), other)
    given: Any = appearance.of(table) if kind == "appearance" else [table, str(other)]
    with pytest.raises(Incomplete, match="ZeroDivisionError"):
        module.make(given, tmp_path / "out")
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "What is missing" in page
    assert json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))["failed"]


def test_a_figure_that_ends_every_process_is_named() -> None:
    """What ended two other processes is not tried in this one; the others are drawn."""
    on = partial(on_end, here=os.getpid())
    wanted = [Drawing(f"d{k}", "k", "", "c", "a", (2.0, 1.5), on_nothing if k > 1 else on) for k in range(8)]
    with figure_workers(8, processes=3) as workers, lost.collecting() as losses:
        ended = partial(_ended, workers)
        made = workers.draw(wanted, meanwhile=ended)
    assert [one.failed.partition(":")[0] for one in made] == ["Died", "Died", *[""] * 6]
    assert [one.part for one in losses] == ['figure "d0"', 'figure "d1"']


def _ended(workers: FigureWorkers) -> None:
    for process in workers._processes:
        process.wait(timeout=600)


@pytest.fixture(scope="module")
def fits(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small map of values, and its fits with materials."""
    pytest.importorskip("h5netcdf")
    folder = tmp_path_factory.mktemp("map")
    made_map.write(
        folder / "map.h5", lambda x, y: {"albedo": 0.5, "sigma_deg": 20.0}, kind=OrenNayar, rows=8, cols=8, pixel_mm=0.1
    )
    asked = FitRequest("oren-nayar")
    map_fits.make(
        folder / "map.h5", folder / "fits.h5", asked, materials="1", count=lambda *_: None, say=lambda text: None
    )
    return folder / "fits.h5"


@pytest.mark.parametrize("source", ["fits.h5", "map.h5"])
@pytest.mark.parametrize(
    "wrong",
    [
        [
            (Drawing, "rendered", 'figure "map-flags"'), (map_view, "of", "the interactive plot"),
            (map_page, "percent", "the headline"), (map_page, "_parameters", "the table of parameters"),
            (map_page, "_flags_table", "tables/flags.csv"),
        ],
        [(map_layers, "draw", "figures")],
        [(map_page, "_page", "the page")],
    ],
    ids=["together", "figures", "page"],
)  # fmt: skip
def test_a_map_s_page(
    source: str, wrong: list[tuple[Any, str, str]], fits: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for where, name, _ in wrong:
        monkeypatch.setattr(where, name, fails)
    monkeypatch.setattr("gonio.platform.processors", lambda: 1)  # another process would not know the fault
    with pytest.raises(Incomplete, match="ZeroDivisionError") as raised:
        map_page.make(fits.with_name(source), tmp_path / "out")
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "What is missing" in page
    assert "ZeroDivisionError" in page
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    for *_, part in wrong:
        assert part in str(raised.value)
        assert any(part in one["part"] for one in summary["failed"]), part
    assert (tmp_path / "out" / "tables" / "parameters.csv").is_file()
    assert (tmp_path / "out" / "tables" / "flags.csv").is_file() == (len(wrong) == 1)
