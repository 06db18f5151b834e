"""What a reader of a figure sees of its words: where each stands, and which are printed over others."""

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import pytest
from gonio_analysis.report.drawing import Drawing
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

TOUCH = 0.5
"""Overlap that counts as touching [px of 100 an inch]: boxes hold the room of letters that go below the line, too."""


def words(figure: Any) -> list[tuple[str, Any]]:
    """Every text that is drawn, with its box on the canvas: as it is drawn, for what is in space has no other place."""
    seen: dict[int, tuple[str, Any]] = {}
    draw = Text.draw

    def noted(self: Text, renderer: Any, *rest: Any, **named: Any) -> None:
        draw(self, renderer, *rest, **named)
        if self.get_visible() and self.get_text().strip():
            seen[id(self)] = (self.get_text(), Text.get_window_extent(self, renderer))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Text, "draw", noted)
        figure.draw(FigureCanvasAgg(figure).get_renderer())
    return list(seen.values())


def faults(drawing: Drawing) -> Iterator[str]:
    """Texts of a figure that overprint each other, or leave the canvas."""
    figure = drawing.laid_out()
    found = words(figure)
    for text, box in found:
        if min(box.x0, box.y0) < -TOUCH or box.x1 > figure.bbox.x1 + TOUCH or box.y1 > figure.bbox.y1 + TOUCH:
            yield f"{drawing.name}: {text!r} leaves the canvas at {box.extents.round(1)}"
    for (one, a), (other, b) in combinations(found, 2):
        if min(a.x1, b.x1) - max(a.x0, b.x0) > TOUCH and min(a.y1, b.y1) - max(a.y0, b.y0) > TOUCH:
            yield f"{drawing.name}: {one!r} and {other!r}"
