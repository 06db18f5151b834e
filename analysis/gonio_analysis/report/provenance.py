"""The section "Provenance" of a report: when and how it was made, and where its values come from."""

from collections.abc import Iterable, Mapping
from typing import Any

from gonio_analysis.report import blocks
from gonio_analysis.report.blocks import Block, Group, Heading, Paragraph, facts
from gonio_analysis.report.facts import Summary
from gonio_analysis.report.text import number, percent, with_u
from gonio_analysis.result_records import RunFacts

MOST_SOURCES = 50
"""Samples whose provenance stands on the page."""


def section(s: Summary) -> Group:
    """The section, from a summary."""
    made = [("report made", s.created), ("command", s.command or "–"), ("versions", _versions(s))]
    out: list[Block] = [Heading(2, "Provenance"), facts(made)]
    if len(s.datasets) > MOST_SOURCES:
        out.append(Paragraph(f"The first {MOST_SOURCES} of {len(s.datasets)} samples; summary.json has all."))
    for d in s.datasets[:MOST_SOURCES]:
        rows = [("file", d.source or "–"), ("format", str(d.format or "–"))]
        if d.run:
            r = d.run
            rows += [("simulated" if d.simulated else "measured", r.created), ("command", r.command)]
            rows += [("plan's SHA-256", r.plan_sha256), ("seed", str(r.seed)), ("steps", str(r.steps))]
            rows += [("bands", ", ".join(r.bands)), ("versions", _versions(r))]
        # those have sections of their own
        given = {k: v for k, v in d.provenance.items() if k not in ("checks", "not_in_budget", "monte_carlo")}
        calibrations = given.pop("calibrations", [])
        visits = given.pop("reference", []) if d.run else []
        rows += _flat(given)
        rows += [("calibration", _calibration(one)) for one in calibrations]
        rows += [("white reference", _reference(band)) for band in visits]
        out += [Heading(3, d.title), facts(rows)]
    return blocks.section(out, "provenance")


def _versions(s: Summary | RunFacts) -> str:
    return ", ".join(f"{k} {v}" for k, v in s.versions.items())


def _flat(values: Any, prefix: str = "") -> Iterable[tuple[str, str]]:
    """Provenance, one line a leaf."""
    if isinstance(values, dict):
        for key, value in values.items():
            yield from _flat(value, f"{prefix}, {key}" if prefix else str(key))
    elif isinstance(values, list) and any(isinstance(v, dict) for v in values):
        for k, value in enumerate(values):
            yield from _flat(value, f"{prefix} {k + 1}" if len(values) > 1 else prefix)
    else:
        shown = ", ".join(map(str, values)) if isinstance(values, list) else values
        yield prefix.replace("_", " "), number(shown, 5) if isinstance(shown, float) else str(shown)


def _calibration(used: Mapping[str, Any]) -> str:
    """A calibration file that the run was measured with."""
    until = f"valid until {used['valid_until']}" if used["valid_until"] else "valid without an end"
    return f"{used['kind']}: {used['file']}, made on {used['made']}, {until}; SHA-256 {used['sha256']}"


def _reference(band: Mapping[str, Any]) -> str:
    """What the visits to the white reference said, as `gonio.reduction.brdf.reduce` leaves it."""
    level, slope, u_slope = band["level_e_per_s_sr"], band["drift_per_hour"], band["u_drift_per_hour"]
    drift, steady = "unknown", "that tell no drift"
    if slope is not None:
        drift = f"({with_u(100 * slope, 100 * u_slope)}) % an hour"
        steady = "on a straight line" if band["straight"] else "on no straight line"
    # a table of an earlier version does not say how well the BRDF of the reference is known
    known = f", known to {percent(band['u_brdf_rel'])}" if "u_brdf_rel" in band else ""
    return (
        f"{band['band']}: BRDF {number(band['brdf'], 4)} sr⁻¹{known}; {band['visits']} visits {steady} "
        f"(chi-square {number(band['chi_square'])}); level {number(level, 4)} electrons a second and steradian,"
        f" known to {percent(band['u_level_rel'])}; drift {drift}; frames of one step scatter as the noise "
        f"model says, times {number(band['frame_scatter'])} in variance"
    )
