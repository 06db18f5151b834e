"""How far the fits of many models are, and how long those may take that are left."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

from gonio.progress import QUIET_S, Say, duration
from gonio_analysis.fitting import parameters
from gonio_analysis.selection.judging import Candidate

AFTER, AFTER_EACH_S = 0.2, 0.1
"""What comes after the fits: a part of their time, and seconds for each model, whatever the number of values."""
CURVES, FIGURES = 0.35, 0.5
"""Parts of that: curves and reflectances of models, and figures; predictions of values left out are the rest."""


def after(fits_s: float, models: int) -> float:
    """Seconds that may pass from the last fit until a comparison's page is there."""
    return AFTER * fits_s + AFTER_EACH_S * models


def foretold(
    taken: Mapping[Candidate, float], left: Iterable[Candidate], sizes: Mapping[Candidate, int]
) -> dict[Candidate, float]:
    """Seconds that each of the fits that are left may take.

    It takes as long as a relative that is done, times the square of the ratio of their parameters: the same with k = 0,
    or with one slope, or a sum's gloss alone. What is of its kind (with k, a sum, both) tells by what factor that is
    off. One without a relative takes as long as all that are done, by the square of its parameters.

    Parameters
    ----------
    taken
        Seconds of the fits that are done, one at least.
    left, sizes
        The others; and how many parameters all of them fit.
    """
    one = sum(taken.values()) / len(taken)
    rate = sum(taken.values()) / sum(sizes[c] ** 2 for c in taken)

    def by_relative(candidate: Candidate) -> float | None:
        found = next((c for c in _relatives(candidate) if c in taken), None)
        return None if found is None else taken[found] * (sizes[candidate] / sizes[found]) ** 2

    # of each kind, what is known of it counts as against one fit that took as long as was said
    was, said = defaultdict[tuple[bool, bool], float](lambda: one), defaultdict[tuple[bool, bool], float](lambda: one)
    for candidate in taken:
        if (seconds := by_relative(candidate)) is not None:
            was[_kind(candidate)] += taken[candidate]
            said[_kind(candidate)] += seconds
    out = {}
    for candidate in left:
        seconds, kind = by_relative(candidate), _kind(candidate)
        out[candidate] = rate * sizes[candidate] ** 2 if seconds is None else seconds * was[kind] / said[kind]
    return out


def _relatives(candidate: Candidate) -> list[Candidate]:
    """Simpler candidates that take about as long for each parameter, the nearest first."""
    terms = parameters.parts(candidate.model)
    found = [replace(candidate, free=()), replace(candidate, slopes=1)]
    if len(terms) > 1:
        found += [Candidate(terms[1], candidate.free), Candidate(terms[1])]
    return [c for c in found if c != candidate]


def _kind(candidate: Candidate) -> tuple[bool, bool]:
    return "k" in candidate.free, len(parameters.parts(candidate.model)) > 1 or candidate.slopes > 1


class Begun:
    """Tells which model is begun, and how long those may take that are left (`foretold`).

    A job says the label of its model when it begins, and again when it ends. Nothing is foretold before the first with
    n and k is done, whose ways are the longest.
    """

    def __init__(
        self, name: str, sizes: Mapping[Candidate, int], progress: Say, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self._name, self._sizes, self._progress, self._clock = name, sizes, progress, clock
        self._left = {c.label: c for c in sizes}
        self._slow = any("k" in c.free for c in sizes)
        self._running, self._taken = dict[str, float](), dict[Candidate, float]()
        self._many, self._number, self._began = len(sizes), 0, clock()

    def skip(self, candidate: Candidate) -> None:
        """This one is not fitted."""
        self._left.pop(candidate.label)
        self._number += 1

    def __call__(self, label: str) -> None:
        """A model is begun, or has ended; what others say of their work is not passed on."""
        if label in self._running:
            self._taken[self._left.pop(label)] = self._clock() - self._running.pop(label)
        elif label in self._left:
            now = self._clock()
            known = bool(self._taken) and (not self._slow or any("k" in c.free for c in self._taken))
            left = f", about {duration(self.left(now))} left" if known and now - self._began > QUIET_S else ""
            self._running[label] = now
            self._number += 1
            many = f" ({self._number} of {self._many}{left})" if self._many > 1 else ""
            self._progress(f"{self._name}: fitting {label}{many}")

    def left(self, now: float) -> float:
        """Seconds from `now` on until figures are drawn, by as many fits at a time as there were."""
        running = {self._left[label]: now - began for label, began in self._running.items()}
        rest = foretold(self._taken, self._left.values(), self._sizes)
        rest = {c: max(seconds - running.get(c, 0.0), 0.0) for c, seconds in rest.items()}
        at_a_time = (sum(self._taken.values()) + sum(running.values())) / (now - self._began)
        fits = max(sum(rest.values()) / at_a_time, *rest.values())
        return fits + after(now - self._began + fits, self._many)
