"""Sample files: what a simulated rig measures, and models that a person names."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from gonio.config import load, parse
from gonio.errors import ConfigError
from gonio.samples.description import SampleDescription
from gonio.samples.regions import SampleRegion, check
from gonio.samples.textures import SampleTexture

if TYPE_CHECKING:
    from gonio.models import Model


def shipped_samples() -> dict[str, str]:
    """The sample files that come with the program, as text, by name."""
    found = (entry for entry in (files("gonio") / "samples").iterdir() if entry.name.endswith(".toml"))
    return {entry.name.removesuffix(".toml"): entry.read_text(encoding="utf-8") for entry in found}


def load_sample(path: str | Path, *, uniform: bool = False) -> SampleDescription:
    """Read a sample file, or one of `shipped_samples` by its name, and check that its model takes its parameters.

    `uniform` is for who needs one model: a sample with textures or regions is then refused.

    Raises
    ------
    ConfigError
        The file, its model, one of its parameters, textures or regions is wrong; the message names file and key.
    """
    path = Path(path)
    if not path.suffix and len(path.parts) == 1 and not path.exists():
        shipped = shipped_samples()
        if path.name not in shipped:
            known = ", ".join(sorted(shipped))
            raise ConfigError(f"{path}: there is no such file, and no shipped sample of this name: {known}")
        sample = parse(SampleDescription, tomllib.loads(shipped[path.name]), path)
    else:
        sample = load(SampleDescription, path)
    if uniform and (sample.texture or sample.region):
        what = f"[texture.{next(iter(sample.texture))}]" if sample.texture else "[[region]]"
        rest = "texture" if sample.texture else "regions"
        raise ConfigError(f"{path}: {what}: one model is needed here, alike all over; leave the {rest} out")
    _check_parameters(sample, f"{path}: ")
    regions = tuple(_filled(one, path, f"{path}: region[{k}]") for k, one in enumerate(sample.region, 1))
    mask = sample.mask.beside(path, f"{path}: mask") if sample.mask is not None else None
    check(regions, mask, f"{path}: ")
    update = {"texture": _beside(sample.texture, path, f"{path}: "), "region": regions, "mask": mask}
    sample = sample.model_copy(update=update)
    _check_textures(sample, f"{path}: ")
    return sample


def _filled(region: SampleRegion, path: Path, where: str) -> SampleRegion:
    """A region with its own material, checked, whether that stands in the file or in another one."""
    if region.file is not None:
        told = f'{where}.file = "{region.file}"'
        other = path.parent / region.file
        if not other.exists():
            raise ConfigError(f"{told}: there is no such file; it lies beside the sample file")
        sample = load_sample(other)
        if sample.region:
            raise ConfigError(f"{told}: has regions itself; a region is of one material: name the file of one")
        return region.filled(sample)
    textures = _beside(region.texture, path, f"{where}.")
    region = region.model_copy(update={"texture": textures})
    try:
        sample = SampleDescription(
            name=region.name, model=region.model, parameters=region.parameters, texture=region.texture
        )
    except ValidationError as error:
        raise ConfigError(f"{where}: {error.errors()[0]['msg'].removeprefix('Value error, ')}") from None
    _check_parameters(sample, f"{where} ")
    _check_textures(sample, f"{where} ")
    return region


def _beside(textures: dict[str, SampleTexture], path: Path, where: str) -> dict[str, SampleTexture]:
    return {name: one.beside(path, f"{where}texture.{name}") for name, one in textures.items()}


def load_model(path: str | Path) -> tuple[Model, SampleDescription]:
    """The model of a sample file without textures and regions, and the file; raises as `load_sample`."""
    from gonio import models

    sample = load_sample(path, uniform=True)
    return models.build(sample.model, sample.parameters), sample


def _check_parameters(sample: SampleDescription, where: str) -> None:
    from gonio import models

    try:
        models.build(sample.model, sample.parameters)
    except ConfigError as error:
        raise ConfigError(f"{where}[parameters] of model = {sample.model!r}: {error}") from None


def _check_textures(sample: SampleDescription, where: str) -> None:
    """Each texture's two ends, where the others are 0."""
    from gonio import models

    for name in sample.texture:
        for share, key in ((0.0, "low"), (1.0, "high")):
            shares = dict.fromkeys(sample.texture, 0.0) | {name: share}
            try:
                models.build(sample.model, sample.parameters_at(shares))
            except ConfigError as error:
                raise ConfigError(f"{where}[texture.{name}] {key}: {error}") from None
