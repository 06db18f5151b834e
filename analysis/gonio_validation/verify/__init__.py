"""`gonio verify`: whether this installation computes what it should. docs/how_well.md says what is checked.

The digits that results are held against were computed or published by others. Each part says what it found, and fails
by itself: an error in one is that part's result, and the others are still looked at.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gonio_analysis.report import files, frame
from gonio_analysis.report.blocks import (
    Block,
    Heading,
    Page,
    Paragraph,
    facts,
    footer,
    lead,
    stamp,
    table,
)

from gonio.errors import GonioError
from gonio.typing import JsonObject
from gonio_validation.verify import arithmetic, digits, dome, installation, line
from gonio_validation.verify.finding import Finding

LIMITS = (
    "Simulated frames stand for a camera: no real detector, lamp or arm is looked at. A rig is signed off by measuring"
    " its own white (docs/sign_off.md).",
    "The digits of He-Torrance are those of the 1991 equations with their errata (docs/reference/equations.md); that a"
    " real surface obeys them is not claimed.",
    "Files that are installed for editing have no checksums to be held against; their own are listed.",
)
"""What a verdict does not say."""


@dataclass(frozen=True)
class VerifyPart:
    """One part of the verification."""

    name: str
    what: str
    look: Callable[[Path], list[Finding]]
    """Takes a folder of its own to write in."""


PARTS = (
    VerifyPart("installation", "versions, and files as they were released", installation.look),
    VerifyPart(
        "models", "digits of the papers' equations that others computed, kernels against plain formulas", digits.models
    ),
    VerifyPart("colour", "white points and sums of the observer's tables, as CIE publishes them", digits.colour),
    VerifyPart("uncertainty", "GUM H.1 and H.2, NIST's reference datasets, consensus values", arithmetic.look),
    VerifyPart("draws", "value and limits of La Coupole's example, as its package has them", dome.look),
    VerifyPart("formats", "a table written and read back in each format", line.formats),
    VerifyPart(
        "measurement", "a sample that the simulated rig measures blindly, from frames to parameters", line.measured
    ),
)


def verify(folder: Path, command: str = "", say: Callable[[str], None] = lambda text: None) -> JsonObject:
    """Look at every part: the verdict, and of each part `passed`, `seconds` and `findings`, as in `summary.json`.

    Parameters
    ----------
    folder
        Where parts may write; it exists.
    command
        The command line, for the record.
    say
        Called with a line after each part.
    """
    results = list[JsonObject]()
    for part in PARTS:
        began = time.perf_counter()
        (own := folder / part.name).mkdir()
        try:
            found = part.look(own)
        except (GonioError, ArithmeticError, LookupError, OSError, TypeError, ValueError, AttributeError) as error:
            # a broken installation fails in ways that nobody foresees: each is that part's result
            found = [Finding("it ends", False, f"{type(error).__name__}: {error}", "no error")]
        passed = all(one.passed for one in found)
        took = time.perf_counter() - began
        results.append({"name": part.name, "what": part.what, "passed": passed, "seconds": took, "findings": found})
        bad = [one for one in found if not one.passed]
        head = f"{part.name}: {'passed' if passed else 'FAILED'}, {len(found) - len(bad)} of {len(found)} checks"
        say(head + "".join(f"\n  {one.name}: {one.found}, where {one.expected} is right" for one in bad[:5]))
    failed = [one["name"] for one in results if not one["passed"]]
    count = sum(len(one["findings"]) for one in results)
    conclusion = (
        f"This installation fails in: {', '.join(failed)}. Do not measure with it: install gonio anew."
        if failed
        else f"All {count} checks of {len(results)} parts passed: this installation computes what it should."
    )
    verdict = {"passed": not failed, "conclusion": conclusion, "parts": results, "limits": LIMITS}
    return {"title": "Verification of gonio", **stamp(command), **verdict}


def make(out: Path, result: JsonObject) -> Path:
    """The page and `summary.json` of a verification; the path of `index.html`."""
    with files.staged(out) as stage:
        files.write_page(stage.work, result["title"], lambda _: _page(result), lambda _: result)
    return out / "index.html"


def _page(v: JsonObject) -> Page:
    sub = f"Validation of the software, {v['created'][:10]}, gonio {v['versions']['gonio']}."
    rows = [
        [p["name"], p["what"], _tally(p), "passed" if p["passed"] else "FAILED", f"{p['seconds']:.1f} s"]
        for p in v["parts"]
    ]
    every = table("", ["part", "what is checked", "checks passed", "verdict", "time"], rows, right=(4,))
    folds: list[Block] = []
    for part in v["parts"]:
        shown = [
            [f.name, f.found, f.expected, f.tolerance, "passed" if f.passed else "FAILED"] for f in part["findings"]
        ]
        result = f"{'passed' if part['passed'] else 'FAILED'}, {_tally(part)}"
        columns = ["check", "found", "right", "tolerance", ""]
        folds += [Heading(3, part["name"].capitalize(), result, open=not part["passed"]), table("", columns, shown)]
    folds += [Heading(3, "What this does not say", "no real camera, lamp or arm is looked at")]
    folds += [Paragraph(text) for text in v["limits"]]
    blank = "_" * 40
    signed = [("verified by", blank), ("date", blank), ("signature", blank), ("instrument, computer", blank)]
    folds += [Heading(3, "Signed off", "name, date and signature, on paper"), facts(signed)]
    folds += frame.provenance(v, called="made")
    first = frame.answer([lead(v["conclusion"])], [], [every])
    return frame.page(
        v["title"], sub, first, folds=folds, foot=footer("Every number on this page is in `summary.json`.")
    )


def _tally(part: JsonObject) -> str:
    return f"{sum(f.passed for f in part['findings'])} of {len(part['findings'])}"
