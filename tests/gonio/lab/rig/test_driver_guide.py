"""The rig of docs/writing_a_driver.md as a stranger would install it: its code, its rig file, its entry point."""

import math
import re
import tomllib
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gonio.lab.acquisition.run import Run
from gonio.measurement import read
from tests.command_line import beside
from tests.gonio.cli.test_cli import installed, process
from tests.places import ROOT, example, fenced

GUIDE = ROOT / "docs" / "writing_a_driver.md"
block = partial(fenced, GUIDE)
PLAN = """name = "tiny"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [30]
theta_r_deg = [-60, 0, 45]
"""
SDK = """import math
import numpy as np


class ManualRig:
    \"\"\"A matt surface of albedo 0.99, whatever is put in; the encoder of the light has its zero off.\"\"\"

    def __init__(self):
        self.angles, self.lit, self.rng = {"light": 0.0, "camera": 0.0}, True, np.random.default_rng(1)

    def go(self, angles):
        self.angles.update(angles)

    def where(self):
        return self.angles

    def halt(self):
        pass

    def filter(self, name):
        assert name == "green"

    def lamp(self, on):
        self.lit = on

    def expose(self, seconds):
        light = math.radians(self.angles["light"] - ZERO_DEG)
        electrons = 40_000 * 0.99 * math.cos(light) * seconds if self.lit else 0.0
        charge = self.rng.poisson(electrons, (120, 160)) + self.rng.normal(0, 3, (120, 160))
        return np.clip(np.rint(charge / 3 + 64), 0, 4095).astype(np.uint16)

    def close(self):
        assert not self.lit


def open(port, timeout):
    if port != "/dev/ttyUSB0":
        raise FileNotFoundError(2, "no such port", port)
    return ManualRig()
"""


@pytest.fixture
def stranger(tmp_path: Path) -> str:
    """The guide's package, installed: what goes onto PYTHONPATH."""
    points = tomllib.loads(block("toml", "gonio.rigs"))["project"]["entry-points"]["gonio.rigs"]
    lines = [f"{name} = {target.replace('my_package.rig', 'stranger')}" for name, target in points.items()]
    site = installed(tmp_path, "gonio.rigs", "\n".join(lines), example("bench_rig.py"))
    (Path(site) / "bench_sdk.py").write_text("ZERO_DEG = 5.0\n" + SDK)
    (tmp_path / "bench.toml").write_text(example("bench.toml"))
    (tmp_path / "plan.toml").write_text(PLAN)
    return site


@pytest.mark.slow
def test_the_guide_s_rig_measures(tmp_path: Path, stranger: str) -> None:
    """With an encoder whose zero is five degrees off, so that the example's zeros count."""
    rig = tmp_path / "bench.toml"
    rig.write_text(rig.read_text().replace("[arms.light]", "[arms.light]\nzero_offset_deg = 5.0"))
    done = process(
        tmp_path, "measure", "plan.toml", "--rig", "bench.toml", "--out", "run", "--yes", PYTHONPATH=stranger
    )
    assert done.returncode == 0, done.stderr
    assert process(tmp_path, "reduce", "run").returncode == 0  # without the driver
    table = read(tmp_path / "run" / "brdf.csv")
    # a surface like the reference; the scene is even, so what a pixel's place changes (1e-4 at 1 m) stays
    assert list(table["flag"]) == ["", "", ""]
    assert np.all(abs(table["brdf"] / (0.99 / math.pi) - 1) < 3 * table["u_brdf"] / table["brdf"] + 2e-4)
    assert np.all(table["u_brdf"] / table["brdf"] < 0.01)
    times = [frame.time_s for step in Run.open(tmp_path / "run").steps() for frame in step.frames]
    assert np.all(np.diff(times) > 0)
    assert times[0] > 1.7e9  # seconds since 1970, so that sessions follow each other
    poses = [step.pose.light for step in Run.open(tmp_path / "run").steps() if step.kind == "point"]
    # from the true zero; rounding of 35 degrees minus 5
    np.testing.assert_allclose(np.abs(poses), math.radians(30), atol=1e-12)


@pytest.mark.parametrize(
    ("was", "becomes", "dry", "code", "message"),
    [
        ("timeout_s", "timeout", True, 2, 'bench.toml: .*unknown key devices.timeout; did you mean "timeout_s"'),
        ('port = "/dev/ttyUSB0"', "", True, 2, "bench.toml: .*the key devices.port is missing"),
        ("ttyUSB0", "ttyUSB7", False, 3, 'bench.toml: devices.port = "/dev/ttyUSB7": the bench does not open'),
    ],
)
def test_the_guide_s_rig_names_wrong_settings(
    tmp_path: Path, stranger: str, was: str, becomes: str, dry: bool, code: int, message: str
) -> None:
    rig = tmp_path / "bench.toml"
    assert was in rig.read_text()
    rig.write_text(rig.read_text().replace(was, becomes))
    measure = ["measure", "plan.toml", "--rig", "bench.toml", "--out", "run", "--yes", *(["--dry-run"] if dry else [])]
    done = beside(stranger, tmp_path, *measure)
    assert done.returncode == code
    assert re.search(message, done.stderr), done.stderr
    assert not (tmp_path / "run").exists()


def test_the_picture_lies_as_the_guide_says() -> None:
    """Marks on the sample's +x and +y side, as the shared geometry sees them with the camera at 0 and 40 degrees."""
    from gonio.lab.rig import Pose
    from gonio.lab.rig.imaging import pixel_map
    from gonio.lab.rig.kinematics import view
    from tests.gonio.numpy_rig import describe

    for camera in (0.0, 40.0):
        description = describe()
        seen = pixel_map(description, view(description, Pose(camera=math.radians(camera))))
        assert np.all(np.diff(seen.y_mm[:, 32]) > 0)
        assert np.all(np.diff(seen.x_mm[24]) < 0)
    assert "rows grow toward +y, columns toward -x" in " ".join(GUIDE.read_text(encoding="utf-8").split())
