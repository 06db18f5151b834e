"""The parts that a sample's page ends with, in their order; those of other packages come last.

To add one: write `mine.py` beside this with `SECTIONS`, and name it in `_MODULES`. Other packages name a `Section`, or
several, as an entry point of the group `gonio.sections`.
"""

from functools import partial
from importlib import import_module

from gonio import plugins
from gonio.lost import kept
from gonio_analysis.report.section import Section

_MODULES = (
    "model_parts",
    "model_forms",
    "channels",
    "beyond_reflection",
    "polarisation",
    "appearance",
    "checks",
    "budget",
    "health",
)
SECTIONS: tuple[Section, ...] = tuple(
    section for name in _MODULES for section in import_module(f"gonio_analysis.report.{name}").SECTIONS
)


def every(own: tuple[Section, ...]) -> tuple[Section, ...]:
    """These, and those that other packages bring; one that cannot be loaded is lost, and named."""
    found = list(own)
    for name, point in plugins.available("gonio.sections").items():
        what = f'section plug-in "{name}" ({point.value})'
        found += kept(what, partial(_loaded, name, [one.name for one in found]), lambda _: ())
    return tuple(found)


def _loaded(name: str, taken: list[str]) -> tuple[Section, ...]:
    brought = plugins.load("gonio.sections", name)
    sections = (brought,) if isinstance(brought, Section) else tuple(brought)
    for one in sections:
        if not isinstance(one, Section):
            raise TypeError(f"{one!r} is no gonio_analysis.report.section.Section")
        if one.name in taken or [other.name for other in sections].count(one.name) > 1:
            raise ValueError(f'there is a section named "{one.name}" already')
    return sections
