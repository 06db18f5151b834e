"""The set-up guide: every message of its table occurs in the code, every picture is there, every command exists."""

import ast
import re
from functools import cache

import pytest

from tests.places import ROOT

GUIDE = ROOT / "docs" / "lab_setup.md"
GAP = "\0"
"""What stands for a value that a message is filled with."""


@cache
def said() -> str:
    """Every string of drivers and core, with gaps where values are filled in."""
    out = []
    for folder in ("gonio", "drivers"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.JoinedStr):
                    out.append("".join(p.value if isinstance(p, ast.Constant) else GAP for p in node.values))  # type: ignore[misc]
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    out.append(node.value)
    return "\n".join(out)


def messages() -> list[str]:
    table = GUIDE.read_text().split("## What messages mean")[1].split("\n## ")[0]
    rows = [line for line in table.splitlines() if line.startswith("|")][2:]
    return [row.split("|")[1].strip() for row in rows]


@pytest.mark.parametrize("message", messages())
def test_a_message_of_the_table_is_one_that_the_code_says(message: str) -> None:
    message = re.sub(r"\(.*?\)", "", message)
    for part in re.split(r"\.\.\.|, | / |: ", message):
        words = re.sub(r"^id \d+$|\d+|a xm\S+", "", part).strip()
        assert words in said(), f'"{words}" of the table is said nowhere'


def test_the_pictures_of_the_guide_are_there_and_small() -> None:
    names = re.findall(r"!\[.+?\]\((.+?)\)", GUIDE.read_text())
    assert len(names) >= 7
    assert all((GUIDE.parent / name).stat().st_size < 150_000 for name in names)
