"""What cheaper forms of the model that is put first are worth in the directions of a sample."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from gonio.geometry import direction
from gonio.models import Model, Sum
from gonio.models.forms import ModelDirections, forms, full
from gonio_analysis.fitting.forward import known_wavelength
from gonio_analysis.report.blocks import Block, Heading, Paragraph
from gonio_analysis.report.section import Section
from gonio_analysis.report.text import number, percent

if TYPE_CHECKING:
    from gonio_analysis.report.facts import DatasetSummary
    from gonio_analysis.selection.compare import Dataset

MOST = 512
"""Directions in which forms are held against each other."""
TIMED_S = 2e-3
"""Processor time that each form is evaluated for, `REPEATS` times in turn with the others."""
REPEATS = 3
WORTH = 0.9
"""A form that costs more of the dearest one's time is no alternative."""


class FormSummary(TypedDict):
    """A form of a model against its dearest."""

    model: str
    form: str
    off: float
    """Relative difference, root mean square; parameters are fitted to the dearest form where the form is another law.
    """
    wall_s: float
    """Processor time of an evaluation."""


def found(d: Dataset) -> list[FormSummary]:
    """The dearest form of the model that is put first, and its cheaper ones; empty where there is one alone."""
    fit = None if d.best is None else d.models[d.best].fit
    if fit is None or not isinstance(fit.model, Model) or isinstance(fit.model, Sum):
        return []
    at = fit.data.directions
    some = slice(None, None, -(-len(fit.data) // MOST))
    of_some = at[some]
    seen = ModelDirections(direction(of_some.theta_i, of_some.phi_i), direction(of_some.theta_r, of_some.phi_r))
    dearest = full(fit.model)
    every = {"": dearest} | {form.name: form.change(dearest) for form in forms(dearest, seen) if form.name != "lambert"}
    if len(every) == 1:
        return []
    wave = known_wavelength(fit.data.wavelengths[0])
    values = {name: np.asarray(m.brdf_vectors(*seen, wavelength_nm=wave)) for name, m in every.items()}
    lit = values[""] > 0.0
    off = {name: float(np.sqrt(np.mean((v[lit] / values[""][lit] - 1.0) ** 2))) for name, v in values.items()}
    taken = _times(every, seen, wave)
    return [FormSummary(model=fit.name, form=name, off=off[name], wall_s=taken[name]) for name in every]


def _times(every: dict[str, Model], seen: ModelDirections, wave: float) -> dict[str, float]:
    """Processor time of an evaluation of each, the best of some in turn."""
    best = dict.fromkeys(every, np.inf)
    for _ in range(REPEATS):
        for name, model in every.items():
            began, done = time.process_time(), 0
            while (spent := time.process_time() - began) < TIMED_S:
                model.brdf_vectors(*seen, wavelength_nm=wave)
                done += len(seen.toward)
            best[name] = min(best[name], spent / done)
    return best


def words(of: Sequence[FormSummary]) -> list[str]:
    """A sentence for each cheaper form."""
    return [
        f"{one['model']} ({one['form']}) is within {percent(one['off'])} of its full form in the measured directions "
        f"(root mean square), at {percent(one['wall_s'] / of[0]['wall_s'])} of the cost of an evaluation."
        for one in of[1:]
        if one["wall_s"] < WORTH * of[0]["wall_s"]
    ]


def blocks(d: DatasetSummary) -> Sequence[Block]:
    """The sentences; nothing where no form is cheaper."""
    said = words(d.sections.get("forms", []))
    if not said:
        return []
    return [Heading(3, "Cheaper forms", f"{number(len(said))} of {d.best}"), *(Paragraph(text) for text in said)]


SECTIONS = (Section("forms", lambda d, figures: blocks(d), facts=lambda d: found(d) or None),)
