"""The commands `gonio render` and `gonio photograph`. Nothing heavy is imported before one runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gonio.cli import console
from gonio.errors import ConfigError
from gonio.platform import command_line

if TYPE_CHECKING:
    from gonio_scenes.scene import Scene


def render(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (TOML).")],
    out: Annotated[Path, typer.Option(help="Folder of the picture.")],
    exr: Annotated[bool, typer.Option("--exr", help="Write picture.exr too, a float channel a wavelength.")] = False,
    to: Annotated[str | None, typer.Option(help='Write the scene for another renderer instead: "mitsuba".')] = None,
    error: Annotated[
        str | None,
        typer.Option(
            metavar="SHARE",
            help="Take the cheapest form of each material by which no pixel is off by more, as 1%.",
        ),
    ] = None,
) -> None:
    """Render a scene file through the models. Prints the picture's path."""
    from gonio_scenes import picture
    from gonio_scenes.cheaper import render_to_error
    from gonio_scenes.render import render as rendered
    from gonio_scenes.scene import read, too_bright

    described = read(scene)
    share = None if error is None else _share(error)
    if share is not None and to is not None:
        raise ConfigError("--error and --to exclude each other: nothing is rendered")
    for told in dict.fromkeys(too_bright(described)):
        console.note(f"{told}: light in the picture is not conserved")
    if to is not None:
        _write(described, out, to, exr)
        return
    picture.require_free(described, out, exr=exr)
    if share is None:
        taken = None
        with console.counter("rendering") as step:
            result = rendered(described, step=step)
    else:
        result, taken = render_to_error(described, share)
        for each in taken:
            console.note(f"material.{each.material}: {each.words}")
    picture.write(described, result, out, exr=exr, command=command_line(), forms=taken)
    for material, share in result.extrapolated.items():
        told = "no lamp lights it" if share is None else f"{share:.0%} of its light is extrapolated"
        console.note(f"material.{material}: a measured table, {told}; summary.json says how")
    if result.above_tolerance:
        console.note(f"{result.above_tolerance} pixels are above the tolerance still; summary.json says how far")
    print(out / "picture.png")


def _share(text: str) -> float:
    """A share as people write it: 1%, 0.01."""

    try:
        share = float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
    except ValueError:
        share = 0.0
    if not 0.0 < share < 1.0:
        raise ConfigError(f"--error {text}: it has to be a share between 0 and 1, as 1% or 0.01")
    return share


def _write(scene: Scene, out: Path, to: str, exr: bool) -> None:
    from gonio_scenes import mitsuba

    if to != "mitsuba":
        raise ConfigError(f'--to {to}: there is no such renderer; "mitsuba" is what scenes are written for')
    if exr:
        raise ConfigError("--exr and --to exclude each other: nothing is rendered")
    made = mitsuba.write(scene, out, command_line())
    for left in made.left_out:
        console.note(f"{left['what']}: {left['why']}")
    for name in made.scenes:
        print(out / name)


def photograph(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file: camera, shape and light as known.")],
    image: Annotated[
        Path, typer.Argument(metavar="IMAGE", help="A raw frame, or linear radiances: .npz, .exr, .npy, .tif.")
    ],
    out: Annotated[Path, typer.Option(help="The measurement table to write (.csv).")],
) -> None:
    """Measure from a photograph of a curved sample. Every square of pixels becomes a row of a measurement table."""
    from gonio import measurement
    from gonio_scenes.photograph import reduce
    from gonio_scenes.scene import read

    described = read(scene)
    try:
        table = reduce(described, image)
    except ConfigError as error:
        raise ConfigError(f"{scene}: {error}") from None
    for note in table.attrs["notes"]:
        console.note(note)
    for remark in measurement.write(table, out):
        console.note(remark)
    counts = table["flag"].value_counts()
    used = int(counts.pop("")) if "" in counts else 0
    aside = "".join(f", {count} {word}" for word, count in counts.items())
    console.show(f"{out}: {used} values{aside}")
