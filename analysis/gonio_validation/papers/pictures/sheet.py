"""The contact sheet: every picture small, under the name of its figure and what its text's claims came to."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

from gonio_scenes.picture import Image

from gonio_validation.papers.figure import Claim
from gonio_validation.papers.pictures.catalogue import SHOWN, Shown

WIDTH, HIGH = 1360, 140
"""Width of the sheet, and least height of a picture on it [px]."""
TITLE, LABEL, GAP, MARGIN = 34, 17, 7, 16
BETWEEN = 24
"""Space between two figures of a row."""
DPI = 100


def verdicts(claims: Sequence[Claim]) -> str:
    """What the claims came to, in words."""
    count = [sum(c.verdict == v for c in claims) for v in ("holds", "does not hold", "no verdict")]
    one = ("holds", "does not hold", "without a verdict")
    more = ("hold", "do not hold", "without a verdict")
    words = [f"{n} {(one if n == 1 else more)[k]}" for k, n in enumerate(count) if n]
    return f"{len(claims)} claim{'' if len(claims) == 1 else 's'}: " + ", ".join(words)


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
    heights = [_height(row, pictures) for row in rows]
    tall = sum(heights) + len(rows) * (TITLE + LABEL + GAP) + 2 * MARGIN
    figure = Figure(figsize=(WIDTH / DPI, tall / DPI), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    top = MARGIN
    for row, high in zip(rows, heights, strict=True):
        x = float(MARGIN)
        for shown in row:
            title, said = shown.title, verdicts(claims[shown.name])
            if _wide(shown, pictures, high) < 6.4 * len(title):  # the figure's name alone
                title, said = title.partition(":")[0], said.partition(": ")[2]
            _text(figure, x, top + 11, tall, title, 8.5, "#1c2430", weight="bold")
            _text(figure, x, top + 26, tall, said, 7.0, "#5b6573")
            for name, label in shown.pictures:
                image = pictures[name]
                wide = high * image.shape[1] / image.shape[0]
                ax = figure.add_axes((x / WIDTH, 1.0 - (top + TITLE + high) / tall, wide / WIDTH, high / tall))
                ax.imshow(_small(image, round(wide), high), aspect="auto", interpolation="none")
                ax.set_axis_off()
                _text(figure, x, top + TITLE + high + 11, tall, _cut(label, wide), 6.5, "#39424e")
                x += wide + GAP
            x += BETWEEN - GAP
        top += TITLE + high + LABEL + GAP
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


def _wide(shown: Shown, pictures: Mapping[str, Image], high: float = HIGH) -> float:
    shapes = [pictures[name].shape for name, _ in shown.pictures]
    return sum(high * float(s[1]) / float(s[0]) for s in shapes) + GAP * (len(shapes) - 1)


def _height(row: Sequence[Shown], pictures: Mapping[str, Image]) -> int:
    """The height for which a row's pictures fill the sheet, but no more than half as high again as the others."""
    count = sum(len(shown.pictures) for shown in row)
    gaps = (count - len(row)) * GAP + (len(row) - 1) * BETWEEN
    alone = sum(_wide(shown, pictures) for shown in row) - (count - len(row)) * GAP
    return min(int(HIGH * (WIDTH - 2 * MARGIN - gaps) / alone), HIGH * 3 // 2)


def _small(image: Image, wide: int, high: int) -> Image:
    import cv2

    return cv2.resize(image, (wide, high), interpolation=cv2.INTER_AREA)  # type: ignore[no-any-return]


def _cut(label: str, wide: float) -> str:
    """A label that its picture is wide enough for: 5.4 px a letter."""
    most = int(wide / 5.4)
    return label if len(label) <= most else label[: most - 1].rstrip(" ,;") + "…"


def _text(figure: Any, x: float, y: float, tall: float, text: str, size: float, color: str, **more: Any) -> None:
    figure.text(x / WIDTH, 1.0 - y / tall, text, fontsize=size, color=color, va="center", ha="left", **more)
