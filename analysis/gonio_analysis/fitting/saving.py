"""A fitted model as a sample file, for `gonio measure`, `convert`, `render` and `compare`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gonio import disk
from gonio.config import to_toml
from gonio.errors import ConfigError
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.problem import FitRequest


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
    if not path.parent.is_dir():
        raise ConfigError(f"--save {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise ConfigError(f"--save {path}: is a folder; a file's name is needed")


def save(result: FitResult, path: Path, *, name: str, source: str) -> None:
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

    Raises
    ------
    ConfigError
        It cannot be written, or the fit has values of their own at several wavelengths.
    """
    check_target(path, FitRequest(result.name, each=result.problem.each))
    problem = result.problem
    given = {**problem.family.arguments(problem.values(result.vector)), **problem.words}
    model = "sum" if "+" in result.name else result.name
    tables = {"name": name, "model": model, "parameters": {key: _plain(value) for key, value in given.items()}}
    at = "" if math.isnan(result.wavelength_nm) else f" at {result.wavelength_nm:g} nm"
    head = " ".join(f"{result.name}, fitted to {source}{at}: {result.verdict}".split())
    try:
        disk.write_whole(path, f"# {head}\n{to_toml(tables)}".encode())
    except OSError as error:
        raise ConfigError(f"--save {path}: cannot be written: {error.strerror or error}") from None


def _plain(value: Any) -> Any:
    """As TOML has it: n + ik is [n, k]."""
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(inner) for inner in value]
    return value
