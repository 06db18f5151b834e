"""The parts that a sample's page ends with, in their order. To add one: its file, and its name here."""

from gonio_analysis.report import appearance, beyond_reflection, budget, checks, health, wavelengths

SECTIONS = (
    beyond_reflection.TRANSMISSION,
    beyond_reflection.POLARISATION,
    appearance.SECTION,
    checks.SECTION,
    budget.SECTION,
    wavelengths.SECTION,
    health.SESSIONS,
    health.SECTION,
)
