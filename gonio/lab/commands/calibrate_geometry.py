"""`gonio calibrate geometry`: lens, zeros, encoders, axes and holder of a rig, with their covariance."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gonio import lost
from gonio.cli import console
from gonio.config import numbers_in
from gonio.disk import put_picture
from gonio.errors import ConfigError, DataError, os_error_as
from gonio.lab.acquisition.measure import RigChoice, find_rig
from gonio.lab.by_hand.alignment import HOLDERS
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.calibration import camera_scan, fiducials, intrinsics
from gonio.lab.calibration import geometry as geometric
from gonio.lab.calibration import geometry_scans as poses
from gonio.lab.calibration.board import read_board
from gonio.lab.calibration.expected_budget import what_stays_open
from gonio.lab.calibration.geometry_problem import Sighting, start_of
from gonio.lab.calibration.geometry_scans import GeometryScans, Kept, read_sightings, reversed_approach
from gonio.lab.calibration.intrinsics import Intrinsics
from gonio.lab.commands import opened
from gonio.lab.commands.align import PROMPTS
from gonio.lab.rig import Device, Step
from gonio.lab.rig.calibration_files import Calibration, with_keys, write_calibration
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import ParameterUncertainty
from gonio.shown import apart
from gonio.typing import Floats, TomlTable

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".dng")
QUICK = 0.25
"""Share of the poses."""
DEVICES: tuple[Device, ...] = ("arms", "light", "camera")
Given = tuple[list[str], Floats, Floats]
"""Paths, values and covariance of numbers that pictures of a board have told."""


@dataclass(frozen=True, slots=True)
class GeometryOptions:
    """How the rig is driven: the options of the command."""

    holder: str | None
    search_deg: float
    share: float
    """Share of the poses."""
    seed: int
    yes: bool

    @property
    def holders(self) -> list[str]:
        """What is put into the holder; raises `ConfigError` where it is none of `HOLDERS`."""
        names = [name.strip() for name in self.holder.split(",")] if self.holder is not None else []
        wrong = [name for name in names if name not in HOLDERS]
        if wrong:
            raise ConfigError(f'--holder "{self.holder}": "{wrong[0]}" is none of {", ".join(HOLDERS)}')
        return names


def print_sheet(rig: str, file: Path) -> None:
    """Write the sheet of a holder's markers; raises `ConfigError` where the rig file has none, or the file is there."""
    description = find_rig(rig, without="geometry").description
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


def calibrate(
    rig: str, out: Path | None, images: Path | None, board: Path | None, scans: Path | None, asked: GeometryOptions,
    valid_days: int,
) -> None:  # fmt: skip
    """Fit lens and geometry to pictures of a board, and to sightings that are kept or made now.

    Raises
    ------
    ConfigError
        Options are missing, wrong, or do not go together.
    DataError
        Pictures or sightings determine nothing, or do not go with the rig.
    """
    choice = find_rig(rig, without="geometry")
    if out is None:
        raise ConfigError("--out CALIBRATION.toml is missing")
    opened.require_new(out)
    if (images is None) != (board is None):
        raise ConfigError("--images and --board go together: pictures, and the file of the board that they show")
    holders, filed = asked.holders, choice.description
    lens = _lens(filed, images, board) if images is not None and board is not None else None
    sightings: Sequence[Sighting] = ()
    contradiction = ""
    if scans is not None:
        if asked.holder is not None:
            raise ConfigError("--scans fits what was kept: --holder has nothing to do there")
        sightings = read_sightings(scans)
        _require_axes(sightings, filed, scans)
    elif holders or lens is None:
        sightings, contradiction = _measured(choice, out, holders or None, asked)
    with lost.whole(out):
        _finish(out, filed, lens, sightings, valid_days, [f"WARNING: {contradiction}"] if contradiction else [])


def _require_axes(sightings: Sequence[Sighting], description: RigDescription, scans: Path) -> None:
    axes, marks = description.axes(), description.holder.fiducials
    for s in sightings:
        if set(s.encoder_deg) != set(axes):
            raise DataError(
                f"{scans}: was made with the axes {', '.join(s.encoder_deg)}, and the rig has {', '.join(axes)}"
            )
        if s.corners and marks is None:
            raise DataError(f"{scans}: shows markers, and the rig file has no [holder.fiducials]")
        if s.corners and marks is not None and max(s.corners) >= 4 * marks.count:
            raise DataError(f"{scans}: shows more markers than holder.fiducials.count = {marks.count}")


# ---- the lens ----


def _lens(description: RigDescription, images: Path, board: Path) -> Intrinsics:
    if not images.is_dir():
        raise ConfigError(f"{images}: is no folder of pictures")
    files = sorted(f for f in images.iterdir() if f.suffix.lower() in PICTURES)
    if not files:
        raise DataError(f"{images}: holds no picture ({', '.join(PICTURES)})")
    about, dictionary = read_board(board)
    return intrinsics.calibrate(files, about, dictionary, (description.camera.width, description.camera.height))


def _with_lens(description: RigDescription, found: Intrinsics) -> tuple[RigDescription, Given]:
    """A rig with the lens of the pictures, and what is known of it."""
    camera, (f, c_x, c_y, *bent) = description.camera, (found.values[name] for name in intrinsics.NAMES)
    image_mm = 1e-3 * camera.pixel_um * f
    focal_mm = 1.0 / (1.0 / image_mm + 1.0 / description.geometry.camera_distance_mm)
    beside = [c_x - 0.5 * (camera.width - 1), c_y - 0.5 * (camera.height - 1)]
    keys = {"focal_length_mm": focal_mm, "principal_point_px": beside, "distortion": [*bent, 0.0]}
    paths = [
        "camera.focal_length_mm", *(f"camera.principal_point_px[{k}]" for k in (0, 1)),
        *(f"camera.distortion[{k}]" for k in range(4)),
    ]  # fmt: skip
    scale = np.array([1e-3 * camera.pixel_um * (focal_mm / image_mm) ** 2, *np.ones(6)])
    known = paths, np.array([focal_mm, *beside, *bent]), found.covariance * np.outer(scale, scale)
    return with_keys(description, {"camera": keys}, "the pictures' lens"), known


# ---- frames ----


def _measured(
    choice: RigChoice, out: Path, holders: list[str] | None, asked: GeometryOptions
) -> tuple[Sequence[Sighting], str]:  # fmt: skip
    """Drive the rig, and keep what was seen beside OUT; with what speaks against the rig file's camera."""
    folder = out.with_name(f"{out.stem}-sightings")
    if folder.exists():
        raise ConfigError(f"{folder}: is there already; fit it with --scans {folder}, or name another --out")

    def by_hand(choice: RigChoice) -> tuple[ManualRig, GeometryScans]:
        manual = ManualRig(choice.open(seed=asked.seed, confirm=False, by_hand=True), choice.source, DEVICES)
        return manual, GeometryScans(
            manual,
            search_deg=asked.search_deg,
            say=console.note,
            keep=lambda sighting, frames: kept.keep(sighting, frames),
        )

    def number(poses: int) -> int:
        return round(asked.share * poses)

    manual, scans = by_hand(choice)
    wanted = holders or list(HOLDERS)
    if "empty" in wanted and not scans.facing():
        if wanted == ["empty"]:
            raise ConfigError(f"{choice.source}: {scans.why_not_facing()}")
        console.note(f"{choice.source}: {scans.why_not_facing()}. There are no straight-through frames")
        wanted.remove("empty")
    kept, contradiction = Kept(folder), ""
    with opened.told_where(manual), manual:
        if "mirror" in wanted:
            opened.put(manual, "mirror", PROMPTS["mirror"], yes=asked.yes)
            if contradiction := camera_scan.contradictions(manual):
                console.note(f"WARNING: {contradiction}")
            scans.mirror_frames(number(poses.MIRROR_POSES))
            if manual.description.holder.fiducials is not None:
                scans.marker_frames(number(poses.MARKER_POSES))
        sums, across = scans.where
        if "empty" in wanted:
            manual.lamp(False)  # hands are in the beam now
            opened.put(manual, "empty", PROMPTS["empty"], yes=asked.yes)
            scans.straight_frames(number(poses.STRAIGHT_POSES))
        manual.lamp(False)
    if "mirror" in wanted and any(a.backlash_deg for a in choice.description.axes().values()):
        again, backwards = by_hand(replace(choice, description=reversed_approach(choice.description)))
        with opened.told_where(again), again:
            again.begin(Step(1, "dark"))
            opened.put(again, "mirror", PROMPTS["mirror"], yes=asked.yes)
            backwards.against_frames(sums, across, number(poses.AGAINST_POSES))
            again.lamp(False)
    console.note(f"{folder}: {len(kept.sightings)} sightings; lamp dark, arms parked; put the sample back")
    return kept.sightings, contradiction


# ---- what comes out ----


def _finish(
    out: Path, filed: RigDescription, lens: Intrinsics | None, sightings: Sequence[Sighting], valid_days: int,
    notes: list[str],
) -> None:  # fmt: skip
    """Fit, and write and show what came out."""
    description, given = _with_lens(filed, lens) if lens is not None else (filed, None)
    fit = geometric.solve(description, sightings, given) if sightings else None
    measured: TomlTable = {}
    if fit is not None:
        tables, paths, covariance = geometric.values_of(fit, description)
        notes += [
            *(f"WARNING: {said}" for said in fit.warnings),
            *fit.open,
            *what_stays_open(filed, [u for u, known in zip(fit.unknowns, fit.known, strict=True) if not known]),
            *(f"left out, too far from all else: {what}" for what in fit.dropped),
        ]
        measured = {"sightings": len(sightings), "misfit": fit.misfit, "rank": fit.rank, "of": len(fit.unknowns)}
        if given is None:
            notes.append("focal length and distortion were taken as in the rig file: no pictures of a board")
    elif given is not None:
        paths, _, covariance = given
        camera = description.camera.model_dump(mode="json")
        tables = {"camera": {name: camera[name] for name in ("focal_length_mm", "principal_point_px", "distortion")}}
    if lens is not None:
        measured |= {
            "rms_reprojection_px": lens.rms_px, "corners": lens.corners, "rejected": lens.rejected,
            "images": list(lens.images), "rms_by_image_px": list(lens.rms_by_image_px),
        }  # fmt: skip
        notes.append(f"{lens.rejected} of {lens.corners + lens.rejected} corners were left out")
    remarks = [sentence if sentence.startswith("WARNING") else f"note: {sentence}" for sentence in notes]
    if not paths:
        console.show(*remarks)
        raise DataError(f"{out} is not written: nothing of the rig is determined")
    known = ParameterUncertainty.of(paths, covariance)
    calibration = Calibration.made_today(
        "geometry", filed, valid_days, values=tables, uncertainty=known, measured=measured, notes=notes
    )
    pictures: list[Path] = []
    if fit is not None:
        pictures = put_picture(out.with_name(f"{out.stem}-residuals.png"), lambda: geometric.draw(fit))
    elif lens is not None:
        pictures = put_picture(out.with_name(f"{out.stem}-residuals.png"), lambda: intrinsics.draw(lens))
    with os_error_as(DataError, f"{out}: cannot be written"):
        write_calibration(calibration, out)
    _show_numbers(filed, tables, dict(zip(paths, known.u, strict=True)))
    if lens is not None:
        console.show(f"lens: rms reprojection error {lens.rms_px:.3f} px, {lens.corners} corners of "
                     f"{len(lens.images)} pictures, {lens.rejected} left out")  # fmt: skip
    if fit is not None:
        console.show(
            f"{len(sightings)} sightings determine {fit.rank} of {len(fit.unknowns)} directions; "
            f"misfit {fit.misfit:.2f}"
        )
    console.show(*remarks, f"{out}: {len(paths)} numbers, valid until {calibration.valid_until}", *map(str, pictures))


def _show_numbers(filed: RigDescription, tables: TomlTable, u: dict[str, float]) -> None:
    was, now, claimed = numbers_in(start_of(filed)), numbers_in(tables), geometric.claims(filed)
    table = console.table("key", "value", "u (k = 1)", "was", "with u")
    for path, one in u.items():
        before = f"{was[path]:.5g}" if path in was else "-"
        table.add_row(path, *apart(now[path], one), before, f"{claimed[path]:.2g}" if path in claimed else "")
    console.show(table)
