"""`gonio calibrate`: the group that the modules `calibrate_geometry`, `calibrate_camera`, `calibrate_light` fill."""

from __future__ import annotations

import typer

app = typer.Typer(help="Calibrate a rig: values of its file, measured, with their covariance.", no_args_is_help=True)


@app.callback()
def _calibrate() -> None:
    """Calibrate a rig: values of its file, measured, with their covariance."""
