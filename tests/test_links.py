"""Pages read well on a code host, too: links lead to files and headings that are there, tables have their heads."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.places import ROOT

PAGES = sorted(
    [ROOT / "README.md", *(page for name in ("docs", "tools", "tests") for page in (ROOT / name).rglob("*.md"))]
)
LINK = re.compile(r"\]\(([^)\s]+)(?: \"[^\"]*\")?\)")
HEADING = re.compile(r"(?m)^#{1,6} (.+)$")
FENCED = re.compile(r"(?ms)^ *```.*?^ *```")


def prose(page: Path) -> str:
    return FENCED.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> Iterator[str]:
    """What a code host makes of headings: small letters, no punctuation, a hyphen for each blank; a number if again."""
    seen: dict[str, int] = {}
    for heading in HEADING.findall(prose(page)):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading.replace("\\", ""))
        plain = re.sub(r"[^\w\- ]", "", words.strip().lower()).replace(" ", "-")
        count = seen[plain] = seen.get(plain, -1) + 1
        yield f"{plain}-{count}" if count else plain


def dead(page: Path) -> Iterator[str]:
    """Links of a page within the repository that lead to no file, or to no heading of a page.

    Of a name of the code (`reference/rig.md#gonio.lab.rig.Rig`) the page has to show the module; where the name stands
    there the site alone knows.
    """
    for link in LINK.findall(prose(page)):
        path, _, anchor = link.partition("#")
        if re.match(r"[a-z]+:", link):
            continue
        target = (page.parent / path).resolve() if path else page
        if not target.exists():
            yield link
        elif anchor and "." in anchor:
            shown = re.findall(r"(?m)^::: (\S+)", target.read_text(encoding="utf-8"))
            if not any(f"{anchor}.".startswith(f"{name}.") for name in shown):
                yield link
        elif anchor and anchor not in set(anchors(target)):
            yield link


def headless(page: Path) -> Iterator[str]:
    """Rows of hyphens that are not the second row of their table."""
    lines = prose(page).split("\n")
    for index, row in enumerate(lines[2:]):
        if re.match(r"\|(?:-+\|)+$", row) and lines[index].startswith("|"):
            yield row


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_what_is_there(page: Path) -> None:
    assert not list(dead(page))
    assert not list(headless(page))


def test_a_dead_link_is_found(tmp_path: Path) -> None:
    (tmp_path / "b.md").write_text(
        "# One, `two` & three\n\n## Again\n\n## Again\n\n```\n# none\n```\n::: pack.module\n"
    )
    a = tmp_path / "a.md"
    good = ["b.md", "b.md#one-two--three", "b.md#again-1", "b.md#pack.module.Name", "https://example.org/x", "#a"]
    wrong = ["c.md", "b.md#none", "b.md#again-2", "b.md#pack.other", "#b"]
    a.write_text("# a\n\n" + "".join(f"[x]({link})\n" for link in good + wrong) + '![p](p.png "p")\n')
    assert list(dead(a)) == [*wrong, "p.png"]


def test_a_row_of_hyphens_within_a_table_is_found(tmp_path: Path) -> None:
    page = tmp_path / "a.md"
    page.write_text("| a | b |\n|---|---|\n| 1 | 2 |\n\n| c |\n|---|\n| 3 |\n")
    assert not list(headless(page))
    page.write_text("| a | b |\n|---|---|\n| 1 | 2 |\n| c | d |\n|---|---|\n| 3 | 4 |\n")
    assert list(headless(page)) == ["|---|---|"]
