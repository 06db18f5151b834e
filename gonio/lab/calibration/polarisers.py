"""Extinctions and azimuths of a rig's polarisers from a polarised run over a dielectric whose index is known.

At the Brewster angle a dielectric reflects nothing of p: what is seen there is the polarisers' extinction. In the plane
of the arms it turns nothing of s into p: what d and a show differently is their azimuth. All values of the run are
fitted together by a M b, with M a facet's Mueller matrix by Fresnel's formulas times a factor of each point's own
(roughness, gloss), and the covariance that the reduction states. The surface has to be black: light from below it is
depolarised, and would count as extinction.
"""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from gonio.errors import DataError
from gonio.geometry import Directions
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.reduction.polarised import NUMBERS, known, of_glass
from gonio.lab.rig.polariser_axes import TOWARD_P
from gonio.lab.rig.polarisers import SIDES
from gonio.polarisation import UNPOLARISED, Polarisers, states
from gonio.typing import DataFrame, Floats, TomlTable

UNKNOWN = {"extinction": 0.5, "azimuth": math.radians(10.0)}
"""Standard deviations of what nothing is known of; a polariser of which the run leaves a third of it is left out."""
BREWSTER = math.radians(3.0)
"""Further from the Brewster angle extinctions rest on the index."""


@dataclass(frozen=True)
class FoundPolarisers:
    """What a run tells."""

    values: TomlTable
    """Keys below `polarisers`."""
    names: list[str]
    """Whole paths of those that are uncertain."""
    covariance: Floats
    """In the units of the file."""
    chi_square: float
    freedom: int
    notes: list[str]


def calibrate(run: Run, index: float) -> FoundPolarisers:
    """The polarisers of a run over a black dielectric of a real index.

    Raises
    ------
    DataError
        The run is of unpolarised light, or tells nothing.
    """
    if not run.settings.run.polarisation:
        raise DataError(f"{run.path}: is of unpolarised light; measure with polarisation = [...] in the plan")
    table = brdf.reduce(run)
    table = table[(table["flag"] == "") & (table["polarisation"] != UNPOLARISED)]
    if table.empty:
        raise DataError(f"{run.path}: no polarised value can be used; see the flags of brdf.csv")
    fit = _Fit(table, known(run.description), index)
    parameters, covariance, chi_square = fit.solve()
    values: TomlTable = {}
    names, kept, notes = [], [], fit.notes()
    u = {name: math.sqrt(covariance[k, k]) for k, name in enumerate(fit.names)}
    for side in dict.fromkeys(side for side, _ in fit.names):
        if any(u[side, number] > UNKNOWN[number] / 3.0 for number in NUMBERS):
            notes.append(
                f"the run does not tell polarisers.{side}, of which an azimuth and an extinction look alike in s and "
                "p: measure s, p, d and a there, in the plane of the arms"
            )
    for k, (side, number) in enumerate(fit.names):
        if any(f"polarisers.{side}," in note for note in notes):
            continue
        key, value = number, max(float(parameters[k]), 0.0)
        if number == "azimuth":
            key, mount = "azimuth_deg", run.description.polarisers.on(side)
            assert mount is not None
            value = mount.azimuth_deg + TOWARD_P[side] * math.degrees(float(parameters[k]))
        values.setdefault(side, {})[key] = value
        names.append(f"polarisers.{side}.{key}")
        kept.append(k)
    if not kept:
        raise DataError(f"{run.path}: tells nothing of the polarisers: {'; '.join(notes)}")
    scale = np.array([TOWARD_P[s] * math.degrees(1.0) if n == "azimuth" else 1.0 for s, n in fit.names])
    covariance = (covariance * np.outer(scale, scale))[np.ix_(kept, kept)]
    return FoundPolarisers(values, names, covariance, chi_square, fit.freedom, notes)


class _Fit:
    """Values by extinctions, azimuths and a factor of each point."""

    def __init__(self, table: DataFrame, now: Polarisers, index: float) -> None:
        self._words, self._values = list(table["polarisation"]), table["brdf"].to_numpy(dtype=float)
        at = Directions.from_table(table)
        self._at = at
        self._index = index
        self._matrices = np.stack([of_glass(at[k], index) for k in range(len(at))])
        places = table.groupby(["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "wavelength_nm"], sort=False)
        self._point = places.ngroup().to_numpy()
        self._now = now
        used = {side: {word[k : k + 1] or "u" for word in self._words} for k, side in enumerate(SIDES)}
        self.names = [each for each in itertools.product(SIDES, NUMBERS) if used[each[0]] - {"u"}]
        common = [n for n in table if str(n).startswith("s_") and str(n).split("_")[1] not in SIDES]
        shared = table[common].to_numpy(dtype=float)
        covariance = np.diag(table["u_random"].to_numpy(dtype=float) ** 2) + shared @ shared.T
        self._whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        self.freedom = len(table) - int(self._point.max()) - 1 - len(self.names)

    def notes(self) -> list[str]:
        """What the result rests on."""
        half = 0.5 * np.arccos(np.clip(np.sum(np.prod(self._at.vectors, axis=0), axis=-1), -1.0, 1.0))
        away = float(np.abs(half - math.atan(self._index)).min())
        said = ["the surface is taken for black: what it depolarises counts as extinction"]
        if away > BREWSTER:
            said.append(
                f"no point is nearer to the Brewster angle than {math.degrees(away):.1f} deg: extinctions rest on the "
                "index"
            )
        return said

    def solve(self) -> tuple[Floats, Floats, float]:
        """Parameters in the order of `names`, their covariance, and chi-square."""
        from scipy.optimize import least_squares

        known_of = np.array([UNKNOWN[number] for _, number in self.names])
        start = np.array([getattr(getattr(self._now, side), number) for side, number in self.names])

        def residuals(parameters: Floats) -> Floats:
            return np.concatenate([self._residuals(parameters), parameters / known_of])

        found = least_squares(residuals, start, x_scale=1e-3, xtol=1e-12, ftol=1e-12, gtol=1e-12)
        covariance = np.linalg.inv(found.jac.T @ found.jac)
        return found.x, covariance, float(np.sum(self._residuals(found.x) ** 2))

    def _residuals(self, parameters: Floats) -> Floats:
        polarisers = self._now
        for (side, number), value in zip(self.names, parameters, strict=True):
            one = replace(getattr(polarisers, side), **{number: float(value)})
            polarisers = polarisers._replace(**{side: one})
        light, seen = states(self._words, polarisers)
        shown = np.einsum("ni,nij,nj->n", seen, self._matrices, light)
        # the factors of the points are linear: the best ones are projected out
        design = self._whiten @ (shown[:, None] * (self._point[:, None] == np.arange(self._point.max() + 1)))
        wanted = self._whiten @ self._values
        factors = np.linalg.lstsq(design, wanted)[0]
        return np.asarray(wanted - design @ factors)
