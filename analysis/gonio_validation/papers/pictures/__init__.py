"""The papers' pictures, rendered again from scene files, with verdicts on what the texts say of them."""

from __future__ import annotations

import base64
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio_validation.papers.pictures.catalogue import SHOWN, Shown, names, scene_file

if TYPE_CHECKING:
    from gonio_analysis.report.blocks import Block, Page
    from gonio_analysis.report.drawings import Figure
    from gonio_scenes.picture import Image

    from gonio_validation.papers.figure import Claim

TITLE = "The papers' pictures, rendered again"
Step = Callable[[int, int], None]
"""Told how much is done, of how much."""
JPEG_QUALITY = 90
"""Of the pictures in the page; the PNG beside it are without loss."""


def make(out: str | Path, *, command: str = "", step: Step | None = None) -> Path:
    """Render every picture, judge what the texts say of them, and write the page: all of it or nothing.

    Parameters
    ----------
    out
        Folder of the page; an earlier page there is replaced.
    command
        The command line, for the record.
    step
        Told how much is done, in rays times wavelengths.

    Returns
    -------
    Path
        Of `index.html`.

    Raises
    ------
    ConfigError
        The folder cannot be written or holds something else.
    """
    from gonio_analysis.report import files, html
    from gonio_analysis.report.blocks import stamp

    from gonio_validation.papers.pictures.sheet import contact_sheet

    with files.staged(out) as stage:
        images, times = _rendered(stage.work, step or (lambda done, of: None))
        began = time.perf_counter()
        judged = {shown.name: claims(shown.name) for shown in SHOWN}
        times["claims"] = time.perf_counter() - began
        (stage.work / "contact_sheet.png").write_bytes(contact_sheet(images, judged))
        found = {
            "title": TITLE,
            **stamp(command),
            "seconds": {name: round(seconds, 3) for name, seconds in times.items()},
            "figures": [
                {
                    "figure": shown.name,
                    "title": shown.title,
                    "pictures": [name for name, _ in shown.pictures],
                    "remark": shown.remark,
                    "claims": [
                        {"claim": c.text, "verdict": c.verdict, "found": c.found, "criterion": c.criterion}
                        for c in judged[shown.name]
                    ],
                }
                for shown in SHOWN
            ],
        }
        plot = _cross_sections()
        files.write(stage.work, found, [plot])
        page = html.document(_page(found, images, judged, plot))
        (stage.work / "index.html").write_text(page, encoding="utf-8", newline="\n")
    return Path(out) / "index.html"


def claims(figure: str, height: int | None = None) -> list[Claim]:
    """What a paper's text says of a figure, judged in its pictures.

    Parameters
    ----------
    figure
        As in `catalogue.SHOWN`: "htsg-12".
    height
        Rows of the pictures that are measured, in place of their files'.
    """
    from gonio_validation.papers.pictures import blinn, cook_torrance, htsg, oren_nayar

    judges: dict[str, Callable[[int | None], list[Claim]]] = {
        "htsg-12": htsg.figure_12,
        "htsg-13": htsg.figure_13,
        "htsg-14": htsg.figure_14,
        "cook-torrance-6": cook_torrance.figure_6,
        "cook-torrance-7": cook_torrance.figure_7,
        "cook-torrance-8": cook_torrance.figure_8,
        "blinn-7a": blinn.figure_7a,
        "blinn-7b": blinn.figure_7b,
        "blinn-8": blinn.figure_8,
        "oren-nayar-12": oren_nayar.figure_12,
        "oren-nayar-13": oren_nayar.figure_13,
        "oren-nayar-14": oren_nayar.figure_14,
        "oren-nayar-15": oren_nayar.figure_15,
    }
    return judges[figure](height)


def _rendered(folder: Path, step: Step) -> tuple[dict[str, Image], dict[str, float]]:
    """Every picture as RGB, and the seconds that each took; its PNG and its scene file are written."""
    import cv2
    from gonio_scenes.picture import display
    from gonio_scenes.render import render
    from gonio_scenes.scene import read

    images: dict[str, Image] = {}
    times: dict[str, float] = {}
    (folder / "pictures").mkdir()
    (folder / "scenes").mkdir()
    scenes = {name: read(scene_file(name)) for name in names()}
    work = {n: s.camera.pixels * s.camera.samples * s.wavelength_nm.size for n, s in scenes.items()}
    total, before = sum(work.values()), 0
    for name, scene in scenes.items():
        began = time.perf_counter()

        def told(done: int, of: int, share: int = work[name], first: int = before) -> None:
            step(first + share * done // of, total)

        images[name], _ = display(scene, render(scene, step=told).radiance)
        times[name] = time.perf_counter() - began
        before += work[name]
        cv2.imwrite(str(folder / "pictures" / f"{name}.png"), images[name][..., ::-1])
        shutil.copyfile(scene_file(name), folder / "scenes" / f"{name}.toml")
    step(total, total)
    return images, times


def _cross_sections() -> Figure:
    """Oren and Nayar's Fig. 13."""
    from gonio_analysis.report.drawings import rendered

    from gonio_validation.papers.panels import Trace, trace_panel
    from gonio_validation.papers.pictures import oren_nayar

    traces = [Trace(words, *section, "Lambert" in words) for words, section in oren_nayar.sections().items()]
    panel = trace_panel(
        "oren-nayar-13",
        "Fig. 13: brightness across the vase at half of its height, from the pictures; its largest value 1.",
        traces,
        "position across the vase [radii], positive to the right",
        "brightness",
    )
    return rendered(panel.name, panel.name, "", panel.caption, panel.caption, panel.inches, panel.draw)


# --- the page -------------------------------------------------------------------------------------------------------


def _notes(found: dict[str, Any]) -> list[Block]:
    from gonio_analysis.report.blocks import Heading, facts, notes, section

    from gonio_validation.papers.pictures.cook_torrance import ambient_as_printed

    times = found["seconds"]
    return [
        section(
            [
                Heading(2, "Notes"),
                notes(
                    [
                        "Cook-Torrance Figs. 6 and 7: as printed (I_ia = 0.01 I_i) ambient light would be "
                        f"{ambient_as_printed(100):.0f} times what the two lights give on the plastic vase, whose "
                        "solid angles are 0.0001 and 0.0002. It is taken as 0.01 of their irradiance instead.",
                        "Ambient light is multiplied by ambient_reflectance where a scene file gives it.",
                    ]
                ),
            ]
        ),
        section(
            [
                Heading(2, "Provenance"),
                facts(
                    [
                        ("command", found["command"] or "–"),
                        ("made", found["created"]),
                        ("versions", ", ".join(f"{k} {v}" for k, v in found["versions"].items())),
                        ("seconds", ", ".join(f"{name} {seconds:.1f}" for name, seconds in times.items())),
                    ]
                ),
            ]
        ),
    ]


def _page(found: dict[str, Any], images: dict[str, Image], judged: dict[str, list[Claim]], plot: Figure) -> Page:
    from gonio_analysis.report.blocks import (
        Contents,
        Figures,
        Footer,
        Group,
        Heading,
        Page,
        Paragraph,
        code,
        section,
        table,
    )

    from gonio_validation.papers.pictures.sheet import verdicts

    every = [c for shown in SHOWN for c in judged[shown.name]]
    made = f"Rendered with gonio {found['versions']['gonio']}, {found['created'][:10]}."
    body: list[Block] = [
        Group("header", (Heading(1, TITLE), Paragraph(made, "sub"))),
        Paragraph(f"{len(images)} pictures of {len(SHOWN)} figures. {verdicts(every)}.", "lead"),
        Paragraph(
            "Each verdict is measured from the radiances of one ray a pixel, by the criterion beside it. Where the "
            "paper leaves open what a claim hangs on, several choices are tried; without agreement there is no "
            "verdict. Nor is there one where what it hangs on was "
            "chosen so that it is seen. Shapes, places and cameras are "
            "chosen in every picture."
        ),
        Contents(tuple((shown.name, shown.title.partition(":")[0]) for shown in SHOWN)),
    ]
    for shown in SHOWN:
        figures = tuple(_raster(name, label, images[name]) for name, label in shown.pictures)
        if shown.name == "oren-nayar-13":
            figures = (plot, *figures)
        rows = [[c.verdict, c.text, c.found, c.criterion] for c in judged[shown.name]]
        body.append(
            section(
                [
                    Heading(2, shown.title),
                    Figures(figures, small=True),
                    table("", ["verdict", "what the text says", "found", "criterion"], rows),
                    Paragraph(shown.remark, "note"),
                ],
                shown.name,
            )
        )
    body += [
        *_notes(found),
        Footer(
            (
                *("Every picture is in ", code("pictures/"), ", its scene file in ", code("scenes/"), " for "),
                *(code("gonio render"), ", every verdict in ", code("summary.json"), "."),
            )
        ),
    ]
    return Page(TITLE, tuple(body))


def _raster(name: str, label: str, image: Image) -> Figure:
    """A picture as a figure of a page: an SVG that holds a JPEG."""
    import cv2
    from gonio_analysis.report.drawings import Figure

    high, wide = image.shape[:2]
    done, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    assert done
    text = base64.b64encode(bytes(data)).decode()
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" style="max-width: {wide}px">'
        f'<image width="{wide}" height="{high}" href="data:image/jpeg;base64,{text}"/></svg>'
    )
    return Figure(name, name, "", label, f"{label}, rendered", svg, b"")


__all__ = ["SHOWN", "Shown", "claims", "make", "names", "scene_file"]
