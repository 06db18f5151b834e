"""The page of two things compared point by point: its verdict, its table, and what is folded."""

from collections.abc import Sequence

import numpy as np

from gonio.measurement import said_once
from gonio.run_facts import RunFacts
from gonio_analysis.changes.point_by_point import Change
from gonio_analysis.changes.verdict import CLOSER, FALSE_DISCOVERIES, LEVEL, OFTEN, Effect, Verdict
from gonio_analysis.fitting.objective import DESCRIPTIONS, meaning
from gonio_analysis.fitting.observations import describe_left_out
from gonio_analysis.report import frame, html, viewer
from gonio_analysis.report.blocks import (
    MOST_ROWS,
    Block,
    Figures,
    Heading,
    Page,
    Paragraph,
    Stamp,
    Table,
    Text,
    Viewer,
    dated,
    facts,
    figures_of,
    footer,
    lead,
    notes,
    table,
    term,
)
from gonio_analysis.report.drawing import Figure
from gonio_analysis.report.page import MOST_BYTES
from gonio_analysis.report.text import counted, number, percent, spoken_difference, with_u

ALIKE = 0.9
"""Cosine between what the zeros of both arms do, above which either may be it."""
LARGEST_ZERO = float(np.radians(5.0))
"""An error of an angle that nobody makes unseen."""
_ANGLES = {"theta_r": "θr", "theta_i": "θi"}
FOOTER = footer(
    "Every number on this page is in `summary.json`, every compared value in `tables/change.csv`, the figures as SVG "
    "in `figures/`."
)
BY_CHANCE = term("p", "The probability of so much by chance, where nothing changed.")
FACTOR = term("common factor of B over A", "By least squares, with the covariance of both.")
NEAREST = "the factor that brings both nearest"
Waves = list[dict[str, float | None]]
"""What is known of the values at each wavelength; counts where uncertainties are stated."""


def title(c: Change) -> str:
    """The two."""
    return f"{c.b.title} against {c.a.title}"


def page(
    c: Change,
    made: Stamp,
    runs: Sequence[RunFacts | None],
    waves: Waves,
    figures: Sequence[Figure],
    view: viewer.ViewerData | None,
) -> Page:
    """The page, of at most `MOST_BYTES`."""
    first = {"values"} if view is not None else {f.name for f in figures[:1]}

    def of(drawn: Sequence[Figure]) -> Page:
        picture = Figures(tuple(f for f in drawn if f.name in first), printed=view is not None)
        more = [f for f in drawn if f.name not in first]
        return frame.page(
            title(c),
            dated("Point by point", made),
            frame.answer(
                [lead(" ".join(verdict(c)))], [*([Viewer("change", view)] if view else []), picture], [_tests(c)]
            ),
            folds=[*_folds(c, runs, waves, more), *frame.provenance(made)],
            foot=FOOTER,
        )

    room = MOST_BYTES - html.size(html.document(of([])))
    return of(figures_of([html.within(Figures(tuple(figures)), room)]))


def _folds(c: Change, runs: Sequence[RunFacts | None], waves: Waves, figures: Sequence[Figure]) -> list[Block]:
    v, noted, said = c.verdict, notes_of(c), in_full(c)
    typical = spoken_difference(c.metrics["log_ratio"])
    out: list[Block] = []
    if said:
        marked = f"typically {typical} apart" if v is None else _marked(v)
        out += [Heading(3, "The comparison in full", marked), *(Paragraph(text) for text in said)]
    if figures:
        names = "where it is brighter, and by how many standard deviations" if v else "where it is brighter"
        out += [Heading(3, "The difference", names), Figures(tuple(figures))]
    out += [Heading(3, "What was compared", counted(len(c.at), "value")), facts(_facts(c, runs))]
    out += [notes(noted)] if noted else []
    out += [Heading(3, "Metrics", f"typically {typical} apart" if typical != "–" else "no ratio is told"), _metrics(c)]
    if len(waves) > 1:
        out += [Heading(3, "Wavelengths", counted(len(waves), "wavelength")), _of_wavelengths(waves)]
    if v is not None:
        out += [
            Heading(3, "How it is judged", f"{counted(len(v.tests), 'test')} share {100 * LEVEL:g} %"),
            *_method(v),
        ]
    return out


def _marked(v: Verdict) -> str:
    """How many values changed, judged together."""
    marked = int(v.marked.sum())
    return (
        f"{marked} {'value has' if marked == 1 else 'values have'} changed" if marked else "no single value stands out"
    )


# ---- what is said ----


def conclusion(c: Change) -> str:
    """Everything that is said of the two, in a paragraph."""
    return " ".join([*verdict(c), *in_full(c)])


def verdict(c: Change) -> list[str]:
    """The answer, in one or two sentences."""
    v, n = c.verdict, len(c.at)
    if c.identical:
        return [f"The two are identical: each of the {n} values of B is that of A."]
    if v is None:
        return [
            f"They agree {_so(c.within.as_they_are)}, over {n} values.",
            "No uncertainty is stated: --u-rel assumes one.",
        ]
    same = "the sample changed" if c.a.kind == c.b.kind else "the two disagree"
    head = f"{same[:1].upper()}{same[1:]}, by {_listed(v.found_by)}" if v.changed else f"No sign that {same}"
    if (zeros := _zeros_found(v)) and not v.factor.found:
        return [f"{head}.", zeros[0]]
    return [f"{head}: {_factor_words(v) or f'{n} values'}.", *(zeros[:1] or [_typical(c)])]


def in_full(c: Change) -> list[str]:
    """What else is to say, a sentence each."""
    v, n = c.verdict, len(c.at)
    if c.identical:
        return []
    if v is None:
        return [_typical(c), _agreement(c, "They")]
    out = [
        f"Chi-square is {v.chi_square:.4g} for {n} values (p {_p(v.p_value)}).",
        f"{v.beyond} of {n} values lie beyond 2 standard deviations, where {v.expected:.1f} are expected by chance.",
    ]
    marked, between = int(v.marked.sum()), int(np.count_nonzero(v.marked & (c.error > 0)))
    out.append(f"Judged together, {_marked(v)}.")
    out += [f"About {100 * FALSE_DISCOVERIES:g} % of these are by chance."] if marked else []
    out += [f"{between} of them compared by interpolation: measure there before believing it."] if between else []
    found = _zeros_found(v)
    out += [*found[1:], _typical(c)] if found else []
    if found and not v.factor.found and (factor := _factor_words(v)):
        out.append(f"{factor[:1].upper()}{factor[1:]}.")
    out += [] if v.changed else _limits(v)
    return [*out, _agreement(c, "Beyond what they state they" if c.within.as_they_are > 0.0 else "They")]


def _typical(c: Change) -> str:
    if c.metrics["log_ratio"] is None:
        return "No value stands out of its uncertainty in both, so that no ratio is told."
    return f"They differ typically by {spoken_difference(c.metrics['log_ratio'])}."


def _listed(names: Sequence[str], last: str = "and") -> str:
    return f" {last} ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _factor(v: Verdict) -> str:
    return with_u(1 + v.scale, v.u_scale)


def _factor_words(v: Verdict) -> str:
    """ "" where the values do not tell it."""
    return f"the common factor of B over A is {_factor(v)} (p {_p(v.p_scale)})" if np.isfinite(v.u_scale) else ""


def _degrees(x: Effect) -> str:
    return f"({with_u(np.degrees(x.value), np.degrees(x.u))})°"


def _zeros_found(v: Verdict) -> list[str]:
    """What is said of zeros that were found."""
    found = {angle: x for angle, x in v.zeros.items() if x.found}
    if not found:
        return []
    each = [
        f"{_ANGLES[a]} by ({with_u(np.degrees(x.value), np.degrees(x.u))})° (p {_p(x.p)})" for a, x in found.items()
    ]
    said = [f"B reads too large an angle: {_listed(each)}."]
    if len(found) == 1 and abs(v.alike) > ALIKE:
        (other,) = (name for angle, name in _ANGLES.items() if angle not in found)
        way = "other" if v.alike < 0 else "same"
        said.append(f"An error of {other}, in the {way} direction, would look much the same.")
    return said


def _limits(v: Verdict) -> list[str]:
    """What it would take to see an effect."""
    sizes = [f"a factor that is off by {percent(v.factor.detectable)}"] if v.factor.detectable < 1.0 else []
    sizes += [
        f"a zero of {_ANGLES[angle]} of {np.degrees(x.detectable):.2g}°"
        for angle, x in v.zeros.items()
        if x.detectable < LARGEST_ZERO
    ]
    flat = [] if len(sizes) > 1 else ["These values hardly show a zero of an angle."]
    found = f"Alone, {_listed(sizes, 'or')} would be found in {100 * OFTEN:g} % of the cases." if sizes else ""
    return [found, *flat] if found else flat


def _so(x: float) -> str:
    return f"within {percent(x)}" if x > 0.0 else "within what they state"


def _agreement(c: Change, who: str) -> str:
    """The relative standard deviation within which both agree beyond stated uncertainties."""
    w, known = c.within, c.verdict is not None
    said = f"{who} agree {_so(w.as_they_are)}"
    if w.with_scale < CLOSER * w.as_they_are:
        by = "this factor" if known else "a common factor" if w.zero is not None else f"{w.scale:.4g}, {NEAREST}"
        said += f"; {_so(w.with_scale)} where B is divided by {by}"
    if w.with_zero is not None and w.zero is not None and w.with_zero < CLOSER * w.with_scale:
        too = "" if known else f" and B is divided by {w.scale:.4g}"
        back = number(np.degrees(w.zero), 2)
        said += f"; {_so(w.with_zero)} where B's {_ANGLES[w.angle]} is taken back by {back}°{too}"
    return f"{said}."


def _p(p: float) -> str:
    return "< 0.0001" if p < 1e-4 else f"= {p:.2g}"


# ---- tables ----


def _tests(c: Change) -> Table:
    """What the verdict rests on; of two that state nothing, how near they are."""
    v, w = c.verdict, c.within
    typical = spoken_difference(c.metrics["log_ratio"])
    if v is None:
        rows: list[list[Text]] = [
            ["values", str(len(c.at))], ["typical difference", typical], ["they agree", _so(w.as_they_are)],
        ]  # fmt: skip
        if w.with_zero is None or w.zero is None:
            rows += [[NEAREST, number(w.scale, 4)], ["with it they agree", _so(w.with_scale)]]
        else:
            both = f"{number(w.scale, 4)}, and {_ANGLES[w.angle]} taken back by {number(np.degrees(w.zero), 2)}°"
            rows += [[f"{NEAREST}, with a zero", both], ["with both they agree", _so(w.with_zero)]]
        return table("", ["", "B against A"], rows)
    found = set(v.found_by)

    def row(name: str, label: Text, value: str, p: float) -> list[Text]:
        return [label, value, _p(p).removeprefix("= "), "yes" if name in found else "no"]

    every = list(v.tests)
    rows = [
        row(every[2], FACTOR, _factor(v), v.p_scale),
        *(
            row(name, f"zero of B's {_ANGLES[angle]}", _degrees(x), x.p)
            for name, (angle, x) in zip(every[3:], v.zeros.items(), strict=True)
        ),
        row(every[0], "chi-square of all values", f"{v.chi_square:.4g} for {len(c.at)}", v.p_value),
        row(every[1], "largest single value", f"{v.largest:.2f} standard deviations", v.p_largest),
    ]
    return table("", ["test", "B against A", BY_CHANCE, "changed"], rows)


def _of_wavelengths(waves: Waves) -> Table:
    rows = []
    for w in waves:
        nm, counts = w["wavelength_nm"], (w.get(name) for name in ("n_points", "beyond", "changed_points"))
        name = "no single wavelength" if nm is None else f"{nm:g} nm"
        rows.append([name, *("–" if n is None else str(n) for n in counts), number(w["median_ratio"], 4)])
    header = ["wavelength", "values", "beyond 2", "changed", "median B/A"]
    return table("", header, rows, right=(1, 2, 3, 4), most=(MOST_ROWS, "wavelengths.csv"))


def _facts(c: Change, runs: Sequence[RunFacts | None]) -> list[tuple[str, str]]:
    rows = []
    for key, x, run in zip("AB", (c.a, c.b), runs, strict=True):
        if x.model is not None:
            rows.append((key, f"{x.name}: {x.model.name} ({x.source}); {x.model.convention}"))
            continue
        stated = "with uncertainties" if x.stated else "no uncertainties stated"
        left = f"; left out: {describe_left_out(x.left_out)}" if x.left_out else ""
        made = f"; rig {run.rig}, {run.created[:10]}, seed {run.seed}" if run else ""
        values = f"{x.values}{' simulated' * x.simulated} values"
        rows.append((key, f"{x.name} ({x.source}): {values}, {stated}{left}{made}"))
    shared, interpolated = f"{len(c.at)}", int(np.count_nonzero(c.error))
    if {c.a.kind, c.b.kind} == {"measurement"}:
        shared += f", in the directions of {c.onto}"
    if interpolated:
        shared += f", {interpolated} of them by interpolation (median error {percent(median_error(c))})"
    rows.append(("shared values", shared))
    missing = "; ".join(f"{n} values of {c.onto} {why}" for why, n in c.missing.items())
    return [*rows, ("not compared", missing)] if missing else rows


def notes_of(c: Change) -> list[str]:
    """What the comparison says, and what the readers of both sides say."""
    read = {x.name: x.notes for x in (c.a, c.b) if x.model is None}
    known = {note for notes in read.values() for note in notes}
    return [*(note for note in c.notes if note not in known), *said_once(read)]


def median_error(c: Change) -> float | None:
    """Of interpolation, relative to the values that were carried; None where none was."""
    carried = c.value_b if c.onto == "A" else c.value_a
    used = (c.error > 0) & (carried != 0)
    return float(np.median(c.error[used] / np.abs(carried[used]))) if used.any() else None


def _metrics(c: Change) -> Table:
    known = c.verdict is not None
    rows = [[label, number(c.metrics[k]), meaning(k, known=known)] for k, (label, _) in DESCRIPTIONS.items()]
    caption = "B takes the place of the model, A that of the measurement."
    return table(caption, ["metric", "value", "what it is"], rows, right=(1,))


def _method(v: Verdict) -> list[Block]:
    effects = ["the common factor of B over A", *(f"the zero of {_ANGLES[angle]}" for angle in v.zeros)]
    remains = (
        " The factor and the zeros are named, and have their uncertainties, with what remains beside them as an"
        f" uncertainty of each value ({percent(v.remains)})."
        if v.remains > 0.0
        else ""
    )
    said = " ".join(_limits(v)) if v.changed else ""
    return [
        Paragraph(
            "The difference of each value is judged against what all the others predict of it, with the covariance of"
            " both measurements. What a common cause (a reference, a drift, the zero of an angle) does to all values"
            " alike does not count as a change of each. The causes of two measurements count as independent. Where"
            " both used the same reference its part cancels, and the verdict is on the safe side."
        ),
        Paragraph(
            f"Values are marked by Benjamini and Hochberg's procedure, which lets {100 * FALSE_DISCOVERIES:g} % of the"
            f" marks be wrong. The verdict rests on chi-square of all values, on the largest of them, and on"
            f" {_listed(effects)}, each at {100 * LEVEL / len(v.tests):.2g} %. Where nothing changed it says so in"
            f" {100 * (1 - LEVEL):g} % of the cases.{remains} {said}".strip()
        ),
    ]
