"""Who does the work of many tasks: processes of this computer, or the workers of a cluster."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from labrig.analysis.engine import CORES, Pool, open_process_pool
from labrig.errors import InputError


@contextmanager
def open_pool(workers: int | None, cluster: str | None, work: str) -> Iterator[Pool]:
    """Give workers, of this computer or of a cluster.

    Parameters
    ----------
    workers : int or None
        So many processes; None for one on each core.
    cluster : str or None
        The address of a cluster instead, tcp://HOST:PORT of a dask scheduler.
    work : str
        What they do, in the past tense, for messages: "computed tasks".

    Raises
    ------
    InputError
        When both are given, or dask is not installed.
    """
    if workers is not None and cluster is not None:
        raise InputError("--workers and --cluster exclude each other", "a cluster has its own workers")
    if cluster is None:
        with open_process_pool(workers or CORES, work) as pool:
            yield pool
        return
    if find_spec("distributed") is None:
        raise InputError(
            "--cluster needs labrig's extra cluster, which is not installed", "see: labrig manual install"
        )
    # Imported late: dask takes a second, and is not installed with labrig.
    from labrig.analysis.cluster import open_cluster

    with open_cluster(cluster, work) as pool:
        yield pool
