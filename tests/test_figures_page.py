"""docs/figures.md: the tool that writes what the commands found, and the counts over its tables."""

import json
import re
from pathlib import Path

import pytest

from tests.places import ROOT
from tests.test_site import tool

TOOL = tool("figures_page")
PAGE = (ROOT / "docs" / "figures.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("part", ["drawn", "pictures"])
def test_counts_are_those_of_the_table(part: str) -> None:
    """Whoever changes a row by hand, or forgets one, is found."""
    text = re.search(rf"<!-- {part} -->\n(.*?)\n<!-- end -->", PAGE, re.DOTALL)
    assert text is not None
    counts = re.match(r"Of (\d+) claims (\d+) hold, (\d+) do(?:es)? not, and (\d+) gets? no verdict\.", text[1])
    assert counts is not None
    total, hold, fail, open_ = map(int, counts.groups())
    assert total == hold + fail + open_
    assert (text[1].count(": *does not hold* |"), text[1].count(": *no verdict* |")) == (fail, open_)


def test_the_tool_writes_what_a_folder_says(tmp_path: Path) -> None:
    claims = [
        {"claim": "A | B.", "verdict": "does not hold", "found": "word " * 60},
        {"claim": "C.", "verdict": "holds", "found": "1"},
    ]
    said = {"figures": [{"figure": "htsg-7", "claims": claims}]}
    (tmp_path / "summary.json").write_text(json.dumps(said), encoding="utf-8")
    words = TOOL.words(TOOL.judged(tmp_path))
    head, _, _, _, row = words.splitlines()
    assert head == "Of 2 claims 1 hold, 1 does not, and 0 get no verdict."
    assert row.startswith(r"| htsg-7 | A \| B.: *does not hold* | word word")
    assert row.endswith("word … |")
    page = TOOL.written("a\n<!-- drawn -->\nold\n<!-- end -->\nb\n", {"drawn": words})
    assert page == f"a\n<!-- drawn -->\n{words}\n<!-- end -->\nb\n"
    with pytest.raises(ValueError, match="pictures"):
        TOOL.written(page, {"pictures": words})
