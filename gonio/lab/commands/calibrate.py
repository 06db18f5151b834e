"""`gonio calibrate geometry | camera | light`: what they take; `calibrate_geometry.py` and its like do the work."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from gonio import lost
from gonio.lab.commands.opened import RigOption, Search, Seed, WavelengthOption, Yes

app = typer.Typer(no_args_is_help=True)


@app.callback()
def _calibrate() -> None:
    """Calibrate a rig: values of its file, measured, with their covariance.

    First the geometry, then the camera, then the light. Name each file in the rig file before the next: [calibration]
    files = ["geometry.toml", "camera.toml", "light.toml"]
    """


@app.command()
def camera(
    rig: RigOption,
    out: Annotated[Path, typer.Option(help="The calibration file to write.")] = Path("camera.toml"),
    frames: Annotated[
        Path | None, typer.Option(help="Reduce the frames of this folder; moves nothing.")
    ] = None,
    response: Annotated[bool, typer.Option("--response", help="The response curve of 8 bits alone.")] = False,
    only: Annotated[
        str, typer.Option(help="What to take, with commas: flats (darks and flats), trap, edge.")
    ] = "flats,trap,edge",
    pairs: Annotated[int, typer.Option(min=1, max=50, help="Pairs of flats at each exposure.")] = 2,
    wavelength: WavelengthOption = None,
    valid_days: Annotated[
        int | None, typer.Option(min=1, help="Days until the file is out of date.")
    ] = None,
    seed: Seed = 0,
    yes: Yes = False,
) -> None:  # fmt: skip
    """Measure the camera, and write its keys of the rig file with their covariance.

    Beside OUT: OUT-frames, the raw frames, to reduce again with --frames; OUT-maps.npz; OUT.png. The lamp is dark and
    the arms parked afterwards.
    """
    from gonio.lab.commands import calibrate_camera as work

    asked = work.CameraOptions(only, pairs=pairs, wavelength_nm=wavelength, seed=seed, yes=yes)
    work.calibrate(rig, out, frames, asked, response=response, valid_days=valid_days)


@app.command()
def geometry(
    rig: RigOption,
    out: Annotated[Path | None, typer.Option(help="The calibration file.")] = None,
    images: Annotated[
        Path | None, typer.Option(help="A folder of pictures of a ChArUco board.")
    ] = None,
    board: Annotated[
        Path | None, typer.Option(help="The board: a .toml, or OpenCV's .yml.")
    ] = None,
    holder: Annotated[
        str | None,
        typer.Option(help="What is put into the holder, by commas: mirror, empty. Without it both, where the arms can "
                          "face each other; with --images, none."),
    ] = None,
    scans: Annotated[
        Path | None, typer.Option(help="Kept sightings: fit these again; moves nothing.")
    ] = None,
    print_fiducials: Annotated[
        Path | None,
        typer.Option(help="Write the sheet of the holder's markers (.svg, .png), and nothing else."),
    ] = None,
    valid_days: Annotated[int, typer.Option(min=1, help="How long the calibration may be used.")] = 365,
    search: Search = 8.0,
    quick: Annotated[bool, typer.Option("--quick", help="A quarter of the poses: known half as well.")] = False,
    seed: Seed = 0,
    yes: Yes = False,
) -> None:  # fmt: skip
    """Calibrate a rig's geometry: the lens from pictures of a board; zeros, encoders, axes, holder from frames.

    Beside OUT: OUT-sightings/, all that was seen, to fit again with --scans; and OUT-residuals.png.
    """
    from gonio.lab.commands import calibrate_geometry as work

    if print_fiducials is not None:
        return work.print_sheet(rig, print_fiducials)
    asked = work.GeometryOptions(holder, search_deg=search, share=work.QUICK if quick else 1.0, seed=seed, yes=yes)
    return work.calibrate(rig, out, images, board, scans, asked, valid_days)


@app.command()
def light(
    rig: Annotated[str, typer.Option(help="A rig file.")],
    out: Annotated[Path, typer.Option(help="The calibration file to write.")],
    only: Annotated[Literal["both", "lamp", "beam"], typer.Option(help="What to measure on the rig.")] = "both",
    minutes: Annotated[float, typer.Option(min=1, max=10_000, help="How long to watch the lamp.")] = 60.0,
    every: Annotated[float, typer.Option(min=0.1, help="Seconds from burst to burst of frames.")] = 15.0,
    series: Annotated[Path | None, typer.Option(help="An earlier series of the lamp.")] = None,
    spectra: Annotated[Path | None, typer.Option(help="Spectra of bands: band, wavelength_nm, signal.")] = None,
    lines: Annotated[Path | None, typer.Option(help="Known lines: line_nm, read_nm.")] = None,
    lamp_polariser: Annotated[
        Path | None, typer.Option(help="A polariser turned in the beam: polariser_deg, signal.")
    ] = None,
    polarisers: Annotated[
        Path | None, typer.Option(help="A polarised run over a black dielectric, such as black glass.")
    ] = None,
    index: Annotated[float, typer.Option(min=1.01, max=5.0, help="With --polarisers: its index.")] = 1.5,
    valid_days: Annotated[int | None, typer.Option(min=1, help="How long it is good.")] = None,
    wavelength: WavelengthOption = None,
    seed: Seed = 0,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nobody: the white lies in the holder.")] = False,
) -> None:
    """Calibrate lamp, beam, bands and polarisation, with the covariance of what is found.

    With files of earlier data nothing moves, and only they are evaluated. Without, the rig is driven, and its raw data
    lie beside OUT: OUT-series.csv and OUT-flats.csv.
    """
    from gonio.lab.commands import calibrate_light as work

    earlier = work.EarlierData(series, spectra, lines, lamp_polariser, polarisers)
    asked = work.LightOptions(only, index, minutes=minutes, every_s=every, wavelength_nm=wavelength, seed=seed, yes=yes)
    with lost.whole(out):
        work.calibrate(rig, out, earlier, asked, valid_days)
