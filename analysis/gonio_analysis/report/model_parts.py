"""The parts of fitted models: the share of the light in each. The interactive plot draws them (`viewer`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from gonio.instrument.parts import DIRECTIONAL, SPECULAR, UNIFORM, uniform
from gonio.models import Lambert, Model, Sum
from gonio.typing import Floats
from gonio_analysis.fitting.forward import known_wavelength
from gonio_analysis.report.blocks import Block, Heading, Text, table
from gonio_analysis.report.section import Section
from gonio_analysis.report.text import angle as angle_text
from gonio_analysis.report.text import cut, percent

if TYPE_CHECKING:
    from gonio_analysis.report.facts import DatasetSummary
    from gonio_analysis.selection.compare import Dataset


class Shares(TypedDict):
    """The light of one incidence."""

    theta_i_deg: float
    shares: dict[str, float]
    """By the name of a part: the share of the incident light that it reflects."""


def shares(d: Dataset) -> dict[str, list[Shares]]:
    """By model that has several parts: the share of the incident light in each, by angle of incidence."""
    out = {}
    for name, f in d.models.items():
        known = [(r.theta_i_deg, r.rho_dh) for r in f.rho_dh if r.rho_dh is not None]
        if not known or not isinstance(f.fit.model, Model):
            continue
        theta, rho = np.radians([t for t, _ in known]), np.array([value for _, value in known])
        each = _reflected(f.fit.model, theta, rho, known_wavelength(f.fit.data.wavelengths[0]))
        if len(each) > 1:
            out[name] = [
                Shares(theta_i_deg=t, shares={part: float(v[k]) for part, v in each.items()})
                for k, (t, _) in enumerate(known)
            ]
    return out


def _reflected(model: Model, theta: Floats, rho: Floats, wave: float) -> dict[str, Floats]:
    """What each part reflects of the light from angles (n,) [rad], of which all reflect `rho`."""
    if isinstance(model, Lambert):
        return {}
    out: dict[str, Floats] = {}
    if isinstance(model, Sum):
        *first, last = ((f"{term.name} {j}", term, weight) for j, (term, weight) in enumerate(model.terms, 1))
        for name, term, weight in first:
            out[name] = weight * np.asarray(term.directional_hemispherical(theta, wavelength_nm=wave))
        return out | {last[0]: rho - sum(out.values())}
    if model.has_spike:
        out[SPECULAR] = np.asarray(model.specular_reflectivity(theta, wavelength_nm=wave))
    even = math.pi * uniform(model, wave)
    beside = {UNIFORM: np.full(theta.shape, even)} if even > 0.0 else {}
    return out | {DIRECTIONAL: rho - sum([*out.values(), *beside.values()])} | beside


def _place(name: str) -> tuple[int, str]:
    of_one = (SPECULAR, DIRECTIONAL, UNIFORM)
    return (of_one.index(name) if name in of_one else len(of_one)), name


def blocks(d: DatasetSummary) -> Sequence[Block]:
    """A row for each model and incidence."""
    found: dict[str, list[Shares]] = d.sections.get("parts", {})
    if not found:
        return []
    names = sorted({part for each in found.values() for part in each[0]["shares"]}, key=_place)
    rows: list[list[Text]] = [
        [f"{model}, {angle_text(row['theta_i_deg'])}", *(percent(row["shares"].get(n)) for n in names)]
        for model, each in found.items()
        for row in each
    ]
    words = (
        "The share of the incident light that each part of a model reflects, as fitted. “Parts of the models”, above, "
        "draws them over the angle."
    )
    right = tuple(range(1, 1 + len(names)))
    return [
        Heading(3, "Parts of the models", cut(", ".join(found), 60)),
        table(words, ["model, θi", *names], rows, right=right),
    ]


SECTIONS = (Section("parts", lambda d, figures: blocks(d), facts=lambda d: shares(d) or None),)
