"""What a fit or a plot uses of a table: the rows that count, as arrays, with their covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from gonio import measurement, polarisation
from gonio.checks.values import CheckedValues
from gonio.errors import ConfigError, DataError
from gonio.formats.channels import is_joined
from gonio.geometry import Directions
from gonio.measurement import of_reader, said_once
from gonio.models.polarised import Light
from gonio.typing import DataFrame, Floats
from gonio_analysis.fitting.usable import TRANSMISSION, Some, usable
from gonio_analysis.fitting.value_covariance import Covariance, independent
from gonio_analysis.result_records import CauseSummary

if TYPE_CHECKING:
    from gonio.instrument import Cones

DEFAULT_WAVELENGTH_NM = 550.0
SAME_BAND_NM = 1e-6
UNSTATED = "The table states no uncertainties."
ASSUMED = (
    "The table states no uncertainties: a standard uncertainty of {:g} % of each value is ASSUMED (--u-rel),"
    " independent from value to value. Every chi-square, verdict and error bar rests on it."
)
LINEAR_BELOW = 0.05
"""Without uncertainties: the fraction of the median |f| below which differences count as such, not as ratios."""


@dataclass(frozen=True)
class FittedTable:
    """One of several tables that are fitted together."""

    name: str
    source_solid_angle_sr: float
    receiver_solid_angle_sr: float


@dataclass(frozen=True)
class Prepared:
    """Values of one wavelength that one instrument measured, for the forward model."""

    wavelength_nm: float
    rows: Any
    cones: Cones
    pointlike: bool
    """Whether both cones are directions."""
    light: Light | None = None
    """Polarised light and analysers of the values; None where all of it is unpolarised."""


@dataclass(frozen=True)
class Unused:
    """Where a table has rows that must not be used: values are not interpolated across them."""

    directions: Directions = field(default_factory=lambda: Directions(*np.zeros((4, 0))))
    wavelength_nm: Floats = field(default_factory=lambda: np.zeros(0))

    def turned(self, turn: float) -> Unused:
        """The same with azimuths that are larger by an angle [rad]."""
        return replace(self, directions=self.directions.turned(turn))


@dataclass(frozen=True)
class Observations:
    """The usable values of one sample, in the order of the table.

    `brdf` and everything of `covariance` are 1/sr. `wavelength_nm` is NaN in a broad band.
    `covariance` is None where the table states no uncertainty. Solid angles are NaN where tables that are fitted
    together have different ones.
    """

    directions: Directions
    wavelength_nm: Floats
    brdf: Floats
    covariance: Covariance | None
    rows: npt.NDArray[np.integer]
    """Row of the table that each value comes from."""
    source_solid_angle_sr: float = 0.0
    receiver_solid_angle_sr: float = 0.0
    omitted: Mapping[str, Floats] = field(default_factory=dict)
    """Why rows of the table are not here -> the wavelengths [nm] of those rows."""
    unused: Unused = field(default_factory=Unused)
    """Where those rows lie; without those whose angles are not finite, which are nowhere."""
    notes: tuple[str, ...] = ()
    """Sentences for a person about what was assumed."""
    parts: tuple[FittedTable, ...] = ()
    """The tables that are fitted together; none where there is one."""
    part: npt.NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    """Which of `parts` each value is from; empty where there is one table."""
    zeros_rad: Mapping[str, float] = field(default_factory=dict)
    """Standard uncertainties [rad] of the arms' zeros by their causes, where the model shall tell what they do
    (`gonio_analysis.fitting.forward`)."""
    readings_rad: Mapping[str, float] = field(default_factory=dict)
    """The same of the encoders' readings, by the cause of the same arm; with `u_angles`."""
    u_angles: Floats = field(default_factory=lambda: np.zeros(0))
    """(n,) The part of the independent uncertainties [1/sr] that errors of the angles make; empty where unknown."""
    states: npt.NDArray[Any] = field(default_factory=lambda: np.zeros(0, dtype=object))
    """(n,) Words of the column `polarisation`; empty where all of the light is unpolarised."""
    first: Floats = field(default_factory=lambda: np.zeros(0))
    """(n,) Measured first elements of Mueller matrices [1/sr] that values are ratios times, NaN for others; empty where
    there are none."""
    polarisers: polarisation.Polarisers = polarisation.PERFECT
    """The instrument's, of polarised values."""
    u_rel_assumed: float | None = None
    """Relative uncertainty that somebody assumes, where the table states none: `covariance` is then made from it."""
    of_channels: bool = False
    """Whether the wavelengths are nominal ones of the channels red, green and blue (`gonio.formats.channels`)."""

    def __len__(self) -> int:
        return int(self.brdf.size)

    @property
    def left_out(self) -> dict[str, int]:
        """Why rows of the table are not here, and how many."""
        return {reason: int(waves.size) for reason, waves in self.omitted.items() if waves.size}

    @property
    def u(self) -> Floats:
        """Combined standard uncertainty [1/sr]; NaN where the table states none."""
        return self.covariance.total if self.covariance is not None else np.full(len(self), np.nan)

    @cached_property
    def wavelengths(self) -> list[float]:
        """The wavelengths [nm] that occur, ascending; NaN (last) stands for a broad band."""
        return [float(w) for w in np.unique(self.wavelength_nm)]

    @property
    def checked(self) -> CheckedValues:
        """What `gonio.checks` takes."""
        known = self.covariance
        if known is None:
            return CheckedValues(self.directions, self.brdf)
        return CheckedValues(self.directions, self.brdf, known.random, known.common)

    def budget(self) -> list[CauseSummary]:
        """Uncertainty by cause: median and 95th percentile of |u / value|, the combined one first.

        Values within 3 u of zero are left out: relative to them nothing means anything. Empty where nothing is stated.
        """
        known, use = self.covariance, np.abs(self.brdf) > 3 * self.u
        if known is None or not use.any():
            return []
        parts = {"combined": known.total, "random (independent)": known.random}
        parts |= {cause.replace("_", " "): np.abs(known.common[:, k]) for k, cause in enumerate(known.causes)}
        relative = {label: u[use] / np.abs(self.brdf[use]) for label, u in parts.items()}
        return [CauseSummary(label, float(np.median(p)), float(np.quantile(p, 0.95))) for label, p in relative.items()]

    @cached_property
    def cones(self) -> list[Prepared]:
        """The values of each wavelength and instrument, and their directions, prepared for the forward model."""
        from gonio.instrument import LOBE_TOLERANCE, Cones

        out = []
        own = FittedTable("", self.source_solid_angle_sr, self.receiver_solid_angle_sr)
        for number, part in enumerate(self.parts or (own,)):
            of_part = self.part == number if self.parts else np.ones(len(self), dtype=bool)
            for wave in self.wavelengths:
                rows = of_part & (np.isnan(self.wavelength_nm) if np.isnan(wave) else self.wavelength_nm == wave)
                here = slice(None) if rows.all() else rows
                if rows.any():
                    angles = (part.source_solid_angle_sr, part.receiver_solid_angle_sr)
                    cones = Cones(*self.directions[here].angles, *angles, spike="exact", tolerance=LOBE_TOLERANCE)
                    light = None if self.light is None else self.light.take(here)
                    out.append(Prepared(wave, here, cones, angles == (0.0, 0.0), light))
        return out

    @cached_property
    def light(self) -> Light | None:
        """Polarised light and analysers of the values; None where all of it is unpolarised."""
        if not self.states.size:
            return None
        first = self.first if self.first.size else None
        return Light(self.directions, *polarisation.states(self.states.tolist(), self.polarisers), first)

    @property
    def differences(self) -> npt.NDArray[np.bool_]:
        """(n,) Which values are no intensities: elements of a Mueller matrix, and Stokes parameters."""
        return differences(self.states) if self.states.size else np.zeros(len(self), dtype=bool)

    def __getstate__(self) -> dict[str, Any]:
        made_again = ("cones", "light")
        return {key: value for key, value in self.__dict__.items() if key not in made_again}

    def take(self, rows: npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> Observations:
        """Some of the values; of all of them nothing is copied."""
        if rows.all() if rows.dtype == bool else np.array_equal(rows, np.arange(len(self))):
            return self
        some = [name for name in ("part", "u_angles", "states", "first") if getattr(self, name).size]
        taken = {name: getattr(self, name)[rows] for name in ("directions", "wavelength_nm", "brdf", "rows", *some)}
        return replace(self, covariance=self.covariance and self.covariance.take(rows), **taken)

    def at(self, wavelength_nm: float) -> Observations:
        """The values at one of `wavelengths` (NaN: the broad band)."""

        def here(waves: Floats) -> npt.NDArray[np.bool_]:
            return np.isnan(waves) if np.isnan(wavelength_nm) else np.abs(waves - wavelength_nm) <= SAME_BAND_NM

        omitted = {reason: waves[here(waves)] for reason, waves in self.omitted.items()}
        taken = self.take(here(self.wavelength_nm))
        same = taken is self and all(waves.size == self.omitted[reason].size for reason, waves in omitted.items())
        return self if same else replace(taken, omitted=omitted)

    def nearest(self, wavelength_nm: float | None) -> tuple[Observations, float]:
        """The values at the wavelength nearest to the one asked for (550 nm if none is), and that wavelength [nm]."""
        known = [w for w in self.wavelengths if not np.isnan(w)]
        if not known:
            return self, float("nan")
        goal = DEFAULT_WAVELENGTH_NM if wavelength_nm is None else wavelength_nm
        chosen = min(known, key=lambda w: abs(w - goal))
        return self.at(chosen), chosen


def _none_left(name: str, rows: int, omitted: Mapping[str, Floats]) -> DataError:
    counts = describe_left_out({reason: waves.size for reason, waves in omitted.items()})
    alone = TRANSMISSION in omitted and len(omitted) == 1
    return DataError(
        f"{name}: none of its {rows} rows can be used: {counts or 'it is empty'}"
        + ("; models and quantities here are those of reflection" if alone else "")
    )


def observations(
    table: DataFrame, name: str = "the table", u_rel: float | None = None, *, polarised: bool = False
) -> Observations:
    """The usable rows of a measurement table.

    Others are left out, and counted by the reason why (`gonio_analysis.fitting.usable`).

    Parameters
    ----------
    table, name
        A measurement table of one sample (`gonio.measurement`), and what messages call it.
    u_rel
        Relative standard uncertainty to assume of every value where the table states none; above 0 and below 1.
    polarised
        Take rows of polarised light as they were measured, and each element of a Mueller matrix as a value. Without it
        what unpolarised light would show is taken, where every state was measured, and other polarised rows are not.

    Raises
    ------
    DataError, ConfigError
        Not one row is usable; the message says why. `u_rel` is no such number.
    """
    check_u_rel(u_rel)
    told = measurement.every_state(table) if polarised else measurement.unpolarised(table)
    table = told.copy(deep=False)
    table.attrs = {}  # which each access to a column would copy
    directions = Directions.from_table(table)
    brdf, wavelength = (table[name].to_numpy(np.float64) for name in ("brdf", "wavelength_nm"))
    rows = usable(table, directions, wavelength, brdf, polarised=polarised)
    keep, omitted, notes = rows.keep, rows.omitted, [*of_reader(told), *rows.notes]
    if not keep.size:
        raise _none_left(name, len(table), omitted)
    some: Some = keep if keep.size < len(table) else slice(None)  # nothing is copied where all are used
    covariance = rows.covariance(some)
    if covariance is not None and u_rel is not None:
        notes.append(f"The table states its own uncertainties; the assumed {100 * u_rel:g} % is not used.")
        u_rel = None
    elif u_rel is not None:
        apart = differences(table["polarisation"].to_numpy(object)[keep])
        covariance = independent(_assumed(brdf[keep], wavelength[keep], u_rel, apart))
        notes.append(ASSUMED.format(100 * u_rel))
    elif covariance is None and not any("no uncertainties" in note for note in notes):
        notes.append(UNSTATED)
    if TRANSMISSION in omitted:
        notes.append(f"{omitted[TRANSMISSION].size} rows are transmission: left out, models here describe reflection.")
    source, receiver = (_solid_angle(told.attrs, which) for which in ("source", "receiver"))
    if unknown := " and of the ".join(["source"] * (source is None) + ["receiver"] * (receiver is None)):
        notes.append(f"The solid angle of the {unknown} is unknown: models are evaluated for a single direction there.")
    return Observations(
        directions=directions[some],
        wavelength_nm=wavelength[some],
        brdf=brdf[some],
        covariance=covariance,
        rows=keep,
        source_solid_angle_sr=source or 0.0,
        receiver_solid_angle_sr=receiver or 0.0,
        omitted=omitted,
        unused=_unused(directions, wavelength, rows.unused),
        notes=tuple(notes),
        u_rel_assumed=u_rel,
        of_channels=is_joined(told),
        polarisers=polarisation.Polarisers.of(told.attrs),
        **_of_angles(told, keep),
        states=_states(table["polarisation"].to_numpy(object)[keep]),
        first=_first(
            table[measurement.FIRST].to_numpy(np.float64)[keep] if measurement.FIRST in table else np.zeros(0)
        ),
    )


def _unused(directions: Directions, wavelength_nm: Floats, rows: npt.NDArray[np.bool_]) -> Unused:
    nowhere = ~np.isfinite(np.stack(directions[rows].angles)).all(axis=0)
    left = np.flatnonzero(rows)[~nowhere]
    return Unused(directions[left], wavelength_nm[left])


def _of_angles(table: DataFrame, keep: npt.NDArray[np.int32]) -> dict[str, Any]:
    """What a table says of its angles: `zeros_rad` and `readings_rad` of its provenance, and `u_angles` of some rows.

    Nothing where it holds something else, and no `u_angles` where a row lacks them.
    """
    provenance = table.attrs.get("provenance")
    out: dict[str, Any] = {}
    for key in ("zeros_rad", "readings_rad"):
        stated = provenance.get(key) if isinstance(provenance, Mapping) else None
        known = stated.items() if isinstance(stated, Mapping) else ()
        out[key] = {str(name): float(u) for name, u in known if isinstance(u, float | int) and 0.0 < u < 0.1}
    u = table["u_angles"].to_numpy(np.float64)[keep] if "u_angles" in table.columns else np.zeros(0)
    return out | {"u_angles": u if np.isfinite(u).all() else np.zeros(0)}


def _states(words: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return words if (words != polarisation.UNPOLARISED).any() else np.zeros(0, dtype=object)


def _first(elements: Floats) -> Floats:
    return elements if np.isfinite(elements).any() else np.zeros(0)


def together(several: Mapping[str, Observations]) -> Observations:
    """The values of several tables of one sample as one, by name: each with its own instrument and its own causes.

    A cause is common to the rows of its table alone, and is called CAUSE@TABLE.

    Raises
    ------
    DataError
        Some tables state uncertainties and others do not: nothing says how they weigh against each other.
    """
    if len(several) == 1:
        return next(iter(several.values()))
    stated = [name for name, one in several.items() if one.covariance is not None]
    if stated and len(stated) < len(several):
        silent = next(name for name in several if name not in stated)
        raise DataError(
            f"{silent}: states no uncertainties, and {stated[0]} does: nothing says how the two weigh against each "
            "other; fit them one by one, or give the first one a column u_brdf"
        )
    each = list(several.values())
    for name, one in several.items():
        if one.polarisers != each[0].polarisers:
            raise DataError(f"{name}: has other polarisers than {next(iter(several))}; fit the two one by one")
    words = [one.states if one.states.size else np.full(len(one), polarisation.UNPOLARISED, object) for one in each]
    cones = np.array([(one.source_solid_angle_sr, one.receiver_solid_angle_sr) for one in each])
    source, receiver = np.where((cones == cones[0]).all(axis=0), cones[0], np.nan).tolist()
    return Observations(
        directions=Directions(*np.concatenate([np.stack(one.directions.angles) for one in each], axis=1)),
        wavelength_nm=np.concatenate([one.wavelength_nm for one in each]),
        brdf=np.concatenate([one.brdf for one in each]),
        covariance=_own_causes({name: one.covariance for name, one in several.items() if one.covariance is not None}),
        rows=np.concatenate([one.rows for one in each]),
        source_solid_angle_sr=source,
        receiver_solid_angle_sr=receiver,
        omitted={
            f"{reason} in {name}": waves for name, one in several.items() for reason, waves in one.omitted.items()
        },
        notes=tuple(said_once({name: one.notes for name, one in several.items()})),
        parts=tuple(
            FittedTable(name, one.source_solid_angle_sr, one.receiver_solid_angle_sr) for name, one in several.items()
        ),
        part=np.repeat(np.arange(len(each)), [len(one) for one in each]),
        u_rel_assumed=next((one.u_rel_assumed for one in each if one.u_rel_assumed is not None), None),
        states=_states(np.concatenate(words)),
        polarisers=each[0].polarisers,
        first=_first(np.concatenate([one.first if one.first.size else np.full(len(one), np.nan) for one in each])),
        of_channels=all(one.of_channels for one in each),
    )


def _own_causes(stated: Mapping[str, Covariance]) -> Covariance | None:
    """The covariance of the values of several tables, whose causes are each table's own; None of no table."""
    from scipy.linalg import block_diag

    if not stated:
        return None
    causes = tuple(f"{cause}@{name}" for name, one in stated.items() for cause in one.causes)
    common = np.asarray(block_diag(*(one.common for one in stated.values())))
    return Covariance(np.concatenate([one.random for one in stated.values()]), common, causes)


def check_u_rel(u_rel: float | None) -> None:
    """Raise `ConfigError` for an assumed relative uncertainty that is none."""
    if u_rel is not None and not 0 < u_rel < 1:
        raise ConfigError(f"--u-rel {u_rel:g}: a relative uncertainty lies between 0 and 1, as 0.03 for 3 %")


def check_wavelength(wavelength_nm: float | None) -> None:
    """Raise `ConfigError` for a wavelength [nm] that is none."""
    if wavelength_nm is not None and not 0.0 < wavelength_nm < np.inf:
        raise ConfigError(f"--wavelength-nm {wavelength_nm:g}: a wavelength is above 0 nm")


def differences(states: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """(n,) Which words of the column `polarisation` are no intensities: Stokes parameters, elements of a matrix."""
    return np.array([not word.islower() for word in states.tolist()], dtype=bool)


def _assumed(brdf: Floats, wavelength_nm: Floats, u_rel: float, apart: npt.NDArray[np.bool_]) -> Floats:
    """u_rel times each value; those far below the median of their wavelength count as a tenth of it.

    Differences of intensities (`apart`) count as that median.
    """
    _, group = np.unique(wavelength_nm, return_inverse=True)
    kept = ~apart if not apart.all() else apart
    medians = np.array([np.median(np.abs(brdf[(group == k) & kept])) for k in range(int(group.max()) + 1)])
    least = np.where(apart, 1.0, 2 * LINEAR_BELOW) * medians[group]
    return np.asarray(u_rel * np.hypot(brdf, np.maximum(least, 1e-300)))


def describe_left_out(left_out: Mapping[str, int]) -> str:
    """As in "12 flagged blocked, 3 polarised"."""
    return ", ".join(f"{count} {reason}" for reason, count in left_out.items())


def _solid_angle(attrs: dict[Any, Any], which: str) -> float | None:
    value = attrs.get(f"{which}_solid_angle_sr")
    if value is None or not np.isfinite(float(value)):
        return None
    if float(value) < 0:
        raise DataError(f"{which}_solid_angle_sr = {value} in the table: a solid angle is not negative")
    return float(value)
