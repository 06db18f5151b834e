"""A fitted model as a sample file, for `gonio measure`, `convert`, `render`, `compare` and `appearance`."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gonio import disk
from gonio.config import numbers_in, to_toml
from gonio.errors import ConfigError, os_error_as
from gonio.models import Corrected
from gonio.typing import Floats, TomlTable
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.problem import FitRequest

STEP = 1e-5
"""Step of the search scale over which arguments are differentiated: they are smooth functions of few operations."""


def check_target(path: Path, asked: FitRequest) -> None:
    """Raise `ConfigError` for what a sample file cannot hold, and for a place where none can be written."""
    if asked.each:
        raise ConfigError(
            f"--save {path}: a sample file holds one value of {', '.join(asked.each)}, and --each fits one a"
            " wavelength; leave one of the two out"
        )
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


def save(result: FitResult, path: Path, *, name: str, source: str, residual: bool = False) -> None:
    """Write the fitted model as a sample file, whole or not at all; a file that is there is replaced.

    Parameters
    ----------
    result
        A fit without values of their own at several wavelengths.
    path
        Of the sample file, a .toml.
    name
        Of the sample.
    source
        What it was fitted to, for the remark at the top.
    residual
        With the smooth curve of the model's misfit.

    Raises
    ------
    ConfigError
        It cannot be written, or the fit has values of their own at several wavelengths.
    """
    check_target(path, FitRequest(result.name, each=result.problem.each))
    model = "sum" if "+" in result.name else result.name
    tables: TomlTable = {"name": name, "model": model, "parameters": _parameters(result, result.vector)}
    uncertainty = _uncertainty(result)
    if uncertainty is not None and result.misfit is not None and not residual:
        uncertainty["misfit"] = float(f"{result.misfit.tau:.3g}")
    if residual and result.misfit is not None:
        tables["parameters"] = {model: tables["parameters"], "misfit": result.misfit.correction.parameters}
        tables["model"] = Corrected.name
        if uncertainty is not None:
            uncertainty["parameters"] = [f"{model}.{name}" for name in uncertainty["parameters"]]
    if uncertainty is not None:
        tables["uncertainty"] = uncertainty
    at = "" if math.isnan(result.wavelength_nm) else f" at {result.wavelength_nm:g} nm"
    head = " ".join(f"{result.name}, fitted to {source}{at}: {result.verdict}".split())
    with os_error_as(ConfigError, f"--save {path}: cannot be written"):
        disk.write_whole(path, f"# {head}\n{to_toml(tables)}".encode())


def _parameters(result: FitResult, vector: Floats) -> TomlTable:
    """The constructor's arguments at a point of the search, as TOML has them."""
    problem = result.problem
    given = {**problem.family.arguments(problem.values(vector)), **problem.words}
    return {key: _plain(value) for key, value in given.items()}


def _uncertainty(result: FitResult) -> TomlTable | None:
    """Standard uncertainties and correlation of the arguments that the fit found; None where it states none.

    Arguments follow the fitted parameters to first order; those that do not depend on them are exact, and left out.
    """
    if not (result.vector.size and np.all(np.isfinite(result.spread))):
        return None
    best = numbers_in(_parameters(result, result.vector))

    def arguments(vector: Floats) -> Floats:
        moved = numbers_in(_parameters(result, vector))
        return np.array([moved[name] for name in best])

    slope = result.problem.slopes(arguments, result.vector, STEP).T
    covariance = slope @ result.spread @ slope.T
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    moving = np.flatnonzero(u > 0.0)
    if not moving.size:
        return None
    correlation = np.clip(covariance[np.ix_(moving, moving)] / np.outer(u[moving], u[moving]), -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    return {
        "parameters": [list(best)[k] for k in moving],
        "u": [float(f"{u[k]:.6g}") for k in moving],
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
