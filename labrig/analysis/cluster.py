"""Workers of a cluster, through dask.

This is the only module that imports dask, which is installed with the extra `cluster`.
"""

import logging
import re
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from threading import Event

from dask.distributed import Client, KilledWorker

from labrig.analysis.engine import Pool, describe_installation
from labrig.errors import InputError, MachineError, WorkersError

_ADDRESS = re.compile(r"(tcp|tls)://[^/\s:]+:\d{1,5}")
_ANSWER_S = 10.0
_LOST_S = 60.0
"""How long a cluster that had workers may be without any."""
_LOOK_S = 0.1
_CONNECT_HINT = "check that its scheduler runs, its address, and the network between"
_LOGGERS = ("distributed", "distributed.client", "tornado", "tornado.application")


class _Cluster(Pool):
    """The workers of a scheduler, which may be without any for `wait_s`."""

    patience_s = 5.0

    def __init__(self, client: Client, place: str, work: str, wait_s: float) -> None:
        super().__init__(work, client.get_executor(pure=False))
        self.installation = describe_installation()
        self._client = client
        self._place = place
        self._wait_s = wait_s
        self._workers = 1

    def count_workers(self) -> int:
        # Of a scheduler that is out of reach the last count is good enough: its tasks tell the reason.
        if self._client.status == "running":
            with suppress(OSError):
                self._workers = max(1, len(self._client.nthreads()))
        return self._workers

    def count_deaths(self, error: BaseException) -> int | None:
        """Return after how many deaths the scheduler has given a task up; none, if it was out of reach for a while."""
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

    def close(self) -> None:
        """Drop what the workers still do, unless the scheduler is gone and they with it."""
        if self._client.status == "running":
            self.executor.shutdown(wait=False)


@contextmanager
def open_cluster(
    place: str, work: str, *, answer_s: float = _ANSWER_S, lost_s: float = _LOST_S
) -> Iterator[Pool]:
    """Give a pool of the workers of a cluster; tasks that have not ended are dropped when the block ends.

    Parameters
    ----------
    place : str
        The address of a dask scheduler, `tcp://host:port` or `tls://host:port`.
    work : str
        What the workers do, in the past tense, for messages.
    answer_s : float
        How long the scheduler and its first worker may take to answer [s].
    lost_s : float
        How long there may be no worker later [s].

    Raises
    ------
    InputError
        When the address cannot be used.
    MachineError
        When no scheduler or no worker answers, or a worker does several tasks at a time.
    """
    for name in _LOGGERS:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if _ADDRESS.fullmatch(place) is None:
        raise InputError(f"{place} is no address of a dask scheduler", "for example tcp://host:8786")
    try:
        client = Client(place, timeout=answer_s)
    except (OSError, ValueError) as error:
        told = f"the cluster {place} does not answer within {answer_s:g} s: {error}"
        raise MachineError(told, _CONNECT_HINT) from error
    with client:
        _wait_for_workers(client, place, answer_s)
        _require_one_task_each(client)
        pool = _Cluster(client, place, work, lost_s)
        try:
            yield pool
        finally:
            pool.close()


def _wait_for_workers(client: Client, place: str, wait_s: float) -> None:
    try:
        client.wait_for_workers(1, timeout=wait_s)
    except (OSError, ValueError, RuntimeError) as error:
        raise WorkersError(
            f"the cluster {place} has no worker after {wait_s:g} s", "start workers, or look at its queue"
        ) from error


def _require_one_task_each(client: Client) -> None:
    """Refuse workers that compute several tasks at a time. Raises `WorkersError`."""
    for worker, threads in sorted(client.nthreads().items()):
        if threads != 1:
            raise WorkersError(
                f"worker {worker} does {threads} tasks at a time in one process, expected 1",
                f"start it with --nthreads 1 --nworkers {threads}",
            )
