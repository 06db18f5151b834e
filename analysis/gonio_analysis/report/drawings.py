"""Drawings of a page, and the figures that they become."""

import hashlib
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

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


@dataclass(frozen=True)
class Drawing(Described):
    """A figure that is still to be drawn, with what its drawing needs: little enough to be sent to another process."""

    inches: tuple[float, float]
    on: Callable[[Any], None]
    """Draws on a canvas of that size: a function of a module, with its arguments (`functools.partial`)."""

    def rendered(self) -> Figure:
        """The figure as SVG and PNG; the same drawing gives the same bytes."""
        from matplotlib import rc_context
        from matplotlib.figure import Figure as Canvas

        png, svg = io.BytesIO(), io.StringIO()
        with rc_context(SVG):
            figure = Canvas(figsize=self.inches)
            self.on(figure)
            quick = {"compress_level": 3}  # a tenth larger than at best, in a third of the time
            figure.savefig(png, format="png", dpi=PNG_DPI, metadata={"Software": "gonio"}, pil_kwargs=quick)
            figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": "gonio"})
        words = (self.name, self.kind, self.model, self.caption, self.alt)
        return Figure(*words, _tidy(svg.getvalue(), self.name), png.getvalue())


def rendered(
    name: str, kind: str, model: str, caption: str, alt: str, inches: tuple[float, float], on: Callable[[Any], None]
) -> Figure:
    """What `on` draws on a canvas of some `inches`, at once."""
    return Drawing(name, kind, model, caption, alt, inches, on).rendered()


def _tidy(svg: str, name: str) -> str:
    """SVG that can stand in an HTML page: no prologue, no fixed size, ids of its own, and a third of the bytes.

    What is referred to is numbered as it comes, so that the same drawing gives the same bytes in every process.
    """
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    for size in ("height", "width"):
        svg = re.sub(rf'(<svg[^>]*?) {size}="[^"]*"', r"\1", svg, count=1)
    svg = _numbered(svg, "f" + hashlib.sha256(name.encode()).hexdigest()[:8])
    svg = re.sub(r"font-family: 'DejaVu Sans'(, sans-serif)*(; )?", "", svg)
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
