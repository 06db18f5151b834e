"""Makes the tables and the pictures of docs/reference/models_and_parameters.md from the samples that the page shows.

    python tools/models_page.py

A section is `## name`, and its `toml` block a sample file. Below it stands what the model's class says of its
parameters, between two comments, and the model's values in the plane of incidence as a picture.
"""

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.fitting import parameters as fits
from gonio_analysis.plots import in_plane
from gonio_analysis.report.drawing import Drawing

from gonio import geometry
from gonio.models import DiffuseTransmitter, Model, Sum, build
from gonio.models.parameters import FURTHER

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE = DOCS / "reference" / "models_and_parameters.md"
SECTION = re.compile(r"(?ms)^## ([\w-]+)\n(.*?)(?=^## |\Z)")
SAMPLE = re.compile(r"(?ms)^```toml\n(.*?)^```$")
TABLE = re.compile(r"(?ms)(^<!-- parameters -->\n).*?(^<!-- end -->$)")
INCIDENCES_DEG = (15.0, 45.0, 65.0)
STEP_DEG = 0.25
OFF_THE_MIRROR = 2.5
"""Where a curve exceeds its mirror value by more, all are divided by their largest values."""


def samples(page: str) -> dict[str, str]:
    """The sample file of each section, by the section's name."""
    return {name: found[1] for name, text in SECTION.findall(page) if (found := SAMPLE.search(text))}


def model_of(sample: str) -> Model:
    """The model of a sample file."""
    read = tomllib.loads(sample)
    return build(read["model"], read["parameters"])


def with_tables(page: str) -> str:
    """The page with its tables as the code has them."""

    def section(match: re.Match[str]) -> str:
        found = SAMPLE.search(match[2])
        return match[0] if found is None else TABLE.sub(rf"\g<1>{_escaped(table(found[1]))}\g<2>", match[0])

    return SECTION.sub(section, page)


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\")


def table(sample: str) -> str:
    """The parameters of a sample's model: unit, default, what the constructor takes, bounds of a fit, and text."""
    read = tomllib.loads(sample)
    names = list(read["parameters"]) if read["model"] == Sum.name else [read["model"]]
    lines = ["| parameter | unit | default | allowed | fitted between | what it is |", "|---|---|---|---|---|---|"]
    if read["model"] == Sum.name:
        lines.append(f"| `weight` of each | | 1 | at least 0 | | {FURTHER['weight']} |")
    for name in names:
        lines += _rows(name, f"{name}: " if len(names) > 1 else "")
    return "\n".join(lines) + "\n"


def _rows(name: str, prefix: str) -> list[str]:
    kind = DiffuseTransmitter if name == DiffuseTransmitter.name else fits.kind(name)
    cells = ((f"{prefix}`{one}`", *rest) for one, *rest in fits.told(kind))
    return ["| " + " | ".join(c.replace("|", "\\|").replace("*", "\\*") for c in row) + " |" for row in cells]


def curves(model: Model) -> tuple[list[Line], str]:
    """Values in the plane of incidence, divided as the second result says."""
    angle = np.radians(np.arange(-88.0, 88.0 + STEP_DEG / 2, STEP_DEG))
    theta_r, phi_r = geometry.unsigned(angle)
    azimuths = ((0.0, ""),) if not model.depends_on_azimuth else ((0.0, ", φi = 0°"), (90.0, ", φi = 90°"))
    incidences = INCIDENCES_DEG if len(azimuths) == 1 else INCIDENCES_DEG[:2]
    drawn = []
    for theta_i, (phi, words) in ((t, a) for t in incidences for a in azimuths):
        turned = np.radians(phi)
        value = model.brdf(np.radians(theta_i), turned, theta_r, phi_r + turned)
        drawn.append((f"θi = {theta_i:g}°{words}", np.radians(theta_i), np.asarray(value)))
    at_mirror = [float(np.interp(mirror, angle, value)) for _, mirror, value in drawn]
    largest = [float(value.max()) for _, _, value in drawn]
    far = any(top > OFF_THE_MIRROR * at for top, at in zip(largest, at_mirror, strict=True))
    none = np.zeros(0)
    lines = [
        Line(label, angle, value / by, none, none, none, float(mirror))
        for (label, mirror, value), by in zip(drawn, largest if far else at_mirror, strict=True)
    ]
    return lines, "BRDF over its largest value" if far else "BRDF over its value in the mirror direction"


def picture(name: str, model: Model) -> str:
    """The normalised polar plot, as SVG."""
    lines, label = curves(model)

    def on(figure: Any) -> None:
        ax = figure.add_axes((0.01, 0.15, 0.98, 0.84))
        in_plane.polar(ax, lines, radius_label=label)
        figure.legend(
            handles=in_plane.handles(lines),
            loc="lower center",
            ncols=3 if len(lines) < 4 else 2,
            frameon=False,
            fontsize=7,
        )

    return Drawing(f"model-{name}", "polar", name, "", "", (4.6, 2.9), on).rendered().svg


def main() -> None:
    """Write the page's tables and pictures."""
    page = with_tables(PAGE.read_text(encoding="utf-8"))
    PAGE.write_text(page, encoding="utf-8")
    (DOCS / "models").mkdir(exist_ok=True)
    for name, sample in samples(page).items():
        text = picture(name, model_of(sample))
        (DOCS / "models" / f"{name}.svg").write_text(text, encoding="utf-8")
        print(f"{name}: {len(text) / 1000:.0f} kB")


if __name__ == "__main__":
    main()
