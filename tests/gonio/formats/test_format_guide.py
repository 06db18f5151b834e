"""The format of docs/examples/bench_format.py as a package of somebody else, installed as docs/formats.md says."""

import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import formats, measurement
from gonio.errors import ConfigError, DataError
from gonio.formats.reader import ANGLES
from tests.command_line import gonio
from tests.places import ROOT, example, fenced

COLUMNS = [*ANGLES, "wavelength_nm", "brdf"]
LINE = "# bench 1\n10 0 20 0 550 1\n"


def install(site: Path, package: str, module: str, points: dict[str, str]) -> None:
    """A package of one module, with entry points of formats."""
    info = site / f"{package}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = "".join(f"{name} = {value}\n" for name, value in points.items())
    (info / "entry_points.txt").write_text(f"[gonio.formats]\n{lines}")
    (site / f"{package.replace('-', '_')}.py").write_text(module)


@pytest.fixture(autouse=True)
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of packages with the guide's, on the search path."""
    project = tomllib.loads(fenced(ROOT / "docs" / "formats.md", "toml", "bench-format"))["project"]
    install(tmp_path / "site", project["name"], example("bench_format.py"), project["entry-points"]["gonio.formats"])
    monkeypatch.syspath_prepend(tmp_path / "site")
    yield tmp_path / "site"
    formats._every.cache_clear()  # the next test's packages have these names, too
    formats._loaded.cache_clear()
    for module in (tmp_path / "site").glob("*.py"):
        sys.modules.pop(module.stem, None)


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


def test_convert_reads_and_writes_it(tmp_path: Path) -> None:
    (tmp_path / "tile.bench").write_text(LINE)
    gonio(tmp_path, "convert", "tile.bench", "tile.csv", expect=0)
    gonio(tmp_path, "convert", "tile.csv", "again", "--to", "bench", expect=0)
    assert (tmp_path / "again").read_text() == "# bench 1\n10.0 0.0 20.0 0.0 550.0 1.0\n"
    done = gonio(tmp_path, "convert", "tile.csv", "again", "--to", "bensh", expect=2)
    assert "did you mean bench?" in done.stderr


def test_what_cannot_be_loaded_is_named_and_takes_nothing_along(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(
        site,
        "broken",
        "import no_such_package\n",
        {"away": "broken:FORMAT", "other": "bench_format:FORMAT", "text": "bench_format:HEAD", "astm": "broken:X"},
    )
    monkeypatch.syspath_prepend(site)  # its packages are looked for anew
    said = {
        "away": ('"away" (broken:FORMAT) cannot be loaded', "no_such_package"),
        "other": ('"other" (bench_format:FORMAT)', 'calls itself "bench"'),
        "text": ('"text" (bench_format:HEAD)', "is no gonio.formats.reader.Format"),
        "astm": ('"astm" (broken:X) of broken is passed over', "gonio has brought that name"),
    }
    (tmp_path / "tile.bench").write_text(LINE)
    done = gonio(tmp_path, "convert", "tile.bench", "tile.csv", expect=0)
    for words in said.values():
        (line,) = (one for one in done.stderr.splitlines() if words[0] in one)
        assert words[1] in line
    for name in ("away", "other", "text"):
        done = gonio(tmp_path, "convert", "tile.bench", "b.csv", "--from", name, expect=2)
        assert done.stderr.count(said[name][1]) == 2  # once as left out, once as asked for
    assert formats.named("astm").read.__module__ == "gonio.formats.astm"
    (tmp_path / "what.xyz").write_text("no table\n")
    with pytest.raises(DataError, match="no_such_package"):
        measurement.read(tmp_path / "what.xyz")


FAULTY = """
from dataclasses import replace
import bench_format
FORMAT = replace(bench_format.FORMAT, name="faulty", endings=(".f",), {}=lambda *_: dict()["key"])
"""


def _used(does: str, small: pd.DataFrame, path: Path) -> None:
    if does == "write":
        measurement.write(small, path)
    else:
        measurement.read(path, format="faulty" if does == "read" else None)


@pytest.mark.parametrize("does", ["sniff", "read", "write"])
def test_a_fault_of_its_code_is_its_own(
    does: str, site: Path, tmp_path: Path, small: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(site, "faulty", FAULTY.format(does), {"faulty": "faulty:FORMAT"})
    monkeypatch.syspath_prepend(site)
    (tmp_path / "tile.bench").write_text(LINE)
    (tmp_path / "tile.f").write_text("none\n")
    why = rf"the format \"faulty\" \(faulty:FORMAT\): {does} has failed \(KeyError: 'key'"
    with pytest.raises(DataError, match=why):
        _used(does, small, tmp_path / "tile.f")
    if does == "sniff":  # what others tell is read
        assert measurement.read(tmp_path / "tile.bench").attrs["format"] == "bench"


def test_a_file_that_only_ends_as_two_formats_do_is_not_guessed(tmp_path: Path) -> None:
    (tmp_path / "a.bsdf").write_text("1 2 3\n")
    with pytest.raises(DataError, match=r"--from rgl\) or .*--from zemax"):
        measurement.read(tmp_path / "a.bsdf")


def test_one_format_is_loaded_where_one_is_named() -> None:
    formats._loaded.cache_clear()
    formats.named("bench")
    assert formats._loaded.cache_info().currsize == 1
    with pytest.raises(ConfigError, match="known: alta"):
        formats.named("zzzz")
