"""MERL's cubes: one value in one cell has to come out at that cell's pair of directions."""

import math
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError

SCALES = (1 / 1500, 1.15 / 1500, 1.66 / 1500)


def cubes() -> np.ndarray:
    """A Lambertian of albedo 0.3, 0.5 and 0.7."""
    return np.stack(
        [np.full((90, 90, 180), albedo / math.pi / s) for albedo, s in zip((0.3, 0.5, 0.7), SCALES, strict=True)]
    )


def file(values: np.ndarray) -> bytes:
    return struct.pack("<3i", 90, 90, 180) + values.astype("<f8").tobytes()


@pytest.mark.slow
def test_cells_scales_and_round_trip(tmp_path: Path) -> None:
    values = cubes()
    values[0, 0, 45, 90] = 1500.0  # theta_h 0.5^2 / 90 degrees, theta_d 45.5, phi_d 90.5: 1/sr in red
    values[1, 30, 20, 10] = -1.0
    frame = measurement.parse(file(values), Path("paint.binary"))
    count = len(frame) // 3
    assert measurement.samples(frame)["paint green"].attrs["bands"] == [{"name": "green"}]
    red, green, blue = (frame.iloc[k * count : (k + 1) * count] for k in range(3))
    assert frame.attrs["samples"] == ["paint red", "paint green", "paint blue"]
    for part, albedo in ((green, 0.5), (blue, 0.7)):
        np.testing.assert_allclose(part.loc[part["flag"] == "", "brdf"], albedo / math.pi, rtol=1e-14)
    spike = red.iloc[int(red["brdf"].argmax())]
    # half vector at the normal (within 0.003 degrees): the mirror of 45.5 degrees
    assert spike["brdf"] == pytest.approx(1.0, rel=1e-14)
    assert spike["theta_i_deg"] == pytest.approx(45.5, abs=0.01)
    assert spike["theta_r_deg"] == pytest.approx(45.5, abs=0.01)
    assert spike["phi_r_deg"] == pytest.approx(180.0, abs=0.01)
    (missing,) = np.flatnonzero(green["flag"] == "not_measured")
    # its half vector has MERL's theta_h = 90 (30.5/90)^2 and the angle between source and half vector is theta_d = 20.5
    row = green.iloc[missing]
    i, r, dphi = np.deg2rad([row["theta_i_deg"], row["theta_r_deg"], row["phi_r_deg"]])
    cosine = math.cos(i) * math.cos(r) + math.sin(i) * math.sin(r) * math.cos(dphi)
    assert math.degrees(math.acos(cosine)) / 2 == pytest.approx(20.5, abs=1e-9)
    theta_h = math.degrees(math.acos((math.cos(i) + math.cos(r)) / 2 / math.cos(math.radians(20.5))))
    assert theta_h == pytest.approx(90 * (30.5 / 90) ** 2, abs=1e-9)

    measurement.write(frame, tmp_path / "paint.binary")
    written = (tmp_path / "paint.binary").read_bytes()
    assert written[:12] == file(values)[:12]
    again = np.frombuffer(written, "<f8", offset=12).reshape(values.shape)
    kept = again != -1.0  # cells above the surface; the format's scale was multiplied and divided out
    assert kept.sum() == len(frame) - 1
    np.testing.assert_allclose(again[kept], values[kept], rtol=1e-15)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (file(np.zeros(3))[:12], "byte 12: the file has 12 bytes"),
        (struct.pack("<3i", 90, 90, 360) + bytes(80), r"byte 0: the cells are \(90, 90, 360\)"),
        (b"\x5a\x00", "byte 0: the cells are cut"),
    ],
)
def test_damage_is_located(data: bytes, told: str) -> None:
    with pytest.raises(DataError, match=told):
        measurement.parse(data, Path("paint.binary"))


def test_a_value_that_is_not_finite_is_located() -> None:
    values = cubes()
    values[2, 5, 6, 7] = np.nan
    byte = 12 + 8 * (2 * 90 * 90 * 180 + (5 * 90 + 6) * 180 + 7)
    with pytest.raises(DataError, match=f"byte {byte}: the value is not finite"):
        measurement.parse(file(values), Path("paint.binary"))


def test_other_tables_are_refused(tmp_path: Path, small: pd.DataFrame) -> None:
    with pytest.raises(DataError, match="red, green and blue"):
        measurement.write(small, tmp_path / "a.binary")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_reading_takes_little_more_memory_than_the_table(tmp_path: Path) -> None:
    """The table itself takes 290 MB: 3.3 million rows of eight numbers and three references to texts."""
    (tmp_path / "paint.binary").write_bytes(file(cubes()))
    script = (
        "import resource\nfrom gonio import measurement\nimport pandas\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "before = peak()\nframe = measurement.read('paint.binary')\n"
        "print((peak() - before) * 1024 / len(frame))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=600
    )
    # bytes a row: 88 in the table, 27 of file and cells, 10 for the check of a column; they were 265
    assert float(done.stdout) < 140
