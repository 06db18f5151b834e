"""`gonio warm`."""

from functools import partial
from typing import Any


def warm() -> None:
    """Compile all models now, for evaluation, fits and maps, so that no later command waits for it."""
    import time

    from gonio.cli import console

    every, began = jobs(), time.perf_counter()
    with console.counter("compiling", lines=True) as progress:
        for done, job in enumerate(every, 1):
            job()
            progress(done, len(every))
    console.show(f"{len(every)} kinds of fits are compiled, in {time.perf_counter() - began:.0f} s")


def jobs() -> list[partial[Any]]:
    """A fit of every model to a few made values, and one for maps of every model that has it."""
    import numpy as np

    from gonio import plugins
    from gonio.formats.reader import attributes, table
    from gonio.models import CookTorrance
    from gonio_analysis.fitting.parameters import declared
    from gonio_analysis.fitting.problem import FitRequest
    from gonio_analysis.fitting.spectrum import fit_table

    theta_i, theta_r = np.repeat([10.0, 40.0, 60.0], 16), np.tile(np.linspace(0.0, 75.0, 16), 3)
    phi_r = np.where(np.arange(theta_i.size) % 2, 180.0, 30.0)
    towards = [np.radians(angle) for angle in (theta_i, 0.0 * theta_i, theta_r, phi_r)]
    brdf = CookTorrance(s=0.3, m=0.2, ior=1.5, diffuse_albedo=0.4).brdf(*towards)
    made = table(
        theta_i_deg=theta_i, phi_i_deg=0.0, theta_r_deg=theta_r, phi_r_deg=phi_r, wavelength_nm=550.0,
        brdf=brdf, u_brdf=0.01 * brdf, attrs=attributes(quantity="brdf"),
    )  # fmt: skip
    of_maps = plugins.room("maps").jobs(tuple(towards), brdf) if not plugins.left_out("gonio.rooms", "maps") else []
    return [
        *(partial(fit_table, made, FitRequest(name), name=name) for name in declared()),
        *of_maps,
    ]
