"""Names are data: a page, its figures and its files hold every name, whatever stands in it.

The kind: names that mean something to HTML, to matplotlib, to a file system, or that lead to the same file.
"""

import json
import re
from html import unescape
from pathlib import Path

import pandas as pd
import pytest
from gonio_analysis.report.text import model_slugs, slug, slugs

from gonio import measurement
from tests.command_line import gonio
from tests.gonio.formats.test_names import one, several
from tests.names import PUNCTUATION, SCRIPTS


def test_each_name_has_files_of_its_own() -> None:
    names = ["a-2", "a", "a", "a-3", "A", "a-all", "conventions", "Provenance", "x" * 300, "x" * 301, "..", "/", "塗料"]
    found = slugs(names)
    assert len(set(found)) == len(names)
    assert all(re.fullmatch(r"[a-z0-9-]{1,90}", one) for one in found)
    assert not {"conventions", "provenance", "a-all"} & set(found)
    assert slugs(["tame", "Two words"]) == ["tame", "two-words"]
    assert slug("../../etc") == "etc"
    alike = ["oren-nayar+blinn", "oren-nayar, blinn", "oren nayar blinn", "oren-nayar-blinn-2", "+", "++"]
    names = [*SCRIPTS.values(), *alike]
    assert model_slugs(names)["oren-nayar+blinn"] == "oren-nayar-blinn"
    assert len(set(model_slugs(names).values())) == len(names)  # a file, and so a figure, of its own each


def test_a_report_holds_every_name(tmp_path: Path) -> None:
    names = ["p$\\bad$q", "塗料" + PUNCTUATION, "_</script><b>", *list(SCRIPTS.values())[7:9]]
    measurement.write(several(*names), tmp_path / "a.csv")
    gonio(tmp_path, "compare", "a.csv", "--models", "lambert", "--out", "out", expect=0)
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert all(name in unescape(page) for name in names)
    assert "<b></" not in page
    assert [d["name"] for d in json.loads((tmp_path / "out" / "summary.json").read_text())["datasets"]] == names
    assert pd.read_csv(tmp_path / "out" / "tables" / "metrics.csv")["sample"].tolist() == names


@pytest.mark.slow
def test_laboratories_are_drawn_by_their_names(tmp_path: Path) -> None:
    files = ["p$\\bad$q", "_塗料", "c$x$"]
    for k, name in enumerate(files):
        measurement.write(one(name, 0.3 + 0.001 * k), tmp_path / f"{name}.csv")
    gonio(tmp_path, "compare", "--laboratories", *(f"{name}.csv" for name in files), "--out", "out", expect=0)
    drawn = "".join(path.read_text(encoding="utf-8") for path in (tmp_path / "out" / "figures").glob("*.svg"))
    assert all(f">{name}<" in drawn for name in files)
