"""The cases: files that a user writes, commands, and which of what they write is kept."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.command_line import gonio

SAMPLE = """name = "satin"
model = "cook-torrance"
[parameters]
s = 0.2
m = 0.25
diffuse_albedo = 0.4
ior = 1.5
"""
IN_PLANE = """name = "in plane"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [20, 50]
theta_r_deg = { start = -70, stop = 70, step = 10 }
[[sweep]]
theta_i_deg = [50]
theta_r_deg = [30, 60]
dphi_deg = [90, 150]
"""
ONE_PLANE = (
    IN_PLANE.rpartition("[[sweep]]")[0]
    + """[laboratory]
organisation = "Institute of Optics"
contact = "Jane Doe"
email = "jane.doe@example.org"
operator = "John Doe"
title = "BRDF of satin"
license = "CC-BY-4.0"
creators = [{ name = "Doe, Jane" }]
publication_year = 2026
[laboratory.address]
country = "Germany"
city = "Anytown"
street = "Long Road"
building = "1"
postal_code = "12345"
[laboratory.sample]
type = "paint"
shape = "disc"
diameter_mm = 50
zero_azimuth = "the mark on the rim"
"""
)
BOTH_SIDES = """name = "both sides"
wavelength_nm = [450, 650]
[[sweep]]
theta_i_deg = [30]
theta_r_deg = [-60, 0, 45]
[[sweep]]
theta_i_deg = [30]
theta_r_deg = [120, 165, -135]
side = "transmission"
"""
OPAL = """name = "opal glass"
model = "diffuse-transmitter"
[parameters]
reflectance = 0.45
transmittance = 0.35
"""
ADAPTIVE = """name = "adaptive"
wavelength_nm = [550]
[adaptive]
how = "parameters"
budget_h = 0.06
model = "lambert"
u_rel = { albedo = 1e-4 }
theta_i_deg = [20, 50]
theta_r_deg = [-60, -30, 0, 10, 35, 65]
"""
CURVE = """name = "a curve"
wavelength_nm = [550]
[adaptive]
how = "curve"
budget_h = 0.1
theta_i_deg = [30]
theta_r_deg = { start = -60, stop = 60, step = 10 }
"""
SCENE = """name = "a glossy sphere"
wavelength_nm = [550]
[camera]
position_mm = [0, 0, 800]
vertical_field_deg = 6.5
width = 40
height = 40
[[shape]]
kind = "sphere"
radius_mm = 40
material = "m"
[material.m]
model = "oren-nayar"
parameters = { albedo = 0.6, sigma_deg = 20 }
[[light]]
kind = "directional"
toward = [0.8, 0.3, 1.0]
irradiance = 2.0
[photograph]
exposure_s = 0.1
seed = 7
[photograph.sensor]
responsivity_e_per_s = 2.5e5
read_noise_e = 2.5
[photograph.uncertainty]
irradiance_rel = 0.01
center_mm = 0.05
"""
MEASURE = ("measure", "plan.toml", "--rig", "RIG", "--sample", "sample.toml", "--out", "run", "--seed", "5", "--yes")
RUN = ("run/brdf.csv", "run/journal.jsonl", "run/plan.csv")
WRITTEN = {
    "table.astm": (), "table.bsdf.json": ("--to", "bird-json"),
    "alta.dat": ("--to", "alta"), "datacite.json": ("--to", "datacite"),
}  # fmt: skip
"""Formats that a table in one plane can be written to, by file."""


Command = Sequence[str] | Callable[[Path], None]


@dataclass(frozen=True)
class Case:
    """Something that a user does."""

    files: dict[str, str]
    commands: Sequence[Command]
    """In turn; a function does what a user does with his hands."""
    kept: Sequence[str] = ()
    """Files that are compared; what the commands print to standard output is, too."""
    tolerance: float = 1e-12
    """Relative, of every number."""

    def carried_out(self, folder: Path) -> dict[str, str]:
        """Text by name."""
        for name, text in self.files.items():
            (folder / name).write_text(text, encoding="utf-8")
        out = {}
        for k, words in enumerate(self.commands):
            if callable(words):
                words(folder)
                continue
            done = gonio(folder, *words, expect=0)
            out[f"printed-{k}.txt"] = done.stdout
        for name in self.kept:
            out[name.replace("/", "-")] = (folder / name).read_text(encoding="utf-8")
        return {name: text for name, text in out.items() if text}


def on_rig(rig: str, plan: str = IN_PLANE, *more: Command, kept: Sequence[str] = RUN, tolerance: float = 1e-12) -> Case:
    """A measurement, reduced, and what is made of it."""
    measure = [rig if word == "RIG" else word for word in MEASURE]
    return Case({"plan.toml": plan, "sample.toml": SAMPLE}, [measure, *more, ("reduce", "run")], kept, tolerance)


def made_of(plan: str, *more: Command, kept: Sequence[str] = (), tolerance: float = 1e-9) -> Case:
    """What is made of a reduced run."""
    case = on_rig("sim", plan)
    return Case(case.files, [*case.commands, *more], kept, tolerance)


def cut_short(folder: Path) -> None:
    """As a kill leaves it: half of the journal, and the frames of one more step."""
    journal = folder / "run" / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[: len(lines) // 2]))
    gonio(folder, *(("sim" if word == "RIG" else word) for word in MEASURE), "--resume", expect=0)


def shown(rig: str, change: Callable[[str], str] = str) -> Callable[[Path], None]:
    """A shipped rig's file as one's own, changed."""

    def write(folder: Path) -> None:
        text = gonio(folder, "rig", "show", rig).stdout
        (folder / "rig.toml").write_text(change(text), encoding="utf-8")

    return write


def far_reaching(text: str) -> str:
    """A camera arm that reaches behind the sample."""
    head, arm, rest = text.partition("[arms.camera]")
    return head + arm + rest.replace("[-89.0, 89.0]", "[-175.0, 180.0]", 1)


def transmission() -> Case:
    """Both sides of a sample."""
    files = {"plan.toml": BOTH_SIDES, "sample.toml": OPAL}
    measure = ["rig.toml" if word == "RIG" else word for word in MEASURE]
    return Case(files, [shown("sim", far_reaching), measure, ("reduce", "run")], RUN)


def calibration() -> Case:
    """All three, one after the other, each with the files before it."""
    quick = {"geometry": ("--quick",), "camera": ("--pairs", "3"), "light": ("--minutes", "45", "--every", "60")}
    commands: list[Command] = []
    for k, (name, how) in enumerate(quick.items()):
        files = [f"{earlier}.toml" for earlier in list(quick)[:k]]
        table = f"\n[calibration]\nfiles = {json.dumps(files)}\n"
        commands.append(shown("sim-uncalibrated", lambda text, table=table: text + table))  # type: ignore[misc]
        commands.append(("calibrate", name, "--rig", "rig.toml", "--out", f"{name}.toml", "--yes", *how))
    return Case({}, commands, [f"{name}.toml" for name in quick], 1e-6)


def help_of_all() -> str:
    """`--help` of every command."""
    import typer.main

    from gonio.cli import application

    out = []

    def walk(command: Any, path: list[str]) -> None:
        done = gonio(Path.cwd(), *path, "--help")
        out.append(f"$ {' '.join(['gonio', *path])} --help\n{done.stdout}")
        if hasattr(command, "list_commands"):
            context = command.make_context("gonio", [], resilient_parsing=True)
            for name in command.list_commands(context):
                walk(command.get_command(context, name), [*path, name])

    walk(typer.main.get_command(application.build()), [])
    return "\n".join(out)


def formats() -> Case:
    """Written, and read again."""
    again = [name for name in WRITTEN if name != "datacite.json"]
    written = [("convert", "run/brdf.csv", name, *how) for name, how in WRITTEN.items()]
    read = [("convert", name, f"{name}.csv") for name in again]
    of_model = [("convert", "sample.toml", "paint.xml", "--to", "klems")]
    kept = ["paint.xml", *WRITTEN, *(f"{name}.csv" for name in again)]
    return made_of(ONE_PLANE, *written, *read, *of_model, kept=kept)


FITS = [("fit", "run/brdf.csv", "--model", name, "--json", *how)
        for name, *how in (("cook-torrance",), ("blinn",), ("he-torrance", "--intervals"))]  # fmt: skip
CASES: dict[str, Case] = {
    "sim": on_rig("sim"),
    "sim-metrology": on_rig("sim-metrology"),
    "resumed": on_rig("sim", IN_PLANE, cut_short),
    "transmission": transmission(),
    "adaptive-parameters": on_rig("sim", ADAPTIVE),
    "adaptive-curve": on_rig("sim", CURVE),
    "fits": made_of(
        IN_PLANE, *FITS, ("fit", "run/brdf.csv", "--model", "lambert", "--residual", "--save", "off.toml"),
        kept=["off.toml"],
    ),
    "report": made_of(
        IN_PLANE, ("compare", "run", "--models", "lambert,cook-torrance", "--out", "page"), kept=["page/summary.json"]
    ),
    "change": made_of(
        IN_PLANE, ("compare", "run", "sample.toml", "--change", "--out", "page"), kept=["page/summary.json"]
    ),
    "appearance": made_of(IN_PLANE, ("appearance", "run", "--json"), ("appearance", "sample.toml", "--json")),
    "formats": formats(),
    "scene": Case(
        {"scene.toml": SCENE},
        [("render", "scene.toml", "--out", "picture"),
         ("photograph", "scene.toml", "picture/photograph.dng", "--out", "photo.csv"),
         ("fit", "photo.csv", "--model", "oren-nayar", "--json")],
        ["picture/summary.json", "photo.csv"], 1e-9,
    ),
    "calibrations": calibration(),
}  # fmt: skip
