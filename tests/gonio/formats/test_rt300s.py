"""RT-300S workbooks: the Excel 97 file written here record by record, the laboratory's evaluation, its blank."""

import math
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import ConfigError, DataError

LABELS = (" Method", " Azimuth", " Incidence", " Receive", " RT")


def record(kind: int, body: bytes) -> bytes:
    return struct.pack("<2H", kind, len(body)) + body


def workbook(sheets: Sequence[Sequence[Sequence[float]]], *, split: bool = False) -> bytes:
    """A compound file with worksheets of measurements (azimuth, incidence, receive, RT), after [MS-CFB], [MS-XLS]."""
    texts = [*LABELS, "BRDF_LD"]
    blocks = [struct.pack("<2I", 100, len(texts))]
    for text in texts:
        if split and text == LABELS[3]:  # a text that goes on in a CONTINUE record, there in two bytes a letter
            blocks[-1] += struct.pack("<HB", len(text), 0) + text[:4].encode("latin-1")
            blocks.append(b"\x01" + text[4:].encode("utf-16-le"))
        else:
            blocks[-1] += struct.pack("<HB", len(text), 0) + text.encode("latin-1")
    strings = record(0x00FC, blocks[0]) + b"".join(record(0x003C, block) for block in blocks[1:])
    bodies = []
    for measurements in sheets:
        rows = record(0x0809, struct.pack("<2H", 0x0600, 0x0010) + bytes(12))
        for row in range(len(LABELS)):
            rows += record(0x00FD, struct.pack("<3HI", row, 0, 0, row))
        for column, values in enumerate(measurements, start=1):
            rows += record(0x00FD, struct.pack("<3HI", 0, column, 0, len(LABELS)))
            for row, value in enumerate(values, start=1):
                if row == 1:  # an RK integer
                    rows += record(0x027E, struct.pack("<3HI", row, column, 0, (int(value) << 2 & 0xFFFFFFFC) | 2))
                elif row == 2:  # an RK integer over 100, in a MULRK
                    rows += record(0x00BD, struct.pack("<3HIH", row, column, 0, int(value * 100) << 2 | 3, column))
                else:
                    rows += record(0x0203, struct.pack("<3Hd", row, column, 0, value))
        bodies.append(rows + record(0x000A, b""))
    names = [struct.pack("<BB", 1, 0) + b"S" for _ in bodies]
    head = record(0x0809, struct.pack("<2H", 0x0600, 0x0005) + bytes(12))
    size = len(head) + len(strings) + sum(4 + 6 + len(n) for n in names) + 4
    starts = [size + sum(map(len, bodies[:k])) for k in range(len(bodies))]
    bound = b"".join(record(0x0085, struct.pack("<IH", s, 0) + n) for s, n in zip(starts, names, strict=True))
    stream = head + bound + strings + record(0x000A, b"") + b"".join(bodies)
    stream += bytes(max(0, 4096 - len(stream)))
    return compound(stream)


def compound(stream: bytes) -> bytes:
    count = -(-len(stream) // 512)
    table = [0xFFFFFFFD, 0xFFFFFFFE, *range(3, 2 + count), 0xFFFFFFFE]
    assert len(table) <= 128
    table += [0xFFFFFFFF] * (128 - len(table))
    header = bytes.fromhex("d0cf11e0a1b11ae1") + bytes(16) + struct.pack("<5H", 0x3E, 3, 0xFFFE, 9, 6) + bytes(10)
    header += struct.pack("<9I", 1, 1, 0, 4096, 0xFFFFFFFE, 0, 0xFFFFFFFE, 0, 0)[:32]
    header += struct.pack("<109I", 0, *[0xFFFFFFFF] * 108)

    def entry(name: str, kind: int, first: int, size: int) -> bytes:
        text = (name + "\0").encode("utf-16-le")
        fields = struct.pack("<HBB3I", len(text), kind, 1, 0xFFFFFFFF, 0xFFFFFFFF, 1 if kind == 5 else 0xFFFFFFFF)
        return (text.ljust(64, b"\0") + fields + bytes(36) + struct.pack("<3I", first, size, 0)).ljust(128, b"\0")

    directory = entry("Root Entry", 5, 0xFFFFFFFE, 0) + entry("Workbook", 2, 2, len(stream))
    return header + struct.pack("<128I", *table) + directory.ljust(512, b"\0") + stream.ljust(512 * count, b"\0")


SAMPLE = [
    [(-90, 30.0, 60.0, 1.25), (90, 30.0, -60.0, 1.0), (0, 30.0, 60.0, 0.5)],
    [(-90, 30.0, -35.0, 0.25), (90, 30.0, 0.0, 0.75)],
]


def test_directions_values_and_the_blocked_zone() -> None:
    frame = measurement.parse(workbook(SAMPLE), Path("nowhere/tile.xls"))
    assert frame["theta_r_deg"].tolist() == [60, 60, 60, 35, 0]
    # both half-turns of the instrument see the mirror side; azimuth 0 stands across the plane of incidence
    assert frame["phi_r_deg"].tolist()[:4] == [180, 180, 90, 0]
    expected = (np.array([1.25, 1.0, 0.5, 0.25, 0.75]) - 0.25) / (math.pi * np.cos(np.deg2rad([60, 60, 60, 35, 0])))
    np.testing.assert_allclose(frame["brdf"], expected, rtol=1e-14)
    assert frame["flag"].tolist() == ["", "", "", "blocked", ""]
    assert any("no blank" in note for note in frame.attrs["notes"])
    assert "the smallest signal of the file, 0.25, is taken as zero" in " ".join(frame.attrs["notes"])


def test_the_blank_beside_is_subtracted(tmp_path: Path) -> None:
    (tmp_path / "tile_20251115.xls").write_bytes(workbook(SAMPLE, split=True))
    for name, offset in (("blank_20240101", 9.0), ("blank_v2_20250911", 0.125), ("blank_20260101", 9.0)):
        dark = [[(*row[:3], offset * (k + 1)) for k, row in enumerate(sheet)] for sheet in SAMPLE]
        (tmp_path / f"{name}.xls").write_bytes(workbook(dark))
    frame = measurement.read(tmp_path / "tile_20251115.xls")
    net = np.array([1.25, 1.0, 0.5, 0.25, 0.75]) - 0.125 * np.array([1, 2, 3, 1, 2])
    expected = (net - net.min()) / (math.pi * np.cos(np.deg2rad([60, 60, 60, 35, 0])))
    np.testing.assert_allclose(frame["brdf"], expected, rtol=1e-12)  # rounding of differences
    assert any("blank_v2_20250911" in note for note in frame.attrs["notes"])
    (tmp_path / "blank_v2_20250911.xls").write_bytes(workbook(SAMPLE[:1]))
    assert measurement.read(tmp_path / "tile_20251115.xls")["flag"].tolist() == ["", "", "", "blocked", "no_blank"]
    (tmp_path / "blank_v2_20250911.xls").write_bytes(workbook([[(0.0, 5.0, 5.0, 1.0)]]))
    with pytest.raises(DataError, match="measured at none of the file's directions"):
        measurement.read(tmp_path / "tile_20251115.xls")


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (workbook(SAMPLE)[:3000], "the workbook is damaged"),
        (workbook([[(-90, 30.0, 95.0, 1.0)]]), "worksheet 1, row 4, column B: Receive is 95.0"),
        (workbook(SAMPLE).replace(b" RT", b" XX"), "column 0 has no label RT"),
        (workbook([[]]), "holds no measurement"),
        (
            workbook(SAMPLE).replace(struct.pack("<2I", 0xFFFFFFFD, 0xFFFFFFFE), struct.pack("<2I", 0xFFFFFFFD, 1)),
            "the workbook is damaged",
        ),
    ],
)
def test_damage_is_named(data: bytes, told: str) -> None:
    with pytest.raises(DataError) as caught:
        measurement.parse(data, Path("nowhere/tile.xls"))
    assert "tile.xls" in str(caught.value)
    assert told in str(caught.value)


def test_damaged_files(survives: Callable[..., None]) -> None:
    survives(workbook(SAMPLE, split=True), "nowhere/tile.xls", format="rt300s")


@pytest.fixture(scope="module")
def raw(shared: Callable[[str], Path]) -> pd.DataFrame:
    return measurement.read(shared("loft_rt300s") / "raw" / "ANOPLATE_AnoBlack_EC1_Alum6061_v1o0_20251115.xls")


@pytest.mark.parametrize("name", ["AnoBlackEC1onAlum.txt", "AnoBlackEC1onAlum_fullAz.txt"])
def test_the_laboratorys_own_results(name: str, raw: pd.DataFrame, shared: Callable[[str], Path]) -> None:
    """The laboratory published means of the two half-turns, without the zone around retro: all of them are found."""
    frame, folder = raw, shared("loft_rt300s")
    assert len(frame) == 2508
    ours = frame[frame["flag"] == ""].groupby(["theta_i_deg", "theta_r_deg", "phi_r_deg"])["brdf"].mean()
    along_normal = frame[frame["theta_r_deg"] == 0].groupby("theta_i_deg")["brdf"].mean()
    lines = (folder / "processed_fred" / name).read_text().splitlines()[2:]
    theta_i, compared = 0.0, 0
    for words in (line.split() for line in lines):
        if len(words) == 2:
            theta_i = float(words[0])
            continue
        theta_r, phi, published = map(float, words)
        if theta_r == 0:
            # the mean over azimuths, of which the laboratory does not say how often A = 0 counts; near retro it is left
            # out on both sides
            if theta_i != 10:
                assert along_normal[theta_i] == pytest.approx(published, rel=1.5e-3)
            continue
        pair = [ours.get((theta_i, theta_r, (180.0 + turn * phi) % 360.0)) for turn in (1, -1)]
        found = [value for value in pair if value is not None]
        assert found, (theta_i, theta_r, phi)
        assert np.mean(found) == pytest.approx(published, abs=1.1e-6 if published < 1 else 1e-5)  # six decimals
        compared += 1
    assert compared > 1000


def test_a_blank_that_is_named_is_subtracted_and_has_to_have_every_direction(tmp_path: Path) -> None:
    table, blank = tmp_path / "tile.xls", tmp_path / "dark.xls"
    table.write_bytes(workbook(SAMPLE))
    blank.write_bytes(workbook([[(*row[:3], 0.125) for row in sheet] for sheet in SAMPLE]))
    plain = measurement.read(table)
    named = tmp_path / "tile.columns.toml"
    named.write_text('blank = "dark.xls"\n')
    net = measurement.read(table)
    np.testing.assert_allclose(net["brdf"], plain["brdf"], rtol=1e-12)  # the smallest signal is zero either way
    assert any("blank subtracted: dark.xls" in note for note in net.attrs["notes"])
    assert net["u_brdf"].isna().all()  # nothing was measured twice
    blank.write_bytes(workbook(SAMPLE[:1]))
    with pytest.raises(DataError) as told:
        measurement.read(table)
    assert "directions were not measured with the blank" in str(told.value)
    assert "Measure the blank at them" in str(told.value)
    named.write_text('blank = "away.xls"\n')
    with pytest.raises(ConfigError, match=r"away\.xls: the blank cannot be read"):
        measurement.read(table)
    other = tmp_path / "a.csv"
    other.write_text("theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf\n1,0,2,0,0.3\n")
    (tmp_path / "a.columns.toml").write_text('blank = "dark.xls"\n')
    with pytest.raises(ConfigError, match=r"a\.columns\.toml: a blank is subtracted from RT-300S workbooks alone"):
        measurement.read(other)


def test_repeats_of_sample_and_blank_give_uncertainties(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    directions = [(-90, 30.0, float(r)) for r in range(0, 60, 5)]
    rows = [[(*d, 1.0 + rng.normal(0.0, 0.02)) for d in directions for _ in range(4)]]
    dark = [[(*d, 0.1 + rng.normal(0.0, 0.01)) for d in directions for _ in range(9)]]
    (tmp_path / "tile.xls").write_bytes(workbook(rows))
    (tmp_path / "dark.xls").write_bytes(workbook(dark))
    (tmp_path / "tile.columns.toml").write_text('blank = "dark.xls"\n')
    frame = measurement.read(tmp_path / "tile.xls")
    # one signal of the sample, and the mean of nine of the blank; 36 and 96 degrees of freedom know them to 12 %
    expected = math.hypot(0.02, 0.01 / 3.0) / (math.pi * np.cos(np.deg2rad(frame["theta_r_deg"])))
    np.testing.assert_allclose(frame["u_brdf"], expected, rtol=0.36)
    np.testing.assert_allclose(frame["u_random"], frame["u_brdf"], rtol=1e-12)  # no cause is common: one number, twice


@pytest.mark.parametrize("signals", [(-30.0, -2.0, -1.0), (-5.0, 0.0, -1.0), (-30.0, 2.0, 1.0)])
def test_signals_below_zero_are_no_light(tmp_path: Path, signals: tuple[float, ...]) -> None:
    """An export in decibels, or of an inverted detector: shifted to zero it would look like a BRDF."""
    rows = [(-90, 30.0, receive, rt) for receive, rt in zip((60.0, 40.0, 20.0), signals, strict=True)]
    (tmp_path / "s.xls").write_bytes(workbook([rows]))
    with pytest.raises(DataError, match=rf"s\.xls: its signals go from {min(signals):g} to {max(signals):g}: below"):
        measurement.read(tmp_path / "s.xls")


def test_a_blank_that_is_brighter_than_its_sample_is_named(tmp_path: Path) -> None:
    (tmp_path / "s.xls").write_bytes(workbook(SAMPLE))
    bright = [[(a, i, r, rt + 9.0) for a, i, r, rt in sheet] for sheet in SAMPLE]
    (tmp_path / "blank.xls").write_bytes(workbook(bright))
    with pytest.raises(DataError, match=r"s\.xls: its signals, less those of the blank blank\.xls, go from -9 to -9"):
        measurement.read(tmp_path / "s.xls")
