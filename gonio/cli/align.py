"""`gonio rig align`: the zeros of the axes, from scans over a mirror and straight through an empty holder."""

from __future__ import annotations

import sys
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gonio.cli.by_hand import RigOption, SampleOption, WavelengthOption, _told_where, manual_rig_of
from gonio.cli.rigs import app
from gonio.shown import apart, number

if TYPE_CHECKING:
    import pandas as pd

    from gonio.by_hand.alignment import Alignment
    from gonio.by_hand.manual_rig import ManualRig
    from gonio.rig.description import RigDescription

__all__ = ["app"]

PROMPTS = {
    "mirror": "Put a front-surface mirror into the holder, as the sample lies",
    "empty": "Take the mirror out: the holder is empty, and nothing stands between the arms",
    "sample": "Put the sample back into the holder",
}


@app.command()
def align(
    rig: RigOption,
    out: Annotated[Path, typer.Option(help="The copy of the rig file, with the zeros in it.")] = Path("aligned.toml"),
    only: Annotated[
        Literal["both", "mirror", "straight"], typer.Option(help="Which scans; each alone leaves something open.")
    ] = "both",
    search: Annotated[float, typer.Option(min=1, max=30, help="How far to look for the lamp [deg].")] = 5.0,
    again: Annotated[
        list[Path] | None,
        typer.Option("--from", help="Scans of an earlier alignment: fit these; moves nothing.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of a simulated rig.")] = 0,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nobody: what has to lie in the holder does.")] = False,
    live: Annotated[
        bool, typer.Option("--live", help="No scans: a live picture on a page, and a prompt to jog and set zeros.")
    ] = False,
    keep: Annotated[float, typer.Option(min=1, max=3600, help="--live: dark so long after a key [s].")] = 60.0,
    port: Annotated[int, typer.Option(min=0, max=65535, help="--live: of the page; 0 takes any that is free.")] = 0,
    host: Annotated[str, typer.Option(help="--live: serve the page there; by default, here alone.")] = "127.0.0.1",
    wavelength: WavelengthOption = None,
    sample: SampleOption = None,
) -> None:  # fmt: skip
    """Find the zeros of light, camera, tilt and azimuth, and write them into a copy of the rig file.

    Beside OUT: OUT-scans.csv, to fit again, and OUT-residuals.png. The lamp is dark and the arms parked afterwards.
    With --live a person aligns: the first line is the address of a page with the camera's picture.
    """
    if live:
        from gonio.cli.align_live import live as session
        from gonio.errors import ConfigError

        if again:
            raise ConfigError("--from belongs to scans, and --live makes none: leave one of them away")
        return session(rig, out, sample=sample, seed=seed, host=host, port=port, keep_s=keep, wavelength=wavelength)
    from gonio.by_hand import alignment, rig_file
    from gonio.by_hand.alignment_scans import Scans
    from gonio.cli import console
    from gonio.errors import ConfigError, DataError

    if not Path(rig).is_file():
        raise ConfigError(f'"{rig}" is no rig file: gonio rig show {rig} > my.toml, then --rig my.toml')
    if out.exists():
        raise ConfigError(f"{out}: is there already; name another file with --out")
    scans_file, picture = _free(out, "scans", ".csv"), _free(out, "residuals", ".png")
    if out.suffix != ".toml" or not out.absolute().parent.is_dir():
        raise ConfigError(f"--out {out}: must end with .toml, and lie in a folder that is there")
    if again:
        from gonio.acquisition.measure import find_rig

        description = find_rig(rig).description
        table = _joined([alignment.read(path) for path in again])
    else:
        manual = manual_rig_of(rig, "arms", "light", "camera", seed=seed)
        description = manual.description
        scans = Scans(manual, search_deg=search, say=console.note)
        straight = only != "mirror"
        if straight and not scans.facing():
            if only == "straight":
                raise ConfigError(f"{rig}: {scans.why_not_facing()}")
            console.note(f"{rig}: {scans.why_not_facing()}. The mirror scan is made alone")
            straight = False
        try:
            with _told_where(manual), manual:
                if only != "straight":
                    _put(manual, "mirror", yes=yes)
                    scans.mirror()
                if straight:
                    _dark(manual)
                    _put(manual, "empty", yes=yes)
                    scans.straight_through()
                _dark(manual)
                _put(manual, "sample", yes=True)  # nobody has to press a key for it
        finally:
            if len(scans.table):
                alignment.write(scans.table, scans_file)
                console.note(f"{scans_file}: {scans.table['scan'].nunique()} scans")
        console.note("lamp dark, arms parked; put the sample back")
        table = scans.table
    found = alignment.align(table, description)
    _write_picture(table, found, picture)
    _show(found, description)
    values = alignment.zero_values(found, description)
    if not values:
        raise DataError(f"{out} is not written: these scans determine no zero alone")
    rig_file.write_values(rig, values, out=out)
    console.show(f"{out}: {', '.join(found.zeros)}", str(picture))


def _free(out: Path, what: str, suffix: str) -> Path:
    """A name beside OUT that is not taken: an alignment that was cut short has left its scans."""
    name, number = out.with_name(f"{out.stem}-{what}{suffix}"), 1
    while name.exists():
        number += 1
        name = out.with_name(f"{out.stem}-{what}-{number}{suffix}")
    return name


def _joined(tables: list[pd.DataFrame]) -> pd.DataFrame:
    """Scans of several files, numbered on."""
    import pandas as pd

    first = 0
    for table in tables:
        table["scan"] += first
        first = int(table["scan"].max())
    return pd.concat(tables, ignore_index=True)


def _dark(manual: ManualRig) -> None:
    """Hands are in the beam now."""
    manual.lamp(False)


def _put(manual: ManualRig, what: str, *, yes: bool) -> None:
    """Have the holder hold what a scan needs: by the rig itself, or by the person, who confirms it."""
    from gonio.cli import console
    from gonio.errors import DeviceError

    if hasattr(manual, "put") and manual.put(what):
        return
    if yes:
        console.note(f"{PROMPTS[what]} (--yes: taken as done)")
        return
    print(f"{PROMPTS[what]}, then press Enter (Ctrl-C stops): ", end="", file=sys.stderr, flush=True)
    if not sys.stdin.readline():
        raise DeviceError("there is no terminal to confirm what lies in the holder; --yes asks for none")


def _write_picture(table: pd.DataFrame, found: Alignment, picture: Path) -> None:

    from gonio.by_hand import alignment
    from gonio.disk import write_whole
    from gonio.errors import DataError

    drawn = BytesIO()
    alignment.draw(table, found).savefig(drawn, format="png", dpi=110)
    try:
        write_whole(picture, drawn.getvalue())
    except OSError as error:
        raise DataError(f"{picture}: cannot be written: {error.strerror}") from None


def _show(found: Alignment, description: RigDescription) -> None:
    from gonio.cli import console

    table = console.table(
        "axis", "zero_offset_deg", "was", "u (k = 1)", "of it: scans", "encoder", "backlash", "departures"
    )
    for name, zero in found.zeros.items():
        known = description.axes()[name]
        was = f"{known.zero_offset_deg:.3f}" if known.zero_offset_known else "not known"
        parts = (number(part, 2) for part in zero.parts.values())
        now, u = apart(zero.offset_deg, zero.u_deg)
        table.add_row(name, now, was, u, *parts)
    console.show(table)
    rows = console.table("scan", "holder", "axis", "light [deg]", "centre [deg]", "u [deg]", "residual [deg]")
    for r in found.scans.itertuples():
        numbers = (f"{r.at_deg:.2f}", f"{r.centre_deg:.3f}", f"{r.u_deg:.3f}", f"{r.residual_deg:+.3f}")
        rows.add_row(str(r.scan), str(r.holder), str(r.axis), *numbers)
    console.show(rows)
    console.show(f"rank {found.rank} of {len(found.axes)} ({', '.join(found.axes)})")
    if "light" in found.zeros:
        i, j = found.axes.index("light"), found.axes.index("camera")
        c = found.covariance
        console.show(f"correlation of light and camera: {c[i, j] / (c[i, i] * c[j, j]) ** 0.5:+.2f}")
    for sentence in found.open:
        console.show(f"not determined: {sentence}")
