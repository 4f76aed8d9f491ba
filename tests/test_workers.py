"""Many recordings on any executor: order, bad ones, lost processes."""

import os
import signal

import pytest

from cdm_pin.errors import InputError, RecordingError
from cdm_pin.workers import Skipped, Workers, cluster, processes, run_all


def double(x: int) -> int:
    """Work on an item; 13 is bad."""
    if x == 13:
        raise RecordingError("is unlucky", source=f"item {x}")
    return 2 * x


def deadly(x: tuple[int, str]) -> int:
    """Kill this process: at 1 always, at 2 until its mark exists."""
    number, mark = x
    if number == 1 or (number == 2 and not os.path.exists(mark)):
        open(mark, "w").close()
        os.kill(os.getpid(), signal.SIGKILL)
    return 10 * number


@pytest.mark.parametrize("make", [Workers, lambda: processes(2)], ids=["here", "processes"])
def test_results_come_in_the_order_of_the_items(make):
    """All items, once each, in order, with progress up to 1."""
    seen: list[float] = []
    with make() as workers:
        assert list(run_all(double, range(12), workers, progress=seen.append)) == [2 * k for k in range(12)]
        assert list(run_all(double, [5], workers)) == [10]
    assert seen[-1] == 1.0 and seen == sorted(seen)


def test_a_bad_item_stops_or_is_skipped_by_name():
    """The error is the item's own; skipping leaves the name and the reason in its place."""
    with pytest.raises(RecordingError, match="item 13: is unlucky"):
        list(run_all(double, [1, 13, 2], Workers()))
    results = list(run_all(double, [1, 13, 2], Workers(), names=["a", "b", "c"], skip_bad=True))
    assert results == [2, Skipped("b", "item 13: is unlucky"), 4]


def test_work_survives_lost_processes(tmp_path):
    """What dies once is done again; what kills its process whenever it runs is named; the others are unharmed."""
    items = [(k, str(tmp_path / f"mark{k}")) for k in range(5)]
    with processes(2) as workers:
        results = list(run_all(deadly, items, workers, names=list("abcde"), skip_bad=True))
    assert results == [0, Skipped("b", "b: killed the process that worked on it, twice"), 20, 30, 40]


def test_a_dask_cluster_does_the_same():
    """Results in order, bad items skipped by name, on workers of a Dask scheduler."""
    distributed = pytest.importorskip("distributed", reason="the optional packages of a cluster: cdm-pin[cluster]")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as dask:
        with cluster(dask.scheduler_address) as workers:
            results = list(run_all(double, [1, 13, 2], workers, names=["a", "b", "c"], skip_bad=True))
    assert results == [2, Skipped("b", "item 13: is unlucky"), 4]


def test_a_cluster_needs_its_packages_or_its_scheduler():
    """One line says what is missing."""
    with pytest.raises(InputError, match=r"cdm-pin\[cluster\]|no Dask scheduler"):
        cluster("tcp://127.0.0.1:9")
