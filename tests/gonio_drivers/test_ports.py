"""What is said of a serial port that does not open, by the system's error."""

import errno
from pathlib import Path
from types import SimpleNamespace

import pytest
from gonio_drivers import ports
from serial import SerialException


def failed(number: int | None, text: str = "could not open port") -> SerialException:
    error = SerialException(text)
    error.errno = number
    return error


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.EBUSY, "the port is taken"),
        (errno.EAGAIN, "the port is taken"),
        (errno.ENOENT, "there is no such port"),
        (errno.ENODEV, "there is no such port"),
        (errno.ENXIO, "there is no such port"),
        (errno.EACCES, "no permission to open it"),
        (errno.EPERM, "no permission to open it"),
        (errno.EISDIR, "this is no serial port"),
        (errno.EIO, "cannot be opened as a serial port: could not open port"),
    ],
)
def test_each_error_of_the_system_has_its_remedy(number: int, said: str, tmp_path: Path) -> None:
    port = tmp_path / "port"
    port.touch()
    told = str(ports.unopened(str(port), failed(number), "devices.servos.port"))
    assert told.startswith(f'devices.servos.port = "{port}"')
    assert said in told


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("", "Could not exclusively lock port", "the port is taken"),
        ("", "Could not configure port: (25, ...)", "this is no serial port"),
        ("", "what nobody expects", "cannot be opened as a serial port: what nobody expects"),
        ("COM9", "could not open port 'COM9': FileNotFoundError(2, 'no such file', None, 2)", "there is no such port"),
        ("COM3", "could not open port 'COM3': PermissionError(13, 'Access is denied.', None, 5)", "the port is taken"),
        ("socket://127.0.0.1:9", "Could not open port: [Errno 111] Connection refused", "is the server running there"),
    ],
)
def test_words_of_the_library_tell_where_there_is_no_number(name: str, text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "port").touch()
    port = name or str(tmp_path / "port")
    told = str(ports.unopened(port, failed(None, text), "devices.light.port"))
    assert told.startswith(f'devices.light.port = "{port}": ')
    assert said in told


def test_a_port_that_is_not_there_is_no_such_port_whatever_the_error(tmp_path: Path) -> None:
    told = str(ports.unopened(str(tmp_path / "none"), failed(None, "?"), "key"))
    assert "there is no such port (if it is a twin's: does `gonio sim serve` run?)" in told
    assert "is the adapter plugged in?" in str(ports.unopened("/dev/there-is-none", failed(None, "?"), "key"))


def test_ports_that_are_there_are_sorted_and_have_an_adapter(monkeypatch: pytest.MonkeyPatch) -> None:
    known = {"/dev/b": "USB", "/dev/s": "n/a", "/dev/a": "PCI"}
    found = [SimpleNamespace(device=device, hwid=hwid) for device, hwid in known.items()]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: found)
    assert ports.present() == ["/dev/a", "/dev/b"]


def test_a_port_on_the_network_names_its_server() -> None:
    told = str(ports.unopened("socket://127.0.0.1:7000", failed(errno.EACCES, "refused"), "key"))
    assert "refused; is the server running there" in told
