"""`gonio calibrate geometry`: lens, zeros, encoders, axes and holder of a rig, with their covariance."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gonio.cli.calibrate import app
from gonio.documents import TomlTable
from gonio.shown import apart

if TYPE_CHECKING:
    from gonio.acquisition.measure import RigChoice
    from gonio.calibration.geometry import Fit, Sighting
    from gonio.calibration.intrinsics import Intrinsics
    from gonio.rig.calibrated import Calibration
    from gonio.rig.description import RigDescription
    from gonio.typing import Floats

__all__ = ["app"]

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".dng")
HOLDERS = ("mirror", "empty")
QUICK = 0.25
Given = tuple[list[str], "Floats", "Floats"]


def _required(out: Path | None) -> Path:
    """The file to write, which must not be there."""
    from gonio.errors import ConfigError

    if out is None:
        raise ConfigError("--out CALIBRATION.toml is missing")
    if out.exists():
        raise ConfigError(f"{out}: is there already; name another file with --out")
    if out.suffix != ".toml" or not out.absolute().parent.is_dir():
        raise ConfigError(f"--out {out}: must end with .toml, and lie in a folder that is there")
    return out


@app.command()
def geometry(
    rig: Annotated[str, typer.Option(help="A rig's name, or a rig file.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="The calibration file.", show_default=False)] = None,
    images: Annotated[
        Path | None, typer.Option(help="A folder of pictures of a ChArUco board.", show_default=False)
    ] = None,
    board: Annotated[
        Path | None, typer.Option(help="The board: a .toml, or OpenCV's .yml.", show_default=False)
    ] = None,
    holder: Annotated[
        str | None,
        typer.Option(help="What is put into the holder, by commas: mirror, empty. Without it both, where the arms can "
                          "face each other; with --images, none.", show_default=False),
    ] = None,
    scans: Annotated[
        Path | None, typer.Option(help="Kept sightings: fit these again; moves nothing.", show_default=False)
    ] = None,
    print_fiducials: Annotated[
        Path | None,
        typer.Option(help="Write the sheet of the holder's markers (.svg, .png), and nothing else.",
                     show_default=False),
    ] = None,
    valid_days: Annotated[int, typer.Option(min=1, help="How long the calibration may be used.")] = 365,
    search: Annotated[float, typer.Option(min=1, max=30, help="How far to look for the lamp [deg].")] = 8.0,
    quick: Annotated[bool, typer.Option("--quick", help="A quarter of the poses: known half as well.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of a simulated rig.")] = 0,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nobody: what has to lie in the holder does.")] = False,
) -> None:  # fmt: skip
    """Calibrate a rig's geometry: the lens from pictures of a board; zeros, encoders, axes, holder from frames.

    Beside OUT: OUT-sightings/, all that was seen, to fit again with --scans; and OUT-residuals.png.
    """
    from gonio.acquisition.measure import find_rig
    from gonio.errors import ConfigError

    choice = find_rig(rig, without="geometry")
    if print_fiducials is not None:
        _print_sheet(choice.description, rig, print_fiducials)
        return
    out = _required(out)
    if (images is None) != (board is None):
        raise ConfigError("--images and --board go together: pictures, and the file of the board that they show")
    holders = _holders(holder)
    intrinsics = _intrinsics(choice.description, images, board) if images and board else None
    lens: tuple[RigDescription, Given | None] = choice.description, None
    if intrinsics is not None:
        lens = _with_lens(choice.description, intrinsics)
    sightings: Sequence[Sighting] = ()
    contradiction = ""
    if scans is not None:
        from gonio.calibration.geometry_scans import read_sightings

        if holder is not None:
            raise ConfigError("--scans fits what was kept: --holder has nothing to do there")
        sightings = read_sightings(scans)
        _require_axes(sightings, choice.description, scans)
    elif holders or intrinsics is None:
        asked, share = (choice, out, holders or None), QUICK if quick else 1.0
        sightings, contradiction = _measured(*asked, search=search, share=share, seed=seed, yes=yes)
    _finish(out, choice.description, *lens, intrinsics, sightings, valid_days, contradiction)


def _holders(text: str | None) -> list[str]:
    from gonio.errors import ConfigError

    names = [name.strip() for name in text.split(",")] if text is not None else []
    wrong = [name for name in names if name not in HOLDERS]
    if wrong:
        raise ConfigError(f'--holder "{text}": "{wrong[0]}" is none of {", ".join(HOLDERS)}')
    return names


def _print_sheet(description: RigDescription, rig: str, file: Path) -> None:
    from gonio.calibration import fiducials
    from gonio.cli import console
    from gonio.errors import ConfigError

    marks = description.holder.fiducials
    if marks is None:
        raise ConfigError(
            f"{rig}: the rig file has no [holder.fiducials]; add it with dictionary, count, marker_mm and ring_mm "
            "(an empty table takes 8 markers of 6 mm on a circle of 18 mm radius)"
        )
    if file.exists():
        raise ConfigError(f"{file}: is there already; name another file")
    fiducials.print_sheet(marks, description.holder.sample_diameter_mm, file)
    console.show(f"{file}: {marks.count} markers of {marks.dictionary}; print at 100 %, and measure the 20 mm")


def _require_axes(sightings: Sequence[Sighting], description: RigDescription, scans: Path) -> None:
    from gonio.errors import DataError

    axes = set(description.axes())
    for s in sightings:
        if set(s.encoder_deg) != axes:
            raise DataError(
                f"{scans}: was made with the axes {', '.join(s.encoder_deg)}, and the rig has {', '.join(axes)}"
            )
        if s.corners and (marks := description.holder.fiducials) is None:
            raise DataError(f"{scans}: shows markers, and the rig file has no [holder.fiducials]")
        if s.corners and marks is not None and max(s.corners) >= 4 * marks.count:
            raise DataError(f"{scans}: shows more markers than holder.fiducials.count = {marks.count}")


# ---- the lens ----


def _intrinsics(description: RigDescription, images: Path, board: Path) -> Intrinsics:
    from gonio.calibration import intrinsics
    from gonio.errors import DataError

    if not images.is_dir():
        raise DataError(f"{images}: is no folder of pictures")
    files = sorted(f for f in images.iterdir() if f.suffix.lower() in PICTURES)
    if not files:
        raise DataError(f"{images}: holds no picture ({', '.join(PICTURES)})")
    about, dictionary = intrinsics.read_board(board)
    return intrinsics.calibrate(files, about, dictionary, (description.camera.width, description.camera.height))


def _with_lens(description: RigDescription, found: Intrinsics) -> tuple[RigDescription, Given]:
    """A rig with the lens of the pictures; and the paths, values and covariance of what is known of it."""
    import numpy as np

    from gonio.rig.calibrated import with_keys

    camera, v = description.camera, found.values
    image_mm = 1e-3 * camera.pixel_um * v["f"]
    focal_mm = 1.0 / (1.0 / image_mm + 1.0 / description.geometry.camera_distance_mm)
    beside = v["c_x"] - 0.5 * (camera.width - 1), v["c_y"] - 0.5 * (camera.height - 1)
    keys = {
        "focal_length_mm": focal_mm, "principal_point_px": list(beside),
        "distortion": [v["k1"], v["k2"], v["p1"], v["p2"], 0.0],
    }  # fmt: skip
    paths = ["camera.focal_length_mm", *(f"camera.principal_point_px[{k}]" for k in (0, 1))]
    paths += [f"camera.distortion[{k}]" for k in range(4)]
    scale = np.ones(7)
    scale[0] = 1e-3 * camera.pixel_um * (focal_mm / image_mm) ** 2
    values = np.array([focal_mm, *beside, v["k1"], v["k2"], v["p1"], v["p2"]])
    return (
        with_keys(description, {"camera": keys}, "the pictures' lens"),
        (paths, values, found.covariance * np.outer(scale, scale)),
    )


# ---- frames ----


def _measured(
    choice: RigChoice, out: Path, holders: list[str] | None, *, search: float, share: float, seed: int, yes: bool
) -> tuple[Sequence[Sighting], str]:
    """Drive the rig, and keep what was seen beside OUT; with what speaks against the rig file's camera.

    `share`: of the poses.
    """

    from gonio.by_hand.manual_rig import ManualRig
    from gonio.calibration import camera_check
    from gonio.calibration import geometry_scans as poses
    from gonio.calibration.geometry_scans import GeometryScans, Kept, reversed_approach
    from gonio.cli import console
    from gonio.cli.align import _dark, _put
    from gonio.cli.by_hand import _told_where
    from gonio.errors import ConfigError
    from gonio.rig import Device, Step

    folder = out.with_name(f"{out.stem}-sightings")
    if folder.exists():
        raise ConfigError(f"{folder}: is there already; fit it with --scans {folder}, or name another --out")
    devices: tuple[Device, ...] = ("arms", "light", "camera")
    rig = choice.open(seed=seed, confirm=False, by_hand=True)
    manual = ManualRig(rig, choice.source, devices)
    scans = GeometryScans(manual, search_deg=search, say=console.note, keep=lambda s, f: kept.keep(s, f))
    wanted = holders or list(HOLDERS)
    if "empty" in wanted and not scans.facing():
        if holders is not None and wanted == ["empty"]:
            raise ConfigError(f"{choice.source}: {scans.why_not_facing()}")
        console.note(f"{choice.source}: {scans.why_not_facing()}. There are no straight-through frames")
        wanted.remove("empty")
    kept, contradiction = Kept(folder), ""
    with _told_where(manual), manual:
        if "mirror" in wanted:
            _put(manual, "mirror", yes=yes)
            if contradiction := camera_check.contradictions(manual):
                console.note(f"WARNING: {contradiction}")
            scans.mirror_frames(round(share * poses.MIRROR_POSES))
            if manual.description.holder.fiducials is not None:
                scans.marker_frames(round(share * poses.MARKER_POSES))
        sums, across = scans.where
        if "empty" in wanted:
            _dark(manual)
            _put(manual, "empty", yes=yes)
            scans.straight_frames(round(share * poses.STRAIGHT_POSES))
        _dark(manual)
    if "mirror" in wanted and any(a.backlash_deg for a in choice.description.axes().values()):
        straight = replace(choice, description=reversed_approach(choice.description))
        again = ManualRig(straight.open(seed=seed, confirm=False, by_hand=True), choice.source, devices)
        with _told_where(again), again:
            again.begin(Step(1, "dark"))
            _put(again, "mirror", yes=yes)
            backwards = GeometryScans(again, search_deg=search, say=console.note, keep=kept.keep)
            backwards.against_frames(sums, across, round(share * poses.AGAINST_POSES))
            _dark(again)
    console.note(f"{folder}: {len(kept.sightings)} sightings; lamp dark, arms parked; put the sample back")
    return kept.sightings, contradiction


# ---- what comes out ----


def _show_numbers(filed: RigDescription, tables: TomlTable, u: dict[str, float]) -> None:
    from gonio.calibration import geometry as geometric
    from gonio.cli import console
    from gonio.config import numbers_in

    was, now, claimed = numbers_in(geometric.start_of(filed)), numbers_in(tables), geometric.claims(filed)
    table = console.table("key", "value", "u (k = 1)", "was", "with u")
    for path, one in u.items():
        before = f"{was[path]:.5g}" if path in was else "-"
        table.add_row(path, *apart(now[path], one), before, f"{claimed[path]:.2g}" if path in claimed else "")
    console.show(table)


def _calibration(
    filed: RigDescription, tables: TomlTable, paths: list[str], covariance: Floats, notes: Sequence[str],
    measured: TomlTable, valid_days: int,
) -> Calibration:  # fmt: skip
    """What is known now of a rig's numbers, with its covariance."""
    import numpy as np

    from gonio.rig.calibrated import Calibration, identity
    from gonio.rig.calibration_use import ParameterUncertainty

    u = np.sqrt(np.diag(covariance))
    correlation = np.clip(covariance / np.outer(u, u), -1.0, 1.0)
    correlation = 0.5 * (correlation + correlation.T)
    np.fill_diagonal(correlation, 1.0)
    today = datetime.date.today()
    return Calibration(
        kind="geometry", rig=filed.name, rig_identity=identity(filed), made=today,
        valid_until=today + datetime.timedelta(days=valid_days), notes=tuple(notes), values=tables,
        uncertainty=ParameterUncertainty(parameters=paths, u=u.tolist(), correlation=correlation.tolist()),
        measured=measured,
    )  # fmt: skip


def _finish(
    out: Path, filed: RigDescription, description: RigDescription, given: Given | None,
    intrinsics: Intrinsics | None, sightings: Sequence[Sighting], valid_days: int, contradiction: str,
) -> None:  # fmt: skip
    import numpy as np

    from gonio.calibration import geometry as geometric
    from gonio.cli import console
    from gonio.errors import DataError
    from gonio.rig.calibrated import write_calibration

    fit: Fit | None = None
    notes = [f"WARNING: {contradiction}"] * bool(contradiction)
    measured: TomlTable = {}
    if sightings:
        fit = geometric.solve(description, sightings, given)
        tables, paths, covariance = geometric.values_of(fit)
        tables = geometric.filled(tables, description)
        notes += [
            *(f"WARNING: {said}" for said in fit.warnings),
            *fit.open,
            *(f"left out, too far from all else: {what}" for what in fit.dropped),
        ]
        measured = {"sightings": len(sightings), "misfit": fit.misfit, "rank": fit.rank, "of": len(fit.unknowns)}
        if given is None:
            notes.append("focal length and distortion were taken as in the rig file: no pictures of a board")
    elif given is not None:
        paths, _, covariance = given
        tables = {"camera": {name: description.camera.model_dump(mode="json")[name]
                             for name in ("focal_length_mm", "principal_point_px", "distortion")}}  # fmt: skip
    if intrinsics is not None:
        tables.setdefault("camera", {}).setdefault("distortion", list(description.camera.distortion))
        tables["camera"]["distortion"] = [0.0 if v is None else v for v in tables["camera"]["distortion"]]
        measured |= {
            "rms_reprojection_px": intrinsics.rms_px, "corners": intrinsics.corners, "rejected": intrinsics.rejected,
            "images": list(intrinsics.images), "rms_by_image_px": list(intrinsics.rms_by_image_px),
        }  # fmt: skip
        notes.append(f"{intrinsics.rejected} of {intrinsics.corners + intrinsics.rejected} corners were left out")
    if not paths:
        _show_open(notes)
        raise DataError(f"{out} is not written: nothing of the rig is determined")
    calibration = _calibration(filed, tables, paths, covariance, notes, measured, valid_days)
    picture = out.with_name(f"{out.stem}-residuals.png")
    _draw(fit, intrinsics, picture)
    try:
        write_calibration(calibration, out)
    except OSError as error:
        raise DataError(f"{out}: cannot be written: {error.strerror}") from None
    _show_numbers(filed, tables, dict(zip(paths, np.sqrt(np.diag(covariance)).tolist(), strict=True)))
    if intrinsics is not None:
        console.show(f"lens: rms reprojection error {intrinsics.rms_px:.3f} px, {intrinsics.corners} corners of "
                     f"{len(intrinsics.images)} pictures, {intrinsics.rejected} left out")  # fmt: skip
    if fit is not None:
        console.show(
            f"{len(sightings)} sightings determine {fit.rank} of {len(fit.unknowns)} directions; "
            f"misfit {fit.misfit:.2f}"
        )
    _show_open(notes)
    console.show(f"{out}: {len(paths)} numbers, valid until {calibration.valid_until}", str(picture))


def _show_open(notes: Sequence[str]) -> None:
    from gonio.cli import console

    for sentence in notes:
        console.show(sentence if sentence.startswith("WARNING") else f"note: {sentence}")


def _draw(fit: Fit | None, intrinsics: Intrinsics | None, picture: Path) -> None:

    from gonio.calibration import geometry as geometric
    from gonio.calibration import intrinsics as lens
    from gonio.disk import write_whole
    from gonio.errors import DataError

    if fit is not None:
        figure = geometric.draw(fit)
    else:
        assert intrinsics is not None
        figure = lens.draw(intrinsics)
    drawn = BytesIO()
    figure.savefig(drawn, format="png", dpi=110)
    try:
        write_whole(picture, drawn.getvalue())
    except OSError as error:
        raise DataError(f"{picture}: cannot be written: {error.strerror}") from None
