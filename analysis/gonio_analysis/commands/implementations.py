"""What the commands `fit`, `compare`, `report` and `appearance` do, once their options are read.

What draws pages, or compares, is imported by the command that does.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from gonio import plugins, shown
from gonio.cli import console
from gonio.cli.options import remember
from gonio.disk import check_writable
from gonio.errors import ConfigError, Incomplete
from gonio.hdf5 import is_map
from gonio.measurement import Reading, is_simulated, of_one
from gonio.platform import command_line
from gonio.spectra import RGB_NM
from gonio_analysis import result_records as results
from gonio_analysis.commands.arguments import once, with_u_ior
from gonio_analysis.fitting import fit as fitting
from gonio_analysis.fitting import parameters, profile_likelihood, saving
from gonio_analysis.fitting.energy import of_model
from gonio_analysis.fitting.observations import Observations, check_u_rel, check_wavelength, observations, together
from gonio_analysis.fitting.optical_constants import Constants, NamedSample, TakenConstants
from gonio_analysis.fitting.problem import FitRequest, check_metric
from gonio_analysis.fitting.spectrum import fit_every
from gonio_analysis.report.text import quantity, with_u
from gonio_analysis.report.verdict import after_misfit, in_words, of_fit, reflectances

NOTES = 10
"""Most kinds of notes of readers that are said of very many tables."""
PLAIN = ("model", "ior", "fix", "wavelength_nm", "separate")
"""What of a request maps are fitted by."""


def fit_many(
    table: str | None, each: list[str] | None, asked: FitRequest, how: Reading, wanted: Wanted, *, out: Path | None,
    dask: str | None, materials: str | None, others: Mapping[str, Any],
) -> bool:  # fmt: skip
    """Fit a map or each of many tables, where that is asked for; otherwise False.

    Raises
    ------
    ConfigError
        What is asked for does not go together; `others`: options that have no part in either.
    """
    if table is None:
        if not each:
            raise ConfigError("gonio fit: name a TABLE; or a folder or a list of tables with --each")
        _require_plain(
            "each of many tables",
            asked,
            wanted,
            {**others, "--json": wanted.as_json, "--materials": materials},
            plain=None,
        )
        wanted.constants.require_of_all("gonio fit --each")
        fit_each(each, out, asked, how, dask)
        return True
    if not _is_map(table, out):
        if materials is not None:
            raise ConfigError("--materials: goes with a map; leave it out")
        if dask is not None:
            raise ConfigError("--dask: goes with a map, or with --each FOLDER|LIST; leave it out")
        return False
    _require_plain("a map", asked, wanted, {**others, "--columns": how.columns})
    wanted.constants.require_of_all("a map")
    plugins.room("maps").fit(Path(table), out, asked, dask, materials, as_json=wanted.as_json)
    return True


def _is_map(table: str, out: Path | None) -> bool:
    """Whether what is to be fitted is a map.

    Raises
    ------
    ConfigError
        `out` is given for what is none.
    """
    found = is_map(table)
    if out is not None and not found:
        why = "is no map" if Path(table).exists() else "there is no such file"
        raise ConfigError(f"{table}: {why}; --out goes with a map, as gonio reduce RUN --map makes it")
    return found


def _require_plain(
    what: str, asked: FitRequest, wanted: Wanted, others: Mapping[str, Any], plain: Sequence[str] | None = PLAIN
) -> None:
    """`ConfigError` where an option is given that has no part; `plain` of a request have one, or all for None."""
    usual = FitRequest(asked.model)
    given = {f"--{f.name.replace('_', '-')}": (getattr(asked, f.name) or None) != (getattr(usual, f.name) or None)
             for f in fields(asked) if plain is not None and f.name not in plain}  # fmt: skip
    names = {"--bounds": "--bound", "--priors": "--prior", "--each": "--joint"}
    given |= {"--u-ior": wanted.u_ior, "--intervals": wanted.intervals, "--save": wanted.save,
              "--residual": wanted.residual, **others}  # fmt: skip
    odd = [names.get(name, name) for name, value in given.items() if value]
    if odd:
        raise ConfigError(f"{odd[0]}: has no part in the fit of {what}; leave it out")


def fit_each(where: list[str], out: Path | None, asked: FitRequest, how: Reading, dask: str | None) -> None:
    """Fit each table of a folder or a list, and print what came out."""
    from gonio_analysis.selection import many_tables as each_table

    if len(where) > 1:
        raise ConfigError("--each: name one folder or one list, or the TABLE whose wavelengths --each NAME is about")
    if out is None:
        raise ConfigError(f"--each {where[0]}: name the table of its fits with --out TABLE.csv")
    if out.suffix != ".csv":
        raise ConfigError(f"--out {out}: one row a table is written as CSV; choose a name that ends in .csv")
    check_writable(out.parent)
    with console.counter("fitting tables", lines=True) as count:
        found = each_table.make(where[0], out, asked, how, dask=dask, count=count)
    if found.before:
        console.note(f"{found.before} tables were done before")
    if found.alone:
        reasons = ", ".join(f"{why} ({many})" for why, many in Counter(found.alone).most_common())
        console.note(f"{sum(found.alone.values())} were searched for one by one, not by the engine of maps: {reasons}")
    told = Counter(_of_any_table(row.get("notes") or "", Path(row["table"])) for row in found.rows)
    for text, many in told.most_common(NOTES):
        if text:
            console.note(f"{many} of {len(found.rows)}: {text}")
    flags = [row.get("flag") or "" for row in found.rows]
    failed = [row["table"] for row, flag in zip(found.rows, flags, strict=True) if flag.startswith("not fitted")]
    rejected = sum("rejected" in flag.split("; ") for flag in flags)
    first = f", the first of them {failed[0]} (column flag says why)" if failed else ""
    console.show(
        f"{asked.model}: fitted {len(flags) - len(failed)} of {len(flags)}; the model is rejected in {rejected};"
        f" {len(failed)} could not be fitted{first}"
    )
    print(out)


def _of_any_table(text: str, table: Path) -> str:
    """A note with NAME in the names of the files that stand beside a table."""
    return re.sub(rf"\b{re.escape(table.stem)}\.(?=\w)", "NAME.", text)


@dataclass(frozen=True)
class Wanted:
    """What `gonio fit` is asked for besides the fit."""

    constants: Constants
    u_ior: str | None
    intervals: bool
    save: Path | None
    residual: bool
    as_json: bool


def fit(tables: list[str], asked: FitRequest, how: Reading, wanted: Wanted) -> None:
    """Fit one model to tables of one sample; save and print it."""
    parameters.family(asked.model, slopes=asked.slopes, ior=asked.ior)
    read = [_observed(one, asked.u_rel, how) for one in tables]
    taken = _constants(
        asked, wanted.constants, [NamedSample(t, name) for t, (name, *_) in zip(tables, read, strict=True)]
    )
    asked = replace(asked, ior=taken.values[0])
    simulated = [made for *_, made in read]
    if wanted.save is not None:
        saving.check_target(wanted.save)
    if wanted.residual:
        saving.check_residual(wanted.save, asked)
    name, data = read[0][0], together(dict(zip(_short(tables), (data for _, data, _ in read), strict=True)))
    if wanted.u_ior is not None:
        asked = with_u_ior(asked, wanted.u_ior, data.nearest(asked.wavelength_nm)[1])
    every = (wanted.save is not None or data.of_channels) and wanted.u_ior is None
    result, *others = fit_every(data, asked, name=" + ".join(tables), every=every, say=console.note)
    walked: dict[str, profile_likelihood.Interval] = {}
    if wanted.intervals and result.shared is not None:
        walked = profile_likelihood.profiles(result).intervals
    elif wanted.intervals:
        result, walked = profile_likelihood.walked(result, lambda start: fitting.fit(data, replace(asked, start=start)))
    rho_dh = of_model(result)
    if wanted.save is not None:
        source = " + ".join(map(shown.marked, tables, simulated))
        saving.save(result, wanted.save, name=name, source=source, others=others, residual=wanted.residual)
    remember(tables, how)
    _say(taken.remember())
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
        _say(filter(None, [*result.notes, result.assumes]))
        return
    if 0 < sum(simulated) < len(tables):
        console.note("simulated: " + ", ".join(t for t, made in zip(tables, simulated, strict=True) if made))
    marked = shown.marked(name, simulated[0])
    _print(result, marked, walked)
    if others and data.of_channels:
        _print_channels([result, *others], marked)
    if wanted.residual:
        console.note(after_misfit(result))
    if rho_dh:
        console.note(reflectances(result.name, rho_dh, given=result.given))


def _constants(asked: FitRequest, constants: Constants, samples: list[NamedSample]) -> TakenConstants:
    """The optical constants of tables of one sample; those that were remembered where nothing else is said of them.

    Raises
    ------
    ConfigError
        They differ.
    """
    taken = TakenConstants.of(constants, samples)
    said = {"ior", "k"} & {*asked.free, *(asked.fix or {})}
    if said or not parameters.needs_ior(asked.model):
        taken = replace(taken, remembered=[None] * len(samples))
    if len(set(taken.values)) > 1:
        listed = ", ".join(f"{one.source}: {value}" for one, value in zip(samples, taken.values, strict=True))
        raise ConfigError(f"--ior: tables of one sample have one index; here are {listed}")
    _say(taken.notes)
    return taken


def _observed(table: str, u_rel: float | None, how: Reading) -> tuple[str, Observations, bool]:
    """The one sample that a table on the command line names, its usable values, and whether they are simulated."""
    name, frame = of_one(table, how)
    return name, observations(frame, table, u_rel, polarised=True), is_simulated(frame)


def _short(tables: list[str]) -> list[str]:
    """What messages call tables that are fitted together: their files' names, or their paths where those are alike."""
    if len(set(tables)) < len(tables):
        twice = next(table for table in tables if tables.count(table) > 1)
        raise ConfigError(f"{twice}: is named twice; its values would count twice")
    names = [Path(table).name.removesuffix(".csv") for table in tables]
    return names if len(set(names)) == len(names) else tables


def _print(result: fitting.FitResult, sample: str, walked: dict[str, profile_likelihood.Interval]) -> None:
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
    _say(filter(None, [*result.notes, result.assumes]))


def _print_channels(fits: Sequence[fitting.FitResult], sample: str) -> None:
    """A column a channel, of what differs."""
    by_wave = {one.wavelength_nm: one for one in fits}
    columns = [by_wave[nm] for nm in RGB_NM.values() if nm in by_wave]
    rows = console.table("parameter", *(c for c, nm in RGB_NM.items() if nm in by_wave), title=f"{sample} by channel")
    for name, e in fits[0].parameters.items():
        if not e.fixed:
            each = (one.parameters[name] for one in columns)
            rows.add_row(name, *(quantity(with_u(one.value, one.u), one.unit) for one in each))
    console.show(rows)


def _say(notes: Iterable[str]) -> None:
    """Notes for whoever sits at the terminal, also where the result goes to a program as JSON."""
    for text in notes:
        console.note(text)


def report(specs: list[str], out: Path, models: list[str], *, ior: list[str] | None, **options: Any) -> Path:
    """The report on models fitted to measurements; options as `gonio_analysis.report.make`."""
    from gonio_analysis.report.making import make

    check_metric(options["metric"])
    check_u_rel(options["u_rel"])
    check_wavelength(options["wavelength_nm"])
    return make(
        specs, out, models=models, ior=Constants.of(ior), command=command_line(), progress=console.note, **options
    )  # fmt: skip


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
    from gonio_analysis.report import change as change_page

    if len(specs) != 2:
        raise ConfigError(f"--change compares two, A and B; {len(specs)} are named")
    maps = [is_map(spec) for spec in specs]
    if all(maps):
        if u_rel is not None or wavelength_nm is not None:
            raise ConfigError("--u-rel and --wavelength-nm: maps of fits have their own; leave them out")
        made: Path = plugins.room("maps").change(specs, out)
        return made
    if any(maps):
        raise ConfigError(f"--change compares two maps, or two tables: {specs[maps.index(False)]} is no map")
    check_u_rel(u_rel)
    check_wavelength(wavelength_nm)
    return change_page.make(
        specs, out, wavelength_nm=wavelength_nm, u_rel=u_rel, how=how, command=command_line(), progress=console.note
    )


def laboratories(
    specs: list[str], out: Path, shared: list[str], wavelength_nm: float | None, u_rel: float | None, how: Reading
) -> Path:
    """The report on laboratories compared; `shared` as --shared gives it."""
    from gonio_analysis.report import laboratories as laboratories_page

    check_u_rel(u_rel)
    check_wavelength(wavelength_nm)
    pairs = [one.partition("=") for one in shared]
    whose = once("--shared", [(cause, who.split(",") if equals else None) for cause, equals, who in pairs])
    return laboratories_page.make(
        specs, out, shared=whose, u_rel=u_rel, wavelength_nm=wavelength_nm, how=how, command=command_line(),
        progress=console.note,
    )  # fmt: skip


def appearance(sample: str, wavelength_nm: float | None, out: Path | None, how: Reading, *, as_json: bool) -> None:
    """Print the quantities of a table or a model, and write a page with them."""
    from gonio_analysis.report import appearance as appearance_page
    from gonio_analysis.report import files

    check_wavelength(wavelength_nm)
    if out is not None:
        files.require(out)
    found = appearance_page.of(sample, wavelength_nm=wavelength_nm, how=how)
    page = missing = None
    try:
        page = None if out is None else appearance_page.make(found, out, command=command_line())
    except Incomplete as error:  # the quantities are known all the same
        missing = error
    remember([sample], how)
    if as_json:
        print(json.dumps(results.as_json(found), indent=1, ensure_ascii=False, allow_nan=False))
    else:
        _print_appearance(found)
    _say(found.notes)
    if page is not None and not as_json:
        print(page)
    if missing is not None:
        raise missing


def _print_appearance(found: results.Appearance) -> None:
    from gonio_analysis.report.appearance import listed

    at = f" at {found.wavelength_nm:g} nm" if found.wavelength_nm is not None else ""
    rows = console.table("quantity", "value", "", title=f"{found.title}{at}")
    for one in listed(found):
        rows.add_row(one.label, one.value, one.remark)
    console.show(rows)
