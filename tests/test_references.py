"""Every citation in the tree leads to an entry of docs/references.bib, and every entry is cited.

Citations are keys ("He1991 eq. 25"), names and a year in prose ("Benjamini and Hochberg (1995)": the first name and the
year make the key), and standards and databases by their names.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.places import ROOT

NAME = r"[A-Z][A-Za-z]*[a-z]"
YEAR = r"(?:1[89]|20)\d\d"
KEY = re.compile(rf"\b({NAME}{YEAR})\b")
PROSE = re.compile(rf"\b({NAME})(?:(?:,? (?:and |& )?|[-–]){NAME}){{0,4}}(?: et al\.)?,? \(?({YEAR})\b(?!-)")
STANDARD = re.compile(r"\b(EMVA|CIE|IEC|ASTM(?= E))(?: Standard)? (E?\d[\d-]*\d)\b")
NAMED = {"MERL": "Matusik2003", "RGL": "Dupuy2018", "BiRD": "BiRD", "CIE1931": "CIE15"}


def citations(text: str) -> Iterator[str]:
    """The keys that a text cites."""
    text = re.sub(r"[\"']\s*\n\s*[rf]?[\"']", "", text)  # a string over several lines
    text = re.sub(r"\s*\n\s*#?\s*", " ", text)
    yield from (match[1] for match in KEY.finditer(text))
    for match in PROSE.finditer(text):
        if "SIGGRAPH" not in match[0]:  # a title, and where it appeared
            yield match[1] + match[2]
    for match in STANDARD.finditer(text):
        yield NAMED.get(match[1] + match[2], match[1] + match[2])
    yield from (key for name, key in NAMED.items() if re.search(rf"\b{name}\b", text))


def entries(text: str) -> list[str]:
    return re.findall(r"(?m)^@\w+\{([^,\s]+),", text)


def files() -> Iterator[Path]:
    """What people read and write: code, docs, shipped TOML; not the changes of the past, nor this file's examples."""
    yield ROOT / "README.md"
    for folder in ("gonio", "drivers", "sim", "analysis", "docs", "tests", "tools"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in {".py", ".md", ".toml"} and path.resolve() != Path(__file__).resolve():
                yield path


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ("He1991 eq. 25 with the factor", ["He1991"]),
        ("as He, Torrance, Sillion and Greenberg (1991) have it", ["He1991"]),
        ('"eq. 11 of He, "\n    f"Torrance, Sillion and Greenberg (1991): the"', ["He1991"]),
        ("(Dupuy & Jakob 2018)", ["Dupuy2018"]),
        ("Ngan et al. 2005, by the EMVA Standard 1288 and CIE 15", ["Ngan2005", "EMVA1288", "CIE15"]),
        ("Blinn, Models of Light Reflection, SIGGRAPH 1977", []),
        ("He–Torrance–Sillion–Greenberg 1991, Oren–Nayar 1994", ["He1991", "Oren1994"]),
    ],
)
def test_citations_are_found(text: str, keys: list[str]) -> None:
    assert list(citations(text)) == keys


def test_every_citation_has_an_entry_and_every_entry_is_cited() -> None:
    text = (ROOT / "docs" / "references.bib").read_text(encoding="utf-8")
    known = entries(text)
    assert len(known) == text.count("\n@")
    assert len(set(known)) == len(known)
    cited: dict[str, list[str]] = {}
    for path in files():
        for key in citations(path.read_text(encoding="utf-8")):
            cited.setdefault(key, []).append(str(path.relative_to(ROOT)))
    unknown = {key: sorted(set(where)) for key, where in cited.items() if key not in known}
    assert not unknown, f"no entry in docs/references.bib: {unknown}"
    assert not set(known) - set(cited), f"entries that nothing cites: {sorted(set(known) - set(cited))}"
