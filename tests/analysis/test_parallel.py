"""Samples on several processes, and on a Dask cluster."""

from __future__ import annotations

import pickle

import pytest
from gonio_analysis import parallel
from gonio_analysis.compare import examine
from gonio_analysis.fit import fit
from gonio_analysis.report.summary import summarise

from gonio.errors import ConfigError
from gonio.models import Lambert, build

from .synthetic import measure


def test_a_fit_goes_to_another_process_and_back() -> None:
    paint = build("cook-torrance", {"s": 0.1, "d": 0.9, "slopes": ((0.25, 1.0),), "diffuse_albedo": 0.4, "ior": 1.5})
    result = fit(measure(paint), "cook-torrance", fix={"ior": 1.5}, bounds={"m": (0.1, 0.5)})
    again = pickle.loads(pickle.dumps(result))
    assert again.to_json() == result.to_json()
    assert again.problem.model(again.vector) == result.model


def test_results_come_in_the_order_of_the_jobs() -> None:
    assert list(parallel.each(abs, [-3])) == [3]
    assert list(parallel.each(abs, [-3, 2, -1, 5])) == [3, 2, 1, 5]


def test_an_examined_sample_comes_back_whole() -> None:
    dataset = examine(measure(Lambert(0.5), name="matte"), ["lambert", "oren-nayar"], name="matte")
    again = pickle.loads(pickle.dumps(dataset))
    assert (
        summarise([again], title="", normalise="mirror", command="")["datasets"]
        == summarise([dataset], title="", normalise="mirror", command="")["datasets"]
    )


def test_on_a_cluster() -> None:
    distributed = pytest.importorskip("distributed", reason="the extra gonio[dask] is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", host="127.0.0.1", dashboard_address=None
    ) as cluster:
        assert list(parallel.each(abs, [-3, 2], dask=cluster.scheduler_address)) == [3, 2]


def test_a_cluster_without_its_package_or_scheduler_is_an_error() -> None:
    with pytest.raises(ConfigError, match="--dask"):
        list(parallel.each(abs, [1], dask="tcp://127.0.0.1:9"))
