"""Printed markers: what the simulated camera shows of them, and OpenCV finds."""

import math
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from gonio_sim.rig import SIM, SimulatedRig

from gonio.by_hand.manual_rig import ManualRig
from gonio.calibration import fiducials
from gonio.config import parse
from gonio.errors import ConfigError
from gonio.rig import imaging, kinematics
from gonio.rig.description import Fiducials, RigDescription
from gonio.rig.fiducials import corners_mm, white
from tests.command_line import gonio, some


@pytest.fixture(scope="module")
def description() -> RigDescription:
    tables = tomllib.loads(SIM.toml)
    tables["camera"] |= {"width": 400, "height": 300, "pixel_um": 8.0, "focal_length_mm": 50.0}
    tables["holder"] |= {"fiducials": {}}
    return parse(RigDescription, tables, "test")


@pytest.mark.parametrize(("camera", "tilt"), [(5.0, 0.0), (40.0, 10.0)])
def test_corners_are_where_the_markers_are(description: RigDescription, camera: float, tilt: float) -> None:
    """Corners scatter by 0.1 to 0.2 px in frames with noise; together they show no shift."""
    rig = SimulatedRig(description, None, 1, confirm=False)
    marks = some(description.holder.fiducials)
    with ManualRig(rig, "test") as manual:
        rig.put("mirror")
        manual.lamp(True)
        manual.move(
            light=math.radians(-30), camera=math.radians(camera), tilt=math.radians(tilt), spin=math.radians(20)
        )
        frame = manual.camera.capture(0.05)
        view = kinematics.view(rig.world.truth, rig.world.pose)
    numbers, pixels = fiducials.detect(frame.mosaic, marks)
    numbers, pixels, scatter = fiducials.consistent(marks, numbers, pixels)
    assert len(numbers) >= 16  # of the eight markers, those above and below lie at the frame's edge
    flat = corners_mm(marks).reshape(-1, 2)[numbers]
    points = np.column_stack([flat, np.zeros(len(flat))])
    off = pixels - np.stack(imaging.project(description, view, points), axis=1)
    assert np.abs(off.mean(axis=0)).max() < 0.1
    assert off.std() < 0.3
    assert scatter < 0.3


def test_a_spoiled_corner_is_left_out() -> None:
    marks = Fiducials()
    flat = corners_mm(marks).reshape(-1, 2)
    pixels = 200.0 + 7.0 * flat + np.random.default_rng(1).normal(0.0, 0.1, flat.shape)
    pixels[5] += 3.0
    numbers, kept, scatter = fiducials.consistent(marks, np.arange(len(flat)), pixels)
    assert 5 not in numbers
    assert len(kept) == len(numbers) >= len(flat) - 2
    assert 0.05 < scatter < 0.15


def drawn_svg(file: Path, scale: float) -> npt.NDArray[np.uint8]:
    """The rectangles of a drawing in millimetres, at so many pixels a millimetre."""
    root = ElementTree.parse(file).getroot()
    left, top, width, height = (float(x) for x in root.attrib["viewBox"].split())
    assert (root.attrib["width"], root.attrib["height"]) == (f"{width:g}mm", f"{height:g}mm"), "printed at 100 %"
    grey = np.full((round(height * scale), round(width * scale)), 90, np.uint8)
    for each in root.iter("{http://www.w3.org/2000/svg}rect"):
        x, y, w, h = (float(each.attrib[name]) for name in ("x", "y", "width", "height"))
        columns, rows = (
            slice(round(a * scale), round(b * scale)) for a, b in ((x - left, x + w - left), (y - top, y + h - top))
        )
        grey[rows, columns] = 255 if each.attrib.get("fill") == "white" else 0
    assert grey.min() == 0
    assert not (grey == 90).any(), "the paper is white all over"
    (circle,) = root.iter("{http://www.w3.org/2000/svg}circle")
    assert float(circle.attrib["r"]) == 10.0, "the hole of 20 mm"
    (ruler,) = root.iter("{http://www.w3.org/2000/svg}path")
    level = ruler.attrib["d"].split()[2]
    assert ruler.attrib["d"] == f"M -10 {level} H 10", "20 mm"
    below = grey[round((float(level) - top - 0.5) * scale) :]
    assert 0 < len(below) < len(grey) / 4
    assert (below == 255).all(), "on the sheet, and beside the markers"
    return grey


@pytest.mark.parametrize("name", ["sheet.png", "sheet.svg"])
def test_the_sheet_shows_the_markers_that_are_looked_for(tmp_path: Path, name: str) -> None:
    """The picture of the sheet, found by OpenCV, has the corners of the rig file at 600 pixels an inch."""
    import cv2

    marks, file, scale = Fiducials(), tmp_path / name, 600 / 25.4
    fiducials.print_sheet(marks, 20.0, file)
    grey = drawn_svg(file, scale) if name.endswith("svg") else some(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE))
    numbers, pixels = fiducials.detect(grey, marks)
    assert len(numbers) == 4 * marks.count
    middle = 0.5 * (np.array(grey.shape[::-1]) - 1.0)
    there = middle + scale * corners_mm(marks).reshape(-1, 2)[numbers] * [1.0, -1.0]
    assert np.abs(pixels - there).max() < 2.0  # of 142 pixels a side: matplotlib rounds the page to whole pixels
    with pytest.raises(ConfigError, match=r"written as .svg or .png"):
        fiducials.print_sheet(marks, 20.0, tmp_path / "sheet.pdf")


def test_markers_have_to_fit_around_the_sample() -> None:
    tables = tomllib.loads(SIM.toml)
    tables["holder"] |= {"fiducials": {"ring_mm": 12.0, "count": 4}}
    with pytest.raises(ConfigError, match="reaches into the sample"):
        parse(RigDescription, tables, "test")
    tables["holder"] |= {"fiducials": {"ring_mm": 18.0, "count": 20}}
    with pytest.raises(ConfigError, match="do not fit on a circle"):
        parse(RigDescription, tables, "test")


def test_command_refuses_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "old.toml").write_text("")
    (tmp_path / "none").mkdir()
    for arguments, said in (
        (["--print-fiducials", "sheet.svg"], "has no [holder.fiducials]"),
        ([], "--out CALIBRATION.toml is missing"),
        (["--out", "old.toml"], "is there already"),
        (["--out", "new.toml", "--images", "none"], "--images and --board go together"),
        (["--out", "new.toml", "--holder", "window"], '"window" is none of mirror, empty'),
        (["--out", "new.toml", "--scans", "gone"], "gone"),
        (["--out", "new.toml", "--images", "none", "--board", "gone.toml"], "holds no picture"),
    ):
        done = gonio(tmp_path, "calibrate", "geometry", "--rig", "sim", *arguments)
        assert done.returncode != 0
        assert said in done.stderr, done.stderr
        assert "Traceback" not in done.stderr
    assert not (tmp_path / "new.toml").exists()


@pytest.mark.parametrize("turn_deg", [10.0, 28.0, 45.0, 65.0])
def test_corners_of_squares_oblique_to_the_pixels_are_not_turned_about_their_middles(turn_deg: float) -> None:
    """What is drawn has no noise: what is left is pixels. OpenCV's single corners are turned by 0.1 to 0.2 px here."""
    marks, pitch_mm, size, parts = Fiducials(), 0.152, (320, 320), 8
    turn = np.exp(-1j * np.radians(turn_deg))  # rows run down

    def at_mm(column: Any, row: Any) -> Any:
        return pitch_mm * np.conj((column - 159.3) + 1j * (row - 160.4)) * np.conj(turn)

    rows, columns = np.indices(size)
    frame = np.zeros(size)
    for across in (np.arange(parts) + 0.5) / parts - 0.5:
        for down in (np.arange(parts) + 0.5) / parts - 0.5:
            there = at_mm(columns + across, rows + down)
            frame += white(marks, there.real, there.imag) == 1
    numbers, pixels = fiducials.detect((200 + 3000 * frame / parts**2).astype(np.uint16), marks)
    assert len(numbers) >= 16
    true = corners_mm(marks).reshape(-1, 2)[numbers]
    middles = corners_mm(marks).mean(axis=1)[numbers // 4]
    off = at_mm(*pixels.T) - (true[:, 0] + 1j * true[:, 1])
    outward = (true - middles) @ np.array([1.0, 1.0j])
    turned, drawn = (np.mean(off * np.conj(outward / np.abs(outward))) / pitch_mm).imag, off / pitch_mm
    assert abs(turned) < 0.02
    assert np.abs(drawn).max() < 0.15
    assert np.sqrt(np.mean(np.abs(drawn) ** 2)) < 0.08
