"""What was measured by hand is kept, whatever fails afterwards."""

import signal
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from matplotlib.figure import Figure

import gonio
from gonio.by_hand import scan
from gonio.cli.signals import undisturbed
from gonio.disk import write_whole
from gonio.errors import DataError

TABLE = pd.DataFrame(
    {"angle_deg": [0.0, 1.0], "signal_dn_per_s": [1.0, 2.0], "u_signal_dn_per_s": [0.1, 0.1], "flag": ["", ""]}
)
TABLE.attrs |= {"axis": "camera", "rig": "a rig", "band": "550 nm"}


def _no_pictures(path: Any, data: bytes) -> None:
    if Path(path).name.endswith("view.png") or Path(path).name == "s.png":
        raise OSError(28, "No space left on device")
    write_whole(path, data)


def test_a_table_is_on_the_disk_before_its_plot_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*a: object, **k: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", broken)
    with pytest.raises(KeyboardInterrupt):
        scan.write(TABLE, tmp_path / "s.csv")
    assert len(pd.read_csv(tmp_path / "s.csv")) == 2


def test_a_full_disk_is_blamed_on_the_file_that_did_not_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gonio.disk.write_whole", _no_pictures)
    with pytest.raises(DataError, match=r"s\.png: cannot be written: No space.*whole, in .*s\.csv"):
        scan.write(TABLE, tmp_path / "s.csv")
    with (
        gonio.open_rig("sim-ideal") as rig,
        pytest.raises(DataError, match=r"a-view\.png: cannot be written: No space.*whole, in .*a\.dng"),
    ):
        rig.snap(tmp_path / "a.dng", exposure_s=0.01)
    assert (tmp_path / "a.dng").exists()


def test_signals_wait_while_something_is_written() -> None:
    before = signal.getsignal(signal.SIGINT)
    with undisturbed():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGQUIT)
    assert signal.getsignal(signal.SIGINT) is before
