"""Writes docs/reference/equations.md: where each equation of the four papers stands, by docstrings of its plain form.

python tools/equations.py
"""

import inspect
import re
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from gonio.models import plain

OUT = Path(__file__).resolve().parents[1] / "docs" / "reference" / "equations.md"

HEAD = """# The papers' equations

Every formula stands once in `gonio/models/plain/`, in the paper's order and symbols. The models
evaluate them by compiled kernels, which `tests/gonio/models/test_plain_*.py` hold against the plain
ones.

Equations without a number go by the letter on their left, as "Cook1982 R_s". Names such as He1991
are keys of [references.bib](../references.bib). A dagger marks formulas whose print is wrong or must
be read with care. Names under "plain" begin with `gonio.models.plain.`, names under "compiled" with
`gonio.models.` unless they begin with `gonio.`

`python tools/equations.py` writes this page from the docstrings, and a test compares the two.
"""

STEPS = {
    1: "the Kirchhoff integral of a scalar field; eqs. 6 and 7 are what it leads to",
    13: "averages over surfaces; eqs. 26, 27 and 66 are what becomes of them",
    15: "a name for the surface, z = xi(x, y)",
    16: "the vector Kirchhoff integral; eq. 17 is what becomes of its integrand",
    19: "a double integral over the surface; eqs. 56 and 58 evaluate it",
    21: "the average in eq. 19",
    22: "a change of variables, which leaves the factor S A",
    28: "a name for the horizontal distance, rho = x' x + y' y",
    29: "the averages in eqs. 26 and 27; eqs. 50 to 52 evaluate them",
    49: "eqs. 26 and 27 with all known parts; eq. 50 evaluates them",
}
"""He1991's equations that are steps of the derivation and have no function, with what they are."""


class Formula(NamedTuple):
    """A function of `gonio.models.plain`, as its docstring describes it."""

    module: str
    name: str
    paper: str
    where: str
    what: str
    compiled: list[str]
    instead: str
    """Why there is no compiled form, where there is none."""
    in_doubt: bool

    @property
    def numbers(self) -> list[int]:
        """The equation numbers that it states."""
        if not self.where.startswith("eq"):
            return []
        found: list[int] = []
        for first, last in re.findall(r"(\d+)(?: to (\d+))?", self.where):
            found += range(int(first), int(last or first) + 1)
        return found


def formulas(module: ModuleType) -> list[Formula]:
    """All the public functions of a module, in their order in the file."""
    found = []
    for name, function in vars(module).items():
        if name.startswith("_") or not inspect.isfunction(function) or function.__module__ != module.__name__:
            continue
        text = " ".join(inspect.cleandoc(function.__doc__ or "").split())
        text, _, compiled = text.partition(" Compiled: ")
        match = re.match(r"([A-Z][a-z]+\d{4}),? (.*?): (.*)$", text)
        if match is None:
            raise ValueError(f"{module.__name__}.{name}: the docstring does not begin with a paper and an equation")
        paper, where, rest = match.groups()
        what = re.split(r"(?<!eq)(?<!eqs)(?<!\.\.)\. ", rest)[0].rstrip(".")
        instead = compiled.removeprefix("none, ") if compiled.startswith("none, ") else ""
        names = [] if instead else re.findall(r"gonio\.[\w.]*\w", compiled)
        if not (names or instead):
            raise ValueError(f"{module.__name__}.{name}: the docstring must say what is compiled, or why nothing is")
        # what the print has wrong, lacks, or leaves to be guessed
        in_doubt = re.search(
            r"\b(print|printed|two separate|standard deviation|hidden shares|0\.57)\b", rest, re.IGNORECASE
        )
        found.append(Formula(module.__name__, name, paper, where, what, names, instead, in_doubt is not None))
    return found


def _row(first: str, f: Formula) -> str:
    module = f.module.removeprefix("gonio.models.plain.")
    compiled = ", ".join(f"`{name.removeprefix('gonio.models.')}`" for name in f.compiled) or "none"
    return f"| {first}{' †' if f.in_doubt else ''} | `{module}.{f.name}` | {compiled} |"


def _numbered(found: list[Formula]) -> list[str]:
    """A row a function with all its equations, by the first of them; then those without a number."""
    numbered = sorted((f for f in found if f.numbers), key=lambda f: f.numbers[0])
    rows = [_row(", ".join(str(number) for number in sorted(f.numbers)), f) for f in numbered]
    return rows + [_row(f.where, f) for f in found if not f.numbers]


def page() -> str:
    """The whole page."""
    head = "\n| {} | plain | compiled |\n|---|---|---|"
    he = formulas(plain.he_torrance) + formulas(plain.he_torrance_appendix_a)
    oren = formulas(plain.oren_nayar)
    lines = [HEAD, "## He1991: He, Torrance, Sillion and Greenberg", head.format("eq.")]
    lines += _numbered(he)
    steps = ", ".join(str(number) for number in STEPS)
    lines += [f"\nNo function stands for steps of the derivation: {steps}."]
    lines += ["\n## Cook1982: Cook and Torrance", head.format("equation")]
    lines += [_row(f.where, f) for f in formulas(plain.cook_torrance)]
    lines += ["\n## Blinn1977: Blinn", head.format("equation")]
    lines += [_row(f.where, f) for f in formulas(plain.blinn)]
    lines += ["\n## Oren1994: Oren and Nayar", head.format("eq.")]
    lines += _numbered(oren)
    lines += ["\n## Reflection at a smooth surface", head.format("equation")]
    lines += [_row(f"{f.paper}, {f.where}", f) for f in formulas(plain.fresnel)]
    lines += ["\n## Anisotropic facets, retroreflection", head.format("equation")]
    later = formulas(plain.anisotropic) + formulas(plain.retroreflecting)
    lines += [_row(f"{f.paper}, {f.where}", f) for f in later]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    OUT.write_text(page(), encoding="utf-8")
