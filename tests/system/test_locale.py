"""A decimal comma of the system's language changes no digit of what is written."""

import locale
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from gonio import measurement
from gonio.models import build
from tests.gonio_analysis.synthetic import measure

from .conftest import HANGS_S, environment

COMMA = ("de_DE.UTF-8", "fr_FR.UTF-8", "de_DE.utf8", "fr_FR.utf8")
CODE = "import locale; locale.setlocale(locale.LC_ALL, ''); from gonio.cli import main; main()"
"""As a program would that takes the language of its user for numbers too, which Python does not by itself."""


@pytest.fixture
def comma() -> str:
    before = locale.setlocale(locale.LC_NUMERIC)
    try:
        for name in COMMA:
            try:
                locale.setlocale(locale.LC_NUMERIC, name)
            except locale.Error:
                continue
            if locale.localeconv()["decimal_point"] == ",":
                break
        else:
            pytest.skip(f"none of {', '.join(COMMA)} is installed")
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)
    return name


def run(folder: Path, language: str, *words: str) -> str:
    env = {k: v for k, v in environment().items() if not k.startswith("LC_")}
    env |= {"LC_ALL": language, "LANG": language, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    done = subprocess.run(
        [sys.executable, "-c", CODE, *words], cwd=folder, env=env, capture_output=True, text=True,
        timeout=HANGS_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_decimal_comma_changes_no_byte(tmp_path: Path, comma: str) -> None:
    made = {}
    for language in ("C", comma):
        folder = tmp_path / language
        folder.mkdir()
        model = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30})
        measurement.write(measure(model, incidences=(30.0,), name="gloss"), folder / "a.csv")
        for name in ("b.alta", "b.xml.csv"):
            run(folder, language, "convert", "a.csv", name)
        fitted = run(folder, language, "fit", "a.csv", "--model", "phong", "--json")
        (folder / "fit.json").write_text(re.sub(r'"wall_s": [^,\n]*', "", fitted), encoding="utf-8")
        files = folder.glob("*.*")
        made[language] = {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}
    assert len(made["C"]) >= 5
    assert made["C"] == made[comma]
