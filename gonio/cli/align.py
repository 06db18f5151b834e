"""`gonio rig align`: the zeros of the axes, from scans over a mirror and straight through an empty holder."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from gonio.acquisition.measure import find_rig
from gonio.by_hand import alignment, rig_file
from gonio.by_hand.alignment import Alignment
from gonio.by_hand.alignment_scans import Scans
from gonio.by_hand.manual_rig import ManualRig
from gonio.cli import console
from gonio.cli.opened import free_name, manual_rig_of, put, require_new, require_rig_file, told_where
from gonio.disk import put_picture
from gonio.errors import ConfigError, DataError
from gonio.rig.description import RigDescription
from gonio.shown import apart, number

PROMPTS = {
    "mirror": "Put a front-surface mirror into the holder, as the sample lies",
    "empty": "Take the mirror out: the holder is empty, and nothing stands between the arms",
    "sample": "Put the sample back into the holder",
}


def align(
    rig: str, out: Path, only: str, again: Sequence[Path], *, search_deg: float, seed: int, yes: bool
) -> None:  # fmt: skip
    """Scan, or take the scans of earlier alignments, and write the zeros that they lead to into a copy of a rig file.

    Parameters
    ----------
    rig, out
        The rig file, and the copy.
    only
        Which scans: "both", "mirror" or "straight".
    again
        Files of scans: these are fitted, and nothing moves.
    search_deg
        How far to look for the lamp.
    seed
        Of a simulated rig.
    yes
        Nobody is asked for what has to lie in the holder.

    Raises
    ------
    ConfigError
        A file is not there, or is where it must not be; the arms cannot make the scans.
    DataError
        The scans determine no zero.
    """
    require_rig_file(rig)
    require_new(out)
    picture = free_name(out, "residuals", ".png")
    if again:
        description, table = find_rig(rig).description, _joined([alignment.read(path) for path in again])
    else:
        manual = manual_rig_of(rig, "arms", "light", "camera", seed=seed)
        scans = Scans(manual, search_deg=search_deg, say=console.note)
        _take(rig, manual, scans, only, free_name(out, "scans", ".csv"), yes=yes)
        description, table = manual.description, scans.table
    found = alignment.align(table, description)
    put_picture(picture, alignment.draw(table, found))
    _show(found, description)
    values = alignment.zero_values(found, description)
    if not values:
        raise DataError(f"{out} is not written: these scans determine no zero alone")
    rig_file.write_values(rig, values, out=out)
    console.show(f"{out}: {', '.join(found.zeros)}", str(picture))


def _take(rig: str, manual: ManualRig, scans: Scans, only: str, file: Path, *, yes: bool) -> None:
    """The scans, which are kept whatever ends them."""
    straight = only != "mirror"
    if straight and not scans.facing():
        if only == "straight":
            raise ConfigError(f"{rig}: {scans.why_not_facing()}")
        console.note(f"{rig}: {scans.why_not_facing()}. The mirror scan is made alone")
        straight = False
    try:
        with told_where(manual), manual:
            if only != "straight":
                put(manual, "mirror", PROMPTS["mirror"], yes=yes)
                scans.mirror()
            if straight:
                manual.lamp(False)  # hands are in the beam now
                put(manual, "empty", PROMPTS["empty"], yes=yes)
                scans.straight_through()
            manual.lamp(False)
            put(manual, "sample", PROMPTS["sample"], yes=True)  # nobody has to press a key for it
    finally:
        if len(scans.table):
            alignment.write(scans.table, file)
            console.note(f"{file}: {scans.table['scan'].nunique()} scans")
    console.note("lamp dark, arms parked; put the sample back")


def _joined(tables: list[pd.DataFrame]) -> pd.DataFrame:
    """Scans of several files, numbered on."""
    first = 0
    for table in tables:
        table["scan"] += first
        first = int(table["scan"].max())
    return pd.concat(tables, ignore_index=True)


def _show(found: Alignment, description: RigDescription) -> None:
    table = console.table(
        "axis", "zero_offset_deg", "was", "u (k = 1)", "of it: scans", "encoder", "backlash", "departures"
    )
    for name, zero in found.zeros.items():
        known = description.axes()[name]
        was = f"{known.zero_offset_deg:.3f}" if known.zero_offset_known else "not known"
        now, u = apart(zero.offset_deg, zero.u_deg)
        table.add_row(name, now, was, u, *(number(part, 2) for part in zero.parts.values()))
    rows = console.table("scan", "holder", "axis", "light [deg]", "centre [deg]", "u [deg]", "residual [deg]")
    for r in found.scans.itertuples():
        numbers = (f"{r.at_deg:.2f}", f"{r.centre_deg:.3f}", f"{r.u_deg:.3f}", f"{r.residual_deg:+.3f}")
        rows.add_row(str(r.scan), str(r.holder), str(r.axis), *numbers)
    console.show(table, rows, f"rank {found.rank} of {len(found.axes)} ({', '.join(found.axes)})")
    if "light" in found.zeros:
        i, j = found.axes.index("light"), found.axes.index("camera")
        c = found.covariance
        console.show(f"correlation of light and camera: {c[i, j] / (c[i, i] * c[j, j]) ** 0.5:+.2f}")
    console.show(*(f"not determined: {sentence}" for sentence in found.open))
