"""The study `coverage`: its statistics on campaigns of known coverage, whole campaigns, and going on after a kill."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_sim.world import truth_of
from scipy.special import ndtri
from typer.testing import CliRunner

from gonio.config import numbers_in, to_toml
from gonio.errors import ConfigError, Interrupted
from gonio.geometry import Directions
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.reduction import brdf
from gonio.lab.rig.calibration_files import covariance_of
from tools.studies import coverage, coverage_campaign, coverage_hidden, coverage_judgement
from tools.studies.__main__ import app

POINTS = 12
REACH = float(ndtri(0.975))


def record(number: int, too_small: float = 1.0) -> dict[str, Any]:
    """A campaign whose values have one common error and independent ones, stated `too_small` times too small."""
    rng = np.random.default_rng([7, number])
    truth = rng.uniform(0.1, 0.3, POINTS)
    random, common = 0.002 * truth, 0.004 * truth
    value = truth + random * rng.standard_normal(POINTS) + common * rng.standard_normal()
    spread = np.array([[4.0, 1.2], [1.2, 1.0]]) * 1e-4
    found = np.array([0.5, 0.2]) + np.linalg.cholesky(spread) @ rng.standard_normal(2)
    parameters = {
        name: {
            "true": true, "value": x, "u": u / too_small, "at_bound": "", "low": x - REACH * u / too_small,
            "high": x + REACH * u / too_small, "open_low": False, "open_high": False,
        }
        for name, true, x, u in zip("ab", (0.5, 0.2), found, np.sqrt(np.diag(spread)), strict=True)
    }  # fmt: skip
    return {
        "format": coverage_campaign.FORMAT, "campaign": number, "model": ("one", "two")[number % 2],
        "plan": "in plane", "failed": None,
        "wavelength_nm": 550.0, "seconds": 1.0, "calibrated": {}, "wrong": {},
        "points": {
            "theta_i_deg": [30.0] * POINTS, "theta_r_deg": [40.0] * POINTS, "dphi_deg": [180.0] * POINTS,
            "brdf": value.tolist(), "truth": truth.tolist(), "region": ["elsewhere"] * POINTS,
            "u_brdf": (np.hypot(random, common) / too_small).tolist(), "u_random": (random / too_small).tolist(),
            "common": {"s_reference": (common / too_small).tolist()},
        },
        "fit": {
            "parameters": parameters, "free": ["a", "b"], "covariance": (spread / too_small**2).tolist(),
            "chi_square": 9.0, "freedom": 10, "p_value": float(rng.random()),
        },
    }  # fmt: skip


def test_right_uncertainties_cover_the_truth() -> None:
    counts, pulls, uniform = coverage_judgement.judged([record(k) for k in range(400)])
    every = {c.kind: c for c in counts if c.group == "all"}
    assert set(every) == {"points", "joint", "parameters", "joint parameters"}
    for c in every.values():
        assert c.campaigns == 400  # each once, though it has twelve values
        assert c.holds, c
    assert all(0.85 < p["sd"] < 1.15 for p in pulls if p["group"] == "all")  # 1 +- 0.035 of 400 campaigns
    assert all(p["sd_low"] < 1.0 < p["sd_high"] for p in pulls if p["group"] == "all")
    assert all(u["p_uniform"] > 0.01 and sum(u["bins"]) == u["campaigns"] for u in uniform)


@pytest.mark.parametrize("too_small", [1.4, 0.6])
def test_wrong_uncertainties_are_found(too_small: float) -> None:
    counts, pulls, uniform = coverage_judgement.judged([record(k, too_small) for k in range(400)])
    for c in counts:
        if c.group == "all":
            assert not c.holds, c
            assert (c.high < 0.95) == (too_small > 1.0)
    (points,) = (p for p in pulls if p["group"] == "all" and p["kind"] == "points")
    assert points["sd"] == pytest.approx(too_small, rel=0.12)  # three standard errors of 400 campaigns
    assert uniform[0]["p_uniform"] < 1e-6


def test_a_common_error_is_one_trial() -> None:
    # all twelve values of a campaign are off together: counted as twelve, the interval would be a third as wide
    counts, _, _ = coverage_judgement.judged([record(k) for k in range(60)])
    (c,) = (c for c in counts if c.kind == "points" and c.group == "all")
    assert c.campaigns == 60
    assert c.high - c.low > 0.08


def test_binomial_intervals() -> None:
    none, every = (coverage_judgement.count("points", "", "all", [hit] * 10) for hit in (False, True))
    far = 1.0 - 0.025**0.1  # Clopper and Pearson 1934: no case among ten
    assert (none.low, none.high) == pytest.approx((0.0, far))
    assert (every.low, every.high) == pytest.approx((1.0 - far, 1.0))
    assert every.holds
    assert not none.holds


def test_causes_are_drawn_alike_alone_or_among_others() -> None:
    every, one = coverage_hidden.campaign(3, 17), coverage_hidden.campaign(3, 17, ["drift"])
    assert one.true == {"lamp": {"drift_per_hour": every.true["lamp"]["drift_per_hour"]}}
    assert (one.truth, one.points, one.seed) == (every.truth, every.points, every.seed)
    assert "zero_offset_known" not in one.rig["arms"]["light"]
    assert every.rig["arms"]["light"]["zero_offset_known"] is False
    assert every.rig["arms"]["light"].get("zero_offset_deg") is None
    with pytest.raises(ConfigError, match=r'no error "warmth"; there are zeros, geometry'):
        coverage_hidden.campaign(3, 17, ["warmth"])


def test_a_certificate_is_off_by_what_it_states(tmp_path: Path) -> None:
    every = [coverage_hidden.campaign(4, k) for k in range(200)]
    some = [(c, c.certificate) for c in every if c.certificate is not None]
    assert 75 < len(some) < 125  # four standard deviations of a coin
    squares = []
    for _, known in some:
        off, covariance = np.array(known.off), np.array(known.correlation) * np.outer(known.u, known.u)
        squares.append(off @ np.linalg.solve(covariance, off))
    size = len(coverage_hidden.CERTIFIED)
    # chi-square: four standard errors of the mean
    assert np.mean(squares) == pytest.approx(size, abs=4.0 * math.sqrt(2.0 * size / len(some)))
    c, known = some[0]
    (tmp_path / "rig.toml").write_text(to_toml(c.rig), encoding="utf-8")
    (tmp_path / "truth.toml").write_text(to_toml(c.true), encoding="utf-8")
    rig = coverage_campaign.certified(c, tmp_path / "rig.toml", {})
    description = find_rig(str(rig)).description
    true, found = (numbers_in(d.model_dump(mode="json")) for d in (truth_of(description), description))
    for name, error in zip(known.parameters, known.off, strict=True):
        assert found[name] == pytest.approx(true[name] + error, abs=1e-12)
    assert np.sqrt(np.diag(covariance_of(description, known.parameters))) == pytest.approx(known.u)
    assert all(axis.zero_offset_known for axis in description.axes().values())


def test_regions() -> None:
    theta_i, theta_r, dphi = np.radians([[30, 30, 30, 30, 70, 30], [31, 38, 25, 0, 10, 50], [180, 180, 0, 0, 180, 90]])
    where = Directions(theta_i, np.zeros(6), theta_r, dphi)
    names = ["around the mirror", "around the mirror", "around retro", "elsewhere", "grazing", "elsewhere"]
    assert coverage_campaign.regions(where, None) == names
    assert coverage_campaign.regions(where, math.radians(1.0)) == ["specular spike", *names[1:]]


@pytest.mark.slow
def test_campaigns_from_files_to_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = brdf.reduce

    def blind(run: Any) -> Any:
        (run.path.parent / "truth.toml").unlink()  # from here on nobody needs what is true
        return real(run)

    monkeypatch.setattr(brdf, "reduce", blind)
    out = tmp_path / "found"
    asked = ["coverage", "--out", str(out), "--quick", "--campaigns", "2", "--jobs", "1", "--seed", "5"]
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 0, result.output
    assert result.stdout.strip() == str(out / "index.html")
    found = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert (found["campaigns"], found["refused"]) == (2, [])
    page = (out / "index.html").read_text(encoding="utf-8")
    assert not re.search(r'(src|href)="(?!#)', page)  # nothing is loaded
    assert "zero offsets of light and camera" in page
    for k, model in enumerate(("lambert", "oren-nayar")):
        r = json.loads((out / "campaigns" / f"0000{k}.json").read_text(encoding="utf-8"))
        assert r["model"] == model
        z = coverage_judgement.point_pulls(r)
        assert 8 < z.size <= coverage.FEW_POINTS
        # sums of a dozen squares: beyond 3 on average with a probability of 1e-6
        assert 0.05 < np.mean(z**2) < 3.0
        # hidden, and found by commands' functions; beyond 5 by chance alone once in 1e6
        for name, one in r["calibrated"].items():
            assert abs(one["value"] - one["true"]) < 5.0 * one["u"], name
        assert {"lamp.noise", "camera.electrons_per_dn", "camera.stray_light"} <= set(r["calibrated"])
        sheet, hidden = r["rig"]["camera"], r["hidden"]["camera"]
        assert sheet["electrons_per_dn"] != hidden["electrons_per_dn"]
        assert "stray_light" not in sheet
    assert not (out / "work").exists()
    assert len((out / "campaigns.csv").read_text(encoding="utf-8").splitlines()) == 3


def faked(monkeypatch: pytest.MonkeyPatch, *, stop_at: int | None = None) -> list[int]:
    """Campaigns that take no time; the numbers of those that are carried out. One of them is interrupted."""
    done: list[int] = []

    def carried_out(campaign: coverage_hidden.Campaign, folder: Path) -> dict[str, Any]:
        folder.mkdir(parents=True)
        if campaign.number == stop_at:
            raise KeyboardInterrupt
        folder.rmdir()
        done.append(campaign.number)
        return record(campaign.number)

    monkeypatch.setattr(coverage_campaign, "carried_out", carried_out)
    monkeypatch.setattr("tools.studies.coverage_page.drawn", lambda summary: [])  # that of whole ones is above
    return done


def test_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    faked(monkeypatch, stop_at=4)
    out = tmp_path / "found"
    with pytest.raises(Interrupted, match="4 of 8 campaigns are done and kept"):
        coverage.make(out, campaigns=8, jobs=1)
    assert not (out / "index.html").exists()
    (out / "campaigns" / "00002.json").write_text('{"format": 3, "cam', encoding="utf-8")  # a damaged disk
    again = faked(monkeypatch)
    steps: list[tuple[int, int]] = []
    coverage.make(out, campaigns=8, jobs=1, step=lambda done, total: steps.append((done, total)))
    assert again == [2, 4, 5, 6, 7]
    assert (steps[0], steps[-1]) == ((3, 8), (8, 8))
    more = faked(monkeypatch)
    coverage.make(out, campaigns=10, jobs=1)
    assert more == [8, 9]
    other = tmp_path / "at once"
    faked(monkeypatch)
    coverage.make(other, campaigns=10, jobs=1)
    kept, whole = ((folder / "campaigns.csv").read_bytes() for folder in (out, other))
    assert kept == whole


def test_a_refused_campaign_is_named(tmp_path: Path) -> None:
    # a rig whose camera cannot hold the patch: the measurement refuses it
    c = coverage_hidden.campaign(5, 0, ["drift"], 15)
    narrow = replace(
        c, rig=coverage_hidden.merged(c.rig, {"acquisition": {"roi_radius_mm": 2.9}, "camera": {"pixel_um": 2.0}})
    )
    found = coverage_campaign.carried_out(narrow, tmp_path / "0")
    assert found["failed"]["step"] == "measurement"
    assert "makes the patch" in found["failed"]["message"]
    counts, _, _ = coverage_judgement.judged([found, *(record(k) for k in range(1, 20))])
    assert next(c for c in counts if c.group == "all").campaigns == 19
    (named,) = coverage_judgement.failed([found])
    assert named["campaign"] == 0
