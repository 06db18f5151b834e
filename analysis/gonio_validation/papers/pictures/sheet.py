"""The contact sheet: every picture small, under the name of its figure and what its text's claims came to."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

from gonio_scenes.picture import Image

from gonio_validation.papers.figure import Claim
from gonio_validation.papers.pictures.catalogue import SHOWN, Shown

WIDTH, HIGH = 1360, 150
"""Of the sheet, and of a picture on it [px]."""
TITLE, LABEL, GAP, MARGIN = 34, 17, 7, 16
BETWEEN = 24
"""Between two figures of a row."""
DPI = 100


def verdicts(claims: Sequence[Claim]) -> str:
    """What the claims came to, in words."""
    count = [sum(c.verdict == v for c in claims) for v in ("holds", "does not hold", "no verdict")]
    words = [f"{n} {what}" for n, what in zip(count, ("hold", "do not hold", "without a verdict"), strict=True) if n]
    return f"{len(claims)} claims: " + ", ".join(words)


def contact_sheet(pictures: Mapping[str, Image], claims: Mapping[str, Sequence[Claim]]) -> bytes:
    """The sheet as PNG.

    Parameters
    ----------
    pictures
        RGB of each scene, by its name.
    claims
        Of each figure, by its name.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = _rows(pictures)
    tall = len(rows) * (TITLE + HIGH + LABEL + GAP) + 2 * MARGIN
    figure = Figure(figsize=(WIDTH / DPI, tall / DPI), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    for k, row in enumerate(rows):
        top = MARGIN + k * (TITLE + HIGH + LABEL + GAP)
        x = float(MARGIN)
        for shown in row:
            title, said = shown.title, verdicts(claims[shown.name])
            if _wide(shown, pictures) < 300:  # the figure's name alone
                title, said = title.partition(":")[0], said.replace("claims: ", "claims:\n").partition("\n")[2]
            _text(figure, x, top + 11, tall, title, 8.5, "#1c2430", weight="bold")
            _text(figure, x, top + 26, tall, said, 7.0, "#5b6573")
            for name, label in shown.pictures:
                image = pictures[name]
                wide = HIGH * image.shape[1] / image.shape[0]
                ax = figure.add_axes((x / WIDTH, 1.0 - (top + TITLE + HIGH) / tall, wide / WIDTH, HIGH / tall))
                ax.imshow(_small(image, round(wide)), aspect="auto", interpolation="none")
                ax.set_axis_off()
                _text(figure, x, top + TITLE + HIGH + 11, tall, _cut(label, wide), 6.5, "#39424e")
                x += wide + GAP
            x += BETWEEN - GAP
    file = io.BytesIO()
    canvas.print_png(file)
    return file.getvalue()


def _rows(pictures: Mapping[str, Image]) -> list[list[Shown]]:
    """Figures side by side, as many as fit."""
    rows: list[list[Shown]] = [[]]
    left = 0.0
    for shown in SHOWN:
        wide = _wide(shown, pictures)
        if rows[-1] and left + wide > WIDTH - 2 * MARGIN:
            rows.append([])
            left = 0.0
        rows[-1].append(shown)
        left += wide + BETWEEN
    return rows


def _wide(shown: Shown, pictures: Mapping[str, Image]) -> float:
    shapes = [pictures[name].shape for name, _ in shown.pictures]
    return sum(HIGH * s[1] / s[0] for s in shapes) + GAP * (len(shapes) - 1)


def _small(image: Image, wide: int) -> Image:
    import cv2

    return cv2.resize(image, (wide, HIGH), interpolation=cv2.INTER_AREA)  # type: ignore[no-any-return]


def _cut(label: str, wide: float) -> str:
    """A label that its picture is wide enough for: 4 px a letter."""
    most = int(wide / 3.9)
    return label if len(label) <= most else label[: most - 1].rstrip(" ,;") + "…"


def _text(figure: Any, x: float, y: float, tall: float, text: str, size: float, color: str, **more: Any) -> None:
    figure.text(x / WIDTH, 1.0 - y / tall, text, fontsize=size, color=color, va="center", ha="left", **more)
