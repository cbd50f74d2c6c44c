"""Who does the work of many tasks: processes of this computer, or the workers of a cluster."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from labrig.analysis.engine import Pool, open_process_pool
from labrig.cli.output import say
from labrig.errors import InputError
from labrig.posix import count_usable_cores


def require_one_pool(workers: int | None, cluster: str | None) -> None:
    """Refuse processes of this computer beside a cluster. Raises `InputError`."""
    if workers is not None and cluster is not None:
        raise InputError("--workers and --cluster exclude each other", "a cluster has its own workers")


@contextmanager
def open_pool(workers: int | None, cluster: str | None, work: str) -> Iterator[Pool]:
    """Give the workers that were asked for.

    Parameters
    ----------
    workers : int or None
        So many processes; None for one on each core.
    cluster : str or None
        The address of a cluster instead.
    work : str
        What they do, in the past tense, for messages: "computed tasks".
    """
    if cluster is None:
        with open_process_pool(workers or count_usable_cores(), work) as pool:
            yield pool
        return
    if find_spec("distributed") is None:
        raise InputError(
            "--cluster needs labrig's extra cluster, which is not installed", "see: labrig manual install"
        )
    # Imported late: dask takes a second, and is not installed with labrig.
    from labrig.analysis.cluster import open_cluster

    with open_cluster(cluster, work) as pool:
        for sentence in pool.unlike:
            say(f"note: {sentence}")
        yield pool
