"""Cameras by name: entry points of the group `gonio.cameras`, ours and others' alike.

An entry point names a callable `(description, settings) -> camera`: the rig's description, and what stands in the table
`[devices.camera]` beside `driver`. It returns a context manager that opens the camera, with the method `capture` of
`gonio.lab.rig.CameraDevice`; it touches no device before it is entered. docs/writing_a_driver.md shows one.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol, Self

from gonio import plugins
from gonio.config import parse
from gonio.errors import ConfigError
from gonio.lab.rig import CameraDevice, Frame
from gonio.lab.rig.description import RigDescription
from gonio.typing import TomlTable
from gonio_drivers import settings

SOURCE = "[devices.camera]"


class OpenableCamera(CameraDevice, AbstractContextManager[CameraDevice, None], Protocol):
    """A `CameraDevice` that is opened as a context."""


def build(description: RigDescription, table: TomlTable) -> OpenableCamera:
    """The camera that the table `[devices.camera]` describes.

    Raises
    ------
    ConfigError
        There is no such driver, or one of its keys is wrong.
    """
    rest = dict(table)
    driver = rest.pop("driver", None)
    if not isinstance(driver, str):
        raise ConfigError(
            f"{SOURCE}: the key driver is missing; installed: {', '.join(plugins.available('gonio.cameras'))}"
        )
    camera: OpenableCamera = plugins.load("gonio.cameras", driver)(description, rest)
    return camera


class Unbuilt:
    """A camera that could not be made, for whoever does not need it: it says why when it is opened."""

    def __init__(self, error: ConfigError) -> None:
        self._error = error

    def __enter__(self) -> Self:
        raise self._error

    def __exit__(self, *_: object) -> None:
        """It was never open."""

    def capture(self, exposure_s: float) -> Frame:
        """Raises what went wrong."""
        raise self._error


def folder(description: RigDescription, table: TomlTable) -> OpenableCamera:
    """RAW files from a watched folder."""
    from gonio_drivers.folder_camera import FolderCamera

    return FolderCamera(description, parse(settings.FolderCameraSettings, table, SOURCE))


def uvc(description: RigDescription, table: TomlTable, capture: Callable[..., Any] | None = None) -> OpenableCamera:
    """A USB video camera; `capture` opens it in place of OpenCV's `VideoCapture`."""
    from gonio_drivers.uvc import UvcCamera

    return UvcCamera(description, parse(settings.UvcCameraSettings, table, SOURCE), capture)


def sequence(description: RigDescription, table: TomlTable) -> OpenableCamera:
    """Images from a folder."""
    from gonio_drivers.folder_camera import SequenceCamera

    return SequenceCamera(description, parse(settings.SequenceCameraSettings, table, SOURCE))
