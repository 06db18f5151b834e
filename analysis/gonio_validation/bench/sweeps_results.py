"""What `results.json` of `gonio bench sweeps` holds, key by key: the page and its drawings are made from these."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from gonio.documents import JsonObject
from gonio_validation.bench.campaigns import Record

ENOUGH = 0.005
"""An error that is small enough, whatever a uniform grid has: 0.5 %."""
SHARE = 0.45
"""At most so many of a uniform grid's points."""
HELD = (0.93, 0.97)
"""Between these lies the part of curves that intervals of 95 % hold, over all runs."""


@dataclass(frozen=True)
class ByPoints:
    """The adaptive plan with a given number of points, beside the uniform grid."""

    sample: str
    runs: int
    uniform_points: float
    points: float
    uniform_interpolated: float
    """Root mean square of the relative error."""
    uniform_process: float
    adaptive: float

    @property
    def allowed(self) -> float:
        """The error of the uniform grid, interpolated in the usual way, or what is small enough."""
        return max(self.uniform_interpolated, ENOUGH)

    @property
    def holds(self) -> bool:
        """Whether the adaptive plan keeps to it."""
        return self.adaptive <= self.allowed and self.points <= SHARE * self.uniform_points


@dataclass(frozen=True)
class Held:
    """How much of the curves the stated intervals of 95 % hold."""

    geometry: str
    sample: str
    """"all" of them, or one."""
    runs: int
    inside: float
    lowest: float
    """Of any run: a whole curve moves with its scale."""

    @property
    def holds(self) -> bool:
        """Whether it is about 95 %."""
        return HELD[0] <= self.inside <= HELD[1]


def levels(records: Sequence[Record]) -> list[JsonObject]:
    """Results of a plan's size, put together over seeds; of the adaptive plan batch by batch.

    `seconds` is rig time, `rms` the relative error over the curve and the runs, `largest` that of any run, and `inside`
    the part of the curve within its intervals of 95 %.
    """
    groups: dict[tuple[str, str, str, str, int], list[JsonObject]] = {}
    for record in records:
        count: dict[tuple[str, str], int] = {}
        for r in record["results"]:
            place = count[r["plan"], r["way"]] = count.get((r["plan"], r["way"]), -1) + 1
            groups.setdefault((record["sample"], record["geometry"], r["plan"], r["way"], place), []).append(r)
    return [
        dict(zip(("sample", "geometry", "plan", "way"), key[:4], strict=True)) | {
            "runs": len(rs), "points": _mean([r["points"] for r in rs]), "seconds": _mean([r["seconds"] for r in rs]),
            "rms": math.sqrt(_mean([r["rms"] ** 2 for r in rs])), "largest": max(r["largest"] for r in rs),
            "inside": None if rs[0]["inside"] is None else _mean([r["inside"] for r in rs]),
        }
        for key, rs in groups.items()
    ]  # fmt: skip


def of_plan(found: Sequence[JsonObject], geometry: str, sample: str, plan: str, way: str) -> list[JsonObject]:
    """The levels of one plan."""
    wanted = {"geometry": geometry, "sample": sample, "plan": plan, "way": way}
    return [level for level in found if wanted.items() <= level.items()]


def by_points(found: Sequence[JsonObject]) -> list[ByPoints]:
    """For each sample in plane."""
    out = []
    for sample in dict.fromkeys(level["sample"] for level in found):
        adaptive, simple, process = (
            of_plan(found, "in plane", sample, plan, way)
            for plan, way in (
                ("adaptive by points", "process"),
                ("uniform", "interpolated"),
                ("uniform", "process"),
            )
        )
        if adaptive and simple and process:
            last, grid, again = adaptive[-1], *(max(v, key=lambda v: float(v["points"])) for v in (simple, process))
            out.append(
                ByPoints(
                    sample, last["runs"], grid["points"], last["points"], grid["rms"], again["rms"], last["rms"],
                )
            )  # fmt: skip
    return out


def held(records: Sequence[Record]) -> list[Held]:
    """Of the adaptive runs when they ended: one by one sample, and all together."""
    out = []
    for geometry in dict.fromkeys(r["geometry"] for r in records):
        own = [(r["sample"], _ends(r)) for r in records if r["geometry"] == geometry]
        for sample in ("all", *dict.fromkeys(name for name, _ in own)):
            inside = [x for name, xs in own for x in xs if sample in ("all", name)]
            out.append(Held(geometry, sample, len(inside), _mean(inside), min(inside)))
    return out


def _ends(record: Record) -> list[float]:
    """Of every adaptive run of a comparison: the part of the curve within its intervals when it ended."""
    last = {r["plan"]: float(r["inside"]) for r in record["results"] if r["plan"].startswith("adaptive")}
    return list(last.values())


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)
