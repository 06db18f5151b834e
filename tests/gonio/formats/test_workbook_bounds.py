"""A small workbook of very many cells takes no more memory than stated, and is refused by name."""

import io
import subprocess
import sys
import zipfile
from pathlib import Path

import openpyxl
import pytest

CELL = "<c><v>1</v></c>"
MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
SHEETS = {
    "elements": "<row>" + "<c/>" * 20_000_000 + "</row>",
    "cells in a row": "<row>" + "<c/>" * 2_000_000 + "</row>",
    "places": f"<row>{CELL * 16000}</row>" + f"<row>{CELL}</row>" * 100_000,
}
CHILD = """
import sys
from pathlib import Path
from gonio.errors import DataError
from gonio.formats import workbook
def peak():
    return next(int(l.split()[1]) for l in open("/proc/self/status") if l.startswith("VmHWM")) / 1024
data, start = Path(sys.argv[1]).read_bytes(), peak()
try:
    workbook.as_csv(data, Path("b.xlsx"), lambda names: "a" in names)
except DataError as error:
    print(f"{peak() - start:.0f} {error}")
"""
LIMIT_MIB = 400
"""The text of one part may take 128 MiB, twice while it is read, and a million cells some 100 bytes each."""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of a process is read there")
@pytest.mark.parametrize("what", SHEETS)
def test_many_cells_in_a_small_workbook_are_refused_in_little_memory(tmp_path: Path, what: str) -> None:
    made = io.BytesIO()
    plain = io.BytesIO()
    openpyxl.Workbook().save(plain)
    with zipfile.ZipFile(plain) as source, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in source.namelist():
            text = f'<worksheet xmlns="{MAIN}"><sheetData>{SHEETS[what]}</sheetData></worksheet>'
            archive.writestr(name, text if name.endswith("sheet1.xml") else source.read(name))
    (tmp_path / "b.xlsx").write_bytes(made.getvalue())
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(tmp_path / "b.xlsx")], capture_output=True, text=True, check=True
    )
    mib, _, said = done.stdout.partition(" ")
    assert what in said
    assert float(mib) < LIMIT_MIB
