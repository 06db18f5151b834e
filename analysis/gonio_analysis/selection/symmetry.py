"""What a table says of its sample's symmetry, for a page: `gonio.checks.symmetry` of some observations."""

from __future__ import annotations

from gonio.checks import symmetry
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.result_records import SymmetrySummary


def symmetries(data: Observations) -> list[SymmetrySummary]:
    """What could be compared: nothing is listed that has fewer than three pairs."""
    return [
        SymmetrySummary(s.kind, s.words, s.pairs, s.typical, s.largest, s.reduced_chi_square, s.differ)
        for s in symmetry.symmetries(data.checked)
    ]
