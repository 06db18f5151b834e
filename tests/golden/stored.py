"""The golden files: one archive a case, of texts without times, versions and folders."""

import io
import zipfile
from pathlib import Path

from gonio_validation.bench.timing import machine
from llvmlite.binding import get_host_cpu_name

from tests.golden.cases import CASES, help_of_all
from tests.golden.comparison import same_for_all

FOLDER = Path(__file__).parent / "data"
MADE_ON = FOLDER / "processor.txt"
ACROSS = 1e-4
"""Tolerance on another kind of processor than that of the set: ends of optimisers move. The largest that was seen is
3e-7 in tables (derivatives of lobes), 1.5e-6 in fits (standard errors of a rejected model), and 5.8e-5 in a photograph
(a standard error there, by differences of rendered pictures; the tree that made the set gives the same on a processor
with AVX-512)."""
EPOCH = (2026, 1, 1, 0, 0, 0)
"""Of every file in an archive: an archive of the same texts is the same file."""


def carried_out(name: str, folder: Path) -> dict[str, str]:
    """What a case gives now: text by file."""
    return {"help.txt": help_of_all()} if name == "help" else CASES[name].carried_out(folder)


def processor() -> str:
    """The kind of this computer's processor, as LLVM tells them apart: one maker's name stands for several."""
    found = machine()
    return " ".join([found["cpu"], get_host_cpu_name(), *found["flags"]])


def tolerance(name: str) -> float:
    """Of the numbers of a case, on this processor."""
    own = CASES[name].tolerance if name in CASES else 0.0
    same = MADE_ON.exists() and MADE_ON.read_text(encoding="utf-8").strip() == processor()
    return own if same or name == "help" else max(own, ACROSS)


def read(name: str) -> dict[str, str]:
    """What it gave when the set was made; nothing where it never was."""
    path = FOLDER / f"{name}.zip"
    if not path.exists():
        return {}
    with zipfile.ZipFile(path) as archive:
        return {file: archive.read(file).decode() for file in archive.namelist()}


def write(name: str, texts: dict[str, str]) -> None:
    """Keep what a case gives."""
    FOLDER.mkdir(exist_ok=True)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for file, text in sorted(texts.items()):
            archive.writestr(zipfile.ZipInfo(file, EPOCH), same_for_all(text), zipfile.ZIP_DEFLATED)
    (FOLDER / f"{name}.zip").write_bytes(out.getvalue())
