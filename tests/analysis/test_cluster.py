"""The engine on workers of a cluster: a dask scheduler on the loopback."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import dask
import pytest
from dask.distributed import Client, LocalCluster

from labrig.analysis.cluster import open_cluster
from labrig.analysis.divergence import compare_results
from labrig.analysis.engine import run_in_order
from labrig.analysis.result import AnalysisResult
from labrig.analysis.run import analyze_run, analyze_runs
from labrig.errors import InputError, MachineError, WorkersError
from labrig.experiments.registry import find_run_experiment
from labrig.record.agreement import Verdict
from labrig.record.reader import open_run
from tests.analysis.synthetic import NOW, PROVENANCE

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
FIRST = ROOT / "tests" / "records" / "steerability"

_LOOPBACK = {
    "host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "scheduler_kwargs": {"dashboard": False},
    "worker_dashboard_address": None,
}  # fmt: skip


def square(task: int) -> int:
    """Return a result that tells its task."""
    return task * task


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    """Two worker processes that a scheduler starts again when they die; it gives a task up at its first death."""
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        LocalCluster(n_workers=2, threads_per_worker=1, silence_logs=50, **_LOOPBACK) as started,
    ):
        yield started


def test_a_cluster_has_the_results_of_one_process(cluster):
    """Results come in order; a worker that is killed in the middle costs nothing but time."""
    outcomes = []
    with open_cluster(cluster.scheduler_address, "squared") as pool:
        assert pool.count_workers() == 2
        for outcome in run_in_order(pool, square, range(200)):
            outcomes.append(outcome)
            if len(outcomes) == 20:
                os.kill(cluster.workers[0].pid, signal.SIGKILL)
    assert outcomes == [square(task) for task in range(200)]


def test_a_cluster_measures_the_pictures_of_runs(cluster, tmp_path):
    """The numbers are those of this computer alone."""
    runs = [Path(shutil.copytree(FIRST, tmp_path / name)) for name in ("a", "b")]
    alone = analyze_run(
        open_run(runs[0]), find_run_experiment(open_run(runs[0])), created=NOW, provenance=PROVENANCE
    )
    with open_cluster(cluster.scheduler_address, "analysed runs") as pool:
        measured = list(analyze_runs(runs, find_run_experiment, pool, created=NOW, provenance=PROVENANCE))
    assert [run for run, _ in measured] == runs
    for _, outcome in measured:
        assert isinstance(outcome, AnalysisResult)
        assert compare_results(alone.document, outcome.document).verdict is Verdict.IDENTICAL


def test_a_worker_of_another_installation_is_refused(cluster, tmp_path):
    """A worker with other code is named with its first task."""
    shutil.copytree(ROOT / "labrig", tmp_path / "labrig", ignore=shutil.ignore_patterns("__pycache__"))
    with (tmp_path / "labrig" / "text.py").open("a") as file:
        file.write("# other code\n")
    command = (sys.executable, "-m", "distributed.cli.dask_worker", cluster.scheduler_address)
    with (
        open_cluster(cluster.scheduler_address, "squared") as pool,
        Client(cluster.scheduler_address) as client,
        subprocess.Popen(
            [*command, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1"],
            cwd=tmp_path, env={**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}, stderr=subprocess.DEVNULL,
        ) as other,
    ):  # fmt: skip
        try:
            client.wait_for_workers(3, timeout=300)
            with pytest.raises(MachineError, match=r"has source_sha256 .*, this process has"):
                list(run_in_order(pool, square, range(500)))
        finally:
            other.terminate()


def test_a_cluster_that_has_lost_every_worker_ends_the_work():
    """Tasks that nobody does are not waited for without end; those that were done came back before."""
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, silence_logs=50, **_LOOPBACK) as started,
        open_cluster(started.scheduler_address, "squared", answer_s=60.0, lost_s=0.1) as pool,
    ):
        pool.patience_s = 0.1
        outcomes = run_in_order(pool, square, range(200))
        assert [next(outcomes) for _ in range(20)] == [square(task) for task in range(20)]
        started.scale(0)
        started.sync(started._correct_state)
        with pytest.raises(WorkersError, match=r"has no worker after 0.1 s"):
            list(outcomes)


@pytest.mark.parametrize(
    ("workers", "message"), [(0, "has no worker after 0.1 s"), (2, "does 2 tasks at a time in one process")]
)
def test_a_cluster_without_fit_workers_is_refused(workers, message):
    """No worker at all, or one that does several tasks at a time in one process, is named."""
    with (
        LocalCluster(
            n_workers=min(1, workers), threads_per_worker=2, processes=False, protocol="tcp://", **_LOOPBACK
        ) as started,
        pytest.raises(MachineError, match=message),
        open_cluster(started.scheduler_address, "squared", answer_s=0.1),
    ):
        pass


@pytest.mark.parametrize(
    ("place", "error", "message"),
    [
        *((place, InputError, "is no address of a dask scheduler")
          for place in ("tcp://127.0.0.1", "http://127.0.0.1:1", "tcp://host:port")),
        ("tcp://127.0.0.1:1", MachineError, r"does not answer within 0\.2 s"),
    ],
)  # fmt: skip
def test_what_is_no_address_or_does_not_answer_is_refused(place, error, message):
    """An address has a host and a port, and a scheme that dask speaks; where nothing listens the wait has a limit."""
    with pytest.raises(error, match=message), open_cluster(place, "squared", answer_s=0.2):
        pass
