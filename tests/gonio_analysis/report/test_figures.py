"""Figures hold what their captions say, and no panel stays empty."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from gonio_analysis.report import make

from gonio import measurement
from gonio.formats.reader import table


def test_random_directions_leave_no_empty_panel(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    theta_i, theta_r = rng.uniform(5.0, 75.0, (2, 60))
    phi_i, phi_r = rng.uniform(0.0, 360.0, (2, 60))
    value = 0.16 * (1.0 + 0.05 * rng.normal(size=60))
    frame = table(
        theta_i_deg=theta_i, phi_i_deg=phi_i, theta_r_deg=theta_r, phi_r_deg=phi_r, wavelength_nm=550.0,
        brdf=value, u_brdf=0.05 * value, u_random=0.05 * value, attrs={"sample": "random"},
    )  # fmt: skip
    measurement.write(frame, tmp_path / "random.csv")
    make([str(tmp_path / "random.csv")], tmp_path / "out", models=["lambert"])
    svg = (tmp_path / "out" / "figures" / "random-absolute-lambert.svg").read_text(encoding="utf-8")
    box = re.search(r'viewBox="0 0 (\S+) (\S+)"', svg)
    assert box is not None
    assert float(box[2]) < 0.5 * float(box[1])  # one low panel: with the one above it is 0.72
    html = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "residuals alone" in html
    assert "with error bars" not in html
