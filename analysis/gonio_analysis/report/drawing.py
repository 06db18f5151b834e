"""Drawings of a page, and the figures that several processes make of them: the same files as one process makes.

A drawing is sent to a process (`gonio_analysis.processes`) as a pickle of a few thousand values, and comes back as its
SVG, and PNG where it is asked for. Fits that do not wait for each other go the same way, with the same results to the
last digit.
"""

import hashlib
import io
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from gonio import canvas, lost, platform
from gonio.progress import Say, silent
from gonio.shown import visible
from gonio_analysis.plots.style import apart
from gonio_analysis.processes import Outcome, Processes

SVG = {
    "svg.fonttype": "none",
    "svg.hashsalt": "gonio",
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans"],
}
FONTS = "'DejaVu Sans', Verdana, 'Segoe UI', sans-serif"
"""Metrics close to those that matplotlib lays out with, so that labels keep their places."""
PNG_DPI = 160


@dataclass(frozen=True)
class Described:
    """What a page says of a figure."""

    name: str
    kind: str
    """"polar", "absolute", "budget" or "series": the page groups by it."""
    model: str
    caption: str
    alt: str

    def summary(self) -> dict[str, str]:
        """What `summary.json` says of it."""
        return {"name": self.name, "caption": self.caption, "alt": self.alt}


@dataclass(frozen=True)
class Figure(Described):
    """One drawn figure."""

    svg: str
    png: bytes
    failed: str = ""
    """Why it could not be drawn: then it has neither."""

    def summary(self) -> dict[str, str]:
        """What `summary.json` says of it."""
        return {**super().summary(), **({"failed": self.failed} if self.failed else {})}


@dataclass(frozen=True)
class Drawing(Described):
    """A figure that is still to be drawn, with what its drawing needs: little enough to be sent to another process."""

    inches: tuple[float, float]
    on: Callable[[Any], None]
    """Draws on a canvas of that size: a function of a module, with its arguments (`functools.partial`)."""

    def laid_out(self) -> Any:
        """The figure of matplotlib with every word in its place."""
        return laid_out(self.on, self.inches)

    def rendered(self, *, png: bool = False) -> Figure:
        """The figure as SVG, and where it is asked for as PNG; the same drawing gives the same bytes."""
        pixels = io.BytesIO()
        svg = as_svg(self.on, self.inches, self.name, pixels if png else None)
        return Figure(*self._words, svg, pixels.getvalue())

    def without(self, loss: lost.Loss) -> Figure:
        """The figure where it could not be drawn."""
        return Figure(*self._words, "", b"", loss.error)

    @property
    def _words(self) -> tuple[str, str, str, str, str]:
        return self.name, self.kind, self.model, self.caption, self.alt


def laid_out(on: Callable[[Any], None], inches: tuple[float, float]) -> Any:
    """A figure of matplotlib with every word in its place."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure as Canvas

    with rc_context(SVG), canvas.literal():
        figure = Canvas(figsize=inches)
        on(figure)
        canvas.settle(figure)
        apart(figure)
    return figure


def as_svg(on: Callable[[Any], None], inches: tuple[float, float], name: str, png: io.BytesIO | None = None) -> str:
    """What `on` draws on a canvas of some `inches`, as SVG; its PNG is written to `png`."""
    from matplotlib import rc_context

    svg, figure = io.StringIO(), laid_out(on, inches)
    with rc_context(SVG):
        if png is not None:
            quick = {"compress_level": 3}  # a tenth larger than at best, in a third of the time
            canvas.save(figure, png, format="png", dpi=PNG_DPI, metadata={"Software": "gonio"}, pil_kwargs=quick)
        canvas.save(figure, svg, format="svg", metadata={"Date": None, "Creator": "gonio"})
    return _tidy(svg.getvalue(), name)


def rendered(
    name: str, kind: str, model: str, caption: str, alt: str, inches: tuple[float, float], on: Callable[[Any], None]
) -> Figure:
    """What `on` draws on a canvas of some `inches`, at once, as SVG and PNG."""
    drawing = Drawing(name, kind, model, caption, alt, inches, on)
    return lost.kept(f'figure "{name}"', partial(drawing.rendered, png=True), drawing.without)


def _tidy(svg: str, name: str) -> str:
    """SVG that can stand in an HTML page: no prologue, no fixed size, ids of its own, and a third of the bytes.

    What is referred to is numbered as it comes, so that the same drawing gives the same bytes in every process.
    """
    svg = visible(svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    for size in ("height", "width"):
        svg = re.sub(rf'(<svg[^>]*?) {size}="[^"]*"', r"\1", svg, count=1)
    svg = _numbered(svg, "f" + hashlib.sha256(name.encode()).hexdigest()[:8])
    svg = re.sub(r"font-family: 'DejaVu Sans'(, sans-serif|, '[^']*')*(; )?", "", svg)
    svg = svg.replace("<svg", f'<svg style="font-family: {FONTS}"', 1)
    # inside of tags alone: what a label says stays as it is
    svg = re.sub(r"<[^>]*>", lambda tag: re.sub(r"\.(\d\d)\d+|\.(\d+)", _decimals, tag[0]), svg)
    svg = re.sub(r' d="[^"]*"', lambda d: re.sub(r"\s*([MLCQz])\s*", r"\1", d[0]).replace(' "', '"'), svg)
    svg = re.sub(r">\s+<", ">\n<", svg)
    return _joined(svg)


def _numbered(svg: str, prefix: str) -> str:
    """Only ids that something refers to, numbered."""
    found = re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', svg)
    new = {old: f"{prefix}-{k}" for k, old in enumerate(dict.fromkeys(a or b for a, b in found))}
    svg = re.sub(r' id="([^"]+)"', lambda m: f' id="{new[m[1]]}"' if m[1] in new else "", svg)
    svg = re.sub(r"url\(#([^)]+)\)", lambda m: f"url(#{new[m[1]]})", svg)
    return re.sub(r'href="#([^"]+)"', lambda m: f'href="#{new[m[1]]}"', svg)


def _decimals(match: re.Match[str]) -> str:
    digits = (match[1] or match[2]).rstrip("0")
    return f".{digits}" if digits else ""


def _joined(svg: str) -> str:
    """Markers of one look in one group, and lines of one look in one path."""

    def group(run: re.Match[str]) -> str:
        uses = re.sub(r' style="[^"]*"', "", run[0])
        return f'<g style="{run[2]}">\n{uses}</g>\n'

    def path(run: re.Match[str]) -> str:
        every = "".join(re.findall(r' d="([^"]*)"', run[0]))
        return f'<path d="{every}" {run[1]}/>\n'

    use, style = r'<use xlink:href="(#[^"]+)" x="[^"]*" y="[^"]*"', r' style="([^"]*)"/>\n'
    svg = re.sub(rf'{use}{style}(?:<use xlink:href="\1" x="[^"]*" y="[^"]*" style="\2"/>\n)+', group, svg)
    return re.sub(r'<path d="[^"]*" ([^>]*fill: none[^>]*)/>\n(?:<path d="[^"]*" \1/>\n)+', path, svg)


FEW = 6
"""Fewer figures than this are drawn here alone: to start a process takes as long as two of them."""
MOST_PROCESSES = 8
IMPORTS = ("matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg", "matplotlib.figure")


class FigureWorkers(Processes):
    """Processes that draw beside this one, and do what else is independent of each other before there is a drawing."""

    png = False
    """Whether figures become pictures, too, as `--png` asks: they take half as long again."""

    def draw(
        self, drawings: Sequence[Drawing], say: Say = silent, meanwhile: Callable[[], object] = lambda: None
    ) -> list[Figure]:
        """Every drawing, in their order; one that fails while a page is made is named in its place.

        Parameters
        ----------
        drawings
            What to draw.
        say
            Called with a line now and then.
        meanwhile
            Done here, while the others begin to draw.
        """
        jobs = [partial(_tried, one, self.png) for one in drawings]
        found = self.outcomes(jobs, "drawing: figures", say, meanwhile)
        return [
            lost.kept(f'figure "{one.name}"', partial(_figure, made), one.without)
            for one, made in zip(drawings, found, strict=True)
        ]


@contextmanager
def figure_workers(figures: int, processes: int | None = None, modules: Sequence[str] = ()) -> Iterator[FigureWorkers]:
    """Processes that draw about `figures` figures; they end with the block.

    Parameters
    ----------
    figures
        How many are expected; for fewer than `FEW` no other process is started.
    processes
        How many draw, this one included; by default as many as there are processors.
    modules
        What they import while they wait, beside what drawing needs.
    """
    count = min(platform.processors(), MOST_PROCESSES) if processes is None else processes
    pool = FigureWorkers((*IMPORTS, *modules))
    try:
        pool.grow(min(count, figures // 2) - 1 if figures >= FEW else 0)
        yield pool
    finally:
        pool.end()


def _tried(drawing: Drawing, png: bool, say: Say) -> Figure | Exception:
    """The figure, or why there is none: an error of one ends no other."""
    try:
        return drawing.rendered(png=png)
    except MemoryError:
        raise
    except Exception as error:
        return error


def _figure(made: Outcome[Figure | Exception]) -> Figure:
    found = made.result()
    if isinstance(found, Exception):
        raise found
    return found
