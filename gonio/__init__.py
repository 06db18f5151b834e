"""The core of the goniometer workbench: directions, rigs, plans, acquisition, radiometry, tables and models.

What a script or a notebook needs most can be taken from here; it is imported when it is first asked for.
"""

from typing import Any

from gonio import moved

__version__ = "0.2.0"

_FROM = {
    "read": "gonio.measurement",
    "write": "gonio.measurement",
    "open_rig": "gonio.lab.by_hand.manual_rig",
    "HeTorrance": "gonio.models",
    "CookTorrance": "gonio.models",
    "OrenNayar": "gonio.models",
    "Blinn": "gonio.models",
    "Phong": "gonio.models",
    "Lambert": "gonio.models",
    "Sum": "gonio.models",
    "apparent_brdf": "gonio.instrument",
}

__all__ = [*_FROM]

moved.install()


def __getattr__(name: str) -> Any:
    if name not in _FROM:
        raise AttributeError(f"module 'gonio' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_FROM[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *_FROM]
