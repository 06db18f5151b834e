"""plan.csv: the points of a run, as a table that a person reads."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING

from gonio.acquisition.plan import ANGLES, Assessed

if TYPE_CHECKING:
    pass

PLAN_COLUMNS = ["point", *ANGLES, "flag", "reason"]


def plan_csv(points: list[Assessed]) -> str:

    out = io.StringIO()
    lines = csv.writer(out, lineterminator="\n")
    lines.writerow(PLAN_COLUMNS)
    for row, a in enumerate(points):
        lines.writerow([row, *(repr(float(getattr(a.point, name))) for name in ANGLES), a.flag, a.reason])
    return out.getvalue()
