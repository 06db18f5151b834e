"""A whole sampler: it halves gaps between neighbours whose values differ by more than a ratio."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from gonio_sweeps.expected import spent_s

from gonio.config import Strict, parse
from gonio.geometry import Directions
from gonio.lab.acquisition.duration import Durations
from gonio.lab.acquisition.plan import assess, canonical
from gonio.lab.acquisition.sampling import Choice
from gonio.lab.reduction import brdf
from gonio.lab.rig.description import Positive


class Settings(Strict):  # the keys of [adaptive] beside how and budget_h; an unknown key is an error
    theta_i_deg: float
    ratio: Positive = 1.5
    finest_deg: Positive = 1.0


class Halving:
    def __init__(self, plan, description):  # touches no device and no file
        self.settings = parse(Settings, plan.adaptive.own, f"{plan.source}: [adaptive]")
        self.plan, self.description = plan, description
        self.band = plan.bands(description)[0]
        self.budget_s = 3600.0 * plan.adaptive.budget_h
        self.durations = Durations(description, plan.bands(description))

    def about(self):  # optional: lines for `gonio plan show`
        return [f"halves gaps over which the BRDF changes by more than {self.settings.ratio:g} times"]

    def first(self, planned):
        return self.reachable(range(-60, 61, 30))

    def next(self, run):
        table = brdf.reduce(run)  # every value so far, in the rows of run.plan
        one = (table["wavelength_nm"] == self.band.centre_nm).to_numpy()
        asked = np.degrees(Directions.from_table(run.plan).signed).round(9)
        values = dict(zip(asked.tolist(), table["brdf"].to_numpy()[one], strict=True))
        known = sorted((theta_r, value) for theta_r, value in values.items() if value > 0)  # NaN where flagged
        middles = [
            0.5 * (a + b)
            for (a, low), (b, high) in pairwise(known)
            if max(low, high) > self.settings.ratio * min(low, high) and b - a >= 2 * self.settings.finest_deg
        ]
        points = [point for point in self.reachable(middles) if point not in self.measured(run)]
        why = {"values": len(known), "gaps": len(middles), "spent_s": spent_s(self.durations, run)}
        if not points:
            return Choice((), why, "enough: no gap is left that wants a point", met=True)
        if why["spent_s"] >= self.budget_s:
            return Choice((), why, f"enough: the budget is spent, and {len(points)} gaps are left")
        return Choice(tuple(points), why, f"{len(points)} gaps are halved")

    def reachable(self, angles_deg):
        """Points in the plane of incidence; theta_r is positive on the mirror side."""
        points = tuple(canonical(self.settings.theta_i_deg, 0.0, angle, 180.0) for angle in angles_deg)
        found = assess(replace(self.plan, points=points), self.description)
        return [one.point for one in found if one.pose is not None]

    def measured(self, run):
        return {canonical(*row) for row in run.points.angles_deg.tolist()}


class Plugin:
    def open(self, plan, description):
        return Halving(plan, description)


HALVING = Plugin()
