"""Ports of the network: the same drivers, and the same twins, over a raw socket and over RFC 2217."""

import contextlib
import selectors
import socket
import threading
from collections.abc import Iterator

import pytest
import serial
import serial.rfc2217
from gonio_drivers import guard, service
from gonio_drivers.dynamixel import Bus
from gonio_drivers.service import ServoService
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.lamps import LAMPS, LampTwin, Shine
from gonio_sim.wire.peer import Device, SerialPeer, SocketPeer, scaled_clock
from gonio_sim.wire.servo import Servo

from gonio.lab.by_hand import new_rig
from gonio.lab.rig.light_and_camera import Band

pytestmark = pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")  # pyserial's
BAUD = 57_600
BANDS = (Band(name="green", centre_nm=550, fwhm_nm=20),)


class Terminal(serial.Serial):  # type: ignore[misc]
    """A pseudo-terminal has no modem lines."""

    cts = dsr = ri = cd = property(lambda self: False)

    def _update_dtr_state(self) -> None: ...

    def _update_rts_state(self) -> None: ...


@contextlib.contextmanager
def rfc2217(port: str) -> Iterator[str]:
    """A server of a serial port, as a terminal server is, for one client after the other."""
    with socket.create_server(("127.0.0.1", 0)) as server, Terminal(port, timeout=0) as line:
        wake, woken = socket.socketpair()

        def serve() -> None:
            manager: serial.rfc2217.PortManager | None = None
            with selectors.DefaultSelector() as look:
                look.register(line, selectors.EVENT_READ, "line")
                for one in (server, woken):
                    look.register(one, selectors.EVENT_READ)
                client = None
                while True:
                    for key, _ in look.select():
                        if key.fileobj is woken:
                            if client is not None:
                                client.close()
                            return
                        if key.fileobj is server:
                            if client is not None:
                                look.unregister(client)
                                client.close()
                            client = server.accept()[0]
                            look.register(client, selectors.EVENT_READ)
                            made = client
                            manager = serial.rfc2217.PortManager(line, type("Out", (), {"write": made.sendall})())
                        elif key.data == "line":
                            data = bytes(line.read(4096))
                            if client is not None and manager is not None:
                                client.sendall(b"".join(manager.escape(data)))
                        elif client is not None and manager is not None:
                            data = client.recv(4096)
                            if data:
                                line.write(b"".join(manager.filter(data)))
                            else:
                                look.unregister(client)
                                client.close()
                                client = None

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        try:
            yield f"rfc2217://127.0.0.1:{server.getsockname()[1]}"
        finally:
            wake.close()
            thread.join()
            woken.close()


@contextlib.contextmanager
def served(device: Device, how: str, speed: int) -> Iterator[str]:
    if how == "socket":
        with SocketPeer(device, speed) as peer:
            yield peer.port
    else:
        with SerialPeer(device) as terminal, rfc2217(terminal.port) as url:
            yield url


@pytest.mark.parametrize("how", ["socket", "rfc2217"])
def test_servos_answer_over_the_network(how: str) -> None:
    clock = scaled_clock(50.0)
    servos = {k: Servo(k, clock, model="xm430-w350", baud=BAUD, position=1000.0 + 500 * k) for k in (1, 2, 3)}
    with served(ServoBus(servos.values()), how, BAUD) as port, Bus(port, BAUD) as bus:
        for number in servos:
            assert bus.ping(number)
        assert int.from_bytes(bus.read(2, 132, 4), "little") == 2000


def test_a_raw_server_is_asked_once_and_not_at_every_line_speed() -> None:
    bus = ServoBus([Servo(1, scaled_clock(50.0), model="xm430-w350", baud=BAUD)])
    with SocketPeer(bus, BAUD) as peer:
        found = ServoService().servos(peer.port, lambda said: None)
    assert [servo.id for servo in found] == [1]


@pytest.mark.parametrize("how", ["socket", "rfc2217"])
def test_a_lamp_is_found_and_darkened_over_the_network(how: str) -> None:
    seen: list[Shine] = []
    lamp: LampTwin = LAMPS["scpi"](BANDS, seen.append)
    with served(lamp, how, lamp.bauds[0]) as port:
        found = service.lamp_on(port)
        assert found is not None
        assert found[0] == "scpi"
        with serial.serial_for_url(port, lamp.bauds[0], timeout=60.0) as line:
            line.write(b"OUTP ON\n")
            line.write(b"*IDN?\n")
            assert line.read_until(b"\n")
        guard._darken(port, lamp.bauds[0], [b"OUTP OFF\n"])
    assert not lamp.shine.lit


def test_a_rig_file_may_name_a_server() -> None:
    assert new_rig.port("socket://bench:4001") == "socket://bench:4001"
    with pytest.raises(ValueError, match="is no port that is there"):
        new_rig.port("/dev/nothing-of-that-name")
