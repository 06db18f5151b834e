"""Optical constants as the command line gives them: of all samples, or of single ones, and remembered beside a file.

`<name>.ior.toml` beside a table has one key: `ior = "Au"`, or for a file with several samples `ior = {gold = "Au"}`.
For a run it is `RUN/brdf.ior.toml`. A command that `--ior` was right for writes it; one without `--ior` takes it.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from gonio.disk import read_file, write_whole
from gonio.errors import ArgumentError, ConfigError
from gonio.measurement import split

if TYPE_CHECKING:
    from gonio.models.parameters import Ior

KEY = "ior"
EVERY = ""
"""The name that stands for all samples."""


def read_ior(text: str | None) -> Ior:
    """Optical constants from a command line: a complex number, a material's name, or None.

    Raises
    ------
    ConfigError
        Neither a number nor a known material, or a number that no material has.
    """
    if text is None:
        return None
    from gonio import materials

    try:
        value = complex(text.replace(" ", "").replace("i", "j"))
    except ValueError:
        materials.ior(text)
        return text
    if not (0 < value.real < 1e4 and 0 <= value.imag < 1e4):
        raise ConfigError(f"--ior {text}: n is above 0 and k at least 0 (n + ik absorbs with k > 0)")
    return value


@dataclass(frozen=True)
class NamedSample:
    """A sample that a command is about."""

    source: str
    """As the command line names it, or FILE:SAMPLE."""
    name: str

    @property
    def file(self) -> Path:
        """Its table."""
        path = Path(split(self.source)[0])
        return path / "brdf.csv" if path.is_dir() else path

    @property
    def key(self) -> str:
        """Which sample of its file it is; `EVERY` where the command line names none."""
        return split(self.source)[1] or EVERY

    @property
    def beside(self) -> Path:
        """Where its constants are remembered."""
        return self.file.parent / f"{self.file.stem}.ior.toml"

    @property
    def names(self) -> tuple[str, ...]:
        """What --ior may call it, the most telling first."""
        path = Path(split(self.source)[0])
        return self.source, self.name, str(path), path.name, path.stem


@dataclass(frozen=True)
class Constants:
    """What --ior says."""

    texts: Mapping[str, str] = field(default_factory=dict)
    """By the name of a sample; `EVERY` for all others."""

    @classmethod
    def of(cls, given: Sequence[str] | None) -> Constants:
        """Of `--ior Al` and `--ior gold.csv=Au`.

        Raises
        ------
        ConfigError
            Something is said twice of a sample, or a side of "=" is empty; see `read_ior`.
        """
        texts: dict[str, str] = {}
        for one in given or ():
            name, equals, text = (part.strip() for part in one.rpartition("="))
            if equals and not (name and text):
                raise ConfigError(f"--ior {one}: SAMPLE=NAME is needed, as in --ior gold.csv=Au")
            if name in texts:
                raise ConfigError(f"--ior: is given twice for {name or 'all samples'}; say it once")
            read_ior(text)
            texts[name] = text
        return cls(texts)

    @property
    def of_all(self) -> Ior:
        """What it says of samples that it does not name."""
        return read_ior(self.texts.get(EVERY))

    def require_of_all(self, what: str) -> Ior:
        """`of_all`, where nothing has a name; otherwise `ConfigError`: `what` has no samples to name."""
        if named := [name for name in self.texts if name != EVERY]:
            raise ConfigError(
                f"--ior {named[0]}={self.texts[named[0]]}: {what} has no samples to name; give --ior alone"
            )
        return self.of_all

    def given(self, samples: Sequence[NamedSample]) -> list[str | None]:
        """What is said of each sample; None where nothing is.

        Raises
        ------
        ConfigError
            A name is that of no sample.
        """
        known = {name for one in samples for name in one.names}
        for name in self.texts:
            if name != EVERY and name not in known:
                listed = ", ".join(dict.fromkeys(one.source for one in samples))
                raise ConfigError(f"--ior {name}={self.texts[name]}: no sample is called {name}; there are {listed}")
        return [next((self.texts[n] for n in (*one.names, EVERY) if n in self.texts), None) for one in samples]


@dataclass(frozen=True)
class TakenConstants:
    """The constants of samples, in their order."""

    samples: list[NamedSample]
    given: list[str | None]
    """What --ior says of each."""
    remembered: list[str | None]
    """What is taken from beside the file, where --ior says nothing."""

    @classmethod
    def of(cls, constants: Constants, samples: Sequence[NamedSample]) -> TakenConstants:
        """What --ior says of samples, and what their files remember.

        Raises
        ------
        ConfigError
            A name is that of no sample; a file that remembers cannot be read, or holds something else.
        """
        given = constants.given(samples)
        before = [_remembered(one) if text is None else None for one, text in zip(samples, given, strict=True)]
        return cls(list(samples), given, before)

    @property
    def values(self) -> list[Ior]:
        """The constants of each."""
        return [read_ior(g if g is not None else r) for g, r in zip(self.given, self.remembered, strict=True)]

    @property
    def notes(self) -> list[str]:
        """What is said of constants that were remembered."""
        pairs = zip(self.samples, self.remembered, strict=True)
        return [f"{one.name}: --ior {text} is taken from {one.beside}" for one, text in pairs if text is not None]

    def remember(self) -> list[str]:
        """Write what --ior says beside the files, for the next command; what was done, in sentences.

        What stands there stays.
        """
        pairs = zip(self.samples, self.given, strict=True)
        return [said for one, text in pairs if text is not None and (said := _remember(one, text))]


def _stored(file: Path) -> dict[str, str]:
    """What a file that remembers says, by sample."""
    if not os.path.lexists(file):
        return {}
    try:
        found = tomllib.loads(read_file(file).decode())
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{file}: is not valid TOML: {error}") from None
    said = found.get(KEY)
    every = said if isinstance(said, dict) else {EVERY: said}
    named = {str(name): text for name, text in every.items() if isinstance(text, str) and text}
    if set(found) != {KEY} or len(named) < len(every):
        raise ConfigError(f'{file}: one key is needed, as {KEY} = "Au", or {KEY} = {{gold = "Au"}} by sample')
    return named


def _remembered(one: NamedSample) -> str | None:
    stored = _stored(one.beside)
    text = stored.get(one.key, stored.get(one.name, stored.get(EVERY)))
    if text is not None:
        try:
            read_ior(text)
        except (ConfigError, ArgumentError) as error:
            raise ConfigError(f"{one.beside}: {error}") from None
    return text


def _remember(one: NamedSample, text: str) -> str:
    """What was done, in a sentence; "" where nothing was."""
    import tomli_w

    file = one.beside
    if not one.file.is_file():
        return ""
    stored = _stored(file)
    before = stored.get(one.key, stored.get(EVERY))
    if before is not None or (stored and one.key == EVERY):
        return "" if before == text else f"{file} says otherwise than --ior, which went before it; it is left as it is"
    named = stored | {one.key: text}
    held = {KEY: text if one.key == EVERY else named}
    try:
        write_whole(file, ("# Optical constants; --ior named them.\n" + tomli_w.dumps(held)).encode())
    except OSError as error:
        return f"{file}: --ior cannot be remembered there: {error.strerror}"
    return f"{file} now has --ior {text}: every command takes it for {one.name} without --ior"
