"""A camera that hands out an image again under a new header: named while measuring, by the check, and by the reduction;
and nothing else is taken for it.
"""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gonio.errors import DataError, DeviceError
from gonio.lab.acquisition import repair, repeats, shots
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf, count_rates
from gonio.lab.rig import Frame
from gonio.lab.rig.light_and_camera import Camera
from tests.gonio.lab.acquisition.conftest import Measure
from tests.gonio.numpy_rig import NumpyRig, Plugin, describe

NOISY = Camera(width=64, height=48, pixel_um=40, exposure_limits_s=(1e-4, 10.0), photon_noise=True)


@dataclass
class Stuck(NumpyRig):
    """Its camera hands out what it gave before, in one step, or in all that follow."""

    at: int = 4
    back: int = 1
    taken: tuple[Frame, ...] = ()

    def capture(self, exposure_s: float) -> Frame:
        frame = super().capture(exposure_s)
        if self.step == self.at and len(self.taken) >= self.back:
            return replace(frame, mosaic=self.taken[-self.back].mosaic)
        self.taken = (*self.taken, frame)
        return frame


@pytest.fixture
def measure(measure: Measure) -> Measure:
    return partial(measure, description=describe(camera=NOISY))


@pytest.mark.slow
def test_the_picture_before_is_known_while_it_is_measured(measure: Measure, tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"step 4: the camera .* gives the same picture twice"):
        measure(rig=Plugin(kind=Stuck))
    assert list(Run.open(tmp_path / "run").steps().numbers) == [0, 1, 2, 3]
    assert brdf.reduce(measure(resume=True)).equals(brdf.reduce(measure("other")))


@pytest.mark.slow
@pytest.mark.parametrize("at", [3, 5])
def test_an_older_picture_is_found_among_the_frames(measure: Measure, monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    """A buffer of several pictures: none is the one before. The check names the step, and it is taken again."""
    whole = brdf.reduce(measure("other"))
    monkeypatch.setattr(shots, "cannot_be_alike", lambda *args: False)
    run = measure(rig=Plugin(options={"at": at, "back": 1}, kind=Stuck))
    with pytest.raises(DataError, match=rf": steps? .*\b{at}: .* again under a new header"):
        brdf.reduce(Run.open(run.path))
    found = repair.check(run.path)
    assert at in found.damaged
    assert repeats.REPEATED in found.damaged[at][0]
    done = repair.repair(run.path)
    assert done is not None
    assert any(repeats.REPEATED in text for text in done.damaged)
    monkeypatch.undo()
    table = brdf.reduce(measure(resume=True))
    assert (table["flag"] == whole["flag"]).all()
    # the step after it looked for its exposure where this one had been: other frames, of the same sample; both tables
    # have their own noise, and 5 sigma leave one of 1e5 such tables out
    one, two = (each[table["flag"] == ""] for each in (table, whole))
    apart = (one["brdf"] - two["brdf"]).to_numpy(float)
    assert (abs(apart) < 5.0 * np.hypot(one["u_brdf"].to_numpy(float), two["u_brdf"].to_numpy(float))).all()


def test_frames_that_are_alike_in_the_rows_looked_at_are_compared_whole(
    measure: Measure, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = measure()
    table = brdf.reduce(run)
    monkeypatch.setattr(count_rates, "some_rows_sha256", lambda mosaic: "0" * 64)
    assert brdf.reduce(run).equals(table)


def frame(mosaic: np.ndarray, exposure_s: float = 0.1) -> Frame:
    return Frame(mosaic.astype(np.uint16), exposure_s, 64.0, 4095.0, time_s=0.0)


def test_what_noise_does_not_change_may_be_alike() -> None:
    rng = np.random.default_rng(5)
    pattern = rng.integers(60, 70, (48, 64))
    lit = rng.poisson(3000, (48, 64)) / 2.7 + 64
    quiet, noisy = NOISY.model_copy(update={"photon_noise": False}), NOISY.model_copy(update={"read_noise_e": 8.0})
    full = np.full((48, 64), 4095)
    full[:2] = lit[:2]
    for camera, one, other, accused in (
        (noisy, frame(lit), frame(lit), True),
        (noisy, frame(pattern), frame(pattern), True),  # read noise of 3 DN
        (NOISY, frame(lit), frame(lit), True),
        (quiet, frame(lit), frame(lit), False),  # a rig without noise, twice at the same place
        (quiet, frame(lit), frame(lit, 0.2), True),  # twice the light, and the same picture
        (quiet, frame(pattern), frame(pattern, 0.2), False),  # the pattern of a sensor in the dark
        (noisy, frame(np.full((48, 64), 4095)), frame(np.full((48, 64), 4095), 0.2), False),
        (noisy, frame(np.full((48, 64), 0)), frame(np.full((48, 64), 0), 0.2), False),
        (noisy, frame(np.full((48, 64), 64)), frame(np.full((48, 64), 64), 0.2), False),
        (noisy, frame(np.where(lit > 0, 4095, 0) - np.eye(48, 64)), frame(lit), False),
        (noisy, frame(lit), frame(lit + np.eye(48, 64)), False),
        (quiet, frame(full), frame(full, 0.1001), False),
    ):
        assert repeats.cannot_be_alike(camera, one, other) is accused
