"""A fitted model as a sample file, for `gonio measure`, `convert`, `render`, `compare` and `appearance`."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gonio import disk
from gonio.config import numbers_in, to_toml, with_numbers
from gonio.errors import ConfigError, DataError, os_error_as
from gonio.models import Corrected
from gonio.spectra import RGB_NM
from gonio.typing import Floats, Ints, TomlTable
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.problem import FitRequest, Problem, pose

STEP = 1e-5
"""Step of the search scale over which arguments are differentiated: they are smooth functions of few operations."""


def check_target(path: Path) -> None:
    """Raise `ConfigError` for a place where no sample file can be written."""
    if path.suffix != ".toml":
        raise ConfigError(f'--save {path}: other commands know a sample file by the ending ".toml"')
    disk.require_name(path)
    disk.require_not_measured(path)
    if not path.parent.is_dir():
        raise ConfigError(f"--save {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise ConfigError(f"--save {path}: is a folder; a file's name is needed")


def check_residual(path: Path | None, asked: FitRequest) -> None:
    """Raise `ConfigError` where there is no misfit to keep, or no place for it."""
    if path is None:
        raise ConfigError("--residual: keeps the misfit in a sample file; say where with --save SAMPLE.toml")
    if asked.each is not None:
        raise ConfigError("--residual: the misfit is that of one wavelength; leave out --joint")
    if asked.metric is not None or asked.loss != "linear":
        chosen = f"--metric {asked.metric}" if asked.metric is not None else f"--loss {asked.loss}"
        raise ConfigError(f"--residual: {chosen} knows no misfit; leave one of the two out")


def save(
    result: FitResult,
    path: Path,
    *,
    name: str,
    source: str,
    others: Sequence[FitResult] = (),
    residual: bool = False,
) -> None:
    """Write the fitted model as a sample file, whole or not at all; a file that is there is replaced.

    What differs from wavelength to wavelength becomes a spectrum, or the values of the channels red, green and blue.
    Standard uncertainties and correlations are those of the fit. Of fits that are one a wavelength, errors of what each
    has of its own are taken as independent, given what they share: so they are, but for causes that are common to
    values of different wavelengths.

    Parameters
    ----------
    result
        The fit that is reported.
    path
        Of the sample file, a .toml.
    name
        Of the sample.
    source
        What it was fitted to, for the remark at the top.
    others
        The same at other wavelengths, as `gonio_analysis.fitting.spectrum.fit_every` has them.
    residual
        With the smooth curve of the model's misfit, which is that of `result`: others do not count.

    Raises
    ------
    ConfigError
        It cannot be written.
    DataError
        A channel has no fit.
    """
    check_target(path)
    of_channels = result.data.of_channels
    every = sorted([result, *others], key=lambda one: one.wavelength_nm, reverse=of_channels)  # red first
    fits = [result] if residual else every
    found = _of_one(result) if result.problem.waves else _of_fits(fits)
    numbers = _Numbers(found, of_channels and len(found.waves) > 1)
    model = "sum" if "+" in result.name else result.name
    tables: TomlTable = {"name": name, "model": model, "parameters": numbers.tables}
    uncertainty = numbers.uncertainty()
    taus = [one.misfit.tau for one in fits if one.misfit is not None]
    if uncertainty is not None and taus and not residual:
        uncertainty["misfit"] = float(f"{max(taus):.3g}")
    if residual and result.misfit is not None:
        tables["parameters"] = {model: tables["parameters"], "misfit": result.misfit.correction.parameters}
        tables["model"] = Corrected.name
        if uncertainty is not None:
            uncertainty["parameters"] = [f"{model}.{name}" for name in uncertainty["parameters"]]
    if uncertainty is not None:
        tables["uncertainty"] = uncertainty
    at = "" if math.isnan(result.wavelength_nm) else f" at {result.wavelength_nm:g} nm"
    several = len(found.waves)
    at = f" at {several} wavelengths;{at or ' together'}" if several > 1 else at
    head = " ".join(f"{result.name}, fitted to {source}{at}: {result.verdict}".split())
    with os_error_as(ConfigError, f"--save {path}: cannot be written"):
        disk.write_whole(path, f"# {head}\n{to_toml(tables)}".encode())


@dataclass(frozen=True)
class _Found:
    """The parameters of fits at one or several wavelengths."""

    problem: Problem
    """Of one wavelength."""
    waves: Sequence[float]
    """[nm]"""
    index: Sequence[Ints]
    """Where the parameters of each wavelength stand in `vector`."""
    vector: Floats
    spread: Floats


def _of_one(result: FitResult) -> _Found:
    """Of one fit of several wavelengths together."""
    problem = pose(replace(result.problem.asked, each=None))
    waves = sorted(result.problem.waves, reverse=result.data.of_channels)
    place = {name: k for k, name in enumerate(result.free)}
    index = [
        np.array([place[f"{n}@{wave:g}" if n in result.problem.each else n] for n in problem.free]) for wave in waves
    ]
    return _Found(problem, waves, index, result.vector, result.spread)


def _of_fits(fits: Sequence[FitResult]) -> _Found:
    """Of fits of one wavelength each, which may share some parameters."""
    from scipy.linalg import block_diag

    free = fits[0].free
    common = fits[0].shared.parameters if fits[0].shared is not None else ()
    shared = np.array([k for k, n in enumerate(free) if n in common], dtype=np.intp)
    own = np.array([k for k, n in enumerate(free) if n not in common], dtype=np.intp)
    inner = np.mean([one.spread[np.ix_(shared, shared)] for one in fits], axis=0)
    pulled, apart, index = [np.eye(shared.size)], [np.zeros_like(inner)], list[Ints]()
    for number, one in enumerate(fits):
        place = np.zeros(len(free), dtype=np.intp)
        place[shared] = np.arange(shared.size)
        place[own] = shared.size + number * own.size + np.arange(own.size)
        index.append(place)
        of_shared, across = one.spread[np.ix_(shared, shared)], one.spread[np.ix_(own, shared)]
        pulled.append(across @ np.linalg.pinv(of_shared))
        apart.append(one.spread[np.ix_(own, own)] - pulled[-1] @ across.T)
    vector = np.concatenate([fits[0].vector[shared], *(one.vector[own] for one in fits)])
    follows = np.concatenate(pulled)
    spread = follows @ inner @ follows.T + np.asarray(block_diag(*apart))
    return _Found(fits[0].problem, [one.wavelength_nm for one in fits], index, vector, spread)


class _Numbers:
    """The numbers of a sample file: those that are the same at all wavelengths, and of others a value at each."""

    def __init__(self, found: _Found, of_channels: bool) -> None:
        self._found = found
        tables = [self._arguments(found.vector[index]) for index in found.index]
        values = [numbers_in(one) for one in tables]
        self._paths = list(values[0])
        self._changing = [path for path in self._paths if any(one[path] != values[0][path] for one in values)]
        self._colours = [] if not of_channels else [c for w in found.waves for c, nm in RGB_NM.items() if nm == w]
        if of_channels and set(self._colours) != set(RGB_NM):
            raise DataError(f"a sample of channels needs a fit of each, and there are: {', '.join(self._colours)}")
        spectra = {path: self._spectrum([one[path] for one in values]) for path in self._changing}
        self.tables: TomlTable = with_numbers(tables[0], spectra)
        """The table [parameters]."""

    def _arguments(self, vector: Floats) -> TomlTable:
        """The constructor's arguments at a point of the search at one wavelength, as TOML has them."""
        problem = self._found.problem
        given = {**problem.family.arguments(problem.values(vector)), **problem.words}
        return {key: _plain(value) for key, value in given.items()}

    def _spectrum(self, values: Sequence[float]) -> TomlTable:
        if self._colours:
            known = dict(zip(self._colours, values, strict=True))
            return {colour: known[colour] for colour in RGB_NM}
        return {"wavelength_nm": list(self._found.waves), "value": list(values)}

    def _name(self, path: str, k: int) -> str:
        """What the file calls the k-th value of a number."""
        if path not in self._changing:
            return path
        return f"{path}.{self._colours[k]}" if self._colours else f"{path}.value[{k}]"

    def uncertainty(self) -> TomlTable | None:
        """Standard uncertainties and correlation of the arguments that the fit found; None where it states none.

        Arguments follow the fitted parameters to first order; those that do not depend on them are exact, and left out.
        """
        found = self._found
        if not (found.vector.size and np.all(np.isfinite(found.spread))):
            return None

        def arguments(vector: Floats) -> Floats:
            return np.array(list(numbers_in(self._arguments(vector)).values()))

        by_wave = [found.problem.slopes(arguments, found.vector[at], STEP).T for at in found.index]
        names, rows = list[str](), list[Floats]()
        for row, path in enumerate(self._paths):
            for k in range(len(found.waves)) if path in self._changing else [0]:
                names.append(self._name(path, k))
                rows.append(np.zeros(found.vector.size))
                rows[-1][found.index[k]] = by_wave[k][row]
        slope = np.array(rows)
        covariance = slope @ found.spread @ slope.T
        moving = np.flatnonzero(np.diag(covariance) > 0.0)
        if not moving.size:
            return None
        u = np.sqrt(np.diag(covariance))[moving]
        correlation = np.clip(covariance[np.ix_(moving, moving)] / np.outer(u, u), -1.0, 1.0)
        np.fill_diagonal(correlation, 1.0)
        return {
            "parameters": [names[k] for k in moving],
            "u": [float(f"{one:.6g}") for one in u],
            "correlation": np.round(correlation, 12).tolist(),  # strongly correlated parameters need them all
        }


def _plain(value: Any) -> Any:
    """As TOML has it: n + ik is [n, k]."""
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(inner) for inner in value]
    return value
