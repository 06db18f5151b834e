"""What is no file is written to and stays what it is; a folder is refused."""

import os
import stat
import threading
from pathlib import Path

import pytest

from gonio.disk import Staged, write_whole

from ..command_line import gonio

TABLE = """\
theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,wavelength_nm,polarisation,brdf,u_brdf,flag
10,0,20,180,550,unpolarised,0.3,0.001,
10,0,30,180,550,unpolarised,0.2,0.001,
"""


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "t.csv"
    path.write_text(TABLE)
    return path


def test_a_pipe_gets_the_bytes_and_stays_a_pipe(table: Path, tmp_path: Path) -> None:
    pipe, got = tmp_path / "pipe.csv", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    done = gonio(tmp_path, "convert", table, pipe)
    reader.join(30.0)
    assert done.returncode == 0, done.stderr
    assert b"theta_i_deg" in got[0]
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["pipe.csv", "t.csv"]
    assert "need a file" in done.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="only root makes device nodes")
def test_a_device_stays_a_device(table: Path, tmp_path: Path) -> None:
    null = tmp_path / "null"
    try:
        os.mknod(null, stat.S_IFCHR | 0o666, os.makedev(1, 3))  # the numbers of Linux's null device
        null.write_bytes(b"")
    except OSError as error:
        pytest.skip(f"no device can be made or opened here: {error}")
    done = gonio(tmp_path, "convert", table, null)
    assert done.returncode == 0, done.stderr
    write_whole(null, b"12345")
    assert stat.S_ISCHR(null.stat().st_mode)
    with pytest.raises(OSError, match="is not replaced"):
        Staged(null, b"12345")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["null", "t.csv"]


def test_a_minus_is_standard_output(table: Path, tmp_path: Path) -> None:
    done = gonio(tmp_path, "convert", table, "-")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("theta_i_deg")
    assert "2 values" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["t.csv"]


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"old")
    (tmp_path / "link").symlink_to("file")
    write_whole(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_bytes() == b"new"


@pytest.mark.parametrize("words", [["."], ["/"], [".", "--to", "gonio"], ["out", "--to", "mitsuba"]])
def test_a_folder_is_no_file(table: Path, tmp_path: Path, words: list[str]) -> None:
    (tmp_path / "out").mkdir()
    done = gonio(tmp_path, "convert", table, *words)
    assert done.returncode == 2
    assert "is a folder; name the file" in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "t.csv"]
