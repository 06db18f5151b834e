"""Where tests find what is not beside them."""

import os
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
REFERENCE = ROOT / "tests" / "reference"
SHARED_DATA = Path(os.environ.get("GONIO_SHARED_DATA", ROOT / ".." / "shared" / "data"))
"""Measured data that are not part of the project."""


def measured(name: str) -> Path:
    """A file or folder of the measured data, by its path below them.

    Where it cannot be read the test is skipped, and says why. In continuous integration (`CI=true`) it fails instead
    as soon as the data folder is there: a check that the data are meant for must not fall silent.
    """
    path = SHARED_DATA / name
    try:
        if path.is_dir():
            next(path.iterdir())
        else:
            with path.open("rb") as stream:
                stream.read(1)
    except (OSError, StopIteration) as error:
        said = f"no measured data at {path}: {error or 'the folder is empty'}"
        if os.environ.get("CI", "").lower() in ("1", "true") and SHARED_DATA.is_dir():
            pytest.fail(said)
        pytest.skip(said)
    return path


def example(name: str) -> str:
    """A whole file of docs/examples."""
    return (ROOT / "docs" / "examples" / name).read_text(encoding="utf-8")


def fenced(page: Path, language: str, holding: str) -> str:
    """The one fenced block of a page that holds a text."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    (found,) = (block for block in blocks if holding in block)
    return str(found)
