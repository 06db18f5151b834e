"""`index.html` of `gonio bench scenes`, and its drawing."""

from typing import Any

from gonio_analysis.plots.in_plane import COLOURS
from gonio_analysis.plots.style import FAINT
from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Footer,
    Group,
    Heading,
    Page,
    Paragraph,
    Text,
    code,
    section,
    table,
)
from gonio_analysis.report.drawings import Figure, rendered
from gonio_analysis.report.text import number, percent

from gonio_validation.bench.page import head, method, part, verdict
from gonio_validation.bench.scene_results import SceneBench

FOOTER = Footer(
    (
        *("Every number on this page is in ", code("summary.json"), "; the tables are in "),
        *(code("tables/"), ", the figure as SVG and PNG in ", code("figures/"), "."),
    )
)


def render(s: SceneBench) -> Page:
    """The page."""
    rough = " A quick run: small pictures, nothing is precise." if s.quick else ""
    machine = f"{s.machine.cpu}, {s.machine.cpus} threads"
    what = f", {machine}; pictures of {s.pixels} x {s.pixels}."
    body: list[Block] = [
        head(s, what + rough),
        _lead(s),
        _samples(s),
        _tolerances(s),
        _bins(s),
        _ways(s),
        _shared(s),
        _peers(s),
    ]
    return Page(s.title, (*body, _method(s), FOOTER))


def _lead(s: SceneBench) -> Paragraph:
    kept = sum(t.holds for t in s.tolerances)
    beyond, tiles = sum(p.beyond_three for p in s.peers), sum(p.tiles for p in s.peers)
    words = [f"{kept} of {len(s.tolerances)} tolerances are kept."]
    if s.peers:
        words.append(f"In Mitsuba {beyond} of {tiles} tiles are apart by more than three standard errors.")
    return Paragraph(" ".join(words), "lead")


def _samples(s: SceneBench) -> Group:
    rows: list[list[Text]] = [
        [r.scene, number(r.rays), number(1e3 * r.seconds), percent(r.rms), percent(r.stated)] for r in s.samples
    ]
    words = "A Lambertian sphere on a floor. Errors are root mean squares over the picture's mean radiance."
    header = ["light", "rays a pixel", "ms", "error", "stated"]
    return part("Rays a pixel", "samples", words, table("", header, rows, right=(1, 2, 3, 4)), Figures(tuple(drawn(s))))


def _tolerances(s: SceneBench) -> Group:
    rows: list[list[Text]] = [
        [
            r.scene,
            percent(r.tolerance),
            number(r.rays),
            str(r.most),
            number(1e3 * r.seconds),
            number(1e3 * r.seconds_for_all),
            percent(r.rms),
            percent(r.stated),
            percent(r.beyond_three),
            str(r.above),
            verdict(r.holds),
        ]
        for r in s.tolerances
    ]
    words = (
        "Every pixel is brought below the tolerance: a standard error, over the pixel's radiance or the picture's "
        "mean, whichever is larger. For all: what as many rays for every pixel would take as the worst pixel needs. "
        "Kept: the stated errors are below the tolerance, the real ones are at most half as large again, and 1 % of "
        "the pixels at most lie beyond three tolerances."
    )
    header = [
        "light",
        "tolerance",
        "rays a pixel",
        "most",
        "ms",
        "ms for all",
        "error",
        "stated",
        "beyond 3",
        "above",
        "kept",
    ]
    return part("To a tolerance", "tolerances", words, table("", header, rows, right=tuple(range(1, 10))))


def _bins(s: SceneBench) -> Group:
    rows: list[list[Text]] = [
        [
            r.scene,
            str(r.wavelengths),
            number(1e3 * r.seconds),
            number(r.xyz, 2),
            number(r.delta_e, 2),
            number(r.delta_e_worst, 2),
        ]
        for r in s.bins
    ]
    words = (
        "Spheres of metal in parallel light of D65, against 81 wavelengths from 380 to 780 nm. The illuminant's own "
        "structure is not sampled: what is interpolated between wavelengths is the reflection. Colour differences are "
        "those of CIE 1976, over the pixels of the sphere."
    )
    return part(
        "Wavelengths",
        "bins",
        words,
        table(
            "",
            ["sample", "wavelengths", "ms", "XYZ over white: largest", "ΔE: mean", "largest"],
            rows,
            right=(1, 2, 3, 4, 5),
        ),
    )


def _ways(s: SceneBench) -> Group:
    rows: list[list[Text]] = [
        [r.material, r.way, number(1e3 * r.seconds), number(r.rms, 2), number(r.worst, 2), r.note] for r in s.ways
    ]
    words = (
        "Pictures of a sphere, one ray a pixel, by other ways of evaluating its material. Errors are over the mean "
        "radiance of the sphere, against the first way."
    )
    header = ["material", "way", "ms", "error", "largest", ""]
    return part("Exact and approximate", "ways", words, table("", header, rows, right=(2, 3, 4)))


def _shared(s: SceneBench) -> Group:
    rows: list[list[Text]] = [
        [
            r.material,
            str(r.wavelengths),
            number(1e3 * r.together_s),
            number(1e3 * r.apart_s),
            number(r.apart_s / r.together_s),
        ]
        for r in s.shared
    ]
    words = "The wavelengths of a picture share rays, hits and shadows, and in the models what does not depend on them."
    header = ["sample", "wavelengths", "ms together", "ms in a picture each", "times faster"]
    return part("Wavelengths together", "shared", words, table("", header, rows, right=(1, 2, 3, 4)))


def _peers(s: SceneBench) -> Group:
    rows: list[list[Text]] = [
        [
            p.scene,
            p.note,
            f"{p.largest:.2f}",
            f"{p.rms:.2f}",
            f"{p.beyond_three} of {p.tiles}",
            f"{number(1e3 * p.ours_s)} ms, {percent(p.ours_rms)}",
            f"{number(1e3 * p.theirs_s)} ms, {percent(p.theirs_rms)}",
            number(p.ours_to_one_percent_s, 2),
            number(p.theirs_to_one_percent_s, 2),
        ]
        for p in s.peers
    ]
    words = (
        "The same scenes as gonio render --to mitsuba writes them, as many rays a pixel in both. Tiles are of 8 x 8 "
        "pixels; their differences are in standard errors, and 0.3 % lie beyond three by chance. Mitsuba computes in "
        f"float32, in a process of its own. Found: {s.mitsuba}."
    )
    header = ["scene", "by", "largest", "rms", "beyond 3", "ours", "Mitsuba", "s to 1 %: ours", "Mitsuba"]
    blocks: list[Block] = [Heading(2, "Beside Mitsuba 3"), Paragraph(words, "note")]
    if rows:
        blocks.append(table("", header, rows, right=tuple(range(2, 9))))
    return section(blocks, "mitsuba")


def _method(s: SceneBench) -> Group:
    m = s.machine
    busy = f"{m.load[0]:.1f} when the run began" if m.load else "unknown"
    rows = [
        ("times", "wall-clock time of rendering in process, the best of the repeats; reading and writing are left out"),
        ("load", busy),
    ]
    return method(s, rows)


def drawn(s: SceneBench) -> list[Figure]:
    """Error against time, for rays a pixel and for tolerances."""

    def on(figure: Any) -> None:
        axes = figure.subplots()
        figure.subplots_adjust(0.13, 0.16, 0.98, 0.97)
        scenes = list(dict.fromkeys(r.scene for r in s.samples))
        for name, colour in zip(scenes, COLOURS, strict=False):
            for rows, style, label in ((s.samples, "o-", "rays for all"), (s.tolerances, "s--", "to a tolerance")):
                points = [(r.seconds, r.rms) for r in rows if r.scene == name]
                axes.plot(*zip(*points, strict=True), style, color=colour, ms=4, lw=1.2, label=f"{name}, {label}")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("seconds", fontsize=8)
        axes.set_ylabel("root mean square error", fontsize=8)
        axes.grid(True, color=FAINT, lw=0.4)
        axes.tick_params(which="both", labelsize=7.5)
        axes.legend(fontsize=7.5, frameon=False)

    caption = (
        "Error against time. With rays for all it is over the mean radiance; to a tolerance it is over the pixel's, "
        "where that is larger."
    )
    alt = " ".join(f"{r.scene}, {number(r.rays)} rays: {r.seconds:.2g} s, {r.rms:.2g}." for r in s.samples)
    return [rendered("error-against-time", "front", "", caption, alt, (5.2, 3.2), on)]
