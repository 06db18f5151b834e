"""The rigs that the contracts are tried on: ours, the twins of a laboratory, and a stranger's."""

import contextlib
import importlib.util
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest
from gonio_drivers.lab import LAB
from gonio_sim.rig import SIM, SIM_IDEAL, SimulatedRig
from gonio_sim.wire.twins import Twins

from gonio.config import parse
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.rig import Rig, RigPlugin
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import SampleDescription
from gonio.samples.files import load_sample
from tests.gonio_drivers.conftest import be_patient, small
from tests.gonio_drivers.staged import on_stages
from tests.gonio_drivers.test_polarisers import with_polarisers
from tests.gonio_drivers.virtual import virtual_time
from tests.places import example

SAMPLE = SampleDescription(name="matt", model="lambert", parameters={"albedo": 0.5})
SMALL = {"width": 64, "height": 48}
SDK = '''
import math

import numpy as np


class Bench:
    """A matt surface behind the controller that the guide's rig speaks to."""

    def __init__(self):
        self.angles, self.lit, self.rng = {"light": 0.0, "camera": 0.0}, True, np.random.default_rng(1)

    def go(self, angles):
        self.angles.update(angles)

    def where(self):
        return dict(self.angles)

    def halt(self):
        pass

    def filter(self, name):
        assert name == "green"

    def lamp(self, on):
        self.lit = on

    def expose(self, seconds):
        light = math.radians(self.angles["light"])
        charge = self.rng.poisson(40_000 * 0.5 * math.cos(light) * seconds if self.lit else 0.0, (120, 160))
        return np.clip(np.rint(charge / 3 + 64), 0, 4095).astype(np.uint16)

    def close(self):
        pass


BENCH = Bench()


def open(port, timeout):
    return BENCH
'''


@dataclass(frozen=True)
class Case:
    """A rig to try: how to build it anew, and where a lamp can be looked at from outside, whether it shines."""

    name: str
    plugin: RigPlugin
    description: RigDescription
    sample: SampleDescription | None
    shines: Callable[[], bool] | None = None

    def is_seen(self, *, lit: bool) -> bool:
        """Whether its lamp is lit, or dark, where that can be looked at."""
        return self.shines is None or self.shines() == lit

    def build(self) -> Rig:
        """The rig, with no device touched."""
        return self.plugin.open(self.description, sample=self.sample, seed=5, confirm=False)


def opened(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Case]:
    """The rig of a name: "sim", "sim-ideal", "stranger", or "lab-" and the language of its lamp."""
    if name == "stranger":
        yield stranger(folder, monkeypatch)
    elif name == "stages":
        yield from staged(folder, monkeypatch)
    elif name.startswith("lab-"):
        yield from twins(name, folder, monkeypatch)
    else:
        yield simulated(name)


def named(choice: str, sample: str | None) -> Case:
    """The rig that the user names, with --rig."""
    found = find_rig(choice)
    return Case(choice, found.plugin, found.description, load_sample(sample) if sample else SAMPLE)


def simulated(name: str) -> Case:
    plugin = {"sim": SIM, "sim-slow": SIM, "sim-ideal": SIM_IDEAL}[name]
    tables = tomllib.loads(plugin.toml)
    tables["camera"] |= SMALL | ({"readout_s": 2.0} if name == "sim-slow" else {})
    if name == "sim":
        tables["polarisers"] = {"light": {"empty": True}, "receiver": {"retarder": True}}

    @dataclass(frozen=True)
    class Watched:
        """Keeps the rig that was built last, so that its lamp can be looked at."""

        toml: str
        built: list[SimulatedRig]

        def open(
            self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool
        ) -> Rig:
            self.built.append(plugin.open(description, sample=sample, seed=seed, confirm=confirm))
            return self.built[-1]

    watched = Watched(plugin.toml, [])
    description = parse(RigDescription, tables, name)
    return Case(name, watched, description, SAMPLE, lambda: watched.built[-1].world.lamp_on)


def twins(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Case]:
    """The laboratory's drivers; lamps in three languages, one of them at a terminal and on the real clock."""
    monkeypatch.setattr("gonio.disk.os.fsync", lambda descriptor: None)
    real = name == "lab-scpi"
    described = with_polarisers() if name == "lab-mightex" else small()
    devices = described.devices | {"light": described.devices["light"] | {"dialect": name.partition("-")[2]}}
    described = described.model_copy(update={"devices": devices})
    if name == "lab-mightex":  # a camera that says when an exposure is over
        described = described.model_copy(update={"camera": described.camera.model_copy(update={"readout_s": 0.5})})
    with (
        contextlib.nullcontext() if real else virtual_time(monkeypatch),
        Twins(described, SAMPLE, 3, folder=folder / "twin", scale=50.0) as bench,
    ):
        if real:
            be_patient(bench.peers["servos"], bench.faults, monkeypatch)
        yield Case(name, LAB, bench.description, None, lambda: bench.world.lamp_on)


def staged(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Case]:
    """The laboratory's lamp and camera, with axes of Thorlabs stages through the unmodified pylablib."""
    pytest.importorskip("pylablib", reason="pylablib is not installed (the extra thorlabs)")
    monkeypatch.setattr("gonio.disk.os.fsync", lambda descriptor: None)
    with Twins(on_stages(), SAMPLE, 3, folder=folder / "twin", scale=50.0) as bench:
        yield Case("stages", LAB, bench.description, None, lambda: bench.world.lamp_on)


def stranger(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Case:
    """The rig of docs/writing_a_driver.md, as it stands there."""
    sdk = imported("bench_sdk", SDK, folder)
    monkeypatch.setitem(sys.modules, "bench_sdk", sdk)
    driver = imported("stranger_rig", example("bench_rig.py"), folder)
    description = parse(RigDescription, tomllib.loads(example("bench.toml")), "bench.toml")
    return Case("stranger", driver.BENCH, description, None, lambda: bool(sdk.BENCH.lit))


def imported(name: str, code: str, folder: Path) -> ModuleType:
    path = folder / f"{name}.py"
    path.write_text(code)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
