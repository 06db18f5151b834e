"""Checks with a figure of merit and a verdict, each limit with its reason (docs/checks.md)."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal

from gonio.checks.hemisphere import Hemispherical, reflectances
from gonio.checks.symmetry import DIFFERENT, FEWEST, PLACES, Pairs, repeats, symmetries
from gonio.checks.values import CLIPPED, CheckedValues
from gonio.shown import with_u
from gonio.typing import JsonObject

Verdict = Literal["ok", "look", "bad", "undetermined"]

TWICE = 4.0
"""Chi-square a pair beyond which differences are twice what uncertainties say: an interval of k = 2 then covers what
one of k = 1 should."""
HALF_DIFFERENT = DIFFERENT / 2
"""Difference, of tables without uncertainties, that is half of what counts as different."""
ENERGY_SIGMA = 2.0
"""A reflectance above 1 by more than this many standard uncertainties breaks the conservation of energy (k = 2)."""
LOST = 0.10
"""Share of the points whose loss leaves holes: a curve of ten points lacks one."""
SCATTER = 1.44
"""Reduced chi-square of the frames from which uncertainties are 20 % too small."""
SWING = 0.10
"""Change of the reference's signal beyond which a rate over the level is not linear in the level's error."""
FULL = 0.5
"""Share of the frames left out as saturated beyond which most points rest on their shorter frame alone."""


@dataclass(frozen=True)
class Check:
    """One check of a table or of its run."""

    name: str
    verdict: Verdict
    value: float | None
    """The figure of merit."""
    figure: str
    """The same in words."""
    limit: str
    """What the verdict rests on."""
    advice: str = ""
    """What would tell, or mend."""
    band: str = ""
    """"" for all bands."""

    @classmethod
    def from_json(cls, values: Any) -> "Check | None":
        """Inverse of `to_json`; None for anything else, which a file may hold under the same name."""
        names = {one.name for one in fields(cls)}
        if not isinstance(values, dict) or values.keys() != names:
            return None
        old = values["verdict"] == "not told"  # the word of version 0.1
        return cls(**values | ({"verdict": "undetermined"} if old else {}))

    def to_json(self) -> JsonObject:
        """As it stands in the attributes of a table."""
        return asdict(self)


@dataclass(frozen=True)
class VisitsOfBand:
    """What the visits to the white reference said of one band."""

    used: int
    lost: Sequence[str]
    """The flags of those that could not be used."""
    unknown: str
    """Why a drift is not known; "" where it is."""
    straight: bool
    chi_square: float
    drift_per_hour: float
    """Relative."""
    u_drift_per_hour: float
    peak_to_peak: float
    """Relative, of the visits' signals."""


@dataclass(frozen=True)
class FramesTaken:
    """What became of the frames and the points of one band."""

    frames: int
    """Frames of points and visits, with the lamp lit."""
    frames_left_out: int
    """Because a used pixel was nearly full."""
    scatter: float
    """Reduced chi-square of the frames around the means of their steps."""
    freedom: int
    clipped: float
    """Share of the used pixels at 0 DN in the dark frames."""
    flags: Sequence[str]
    """One for each point that the rig can reach: "", or why it gave no value."""


def of_values(data: CheckedValues) -> list[Check]:
    """Reciprocity, left and right, repeats, and energy, of the values of one wavelength."""
    found = {pairs.kind: pairs for pairs in symmetries(data)}
    out = [
        of_pairs(
            "reciprocity",
            found.get("reciprocity"),
            "measure some pairs with source and detector exchanged: for theta_i = 20, theta_r = 50 also theta_i = 50, "
            "theta_r = 20, on the same side",
        ),
        of_pairs(
            "left and right",
            found.get("left and right"),
            "measure some points out of the plane on both sides: dphi_deg = 150 and 210",
        ),
    ]
    again = repeats(data)
    out += [of_pairs("repeats", again, "")] if again is not None else []
    return [*out, of_energy(reflectances(data))]


def of_pairs(name: str, pairs: Pairs | None, advice: str) -> Check:
    """Whether pairs of values are as much alike as their covariance says."""
    if pairs is None:
        return Check(name, "undetermined", None, f"fewer than {FEWEST} such pairs were measured", "", advice)
    figure = f"{pairs.pairs} pairs differ typically by {_factor(pairs.typical)}, at most by {_factor(pairs.largest)}"
    if pairs.reduced_chi_square is None:
        value = pairs.typical
        verdict: Verdict = "bad" if pairs.broken else "look" if value > HALF_DIFFERENT else "ok"
        limit = f"no uncertainty is stated; {_percent(HALF_DIFFERENT)} is worth a look, {_percent(DIFFERENT)} is bad"
    else:
        value = pairs.reduced_chi_square
        verdict = "ok" if not pairs.broken else "bad" if value > TWICE else "look"
        figure += f"; chi-square a pair {value:.3g}"
        limit = (
            "chi-square with the covariance: 1 run in 100 exceeds the limit by chance; above 4 a pair, differences are"
            " twice their uncertainty"
        )
    return Check(name, verdict, value, figure, limit, "" if verdict == "ok" else _cause(pairs))


def _cause(pairs: Pairs) -> str:
    """Where pairs differ, and why they do there, as far as the values tell."""
    told = ", ".join(f"{_factor(one.typical)} {one.words} ({one.pairs})" for one in pairs.places)
    worst = max(pairs.places, key=lambda one: one.pairs * one.typical**2)
    return f"typical differences (and pairs): {told}. Most of it lies {worst.words}: {PLACES[worst.words]}"


def _factor(log: float) -> str:
    """A difference of logarithms: in percent, or as a factor where it is large."""
    return _percent(math.expm1(log)) if log < math.log(2.0) else f"a factor {math.exp(log):.3g}"


def of_energy(found: Sequence[Hemispherical]) -> Check:
    """Whether the hemispherical integrals of the values exceed what fell on the sample."""
    name = "energy"
    known = [(one.rho_dh - 1.0, one) for one in found if one.rho_dh is not None]
    if not known:
        why = Counter(one.why for one in found).most_common(1)
        return Check(
            name, "undetermined", None, f"no hemisphere: {why[0][0]}" if why else "no values", "",
            "measure one incidence over the hemisphere (theta_r 0 to 80, dphi 0 to 180 degrees)",
        )  # fmt: skip
    above, worst = max(known, key=lambda one: one[0])
    rho = above + 1.0
    verdict: Verdict = "ok" if above <= 0.0 else "bad" if above > ENERGY_SIGMA * worst.u else "look"
    figure = f"reflectance at most {with_u(rho, worst.u)} (at {round(worst.theta_i_deg, 1):g}° incidence)"
    return Check(name, verdict, rho, figure, "1; more than two standard uncertainties above it is bad")


def of_run(taken: FramesTaken, visits: VisitsOfBand, band: str) -> list[Check]:
    """What frames, visits and points of one band say of their run."""
    out = [_reference(visits), _scatter(taken), _saturated(taken), _lost(taken), _clipped(taken)]
    return [Check(**{**one.to_json(), "band": band}) for one in out]


def _reference(visits: VisitsOfBand) -> Check:
    name = "reference drift"
    lost = f"; {len(visits.lost)} measurements of it cannot be used ({_counted(visits.lost)})" if visits.lost else ""
    if visits.unknown:
        advice = "measure the white reference at the start, at the end and between (reference.every)"
        return Check(name, "undetermined", None, visits.unknown + lost, "", advice)
    swing = visits.peak_to_peak
    figure = (
        f"{visits.used} measurements, {_percent(swing)} from lowest to highest, drift "
        f"({with_u(100 * visits.drift_per_hour, 100 * visits.u_drift_per_hour)}) % an hour{lost}"
    )
    verdict: Verdict = "bad" if swing > SWING else "ok" if visits.straight and not lost else "look"
    figure += "" if visits.straight else f"; they lie on no straight line (chi-square {visits.chi_square:.3g})"
    limit = f"measurements lie on a straight line (probability above 1 %) and swing by less than {_percent(SWING)}"
    return Check(name, verdict, swing, figure, limit)


def _scatter(taken: FramesTaken) -> Check:
    name = "repeatability"
    if not taken.freedom:
        return Check(
            name, "undetermined", None, "no step has several frames", "", "take acquisition.frames = 2 or more"
        )
    limit = max(SCATTER, 1.0 + 3.0 * math.sqrt(2.0 / taken.freedom))
    verdict: Verdict = "bad" if taken.scatter > max(TWICE, limit) else "look" if taken.scatter > limit else "ok"
    figure = f"frames of one step scatter {math.sqrt(taken.scatter):.2g} times as much as the noise model says"
    reason = f"{math.sqrt(limit):.2g}: uncertainties are then 20 % too small; at 2 times they are half of what they are"
    return Check(name, verdict, math.sqrt(taken.scatter), figure, reason)


def _saturated(taken: FramesTaken) -> Check:
    share = taken.frames_left_out / max(taken.frames, 1)
    points = sum(flag == "saturated" for flag in taken.flags)
    verdict: Verdict = "bad" if points > LOST * len(taken.flags) else "look" if points or share > FULL else "ok"
    figure = f"{taken.frames_left_out} of {taken.frames} frames left out ({_percent(share)}); {points} points lost"
    limit = f"no point lost, and at most {_percent(FULL)} of the frames; a tenth of the points leaves holes"
    return Check("saturation", verdict, share, figure, limit, "lower acquisition.exposure_target" if points else "")


def _lost(taken: FramesTaken) -> Check:
    lost = [flag for flag in taken.flags if flag and flag != "saturated"]
    share = len(lost) / max(len(taken.flags), 1)
    verdict: Verdict = "bad" if share > LOST else "look" if lost else "ok"
    figure = f"{len(lost)} of {len(taken.flags)} points that the rig reaches" + (f" ({_counted(lost)})" if lost else "")
    return Check("lost points", verdict, share, figure, "none; a tenth of them leaves holes in curves")


def _clipped(taken: FramesTaken) -> Check:
    bad = CLIPPED < taken.clipped < 1.0  # all at 0 is a camera without noise
    verdict: Verdict = "bad" if bad and taken.clipped > LOST else "look" if bad else "ok"
    figure = f"{_percent(taken.clipped)} of the pixels of the dark frames read 0 DN"
    advice = "raise the camera's black level" if bad else ""
    return Check(
        "dark level", verdict, taken.clipped, figure, f"{_percent(CLIPPED)}: what lies below is cut off", advice
    )


def _counted(flags: Sequence[str]) -> str:
    return ", ".join(f"{count} {flag}" for flag, count in Counter(flags).most_common())


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"
