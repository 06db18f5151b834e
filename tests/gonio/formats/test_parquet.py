"""What a Parquet file says of its columns: units are obeyed, types that are no numbers refused, sizes bounded."""

import datetime
import decimal
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio import measurement
from gonio.errors import DataError
from gonio.formats import parquet

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")

ANGLES = ("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg")


def columns(**others: Any) -> dict[str, Any]:
    angles = dict(zip(ANGLES, ([30.0, 30.0], [0.0, 0.0], [20.0, 90.0], [180.0, 180.0]), strict=True))
    return {name: pa.array(values) for name, values in angles.items()} | {"brdf": pa.array([0.1, 0.2])} | others


def written(path: Path, made: dict[str, Any], units: dict[str, str] | None = None, **metadata: str) -> Path:
    fields = [
        pa.field(name, one.type, metadata={"units": units[name]} if units and name in units else None)
        for name, one in made.items()
    ]
    schema = pa.schema(fields, metadata=metadata or None)
    pq.write_table(pa.table(list(made.values()), schema=schema), path)
    return path


RADIANS = {"theta_r_deg": pa.array([math.radians(20.0), math.pi / 2])}


@pytest.mark.parametrize("where", ["field", "attrs"])
def test_units_of_columns_are_obeyed(tmp_path: Path, where: str) -> None:
    """Kind: a container's own statement about a column, in whichever of its places."""
    made = columns(**RADIANS, wavelength_nm=pa.array([0.55, 0.6]))
    units = {"theta_r_deg": "rad", "wavelength_nm": "um"}
    file = tmp_path / "a.parquet"
    if where == "field":
        written(file, made, units)
    else:
        written(file, made, PANDAS_ATTRS=json.dumps({"units": units}))
    frame = measurement.read(file)
    assert frame["theta_r_deg"].tolist() == [20.0, 90.0]
    np.testing.assert_allclose(frame["wavelength_nm"], [550.0, 600.0], rtol=1e-15)


@pytest.mark.parametrize("unit", ["percent", "W/m2", "\x00"])
def test_units_that_are_none_of_the_column_are_refused(tmp_path: Path, unit: str) -> None:
    with pytest.raises(DataError, match=r"a\.parquet: the column brdf states units = "):
        measurement.read(written(tmp_path / "a.parquet", columns(), {"brdf": unit}))


def test_a_scale_that_a_column_states_is_refused(tmp_path: Path) -> None:
    made = columns()
    fields = [pa.field(n, c.type, metadata={"scale_factor": "0.01"} if n == "brdf" else None) for n, c in made.items()]
    pq.write_table(pa.table(list(made.values()), schema=pa.schema(fields)), tmp_path / "a.parquet")
    with pytest.raises(DataError, match="the column brdf states scale_factor"):
        measurement.read(tmp_path / "a.parquet")


@pytest.mark.parametrize(
    "values",
    [
        pa.array([True, False]),
        pa.array([decimal.Decimal("0.1"), decimal.Decimal("0.2")]),
        pa.array([datetime.datetime(2026, 1, 5), datetime.datetime(2026, 1, 6)]),
        pa.array([[0.1], [0.2]]),
        pa.array([{"re": 0.1, "im": 0.0}] * 2),
        pa.array(["0.1", "0.2"]),
        pa.array([b"a", b"b"]),
        pa.array([None, None]),
    ],
    ids=lambda values: str(values.type)[:20],
)
def test_only_numbers_are_numbers(tmp_path: Path, values: Any) -> None:
    """Kind: a type of a container that looks like a number once it is converted."""
    with pytest.raises(DataError, match=r"a\.parquet: the column brdf holds .*; integers or floating-point numbers"):
        measurement.read(written(tmp_path / "a.parquet", columns(brdf=values)))


def test_a_column_of_words_holds_texts(tmp_path: Path) -> None:
    word = pa.array([datetime.datetime(2026, 1, 5)] * 2)
    with pytest.raises(DataError, match=r"the column sample holds timestamp.*; texts are needed"):
        measurement.read(written(tmp_path / "a.parquet", columns(sample=word)))
    coded = pa.array(["a", "b"]).dictionary_encode()
    frame = measurement.read(written(tmp_path / "b.parquet", columns(sample=coded, brdf=pa.array([1, 2]))))
    assert frame.attrs["samples"] == ["a", "b"]
    assert frame["brdf"].tolist() == [1.0, 2.0]


def test_what_unpacks_to_more_than_its_rows_need_is_refused_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kind: a small file that takes memory: one long text, packed to some hundred bytes."""
    monkeypatch.setattr(parquet, "_MOST_TEXT", 2**16)
    word = pa.array(["x" * 2**20, ""])
    pq.write_table(pa.table(columns(sample=word)), tmp_path / "a.parquet", compression="zstd")
    assert (tmp_path / "a.parquet").stat().st_size < 2**16
    with pytest.raises(DataError, match=r"a\.parquet: row group 0, column sample: unpacks to \d+ bytes"):
        measurement.read(tmp_path / "a.parquet")


def test_no_rows_are_no_table(tmp_path: Path) -> None:
    empty = {name: one[:0] for name, one in columns().items()}
    with pytest.raises(DataError, match=r"a\.parquet: has 0 rows"):
        measurement.read(written(tmp_path / "a.parquet", empty))
