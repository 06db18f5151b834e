"""`gonio plan show`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from gonio.acquisition.measure import RigChoice
    from gonio.acquisition.plan import Assessed, Plan
    from gonio.rig.description import RigDescription

app = typer.Typer(help="Look at plans.", no_args_is_help=True)

SHOWN = 12


@app.callback()
def _group() -> None:
    """Look at plans."""


@app.command()
def show(
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="A plan.toml.", show_default=False)],
    rig: Annotated[
        str | None, typer.Option(help="The rig that shall measure it: a name or a rig file.", show_default=False)
    ] = None,
) -> None:
    """Show the points of a plan. With a rig also what it cannot reach and why, and how long it takes."""
    from gonio.acquisition.measure import find_rig
    from gonio.acquisition.plan import load_plan

    describe(load_plan(plan), find_rig(rig) if rig is not None else None)


def describe(plan: Plan, rig: RigChoice | None) -> None:
    """Print a plan, as a rig sees it if there is one."""
    from gonio.acquisition.choosing import about, chooser_of
    from gonio.acquisition.duration import Durations
    from gonio.acquisition.plan import Assessed, assess
    from gonio.cli import console

    chooser = None
    if plan.adaptive is not None and rig is None:
        how, hours = plan.adaptive.how, plan.adaptive.budget_h
        console.show(
            f"{plan.name}: points are chosen as the run grows ({how}, {hours:g} h of rig time); --rig says which"
        )
    elif plan.adaptive is not None and rig is not None:
        plan, chooser = chooser_of(plan, rig.description)
    if not plan.points:
        console.show(f"wavelengths: {', '.join(f'{w:g} nm' for w in plan.wavelength_nm)}")
        return
    points = [Assessed(p, None) for p in plan.points] if rig is None else assess(plan, rig.description)
    by_incidence: dict[float, list[_Place]] = {}
    for place in _places(plan, points):
        by_incidence.setdefault(place.assessed.point.theta_i_deg, []).append(place)
    headings = ["theta_i", "theta_r\nin plane", "dphi\nout of plane", "points"]
    if rig is not None:
        headings += ["measured", "not measured:\ntheta_r, or theta_r/dphi"]
    table = console.table(*headings, title=f"{plan.name}: {len(points)} points, angles in degrees")
    for theta_i, group in sorted(by_incidence.items()):
        signed = sorted(place.signed_deg for place in group if place.in_plane)
        dphi = sorted({place.dphi_deg for place in group if not place.in_plane})
        row = [f"{theta_i:g}", _span(signed), ", ".join(f"{d:g}" for d in dphi[:SHOWN]), str(len(group))]
        if rig is not None:
            row += [str(sum(place.assessed.pose is not None for place in group)), _missing(group)]
        table.add_row(*row)
    console.show(table)
    if plan.repeated:
        console.show(f"{plan.repeated} points occur more than once; each is measured once")
    if rig is None:
        console.show(f"wavelengths: {', '.join(f'{w:g} nm' for w in plan.wavelength_nm)}")
        return
    bands = plan.bands(rig.description)
    steps = rig.schedule(plan, points)
    visits = sum(step.kind == "reference" for step in steps)
    for (flag, cause), count in _reasons(points):
        console.show(f"{count} {flag}: {cause}")
    seconds = Durations(rig.description, bands).total_s(steps)
    console.show(
        f"rig: {rig.description.name}",
        *calibrations(rig.description),
        f"bands: {', '.join(f'{b.name} (centre {b.centre_nm:g} nm, width {b.fwhm_nm:g} nm)' for b in bands)}",
        f"{len(steps)} steps with {visits} visits to the white reference; about {console.duration(seconds)} "
        "on the rig's clock, for a matt sample of albedo 0.5",
    )
    if chooser is not None:
        console.show("then points are chosen as the run grows:", *(f"  {line}" for line in about(chooser)))


def calibrations(description: RigDescription) -> list[str]:
    """The calibrations that a rig is used with, and a warning of each that is unfit."""
    use = description.calibration
    files = [f"{known.file} ({known.kind}, made on {known.made})" for known in use.known]
    return [*([f"calibrations: {', '.join(files)}"] if files else []), *unfit(description)]


def unfit(description: RigDescription) -> list[str]:
    """A warning of each calibration that is used although it is unfit."""
    return [f"warning: calibration {remark}; it is used all the same" for remark in description.calibration.remarks]


def _reasons(points: list[Assessed]) -> list[tuple[tuple[str, str], int]]:
    from gonio.acquisition.plan import count_reasons

    return count_reasons(points)


def _missing(group: list[_Place]) -> str:
    """The points of a group that are not measured, by flag."""
    out: dict[str, list[str]] = {}
    for place in group:
        a = place.assessed
        if a.pose is None:
            angles = f"{place.signed_deg:g}" if place.in_plane else f"{a.point.theta_r_deg:g}/{place.dphi_deg:g}"
            out.setdefault(a.flag, []).append(angles)
    return "; ".join(
        f"{flag}: {', '.join(angles[:SHOWN])}{' ...' if len(angles) > SHOWN else ''}" for flag, angles in out.items()
    )


@dataclass(frozen=True, slots=True)
class _Place:
    """Where the detector of a point is, as tables for people have it."""

    assessed: Assessed
    dphi_deg: float
    signed_deg: float

    @property
    def in_plane(self) -> bool:
        """Whether a plan asks for it in a half-plane of incidence: at the normal too an azimuth is what was asked."""
        return self.dphi_deg in (0.0, 180.0)


def _places(plan: Plan, points: list[Assessed]) -> list[_Place]:
    import numpy as np

    directions = plan.directions
    dphi, signed = np.round(np.degrees(directions.dphi), 6) % 360.0, np.degrees(directions.signed)
    return [_Place(*each) for each in zip(points, dphi.tolist(), signed.tolist(), strict=True)]


def _span(angles: list[float]) -> str:
    return "" if not angles else f"{angles[0]:g}" if len(angles) == 1 else f"{angles[0]:g} to {angles[-1]:g}"
