"""What a frame's label says does not depend on when the thread that writes it comes to it."""

import json
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

import numpy as np

from gonio.acquisition.frame_writer import Files, Store
from gonio.acquisition.records import FrameFile
from gonio.rig import Frame, Pose, Step

FRAME = Frame(np.full((48, 64), 100, dtype=np.uint16), 0.1, 64.0, 4095.0, time_s=1.0)


class Later(Store):
    """A thread that comes to its frames when the step is over."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.labels: list[Callable[[str], str]] = []

    def put(self, frame: Frame, name: str, label: Callable[[str], str]) -> Future[FrameFile]:
        self.labels.append(label)
        return Future()


def test_a_band_that_is_planned_later_does_not_change_the_labels_of_the_one_before(tmp_path: Path) -> None:
    store = Later(tmp_path)
    files = Files(store, Step(3, "point", 1, Pose()), "run", 0, Pose(), 1.0)
    for count in (2, 3):  # a bracket for each of two bands
        files.count += count
        for _ in range(count):
            files.keep(FRAME, "band", "band", lamp=True)
    # four are with the thread by now, the fifth waits for the step's record; the first was put before band two was
    # planned, the second when its first frame came
    assert [json.loads(label("ab"))["of"] for label in store.labels] == [2, 5, 5, 5]
    store.close()
