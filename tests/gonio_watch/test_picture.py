"""A frame as a picture shows what saturates and what is averaged."""

from pathlib import Path

import numpy as np
from gonio_watch.picture import OUTLINE, TOO_BRIGHT, png, rgb

from gonio.lab.acquisition.run import Run
from gonio.lab.rig.dng import read_raw


def decoded(data: bytes) -> np.ndarray:
    import cv2

    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))[:, :, ::-1]


def test_a_saturated_pixel_is_painted_however_small_it_becomes() -> None:
    level = np.full((960, 1280), 0.25, dtype=np.float32)
    level[500, 700] = 1.0
    picture, part = rgb(level)
    assert (picture.shape, part, tuple(picture[250, 350])) == ((480, 640, 3), 2, TOO_BRIGHT)
    assert tuple(picture[0, 0]) == (128, 128, 128)
    assert np.count_nonzero((picture == TOO_BRIGHT).all(axis=2)) == 1


def test_the_region_is_outlined(whole: Path) -> None:
    run = Run.open(whole)
    step = next(step for step in run.steps() if step.kind == "point")
    frame = read_raw(run.frame_path(step.frames[0].file))
    plain, outlined = decoded(png(run.description, frame)), decoded(png(run.description, frame, step))
    assert plain.shape == outlined.shape == (48, 64, 3)
    changed = (plain != outlined).any(axis=2)
    assert changed.sum() > 10
    colour = np.median(outlined[changed], axis=0) - np.median(plain[changed], axis=0)
    assert np.argmax(colour) == np.argmax(OUTLINE), "the line is blue"
