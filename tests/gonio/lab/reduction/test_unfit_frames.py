"""Frames that are not what the journal, the rig file or the camera say: left out, flagged or refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gonio.errors import DataError
from tests.gonio.lab.reduction.made_run import MadeRun, Maker, describe
from tests.gonio.lab.reduction.test_brdf import POINTS, glossy, reduce


@pytest.mark.parametrize("kind", ["changed", "missing", "cut"])
def test_a_frame_that_is_not_the_journal_s_is_left_out_and_named(tmp_path: Path, kind: str) -> None:
    run = Maker(tmp_path, describe(), glossy).make(POINTS[:3], (0.25,))
    path = run.frame_path(run.taken[3].frames[0].file)
    data = path.read_bytes()
    if kind == "missing":
        path.unlink()
    else:
        path.write_bytes(data[:-1] + b"\x55" if kind == "changed" else data[:5000])
    table = reduce(run)
    assert list(table["flag"]).count("damaged") == 1
    assert any(path.name in note for note in table.attrs["notes"])


@pytest.mark.parametrize(
    ("kept", "message"),
    [
        (("reference", "point"), "no dark frames"),
        (("dark", "point"), "no usable measurement of the white reference in band 550 nm"),
        (("dark",), "no point was measured"),
    ],
)
def test_a_run_that_is_too_short_says_what_it_lacks(tmp_path: Path, kept: tuple[str, ...], message: str) -> None:
    run: MadeRun = Maker(tmp_path, describe(), glossy).make(POINTS[:2], (0.25,))
    run.taken = [e for e in run.taken if e.kind in kept]
    with pytest.raises(DataError, match=message):
        reduce(run)


def test_the_table_has_the_name_that_the_laboratory_states_of_its_sample(tmp_path: Path) -> None:
    run = Maker(tmp_path, describe(), glossy).make(POINTS[:2], (0.25,))
    run.laboratory = {"sample": {"name": "grey paint"}}
    assert reduce(run).attrs["sample"] == "grey paint"


def test_frames_of_another_camera_are_refused(tmp_path: Path) -> None:
    run = Maker(tmp_path, describe(), glossy).make(POINTS[:2], (0.25,))
    run.description = describe(camera={"width": 128})
    with pytest.raises(DataError, match=r"holds 64 x 64 pixels.*camera.width = 128"):
        reduce(run)


@pytest.mark.parametrize(
    ("camera", "exposure_s", "reason"),
    [
        ({"bits": 14, "full_well_e": 15_000.0}, 0.25, "white level 65535 DN; the rig file says camera.bits = 14"),
        ({"black_level_dn": 6000.0}, 0.25, "black level 1000 DN; the rig file says camera.black_level_dn = 6000"),
        ({}, 0.0, "was exposed 0.25 s, and the journal says exposure_s = 0.0"),
        ({}, None, "the journal says exposure_s = None"),
        ({}, 0.3, "the journal says exposure_s = 0.3"),
    ],
)
def test_frames_that_contradict_rig_file_or_journal_are_flagged(
    tmp_path: Path, camera: dict[str, Any], exposure_s: Any, reason: str
) -> None:
    run = Maker(tmp_path, describe(), glossy).make(POINTS[:3], (0.25,))
    if camera:
        run.description = describe(camera=camera)
        with pytest.raises(DataError, match=reason):  # of the dark frames already
            reduce(run)
        return
    point = next(k for k, step in enumerate(run.taken) if step.point == 1)
    frames = tuple(replace(frame, exposure_s=exposure_s) for frame in run.taken[point].frames)
    run.taken[point] = replace(run.taken[point], frames=frames)
    table = reduce(run)
    assert table["flag"].tolist() == ["", "contradictory", ""]
    assert any(reason in note and "contradictory" in note for note in table.attrs["notes"])
