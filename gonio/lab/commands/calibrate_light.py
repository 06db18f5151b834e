"""`gonio calibrate light`: warm-up, drift and noise of the lamp, its beam, its bands, its polarisation."""

import contextlib
import math
from collections.abc import Callable
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.linalg import block_diag

from gonio.cli import console
from gonio.cli.signals import undisturbed
from gonio.config import numbers_in
from gonio.disk import put, put_picture
from gonio.errors import ConfigError, DataError
from gonio.lab.acquisition.run import Run
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.calibration import beam, lamp_scan, lamp_stability, polarisers, spectral
from gonio.lab.commands import opened
from gonio.lab.commands.opened import free_name
from gonio.lab.reduction.geometry_errors import zero_keys
from gonio.lab.rig.calibration_files import (
    Calibration,
    covariance_of,
    identity,
    known_parameters,
    with_keys,
    write_calibration,
)
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import ParameterUncertainty
from gonio.shown import apart
from gonio.typing import Figure, Floats, TomlTable

NO_ZERO_DEG = 10.0
"""No zero is off by as much: `gonio calibrate geometry` expects none there."""


@dataclass(frozen=True, slots=True)
class EarlierData:
    """Earlier data: where there are any, they alone are evaluated."""

    series: Path | None
    spectra: Path | None
    lines: Path | None
    lamp_polariser: Path | None
    polarisers: Path | None


@dataclass(frozen=True, slots=True)
class LightOptions:
    """How the rig is driven: the options of the command."""

    only: str
    index: float
    minutes: float
    every_s: float
    wavelength_nm: float | None
    seed: int
    yes: bool


@dataclass(slots=True)
class _Found:
    """What was found so far: values of keys, blocks of their covariance, figures, remarks."""

    values: TomlTable = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    blocks: list[Any] = field(default_factory=list)
    measured: TomlTable = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    pictures: list[str] = field(default_factory=list)

    def add(self, table: str, values: TomlTable, names: list[str], covariance: Any) -> None:
        """Values of keys below a table, and the covariance of some, whose whole paths are given."""
        where = self.values
        for name in table.split("."):
            where = where.setdefault(name, {})
        where.update(values)
        self.names += names
        self.blocks.append(covariance)

    def uncertainty(self) -> ParameterUncertainty:
        """Uncertainties of all numbers so far."""
        return ParameterUncertainty.of(self.names, block_diag(*self.blocks) if self.names else np.zeros((0, 0)))


def calibrate(rig: str, out: Path, earlier: EarlierData, asked: LightOptions, valid_days: int | None) -> None:
    """Evaluate earlier data, or drive the rig; write what is found of the light.

    Raises
    ------
    ConfigError
        A file is not there, or is where it must not be.
    DataError
        The data tell nothing, or not enough.
    """
    opened.require_rig_file(rig)
    opened.require_new(out)
    # what was measured before of the light is not to be taken out of what is measured now
    description, found = opened.choice_of(rig, without="light").description, _Found()
    series, flats = earlier.series, None
    if not any(astuple(earlier)):
        series, flats = _take(rig, out, asked)
        if flats is not None:
            _of_the_camera(description, found)
    if series is not None:
        _lamp(series, description, out, found)
    if flats is not None:
        _beam(flats, description, out, found)
    if earlier.spectra is not None or earlier.lines is not None:
        _bands(earlier.spectra, earlier.lines, description, found)
    if earlier.lamp_polariser is not None:
        _polarisation(earlier.lamp_polariser, found)
    if earlier.polarisers is not None:
        _polarisers(earlier.polarisers, asked.index, description, found)
    if not found.values:
        raise DataError(f"{out} is not written: nothing was found")
    known = found.uncertainty()
    calibration = Calibration.made_today(
        "light", description, valid_days,
        values=found.values, uncertainty=known, measured=found.measured, notes=found.notes,
    )  # fmt: skip
    with_keys(description, found.values, out)  # a value that the rig file cannot have is said now
    write_calibration(calibration, out)
    u = dict(zip(found.names, known.u, strict=True))
    table = console.table("key", "value", "u (k = 1)")
    for name, value in numbers_in(found.values).items():
        with contextlib.suppress(TypeError):
            table.add_row(name, *apart(value, u.get(name)))
    console.show(table)
    for note in found.notes:
        console.note(note)
    console.show(str(out), *found.pictures)


# ---- on the rig ----


def _take(rig: str, out: Path, asked: LightOptions) -> tuple[Path | None, Path | None]:
    """The files of a series, and of flats, that are taken now beside OUT."""
    manual = opened.manual_rig_of(rig, "arms", "light", "camera", seed=asked.seed, without="light")
    if asked.wavelength_nm is not None:
        manual.choose_band(asked.wavelength_nm)
    if not manual.repeatable and manual.description.reference.how not in ("axis", "beside"):
        prompt = "Put the white reference into the holder; the lamp should have been dark for long"
        opened.confirm(prompt, "that the white lies in the holder", yes=asked.yes)
    series = flats = None
    with opened.told_where(manual), manual:
        if asked.only != "beam":
            series = _take_series(manual, out, asked)
        if asked.only != "lamp":
            flats = free_name(out, "flats", ".csv")
            console.note("flats of the white at several camera angles")
            with console.counter("flats", lines=True) as progress:
                lamp_scan.take_flats(manual, keep=lambda table: _keep(table, flats), progress=progress)
    console.note("lamp dark, arms parked")
    return series, flats


def _take_series(manual: ManualRig, out: Path, asked: LightOptions) -> Path:
    file = free_name(out, "series", ".csv")
    console.note(f"watching the lamp for {asked.minutes:g} minutes from when it is lit; it should be cold now")
    with console.counter("watching the lamp: seconds", lines=True) as progress:
        lamp_scan.take_series(
            manual, 60.0 * asked.minutes, asked.every_s, keep=lambda table: _keep(table, file), progress=progress
        )
    return file


def _keep(table: pd.DataFrame, file: Path) -> None:
    with undisturbed():
        put(file, table.to_csv(index=False).encode())
    console.note(f"{file}: {len(table)} rows")


def _of_the_camera(description: RigDescription, found: _Found) -> None:
    """Say what flats rest on that the rig file, with its calibrations, does not say."""
    camera = description.camera
    if not (camera.stray_light or camera.stray_halo or camera.nonlinearity):
        found.notes.append(
            "the rig file knows no stray light and no nonlinearity of the camera: the beam holds what there is of "
            "them. `gonio calibrate camera` first, and name its file in the rig file"
        )


# ---- what the data tell ----


def _lamp(series: Path, description: RigDescription, out: Path, found: _Found) -> None:
    table = lamp_stability.read_series(series)
    time_s, signal, u = (table[name].to_numpy() for name in lamp_stability.COLUMNS[:3])
    stability = lamp_stability.fit(time_s, signal, u)
    _picture(found, out, "series", lambda: lamp_stability.draw(table, stability))
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
    table = beam.read_flats(flats)
    profile = beam.fit(table)
    _picture(found, out, "flats", lambda: beam.draw(table, profile))
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


def _by_zeros(description: RigDescription, table: pd.DataFrame, profile: beam.Profile, found: _Found) -> Floats:
    """Covariance of the beam's numbers from zeros of the axes, which look like a tilt of the beam.

    Where no calibration has measured a zero, the rig file's `zero_u_deg` counts. A tilt that exceeds that and noise
    may still come from a zero; its uncertainty is then its own size.
    """
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
    measured = spectral.spectra(spectra) if spectra is not None else []
    scale = spectral.wavelength_scale(lines) if lines is not None else None
    found.add("bands", *spectral.values(description.bands, measured, scale))
    if scale is not None:
        found.measured["wavelength_scale"] = {
            "middle_nm": scale.middle_nm, "offset_nm": scale.offset_nm, "slope": scale.slope,
            "scatter_nm": scale.residual_nm,
        }  # fmt: skip


def _polarisation(path: Path, found: _Found) -> None:
    of, where = spectral.polarised(path), "lamp.polarisation"
    values = {"degree": of.degree, "azimuth_deg": of.azimuth_deg}
    found.add(where, values, [f"{where}.{name}" for name in values], of.covariance)
    found.notes.append("the polarisation of the lamp is not corrected for: it is in the budget")


def _polarisers(path: Path, index: float, description: RigDescription, found: _Found) -> None:
    run = Run.open(path)
    if identity(run.description) != identity(description):
        raise ConfigError(f'{path}: was measured on "{run.description.name}", which is another rig than --rig')
    of = polarisers.calibrate(run, index)
    found.add("polarisers", of.values, of.names, of.covariance)
    found.measured["polarisers"] = {"index": index, "chi_square": of.chi_square, "freedom": of.freedom}
    found.notes += of.notes


def _picture(found: _Found, out: Path, what: str, draw: Callable[[], Figure]) -> None:
    file = free_name(out, what, ".png")
    found.pictures += map(str, put_picture(file, draw))
