"""GenICam cameras: the committee's own virtual camera through the unmodified harvesters, and a twin that misbehaves."""

import math
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from gonio_drivers.cameras import build
from gonio_drivers.genicam import unpack

from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig import Frame, clock
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band, Bands, Camera
from tests.gonio_drivers.genicam_twin import FORMATS, GenICamTwin, described, packed
from tests.gonio_drivers.ticking import ticking

genapi = pytest.importorskip("genicam.genapi", reason="genicam is not installed (the extra genicam)")
core = pytest.importorskip("harvesters.core", reason="harvesters is not installed (the extra genicam)")

SIZE = (24, 32)
BITS = {"Mono8": 8, "Mono10": 10, "Mono10p": 10, "Mono10Packed": 10, "Mono12": 12, "Mono12p": 12, "Mono12Packed": 12,
        "Mono14": 14, "Mono16": 16}  # fmt: skip
EXPOSURE_S = 0.002


def rig(**camera: Any) -> RigDescription:
    shape = {"height": 32, "width": 32, "pattern": "mono", "bits": 12, "exposure_limits_s": (1e-3, 0.1)}
    return RigDescription(
        rig="lab",
        name="bench",
        bands=Bands(list=(Band(name="green", centre_nm=550, fwhm_nm=10),)),
        camera=Camera.model_validate(shape | camera),
    )


def scene(bits: int, shape: tuple[int, int] = (32, 32)) -> npt.NDArray[np.uint16]:
    return np.random.default_rng(1).integers(0, 2**bits, shape).astype(np.uint16)


def taken(
    twin: GenICamTwin, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, exposure_s: float = EXPOSURE_S, **keys: Any
) -> Frame:
    """A frame of the twin; keys of the camera's table, and of the rig's camera as `camera=`."""
    producer = tmp_path / "maker.cti"
    producer.touch()
    monkeypatch.setattr(core, "Harvester", twin)
    description = rig(**keys.pop("camera", {}))
    with build(description, {"driver": "genicam", "producer": str(producer), **keys}) as camera:
        return camera.capture(exposure_s)


# ---- the committee's virtual camera, through the unmodified library ----


def viky() -> str:
    """It comes with the package genicam; a ball bounces in its pictures, and it has no exposure."""
    import genicam

    return str(Path(genicam.__file__).parent / "viky.cti")


def virtual(**keys: Any) -> Any:
    description = rig(width=400, height=400, bits=8, black_level_dn=0.0)
    return build(description, {"driver": "genicam", "producer": viky(), "serial": "0", **keys})


def test_a_camera_whose_exposure_cannot_be_set_is_refused() -> None:
    for _ in range(2):  # and is left in order
        with pytest.raises(DeviceError, match="GenICam camera Viky 0 has no feature ExposureTime or ExposureTimeAbs"):
            virtual().__enter__()


def test_frames_come_through_the_real_library_and_producer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lent an exposure, the virtual camera measures: buffers, formats and the order of calls are those of GenTL."""
    lent = genapi.NodeMap()
    lent.load_xml_from_string(described(("Mono8",)))

    class Both:
        """The camera's features, and an exposure."""

        def __init__(self, nodes: Any) -> None:
            self._nodes = nodes

        def has_node(self, name: str) -> bool:
            return name == "ExposureTime" or bool(self._nodes.has_node(name))

        def __getattr__(self, name: str) -> Any:
            return getattr(lent if name == "ExposureTime" else self._nodes, name)

    real = core.Harvester.create

    def create(harvester: Any, wanted: Any) -> Any:
        camera = real(harvester, wanted)
        assert camera.remote_device.node_map.PixelFormat.value == "RGBa8"
        nodes = SimpleNamespace(node_map=Both(camera.remote_device.node_map))
        return SimpleNamespace(
            remote_device=nodes,
            start=camera.start,
            stop=camera.stop,
            try_fetch=camera.try_fetch,
            destroy=camera.destroy,
        )

    monkeypatch.setattr(core.Harvester, "create", create)
    before = signal.getsignal(signal.SIGINT)
    with virtual() as camera:
        assert signal.getsignal(signal.SIGINT) is before, "Ctrl-C no longer ends the run"
        frames = [camera.capture(EXPOSURE_S) for _ in range(2)]
    for frame in frames:
        assert frame.mosaic.shape == (400, 400)
        assert frame.mosaic.dtype == np.uint16
        assert frame.mosaic.std() > 0
    assert frames[0].time_s < frames[1].time_s


def test_the_several_virtual_cameras_are_named() -> None:
    with pytest.raises(
        DeviceError, match=r'serial is missing, and there are several GenICam cameras, "0" \(Viky\), "1"'
    ):
        virtual(serial=None).__enter__()
    with pytest.raises(DeviceError, match=r'devices.camera.serial = "7": no such GenICam camera; found: "0" \(Viky\)'):
        virtual(serial="7").__enter__()


# ---- the twin ----


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("padding", [0, 5])
def test_every_format_gives_the_sensor_s_values(
    name: str, padding: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seen = scene(BITS[name])
    twin = GenICamTwin(lambda exposure_s: seen, described((name,)), padding=padding)
    frame = taken(twin, monkeypatch, tmp_path, camera={"bits": BITS[name], "black_level_dn": 8.0})
    np.testing.assert_array_equal(frame.mosaic, seen)
    assert frame.white_level_dn == 2 ** BITS[name] - 1


@pytest.mark.parametrize("name", ["Mono10p", "Mono12p", "Mono12Packed"])
def test_formats_are_unpacked_as_harvesters_does(name: str) -> None:
    data = np.frombuffer(packed(scene(BITS[name], SIZE), name), np.uint8)
    theirs = core.Dictionary.get_proxy(symbolic=name).expand(data).reshape(SIZE)
    np.testing.assert_array_equal(unpack(data.reshape(SIZE[0], -1), name, SIZE[1]), theirs)


def test_everything_automatic_is_off_and_the_camera_is_closed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    twin = GenICamTwin(lambda exposure_s: scene(12))
    taken(twin, monkeypatch, tmp_path, gain=6.0, black_level=32.0)
    nodes = twin.nodes
    assert [nodes.ExposureAuto.value, nodes.GainAuto.value, nodes.TriggerMode.value] == ["Off", "Off", "Off"]
    assert nodes.GammaEnable.value is False
    assert [nodes.Gain.value, nodes.BlackLevel.value] == [6.0, 32.0]
    assert [nodes.Width.value, nodes.Height.value, nodes.PixelFormat.value] == [32, 32, "Mono12"]
    assert not twin.runs
    assert not twin.opened


def test_a_frame_from_the_queue_is_thrown_away(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ticking(monkeypatch)
    begun = math.inf

    def see(exposure_s: float) -> npt.NDArray[np.uint16]:
        return np.full((32, 32), 100 if clock.monotonic() - begun < 0.9 * exposure_s else 3000, np.uint16)

    twin = GenICamTwin(see, stale=3)
    start = twin.start

    def starting() -> None:
        nonlocal begun
        begun = clock.monotonic()
        start()

    monkeypatch.setattr(twin, "start", starting)
    assert np.all(taken(twin, monkeypatch, tmp_path).mosaic == 3000)


def test_a_frame_with_parts_missing_is_no_frame(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ticking(monkeypatch)
    seen = scene(12)
    twin = GenICamTwin(lambda exposure_s: seen, incomplete=2)
    np.testing.assert_array_equal(taken(twin, monkeypatch, tmp_path).mosaic, seen)
    twin = GenICamTwin(lambda exposure_s: seen, incomplete=10_000)
    with pytest.raises(DeviceError, match=r"gives .* frames with parts missing within 0.05 s; check"):
        taken(twin, monkeypatch, tmp_path, timeout_s=0.05)
    assert not twin.runs


def test_a_silent_camera_does_not_hang(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ticking(monkeypatch)
    with pytest.raises(DeviceError, match=r"GenICam camera Twin 22180001 gives no frame within 0.05 s; check"):
        taken(GenICamTwin(lambda exposure_s: scene(12), silent=True), monkeypatch, tmp_path, timeout_s=0.05)


def test_the_exposure_is_what_the_camera_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    twin = GenICamTwin(lambda exposure_s: scene(12))
    exposure = twin.nodes.ExposureTime

    class InLines:
        """It counts its exposures in lines of 33 us."""

        def __getattr__(self, name: str) -> Any:
            return getattr(exposure, name)

        @property
        def value(self) -> float:
            return float(exposure.value)

        @value.setter
        def value(self, asked: float) -> None:
            exposure.value = round(asked / 33) * 33.0

    nodes = SimpleNamespace(ExposureTime=InLines(), has_node=twin.nodes.has_node)
    for name in ("PixelFormat", "Width", "Height", "AcquisitionMode", "ExposureAuto", "GainAuto", "TriggerMode"):
        setattr(nodes, name, getattr(twin.nodes, name))
    nodes.GammaEnable = twin.nodes.GammaEnable
    twin.remote_device.node_map = nodes
    assert taken(twin, monkeypatch, tmp_path, exposure_s=0.0020).exposure_s == pytest.approx(61 * 33e-6, rel=1e-12)
    with pytest.raises(DeviceError, match=r"exposes 6.6e-05 s where 5e-05 s were asked"):
        taken(twin, monkeypatch, tmp_path, exposure_s=5e-5, camera={"exposure_limits_s": (1e-5, 0.1)})


@pytest.mark.parametrize(
    ("twin", "keys", "error", "message"),
    [
        ({"without": ("ExposureTime",)}, {}, DeviceError, "no feature ExposureTime or ExposureTimeAbs that can be set"),
        ({"shortest_us": 9e4}, {}, DeviceError, "gives no frame: .*OutOfRange"),
        (
            {"formats": ("Mono8",)},
            {},
            DeviceError,
            r"none of the formats Mono12, Mono12p, Mono12Packed .* it has Mono8",
        ),
        ({}, {"pixel_format": "Mono8"}, ConfigError, 'pixel_format = "Mono8" does not fit camera.pattern = "mono" and'),
        ({}, {"pixel_fromat": "Mono8"}, ConfigError, 'unknown key pixel_fromat; did you mean "pixel_format"'),
        ({}, {"gain": 99.0}, DeviceError, "does not open: .*OutOfRange"),
        ({}, {"camera": {"width": 33}}, DeviceError, "does not take Width = 33"),
        (
            {"formats": ("Mono10p",)},
            {"camera": {"width": 34, "bits": 10}},
            ConfigError,
            "a line of Mono10p ends within",
        ),
        ({}, {"camera": {"height": 40}}, DeviceError, "gives 32 x 32 pixels; the rig file says 32 x 40"),
        ({}, {"serial": "1"}, DeviceError, 'devices.camera.serial = "1": no such GenICam camera; found: "22180001"'),
        ({}, {"producer": "no.cti"}, ConfigError, 'devices.camera.producer = "no.cti": there is no such file'),
    ],
)
def test_what_does_not_fit_is_named(
    twin: dict[str, Any],
    keys: dict[str, Any],
    error: type[Exception],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    made = GenICamTwin(lambda exposure_s: scene(12), described(**({"formats": tuple(FORMATS)} | twin)))
    with pytest.raises(error, match=message):
        taken(made, monkeypatch, tmp_path, **keys)
    assert not made.runs
    assert not made.opened


def test_values_beyond_the_bits_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Some cameras shift 12 bits to the top of 16."""
    twin = GenICamTwin(lambda exposure_s: scene(12) * np.uint16(16), described(("Mono12",)))
    with pytest.raises(DeviceError, match=r"values up to .*, beyond the 12 bits of Mono12"):
        taken(twin, monkeypatch, tmp_path)


def test_without_a_producer_the_folders_of_the_environment_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    description = rig(width=400, height=400, bits=8, black_level_dn=0.0)
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(Path(viky()).parent))
    with pytest.raises(DeviceError, match="has no feature ExposureTime"):
        build(description, {"driver": "genicam", "serial": "0"}).__enter__()
    monkeypatch.delenv("GENICAM_GENTL64_PATH")
    with pytest.raises(ConfigError, match=r"devices.camera.producer is missing: name the .cti file"):
        build(description, {"driver": "genicam"}).__enter__()
