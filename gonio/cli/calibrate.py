"""`gonio calibrate`: the group that the modules `calibrate_geometry`, `calibrate_camera`, `calibrate_light` fill."""

from __future__ import annotations

import typer

app = typer.Typer(no_args_is_help=True)


@app.callback()
def _calibrate() -> None:
    """Calibrate a rig: values of its file, measured, with their covariance.

    First the geometry, then the camera, then the light. Name each file in the rig file before the next: [calibration]
    files = ["geometry.toml", "camera.toml", "light.toml"]
    """
