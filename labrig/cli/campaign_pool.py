"""The workers of a campaign: processes of this computer, or those of a cluster."""

from collections.abc import Iterator
from contextlib import contextmanager

from labrig.analysis.engine import Pool, open_process_pool
from labrig.cli.missing_package import require_package
from labrig.posix import count_usable_cores


@contextmanager
def open_pool(workers: int | None, cluster: str | None) -> Iterator[Pool]:
    """Give the workers that were asked for: so many processes, None for one on each core, or a cluster's."""
    work = "computed tasks"
    if cluster is None:
        with open_process_pool(workers or count_usable_cores(), work) as pool:
            yield pool
        return
    require_package("distributed", "dask", "--cluster")
    require_package("dask_jobqueue", "dask-jobqueue", "--cluster")
    # Imported late: dask takes a second, and is not installed with labrig.
    from labrig.analysis.cluster import open_cluster

    with open_cluster(cluster, work) as pool:
        yield pool
