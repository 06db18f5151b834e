"""The parts that a sample's page ends with, in their order.

To add one: write `mine.py` beside this with `SECTIONS`, and name it in `_MODULES`.
"""

from importlib import import_module

from gonio_analysis.report.section import Section

_MODULES = (
    "beyond_reflection",
    "appearance",
    "checks",
    "budget",
    "wavelengths",
    "health",
)
SECTIONS: tuple[Section, ...] = tuple(
    section for name in _MODULES for section in import_module(f"gonio_analysis.report.{name}").SECTIONS
)
