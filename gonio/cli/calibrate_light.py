"""`gonio calibrate light`: warm-up, drift and noise of the lamp, its beam, its bands, its polarisation."""

from __future__ import annotations

import contextlib
import datetime
import math
import sys
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from gonio.cli.by_hand import WavelengthOption, _told_where, choice_of, manual_rig_of
from gonio.cli.calibrate import app
from gonio.cli.signals import undisturbed
from gonio.documents import TomlTable
from gonio.shown import apart

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from gonio.by_hand.manual_rig import ManualRig
    from gonio.calibration.beam import Profile
    from gonio.rig.description import RigDescription

__all__ = ["app"]

NO_ZERO_DEG = 10.0
"""No zero is off by as much: `gonio calibrate geometry` expects none there."""
FileOption = typer.Option(show_default=False, exists=True, dir_okay=False)


@app.command()
def light(
    rig: Annotated[str, typer.Option(help="A rig file.", show_default=False)],
    out: Annotated[Path, typer.Option(help="The calibration file to write.", show_default=False)],
    only: Annotated[Literal["both", "lamp", "beam"], typer.Option(help="What to measure on the rig.")] = "both",
    minutes: Annotated[float, typer.Option(min=1, max=10_000, help="How long to watch the lamp.")] = 60.0,
    every: Annotated[float, typer.Option(min=0.1, help="Seconds from burst to burst of frames.")] = 15.0,
    series: Annotated[Path | None, typer.Option(help="An earlier series of the lamp.", show_default=False)] = None,
    flats: Annotated[Path | None, typer.Option(help="Earlier flats of the white.", show_default=False)] = None,
    spectra: Annotated[
        Path | None, typer.Option(help="Spectra of bands: band, wavelength_nm, signal.", show_default=False)
    ] = None,
    lines: Annotated[Path | None, typer.Option(help="Known lines: line_nm, read_nm.", show_default=False)] = None,
    lamp_polariser: Annotated[
        Path | None, typer.Option(help="A polariser turned in the beam: polariser_deg, signal.", show_default=False)
    ] = None,
    camera_polariser: Annotated[
        Path | None, typer.Option(help="A polariser turned before the lens.", show_default=False)
    ] = None,
    valid_days: Annotated[int | None, typer.Option(min=1, help="How long it is good.", show_default=False)] = None,
    wavelength: WavelengthOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of a simulated rig.")] = 0,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nobody: the white lies in the holder.")] = False,
) -> None:
    """Calibrate lamp, beam, bands and polarisation, with the covariance of what is found.

    With files of earlier data nothing moves, and only they are evaluated. Without, the rig is driven, and its raw data
    lie beside OUT: OUT-series.csv and OUT-flats.csv.
    """
    from gonio.cli import console
    from gonio.errors import ConfigError, DataError
    from gonio.rig.calibrated import Calibration, identity, write_calibration

    if not Path(rig).is_file():
        raise ConfigError(f'"{rig}" is no rig file: gonio rig show {rig} > my.toml, then --rig my.toml')
    if out.suffix != ".toml" or not out.absolute().parent.is_dir():
        raise ConfigError(f"--out {out}: must end with .toml, and lie in a folder that is there")
    if out.exists():
        raise ConfigError(f"{out}: is there already; name another file with --out")
    given = [series, flats, spectra, lines, lamp_polariser, camera_polariser]
    found = _Found()
    # what was measured before of the light is not to be taken out of what is measured now
    description = choice_of(rig, without="light").description
    if not any(given):
        manual = manual_rig_of(rig, "arms", "light", "camera", seed=seed, without="light")
        if wavelength is not None:
            manual.choose_band(wavelength)
        _put_white(manual, yes=yes)
        with _told_where(manual), manual:
            if only != "beam":
                series = _take_series(manual, out, 60.0 * minutes, every)
            if only != "lamp":
                flats = _take_flats(manual, out)
                found.notes += _of_the_camera(description)
        console.note("lamp dark, arms parked")
    if series is not None:
        _lamp(series, description, out, found)
    if flats is not None:
        _beam(flats, description, out, found)
    if spectra is not None or lines is not None:
        _bands(spectra, lines, description, found)
    _polarisation(lamp_polariser, camera_polariser, found)
    if not found.values:
        raise DataError(f"{out} is not written: nothing was found")
    today = datetime.date.today()
    calibration = Calibration(
        kind="light",
        rig=description.name,
        rig_identity=identity(description),
        made=today,
        valid_until=None if valid_days is None else today + datetime.timedelta(days=valid_days),
        notes=tuple(found.notes),
        values=found.values,
        uncertainty=found.uncertainty(),
        measured=found.measured,
    )
    from gonio.rig.calibrated import with_keys

    with_keys(description, calibration.values, out)  # a value that the rig file cannot have is said now
    write_calibration(calibration, out)
    _show(calibration.values, found)
    for note in found.notes:
        console.note(note)
    console.show(str(out), *found.pictures)


class _Found:
    """What was found so far: values of keys, blocks of their covariance, figures, remarks."""

    def __init__(self) -> None:
        self.values: TomlTable = {}
        self.names: list[str] = []
        self.blocks: list[Any] = []
        self.measured: TomlTable = {}
        self.notes: list[str] = []
        self.pictures: list[str] = []

    def add(self, table: str, values: TomlTable, names: list[str], covariance: Any) -> None:
        """Values of keys below a table, and the covariance of some, whose whole paths are given."""
        where = self.values
        for name in table.split("."):
            where = where.setdefault(name, {})
        where.update(values)
        self.names += names
        self.blocks.append(covariance)

    def uncertainty(self) -> Any:
        import numpy as np
        from scipy.linalg import block_diag

        from gonio.rig.calibration_use import ParameterUncertainty

        covariance = block_diag(*self.blocks) if self.names else np.zeros((0, 0))
        u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        size = np.where(u > 0.0, u, 1.0)
        correlation = np.clip(covariance / np.outer(size, size), -1.0, 1.0)
        np.fill_diagonal(correlation, 1.0)
        return ParameterUncertainty(parameters=self.names, u=u.tolist(), correlation=correlation.tolist())


def _lamp(series: Path, description: RigDescription, out: Path, found: _Found) -> None:
    from gonio.calibration import lamp_stability

    table = lamp_stability.read_series(series)
    time_s, signal, u = (table[name].to_numpy() for name in lamp_stability.COLUMNS[:3])
    stability = lamp_stability.fit(time_s, signal, u)
    found.pictures.append(_picture(lamp_stability.draw(table, stability), out, "series"))
    stability.require_model()
    values, names, covariance = lamp_stability.values(stability)
    found.add("lamp", values, [f"lamp.{name}" for name in names], covariance)
    found.measured["lamp"] = {
        "frames": len(table),
        "duration_s": stability.duration_s,
        "shot_noise": stability.shot,
        "chi_square": stability.chi_square,
        "degrees_of_freedom": stability.freedom,
        "outliers_s": stability.outliers.tolist(),
    }
    if not stability.loss:
        found.notes.append("no warm-up is seen: the lamp was warm, or warms up faster than the series tells")
    if stability.outliers.size:
        found.notes.append(f"{stability.outliers.size} single frames depart by more than five standard deviations")
    if "monitor" not in table:
        return
    monitor = table["monitor"].to_numpy()
    if (monitor <= 0).any():
        found.notes.append("the monitor reads 0 or less with the lamp lit: it is passed over")
        return
    ratio = lamp_stability.fit(time_s, signal / monitor, u / monitor)
    found.add("lamp", {"monitor_noise": ratio.noise}, ["lamp.monitor_noise"], [[ratio.u_noise**2]])
    better, was, now = ratio.noise < values["noise"], 100 * values["noise"], 100 * ratio.noise
    found.notes.append(
        f"divided by the monitor, frames scatter by {now:.2g} % instead of {was:.2g} %"
        + (": set lamp.monitor = true" if better and not description.lamp.monitor else "")
        + (": dividing by it makes nothing better" if not better else "")
    )


def _beam(flats: Path, description: RigDescription, out: Path, found: _Found) -> None:
    import numpy as np

    from gonio.calibration import beam

    table = beam.read_flats(flats)
    profile = beam.fit(table)
    found.pictures.append(_picture(beam.draw(table, profile), out, "flats"))
    names = list(type(profile.beam).model_fields)
    values = dict(zip(names, profile.beam.terms(), strict=True))
    covariance = profile.covariance + _by_zeros(description, table, profile, found)
    found.add("lamp.beam", values, [f"lamp.beam.{name}" for name in names], covariance)
    found.measured["beam"] = {
        "flats": int(np.unique(table["flat"]).size),
        "reduced_chi_square": profile.reduced_chi_square,
        "lens_r2": profile.lens[0],
        "lens_r4": profile.lens[1],
        "seen_to_mm": profile.across_mm,
    }
    if profile.reduced_chi_square > 2.0:
        found.notes.append(
            f"flats depart from beam and lens by {profile.reduced_chi_square**0.5:.1f} times their noise: is the white "
            "clean and even, and the beam no more than a hill? (u is enlarged by as much)"
        )
    found.notes.append(
        "across the plane of the arms the beam rests on a lens that is round, and takes what it takes there"
    )


def _by_zeros(description: RigDescription, table: pd.DataFrame, profile: Profile, found: _Found) -> Any:
    """Covariance of the beam's numbers from zeros of the axes, which look like a tilt of the beam.

    Where no calibration has measured a zero, the rig file's `zero_u_deg` counts. A tilt that is more than that and
    noise may be the zero's all the same, and is uncertain by as much as it is.
    """
    import numpy as np

    from gonio.calibration import beam
    from gonio.reduction.geometry_errors import zero_keys
    from gonio.rig.calibrated import covariance_of, known_parameters

    axes = [name for name in ("light", "camera", "tilt") if name in description.axes()]
    keys, measured = zero_keys(description), known_parameters(description)
    slopes = np.array([beam.by_zero(description, table, profile, axis) for axis in axes])
    zeros = covariance_of(description, [keys[axis] for axis in axes])
    guessed = [axis for axis in axes if keys[axis] not in measured]
    for axis in guessed:
        at = axes.index(axis)
        zeros[at, at] = description.axes()[axis].zero_u_deg ** 2
    out = np.asarray(slopes.T @ zeros @ slopes)
    if not guessed:
        return out
    said = f"no calibration has measured the zeros of {', '.join(guessed)}: a beam that is tilted and a zero look alike"
    tilts = []
    for k, along in enumerate("xy"):
        value, u = profile.beam.terms()[k], math.sqrt(profile.covariance[k, k] + out[k, k])
        by = {axis: -value / slopes[axes.index(axis), k] for axis in guessed if slopes[axes.index(axis), k]}
        own = {axis: off for axis, off in by.items() if abs(off) < NO_ZERO_DEG}
        if own and abs(value) > 3.0 * u:
            off = " or ".join(f"{zero:+.2g} deg of {axis}" for axis, zero in own.items())
            tilts.append(f"{along}_per_mm = {value:.2g}, which a zero that is off by {off} makes, too")
            out[k, k] += value**2
    said += f". It is {'; '.join(tilts)}; u is enlarged by as much" if tilts else ", and u holds what zero_u_deg says"
    found.notes.append(f"{'WARNING: ' * bool(tilts)}{said}. `gonio calibrate geometry` first, and name its file")
    return out


def _bands(spectra: Path | None, lines: Path | None, description: RigDescription, found: _Found) -> None:
    from gonio.calibration import spectral

    measured = spectral.spectra(spectra) if spectra is not None else []
    scale = spectral.wavelength_scale(lines) if lines is not None else None
    values, names, covariance = spectral.values(description.bands, measured, scale)
    found.add("bands", values, names, covariance)
    if scale is not None:
        found.measured["wavelength_scale"] = {
            "middle_nm": scale.middle_nm, "offset_nm": scale.offset_nm, "slope": scale.slope,
            "scatter_nm": scale.residual_nm,
        }  # fmt: skip


def _polarisation(lamp: Path | None, camera: Path | None, found: _Found) -> None:
    from gonio.calibration.polariser import polarised

    for table, path in (("lamp", lamp), ("camera", camera)):
        if path is not None:
            of = polarised(path)
            where = f"{table}.polarisation"
            values = {"degree": of.degree, "azimuth_deg": of.azimuth_deg}
            found.add(where, values, [f"{where}.degree", f"{where}.azimuth_deg"], of.covariance)
            found.notes.append(f"the polarisation of the {table} is not corrected for: it is in the budget")


def _take_series(manual: ManualRig, out: Path, duration_s: float, every_s: float) -> Path:
    from gonio.calibration import lamp_scan
    from gonio.cli import console

    file = _free(out, "series", ".csv")
    console.note(f"watching the lamp for {duration_s / 60:g} minutes from when it is lit; it should be cold now")
    with console.counter("watching the lamp: seconds", lines=True) as progress:
        lamp_scan.take_series(manual, duration_s, every_s, keep=lambda table: _keep(table, file), progress=progress)
    return file


def _take_flats(manual: ManualRig, out: Path) -> Path:
    from gonio.calibration import lamp_scan
    from gonio.cli import console

    file = _free(out, "flats", ".csv")
    console.note("flats of the white at several camera angles")
    with console.counter("flats", lines=True) as progress:
        lamp_scan.take_flats(manual, keep=lambda table: _keep(table, file), progress=progress)
    return file


def _of_the_camera(description: RigDescription) -> list[str]:
    """What flats rest on that the rig file, with its calibrations, does not say."""
    camera = description.camera
    if camera.stray_light or camera.stray_halo or camera.nonlinearity:
        return []
    return [
        "the rig file knows no stray light and no nonlinearity of the camera: the beam holds what there is of them. "
        "`gonio calibrate camera` first, and name its file in the rig file"
    ]


def _keep(table: pd.DataFrame, file: Path) -> None:
    from gonio.cli import console
    from gonio.disk import write_whole
    from gonio.errors import DataError

    with undisturbed():
        try:
            write_whole(file, table.to_csv(index=False).encode())
        except OSError as error:
            raise DataError(f"{file}: cannot be written: {error.strerror or error}") from None
    console.note(f"{file}: {len(table)} rows")


def _picture(figure: Figure, out: Path, what: str) -> str:

    from gonio.disk import write_whole
    from gonio.errors import DataError

    drawn, file = BytesIO(), _free(out, what, ".png")
    figure.savefig(drawn, format="png", dpi=110)
    try:
        write_whole(file, drawn.getvalue())
    except OSError as error:
        raise DataError(f"{file}: cannot be written: {error.strerror or error}") from None
    return str(file)


def _free(out: Path, what: str, suffix: str) -> Path:
    """A name beside OUT that is not taken: a calibration that was refused has left its data."""
    name, number = out.with_name(f"{out.stem}-{what}{suffix}"), 1
    while name.exists():
        number += 1
        name = out.with_name(f"{out.stem}-{what}-{number}{suffix}")
    return name


def _put_white(manual: ManualRig, *, yes: bool) -> None:

    from gonio.cli import console
    from gonio.errors import DeviceError

    if manual.repeatable or manual.description.reference.how in ("axis", "beside"):
        return
    prompt = "Put the white reference into the holder; the lamp should have been dark for long"
    if yes:
        console.note(f"{prompt} (--yes: taken as done)")
        return
    print(f"{prompt}, then press Enter (Ctrl-C stops): ", end="", file=sys.stderr, flush=True)
    if not sys.stdin.readline():
        raise DeviceError("there is no terminal to confirm that the white lies in the holder; --yes asks for none")


def _show(values: TomlTable, found: _Found) -> None:
    from gonio.cli import console
    from gonio.config import numbers_in

    u = dict(zip(found.names, found.uncertainty().u, strict=True))
    table = console.table("key", "value", "u (k = 1)")
    for name, value in numbers_in(values).items():
        with contextlib.suppress(TypeError):
            table.add_row(name, *apart(value, u.get(name)))
    console.show(table)
