"""Maps compared pixel by pixel: planted changes are found, and few of what is marked is chance."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_analysis.changes.verdict import FALSE_DISCOVERIES
from gonio_maps.files import FIT_FLAGS, Variable
from gonio_maps.pixel_by_pixel import change, marked_pixels, together
from scipy.stats import false_discovery_control

from gonio.errors import DataError
from gonio.typing import Floats
from tests.command_line import gonio, says
from tests.gonio_maps.map_files import fits

SHAPE, RHO = (80, 100), 0.8
PLANTED = np.s_[20:40, 30:70]
"""800 of 8000 pixels."""


def one(path: Path, seed: int, *, by: float = 0.0, shape: tuple[int, int] = SHAPE, **more: object) -> Path:
    """A map of two correlated parameters with noise as its u says; `by` so many u are added to m within `PLANTED`."""
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(2, *shape))
    u = {"m": np.full(shape, 0.01), "s": np.full(shape, 0.002)}
    values: dict[str, Floats] = {
        "m": 0.3 + 0.01 * first,
        "s": 0.5 + 0.002 * (RHO * first + np.sqrt(1 - RHO**2) * second),
    }
    values["m"][PLANTED] += by * 0.01
    correlation = Variable(("y", "x", "pair"), dtype="f4", attrs={"pairs": "m:s"})
    whole = {"correlation": (correlation, np.full((*shape, 1), RHO))}
    return fits(path, values, u, more=whole, **more)  # type: ignore[arg-type]


def test_planted_changes_are_found_and_false_ones_are_rare(tmp_path: Path) -> None:
    planted = np.zeros(SHAPE, bool)
    planted[PLANTED] = True
    false, found, marked = 0, 0, 0
    for k in range(6):
        a, b = one(tmp_path / f"a{k}.h5", 10 + k), one(tmp_path / f"b{k}.h5", 50 + k, by=5.0)
        c = change(a, b)
        false += int((c.changed & ~planted).sum())
        found += int((c.changed & planted).sum())
        marked += int(c.changed.sum())
        # 7200 values with a standard deviation of 1: 1.5 % is two standard errors
        assert np.std(c.parameters[0].z[~planted]) == pytest.approx(1.0, abs=0.025)
    # the expected share is 0.05 times the 90 % that did not change; about 220 false ones have an error of 0.3 %
    assert false / marked <= FALSE_DISCOVERIES
    assert false / marked == pytest.approx(0.9 * FALSE_DISCOVERIES, abs=0.015)
    # 5 u of m are 5/sqrt(2)/sqrt(1 - 0.8^2) = 5.9 standard deviations given s: nearly all exceed the limit of about 3.4
    assert found > 0.98 * 6 * planted.sum()


def test_nothing_changed_marks_nothing_in_most_maps(tmp_path: Path) -> None:
    counts = [
        int(change(one(tmp_path / f"a{k}.h5", 100 + k), one(tmp_path / f"b{k}.h5", 200 + k)).changed.sum())
        for k in range(10)
    ]
    # each map marks any with a probability of 5 %: three of ten with 1 %
    assert sum(count > 0 for count in counts) <= 2


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 1.0])
def test_what_is_marked_is_what_scipy_marks(share: float) -> None:
    rng = np.random.default_rng(5)
    p = rng.random((50, 40)) * np.where(rng.random((50, 40)) < share, 1e-3, 1.0)
    p[3] = np.nan
    wanted = false_discovery_control(p[np.isfinite(p)]) <= FALSE_DISCOVERIES
    np.testing.assert_array_equal(marked_pixels(p)[np.isfinite(p)], wanted)
    assert not marked_pixels(p)[3].any()


def test_correlations_count() -> None:
    difference = np.array([[1.0, -1.0], [1.0, 1.0], [np.nan, 2.0]])
    total, freedom = together(difference, np.broadcast_to(np.array([[1.0, 0.8], [0.8, 1.0]]), (3, 2, 2)))
    # d' C^-1 d by hand: 2/(1 - 0.8), 2/(1 + 0.8), and a single one alone
    assert total == pytest.approx([10.0, 2 / 1.8, 4.0], rel=1e-12)
    assert freedom.tolist() == [2, 2, 1]


def test_what_is_not_determined_is_not_compared(tmp_path: Path) -> None:
    shape = (4, 5)
    m, u = np.full(shape, 0.3), np.full(shape, 0.01)
    m[0] = np.nan
    a = fits(tmp_path / "a.h5", {"m": m}, {"m": u}, flag=np.where(np.isnan(m), 1 << FIT_FLAGS.index("undetermined"), 0))
    c = change(a, fits(tmp_path / "b.h5", {"m": np.full(shape, 0.9)}, {"m": np.where(np.arange(5) == 2, np.nan, u)}))
    assert c.compared == 3 * 4
    assert c.changed.sum() == 12
    assert c.share == 1.0


def test_grids_models_and_kinds_that_do_not_match_are_refused(tmp_path: Path) -> None:
    a = one(tmp_path / "a.h5", 1)
    cases: tuple[tuple[dict[str, Any], str], ...] = (
        ({"shape": (80, 99)}, r"has 100 x 80 pixels, .* 99 x 80: --change compares maps on one grid"),
        ({"pixel_mm": 0.11}, r"its x lies up to .* mm beside that of"),
        ({"model": "ggx"}, r"holds cook-torrance, .* ggx: fit one model to both maps"),
    )
    for keys, message in cases:
        with pytest.raises(DataError, match=message):
            change(a, one(tmp_path / "b.h5", 1, **keys))
    (tmp_path / "t.csv").write_text("x", encoding="utf-8")
    says(gonio(tmp_path, "compare", a, "t.csv", "--change", "--out", "o", expect=2).stderr, "t.csv is no map")


@pytest.mark.slow
def test_the_page_says_which_pixels_changed(tmp_path: Path) -> None:
    one(tmp_path / "a.h5", 1)
    one(tmp_path / "b.h5", 2, by=8.0)
    gonio(tmp_path, "compare", "a.h5", "b.h5", "--change", "--out", "o", expect=0)
    told = json.loads((tmp_path / "o" / "summary.json").read_text(encoding="utf-8"))
    c = change(tmp_path / "a.h5", tmp_path / "b.h5")
    assert told["changed"] == int(c.changed.sum()) >= 800
    assert told["share"] == pytest.approx(told["changed"] / 8000)
    assert told["conclusion"].startswith(f"{told['changed']} of 8000 pixels changed")
    # the median of 800 differences, each with an error of 0.014
    assert told["parameters"]["m"]["median_change_where_changed"] == pytest.approx(0.08, abs=0.002)
    assert [f["name"] for f in told["figures"]] == ["map-changed", "map-z-m", "map-z-s"]
    with open(tmp_path / "o" / "tables" / "changed.csv", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == told["changed"]
    assert {(int(r["row"]), int(r["column"])) for r in rows} == set(zip(*map(list, np.nonzero(c.changed)), strict=True))
