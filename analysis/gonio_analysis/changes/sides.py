"""What a comparison is between: a measurement, or a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gonio import measurement, shown
from gonio.errors import DataError
from gonio.measurement import Reading, is_simulated, of_reader
from gonio.typing import DataFrame
from gonio_analysis.fitting.observations import Observations, observations


@dataclass(frozen=True)
class Side:
    """A measurement, or a model."""

    name: str
    source: str
    table: DataFrame | None = None
    """Columns and attributes of the measurement's table, without its rows: their values are in `data`."""
    data: Observations | None = None
    model: Any = None
    misfit: float = 0.0
    """Where the model is not true: relative standard deviation of measurements from it (docs/misfit.md)."""
    through: Side | None = None
    """The transmission of a table that has both."""
    behind: bool = False
    """Whether `data` is transmission, turned over (`gonio.measurement.turned_over`)."""

    @property
    def kind(self) -> str:
        """In a word: measurement, or model."""
        return "measurement" if self.data is not None else "model"

    @property
    def measured(self) -> Observations:
        """The values of a measurement."""
        assert self.data is not None
        return self.data

    @property
    def simulated(self) -> bool:
        """Whether a simulation made the values of a measurement."""
        return self.table is not None and is_simulated(self.table)

    @property
    def title(self) -> str:
        """The name, with a mark where the values are simulated."""
        return shown.marked(self.name, self.simulated)


@dataclass(frozen=True)
class Compared:
    """What a comparison says of a side; the values that were compared are its own."""

    name: str
    source: str
    kind: str
    title: str
    simulated: bool
    model: Any
    values: int
    """How many a measurement has that can be used."""
    left_out: Mapping[str, int]
    """Why rows of its table are none, and how many."""
    stated: bool
    """Whether it states uncertainties."""
    notes: Sequence[str]
    """What its reader says."""

    @classmethod
    def of(cls, x: Side) -> Compared:
        """Of a side."""
        values, left_out, stated = 0, dict[str, int](), False
        if x.data is not None:
            values, left_out, stated = len(x.data), x.data.left_out, x.data.covariance is not None
        notes = of_reader(x.table) if x.table is not None else ()
        return cls(x.name, x.source, x.kind, x.title, x.simulated, x.model, values, left_out, stated, notes)


def side(spec: str, how: Reading | None = None, u_rel: float | None = None) -> Side:
    """What a command line names: a table, a run, `FILE:SAMPLE`, or a model as a sample file (.toml).

    `u_rel` is the relative standard uncertainty to assume of a table that states none.

    Raises
    ------
    ConfigError, DataError
        From reading it; a file of several samples has to be narrowed to one.
    """
    if spec.endswith(".toml"):
        from gonio.samples.files import load_model

        model, sample = load_model(spec)
        off = 0.0 if sample.uncertainty is None else sample.uncertainty.misfit
        return Side(sample.name, spec, model=model, misfit=off)

    name, table = measurement.of_one(spec, how)
    return of_table(name, spec, table, u_rel)


def of_table(name: str, source: str, table: DataFrame, u_rel: float | None = None) -> Side:
    """A side of a comparison from a measurement table: its reflection, and apart from it its transmission."""

    def of(rows: DataFrame, called: str, **more: Any) -> Side:
        return Side(name, called, rows.iloc[:0].copy(), observations(rows, called, u_rel), **more)

    through = measurement.transmission(table)
    if through is None:
        return of(table, source)
    turned = measurement.turned_over(through)
    if len(through) == len(table):
        return of(turned, source, behind=True)
    behind = None
    if (through["flag"].fillna("") == "").any():
        behind = of(turned, f"{source}, transmission", behind=True)
    return of(measurement.reflection(table), source, through=behind)


def require_alike(a: Side, b: Side) -> None:
    """Transmission is compared with transmission, and with nothing else."""
    if a.behind != b.behind:
        one, other = (a, b) if a.behind else (b, a)
        raise DataError(
            f"{one.source} holds transmission alone, and {other.source} reflection: the two are not the same quantity"
        )
