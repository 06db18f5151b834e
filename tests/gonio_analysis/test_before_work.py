"""Kind: arguments that are refused after the work. What a command cannot write to is said before it reads anything."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.command_line import gonio


@pytest.mark.parametrize(
    ("command", "told"),
    [
        (("report", "map.h5"), "map.h5: the report on a map needs a folder: --out DIR"),
        (("convert", "table.csv", "out.xyz"), "out.xyz"),
        (("convert", "table.csv", "file/out.csv"), "file is not a folder"),
        (("appearance", "table.csv", "--out", "file"), "file: is a file; --out names a folder"),
        (("appearance", "table.csv", "--out", "full"), "full: holds what was not written by this version"),
        (("verify", "--out", "file"), "file: is a file; --out names a folder"),
        (("fit", "--each", "tables", "--model", "ggx", "--out", "file/t.csv"), "file is not a folder"),
    ],
)
def test_what_cannot_be_written_is_said_before_anything_is_read(
    tmp_path: Path, command: tuple[str, ...], told: str
) -> None:
    for name in ("file", "map.h5", "table.csv"):  # no map and no table: to read one is an error of its own
        (tmp_path / name).write_text("nothing", encoding="utf-8")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("notes", encoding="utf-8")
    ended = gonio(tmp_path, *command, expect=2)
    assert told in " ".join(ended.stderr.split())
    assert "nothing" not in ended.stderr
