"""Parameters over the wavelength, where several were fitted: their part of a page."""

from gonio_analysis.report.blocks import Block, Figures, Heading
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.section import Figures as ByKind
from gonio_analysis.report.section import Section


def _blocks(d: DatasetSummary, figures: ByKind) -> list[Block]:
    return [Heading(3, "Parameters over wavelength"), Figures(figures["series"])] if "series" in figures else []


SECTIONS = (Section("wavelengths", _blocks),)
