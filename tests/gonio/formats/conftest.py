"""Shared by the tests of file formats: where measured data lies, small tables, and files damaged on purpose."""

import os
import random
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError
from gonio.formats.reader import table
from tests.places import measured

MUTATIONS = int(os.environ.get("GONIO_MUTATIONS", "400"))
"""Damaged files a format; raise it for a long run by hand."""


@pytest.fixture(scope="session")
def shared() -> Callable[[str], Path]:
    """A file or folder of the measured BRDFs, or a skip where it is missing."""
    return lambda name: measured(f"brdf/{name}")


@pytest.fixture
def small() -> pd.DataFrame:
    """Two incidences, three directions, two wavelengths, one flagged row; no uncertainties."""
    rows = [
        (i, r, dphi, nm)
        for i in (10.0, 45.0)
        for r, dphi in ((0.0, 0.0), (30.0, 180.0), (60.5, 90.0))
        for nm in (500.0, 650.0)
    ]
    theta_i, theta_r, phi_r, nm = np.array(rows).T
    flag = np.array([""] * len(rows), dtype=object)
    flag[3] = "clamped"
    return table(
        theta_i_deg=theta_i,
        phi_i_deg=0.0,
        theta_r_deg=theta_r,
        phi_r_deg=phi_r,
        wavelength_nm=nm,
        brdf=np.where(flag == "", 0.1 + 0.2 * np.sin(np.arange(len(rows))), 0.0),
        flag=flag,
        attrs={"sample": "tile 7", "source_file": "none"},
    )


def damaged(data: bytes, count: int) -> Iterator[bytes]:
    """`data` with bits flipped, bytes and blocks changed, cut, doubled, or numbers replaced by absurd ones."""
    dice = random.Random(20240229)
    absurd = [
        b"1e999",
        b"-1",
        b"nan",
        b"inf",
        b"4294967295",
        b"99999999999999999999",
        b"",
        b"1e308",
        b"\xff\xff\xff\xff",
        b"\x00",
    ]
    for _ in range(count):
        out = bytearray(data)
        for _ in range(dice.choice((1, 1, 1, 2, 5))):
            at = dice.randrange(len(out)) if out else 0
            length = min(len(out) - at, int(2 ** (dice.random() * 10)))
            kind = dice.randrange(8)
            if not out:
                break
            if kind == 0:
                out[at] ^= 1 << dice.randrange(8)
            elif kind == 1:
                out[at] = dice.randrange(256)
            elif kind == 2:
                del out[at:]
            elif kind == 3:
                del out[at : at + length]
            elif kind == 4:
                out[at:at] = out[at : at + length]
            elif kind == 5:
                out[at : at + 4] = dice.choice(absurd)
            elif kind == 6:
                other = dice.randrange(len(out))
                out[at : at + length] = out[other : other + length]
            else:
                out[at : at + 1] = dice.choice([bytes([c]) for c in b',\n\t"-9.<>[}'])
        yield bytes(out)


@pytest.fixture
def survives() -> Callable[..., None]:
    """Read many damaged copies of a file: each is a valid table, or a `DataError` naming the file."""

    def attempt(data: bytes, name: str, format: str | None = None, most_rows: int = 1000) -> None:
        path = Path(name)
        outcomes = {"read": 0, "refused": 0}
        for mutant in damaged(data, MUTATIONS):
            message = ""
            try:
                frame = measurement.parse(mutant, path, format=format)
            except DataError as error:
                message = str(error)
            if message:
                assert name in message
                assert len(message) < 2000  # one clear message, not a dump of the file
                outcomes["refused"] += 1
            else:
                # a file of N bytes cannot stand for more than a few times N rows
                assert 0 < len(frame) <= 4 * len(mutant) + most_rows
                outcomes["read"] += 1
        assert outcomes["refused"] > 0
        print(name, outcomes)

    return attempt
