"""The words of a table's column `polarisation`: which light fell on the sample, and through what it was looked at.

A word is "unpolarised"; or a letter, the light's state, with a receiver that takes all polarisations; or two letters,
the light's and the analyser's. "u" is unpolarised light, or no analyser. A capital in the second place is a Stokes
parameter of the reflected light: the difference of what two analysers pass. One in the first place is what changes
with that Stokes parameter of the light: "QU" is the element of a Mueller matrix in the row of U and the column of Q.
"""

from collections.abc import Sequence

import numpy as np

from gonio.typing import Floats

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


def states(words: Sequence[str]) -> tuple[Floats, Floats]:
    """The light's Stokes vectors and the analysers' rows, (n, 4) each, of n `WORDS`."""
    found = {word: stokes(word) for word in set(words)}
    return np.array([found[w][0] for w in words]), np.array([found[w][1] for w in words])
