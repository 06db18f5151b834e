"""The commands `gonio demo`, `fit`, `compare`, `report`, `appearance` and `watch`.

Nothing heavy is imported before a command runs: `gonio --help` has to answer at once.
"""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gonio.cli.options import Blank, Columns, reading, remember
from gonio_analysis.commands.arguments import (
    given_constants,
    read_bound,
    read_fixed,
    read_ior,
    read_prior,
    with_u_ior,
)

if TYPE_CHECKING:
    from gonio.measurement import Reading
    from gonio_analysis.fitting.fit import FitResult
    from gonio_analysis.fitting.observations import Observations
    from gonio_analysis.fitting.profile_likelihood import Interval
    from gonio_analysis.result_records import Appearance

MODELS = "lambert,oren-nayar,cook-torrance,he-torrance"
MODELS_HELP = "Models to fit, with commas between (sums as oren-nayar+phong), or all."
IOR_HELP = "Optical constants: a material (Al) or n + ik (0.77+6.08j); without them a real n is fitted."
METRIC_HELP = "What fits make small: log, weighted, ngan, cube-root or relative; otherwise weighted, or log without u."
U_REL_HELP = "Relative uncertainty to ASSUME where the table states none (0.03)."
U_IOR_HELP = "Relative uncertainty of n and k (0.02), or that between the sources of a material: sources."
ENERGY_HELP = "Fit with the bound rho_dh <= 1 at the table's incidences."
SHARED_HELP = "With --laboratories: a cause that is the same in all, or in those named, as reference=A,B; once each."
SEPARATE_HELP = "Fit each wavelength alone: no geometry is shared."
WAVELENGTH_HELP = "Wavelength [nm] of a table with several, or the effective one of a broad band."


class Norm(StrEnum):
    """What polar curves are divided by."""

    mirror = "mirror"
    max = "max"
    model = "model"


def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything that is made.")] = Path("gonio-demo"),
    quick: Annotated[bool, typer.Option("--quick", help="Fewer directions: done in seconds.")] = False,
) -> None:
    """Measure, reduce, fit and report one simulated sample. Prints the report's path last."""
    from gonio_analysis.commands.demonstration import run_demo

    print(run_demo(out, quick=quick))


def watch(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="Folder of a run; it need not exist yet.", show_default=False)
    ],
    port: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, help="Port of the page; that of last time, or any that is free.", show_default=False
        ),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address to serve at; other machines see the page at 0.0.0.0.")
    ] = "127.0.0.1",
    text: Annotated[bool, typer.Option("--text", help="Show the run in the terminal, too.")] = False,
) -> None:
    """Follow a run from another process, or look at one that has ended. Prints the page's address first."""
    from gonio_analysis.commands import watching

    watching.watch(run, host, port, text)


def fit(
    table: Annotated[str, typer.Argument(metavar="TABLE", help="A table, a run, or FILE:SAMPLE.", show_default=False)],
    model: Annotated[str, typer.Option(help="Which model: he-torrance, cook-torrance, ...", show_default=False)],
    more: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MORE ...]", help="Tables of the same sample: all are fitted together.", show_default=False
        ),
    ] = None,
    ior: Annotated[str | None, typer.Option(help=IOR_HELP, show_default=False)] = None,
    fix: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Keep a parameter.", show_default=False)
    ] = None,
    free: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Fit one more parameter.", show_default=False)
    ] = None,
    bound: Annotated[
        list[str] | None, typer.Option(metavar="NAME=LOW:HIGH", help="Narrower bounds.", show_default=False)
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE+-U", help="What is known beforehand, U its standard uncertainty.", show_default=False
        ),
    ] = None,
    loss: Annotated[str, typer.Option(help="linear, or a robust one: soft_l1, huber, cauchy, arctan.")] = "linear",
    searches: Annotated[int, typer.Option(help="Starts of a coarse grid to search from.")] = 4,
    intervals: Annotated[bool, typer.Option("--intervals", help="Profile-likelihood intervals (95 %).")] = False,
    slopes: Annotated[int, typer.Option(help="Slopes of Cook-Torrance's facets, 1 or 2.")] = 1,
    wavelength_nm: Annotated[float | None, typer.Option(help=WAVELENGTH_HELP, show_default=False)] = None,
    metric: Annotated[str | None, typer.Option(help=METRIC_HELP, show_default=False)] = None,
    u_rel: Annotated[float | None, typer.Option(help=U_REL_HELP, show_default=False)] = None,
    u_ior: Annotated[str | None, typer.Option(metavar="U|sources", help=U_IOR_HELP, show_default=False)] = None,
    energy: Annotated[bool, typer.Option("--energy", help=ENERGY_HELP)] = False,
    joint: Annotated[bool, typer.Option("--joint", help="Fit all wavelengths together.")] = False,
    each: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="With --joint: a value at each wavelength.", show_default=False),
    ] = None,
    separate: Annotated[bool, typer.Option("--separate", help=SEPARATE_HELP)] = False,
    save: Annotated[
        Path | None,
        typer.Option(help="Write the fitted model as a sample file (.toml).", metavar="SAMPLE", show_default=False),
    ] = None,
    residual: Annotated[
        bool, typer.Option("--residual", help="Save the model with a smooth curve of its misfit.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    columns: Columns = None,
    blank: Blank = None,
) -> None:
    """Fit one model to measurements of a sample. With the table's covariance, and through the instrument's cones."""

    from gonio import shown
    from gonio.cli import console
    from gonio_analysis import result_records
    from gonio_analysis.fitting import parameters, saving
    from gonio_analysis.fitting.observations import together
    from gonio_analysis.fitting.problem import FitRequest
    from gonio_analysis.fitting.spectrum import fit_table
    from gonio_analysis.report.verdict import after_misfit, reflectances
    from gonio_analysis.selection.energy import of_model

    how = reading(columns, blank)
    index = read_ior(ior)
    kept = _once("--fix", [read_fixed(text) for text in fix or []])
    parameters.family(model, slopes=slopes, ior=index)
    tables = [table, *(more or [])]
    read = [_observed(one, u_rel, how) for one in tables]
    name = read[0][0]
    simulated = [made for *_, made in read]
    asked = FitRequest(
        model,
        ior=index,
        fix=kept,
        free=free or (),
        slopes=slopes,
        wavelength_nm=wavelength_nm,
        each=(each or []) if joint or each else None,
        bounds=_once("--bound", [read_bound(text) for text in bound or []]),
        priors=_once("--prior", [read_prior(text) for text in prior or []]),
        loss=loss,
        metric=metric,
        u_rel=u_rel,
        energy=energy,
        searches=searches,
        separate=separate,
    )
    if save is not None:
        saving.check_target(save, asked)
    if residual:
        saving.check_residual(save, asked)
    several = dict(zip(_short(tables), (data for _, data, _ in read), strict=True))
    if u_ior is not None:
        asked = with_u_ior(asked, u_ior, together(several).nearest(wavelength_nm)[1])
    result, *others = fit_table(together(several), asked, name=" + ".join(tables), say=console.note)
    walked = {}
    if intervals:
        from gonio_analysis.fitting import profile_likelihood
        from gonio_analysis.fitting.fit import fit as fit_one

        if others:
            walked = profile_likelihood.profiles(result).intervals
        else:
            from dataclasses import replace

            data = together(several)
            result, walked = profile_likelihood.walked(result, lambda start: fit_one(data, replace(asked, start=start)))
    rho_dh = of_model(result)
    if save is not None:
        saving.save(result, save, name=name, source=" + ".join(map(shown.marked, tables, simulated)), residual=residual)
    remember(tables, how)
    if as_json:
        out = {**result.to_json(), "sample": name, "table": tables if more else table}
        out["simulated"] = simulated if more else simulated[0]
        out["rho_dh"] = result_records.as_json(rho_dh)
        if others:
            series = sorted([result, *others], key=lambda r: r.wavelength_nm)
            out["series"] = result_records.as_json([r.at_wavelength for r in series])
        if intervals:
            out["intervals"] = {n: result_records.as_json(i) for n, i in walked.items()}
        print(json.dumps(out, indent=1, ensure_ascii=False))
    else:
        if 0 < sum(simulated) < len(tables):
            console.note("simulated: " + ", ".join(t for t, made in zip(tables, simulated, strict=True) if made))
        _print(result, shown.marked(name, simulated[0]), walked)
        if residual:
            console.note(after_misfit(result))
        if rho_dh:
            console.note(reflectances(result.name, rho_dh, given=given_constants(result)))


def _observed(table: str, u_rel: float | None, how: Reading) -> tuple[str, Observations, bool]:
    """The one sample that a table on the command line names, its usable values, and whether they are simulated."""
    from gonio import measurement
    from gonio.errors import ConfigError
    from gonio_analysis.fitting.observations import observations

    samples = measurement.tables(table, how)
    if len(samples) > 1:
        listed = "; ".join(samples)
        raise ConfigError(f"{table} holds {len(samples)} samples: name one as {table}:SAMPLE, of: {listed}")
    name, frame = next(iter(samples.items()))
    return name, observations(frame, table, u_rel), measurement.is_simulated(frame)


def _short(tables: list[str]) -> list[str]:
    """What messages call tables that are fitted together: their files' names, or their paths where those are alike."""
    from gonio.errors import ConfigError

    if len(set(tables)) < len(tables):
        twice = next(table for table in tables if tables.count(table) > 1)
        raise ConfigError(f"{twice}: is named twice; its values would count twice")
    names = [Path(table).name.removesuffix(".csv") for table in tables]
    return names if len(set(names)) == len(names) else tables


def compare(
    measurements: Annotated[
        list[str], typer.Argument(metavar="A [B ...]", help="Tables, runs, or FILE:SAMPLE.", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="Folder of the report.", show_default=False)],
    models: Annotated[
        str | None,
        typer.Option(help=f"{MODELS_HELP} Otherwise {MODELS.replace(',', ', ')}.", show_default=False),
    ] = None,
    normalise: Annotated[
        Norm | None, typer.Option(help="What polar curves are divided by; otherwise mirror.", show_default=False)
    ] = None,
    ior: Annotated[str | None, typer.Option(help=IOR_HELP, show_default=False)] = None,
    wavelength_nm: Annotated[float | None, typer.Option(help=WAVELENGTH_HELP, show_default=False)] = None,
    metric: Annotated[str | None, typer.Option(help=METRIC_HELP, show_default=False)] = None,
    u_rel: Annotated[float | None, typer.Option(help=U_REL_HELP, show_default=False)] = None,
    energy: Annotated[bool, typer.Option("--energy", help=ENERGY_HELP)] = False,
    separate: Annotated[bool, typer.Option("--separate", help=SEPARATE_HELP)] = False,
    dask: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Fit on the Dask cluster of this scheduler.", show_default=False),
    ] = None,
    change: Annotated[
        bool, typer.Option("--change", help="Compare two point by point; a model is given by its sample file (.toml).")
    ] = False,
    laboratories: Annotated[
        bool, typer.Option("--laboratories", help="One sample by several laboratories: do they agree, who is off?")
    ] = False,
    shared: Annotated[
        list[str] | None, typer.Option(metavar="CAUSE[=A,B]", help=SHARED_HELP, show_default=False)
    ] = None,
    columns: Columns = None,
    blank: Blank = None,
) -> None:
    """Fit several models to measurements, and write a report.

    With --change instead: did A change into B? With --laboratories: do they agree?
    """
    how = reading(columns, blank)
    fitting = {
        "models": models,
        "normalise": normalise,
        "ior": ior,
        "dask": dask,
        "metric": metric,
        "energy": energy or None,
        "separate": separate or None,
    }
    unused = [name for name, value in fitting.items() if value is not None]
    _one_way(change=change, laboratories=laboratories, unused=unused, shared=bool(shared))
    if change:
        page = _change(measurements, out, wavelength_nm, u_rel, how)
    elif laboratories:
        page = _laboratories(measurements, out, shared or [], wavelength_nm, u_rel, how)
    else:
        page = _report(
            measurements,
            out,
            _names(MODELS if models is None else models),
            normalise or Norm.mirror,
            ior,
            wavelength_nm,
            dask,
            metric=metric,
            u_rel=u_rel,
            energy=energy,
            separate=separate,
            how=how,
        )
    remember(measurements, how)
    print(page)


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a reduced run.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option(help="Folder of the report; otherwise RUN/report.", show_default=False)
    ] = None,
    models: Annotated[str, typer.Option(help=MODELS_HELP)] = MODELS,
    normalise: Annotated[Norm, typer.Option(help="What polar curves are divided by.")] = Norm.mirror,
    ior: Annotated[str | None, typer.Option(help=IOR_HELP, show_default=False)] = None,
    wavelength_nm: Annotated[float | None, typer.Option(help=WAVELENGTH_HELP, show_default=False)] = None,
    metric: Annotated[str | None, typer.Option(help=METRIC_HELP, show_default=False)] = None,
    u_rel: Annotated[float | None, typer.Option(help=U_REL_HELP, show_default=False)] = None,
    energy: Annotated[bool, typer.Option("--energy", help=ENERGY_HELP)] = False,
    separate: Annotated[bool, typer.Option("--separate", help=SEPARATE_HELP)] = False,
) -> None:
    """Write the report of one run."""
    from gonio.errors import ConfigError

    if not run.is_dir():
        raise ConfigError(f"{run}: there is no such folder; gonio report takes a run (for a file: gonio compare)")
    out = out or run / "report"
    print(
        _report(
            [str(run)],
            out,
            _names(models),
            normalise,
            ior,
            wavelength_nm,
            metric=metric,
            u_rel=u_rel,
            energy=energy,
            separate=separate,
        )
    )


def appearance(
    sample: Annotated[
        str,
        typer.Argument(
            metavar="TABLE|SAMPLE", help="A table, a run, FILE:SAMPLE, or a model: sample.toml.", show_default=False
        ),
    ],
    wavelength_nm: Annotated[float | None, typer.Option(help=WAVELENGTH_HELP, show_default=False)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the quantities as JSON.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder of a page with them.", show_default=False)] = None,
    columns: Columns = None,
    blank: Blank = None,
) -> None:
    """Gloss, haze, reflectances, colour over angle, retroreflection and roughness. Of a measurement or of a model."""

    from gonio.acquisition.run import command_line
    from gonio_analysis.appearance.quantities import of
    from gonio_analysis.result_records import as_json as plain

    if wavelength_nm is not None:
        from gonio.errors import ConfigError

        if not 0.0 < wavelength_nm < float("inf"):
            raise ConfigError(f"--wavelength-nm {wavelength_nm:g}: a wavelength is above 0 nm")
    how = reading(columns, blank)
    found = of(sample, wavelength_nm=wavelength_nm, how=how)
    page = None
    if out is not None:
        from gonio_analysis.report import appearance as report_on_it

        page = report_on_it.make(found, out, command=command_line())
    remember([sample], how)
    if as_json:
        print(json.dumps(plain(found), indent=1, ensure_ascii=False, allow_nan=False))
        return
    _print_appearance(found)
    if page is not None:
        print(page)


def _names(models: str) -> list[str]:
    """The models that --models lists."""
    from gonio.errors import ConfigError

    names = [name.strip() for name in models.split(",")]
    if not all(names):
        raise ConfigError(f'--models "{models}": a name is missing; they are separated by single commas')
    return names


def _once(option: str, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """What an option says of each name; `ConfigError` where it says two things of one."""
    from gonio.errors import ConfigError

    names = [name for name, _ in pairs]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{option} {name}=...: is given {names.count(name)} times; say it once")
    return dict(pairs)


def _report(
    specs: list[str],
    out: Path,
    models: list[str],
    normalise: Norm,
    ior: str | None,
    wavelength_nm: float | None,
    dask: str | None = None,
    *,
    metric: str | None = None,
    u_rel: float | None = None,
    energy: bool = False,
    separate: bool = False,
    how: Reading | None = None,
) -> Path:
    from gonio.acquisition.run import command_line
    from gonio.cli import console
    from gonio_analysis.fitting.observations import check_u_rel
    from gonio_analysis.fitting.problem import check_metric
    from gonio_analysis.report import make
    from gonio_analysis.selection.compare import check_models

    check_models(models)
    check_metric(metric)
    check_u_rel(u_rel)
    return make(
        specs,
        out,
        models=models,
        normalise=normalise.value,
        ior=read_ior(ior),
        wavelength_nm=wavelength_nm,
        metric=metric,
        u_rel=u_rel,
        bound_energy=energy,
        separate=separate,
        dask=dask,
        how=how,
        command=command_line(),
        progress=console.note,
    )


def _one_way(*, change: bool, laboratories: bool, unused: list[str], shared: bool) -> None:
    """`ConfigError` where options of one kind of comparison meet another."""
    from gonio.errors import ConfigError

    if change and laboratories:
        raise ConfigError("--change compares two things, --laboratories several measurements of one: name one of them")
    if shared and not laboratories:
        raise ConfigError("--shared belongs to --laboratories: leave it out")
    if unused and (change or laboratories):
        which = "--change" if change else "--laboratories"
        raise ConfigError(
            f"--{unused[0]} has no part in {which}, which fits no model and divides by nothing; leave it out"
        )


def _change(specs: list[str], out: Path, wavelength_nm: float | None, u_rel: float | None, how: Reading) -> Path:
    from gonio.acquisition.run import command_line
    from gonio.cli import console
    from gonio.errors import ConfigError
    from gonio_analysis.fitting.observations import check_u_rel
    from gonio_analysis.report import change

    if len(specs) != 2:
        raise ConfigError(f"--change compares two, A and B; {len(specs)} are named")
    check_u_rel(u_rel)
    return change.make(
        specs, out, wavelength_nm=wavelength_nm, u_rel=u_rel, how=how, command=command_line(), progress=console.note
    )


def _laboratories(
    specs: list[str], out: Path, shared: list[str], wavelength_nm: float | None, u_rel: float | None, how: Reading
) -> Path:
    from gonio.acquisition.run import command_line
    from gonio.cli import console
    from gonio_analysis.fitting.observations import check_u_rel
    from gonio_analysis.report import laboratories

    check_u_rel(u_rel)
    pairs = [one.partition("=") for one in shared]
    whose = _once("--shared", [(cause, who.split(",") if equals else None) for cause, equals, who in pairs])
    return laboratories.make(
        specs, out, shared=whose, u_rel=u_rel, wavelength_nm=wavelength_nm, how=how, command=command_line(),
        progress=console.note,
    )  # fmt: skip


def _print_appearance(found: Appearance) -> None:
    from gonio.cli import console
    from gonio_analysis.report.appearance import listed

    at = f" at {found.wavelength_nm:g} nm" if found.wavelength_nm is not None else ""
    rows = console.table("quantity", "value", "", title=f"{found.title}{at}")
    for one in listed(found):
        rows.add_row(one.label, one.value, one.remark)
    console.show(rows)
    for text in found.notes:
        console.note(text)


def _print(result: FitResult, sample: str, walked: dict[str, Interval]) -> None:
    from gonio.cli import console
    from gonio_analysis.report.model_choice import in_words
    from gonio_analysis.report.text import quantity, with_u
    from gonio_analysis.report.verdict import of_fit

    at = f" at {result.wavelength_nm:g} nm" if result.wavelength_nm == result.wavelength_nm else ""
    level = [f"{100 * next(iter(walked.values())).level:g} % interval"] if walked else []
    title = f"{result.name} on {sample}: {len(result.data)} values{at}"
    rows = console.table("parameter", "value", *level, "", title=title)
    for name, e in [*result.parameters.items(), *result.derived.items()]:
        kind = "derived" if name in result.derived else "fixed" if e.fixed else "fitted"
        alone = name in walked and not e.fixed and not walked[name].linear(e.value, e.u)  # two truths otherwise
        own, ends = in_words(walked[name], e.value) if name in walked else ("", "")
        shown = own if alone else with_u(e.value, 0.0 if e.fixed else e.u)
        value = quantity(shown, e.unit) + (f" ({e.material})" if e.material else "")
        between = [ends] if walked else []
        kind += f", at its {e.at_bound} bound" if e.at_bound else ""
        told = result.model.parameter_notes.get(name)
        rows.add_row(name, value, *between, f"{kind}; {told}" if told else kind)
    console.show(rows, of_fit(result))
    for text in result.notes:
        console.note(text)
