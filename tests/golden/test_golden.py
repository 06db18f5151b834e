"""Nothing that a user gets has changed since the golden set was made: `python -m tests.golden` shows what has."""

from pathlib import Path

import pytest

from tests.golden.cases import CASES
from tests.golden.comparison import difference
from tests.golden.stored import carried_out, read, tolerance

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", [*CASES, "help"])
def test_a_case_gives_what_it_gave(name: str, tmp_path: Path) -> None:
    golden, now = read(name), carried_out(name, tmp_path)
    assert set(now) == set(golden)
    changed = {file: difference(golden[file], now[file], tolerance(name)) for file in golden}
    assert {file: how for file, how in changed.items() if how} == {}


def test_a_killed_run_gives_the_table_of_a_whole_one() -> None:
    assert read("resumed")["run-brdf.csv"] == read("sim")["run-brdf.csv"]


@pytest.mark.parametrize(
    ("golden", "now", "tolerance", "same"),
    [
        ("a 1.0 b", "a 1.0 b", 0.0, True),
        ("a 1.0000000000000 b", "a 1.0000000000001 b", 1e-12, True),
        ("a 1.000000000 b", "a 1.000000100 b", 1e-9, False),
        ("a 1.0 b", "a 1.0 c", 1.0, False),
        ("one\ntwo", "one", 1.0, False),
        ("made 2026-01-01T10:00:00Z", "made 2026-11-23T10:00:01Z", 0.0, True),
        ('"wall_s": 0.1', '"wall_s": 2e-05', 0.0, True),
        ("0.31", "0.41", 1e-12, False),
        (f"sha {'0' * 64}", f"sha {'1' * 64}", 1e-12, True),
    ],
)
def test_what_counts_as_the_same(golden: str, now: str, tolerance: float, same: bool) -> None:
    assert (difference(golden, now, tolerance) == "") == same
