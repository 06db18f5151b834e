"""A quantity has one value on a page: every number of every table and sentence is read, as a stranger reads it."""

import re
from collections import defaultdict
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from gonio_analysis.report import make

from gonio import measurement
from gonio.models import build
from tests.gonio_analysis.synthetic import joined, measure

GOLD = {450.0: 1.45, 650.0: 0.17}
"""Wavelength [nm]: an index that differs from band to band, as a metal's does."""


class Tables(HTMLParser):
    """Header and rows of every table of a page, and the words outside of them."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.words: list[str] = []
        self._cell = self._skipped = False
        self.feed(re.sub(r"(?s)<(script|style|svg)\b.*?</\1>", "", text))

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
            self._cell = True

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th"):
            self._cell = False

    def handle_data(self, data: str) -> None:
        data = data.replace("\u00a0", " ")
        if self._cell:
            self.tables[-1][-1][-1] += data.strip()
        else:
            self.words.append(data)


def stated(text: str) -> dict[tuple[str, str], set[str]]:
    """What a page says of each quantity: (of what, which) -> the values, as they are printed."""
    page, found = Tables(text), defaultdict[tuple[str, str], set[str]](set)
    for header, *rows in page.tables:
        for row in rows:
            by = dict(zip(header, row, strict=False))
            if "parameter" in by:
                model = by.get("model", "the chosen model")
                found[model, by["parameter"]].add(by["value ± u"])
                continue
            for column, cell in by.items():
                if column == "fitted parameters":
                    for name, value in re.findall(r"(\w+) = ([^,;(]+)", cell):
                        found[by["model"], name].add(value.strip())
                elif re.search(r"\d", cell) and column not in (header[0], "why", "what it is"):
                    found[" ".join([row[0], by.get("model", "")]), column].add(cell)
    return found


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Of one wavelength and of two that share a geometry, of a true and of a foreign sample, alone and together."""
    folder = tmp_path_factory.mktemp("agree")
    rough = [build("cook-torrance", {"s": 0.3, "m": 0.25, "diffuse_albedo": 0.1, "ior": n}) for n in GOLD.values()]
    both = joined(*(measure(m, noise=0.01, wavelength_nm=nm) for m, nm in zip(rough, GOLD, strict=True)))
    tables = {"two": both, "one": measure(build("phong", {"k_d": 0.3, "k_s": 0.4, "exponent": 40.0}), noise=0.01)}
    out = {}
    for name, table in tables.items():
        measurement.write(table, folder / f"{name}.csv")
    for specs in (["two"], ["one"], ["two", "one"]):
        names = [str(folder / f"{name}.csv") for name in specs]
        make(names, folder / "-".join(specs), models=["lambert", "cook-torrance"])
        out["-".join(specs)] = (folder / "-".join(specs) / "index.html").read_text(encoding="utf-8")
    return out


@pytest.mark.slow
@pytest.mark.parametrize("which", ["two", "one", "two-one"])
def test_no_quantity_has_two_values(pages: dict[str, str], which: str) -> None:
    found = stated(pages[which])
    assert len(found) > 20
    if which == "two-one":  # a model has values of two samples, and each table says of which
        assert max(map(len, found.values())) <= 2
        return
    assert {key: values for key, values in found.items() if len(values) > 1} == {}


@pytest.mark.slow
@pytest.mark.parametrize("which", ["two", "one"])
def test_the_verdict_has_the_numbers_of_the_table(pages: dict[str, str], which: str) -> None:
    """Chi-square stands in sentences and in one table."""
    text = " ".join(Tables(pages[which]).words)
    said = set(re.findall(r"reduced (?:χ²|chi-square) ([\d.]+\d)", text))
    numbers = [float(v) for (_, column), values in stated(pages[which]).items() if "χ²" in column for v in values
               if re.fullmatch(r"[\d.]+", v)]  # fmt: skip
    assert numbers
    for one in said:  # three digits in a sentence
        assert np.isclose(numbers, float(one), rtol=5e-3).any(), one


@pytest.mark.slow
def test_of_several_samples_the_first_table_says_what_each_verdict_says(pages: dict[str, str]) -> None:
    """It said 8.0 % where the sample's verdict said 7.9 %: a root mean square of logarithms beside a misfit."""
    text = " ".join(Tables(pages["two-one"]).words)
    said = re.findall(r"(?:describes this sample to|misses this sample by) ([^()]+ \([^()]+\))", text)
    assert said
    assert set(said) <= {cell for row in Tables(pages["two-one"]).tables[0] for cell in row}


def test_two_values_are_seen(tmp_path: Path) -> None:
    page = (
        "<table><tr><th>parameter</th><th>value ± u</th></tr><tr><th>m</th><td>0.25010 ± 0.00081</td></tr></table>"
        "<table><tr><th>parameter</th><th>value ± u</th></tr><tr><th>m</th><td>0.24999 ± 0.00038</td></tr></table>"
    )
    assert len(stated(page)["the chosen model", "m"]) == 2
