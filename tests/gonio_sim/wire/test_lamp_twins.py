"""What the lamps' twins answer."""

from gonio_sim.wire.lamps import LAMPS

from gonio.lab.rig.light_and_camera import Band

BANDS = (Band(name="green", centre_nm=550, fwhm_nm=20),)


def test_an_arduino_tells_whether_it_shines() -> None:
    lamp = LAMPS["arduino"](BANDS)
    said: list[bytes] = []
    for line in (b"STATE\n", b"SET 1 0.5\n", b"ON 1\n", b"STATE\n", b"GET 1\n", b"OFF\n", b"STATE\n", b"ON 9\n"):
        lamp.receive(line, lamp.bauds[0], said.append)
    assert [one.strip() for one in said] == [
        b"OFF", b"OK", b"OK", b"ON", b"0.5000", b"OK", b"OFF", b"ERR bad channel",
    ]  # fmt: skip
