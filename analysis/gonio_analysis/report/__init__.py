"""The comparison report: `index.html` (self-contained), `summary.json`, figures as SVG, tables as CSV.

What makes it is imported when it is first asked for: words and numbers of a fit need none of the drawing.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gonio_analysis.report.making import make, write

__all__ = ["make", "write"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from gonio_analysis.report import making

    return getattr(making, name)
