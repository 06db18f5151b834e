"""`gonio calibrate camera`: gain, noise, linearity, dark current, maps and stray light of a rig's camera."""

from __future__ import annotations

import datetime
import sys
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gonio.cli.by_hand import RigOption, WavelengthOption, _told_where, manual_rig_of
from gonio.cli.calibrate import app
from gonio.shown import apart

if TYPE_CHECKING:
    from gonio.by_hand.manual_rig import ManualRig
    from gonio.calibration.camera import CameraCalibration
    from gonio.calibration.camera_frames import CameraFrame
    from gonio.rig.description import RigDescription

__all__ = ["app"]

PROMPTS = {
    "reference": "Put the white reference into the holder",
    "trap": "Put a black trap into the holder, in the sample's place (a box with a hole, or black velvet in a tube)",
    "edge": "Put the knife edge before the white reference: it covers x > 0, its edge at the sample's centre",
    "sample": "Put the sample back into the holder",
}


@app.command()
def camera(
    rig: RigOption,
    out: Annotated[Path, typer.Option(help="The calibration file to write.")] = Path("camera.toml"),
    frames: Annotated[
        Path | None, typer.Option(help="Reduce the frames of this folder; moves nothing.", show_default=False)
    ] = None,
    response: Annotated[bool, typer.Option("--response", help="The response curve of 8 bits alone.")] = False,
    only: Annotated[
        str, typer.Option(help="What to take, with commas: flats (darks and flats), trap, edge.")
    ] = "flats,trap,edge",
    pairs: Annotated[int, typer.Option(min=1, max=50, help="Pairs of flats at each exposure.")] = 2,
    wavelength: WavelengthOption = None,
    valid_days: Annotated[
        int | None, typer.Option(min=1, help="Days until the file is out of date.", show_default=False)
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of a simulated rig.")] = 0,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nobody: what has to lie in the holder does.")] = False,
) -> None:  # fmt: skip
    """Measure the camera, and write its keys of the rig file with their covariance.

    Beside OUT: OUT-frames, the raw frames, to reduce again with --frames; OUT-maps.npz; OUT.png. The lamp is dark and
    the arms parked afterwards.
    """
    from gonio.acquisition.measure import find_rig
    from gonio.calibration import camera as calibration
    from gonio.calibration.camera_frames import read_list
    from gonio.cli import console
    from gonio.errors import ConfigError
    from gonio.rig.calibrated import write_calibration

    kinds = [kind.strip() for kind in only.split(",") if kind.strip()]
    if unknown := [kind for kind in kinds if kind not in ("flats", "trap", "edge")]:
        raise ConfigError(f"--only {only}: there is no {unknown[0]}; there are flats, trap, edge")
    if "flats" not in kinds:
        raise ConfigError(f"--only {only}: flats are needed, trap and edge can be left out")
    if out.suffix != ".toml" or not out.absolute().parent.is_dir():
        raise ConfigError(f"--out {out}: must end with .toml, and lie in a folder that is there")
    maps, picture, folder = (out.with_name(f"{out.stem}{end}") for end in ("-maps.npz", ".png", "-frames"))
    for name in (out, maps, picture) if frames is not None else (out, maps, picture, folder):
        if name.exists():
            raise ConfigError(f"{name}: is there already; name another file with --out")
    # what was measured before of the camera is not to be taken out of what is measured now
    description = find_rig(rig, without="camera").description
    if not response and _has_response(description, rig):
        raise ConfigError(
            f"{rig}: the camera has a response curve (camera.response): photon transfer is for linear cameras, "
            f"and its noise "
            "stays that of the rig file; --response measures the curve again"
        )
    band = _band(description, wavelength)
    if frames is None:
        taken = _take(rig, folder, kinds, pairs=pairs, wavelength=wavelength, seed=seed, yes=yes)
    else:
        taken = read_list(frames)
    if response:
        found = calibration.calibrate_response(taken, description)
    else:
        found = calibration.calibrate(taken, description, band.channel)
    until = datetime.date.today() + datetime.timedelta(days=valid_days) if valid_days is not None else None
    file = found.file(description, valid_until=until, maps=maps.name)
    written = [str(out)]
    if found.maps is not None:
        found.maps.write(maps)
        written.append(str(maps))
    if _draw(found, description.camera, picture):
        written.append(str(picture))
    write_calibration(file, out)
    _show(found, description.camera)
    console.show(*written)


def _has_response(description: RigDescription, rig: str) -> bool:
    """Whether the rig file, or a calibration that it names, gives the camera a response curve."""
    from gonio.rig.calibrated import read_calibration

    files = [Path(rig).parent / name for name in description.calibration.files]
    given = [read_calibration(file).values.get("camera") for file in files]
    return bool(description.camera.response) or any(isinstance(keys, dict) and keys.get("response") for keys in given)


def _band(description: Any, wavelength: float | None) -> Any:
    from gonio.by_hand.manual_rig import EYE_NM

    if wavelength is not None:
        return description.bands.containing(wavelength)
    return min(description.bands.all(), key=lambda band: abs(band.centre_nm - EYE_NM))


def _take(
    rig: str, folder: Path, kinds: list[str], *, pairs: int, wavelength: float | None, seed: int, yes: bool
) -> list[CameraFrame]:
    """Drive the rig through all frames; those that were taken are kept whatever happens."""
    from gonio.calibration.camera_scan import Scan
    from gonio.cli import console

    manual = manual_rig_of(rig, "arms", "light", "camera", seed=seed, without="camera")
    if wavelength is not None:
        manual.choose_band(wavelength)
    folder.mkdir()
    counter = partial(console.counter, lines=True)
    scan = Scan(manual, folder, pairs=pairs, say=console.note, counter=counter)
    try:
        with _told_where(manual), manual:
            _put(manual, "reference", yes=yes)
            scan.go()
            scan.darks()
            scan.flats()
            scan.field()
            for kind in ("trap", "edge"):
                if kind in kinds:
                    _put(manual, kind, yes=yes)
                    scan.stray(kind)
            _put(manual, "sample", yes=True)  # nobody has to press a key for it
    finally:
        scan.keep()
        console.note(f"{folder}: {len(scan.frames)} frames")
    console.note("lamp dark, arms parked; put the sample back")
    return scan.frames


def _put(manual: ManualRig, what: str, *, yes: bool) -> None:
    """Have the holder hold what is needed, with the lamp dark: by the rig itself, or by the person, who confirms it."""
    from gonio.cli import console
    from gonio.errors import DeviceError

    manual.lamp(False)
    if manual.description.reference.how == "axis":  # the rig itself turns the white reference into the beam
        manual.present("reference" if what in ("reference", "edge") else "sample")
    if hasattr(manual, "put") and manual.put(what):
        return
    if what == "reference" and manual.description.reference.how == "axis":
        return
    if yes:
        console.note(f"{PROMPTS[what]} (--yes: taken as done)")
        return
    print(f"{PROMPTS[what]}, then press Enter (Ctrl-C stops): ", end="", file=sys.stderr, flush=True)
    if not sys.stdin.readline():
        raise DeviceError("there is no terminal to confirm what lies in the holder; --yes asks for none")


def _draw(found: CameraCalibration, description: Any, picture: Path) -> bool:

    from gonio.calibration import camera_plots
    from gonio.disk import write_whole

    figure = camera_plots.draw(found, description)
    if figure is None:
        return False
    drawn = BytesIO()
    figure.savefig(drawn, format="png", dpi=110)
    write_whole(picture, drawn.getvalue())
    return True


def _show(found: CameraCalibration, was: Any) -> None:
    from gonio.cli import console

    u = dict(zip(found.names, found.covariance.diagonal() ** 0.5, strict=True))
    table = console.table("camera.", "value", "u (k = 1)", "was")
    for key, value in found.values.items():
        before = getattr(was, key)
        if key == "response":
            table.add_row(key, "256 values", "", "256 values" if before else "none")
        elif isinstance(value, list):
            for k, one in enumerate(value):
                known = f"{before[k]:.5g}" if k < len(before) else "0"
                table.add_row(f"{key}[{k}]", *apart(one, u[f"{key}[{k}]"]), known)
        else:
            then, _ = (str(before).lower(), "") if isinstance(before, bool) else apart(before, None)
            now = (str(value).lower(), "") if isinstance(value, bool) else apart(value, u.get(key))
            table.add_row(key, *now, then)
    console.show(table)
    rows = console.table("EMVA 1288", "value")
    for key, value in found.measured.items():
        numbers = value if isinstance(value, list) else [value]
        rows.add_row(key, ", ".join(f"{one:.5g}" for one in numbers))
    console.show(rows)
    for note in found.notes:
        console.show(f"note: {note}")
