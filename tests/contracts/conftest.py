"""What the contracts are tried on: every rig, arm set, light and camera that there is, or what is in the rig of --rig.

`case` and `rig` serve all tests of a file: a rig is entered once and used by one test after the other, as in a run. A
test of how a rig is entered and left builds its own from `case`, in a file where no test uses `rig`.
"""

import math
from collections.abc import Iterator

import pytest

from gonio.lab.rig import Pose, Rig, Step
from tests.contracts import cameras, rigs
from tests.contracts.cameras import Eye
from tests.contracts.rigs import Case

RIGS = ("sim", "sim-ideal", "lab-scpi", "stages", "stranger")
LIGHTS = ("sim", "lab-scpi", "lab-mightex", "lab-arduino", "stranger")
TRIED = {
    "test_rig": RIGS,
    "test_arms": RIGS,
    "test_dark": LIGHTS,
    "test_light": LIGHTS,
    "test_polarisers": ("sim", "lab-mightex"),
    "test_camera": (*dict.fromkeys(RIGS + LIGHTS), "sim-slow", *cameras.NAMES),
}
"""By file. What two rigs share they are not asked twice: the lamps' languages are three, with one set of arms."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    asked = metafunc.config.getoption("--rig")
    tried = [asked] if asked else TRIED[metafunc.module.__name__.rpartition(".")[2]]
    name = "eye" if "eye" in metafunc.fixturenames else "case"
    metafunc.parametrize(name, tried, indirect=True, scope="module")


@pytest.fixture(scope="module")
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Case]:
    yield from cases(request, tmp_path_factory)


def cases(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Case]:
    if request.config.getoption("--rig"):
        yield rigs.named(request.param, request.config.getoption("--sample"))
        return
    with pytest.MonkeyPatch.context() as monkeypatch:
        yield from rigs.opened(request.param, tmp_path_factory.mktemp(request.param), monkeypatch)


@pytest.fixture(scope="module")
def entered(case: Case) -> Iterator[Rig]:
    with case.build() as rig:
        start(rig, case)
        yield rig


@pytest.fixture
def rig(entered: Rig, case: Case) -> Rig:
    """A rig that is open, with its arms at home, the sample in the beam, and the lamp dark."""
    entered.light.off()
    if off_deg(entered.arms.read(), home(case), case) > LANDED_DEG:
        start(entered, case)
    return entered


@pytest.fixture(scope="module")
def eye(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Eye]:
    """A camera that is open: a rig's, with its arms at home, or one by itself."""
    if request.param in cameras.NAMES and not request.config.getoption("--rig"):
        with pytest.MonkeyPatch.context() as monkeypatch:
            yield from cameras.opened(request.param, tmp_path_factory.mktemp(request.param), monkeypatch)
        return
    for case in cases(request, tmp_path_factory):
        with case.build() as rig:
            start(rig, case)
            yield Eye(rig.camera, rig.description, rig.time_s, cameras.switch(rig.light))


LANDED_DEG = 0.5
"""A landing as far off as this is another direction; drivers state tighter tolerances of their own."""
STANDS_DEG = 0.2
"""Between two readings at rest: two encoder steps of the coarsest common encoder (4096 a turn)."""


def home(case: Case) -> Pose:
    """A pose inside all limits, from which every axis can go a little both ways."""
    middle = {name: (low + high) / 2 for name, (low, high) in case.description.limits_deg().items()}
    apart = {"light": -20.0, "camera": 25.0}
    return Pose(**{name: math.radians(apart.get(name, deg)) for name, deg in middle.items()})


def exposure_s(case: Case) -> float:
    """Short, but inside the limits."""
    return cameras.short_s(case.description)


def begin(rig: Rig, case: Case, index: int = 0) -> None:
    """Begin a step at home; nothing turns yet."""
    rig.begin(Step(index=index, kind="point", point=0, pose=home(case)))


def start(rig: Rig, case: Case, index: int = 0) -> Pose:
    """Begin a step at home, with the sample in the beam; where the arms landed."""
    begin(rig, case, index)
    rig.present("sample")
    rig.light.select(case.description.bands.all()[0])
    return rig.arms.move(home(case))


def off_deg(a: Pose, b: Pose, case: Case) -> float:
    """The largest difference of two poses over the axes that the rig has [deg]."""
    return max(abs(math.degrees(getattr(a, name) - getattr(b, name))) for name in case.description.axes())
