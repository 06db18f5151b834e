"""What the commands `fit`, `compare`, `report` and `appearance` do, once their options are read."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gonio import measurement, shown
from gonio.acquisition.run import command_line
from gonio.cli import console
from gonio.cli.options import remember
from gonio.errors import ConfigError
from gonio.maps import is_map
from gonio.measurement import Reading
from gonio_analysis import report as comparison
from gonio_analysis import result_records as results
from gonio_analysis.commands.arguments import given_constants, once, read_ior, with_u_ior
from gonio_analysis.fitting import fit as fitting
from gonio_analysis.fitting import parameters, profile_likelihood, saving
from gonio_analysis.fitting.energy import of_model
from gonio_analysis.fitting.observations import Observations, check_u_rel, observations, together
from gonio_analysis.fitting.problem import FitRequest, check_metric
from gonio_analysis.fitting.profile_likelihood import Interval
from gonio_analysis.fitting.spectrum import fit_table
from gonio_analysis.report import appearance as appearance_page
from gonio_analysis.report import change as change_page
from gonio_analysis.report import laboratories as laboratories_page
from gonio_analysis.report import map_change, map_page
from gonio_analysis.report.model_choice import in_words
from gonio_analysis.report.text import quantity, with_u
from gonio_analysis.report.verdict import after_misfit, of_fit, reflectances


@dataclass(frozen=True)
class Wanted:
    """What `gonio fit` is asked for besides the fit."""

    u_ior: str | None
    intervals: bool
    save: Path | None
    residual: bool
    as_json: bool


def fit(tables: list[str], asked: FitRequest, how: Reading, wanted: Wanted) -> None:
    """Fit one model to tables of one sample; save and print it."""
    parameters.family(asked.model, slopes=asked.slopes, ior=asked.ior)
    read = [_observed(one, asked.u_rel, how) for one in tables]
    simulated = [made for *_, made in read]
    if wanted.save is not None:
        saving.check_target(wanted.save, asked)
    if wanted.residual:
        saving.check_residual(wanted.save, asked)
    name, data = read[0][0], together(dict(zip(_short(tables), (data for _, data, _ in read), strict=True)))
    if wanted.u_ior is not None:
        asked = with_u_ior(asked, wanted.u_ior, data.nearest(asked.wavelength_nm)[1])
    result, *others = fit_table(data, asked, name=" + ".join(tables), say=console.note)
    walked: dict[str, Interval] = {}
    if wanted.intervals and others:
        walked = profile_likelihood.profiles(result).intervals
    elif wanted.intervals:
        result, walked = profile_likelihood.walked(result, lambda start: fitting.fit(data, replace(asked, start=start)))
    rho_dh = of_model(result)
    if wanted.save is not None:
        source = " + ".join(map(shown.marked, tables, simulated))
        saving.save(result, wanted.save, name=name, source=source, residual=wanted.residual)
    remember(tables, how)
    if wanted.as_json:
        several = len(tables) > 1
        out = {**result.to_json(), "sample": name, "table": tables if several else tables[0]}
        out |= {"simulated": simulated if several else simulated[0], "rho_dh": results.as_json(rho_dh)}
        if others:
            series = sorted([result, *others], key=lambda r: r.wavelength_nm)
            out["series"] = results.as_json([r.at_wavelength for r in series])
        if wanted.intervals:
            out["intervals"] = results.as_json(walked)
        print(json.dumps(out, indent=1, ensure_ascii=False))
        return
    if 0 < sum(simulated) < len(tables):
        console.note("simulated: " + ", ".join(t for t, made in zip(tables, simulated, strict=True) if made))
    _print(result, shown.marked(name, simulated[0]), walked)
    if wanted.residual:
        console.note(after_misfit(result))
    if rho_dh:
        console.note(reflectances(result.name, rho_dh, given=given_constants(result)))


def _observed(table: str, u_rel: float | None, how: Reading) -> tuple[str, Observations, bool]:
    """The one sample that a table on the command line names, its usable values, and whether they are simulated."""
    samples = measurement.tables(table, how)
    if len(samples) > 1:
        listed = "; ".join(samples)
        raise ConfigError(f"{table} holds {len(samples)} samples: name one as {table}:SAMPLE, of: {listed}")
    name, frame = next(iter(samples.items()))
    return name, observations(frame, table, u_rel), measurement.is_simulated(frame)


def _short(tables: list[str]) -> list[str]:
    """What messages call tables that are fitted together: their files' names, or their paths where those are alike."""
    if len(set(tables)) < len(tables):
        twice = next(table for table in tables if tables.count(table) > 1)
        raise ConfigError(f"{twice}: is named twice; its values would count twice")
    names = [Path(table).name.removesuffix(".csv") for table in tables]
    return names if len(set(names)) == len(names) else tables


def _print(result: fitting.FitResult, sample: str, walked: dict[str, Interval]) -> None:
    at = f" at {result.wavelength_nm:g} nm" if result.wavelength_nm == result.wavelength_nm else ""
    level = [f"{100 * next(iter(walked.values())).level:g} % interval"] if walked else []
    title = f"{result.name} on {sample}: {len(result.data)} values{at}"
    rows = console.table("parameter", "value", *level, "", title=title)
    for name, e in [*result.parameters.items(), *result.derived.items()]:
        alone = name in walked and not e.fixed and not walked[name].linear(e.value, e.u)  # two truths otherwise
        own, ends = in_words(walked[name], e.value) if name in walked else ("", "")
        value = quantity(own if alone else with_u(e.value, 0.0 if e.fixed else e.u), e.unit)
        kind = "derived" if name in result.derived else "fixed" if e.fixed else "fitted"
        kind += f", at its {e.at_bound} bound" if e.at_bound else ""
        told = result.model.parameter_notes.get(name)
        between, remark = [ends] if walked else [], f"; {told}" if told else ""
        rows.add_row(name, value + (f" ({e.material})" if e.material else ""), *between, kind + remark)
    console.show(rows, of_fit(result))
    for text in result.notes:
        console.note(text)


def report(specs: list[str], out: Path, models: list[str], *, ior: str | None, **options: Any) -> Path:
    """The report on models fitted to measurements; options as `gonio_analysis.report.make`."""
    check_metric(options["metric"])
    check_u_rel(options["u_rel"])
    return comparison.make(
        specs, out, models=models, ior=read_ior(ior), command=command_line(), progress=console.note, **options
    )  # fmt: skip


def map_report(path: Path, out: Path | None, values: Path | None, unused: list[str]) -> Path:
    """The report on a map; `unused` names options that belong to fits."""
    if out is None:
        raise ConfigError(f"{path}: the report on a map needs a folder: --out DIR")
    if unused:
        raise ConfigError(f"--{unused[0]}: {path} is a map, of which nothing is fitted here; leave it out")
    return map_page.make(path, out, values=values, command=command_line(), progress=console.note)


def check_one_way(*, change: bool, laboratories: bool, unused: list[str], shared: bool) -> None:
    """`ConfigError` where options of one kind of comparison meet another."""
    if change and laboratories:
        raise ConfigError("--change compares two things, --laboratories several measurements of one: name one of them")
    if shared and not laboratories:
        raise ConfigError("--shared belongs to --laboratories: leave it out")
    if unused and (change or laboratories):
        which = "--change" if change else "--laboratories"
        raise ConfigError(
            f"--{unused[0]} has no part in {which}, which fits no model and divides by nothing; leave it out"
        )


def change(specs: list[str], out: Path, wavelength_nm: float | None, u_rel: float | None, how: Reading) -> Path:
    """The report on two things compared point by point."""
    if len(specs) != 2:
        raise ConfigError(f"--change compares two, A and B; {len(specs)} are named")
    maps = [is_map(spec) for spec in specs]
    if all(maps):
        if u_rel is not None or wavelength_nm is not None:
            raise ConfigError("--u-rel and --wavelength-nm: maps of fits have their own; leave them out")
        return map_change.make(specs, out, command=command_line(), progress=console.note)
    if any(maps):
        raise ConfigError(f"--change compares two maps, or two tables: {specs[maps.index(False)]} is no map")
    check_u_rel(u_rel)
    return change_page.make(
        specs, out, wavelength_nm=wavelength_nm, u_rel=u_rel, how=how, command=command_line(), progress=console.note
    )


def laboratories(
    specs: list[str], out: Path, shared: list[str], wavelength_nm: float | None, u_rel: float | None, how: Reading
) -> Path:
    """The report on laboratories compared; `shared` as --shared gives it."""
    check_u_rel(u_rel)
    pairs = [one.partition("=") for one in shared]
    whose = once("--shared", [(cause, who.split(",") if equals else None) for cause, equals, who in pairs])
    return laboratories_page.make(
        specs, out, shared=whose, u_rel=u_rel, wavelength_nm=wavelength_nm, how=how, command=command_line(),
        progress=console.note,
    )  # fmt: skip


def appearance(sample: str, wavelength_nm: float | None, out: Path | None, how: Reading, *, as_json: bool) -> None:
    """Print the quantities of a table or a model, and write a page with them."""
    if wavelength_nm is not None and not 0.0 < wavelength_nm < float("inf"):
        raise ConfigError(f"--wavelength-nm {wavelength_nm:g}: a wavelength is above 0 nm")
    found = appearance_page.of(sample, wavelength_nm=wavelength_nm, how=how)
    page = None if out is None else appearance_page.make(found, out, command=command_line())
    remember([sample], how)
    if as_json:
        print(json.dumps(results.as_json(found), indent=1, ensure_ascii=False, allow_nan=False))
        return
    at = f" at {found.wavelength_nm:g} nm" if found.wavelength_nm is not None else ""
    rows = console.table("quantity", "value", "", title=f"{found.title}{at}")
    for one in appearance_page.listed(found):
        rows.add_row(one.label, one.value, one.remark)
    console.show(rows)
    for text in found.notes:
        console.note(text)
    if page is not None:
        print(page)
