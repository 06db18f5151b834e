"""The words of a table's column `polarisation`: which light fell on the sample, and through what it was looked at.

A word is "unpolarised"; or a letter, the light's state, with a receiver that takes all polarisations; or two letters,
the light's and the analyser's. "u" is unpolarised light, or no analyser. A capital in the second place is a Stokes
parameter of the reflected light: the difference of what two analysers pass. One in the first place is what changes
with that Stokes parameter of the light: "QU" is the element of a Mueller matrix in the row of U and the column of Q.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np

from gonio.errors import DataError
from gonio.typing import ArrayLike, Floats

STATES = {
    "u": (1.0, 0.0, 0.0, 0.0),
    "s": (1.0, 1.0, 0.0, 0.0),
    "p": (1.0, -1.0, 0.0, 0.0),
    "d": (1.0, 0.0, 1.0, 0.0),
    "a": (1.0, 0.0, -1.0, 0.0),
    "r": (1.0, 0.0, 0.0, 1.0),
    "l": (1.0, 0.0, 0.0, -1.0),
}
"""Stokes vectors of intensity 1 by letter, on the bases of docs/conventions.md."""
PARAMETERS = "IQUV"
UNPOLARISED = "unpolarised"
MUELLER = {f"m{i}{j}": PARAMETERS[j] + PARAMETERS[i] for i in range(4) for j in range(4) if i or j}
"""The word of each element of a Mueller matrix but the first, by its column in a table."""
WORDS = (
    UNPOLARISED,
    *(state for state in STATES if state != "u"),
    *(light + seen for light in STATES for seen in (*STATES, *PARAMETERS) if light + seen not in ("uu", "uI")),
    *MUELLER.values(),
)
"""Every word of the column."""
SAID = (
    '"unpolarised", a letter for the light (s, p; d, a: +45 and -45 degrees; r, l: circular), or two for light and '
    "analyser (ss, sp, ... with u for none; Q, U, V: that Stokes parameter)"
)


def stokes(word: str) -> tuple[Floats, Floats]:
    """The light's Stokes vector and the analyser's row, (4,), of one of `WORDS`.

    An analyser passes half of unpolarised light: what "ss" and "sp" are together "s" is.
    """
    if word == UNPOLARISED:
        word = "uu"
    light = np.eye(4)[PARAMETERS.index(word[0])] if word[0] in PARAMETERS else np.array(STATES[word[0]])
    seen = word[1:] or "u"
    if seen in PARAMETERS:
        return light, np.eye(4)[PARAMETERS.index(seen)]
    return light, np.array(STATES[seen]) * (1.0 if seen == "u" else 0.5)


def ray_axes(theta: ArrayLike, phi: ArrayLike, *, incident: bool) -> tuple[Floats, Floats, Floats]:
    """The way that light goes on the ray of a direction [rad], and its axes s and p: unit vectors, (..., 3) each.

    k is the way, s = k x z over its length, also along the normal, where it follows phi; p = s x k.
    """
    theta, phi = np.broadcast_arrays(theta, phi)
    sense = -1.0 if incident else 1.0
    k = sense * np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    s = sense * np.stack([np.sin(phi), -np.cos(phi), np.zeros(phi.shape)], axis=-1)
    return k, s, np.cross(s, k)


@dataclass(frozen=True)
class Polariser:
    """A polariser that is not perfect, and how well it is known (k = 1)."""

    extinction: float = 0.0
    """Smallest over largest transmittance for linearly polarised light, in [0, 1]; 0 is perfect."""
    azimuth: float = 0.0
    """How far its axis is turned beside what a word says, from s toward p [rad]."""
    u_extinction: float = 0.0
    u_azimuth: float = 0.0

    @classmethod
    def of(cls, stated: object, where: str) -> Self:
        """From `extinction`, `azimuth_deg`, `u_extinction` and `u_azimuth_deg` of a table's attributes.

        Raises
        ------
        DataError
            There is another key, or a value is no number in its range; `where` names the place.
        """
        numbers = dict(stated) if isinstance(stated, Mapping) else {"": stated}
        out = {}
        for key, value in numbers.items():
            name = str(key).removesuffix("_deg")
            known = name in ("extinction", "u_extinction") or key in ("azimuth_deg", "u_azimuth_deg")
            if not known or isinstance(value, bool) or not isinstance(value, int | float):
                keys = "extinction, azimuth_deg, u_extinction, u_azimuth_deg"
                raise DataError(f"{where}: {key!r} = {value!r}; a number for each of {keys} is needed, or none")
            low, high = (0.0, 1.0) if "extinction" in name else (-90.0 if name == "azimuth" else 0.0, 90.0)
            if not low <= value <= high:
                raise DataError(f"{where}: {key} = {value:g} is outside [{low:g}, {high:g}]")
            out[name] = math.radians(value) if "azimuth" in name else float(value)
        return cls(**out)

    def passed(self, ideal: Floats) -> Floats:
        """What it makes of a Stokes vector or an analyser's row (4,) that a perfect one has."""
        cos, sin = math.cos(2.0 * self.azimuth), math.sin(2.0 * self.azimuth)
        share = (1.0 - self.extinction) / (1.0 + self.extinction)
        i, q, u, v = ideal
        return np.array([i, share * (q * cos - u * sin), share * (q * sin + u * cos), share * v])


class Polarisers(NamedTuple):
    """Those in front of the light and in front of the receiver."""

    light: Polariser = Polariser()
    receiver: Polariser = Polariser()

    @classmethod
    def of(cls, attributes: Mapping[Any, Any]) -> Self:
        """Those that a table states in its attribute `polarisers`, by `light` and `receiver`; else perfect ones."""
        stated = attributes.get("polarisers") or {}
        if not isinstance(stated, Mapping) or not {*stated} <= {*cls._fields}:
            raise DataError(f"polarisers = {stated!r} of the table: a table for light, for receiver, or both is needed")
        return cls(**{name: Polariser.of(one, f"polarisers.{name} of the table") for name, one in stated.items()})

    def moved(self, which: str, number: str, by: float) -> Self:
        """With one number of one of them changed."""
        one = getattr(self, which)
        return self._replace(**{which: replace(one, **{number: getattr(one, number) + by})})


PERFECT = Polarisers()


def states(words: Sequence[str], polarisers: Polarisers = PERFECT) -> tuple[Floats, Floats]:
    """The light's Stokes vectors and the analysers' rows, (n, 4) each, of n `WORDS`.

    A polariser that is not perfect stands where the word has a letter for one: not for unpolarised light, no analyser,
    or an element of a matrix.
    """
    found = {}
    for word in set(words):
        light, seen = stokes(word)
        if word != UNPOLARISED and word[0] not in PARAMETERS:
            light = polarisers.light.passed(light)
        if word != UNPOLARISED and word[1:].islower():
            seen = polarisers.receiver.passed(seen)
        found[word] = light, seen
    return np.array([found[w][0] for w in words]), np.array([found[w][1] for w in words])
