"""Workers of a cluster, through dask: those of a scheduler that runs already, or jobs that a batch system starts.

This is the only module that imports dask, which is installed with the extra `cluster`.
"""

import logging
import re
from collections.abc import Iterator, Mapping
from concurrent.futures import CancelledError, Executor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Event
from typing import Any, Literal

import dask
from dask.distributed import Client, KilledWorker, Status
from dask_jobqueue.core import JobQueueCluster
from dask_jobqueue.htcondor import HTCondorCluster
from dask_jobqueue.lsf import LSFCluster
from dask_jobqueue.moab import MoabCluster
from dask_jobqueue.oar import OARCluster
from dask_jobqueue.pbs import PBSCluster
from dask_jobqueue.sge import SGECluster
from dask_jobqueue.slurm import SLURMCluster
from pydantic import Field, JsonValue

from labrig.analysis.engine import Pool
from labrig.analysis.installation import describe_installation, describe_kernels, digest_installation
from labrig.errors import InputError, MachineError, WorkersError
from labrig.protocol.model import Model
from labrig.protocol.yaml_file import load_yaml_model
from labrig.record.processor import describe_change

_ADDRESS = re.compile(r"(tcp|tls)://[^/\s:]+:\d{1,5}")
_ANSWER_S = 10.0
_LOST_S = 60.0
"""How long a cluster that had workers may be without any; jobs may take longer to begin."""
_LOOK_S = 0.1
# The workers of a cluster come and go, and asking for them takes about a millisecond.
_CALLS_BETWEEN_COUNTS = 64
_CONNECT_HINT = "check that its scheduler runs, its address, and the network between"
_INSTALL_HINT = "install the same labrig and the same packages wherever workers run, and start them anew"
# The scheduler has an HTTP server even so, which then only this computer reaches.
_NO_DASHBOARD = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
# Files of the job cluster, which it leaves to the garbage collector to close.
_CERTIFICATES = ("_job_ca_file", "_job_cert", "_job_key")
_LOGGERS = ("distributed", "distributed.client", "tornado", "tornado.application")

_SYSTEMS: Mapping[str, type[JobQueueCluster]] = {
    "htcondor": HTCondorCluster,
    "lsf": LSFCluster,
    "moab": MoabCluster,
    "oar": OARCluster,
    "pbs": PBSCluster,
    "sge": SGECluster,
    "slurm": SLURMCluster,
}
_System = Literal["htcondor", "lsf", "moab", "oar", "pbs", "sge", "slurm"]


class ClusterFile(Model):
    """Jobs of a batch system whose processes are the workers."""

    jobs: int = Field(
        default=1, ge=1, le=10_000, description="Jobs that are kept running; each has the processes below."
    )
    wait_s: float = Field(
        default=3600.0, gt=0, le=1e6, description="Longest wait for the first of them to begin [s]."
    )
    jobqueue: dict[_System, dict[str, JsonValue]] = Field(
        min_length=1,
        max_length=1,
        description="The batch system, and its section of dask-jobqueue's own configuration: cores, memory, queue.",
    )


class _Cluster(Pool):
    """The workers of a scheduler, which may be without any for `wait_s`."""

    patience_s = 5.0

    def __init__(self, client: Client, place: str, work: str, wait_s: float) -> None:
        super().__init__(work)
        self._client = client
        self._place = place
        self._wait_s = wait_s
        self._executor: Executor = client.get_executor(pure=False)
        self._workers = 0
        self._calls = 0

    @property
    def executor(self) -> Executor:
        return self._executor

    @property
    def installation(self) -> str:
        return digest_installation()

    def count_workers(self) -> int:
        # Of a scheduler that is out of reach the last count is good enough: its batches tell the reason.
        if self._calls % _CALLS_BETWEEN_COUNTS == 0 and self._client.status == "running":
            with suppress(OSError):
                self._workers = len(self._client.nthreads())
        self._calls += 1
        return max(1, self._workers)

    def count_deaths(self, error: BaseException) -> int | None:
        """Return after how many deaths the scheduler has given a batch up; none, if it was out of reach for a while."""
        if isinstance(error, KilledWorker):
            return int(error.allowed_failures) + 1
        return 0 if isinstance(error, CancelledError) else None

    def renew(self) -> None:
        """Wait for the scheduler and a worker, both of which replace themselves. Raises `WorkersError`."""
        while self._client.status == "connecting":
            Event().wait(_LOOK_S)
        if self._client.status != "running":
            raise WorkersError(f"the cluster {self._place} does not answer any more", _CONNECT_HINT)
        _wait_for_workers(self._client, self._place, self._wait_s)

    def require_usable(self, error: BaseException) -> None:  # noqa: ARG002 - what it says differs by version
        self.renew()
        _require_same_installation(self._client)

    def close(self) -> None:
        """Drop what the workers still do, unless the scheduler is gone and they with it."""
        if self._client.status == "running":
            self._executor.shutdown(wait=False)


@contextmanager
def open_cluster(
    place: str, work: str, *, answer_s: float = _ANSWER_S, lost_s: float = _LOST_S
) -> Iterator[Pool]:
    """Give a pool of the workers of a cluster; batches that have not ended are dropped when the block ends.

    Parameters
    ----------
    place : str
        The address of a dask scheduler, `tcp://host:port` or `tls://host:port`, or a file that is read as
        `ClusterFile`; the jobs of a file end with the block.
    work : str
        What the workers do, in the past tense, for messages.
    answer_s : float
        How long the scheduler and its first worker may take to answer [s]; jobs may take as long as their file says.
    lost_s : float
        How long there may be no worker later [s]; of jobs, at least as long as the first one may take to begin.

    Raises
    ------
    InputError
        When the address or the file cannot be used.
    MachineError
        When no scheduler or no worker answers, or a worker has another installation than this process.
    """
    for name in _LOGGERS:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as held:
        if "://" in place:
            client, wait_s = held.enter_context(_connect(place, answer_s)), answer_s
        else:
            file = load_yaml_model(Path(place), ClusterFile)
            client, wait_s = held.enter_context(_start_jobs(place, file)), file.wait_s
            lost_s = max(wait_s, lost_s)
        _wait_for_workers(client, place, wait_s)
        _require_same_installation(client)
        pool = _Cluster(client, place, work, lost_s)
        pool.unlike = _name_unlike_workers(client)
        held.callback(pool.close)
        yield pool


@contextmanager
def _connect(address: str, answer_s: float) -> Iterator[Client]:
    if _ADDRESS.fullmatch(address) is None:
        raise InputError(f"{address} is no address of a dask scheduler", "for example tcp://host:8786")
    try:
        client = Client(address, timeout=answer_s)
    except (OSError, ValueError) as error:
        raise MachineError(
            f"the cluster {address} does not answer within {answer_s:g} s: {error}", _CONNECT_HINT
        ) from error
    with client:
        yield client


@contextmanager
def _start_jobs(place: str, file: ClusterFile) -> Iterator[Client]:
    """Start the jobs of a file, under a scheduler in this process that takes only workers with its own certificate."""
    ((system, given),) = file.jobqueue.items()
    known = dask.config.get(f"jobqueue.{system}")
    if unknown := sorted(given.keys() - known.keys()):
        raise InputError(
            f"{place}: jobqueue.{system} has no {unknown[0]}", f"its keys are {', '.join(sorted(known))}"
        )
    section = _fill_section(known, given)
    # The engine does lost batches again by itself, and finds the task that is to blame.
    settings = {
        "jobqueue": {**dask.config.get("jobqueue"), system: section},
        "distributed.scheduler.allowed-failures": 0,
    }
    with dask.config.set(settings), ExitStack() as held:
        try:
            cluster = held.enter_context(_open_jobs(_SYSTEMS[system]))
            # The first job is submitted here, where the words of the batch system are heard.
            cluster.worker_spec.update(cluster.new_worker_spec())
            cluster.sync(cluster._correct_state)  # noqa: SLF001 - what `scale` leaves to the background
        except (ValueError, TypeError, OSError, RuntimeError) as error:
            raise InputError(
                f"{place}: {system} took no job: {error}",
                "correct the file, or run labrig where jobs are submitted",
            ) from error
        cluster.adapt(minimum_jobs=file.jobs, maximum_jobs=file.jobs)
        yield held.enter_context(Client(cluster))


@contextmanager
def _open_jobs(kind: type[JobQueueCluster]) -> Iterator[JobQueueCluster]:
    cluster = kind(security=True)
    try:
        yield cluster
    finally:
        _mark_jobs_not_begun(cluster)
        cluster.close()
        for name in _CERTIFICATES:
            getattr(cluster, name).close()


def _mark_jobs_not_begun(cluster: JobQueueCluster) -> None:
    """Mark jobs that could not be submitted as failed: the cluster takes them for new ones, and would not close."""
    for job in tuple(cluster._created):  # noqa: SLF001 - `workers` does not have such a job yet
        if job.job_id is None:
            job.status = Status.failed


def _fill_section(known: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a batch system: a process for each core, no dashboard."""
    section = {**known, **given}
    if section["processes"] is None:
        section["processes"] = section["cores"]
    if section["shared-temp-directory"] is None:
        section["shared-temp-directory"] = str(Path.home())
    section["scheduler-options"] = {**_NO_DASHBOARD, **(section["scheduler-options"] or {})}
    return section


def _wait_for_workers(client: Client, place: str, wait_s: float) -> None:
    try:
        client.wait_for_workers(1, timeout=wait_s)
    except (OSError, ValueError, RuntimeError) as error:
        raise WorkersError(
            f"the cluster {place} has no worker after {wait_s:g} s", "start workers, or look at its queue"
        ) from error


def _require_same_installation(client: Client) -> None:
    """Refuse workers that compute several tasks at a time, or not with our code. Raises `WorkersError`."""
    for worker, threads in sorted(client.nthreads().items()):
        if threads != 1:
            raise WorkersError(
                f"worker {worker} does {threads} tasks at a time in one process, expected 1",
                f"start it with --nthreads 1 --nworkers {threads}; of a job, processes is cores",
            )
    ours = describe_installation()
    for worker, found in sorted(client.run(describe_installation, on_error="return").items()):
        if not isinstance(found, Mapping):
            raise WorkersError(
                f"worker {worker} cannot import labrig: {type(found).__name__}: {found}", _INSTALL_HINT
            )
        for name, value in ours.items():
            if found.get(name) != value:
                raise WorkersError(
                    f"worker {worker} has {name} {found.get(name)}, this process has {value}", _INSTALL_HINT
                )


def _name_unlike_workers(client: Client) -> tuple[str, ...]:
    ours = describe_kernels()
    changes = {
        worker: describe_change(found, ours)
        for worker, found in sorted(client.run(describe_kernels, on_error="return").items())
    }
    return tuple(
        f"what worker {worker} computes is {change}; last digits may differ"
        for worker, change in changes.items()
        if change
    )
