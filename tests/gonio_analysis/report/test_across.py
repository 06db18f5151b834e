"""Pairs of samples with known differences: what tells them apart is named, in plain words, and nothing else.

The tables are made from models with noise of 1 % and a reference that is known to 0.5 %, both stated.
"""

import math
import re
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.changes.sides import of_table
from gonio_analysis.report import across_plot
from gonio_analysis.report.across import across
from gonio_analysis.report.across_words import brighter, details, verdict

from gonio.models import build
from tests.gonio_analysis.synthetic import joined, known, measure

VIEWS = np.arange(-80.0, 80.1, 2.5)
INCIDENCES = (10.0, 30.0, 45.0, 60.0)


def exponent(width_deg: float) -> float:
    """Of cos^n of the half vector's angle, which is half of the detector's from the mirror direction."""
    return math.log(0.5) / math.log(math.cos(math.radians(width_deg / 4.0)))


def table(model: object, seed: int, *, times: float = 1.0, **how: object) -> pd.DataFrame:
    asked = {"views": VIEWS, "incidences": INCIDENCES, "noise": 0.01, "reference": 0.005, "seed": seed} | how
    return scaled(measure(model, **asked), times)  # type: ignore[arg-type]


def scaled(frame: pd.DataFrame, times: float) -> pd.DataFrame:
    columns = [name for name in ("brdf", "u_brdf", "u_random", "s_reference") if name in frame]
    return frame.assign(**{name: times * frame[name] for name in columns})


def gloss(width_deg: float = 30.0, level: float = 0.5) -> object:
    return build("phong", {"k_d": 0.3, "k_s": level, "exponent": exponent(width_deg)})


def matt(albedo: float = 0.5) -> object:
    return build("lambert", {"albedo": albedo})


def plaster() -> object:
    return build("oren-nayar", {"albedo": 0.8, "sigma_deg": 30.0})


def gold(slope: float) -> object:
    return build("cook-torrance", {"s": 1.0, "d": 0.0, "m": slope, "diffuse_albedo": 0.0, "ior": "Au"})


def shifted(seed: int, by_deg: float) -> pd.DataFrame:
    """What an arm says whose readings are too large by so much."""
    frame = table(gloss(), seed, views=VIEWS - by_deg)
    signed = np.where(frame["phi_r_deg"] == 180.0, 1.0, -1.0) * frame["theta_r_deg"] + by_deg
    return frame.assign(theta_r_deg=np.abs(signed), phi_r_deg=np.where(signed >= 0.0, 180.0, 0.0))


def unstated(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.drop(columns="s_reference").assign(u_brdf=np.nan, u_random=np.nan)


def retro() -> object:
    return build("retroreflecting", {"returned": 0.05, "width_deg": 4.0, "tail": 3.0, "entrance": 1.0,
                                     "diffuse_albedo": 0.5})  # fmt: skip


def coloured(factors: tuple[float, ...], seed: int) -> pd.DataFrame:
    waves = zip((450.0, 550.0, 650.0), factors, strict=True)
    return joined(*(table(matt(), seed + k, times=f, wavelength_nm=nm) for k, (nm, f) in enumerate(waves)))


BEYOND = "they differ beyond their uncertainties"
PAIRS: dict[str, tuple[Callable[[], list[pd.DataFrame]], list[str], list[str]]] = {
    "the same sample twice": (lambda: [table(gloss(), 1), table(gloss(), 2)],
        [r"B does not differ from A beyond their uncertainties"], ["darker", "wider", "lobe", BEYOND]),
    "12 % darker": (lambda: [table(gloss(), 1), table(gloss(), 2, times=0.88)],
        [r"B is 1[123] % darker than A at all angles", BEYOND], ["lobe"]),
    "a lobe that is 3 degrees wider": (lambda: [table(gloss(), 1), table(gloss(33.0), 2)],
        [r"B is as bright as A at all angles and its lobe is (2\.[5-9]|3\.[0-5]?)\d*° wider", BEYOND], ["darker"]),
    "12 % darker, and the lobe 3 degrees wider": (lambda: [table(gloss(), 1), table(gloss(33.0), 2, times=0.88)],
        [r"1[123] % darker than A at all angles and its lobe is (2\.[5-9]|3\.[0-5]?)\d*° wider", BEYOND], []),
    "a shifted zero": (lambda: [table(gloss(), 1), shifted(2, 0.5)],
        [r"as bright as A at all angles", r"its lobe lies 0\.[45]\d*° farther from the normal", BEYOND], ["wider"]),
    "glossier": (lambda: [table(gloss(), 1), table(gloss(level=1.5), 2)],
        [r"as bright as A away from the lobe and its lobe is 2\.[2-6]\d* times as high", BEYOND], ["wider"]),
    "gloss on a matt base": (lambda: [table(matt(), 1), table(gloss(20.0), 2)],
        [r"has a lobe in the mirror direction", "which A has not", BEYOND], ["different kinds"]),
    "a retro lobe added": (lambda: [table(matt(), 1), table(retro(), 2)],
        [r"toward the source \(the retro side\) it is \d\S* (times as bright|% brighter)", BEYOND], ["wider"]),
    "another colour": (lambda: [coloured((1.0, 1.0, 1.0), 1), coloured((1.1, 1.0, 0.7), 11)],
        [r"At 550 nm B is as bright as A at all angles", BEYOND,
         r"from (9\.\d|10\.0|10|11) % brighter at 450 nm to (29|30|31) % darker at 650 nm"], []),
    "gold beside plaster": (lambda: [table(gold(0.3), 1), table(plaster(), 2)],
        [r"of different kinds: A is (mirror-like|glossy) \(its lobe is .* as bright as the rest\), and B is matt"],
        ["wider", "darker", "brighter than"]),
    "both matt": (lambda: [table(matt(0.5), 1), table(matt(0.44), 2)],
        [r"1[123] % darker than A at all angles", BEYOND], ["lobe", "kinds"]),
    "matt, and three times as bright": (lambda: [table(matt(0.2), 1), table(matt(0.62), 2)],
        [r"B is 3\.[01]\d* times as bright as A at all angles", BEYOND], ["%"]),
    "a rougher matt surface": (lambda: [table(matt(0.8), 1), table(plaster(), 2)],
        [r"darker than A at most angles", r"near the mirror direction it is \d+ % darker", BEYOND], ["lobe"]),
    "no uncertainties": (lambda: [unstated(table(gloss(), 1)), unstated(table(gloss(), 2, times=0.88))],
        [r"1[123] % darker than A at all angles; no uncertainties are stated"], ["beyond"]),
    "uncertainties of one alone": (lambda: [table(gloss(), 1), unstated(table(gloss(), 2, times=0.88))],
        [r"1[123] % darker than A", BEYOND, "B states none, and counts as exact"], []),
    "few common directions": (
        lambda: [table(matt(), 1), table(matt(), 2, times=0.8, views=np.array([-30.0, 0.0, 60.0]), incidences=(30.0,))],
        [r"(19|20|21) % darker than A in the 3 directions that both have"], ["all angles"]),
    "no common wavelength": (lambda: [table(matt(), 1), table(matt(), 2, wavelength_nm=633.0)],
        [r"cannot be compared: they have no wavelength in common: A has 550 nm, B has 633 nm"], ["beyond"]),
    "no common incidence": (lambda: [table(matt(), 1), table(matt(), 2, incidences=(20.0,))],
        [r"no angle of incidence in common: A has .*, B has θi = 20°"], ["beyond"]),
    "three samples": (lambda: [table(gloss(), 1), table(gloss(), 2, times=0.88), table(gloss(36.0), 3)],
        [r"B is 1[123] % darker than A at all angles", r"C is as bright as A at all angles and its lobe is [56]\S*"],
        []),
}  # fmt: skip
"""What is known of a pair; the tables; what the verdict says; and what it does not.

Factors are known to 0.9 % (two references, and noise): 11 to 13 % for 12 % are its standard uncertainty and more.
Widths of both lobes are known to 0.25 degrees each at an incidence, and there are four: 0.5 degrees is three of the
difference's.
"""


@pytest.mark.parametrize("kind", PAIRS)
def test_the_verdict_names_what_two_samples_differ_by(kind: str) -> None:
    tables, needed, never = PAIRS[kind]
    found = across([of_table("ABC"[k], f"{'ABC'[k]}.csv", frame) for k, frame in enumerate(tables())])
    said = verdict(found)
    assert 1 <= len(said) <= 2
    text = " ".join(said)
    for words in needed:
        assert re.search(words, text), text
    for words in never:
        assert words not in text, text
    assert all(one.endswith(".") for one in [*said, *details(found)])


def test_four_samples_without_uncertainties_have_no_count_of_those_that_differ() -> None:
    parts = [unstated(table(matt(0.2 + 0.1 * k), k)) for k in range(4)]
    said = verdict(across([of_table(f"s{k}", "x", part) for k, part in enumerate(parts)]))
    assert said[0].startswith("s3 is ")
    assert "no uncertainties are stated" in said[0]
    assert said[1] == "The other samples lie nearer to s0."


def test_lobes_are_compared_in_numbers() -> None:
    (pair,) = across([of_table("A", "a", table(gloss(), 1)), of_table("B", "b", table(gloss(33.0), 2))]).pairs
    width, height = known(pair.width_deg), known(pair.height)
    assert width.stands
    assert not height.stands
    assert width.value == pytest.approx(3.0, abs=3 * width.u)
    assert width.u < 0.3  # four incidences, each known to 0.35 degrees
    assert [x.theta_i_deg for x in pair.lobes] == pytest.approx(list(INCIDENCES), abs=1e-9)


@pytest.mark.parametrize(
    ("factor", "words"),
    [(0.88, "12 % darker than A"), (1.12, "12 % brighter than A"), (3.1, "3.1 times as bright as A"),
     (0.05, "0.050 times as bright as A"), (1.0, "as bright as A")],
)  # fmt: skip
def test_factors_in_words(factor: float, words: str) -> None:
    assert brighter(factor, "A") == words


@pytest.mark.parametrize(("lower", "logarithmic"), [(1.0, False), (0.25, False), (0.1, True), (0.0, False)])
def test_a_plot_in_which_a_sample_would_be_a_blot_is_semilog(lower: float, logarithmic: bool) -> None:
    values = 0.2 + 0.1 * np.cos(np.linspace(-1.0, 1.0, 21))
    assert across_plot._logarithmic([values, lower * values]) == logarithmic


def test_a_plot_of_a_spike_is_semilog() -> None:
    values = np.full(21, 0.2)
    values[10] = 20.0
    assert across_plot._logarithmic([values, values])
