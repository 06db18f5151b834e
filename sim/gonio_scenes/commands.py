"""The commands `gonio render` and `gonio photograph`. Nothing heavy is imported before one runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gonio.cli import console

if TYPE_CHECKING:
    from gonio_scenes.scene import Scene


def render(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (TOML).")],
    out: Annotated[Path, typer.Option(help="Folder of the picture.")],
    exr: Annotated[bool, typer.Option("--exr", help="Write picture.exr too, a float channel a wavelength.")] = False,
    to: Annotated[str | None, typer.Option(help='Write the scene for another renderer instead: "mitsuba".')] = None,
) -> None:
    """Render a scene file through the models. Prints the picture's path."""
    from gonio.platform import command_line
    from gonio_scenes import picture
    from gonio_scenes.render import render as rendered
    from gonio_scenes.scene import read, too_bright

    described = read(scene)
    for told in dict.fromkeys(too_bright(described)):
        console.note(f"{told}: light in the picture is not conserved")
    if to is not None:
        _write(described, out, to, exr)
        return
    picture.require_free(described, out, exr=exr)
    with console.counter("rendering") as step:
        result = rendered(described, step=step)
    picture.write(described, result, out, exr=exr, command=command_line())
    for material, share in result.extrapolated.items():
        told = "no lamp lights it" if share is None else f"{share:.0%} of its light is extrapolated"
        console.note(f"material.{material}: a measured table, {told}; summary.json says how")
    if result.above_tolerance:
        console.note(f"{result.above_tolerance} pixels are above the tolerance still; summary.json says how far")
    print(out / "picture.png")


def _write(scene: Scene, out: Path, to: str, exr: bool) -> None:
    from gonio.errors import ConfigError
    from gonio.platform import command_line
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
    from gonio.errors import ConfigError
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
