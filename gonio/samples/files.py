"""Sample files: what a simulated rig measures, and models that a person names."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from gonio.config import load, parse
from gonio.errors import ConfigError
from gonio.samples.description import SampleDescription

if TYPE_CHECKING:
    from gonio.models import Model


def shipped_samples() -> dict[str, str]:
    """The sample files that come with the program, as text, by name."""
    found = (entry for entry in (files("gonio") / "samples").iterdir() if entry.name.endswith(".toml"))
    return {entry.name.removesuffix(".toml"): entry.read_text(encoding="utf-8") for entry in found}


def load_sample(path: str | Path, *, uniform: bool = False) -> SampleDescription:
    """Read a sample file, or one of `shipped_samples` by its name, and check that its model takes its parameters.

    `uniform` is for who needs one model: a sample with textures is then refused.

    Raises
    ------
    ConfigError
        The file, its model, one of its parameters or textures is wrong; the message names file and key.
    """
    from gonio import models

    path = Path(path)
    if not path.suffix and len(path.parts) == 1 and not path.exists():
        shipped = shipped_samples()
        if path.name not in shipped:
            known = ", ".join(sorted(shipped))
            raise ConfigError(f"{path}: there is no such file, and no shipped sample of this name: {known}")
        sample = parse(SampleDescription, tomllib.loads(shipped[path.name]), path)
    else:
        sample = load(SampleDescription, path)
    if uniform and sample.texture:
        name = next(iter(sample.texture))
        raise ConfigError(f"{path}: [texture.{name}]: one model is needed here, alike all over; leave the texture out")
    textures = {name: one.beside(path, f"{path}: texture.{name}") for name, one in sample.texture.items()}
    sample = sample.model_copy(update={"texture": textures})
    try:
        models.build(sample.model, sample.parameters)
    except ConfigError as error:
        raise ConfigError(f"{path}: [parameters] of model = {sample.model!r}: {error}") from None
    _check_textures(sample, path)
    return sample


def load_model(path: str | Path) -> tuple[Model, SampleDescription]:
    """The model of a sample file without textures, and the file; raises as `load_sample`."""
    from gonio import models

    sample = load_sample(path, uniform=True)
    return models.build(sample.model, sample.parameters), sample


def _check_textures(sample: SampleDescription, path: Path) -> None:
    """Each texture's two ends, where the others are 0."""
    from gonio import models

    for name in sample.texture:
        for share, key in ((0.0, "low"), (1.0, "high")):
            shares = dict.fromkeys(sample.texture, 0.0) | {name: share}
            try:
                models.build(sample.model, sample.parameters_at(shares))
            except ConfigError as error:
                raise ConfigError(f"{path}: [texture.{name}] {key}: {error}") from None
