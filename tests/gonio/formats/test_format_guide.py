"""The format of docs/examples/bench_format.py, as it stands there: one module, and its name in the list."""

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from gonio import formats, measurement
from gonio.errors import DataError
from gonio.formats.reader import ANGLES
from tests.places import example

COLUMNS = [*ANGLES, "wavelength_nm", "brdf"]


@pytest.fixture(autouse=True)
def listed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    module = ModuleType("gonio.formats.bench")
    exec(example("bench_format.py"), module.__dict__)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(formats, "_MODULES", (*formats._MODULES, "bench"))
    formats.all_formats.cache_clear()
    yield
    formats.all_formats.cache_clear()


def test_what_is_written_reads_back_bit_by_bit(small: pd.DataFrame, tmp_path: Path) -> None:
    small.loc[5, "brdf"], small.loc[5, "flag"] = np.nan, "not_measured"
    said = measurement.write(small, tmp_path / "tile.bench")
    again = measurement.read(tmp_path / "tile.bench")
    kept = small[small["flag"] == ""]
    assert len(kept) == len(small) - 2
    assert any("2 flagged rows" in sentence for sentence in said)
    np.testing.assert_array_equal(again[COLUMNS].to_numpy(), kept[COLUMNS].to_numpy())
    assert again.attrs["format"] == "bench"


@pytest.mark.parametrize(("line", "why"), [("10 0 20", "3 numbers"), ("10 0 20 x 550 1", "line 3"), ("", "no values")])
def test_a_damaged_file_is_refused_with_its_line(tmp_path: Path, line: str, why: str) -> None:
    good = "" if why == "no values" else "10 0 20 0 550 1"
    (tmp_path / "tile.bench").write_text(f"# bench 1\n{good}\n{line}\n")
    with pytest.raises(DataError, match=why):
        measurement.read(tmp_path / "tile.bench")
