"""`gonio demo`: the whole line on one simulated sample, each step a file that can be run again."""

import os
import sys
import time
from pathlib import Path

from gonio.errors import ConfigError, os_error_as

SEED = 1

SAMPLE = """\
# The roughened aluminium of He, Torrance, Sillion and Greenberg (1991), Fig. 8.
name = "rough aluminium"
model = "he-torrance"
[parameters]
sigma0_um = 0.28
tau_um = 1.77
ior = "Al"
"""

PLAN = """\
# In the plane of incidence: theta_r is signed, positive on the mirror side.
name = "aluminium at 500 nm"
wavelength_nm = [500]
[[sweep]]
theta_i_deg = [10, 30, 45, 60, 75]
theta_r_deg = { start = -80, stop = 85, step = 2.5 }
"""

QUICK_PLAN = """\
# In the plane of incidence: theta_r is signed, positive on the mirror side.
name = "aluminium at 500 nm, quickly"
wavelength_nm = [500]
[[sweep]]
theta_i_deg = [15, 45, 75]
theta_r_deg = { start = -75, stop = 82.5, step = 7.5 }
"""

MODELS = ("lambert", "oren-nayar", "cook-torrance", "he-torrance")
QUICK_MODELS = ("lambert", "cook-torrance", "he-torrance")


def _begun(out: Path, *, quick: bool) -> tuple[Path, Path, Path]:
    """The sample's and the plan's files, written, and where the run will be."""
    from gonio.disk import check_writable, write_own

    _clear(out)
    check_writable(out)
    sample, plan = out / "sample.toml", out / "plan.toml"
    with os_error_as(ConfigError, f"{out}: cannot be written"):
        out.mkdir(parents=True, exist_ok=True)
        write_own(out, {sample.name: SAMPLE.encode(), plan.name: (QUICK_PLAN if quick else PLAN).encode()})
    return sample, plan, out / "run"


def run_demo(out: Path, *, quick: bool) -> Path:
    """Measure, reduce, fit, compare and report a simulated aluminium sample.

    Parameters
    ----------
    out
        Folder for the sample file, the plan and the run; an earlier demo in it is replaced.
    quick
        Fewer directions and models.

    Returns
    -------
    Path
        Of the report's `index.html`.

    Raises
    ------
    ConfigError
        The folder holds something else, or cannot be written.
    """
    from gonio_analysis.fitting.fit import fit
    from gonio_analysis.report import make
    from gonio_analysis.report.text import with_u

    from gonio import measurement
    from gonio.cli import console
    from gonio.lab.acquisition.measure import carry_out, find_rig
    from gonio.lab.acquisition.plan import load_plan
    from gonio.lab.commands.progress import on_screen
    from gonio.lab.reduction import brdf
    from gonio.samples.files import load_sample

    began = time.perf_counter()
    sample, plan, run = _begun(out, quick=quick)
    command = f"gonio measure {plan} --rig sim --sample {sample} --seed {SEED} --out {run} --yes"
    _say(command)
    with on_screen() as progress:
        asked = load_plan(plan), find_rig("sim"), run
        made = carry_out(*asked, sample=load_sample(sample), seed=SEED, yes=True, command=command, progress=progress)
    _say(f"gonio reduce {run}")
    with console.counter("reducing") as counting:
        reduced = brdf.reduce_in_parts(made, progress=counting)
    made.write_table(reduced.table, {"budget.csv": reduced.budget})

    _say(f"gonio fit {run / 'brdf.csv'} --model he-torrance --ior Al")
    result = fit(measurement.read(run / "brdf.csv"), "he-torrance", ior="Al")
    for name, true in (("sigma0_um", 0.28), ("tau_um", 1.77)):
        e = result.parameters[name]
        _say(f"  {name} = {with_u(e.value, e.u)} (the sample has {true})", step=False)

    models = QUICK_MODELS if quick else MODELS
    command = f"gonio report {run} --ior Al --models {','.join(models)}"
    _say(command)
    page = make([str(run)], run / "report", models=models, ior="Al", command=command, progress=console.note)
    _say(f"done in {time.perf_counter() - began:.0f} s; open the report in a browser:", step=False)
    return page


def _clear(out: Path) -> None:
    """Take an earlier demo away; refuse anything else."""
    from gonio.disk import NOT_OWN, foreign_files, remove_own, require_name
    from gonio.lab.acquisition.run import own_files

    require_name(out)
    if os.path.lexists(out) and not out.is_dir():
        raise ConfigError(f"{out}: is a file; --out names a folder")
    if not out.is_dir():
        return
    with os_error_as(ConfigError, f"{out}: cannot be cleared"):
        own = {f"run/{name}": found for name, found in own_files(out / "run").items()}
        foreign = foreign_files(out, own)
        if foreign:
            names = ", ".join(foreign[:5]) + (" ..." if len(foreign) > 5 else "")
            raise ConfigError(
                f"{out}: holds what {NOT_OWN} ({names}), and is not replaced; move it away, or choose another folder "
                "with --out"
            )
        if (out / "run").is_dir():
            remove_own(out / "run", own_files(out / "run"))


def _say(text: str, *, step: bool = True) -> None:
    print(f"$ {text}" if step else text, file=sys.stderr, flush=True)
