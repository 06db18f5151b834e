"""What compiled code on disk is held by: the code of a function and of all that it calls, and nothing else."""

from __future__ import annotations

import pkgutil
import textwrap
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import pytest
from gonio_maps.models import _batch_gram, _batch_loops

import gonio.models
from gonio.models import Lambert, _compile
from gonio.models._compile import device, fingerprint, table

MODULES = [f"gonio.models.{module.name}" for module in pkgutil.iter_modules(gonio.models.__path__)]
CODE = """
    from math import sqrt

    import numpy as np

    SCALE = 2.0

    @table
    def nodes():
        return np.array([1.0, 3.0])

    @device
    def inner(x):
        return x * SCALE + 1.5

    @njit(fastmath={"contract", "nsz"})
    def middle(x):
        return inner(x) + nodes()[0]

    def outer(x):
        total = sqrt(x)
        for part in [middle(y) for y in (x, 2.0)]:
            total += part
        return total
"""


def of(*changes: tuple[str, str]) -> str:
    """The fingerprint of `outer`, with changes in the text."""
    text = textwrap.dedent(CODE)
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    made = ModuleType("made")
    made.__dict__.update(device=device, table=table, njit=numba.njit)
    exec(text, made.__dict__)
    return fingerprint(made.__dict__["outer"])


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("def inner(x):", 'def inner(x):\n    """Words."""'),
        ("def outer(x):", 'def outer(x):\n    """Words."""\n    # and more of them'),
        ("SCALE = 2.0", "SCALE = 2.0\nUNUSED = 3.0"),
        ("import numpy as np", "import numpy as np\n\n"),
    ],
)
def test_words_and_what_is_not_called_do_not_count(before: str, after: str) -> None:
    assert of((before, after)) == of()


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("SCALE = 2.0", "SCALE = 2.5"),
        ("+ 1.5", "+ 1.25"),
        ("x * SCALE", "x / SCALE"),
        ("[1.0, 3.0]", "[1.0, 4.0]"),
        ('{"contract", "nsz"}', '{"contract"}'),
        ("sqrt(x)", "abs(x)"),
        ("(x, 2.0)", "(x, 3.0)"),
        ("nodes()[0]", "nodes()[1]"),
    ],
)
def test_what_the_code_does_at_any_depth_counts(before: str, after: str) -> None:
    assert of((before, after)) != of()


def test_what_makes_machine_code_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    before = of()
    monkeypatch.setattr(_compile, "_made_by", lambda: (b"another compiler",))
    assert of() != before


def test_no_kernel_refers_to_what_cannot_be_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every file of the folder would count with it, and a word in one would compile all models again."""

    def refused(folder: Any, pattern: str) -> None:
        raise AssertionError(f"a fingerprint of {folder}/{pattern}")

    of()
    monkeypatch.setattr(Path, "glob", refused)
    with pytest.raises(AssertionError):
        fingerprint(Lambert)
    for function in (_batch_loops.fit_pixels, _batch_gram.examine):
        assert len(fingerprint(function)) == 16
    every = {obj for module in MODULES for obj in vars(import_module(module)).values() if hasattr(obj, "__device__")}
    assert len(every) > 40
    for function in every:
        assert len(fingerprint(_compile._clone(function, {}))) == 16, function
