"""Two things point by point: did this sample change, does this file agree with that one, how far apart are two models?

Either side is a measurement or a model. Two measurements are aligned by `gonio_analysis.changes.resampling`; a model
is evaluated in the directions and through the cones of the measurement. The difference is B - A.

Significance. The difference has the covariance of both measurements (of two runs, independent of each other) and the
interpolation's error. Each value is judged against what all the others predict of it (`Covariance.alone`). So a common
change of scale, which a new reference could make, does not count as a change of every value. Of n values 4.6 % lie
beyond 2 standard deviations by chance. A value therefore counts as changed only by the false-discovery procedure of
Benjamini and Hochberg (1995). The verdict on the whole rests on tests that share `LEVEL`: chi-square of all values,
the largest single one of n, the common factor of B over A, and a zero of either arm (`gonio_analysis.changes.verdict`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gonio import shown
from gonio.errors import ConfigError, DataError
from gonio.geometry import SAME_ANGLE, Directions, wrap
from gonio.models.corrected import Corrected, folded
from gonio.progress import Say, silent
from gonio.typing import Floats
from gonio_analysis.changes.interpolation import Interpolations
from gonio_analysis.changes.resampling import Carried, carry, common_wavelengths, slope_in_plane
from gonio_analysis.changes.sides import Compared, Side, require_alike
from gonio_analysis.changes.verdict import Verdict, Within, judge, within
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.objective import metrics, ratio_to, scaled_to
from gonio_analysis.fitting.observations import Observations, describe_left_out
from gonio_analysis.fitting.value_covariance import ADDED, Covariance

INCIDENCES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0)
AZIMUTHS_DEG = (0.0, 45.0, 90.0, 135.0, 180.0)
"""Directions of two models: these incidences, theta_r from 0 to 85 by 2.5 degrees, these dphi."""


@dataclass(frozen=True)
class Change:
    """B against A in the directions that they share; how they are judged is found when somebody asks."""

    a: Compared
    b: Compared
    at: Observations
    """The shared directions."""
    value_a: Floats
    value_b: Floats
    """[1/sr]"""
    u_a: Floats
    u_b: Floats
    """Standard uncertainty of each alone [1/sr], NaN where none is stated."""
    error: Floats
    """Error of the interpolation [1/sr]; 0 where there was none."""
    onto: str
    """Whose directions they are: "A" or "B"; the other's values were carried or evaluated there."""
    covariance: Covariance | None
    """Of B - A; None where neither side states an uncertainty."""
    missing: dict[str, int] = field(default_factory=dict)
    """Why values of A have no counterpart."""
    notes: Sequence[str] = ()
    together: Floats | None = None
    """Independent standard uncertainty of B - A as it counts in sums over neighbours [1/sr]: what is interpolated
    between the same values goes together. None where `covariance` says it."""

    def __repr__(self) -> str:
        return f"<{self.b.title} against {self.a.title} in {len(self.at)} directions: {self._conclusion}>"

    def _repr_html_(self) -> str:
        rows = [[key, "–" if number is None else f"{number:.4g}"] for key, number in self.metrics.items()]
        title = f"{self.b.title} against {self.a.title} in {len(self.at)} directions"
        return shown.html(title, ["metric", "value"], rows, [self._conclusion, *self.notes])

    @property
    def _conclusion(self) -> str:
        v = self.verdict
        if self.identical:
            return "identical"
        if v is None:
            return "no verdict: no uncertainties are stated"
        marked = int(np.count_nonzero(v.marked))
        head = f"changed, by {' and '.join(v.found_by)}" if v.changed else "no sign of a change"
        return f"{head} (p = {min(v.tests.values()):.2g}); {marked} of {v.z.size} values are marked"

    @property
    def identical(self) -> bool:
        """Whether every value of B is that of A."""
        return bool(np.array_equal(self.value_a, self.value_b))

    @cached_property
    def metrics(self) -> dict[str, float | None]:
        """How far B is from A (`gonio_analysis.fitting.objective`)."""
        cosine, known = np.cos(self.at.directions.theta_i), self.covariance
        if known is None:
            return metrics(self.value_b, self.value_a, cosine)
        return metrics(self.value_b, self.value_a, cosine, known.total, known.whiten(self.difference))

    @cached_property
    def verdict(self) -> Verdict | None:
        """Whether they differ by more than they state; None where neither side states an uncertainty."""
        if self.covariance is None:
            return None
        return judge(self.value_a, self.value_b, self.covariance, self.zeros, self.together)

    @cached_property
    def zeros(self) -> dict[str, Floats]:
        """What each of B's angles does to its values where it reads too large [1/(sr rad)].

        A value stands for f(true) cos(true theta_i) / cos(read theta_i). Lobes follow the mirror direction: a source
        that is turned does to f what a receiver does that is turned the other way.
        """
        mean = 0.5 * (self.value_a + self.value_b)
        slope = slope_in_plane(replace(self.at, brdf=mean))
        return {"theta_r": -slope, "theta_i": slope + mean * np.tan(self.at.directions.theta_i)}

    @cached_property
    def within(self) -> Within:
        """Within what they agree."""
        return within(self.value_a, self.value_b, self.covariance, self.zeros, self.verdict)

    @property
    def difference(self) -> Floats:
        """B - A [1/sr]."""
        return self.value_b - self.value_a

    @property
    def u(self) -> Floats:
        """Standard uncertainty of the difference [1/sr], NaN where none is stated."""
        return self.covariance.total if self.covariance is not None else np.full(len(self.at), np.nan)


def _of_measured(at: Observations, values: Sequence[Floats], *, measured_is_a: bool) -> Covariance | None:
    """The covariance of the differences by the measurement's own, scaled to the model's values."""
    if at.covariance is None:
        return None
    weights = scaled_to(at, values[1] if measured_is_a else values[0]).weights
    assert weights is not None
    return Covariance(weights.random, weights.common * (-1 if measured_is_a else 1), weights.causes)


def change(a: Side, b: Side, *, wavelength_nm: float | None = None, say: Say = silent) -> Change:
    """Compare two sides.

    Parameters
    ----------
    a, b
        What `side` returns.
    wavelength_nm
        For two models (550 nm if none is given), and for a model beside a table that states none. Of measurements with
        several wavelengths, the nearest that both have is compared alone.
    say
        Called with a line now and then, where it takes long.

    Raises
    ------
    ConfigError
        A model needs a wavelength that nobody names.
    DataError
        Two measurements share no direction; the message says why.
    """
    return compared([a, b], wavelength_nm=wavelength_nm, say=say)


def compared(sides: list[Side], *, wavelength_nm: float | None = None, say: Say = silent) -> Change:
    """As `change`, of two sides in a list that is empty then: values of large tables go once they are not needed."""
    require_alike(sides[0], sides[1])
    apart = _through(sides[0], sides[1], wavelength_nm, say)
    *sides[:], notes = _at_one(sides[0], sides[1], wavelength_nm)
    for note in notes:
        say(note)
    notes += apart
    if all(x.data is not None for x in sides):
        found = _measurements(sides, say)
        return replace(found, notes=(*found.notes, *notes))
    a, b = sides
    at = a.data if a.data is not None else b.data
    if at is None:
        at = _directions(550.0 if wavelength_nm is None else wavelength_nm)
        notes.append(
            "Models alone are compared in single directions, without the spike that has no finite value there."
        )
    elif np.isnan(at.wavelengths[-1]):
        model = a.model if b.model is None else b.model
        if wavelength_nm is None and model.name == "he-torrance":
            raise ConfigError(f"{a.source if a.data is not None else b.source} has no single wavelength, and the model"
                              " needs one: give it with --wavelength-nm")  # fmt: skip
        at = replace(at, wavelength_nm=np.full(len(at), wavelength_nm or 550.0))
        notes.append(
            f"The model is evaluated at {wavelength_nm or 550.0:g} nm: the measurement has no single wavelength."
        )
    values = [x.data.brdf if x.data is not None else apparent(x.model, at) for x in (a, b)]
    covariance = _of_measured(at, values, measured_is_a=a.data is not None)
    of_models = [_off(x, at, value) for x, value in zip((a, b), values, strict=True)]
    off = np.hypot(*(np.zeros(len(at)) if u is None else u for u in of_models))
    if off.any() and covariance is not None:
        covariance = replace(covariance, random=np.hypot(covariance.random, off))
    elif off.any() and a.data is None and b.data is None:
        covariance = Covariance(off, np.zeros((len(at), 0)), ())
    none, stated = np.full(len(at), np.nan), dict[str, tuple[Floats, Floats]]()
    for key, x, value, u in zip("AB", (a, b), values, of_models, strict=True):
        stated[key] = value, x.data.u if x.data is not None else none if u is None else u
        if u is not None:
            notes.append(f"{x.name} is a model that is off: its misfit is in the uncertainty, each value's for itself.")
    onto = "B" if a.data is None and b.data is not None else "A"
    return _change(
        Compared.of(a),
        Compared.of(b),
        at,
        onto,
        stated,
        covariance,
        notes=[*at.notes, *notes],
        error=np.zeros(len(at)),
        missing={},
    )


def _off(x: Side, at: Observations, value: Floats) -> Floats | None:
    """Standard uncertainty (n,) [1/sr] of a model that states a misfit; None of all else."""
    if isinstance(x.model, Corrected):
        known = x.model.correction
        where = folded(at.directions, x.model.model)
        return np.asarray(np.linalg.norm(known.beside(where, apparent(x.model.model, at))[1], axis=1))
    return x.misfit * np.abs(value) if x.misfit else None


def _through(a: Side, b: Side, wavelength_nm: float | None, say: Say) -> list[str]:
    """What is said of transmission: compared apart where both sides have it."""
    if a.behind:
        return ["Both hold transmission alone: the values are BTDF, theta_r counted from the normal of the back."]
    if a.through is None or b.through is None:
        having = [x for x in (a, b) if x.through is not None]
        return [f"{x.name} holds transmission too, which the other does not: it is left out." for x in having]
    one, other, _ = _at_one(a.through, b.through, wavelength_nm)
    try:
        found = _measurements([one, other], say)
    except DataError as error:
        return [f"Transmission could not be compared: {error}."]
    ratio = found.metrics.get("log_ratio")
    typical = "" if ratio is None or found.identical else f", rms of ln(B / A) {ratio:.2g}"
    return [f"Transmission is compared apart, in {len(found.at)} directions{typical}: {found._conclusion}."]


def _at_one(a: Side, b: Side, wavelength_nm: float | None) -> tuple[Side, Side, list[str]]:
    """Both sides at the wavelength that was asked for, where there are several."""
    measured = [x.data for x in (a, b) if x.data is not None]
    if wavelength_nm is None or not measured:
        return a, b, []
    pairs = [(w, w) for w in measured[0].wavelengths if not np.isnan(w)]
    if len(measured) == 2:
        pairs = [p for p in common_wavelengths(measured[0], measured[1]) if not np.isnan(p).any()]
    if len(pairs) < 2:
        return a, b, [instead(own, wavelength_nm) for own, _ in pairs if abs(own - wavelength_nm) > 1]
    own, other = min(pairs, key=lambda p: abs(p[0] - wavelength_nm))
    sides = [
        x if x.data is None else replace(x, data=x.data.at(wave))
        for x, wave in zip((a, b), (own, other) if len(measured) == 2 else (own, own), strict=True)
    ]
    note = f"{own:g} nm alone is compared, the nearest of {len(pairs)} wavelengths to {wavelength_nm:g} nm."
    return sides[0], sides[1], [note]


def instead(own: float, wavelength_nm: float) -> str:
    """A note on a wavelength [nm] that nobody asked for."""
    return f"{own:g} nm is compared instead of {wavelength_nm:g} nm, the nearest there is."


def _measurements(sides: list[Side], say: Say) -> Change:
    """The values of one side against those of the other, carried to its directions; empties the list."""
    (a, b), both = (Compared.of(x) for x in sides), [x.measured for x in sides]
    sides.clear()
    both[1], notes = laid_on(*both)
    notes += [*_unstated({a.name: both[0], b.name: both[1]}), *_cones(*both)]
    known = Interpolations()
    back = _Found.of(carry(both[1], both[0], say, known))  # both at once would be much in memory
    carried, onto, names = carry(both[0], both[1], say, known), "A", (a.name, b.name)
    if _still(_Found.of(carried), back, len(both[0]), len(both[1])) == "B":
        carried, onto, names = carry(both[1], both[0], say, known), "B", (b.name, a.name)
        both.reverse()
    if not carried.rows.size:
        why = describe_left_out(carried.missing)
        raise DataError(f"{a.source} and {b.source} share no direction: of the values of {a.source}, {why}")
    moved = both.pop().covariance
    causes = None if moved is None else moved.causes
    del moved
    at = both.pop().take(carried.rows)
    notes += _interpolated(carried, len(at), *names)
    other = "B" if onto == "A" else "A"
    covariance = _of_difference(at, carried, causes, (onto, other))
    u_carried = np.full(len(at), np.nan)
    if causes is not None:
        u_carried = carried.u
    values = {onto: (at.brdf, at.u), other: (carried.value, u_carried)}
    found = _change(a, b, at, onto, values, covariance, notes=notes, error=carried.error, missing=carried.missing)
    if covariance is None or not carried.interpolated:
        return found
    more = carried.together**2 - carried.random**2
    return replace(found, together=np.sqrt(covariance.random**2 + more))


def laid_on(a: Observations, b: Observations) -> tuple[Observations, list[str]]:
    """B with its plane of incidence turned onto A's, and a note where that was needed."""
    turn = _turn(a, b)
    if not turn:
        return b, []
    off = np.degrees(min(turn, 2 * np.pi - turn))
    note = (
        f"The planes of incidence differ by {off:.3g}° in azimuth; they are laid on each other, as if the sample"
        " had no grain."
    )
    return replace(b, directions=b.directions.turned(turn), unused=b.unused.turned(turn)), [note]


def _unstated(sides: Mapping[str, Observations]) -> list[str]:
    """Who states no uncertainties, which counts as none where the other side states its own."""
    silent = [name for name, x in sides.items() if x.covariance is None]
    end = "." if len(silent) == len(sides) else ": its values count as exact."
    return [f"{name} states no uncertainties{end}" for name in silent]


def _cones(a: Observations, b: Observations) -> list[str]:
    cones = [(x.source_solid_angle_sr, x.receiver_solid_angle_sr) for x in (a, b)]
    if np.allclose(cones[0], cones[1], rtol=0.02):
        return []
    return ["The solid angles of source or receiver differ or are unknown: narrow peaks look different for that alone."]


def _interpolated(carried: Carried, count: int, still: str, moved: str) -> list[str]:
    if not carried.interpolated:
        return []
    share = carried.relative_error[carried.error > 0]
    return [
        f"{carried.interpolated} of {count} values of {moved} are interpolated between measured"
        f" neighbours, in the directions of {still}; the error of that is stated for each (median"
        f" {100 * float(np.median(share)):.2g} %) and part of the uncertainty."
    ]


def _of_difference(
    at: Observations, carried: Carried, moved: Sequence[str] | None, names: tuple[str, str]
) -> Covariance | None:
    """Covariance of the carried values less those where they were carried to; None where neither side states any.

    `moved` names the causes of the carried values; None where nothing is stated of them.

    What causes do is scaled to the mean of both values. A column that goes with noisy values of its own side alone
    would pull the common factor, by n u^2 / 2 for n values and a cause of relative u.
    """
    own = at.covariance
    if own is None and moved is None:
        return None
    random = np.hypot(own.random if own is not None else 0.0, carried.random)
    np.hypot(random, carried.error, out=random)
    for value in (at.brdf, carried.value):  # never 0
        floor = np.abs(value)
        floor *= 1e-6
        np.maximum(random, np.maximum(floor, 1e-300, out=floor), out=random)
    common = [carried.common] if own is None else [own.common, carried.common]
    stated = (() if own is None else own.causes, moved or ())
    causes = [f"{cause} of {side}" for side, of_side in zip(names, stated, strict=True) for cause in of_side]
    whole, middle = np.hstack(common), 0.5 * (at.brdf + carried.value)
    ratios = (ratio_to(middle, *one) for one in ((at.brdf, at.u), (carried.value, carried.u)))
    shares = [(cause, ratio) for of_side, ratio in zip(stated, ratios, strict=True) for cause in of_side]
    for column, (cause, ratio) in zip(whole.T, shares, strict=True):
        if not cause.startswith(ADDED):
            column *= ratio
    return Covariance(random, whole, tuple(causes))


@dataclass(frozen=True)
class _Found:
    """What is known of values that were carried over."""

    count: int
    roughness: float
    """Mean relative error of the interpolation; infinite where nothing was carried."""

    @classmethod
    def of(cls, carried: Carried) -> _Found:
        return cls(carried.rows.size, float(np.mean(carried.relative_error)) if carried.rows.size else np.inf)


def _still(forth: _Found, back: _Found, of_a: int, of_b: int) -> str:
    """In whose directions both are compared.

    Of a side whose few directions the other holds, as a certificate's, all count. Otherwise what was sampled finely is
    interpolated, and not the other.
    """
    if back.count > forth.count and back.count / of_b > 2.0 * forth.count / of_a:
        return "B"
    if forth.count > back.count and forth.count / of_a > 2.0 * back.count / of_b:
        return "A"
    return "B" if back.roughness < 0.5 * forth.roughness else "A"


def _change(
    a: Compared,
    b: Compared,
    at: Observations,
    onto: str,
    values: Mapping[str, tuple[Floats, Floats]],
    covariance: Covariance | None,
    *,
    notes: Sequence[str],
    error: Floats,
    missing: Mapping[str, int],
) -> Change:
    """A comparison, of the values of "A" and "B" with their standard uncertainties [1/sr]."""
    (value_a, u_a), (value_b, u_b) = values["A"], values["B"]
    once = tuple(dict.fromkeys(notes))
    return Change(a, b, at, value_a, value_b, u_a, u_b, error, onto, covariance, dict(missing), once)


def _turn(a: Observations, b: Observations) -> float:
    """Azimuth [rad] that lays B's only plane of incidence on A's; 0 where either has several, or they agree."""
    means = []
    for x in (a, b):
        arrow = np.exp(1j * x.directions.phi_i[x.directions.theta_i > SAME_ANGLE])
        if not arrow.size or np.abs(arrow - arrow[0]).max() > SAME_ANGLE:
            return 0.0
        means.append(float(np.angle(arrow.mean())))
    turn = float(wrap(means[0] - means[1]))
    return 0.0 if min(turn, 2 * np.pi - turn) <= SAME_ANGLE else turn


def _directions(wavelength_nm: float) -> Observations:
    grid = np.meshgrid(
        np.radians(INCIDENCES_DEG), np.radians(np.arange(0.0, 86.0, 2.5)), np.radians(AZIMUTHS_DEG), indexing="ij"
    )
    theta_i, theta_r, phi_r = (x.ravel() for x in grid)
    zero = np.zeros(theta_i.size)
    return Observations(
        directions=Directions(theta_i, zero, theta_r, phi_r), wavelength_nm=np.full(theta_i.size, wavelength_nm),
        brdf=zero, covariance=None, rows=np.arange(theta_i.size),
    )  # fmt: skip
