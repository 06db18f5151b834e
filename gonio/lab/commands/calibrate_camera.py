"""`gonio calibrate camera`: gain, noise, linearity, dark current, maps and stray light of a rig's camera."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from gonio import lost
from gonio.cli import console
from gonio.disk import free_name, put_picture
from gonio.errors import ConfigError
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.by_hand.manual_rig import ManualRig, usual_band
from gonio.lab.calibration.camera import CameraCalibration, calibrate_response, draw, require_8_bits
from gonio.lab.calibration.camera import calibrate as reduced
from gonio.lab.calibration.camera_frames import CameraFrame, read_list
from gonio.lab.calibration.camera_scan import CameraScan
from gonio.lab.commands import opened
from gonio.lab.rig.calibration_files import read_calibration, with_keys, write_calibration
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Camera
from gonio.shown import apart

PROMPTS = {
    "reference": "Put the white reference into the holder",
    "trap": "Put a black trap into the holder, in the sample's place (a box with a hole, or black velvet in a tube)",
    "edge": "Put the knife edge before the white reference: it covers x > 0, its edge at the sample's centre",
    "sample": "Put the sample back into the holder",
}
PLAIN = [float(value) for value in range(256)]
"""The curve of a camera of 8 bits whose values are left as they are."""


@dataclass(frozen=True, slots=True)
class CameraOptions:
    """How the rig is driven: the options of the command."""

    only: str
    pairs: int
    wavelength_nm: float | None
    seed: int
    yes: bool

    @property
    def kinds(self) -> list[str]:
        """What to take; raises `ConfigError` where something else is named, or what is needed is not."""
        kinds = [kind.strip() for kind in self.only.split(",") if kind.strip()]
        if unknown := [kind for kind in kinds if kind not in ("flats", "trap", "edge")]:
            raise ConfigError(f"--only {self.only}: there is no {unknown[0]}; there are flats, trap, edge")
        if "flats" not in kinds:
            raise ConfigError(f"--only {self.only}: flats are needed, trap and edge can be left out")
        return kinds


def calibrate(
    rig: str, out: Path, frames: Path | None, asked: CameraOptions, *, response: bool, valid_days: int | None
) -> None:  # fmt: skip
    """Take the frames, or those of a folder, reduce them, and write the calibration with its maps and its picture.

    Raises
    ------
    ConfigError
        An option is wrong, or the camera has a response curve and none is asked for.
    DataError
        The frames tell no calibration.
    """
    kinds = asked.kinds
    maps, picture, folder = (out.with_name(f"{out.stem}{end}") for end in ("-maps.npz", ".png", "-frames"))
    picture = free_name(picture)
    opened.require_new(out, maps, *([folder] if frames is None else []))
    # what was measured before of the camera is not to be taken out of what is measured now
    description = find_rig(rig, without="camera").description
    if not response and _has_response(description, rig):
        raise ConfigError(
            f"{rig}: the camera has a response curve (camera.response): photon transfer is for linear cameras, "
            "and its noise stays that of the rig file; --response measures the curve again"
        )
    if response:
        require_8_bits(description.camera)
        kinds = ["flats"]  # and neither trap nor edge
    band = usual_band(description, asked.wavelength_nm)
    taken = read_list(frames) if frames is not None else _take(rig, folder, kinds, asked, response=response)
    found = calibrate_response(taken, description) if response else reduced(taken, description, band.channel)
    file = found.file(description, valid_days=valid_days, maps=maps.name)
    written = [out]
    if found.maps is not None:
        found.maps.write(maps)
        written.append(maps)
    with lost.whole(out):
        written += put_picture(picture, lambda: draw(found, description.camera))
        write_calibration(file, out)
        _show(found, description.camera)
        console.show(*map(str, written))


def _has_response(description: RigDescription, rig: str) -> bool:
    """Whether the rig file, or a calibration that it names, gives the camera a response curve."""
    files = [Path(rig).parent / name for name in description.calibration.files]
    given = [read_calibration(file).values.get("camera") for file in files]
    return bool(description.camera.response) or any(isinstance(keys, dict) and keys.get("response") for keys in given)


def _take(rig: str, folder: Path, kinds: list[str], asked: CameraOptions, *, response: bool) -> list[CameraFrame]:
    """Drive the rig through all frames; those that were taken are kept whatever happens."""
    choice = opened.choice_of(rig, without="camera")
    if response:  # values as the camera gives them, which a driver may refuse without a curve
        plain = with_keys(choice.description, {"camera": {"response": PLAIN}}, rig)
        choice = replace(choice, description=plain)
    manual = ManualRig(choice.open(seed=asked.seed, by_hand=True), choice.source, ("arms", "light", "camera"))
    if asked.wavelength_nm is not None:
        manual.choose_band(asked.wavelength_nm)
    folder.mkdir()
    scan = CameraScan(manual, folder, pairs=asked.pairs, say=console.note, counter=partial(console.counter, lines=True))
    try:
        with opened.told_where(manual), manual:
            put(manual, "reference", yes=asked.yes)
            scan.go()
            if response:
                scan.bracket()
            else:
                scan.darks()
                scan.flats()
                scan.field()
            for kind in ("trap", "edge"):
                if kind in kinds:
                    put(manual, kind, yes=asked.yes)
                    scan.stray(kind)
            put(manual, "sample", yes=True)  # nobody has to press a key for it
    finally:
        if scan.frames:
            scan.keep()
            console.note(f"{folder}: {len(scan.frames)} frames")
        else:
            folder.rmdir()
    console.note("lamp dark, arms parked; put the sample back")
    return scan.frames


def put(manual: ManualRig, what: str, *, yes: bool) -> None:
    """Have the holder hold what is needed, with the lamp dark: by the rig itself, or by the person, who confirms it."""
    manual.lamp(False)
    turned = manual.description.reference.how == "axis"  # the rig itself turns the white reference into the beam
    if turned:
        manual.present("reference" if what in ("reference", "edge") else "sample")
    opened.put(manual, what, PROMPTS[what], yes=yes, itself=turned and what == "reference")


def _show(found: CameraCalibration, was: Camera) -> None:
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
        elif isinstance(value, bool):
            table.add_row(key, str(value).lower(), "", str(before).lower())
        else:
            table.add_row(key, *apart(value, u.get(key)), apart(before, None)[0])
    rows = console.table("EMVA 1288", "value")
    for key, value in found.measured.items():
        rows.add_row(key, ", ".join(f"{one:.5g}" for one in (value if isinstance(value, list) else [value])))
    console.show(table, rows, *(f"note: {note}" for note in found.notes))
