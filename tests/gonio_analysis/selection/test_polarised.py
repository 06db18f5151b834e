"""Ratios of polarised states: those of the model that made them, from states and from matrices alike."""

import numpy as np
import pytest
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.observations import observations
from gonio_analysis.selection.polarised import RATIOS, ratios

from gonio.formats.reader import MUELLER
from gonio.geometry import Directions
from gonio.models.polarised import mueller
from tests.gonio_analysis.fitting.test_polarised import METAL, polarised
from tests.gonio_analysis.synthetic import known


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ("s p", ["diattenuation"]),
        ("us up", ["polarisation"]),
        ("ss pp", ["ellipsometric"]),
        ("ss sp ps pp", list(RATIOS)),
    ],
)
def test_ratios_that_the_states_give_are_the_models(words: str, names: list[str]) -> None:
    data = observations(polarised(METAL, words), polarised=True)
    found = known(ratios(data, fit(data, "he-torrance", ior=2.9 + 3.1j), "he-torrance"))
    assert list(found.lines) == names
    for name, numbers in found.summary().items():
        if isinstance(numbers, dict):
            # 124 values of standard deviation 1: five standard deviations of their mean square
            assert numbers["chi_square_per_value"] == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / 124)), name


def test_a_matrix_has_the_ratios_of_its_states() -> None:
    frame = polarised(METAL, "unpolarised", u_rel=1e-9)
    matrix = mueller(METAL, Directions.from_table(frame)).reshape(-1, 16)
    for k, element in enumerate(MUELLER):
        frame[element] = matrix[:, k + 1] / matrix[:, 0]
    of_matrix = known(ratios(observations(frame, polarised=True), None, None))
    of_states = known(ratios(observations(polarised(METAL, "ss sp ps pp", u_rel=1e-9), polarised=True), None, None))
    assert of_matrix.model is None
    for name in ("diattenuation", "polarisation", "crossed"):
        for one, other in zip(of_matrix.lines[name], of_states.lines[name], strict=True):
            # values of 1e-5 and less have an absolute uncertainty of 1e-5 beside the relative one
            bright = np.abs(one.angle - np.radians(30)) < 0.2
            assert one.measured[bright] == pytest.approx(other.measured[bright], abs=1e-2)


def test_unpolarised_light_and_lone_states_have_none() -> None:
    assert ratios(observations(polarised(METAL, "unpolarised"), polarised=True), None, None) is None
    assert ratios(observations(polarised(METAL, "s"), polarised=True), None, None) is None
