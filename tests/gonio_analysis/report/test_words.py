"""Pages and terminal speak in words of optics and statistics textbooks, or explain a term at a touch."""

import ast
import html
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from gonio_analysis.report import make
from gonio_analysis.report.blocks import Span, Text, facts, spans, table, term
from gonio_analysis.report.terms import MEANINGS
from gonio_analysis.report.text import CAUSES, cause

from gonio import measurement
from gonio.models import build
from tests.gonio_analysis.synthetic import measure
from tests.places import ROOT

PACKAGES = ("gonio", "drivers", "sim", "analysis")
JARGON = {
    r"misfit,? tau|(?<!/)\btau,? (is|of|rel)|(their|its|the) tau\b": "misfit",
    r"held[- ]?out": "left out; prediction error",
    r"\bwhiten": "residual / u; in units of the uncertainty",
    r"\bcoarse steps": "lobe between points",
    r"zeros even": "axis zeros, second order",
    r"\bwander": "lamp instability",
    r"\bswung\b": "turned about the mirror direction",
    r"\bpulls?\b(?!-)": "normalised error",
    r"\bchooser": "sampler",
    r"filling over|filling under": "beam larger, smaller than the region of interest",
    r"energy-true": "that conserves energy",
    r"\bngan (metric|cos|diff)": "cosine-weighted difference",
    r"\b(no|one|a|the|last|first|[0-9]+|of) visits?\b|visits? (to|of|on|lie|since|cannot)\b": "measurement",
    r"within 0(°| deg)": "in the plane",
}
"""Words that a reader would have to learn from us, and what is said in their place."""
SPOKEN = re.compile("|".join(JARGON), re.IGNORECASE)


def literals(path: Path) -> Iterator[tuple[int, str]]:
    """Texts of a module that may be shown: no docstrings, no keys, no first words of a term."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    unseen: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr):
            unseen.add(id(node.value))
        elif isinstance(node, ast.Dict):
            unseen.update(id(key) for key in node.keys)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "term":
            unseen.update(id(one) for one in node.args)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in unseen:
            yield node.lineno, node.value


@pytest.mark.parametrize("package", PACKAGES)
def test_no_text_of_a_program_is_jargon(package: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text[:80]!r}"
        for path in sorted((ROOT / package).rglob("*.py"))
        for line, text in literals(path)
        if " " in text.strip() and SPOKEN.search(text)
    ]
    pages = [path for kind in ("html", "jinja") for path in (ROOT / package).rglob(f"*.{kind}")]
    found += [str(path) for path in pages if SPOKEN.search(path.read_text(encoding="utf-8"))]
    assert not found, "\n".join(found)


def test_what_is_jargon_is_found(tmp_path: Path) -> None:
    text = '"""held out"""\nsay("values held out, models")\nterm("pull", "x")\n{"whiten it": 1}\n'
    (tmp_path / "a.py").write_text(text, encoding="utf-8")
    assert [line for line, text in literals(tmp_path / "a.py") if SPOKEN.search(text)] == [2]


def test_causes_are_shown_under_names_without_jargon() -> None:
    for name in (*CAUSES, *(f"{name} 2" for name in CAUSES)):
        assert not SPOKEN.search(cause(name)), name
        assert cause(name) != "visits"


def test_names_that_are_explained_everywhere_are_explained_in_every_table_and_list() -> None:
    made = table("", ["model", "reduced χ²", term("d", "own")], [["a", "1.0", "2"]])
    assert [one.meaning for one in map(first_span, made.header)] == ["", MEANINGS["reduced χ²"], "own"]
    (name, _), (other, _) = facts([("seed", "1"), ("rig", "sim")]).rows
    assert (first_span(name).meaning, first_span(other).meaning) == (MEANINGS["seed"], "")
    assert not [text for text in MEANINGS.values() if SPOKEN.search(text) or not text.endswith(".")]


def first_span(text: Text) -> Span:
    return spans(text)[0]


def test_a_page_says_no_jargon_and_explains_each_cause_at_a_touch(tmp_path: Path) -> None:
    sample = measure(
        build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30}), noise=0.01, reference=0.005, name="gloss"
    )
    for name in ("s_lamp_wander_1", "s_dark_2", "s_prnu_1", "s_theta_i_zero"):
        sample[name] = 0.001 * sample["brdf"]
    measurement.write(sample, tmp_path / "gloss.csv")
    make([str(tmp_path / "gloss.csv")], tmp_path / "out", models=["lambert", "phong"])
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    explained = dict(re.findall(r'class="term[^"]*"[^>]*title="([^"]+)">([^<]+)<', page))
    shown = set(explained.values())
    assert {
        "lamp instability 1",
        "dark frames 2",
        "pixel responsivities 1",
        "θi zero",
        "reference",
        "exponent",
    } <= shown
    assert {"cosine-weighted difference", "residual / u", "prediction error", "95 % interval", "value ± u"} <= shown
    plain = re.sub(r"(?s)<(script|style)\b.*?</\1>|<[^>]+>", "\n", re.sub(r' title="[^"]*"', "", page))
    found = [html.unescape(line) for line in plain.splitlines() if SPOKEN.search(line)]
    assert not found, found
    assert not re.search(r"\n(visits|tau|lamp wander \d|dark \d)\n", plain)
