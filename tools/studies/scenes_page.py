"""`index.html` of the study `scenes`, and its drawing."""

from collections.abc import Sequence
from functools import partial
from typing import Any

from gonio_analysis.plots.in_plane import COLOURS
from gonio_analysis.plots.style import FAINT
from gonio_analysis.report import frame
from gonio_analysis.report.blocks import Block, Figures, Page, Paragraph, footer
from gonio_analysis.report.drawing import Figure, rendered
from gonio_analysis.report.section import parts
from gonio_analysis.report.text import number, percent
from gonio_validation.bench.page import (
    Column,
    TableSection,
    held,
    listed,
    made,
    method,
    milliseconds,
    of_parts,
    part,
    two_digits,
    verdict,
)

from gonio.typing import JsonObject

FOOTER = footer(
    "Every number on this page is in `summary.json`; the tables are in `tables/`, the figure as SVG and PNG in "
    "`figures/`."
)
ERRORS = {"mean": "error of the mean", "pixel": "error of a pixel"}
RAYS = TableSection(
    "Rays a pixel", "samples",
    "A Lambertian sphere on a floor. Errors are root mean squares over the picture's mean radiance.",
    (
        Column("light", "scene"), Column("rays a pixel", "rays", number), Column("ms", "seconds", milliseconds),
        Column("error", "rms", percent), Column("stated", "stated", percent),
    ),
    (1, 2, 3, 4),
)  # fmt: skip
PARTS = (
    TableSection(
        "To a tolerance", "tolerances",
        "Every pixel is brought below the tolerance: a standard error, over the pixel's radiance or the picture's "
        "mean, whichever is larger. For all: what as many rays for every pixel would take as the worst pixel needs. "
        "Kept: the stated errors are below the tolerance, the real ones are at most half as large again, and 1 % of "
        "the pixels at most lie beyond three tolerances.",
        (
            Column("light", "scene"), Column("tolerance", "tolerance", percent),
            Column("rays a pixel", "rays", number), Column("most", "most"), Column("ms", "seconds", milliseconds),
            Column("ms for all", "seconds_for_all", milliseconds), Column("error", "rms", percent),
            Column("stated", "stated", percent), Column("beyond 3", "beyond_three", percent),
            Column("above", "above"), Column("kept", "holds", verdict),
        ),
        tuple(range(1, 10)),
    ),
    TableSection(
        "Wavelengths", "bins",
        "Spheres of metal in parallel light of D65, against 81 wavelengths from 380 to 780 nm. The illuminant's own "
        "structure is not sampled: what is interpolated between wavelengths is the reflection. Colour differences are "
        "those of CIE 1976, over the pixels of the sphere.",
        (
            Column("sample", "scene"), Column("wavelengths", "wavelengths"), Column("ms", "seconds", milliseconds),
            Column("XYZ over white: largest", "xyz", two_digits), Column("ΔE: mean", "delta_e", two_digits),
            Column("largest", "delta_e_worst", two_digits),
        ),
        (1, 2, 3, 4, 5),
    ),
    TableSection(
        "Exact and approximate", "ways",
        "Pictures of a sphere, one ray a pixel, by other ways of evaluating its material. Errors are over the mean "
        "radiance of the sphere, against the first way.",
        (
            Column("material", "material"), Column("way", "way"), Column("ms", "seconds", milliseconds),
            Column("error", "rms", two_digits), Column("largest", "worst", two_digits), Column("", "note"),
        ),
        (2, 3, 4),
    ),
    TableSection(
        "Wavelengths together", "shared",
        "The wavelengths of a picture share rays, hits and shadows, and in the models what does not depend on them.",
        (
            Column("sample", "material"), Column("wavelengths", "wavelengths"),
            Column("ms together", "together_s", milliseconds), Column("ms in a picture each", "apart_s", milliseconds),
            Column("times faster", "", lambda r: number(r["apart_s"] / r["together_s"])),
        ),
        (1, 2, 3, 4),
    ),
)  # fmt: skip
PEERS = (
    Column("scene", "scene"),
    Column("by", "note"),
    Column("largest", "largest", "{:.2f}".format),
    Column("rms", "rms", "{:.2f}".format),
    Column("beyond 3", "", "{0[beyond_three]} of {0[tiles]}".format),
    Column("ours", "", lambda p: f"{milliseconds(p['ours_s'])} ms, {percent(p['ours_rms'])}"),
    Column("Mitsuba", "", lambda p: f"{milliseconds(p['theirs_s'])} ms, {percent(p['theirs_rms'])}"),
    Column("s to 1 %: ours", "ours_to_one_percent_s", two_digits),
    Column("Mitsuba", "theirs_to_one_percent_s", two_digits),
)


def render(s: JsonObject, drawn: Sequence[Figure]) -> Page:
    """The page."""
    rough = " A quick run: small pictures, nothing is precise." if s["quick"] else ""
    m = s["machine"]
    what = f", {m['cpu']}, {m['cpus']} threads; pictures of {s['pixels']} x {s['pixels']}."
    busy = f"{m['load'][0]:.1f} when the run began" if m["load"] else "unknown"
    rows = [
        ("times", "wall-clock time of rendering in process, the best of the repeats; reading and writing are left out"),
        ("load", busy),
    ]
    results = {
        "tolerances": held(s["tolerances"], lambda t: t["holds"]),
        "bins": f"{len(s['bins'])} pictures of metals",
        "ways": f"{len(s['ways'])} ways",
        "shared": "what a picture of several wavelengths saves",
    }
    folds = of_parts(s, *((p, results[p.rows]) for p in PARTS))
    folds += [*parts({'section "Beside Mitsuba 3"': partial(_peers, s)}), *method(s, *rows)]
    rays = partial(listed, s[RAYS.rows], RAYS.columns, RAYS.right, RAYS.words)
    first = frame.answer(
        parts({"the headline": partial(_lead, s)}), [Figures(tuple(drawn))], parts({f'table "{RAYS.title}"': rays})
    )
    return frame.page(s["title"], made(s, what + rough), first, folds=folds, foot=FOOTER)


def _lead(s: JsonObject) -> Paragraph:
    kept = sum(t["holds"] for t in s["tolerances"])
    words = [f"{kept} of {len(s['tolerances'])} tolerances are kept."]
    if s["peers"]:
        beyond, tiles = _apart(s)
        words.append(f"In Mitsuba {beyond} of {tiles} tiles are apart by more than three standard errors.")
    return Paragraph(" ".join(words), "lead")


def _apart(s: JsonObject) -> tuple[int, int]:
    beyond, tiles = (sum(p[key] for p in s["peers"]) for key in ("beyond_three", "tiles"))
    return beyond, tiles


def _peers(s: JsonObject) -> list[Block]:
    words = (
        "The same scenes as gonio render --to mitsuba writes them, as many rays a pixel in both. Tiles are of 8 x 8 "
        "pixels; their differences are in standard errors, and 0.3 % lie beyond three by chance. Mitsuba computes in "
        f"float32, in a process of its own. Found: {s['mitsuba']}."
    )
    shown = [listed(s["peers"], PEERS, tuple(range(2, 9)))] if s["peers"] else []
    result = "{} of {} tiles apart".format(*_apart(s)) if s["peers"] else s["mitsuba"] or "not compared"
    return part("Beside Mitsuba 3", result, words, *shown)


def drawn(s: JsonObject) -> Figure:
    """Error against time, for rays a pixel and for tolerances: of the picture's mean, and of a pixel."""

    def on(figure: Any) -> None:
        figure.subplots_adjust(0.11, 0.3, 0.985, 0.92, wspace=0.28)
        for ax, (error, words) in zip(figure.subplots(1, len(ERRORS)), ERRORS.items(), strict=True):
            for name, colour in zip(dict.fromkeys(r["scene"] for r in s["samples"]), COLOURS, strict=False):
                for key, style, label in (("samples", "o-", "rays for all"), ("tolerances", "s--", "to a tolerance")):
                    points = [(r["seconds"], r[error]) for r in s[key] if r["scene"] == name]
                    ax.plot(*zip(*points, strict=True), style, color=colour, ms=4, lw=1.2, label=f"{name}, {label}")
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.xaxis.set_minor_formatter("")
            ax.set_xlabel("seconds", fontsize=8)
            ax.set_title(words, fontsize=8, loc="left")
            ax.grid(True, color=FAINT, lw=0.4)
            ax.tick_params(which="both", labelsize=7.5)
        figure.legend(*ax.get_legend_handles_labels(), loc="lower center", ncols=2, fontsize=7.5, frameon=False)

    caption = (
        "Error against time. The mean is that of the whole picture; a pixel's error is over its radiance, or over the "
        "mean where that is larger, root mean square."
    )
    alt = " ".join(
        f"{r['scene']}, {number(r['rays'])} rays: {r['seconds']:.2g} s, {r['pixel']:.2g}." for r in s["samples"]
    )
    return rendered("error-against-time", "front", "", caption, alt, (6.4, 3.4), on)
