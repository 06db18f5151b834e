"""Calibration files: values of a rig file that were measured, with their covariance, for one rig and for a time.

format = 1
kind = "geometry"                     # or "camera", "light"
rig = "laboratory goniometer"         # its name, and the identity that only its own file has
rig_identity = "6f0c..."
made = 2026-11-22
valid_until = 2027-05-22              # left out: for ever
notes = ["no straight-through scan: ..."]

[values]                              # keys of the rig file
arms.light.zero_offset_deg = 1.7312

[uncertainty]                         # of the numbers among them; others count as exact
parameters = ["arms.light.zero_offset_deg"]
u = [0.012]
correlation = [[1.0]]

[measured]                            # what else was found: figures for people, and for reports
"""

import datetime
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from gonio.config import Strict, numbers_in, parse, read_toml, to_toml
from gonio.disk import read_file, write_whole
from gonio.errors import ArgumentError, ConfigError
from gonio.lab.rig.calibration_use import Calibrated
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import ParameterUncertainty
from gonio.typing import Floats, TomlTable, laid_over

FORMAT = 1
FIXED = {
    "camera": ("width", "height", "pixel_um", "pattern", "bits"),
    "reference": ("how",),
}
"""Keys that tell one rig from another, beside its name, driver, axes and encoders: no calibration changes them."""


TABLES = ("geometry", "arms", "holder", "lamp", "camera", "polarisers", "reference", "bands")
"""Tables of the rig file that a calibration may have measured."""


class Calibration(Strict):
    """A calibration file."""

    format: Literal[1] = 1
    kind: Literal["geometry", "camera", "light"]
    rig: str
    rig_identity: str
    made: datetime.date
    valid_until: datetime.date | None = None
    notes: tuple[str, ...] = ()
    """What remained undetermined, and what else a user of the values has to know."""
    values: TomlTable
    """Keys of the rig file, in its tables."""
    uncertainty: ParameterUncertainty = ParameterUncertainty(parameters=[], u=[], correlation=[])
    """Uncertainties of numbers of `values`, by their paths."""
    measured: TomlTable = Field(default_factory=dict)
    """What else was found, for people and reports."""

    @classmethod
    def made_today(
        cls, kind: Literal["geometry", "camera", "light"], description: RigDescription, valid_days: int | None,
        *, values: TomlTable, uncertainty: ParameterUncertainty, measured: TomlTable, notes: Sequence[str],
    ) -> "Calibration":  # fmt: skip
        """A calibration of a rig, valid from today on for some days, or for ever (None)."""
        today = datetime.date.today()
        return cls(
            kind=kind, rig=description.name, rig_identity=identity(description), made=today,
            valid_until=None if valid_days is None else today + datetime.timedelta(days=valid_days),
            notes=tuple(notes), values=values, uncertainty=uncertainty, measured=measured,
        )  # fmt: skip

    @model_validator(mode="after")
    def _names_are_there(self) -> "Calibration":
        known = numbers_in(self.values)
        if missing := [name for name in self.uncertainty.parameters if name not in known]:
            raise ValueError(f'uncertainty.parameters: there is no number "{missing[0]}" in [values]')
        return self

    def unfit(self, description: RigDescription, today: datetime.date) -> str:
        """Why the file is not to be used with a rig on a day; "" where it may be."""
        if self.rig_identity != identity(description):
            other = f'"{self.rig}"' if self.rig != description.name else "another one of this name"
            return (
                f'was made on another rig ({other}, identity {self.rig_identity}; "{description.name}" has '
                f"{identity(description)})"
            )
        if self.valid_until is not None and today > self.valid_until:
            return f"is out of date: it was valid until {self.valid_until}"
        if self.made > today:
            return f"was made on {self.made}, which is still to come: is the clock right?"
        return ""


def identity(description: RigDescription) -> str:
    """What tells a rig from others, whatever is calibrated of it: 12 hexadecimal digits."""
    facts: list[Any] = [description.rig, description.name]
    facts += [(name, axis.encoder_step_deg) for name, axis in description.axes().items()]
    facts += [getattr(getattr(description, table), key) for table, keys in FIXED.items() for key in keys]
    return hashlib.sha256(repr(facts).encode()).hexdigest()[:12]


def read_calibration(path: str | Path) -> Calibration:
    """A calibration file.

    Raises
    ------
    ConfigError
        It is missing, or wrong; the message names file and key.
    """
    return parse(Calibration, read_toml(path), path)


def write_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration file, whole or not at all."""
    write_whole(Path(path), to_toml(calibration.model_dump(mode="python", exclude_none=True)).encode())


def with_keys(description: RigDescription, values: TomlTable, source: str | Path) -> RigDescription:
    """A rig with other values for some keys of its file; `source` is named where one is wrong."""
    return parse(RigDescription, laid_over(description.model_dump(mode="python"), values), source)


def with_calibrations(description: RigDescription, folder: str | Path, *, without: str = "") -> RigDescription:
    """A rig with the values of its `calibration.files`, which lie in `folder` unless their paths are whole.

    A later file that changes a number takes with it what an earlier one knew of its uncertainty.
    Files of the kind `without` are passed over: those that are about to be made again.

    Raises
    ------
    ConfigError
        A file is missing or wrong; or it is out of date or of another rig, and `calibration.when_unfit` is "refuse".
    """
    use = description.calibration
    today = datetime.date.today()
    remarks, out = [], description
    known: list[Calibrated] = []
    as_filed = description.model_dump(mode="python", exclude_none=True)
    replaced: TomlTable = {}
    for name in use.files:
        path = Path(folder) / name
        try:
            calibration = read_calibration(path)
        except ConfigError as error:
            error.args = (f"calibration.files of the rig file: {error}",)
            raise
        if calibration.kind == without:
            continue
        why = calibration.unfit(description, today)
        if why and use.when_unfit == "refuse":
            raise ConfigError(f'{path}: {why}; calibrate again, or set calibration.when_unfit = "warn" in the rig file')
        remarks += [f"{path.name} {why}"] * bool(why)
        if wrong := [table for table in calibration.values if table not in TABLES]:
            raise ConfigError(f"{path}: values.{wrong[0]}: a calibration gives values for {', '.join(TABLES)} alone")
        before = _numbers(out) if known else {}
        out = with_keys(out, _beside(calibration.values, path), path)
        if identity(out) != identity(description):
            raise ConfigError(
                f"{path}: [values] make another rig of it: no calibration changes axes, encoder_step_deg, the camera's "
                f"{', '.join(FIXED['camera'])}, or reference.how"
            )
        known = [_still_of(earlier, before, _numbers(out)) for earlier in known]
        replaced = laid_over(replaced, _where(calibration.values, as_filed))
        known.append(
            Calibrated(
                **calibration.uncertainty.model_dump(),
                kind=calibration.kind,
                file=path.name,
                sha256=hashlib.sha256(read_file(path)).hexdigest(),
                made=calibration.made,
                valid_until=calibration.valid_until,
            )
        )
    use = use.model_copy(update={"known": tuple(known), "replaced": replaced, "remarks": tuple(remarks)})
    return out.model_copy(update={"calibration": use})


def _beside(values: TomlTable, path: Path) -> TomlTable:
    """Values whose file of maps lies beside the calibration file that names it."""
    camera = values.get("camera")
    if not isinstance(camera, dict) or not isinstance(camera.get("maps"), str):
        return values
    return values | {"camera": camera | {"maps": str((path.parent / camera["maps"]).absolute())}}


def _still_of(known: Calibrated, before: dict[str, float], after: dict[str, float]) -> Calibrated:
    """What a calibration knows of the numbers that a later one left as they were."""
    kept = [k for k, name in enumerate(known.parameters) if name in after and after[name] == before.get(name)]
    if len(kept) == len(known.parameters):
        return known
    return known.model_copy(
        update={
            "parameters": [known.parameters[k] for k in kept],
            "u": [known.u[k] for k in kept],
            "correlation": [[known.correlation[j][k] for k in kept] for j in kept],
        }
    )


def _numbers(description: RigDescription) -> dict[str, float]:
    return numbers_in(description.model_dump(mode="json", exclude={"calibration"}))


def uncalibrated(description: RigDescription) -> RigDescription:
    """The rig as its own file has it, without the values of calibrations."""
    return with_keys(description, description.calibration.replaced, "rig file")


def covariance_of(description: RigDescription, names: Sequence[str]) -> Floats:
    """The covariance that the rig's calibrations know of some numbers of its file.

    Parameters
    ----------
    description
        A rig with calibrations (`with_calibrations`), or of a run.
    names
        Paths of numbers, as `arms.light.zero_offset_deg` or `camera.nonlinearity[0]`, each once.

    Returns
    -------
    numpy.ndarray
        Shape (n, n), in the units of the file. Rows and columns of numbers that no calibration is uncertain of are 0.
        Where several files know a number, the last one does; files are independent of each other.
    """
    out = np.zeros((len(names), len(names)))
    place = {name: k for k, name in enumerate(names)}
    if len(place) < len(names):
        raise ArgumentError("names: a number is named twice")
    taken: set[str] = set()
    for known in reversed(description.calibration.known):
        its = [k for k, name in enumerate(known.parameters) if name in place and name not in taken]
        at, u = [place[known.parameters[k]] for k in its], np.array(known.u)[its]
        correlation = np.array(known.correlation).reshape(2 * (len(known.u),))
        out[np.ix_(at, at)] = correlation[np.ix_(its, its)] * np.outer(u, u)
        taken |= set(known.parameters)
    return out


def known_parameters(description: RigDescription) -> list[str]:
    """The numbers that the rig's calibrations give an uncertainty for, each once."""
    return list(dict.fromkeys(name for known in description.calibration.known for name in known.parameters))


def _where(values: TomlTable, tables: TomlTable) -> TomlTable:
    """The part of nested tables that values are given for."""
    return {
        key: _where(value, tables[key]) if isinstance(value, dict) and isinstance(tables[key], dict) else tables[key]
        for key, value in values.items()
        if tables.get(key) is not None
    }
