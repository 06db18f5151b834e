"""Fits, comparisons, plots and reports.

What a script or a notebook needs most can be taken from here; it is imported when it is first asked for.
"""

from typing import Any

__all__ = ["change", "compare", "consensus", "fit", "polar", "semilog"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'gonio_analysis' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module("gonio_analysis.report.notebook"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
