"""The parts that a sample's page ends with, in their order. To add one: its file, and its name here."""

from gonio_analysis.report import (
    appearance,
    budget,
    checks,
    health,
    polarisation,
    sessions,
    transmission,
    wavelengths,
)

SECTIONS = (
    transmission.SECTION,
    polarisation.SECTION,
    appearance.SECTION,
    checks.SECTION,
    budget.SECTION,
    wavelengths.SECTION,
    sessions.SECTION,
    health.SECTION,
)
