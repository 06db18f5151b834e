"""The commands `gonio fit`, `compare`, `report` and `appearance`.

Nothing heavy is imported before a command runs: `gonio --help` has to answer at once. What a command does once its
options are read stands in `gonio_analysis.commands.implementations`.
"""

import contextlib
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gonio.cli.options import Columns, reading, remember
from gonio.errors import ConfigError
from gonio_analysis.commands.arguments import names_of, once, read_bound, read_fixed, read_prior, read_radius

MODELS = "lambert,oren-nayar,cook-torrance,he-torrance"
MODELS_HELP = "Models to fit, with commas between (sums as oren-nayar+phong), or all."
DIVISOR_HELP = "What polar curves are divided by"


class NormOption(StrEnum):
    """What polar curves are divided by."""

    mirror = "mirror"
    max = "max"
    model = "model"


RADIUS_HELP = "Radius of the rim of polar plots, the same in all; auto: each by what it shows"
Radius = Annotated[str, typer.Option(metavar="auto|R", help=f"{RADIUS_HELP}.")]
IorOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[SAMPLE=]NAME|n+kj",
        help="Optical constants: a material (Al) or n + ik (0.77+6.08j), of all samples or of one (gold.csv=Au);"
        " remembered beside the file. Without them a real n is fitted.",
    ),
]
Wavelength = Annotated[
    float | None, typer.Option(help="Wavelength [nm] of a table with several, or the effective one of a broad band.")
]
Metric = Annotated[
    str | None,
    typer.Option(
        help="What fits make small: log, weighted, ngan, cube-root or relative; otherwise weighted, or log without u."
    ),
]
URel = Annotated[float | None, typer.Option(help="Relative uncertainty to ASSUME where the table states none (0.03).")]
UIor = Annotated[
    str | None,
    typer.Option(
        metavar="U|sources",
        help="Relative uncertainty of n and k (0.02), or that between the sources of a material: sources.",
    ),
]
Energy = Annotated[bool, typer.Option("--energy", help="Fit with the bound rho_dh <= 1 at the table's incidences.")]
Separate = Annotated[bool, typer.Option("--separate", help="Fit each wavelength alone: no geometry is shared.")]
Png = Annotated[bool, typer.Option("--png", help="Write each figure as PNG, too.")]
Fix = Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE", help="Keep a parameter.")]
Free = Annotated[list[str] | None, typer.Option(metavar="NAME", help="Fit one more parameter.")]
BoundOption = Annotated[list[str] | None, typer.Option(metavar="NAME=LOW:HIGH", help="Narrower bounds.")]
Prior = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=VALUE+-U", help="What is known beforehand, U its standard uncertainty."),
]
Each = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME|FOLDER|LIST",
        help="With --joint: a value at each wavelength. Without TABLE: fit each table of a folder or a list.",
    ),
]
More = Annotated[
    list[str] | None, typer.Argument(metavar="[MORE ...]", help="Tables of the same sample: all are fitted together.")
]
Save = Annotated[Path | None, typer.Option(help="Write the fitted model as a sample file (.toml).", metavar="SAMPLE")]
Measurements = Annotated[list[str], typer.Argument(metavar="A [B ...]", help="Tables, runs, FILE:SAMPLE, or two maps.")]
Dask = Annotated[str | None, typer.Option(metavar="ADDRESS", help="Work on the Dask cluster of this scheduler.")]
Shared = Annotated[
    list[str] | None,
    typer.Option(
        metavar="CAUSE[=A,B]",
        help="With --laboratories: a cause that is the same in all, or in those named, as reference=A,B; once each.",
    ),
]
Residual = Annotated[bool, typer.Option("--residual", help="Save the model with a smooth curve of its misfit.")]


def _with_parameters(ctx: typer.Context, model: str) -> str:
    """Let `gonio fit --model NAME --help` end with the model's parameters."""
    from gonio_analysis.fitting import parameters

    with contextlib.suppress(ConfigError):  # the command says it
        rows = [row for part in parameters.parts(model) for row in parameters.told(parameters.kind(part))]
        said = []
        for name, unit, default, allowed, bounds, text in rows:
            facts = {"": f"{allowed} {unit}", "default": default, "bounds of a fit": bounds}
            words = "; ".join(f"{label} {fact}".strip() for label, fact in facts.items() if fact.strip())
            said.append(f"{name}: {text} [{words}]")
        ctx.command.epilog = "\n\n".join([f"Parameters of {model}:", *said])
    return model


def fit(
    model: Annotated[
        str,
        typer.Option(
            help="Which model: he-torrance, cook-torrance, ... Before --help: its parameters are told.",
            is_eager=True,
            callback=_with_parameters,
        ),
    ],
    table: Annotated[str | None, typer.Argument(metavar="TABLE", help="A table, a run, FILE:SAMPLE, or a map.")] = None,
    more: More = None,
    ior: IorOption = None,
    fix: Fix = None,
    free: Free = None,
    bound: BoundOption = None,
    prior: Prior = None,
    loss: Annotated[str, typer.Option(help="linear, or a robust one: soft_l1, huber, cauchy, arctan.")] = "linear",
    intervals: Annotated[bool, typer.Option("--intervals", help="Profile-likelihood intervals (95 %).")] = False,
    slopes: Annotated[int, typer.Option(help="Slopes of Cook-Torrance's facets, 1 or 2.")] = 1,
    wavelength_nm: Wavelength = None,
    metric: Metric = None,
    u_rel: URel = None,
    u_ior: UIor = None,
    energy: Energy = False,
    joint: Annotated[bool, typer.Option("--joint", help="Fit all wavelengths together.")] = False,
    each: Each = None,
    separate: Separate = False,
    save: Save = None,
    residual: Residual = False,
    out: Annotated[
        Path | None, typer.Option(help="Of a map: its fits (FITS.h5). Of --each: one row a table (TABLE.csv).")
    ] = None,
    materials: Annotated[
        str | None, typer.Option(metavar="K|auto", help="Of a map: fit pixels that are alike together.")
    ] = None,
    dask: Dask = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    columns: Columns = None,
) -> None:
    """Fit one model to measurements of a sample. With the table's covariance, and through the instrument's cones.

    Of a map (gonio reduce --map) every pixel is fitted, without the cones. With --each and no TABLE: very many tables.
    """
    from gonio_analysis.commands import implementations
    from gonio_analysis.fitting.optical_constants import Constants
    from gonio_analysis.fitting.problem import FitRequest

    how, constants = reading(columns), Constants.of(ior)
    asked = FitRequest(
        model,
        ior=constants.of_all,
        fix=once("--fix", [read_fixed(text) for text in fix or []]),
        free=free or (),
        slopes=slopes,
        wavelength_nm=wavelength_nm,
        each=(each or []) if joint or (each and table is not None) else None,
        bounds=once("--bound", [read_bound(text) for text in bound or []]),
        priors=once("--prior", [read_prior(text) for text in prior or []]),
        loss=loss,
        metric=metric,
        u_rel=u_rel,
        energy=energy,
        separate=separate,
    )
    wanted = implementations.Wanted(constants, u_ior, intervals, save, residual, as_json)
    others = {"MORE": more, "--joint": joint}
    if not implementations.fit_many(
        table, each, asked, how, wanted, out=out, dask=dask, materials=materials, others=others
    ):
        implementations.fit([str(table), *(more or [])], asked, how, wanted)


def compare(
    measurements: Measurements,
    out: Annotated[Path, typer.Option(help="Folder of the report.")],
    models: Annotated[str | None, typer.Option(help=f"{MODELS_HELP} Otherwise {MODELS.replace(',', ', ')}.")] = None,
    normalise: Annotated[NormOption | None, typer.Option(help=f"{DIVISOR_HELP}; otherwise mirror.")] = None,
    radius: Annotated[str | None, typer.Option(metavar="auto|R", help=f"{RADIUS_HELP}. Otherwise auto.")] = None,
    ior: IorOption = None,
    wavelength_nm: Wavelength = None,
    metric: Metric = None,
    u_rel: URel = None,
    energy: Energy = False,
    separate: Separate = False,
    dask: Dask = None,
    change: Annotated[
        bool, typer.Option("--change", help="Compare two point by point; a model is given by its sample file (.toml).")
    ] = False,
    laboratories: Annotated[
        bool, typer.Option("--laboratories", help="One sample by several laboratories: do they agree, who is off?")
    ] = False,
    shared: Shared = None,
    png: Png = False,
    columns: Columns = None,
) -> None:
    """Fit several models to measurements, and write a report.

    With --change instead: did A change into B? With --laboratories: do they agree?
    """
    from gonio_analysis.commands import implementations

    how = reading(columns)
    fitting = {"models": models, "normalise": normalise, "radius": radius, "ior": ior, "dask": dask, "metric": metric,
               "energy": energy or None, "separate": separate or None, "png": png or None}  # fmt: skip
    unused = [name for name, value in fitting.items() if value is not None]
    implementations.check_one_way(change=change, laboratories=laboratories, unused=unused, shared=bool(shared))
    if change:
        page = implementations.change(measurements, out, wavelength_nm, u_rel, how)
    elif laboratories:
        page = implementations.laboratories(measurements, out, shared or [], wavelength_nm, u_rel, how)
    else:
        page = implementations.report(
            measurements, out, names_of(MODELS if models is None else models),
            normalise=(normalise or NormOption.mirror).value, radius=read_radius(radius or "auto"), ior=ior,
            wavelength_nm=wavelength_nm, metric=metric, u_rel=u_rel, bound_energy=energy, separate=separate,
            dask=dask, png=png, how=how,
        )  # fmt: skip
    remember(measurements, how)
    print(page)


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN|MAP", help="Folder of a reduced run, or a map (.h5).")],
    out: Annotated[Path | None, typer.Option(help="Folder of the report; otherwise RUN/report.")] = None,
    values: Annotated[
        Path | None, typer.Option("--map", metavar="MAP", help="Of a map of fits: the map of values that was fitted.")
    ] = None,
    models: Annotated[str, typer.Option(help=MODELS_HELP)] = MODELS,
    normalise: Annotated[NormOption, typer.Option(help=f"{DIVISOR_HELP}.")] = NormOption.mirror,
    radius: Radius = "auto",
    ior: IorOption = None,
    wavelength_nm: Wavelength = None,
    metric: Metric = None,
    u_rel: URel = None,
    energy: Energy = False,
    separate: Separate = False,
    png: Png = False,
) -> None:
    """Write the report of one run, or of a map: what is in every pixel."""

    from gonio import plugins
    from gonio.hdf5 import MAP_SUFFIXES, is_map
    from gonio_analysis.commands import implementations

    if out is None and run.is_file() and run.suffix in MAP_SUFFIXES:
        raise ConfigError(f"{run}: the report on a map needs a folder: --out DIR")
    if is_map(run):
        fitting = {"radius": read_radius(radius), "ior": ior, "wavelength-nm": wavelength_nm, "metric": metric,
                   "u-rel": u_rel, "energy": energy or None, "separate": separate or None,
                   "png": png or None}  # fmt: skip
        unused = [name for name, value in fitting.items() if value is not None]
        print(plugins.room("maps").report(run, out, values, unused))
        return
    if values is not None:
        raise ConfigError(f"--map {values}: goes with a map of fits; {run} is none")
    if not run.is_dir():
        what = "is neither the folder of a run nor a map" if run.exists() else "there is no such folder"
        raise ConfigError(f"{run}: {what}; gonio report takes a run (for a file: gonio compare)")
    print(
        implementations.report(
            [str(run)], out or run / "report", names_of(models), normalise=normalise.value,
            radius=read_radius(radius), ior=ior, wavelength_nm=wavelength_nm, metric=metric, u_rel=u_rel,
            bound_energy=energy, separate=separate, png=png,
        )
    )  # fmt: skip


def appearance(
    sample: Annotated[
        str, typer.Argument(metavar="TABLE|SAMPLE", help="A table, a run, FILE:SAMPLE, or a model: sample.toml.")
    ],
    wavelength_nm: Wavelength = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the quantities as JSON.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder of a page with them.")] = None,
    columns: Columns = None,
) -> None:
    """Gloss, haze, reflectances, colour over angle, retroreflection and roughness. Of a measurement or of a model."""
    from gonio_analysis.commands import implementations

    implementations.appearance(sample, wavelength_nm, out, reading(columns), as_json=as_json)
