"""Do intervals of 95 % hold the truth in 95 % of all campaigns? Counts, pulls and probabilities from records.

All values of one campaign share its errors: its zeros, its reference, its drift. So a campaign counts once in every
count, by one value that is chosen at random and beforehand, or by one test of all its values together.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from zlib import crc32

import numpy as np
from scipy.special import chdtrc
from scipy.stats import binomtest, kstest

from gonio.typing import Floats, JsonObject

Record = Mapping[str, Any]
LEVEL = 0.95
"""Level of every interval that is judged, and of the intervals of what is counted here."""
REACH = 1.959963984540054
"""Standard deviations on either side of a normal interval of 95 %."""
RESAMPLES = 2000
FEWEST = 5
"""Campaigns below which a group is not shown: its interval would reach from a half to 1."""
WORST = 15


@dataclass(frozen=True)
class Count:
    """In how many campaigns an interval of 95 % holds the truth."""

    kind: str
    """"points", "joint", "parameters", "joint parameters", "wrong" or "calibrated"."""
    what: str
    """The quantity."""
    group: str
    """The campaigns that count: "all", or those of a model, a plan or a region; of "parameters" model and parameter."""
    campaigns: int
    inside: int
    low: float
    """Clopper-Pearson interval (95 %) of the coverage."""
    high: float

    @property
    def holds(self) -> bool:
        """Whether the interval contains 95 %."""
        return self.low <= LEVEL <= self.high


def chosen(record: Record, what: str, among: Sequence[int]) -> int:
    """One of several values of a campaign: chosen by its number and a name alone, not by what came out."""
    rng = np.random.default_rng([int(record["campaign"]), crc32(what.encode())])
    return int(among[int(rng.integers(len(among)))])


# --- one campaign -------------------------------------------------------------------------------------------------


def point_pulls(record: Record) -> Floats:
    """(brdf - truth) / u_brdf of every point."""
    p = record["points"]
    out: Floats = (np.array(p["brdf"]) - np.array(p["truth"])) / np.array(p["u_brdf"])
    return out


def joint_p(record: Record) -> float:
    """Probability of a larger chi-square of all points, with their whole covariance, were it right."""
    p = record["points"]
    common = np.array(list(p["common"].values())).reshape(len(p["common"]), -1)
    # a value whose independent part is 0 would have infinite weight; as a fit has it
    random = np.maximum(np.array(p["u_random"]), 1e-6 * np.array(p["u_brdf"]))
    covariance = np.diag(random**2) + common.T @ common
    off = np.array(p["brdf"]) - np.array(p["truth"])
    return float(chdtrc(len(off), float(off @ np.linalg.solve(covariance, off))))


def parameters_p(record: Record) -> float | None:
    """The same of the fitted parameters, by their covariance; None where one stands at a bound or is undetermined."""
    found = record["fit"]["parameters"]
    if any(p["at_bound"] or not p["u"] for p in found.values()):
        return None
    off = np.array([found[name]["value"] - found[name]["true"] for name in record["fit"]["free"]])
    covariance = np.array(record["fit"]["covariance"], dtype=float)
    return float(chdtrc(len(off), float(off @ np.linalg.solve(covariance, off))))


# --- all campaigns ------------------------------------------------------------------------------------------------


def count(kind: str, what: str, group: str, inside: Iterable[bool]) -> Count:
    """How often, with the interval of Clopper and Pearson."""
    found = [bool(x) for x in inside]
    low, high = binomtest(sum(found), len(found)).proportion_ci(LEVEL, method="exact")
    return Count(kind, what, group, len(found), sum(found), float(low), float(high))


def pulls(kind: str, what: str, group: str, values: Sequence[float]) -> JsonObject:
    """Mean and standard deviation of (found - true) / u, one number a campaign.

    `u_mean` is the standard error of the mean; `sd_low` to `sd_high` the interval (95 %) of the standard deviation,
    from campaigns drawn again with replacement.
    """
    z = np.array(values)
    again = np.random.default_rng(z.size).choice(z, (RESAMPLES, z.size)).std(axis=1, ddof=1)
    low, high = np.quantile(again, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
    sd = float(z.std(ddof=1))
    return {
        "kind": kind,
        "what": what,
        "group": group,
        "campaigns": z.size,
        "mean": float(z.mean()),
        "u_mean": sd / math.sqrt(z.size),
        "sd": sd,
        "sd_low": float(low),
        "sd_high": float(high),
        "largest": float(abs(z).max()),
    }


def uniform(what: str, values: Sequence[float]) -> JsonObject:
    """Whether probabilities, one a campaign, are uniform between 0 and 1: they are where the covariance is right.

    `p_uniform` is Kolmogorov and Smirnov's test of that, `bins` counts campaigns in ten equal bins.
    """
    bins, _ = np.histogram(values, bins=10, range=(0.0, 1.0))
    p_uniform = float(kstest(values, "uniform").pvalue)
    return {"what": what, "campaigns": len(values), "p_uniform": p_uniform, "bins": bins.tolist()}


def judged(records: Sequence[Record]) -> tuple[list[Count], list[JsonObject], list[JsonObject]]:
    """Everything that is counted, from the records of campaigns that did not fail."""
    counts, spreads = list[Count](), list[JsonObject]()

    def judge(kind: str, what: str, group: str, values: Sequence[float], inside: Sequence[bool] | None = None) -> None:
        if len(values) < FEWEST and group != "all":
            return
        within = [abs(z) <= REACH for z in values] if inside is None else inside
        if len(within):
            counts.append(count(kind, what, group, within))
        if len(values) > 1:
            spreads.append(pulls(kind, what, group, values))

    measured = [r for r in records if r["points"] and r["points"]["brdf"]]
    fits = [r for r in records if r["fit"]]
    one = "one point, chosen at random"
    for key in ("all", "model", "plan"):
        for group, some in grouped(measured, key).items():
            judge("points", one, named(key, group), single_points(some))
    for region in sorted({name for r in measured for name in r["points"]["region"]}):
        judge("points", one, f"region {region}", single_points(measured, region))
    joint = [joint_p(r) for r in measured]
    several = [p for r in fits if (p := parameters_p(r)) is not None]
    if joint:
        counts.append(count("joint", "all points together", "all", [p >= 1.0 - LEVEL for p in joint]))
        for key in ("model", "plan"):
            for group, some in grouped(measured, key).items():
                if len(some) >= FEWEST:
                    within = [joint_p(r) >= 1.0 - LEVEL for r in some]
                    counts.append(count("joint", "all points together", named(key, group), within))
    if several:
        within = [p >= 1.0 - LEVEL for p in several]
        counts.append(count("joint parameters", "all fitted parameters together", "all", within))
    drawn = [chosen_parameter(r) for r in fits]
    within = [_holds(p) for p in drawn]
    judge("parameters", "one parameter, chosen at random", "all", known_pulls(drawn), within)
    for group, some in grouped(fits, "model").items():
        for name in some[0]["fit"]["free"]:
            every = [r["fit"]["parameters"][name] for r in some]
            judge("parameters", name, f"{group}: {name}", known_pulls(every), [_holds(p) for p in every])
    for kind in ("wrong", "calibrated"):
        for name in sorted({name for r in records for name in r[kind]}):
            found = [r[kind][name] for r in records if name in r[kind]]
            judge(kind, name, name, [(x["value"] - x["true"]) / x["u"] for x in found])
    tests = {
        "all points together": joint,
        "all fitted parameters together": several,
        "chi-square of the fit": [r["fit"]["p_value"] for r in fits if r["fit"]["p_value"] is not None],
    }
    return counts, spreads, [uniform(what, values) for what, values in tests.items() if values]


def grouped(records: Sequence[Record], key: str) -> dict[str, list[Record]]:
    """Records by their "model" or "plan"; of "all", together."""
    out: dict[str, list[Record]] = {}
    for r in records:
        out.setdefault("all" if key == "all" else str(r[key]), []).append(r)
    return out


def named(key: str, group: str) -> str:
    """What a group of campaigns is called: a plan and a region may have one name."""
    return group if key == "all" else f"{key} {group}"


def single_points(records: Sequence[Record], region: str | None = None) -> list[float]:
    """The pull of one point of each campaign, of those in a region where one is named."""
    out = []
    for r in records:
        where = r["points"]["region"]
        among = [k for k in range(len(where)) if region in (None, where[k])]
        if among:
            out.append(float(point_pulls(r)[chosen(r, f"point {region}", among)]))
    return out


def chosen_parameter(record: Record) -> Mapping[str, Any]:
    """The fitted parameter of a campaign that is judged."""
    names = record["fit"]["free"]
    found: Mapping[str, Any] = record["fit"]["parameters"][names[chosen(record, "parameter", range(len(names)))]]
    return found


def _holds(parameter: Mapping[str, Any]) -> bool:
    slack = 1e-9 * max(abs(parameter["low"]), abs(parameter["high"]))
    return bool(parameter["low"] - slack <= parameter["true"] <= parameter["high"] + slack)


def known_pulls(parameters: Iterable[Mapping[str, Any]]) -> list[float]:
    """Pulls of the parameters that the data determine, inside their bounds."""
    return [(p["value"] - p["true"]) / p["u"] for p in parameters if p["u"] and not p["at_bound"]]


def worst(records: Sequence[Record], most: int = WORST) -> list[JsonObject]:
    """The points that are farthest off in their own uncertainty."""
    out = []
    for r in records:
        if not (r["points"] and r["points"]["brdf"]):
            continue
        p, z = r["points"], point_pulls(r)
        k = int(np.argmax(abs(z)))
        one = {name: r[name] for name in ("campaign", "model", "plan")}
        one |= {name: p[name][k] for name in ("region", "theta_i_deg", "theta_r_deg", "dphi_deg", "brdf", "truth")}
        out.append(one | {"u_brdf": p["u_brdf"][k], "pull": float(z[k])})
    return sorted(out, key=lambda w: -abs(w["pull"]))[:most]


def failed(records: Sequence[Record]) -> list[JsonObject]:
    """Campaigns that a program refused."""
    return [
        {name: r[name] for name in ("campaign", "model", "plan")} | r["failed"]
        for r in records
        if r["failed"] is not None
    ]


def line(record: Record) -> JsonObject:
    """A record as a line of `campaigns.csv`."""
    fit = record["fit"]
    out: JsonObject = {name: record[name] for name in ("campaign", "model", "plan", "wavelength_nm")}
    out |= dict.fromkeys(("points", "pull_of_one", "largest_pull", "joint_p", "parameter", "parameter_holds"))
    out["points"] = 0
    if record["points"] and record["points"]["brdf"]:
        z = point_pulls(record)
        out |= {"points": z.size, "pull_of_one": single_points([record])[0], "largest_pull": float(abs(z).max())}
        out["joint_p"] = joint_p(record)
    if fit:
        name = fit["free"][chosen(record, "parameter", range(len(fit["free"])))]
        out |= {"parameter": name, "parameter_holds": int(_holds(fit["parameters"][name]))}
    out |= {f"fit_{name}": fit.get(name) for name in ("chi_square", "freedom", "p_value")}
    failed = record["failed"]
    out["failed"] = "" if failed is None else f"{failed['step']}: {failed['message']}"
    return out | {"seconds": record["seconds"]}
