"""The page of the papers' pictures: all of them rendered, and verdicts on what the texts say of them."""

import base64
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import cv2
from gonio_analysis.report import files, frame
from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Heading,
    Page,
    Paragraph,
    Span,
    Text,
    footer,
    notes,
    stamp,
    table,
)
from gonio_analysis.report.drawing import Figure, rendered
from gonio_analysis.report.text import slug
from gonio_scenes.picture import Image, display
from gonio_scenes.render import Step, render
from gonio_scenes.scene import read

from gonio import lost
from gonio.typing import JsonObject
from gonio_validation.papers.figure import Claim, Trace, trace_panel
from gonio_validation.papers.pictures import blinn, cook_torrance, htsg, oren_nayar
from gonio_validation.papers.pictures.catalogue import SHOWN, TITLE, Shown, names, scene_file
from gonio_validation.papers.pictures.sheet import contact_sheet, verdicts

JPEG_QUALITY = 90
"""Quality of the pictures in the page; the PNG beside it are without loss."""


def make(out: str | Path, *, figure: str | None = None, command: str = "", step: Step | None = None) -> Path:
    """Render the pictures, judge what the texts say of them, and write the page: all of it or nothing.

    Parameters
    ----------
    out
        Folder of the page; an earlier page there is replaced.
    figure
        The one that is made, as in `catalogue.SHOWN`: "htsg-12"; None for all of them, with a sheet of all.
    command
        The command line, for the record.
    step
        Told how much is done, in rays times wavelengths.

    Returns
    -------
    Path
        Where `index.html` is.

    Raises
    ------
    ConfigError
        The folder cannot be written or holds something else.
    """
    which = [shown for shown in SHOWN if figure in (None, shown.name)]
    title = TITLE if figure is None else which[0].title
    with files.staged(out) as stage:
        images, times = _rendered(stage.work, names(which), step or (lambda done, of: None))
        began = time.perf_counter()
        judged = {shown.name: _judged(shown.name) for shown in which}
        times["claims"] = time.perf_counter() - began
        if figure is None:
            sheet = stage.work / "contact_sheet.png"
            lost.kept(sheet.name, lambda: sheet.write_bytes(contact_sheet(images, judged)), lambda loss: 0)
        found = {
            "title": title,
            **stamp(command),
            "seconds": {name: round(seconds, 3) for name, seconds in times.items()},
            "figures": [
                {
                    "figure": shown.name,
                    "title": shown.title,
                    "pictures": [name for name, _ in shown.pictures],
                    "remark": shown.remark,
                    "claims": [c.summary for c in judged[shown.name]],
                }
                for shown in which
            ],
        }

        def draw() -> list[Figure]:
            return [_cross_sections()] if "oren-nayar-13" in judged else []

        files.write_page(stage.work, title, partial(_page, found, which, images, judged), lambda _: found, draw)
    return Path(out) / "index.html"


def _judged(figure: str) -> list[Claim]:
    return lost.kept(f"claims of {figure}", lambda: claims(figure), lambda loss: [])


def claims(figure: str, height: int | None = None) -> list[Claim]:
    """What a paper's text says of a figure, judged in its pictures.

    Parameters
    ----------
    figure
        As in `catalogue.SHOWN`: "htsg-12".
    height
        Rows of the pictures that are measured, in place of their files'.
    """
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


def _rendered(folder: Path, wanted: Sequence[str], step: Step) -> tuple[dict[str, Image], dict[str, float]]:
    """Pictures as RGB, and the seconds that each took; its PNG and its scene file are written."""
    images: dict[str, Image] = {}
    times: dict[str, float] = {}
    (folder / "pictures").mkdir()
    (folder / "scenes").mkdir()
    scenes = {name: read(scene_file(name)) for name in wanted}
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
    panel = trace_panel(
        "oren-nayar-13",
        "Fig. 13: brightness across the vase at half of its height, from the pictures; its largest value 1.",
        [Trace(words, *section, "Lambert" in words) for words, section in oren_nayar.sections().items()],
        "position across the vase [radii], positive to the right",
        "brightness",
    )
    return rendered(panel.name, panel.name, "", panel.caption, panel.caption, panel.inches, panel.draw)


# --- the page -------------------------------------------------------------------------------------------------------


def _notes(found: JsonObject) -> list[Block]:
    times = ", ".join(f"{name} {seconds:.1f}" for name, seconds in found["seconds"].items())
    remarks = [
        "Cook-Torrance Figs. 6 and 7: as printed (I_ia = 0.01 I_i) ambient light would be "
        f"{cook_torrance.ambient_as_printed(100):.0f} times what the two lights give on the plastic vase, whose "
        "solid angles are 0.0001 and 0.0002. It is taken as 0.01 of their irradiance instead.",
        "Ambient light is multiplied by ambient_reflectance where a scene file gives it.",
    ]
    return [
        Heading(3, "Notes", "ambient light"),
        notes(remarks),
        *frame.provenance(found, ("seconds", times), called="made"),
    ]


HOW = (
    "Each verdict is measured from the radiances of one ray a pixel, by the criterion beside it. Where the paper leaves"
    " open what a claim hangs on, several choices are tried; without agreement there is no verdict. Nor is there one"
    " where what it hangs on was chosen so that it is seen. Shapes, places and cameras are chosen in every picture."
)
FOOTER = footer(
    "Every picture is in `pictures/`, its scene file in `scenes/` for `gonio render`, every verdict in `summary.json`."
)


def _page(
    found: JsonObject, which: Sequence[Shown], images: Mapping[str, Image], judged: Mapping[str, list[Claim]],
    plots: Sequence[Figure],
) -> Page:  # fmt: skip
    every = [c for shown in which for c in judged[shown.name]]
    of = f" of {len(which)} figures" if len(which) > 1 else ""
    rows: list[list[Text]] = []
    folds: list[Block] = []
    first: tuple[Figure, ...] = ()
    taken = set[str]()  # a picture may stand in two figures
    for shown in which:
        title, claims = shown.title.partition(":")[0], judged[shown.name]
        figures = tuple(
            _raster(f"{shown.name}.{name}" if name in taken else name, label, images[name])
            for name, label in shown.pictures
        )
        taken |= {name for name, _ in shown.pictures}
        if shown.name == "oren-nayar-13":
            figures = (*plots, *figures)
        rows.append([Span(title, href=f"#page.{slug(shown.title)}"), verdicts(claims)])
        said = [[c.verdict, c.text, c.found, c.criterion] for c in claims]
        folds += [
            Heading(3, shown.title, verdicts(claims)),
            *([Figures(figures, small=True)] if first else []),
            table("", ["verdict", "what the text says", "found", "criterion"], said),
            Paragraph(shown.remark, "note"),
        ]
        first = first or figures
    folds += [Heading(3, "How claims are judged", "from radiances, by a criterion each"), Paragraph(HOW)]
    return frame.page(
        found["title"],
        f"Rendered with gonio {found['versions']['gonio']}, {found['created'][:10]}.",
        frame.answer(
            [Paragraph(f"{len(images)} picture{'s' * (len(images) > 1)}{of}. {verdicts(every)}.", "lead")],
            [Figures(first, small=True)],
            [table("", ["figure", "what the text says"], rows)],
        ),
        folds=[*folds, *_notes(found)],
        foot=FOOTER,
    )


def _raster(name: str, label: str, image: Image) -> Figure:
    """A picture as a figure of a page: an SVG that holds a JPEG."""
    high, wide = image.shape[:2]
    done, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    assert done
    text = base64.b64encode(bytes(data)).decode()
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" style="max-width: {wide}px">'
        f'<image width="{wide}" height="{high}" href="data:image/jpeg;base64,{text}"/></svg>'
    )
    return Figure(name, name, "", label, f"{label}, rendered", svg, b"")
