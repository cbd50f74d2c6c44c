"""A campaign by one call: reads its files, computes what is left of it, writes its table and its page."""

from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from labrig.analysis.engine import run_in_order
from labrig.analysis.experiment import TaskOutcome
from labrig.campaign.page import write_page
from labrig.campaign.result import CampaignResult, make_result
from labrig.campaign.statistics import ends_by_rule, require_measure
from labrig.campaign.store import FIXED, TABLE_FILE, CampaignStore, Row, open_store
from labrig.campaign.tasks import LoadedCampaign, Task, compute_task, load_campaign, make_row
from labrig.devices.clocks import SystemClock
from labrig.errors import LabrigError, WorkersError
from labrig.lab import CAMPAIGNS, find_in_lab
from labrig.library.names import find_protocol_file
from labrig.library.pools import open_pool
from labrig.runner.attendant import Attendant
from labrig.text import format_count

Compute = Callable[[Iterable[Task]], Generator[TaskOutcome | LabrigError, None, None]]
"""Returns what comes of each task, in their order."""
_SILENT = Attendant()


@dataclass(frozen=True)
class Campaign:
    """A campaign in its folder: what it found, its table, and its page."""

    path: Path
    result: CampaignResult
    table: Path
    report: Path


def run_campaign(
    file: Path | str,
    *,
    out: Path | str | None = None,
    rig: Path | str | None = None,
    settings: Sequence[str] = (),
    workers: int | None = None,
    cluster: str | None = None,
    attendant: Attendant = _SILENT,
) -> Campaign:
    """Repeat a protocol virtually as a campaign file says; return its table, its result and its page.

    Begun again on the same folder, it goes on behind its last row; interrupted, it leaves a page of what is done.

    Parameters
    ----------
    out : Path, str or None
        Its folder; None: one of the campaign's name in `data/campaigns` of the lab folder.
    rig, settings
        As for `load_campaign`.
    workers, cluster
        As for `open_pool`.

    Raises
    ------
    FileFormatError, InputError
        When something cannot be used.
    DiskError, MachineError
        When it cannot go on; what is done stays done.
    """
    with attendant.progress(Path(file).stem, 1.0) as progress:
        loaded = load_campaign(
            find_protocol_file(Path(file), is_campaign=True),
            settings=settings,
            rig=None if rig is None else Path(rig),
            progress=lambda share: progress(share, "reading the arms"),
        )
    folder = find_in_lab(CAMPAIGNS) / loaded.file.campaign if out is None else Path(out)
    with (
        open_pool(workers, cluster, "computed tasks") as pool,
        open_store(folder, loaded.describe()) as store,
    ):
        begin, count = len(store.rows), loaded.count
        if store.change:
            attendant.say(f"note: the first rows were {store.change}; last digits may differ")
        if 0 < begin < count:
            attendant.say(f"{folder}: {begin} of {count} tasks are done already")
        try:
            with attendant.progress(loaded.file.campaign, float(max(1, count - begin))) as tell:
                compute_campaign(
                    loaded,
                    store,
                    partial(run_in_order, pool, compute_task),
                    lambda done: tell(float(done - begin), f"{done} of {count} tasks"),
                )
        except (KeyboardInterrupt, WorkersError):
            done = len(store.rows)
            attendant.say(f"{done} of {count} tasks are done; the same command goes on behind them")
            if done:
                attendant.say(f"report  {write_report(loaded, store).report}")
            raise
        if begin == len(store.rows):
            attendant.say(f"{folder} has ended with {format_count(begin, 'task')}; nothing is left to do")
        attendant.say("writing the report")
        return write_report(loaded, store)


def compute_campaign(
    loaded: LoadedCampaign, store: CampaignStore, compute: Compute, progress: Callable[[int], None]
) -> None:
    """Compute the tasks that the store does not have, until the last or a rule, and keep their rows as they come.

    Rows come back in order. However it ends, those that came until then are kept, and the campaign can go on.

    Parameters
    ----------
    compute : callable
        Computes tasks.
    progress : callable
        Told how many tasks are done.

    Raises
    ------
    InputError
        When tasks do not have the quantity by which they are judged.
    DiskError, MachineError
        When rows cannot be kept, or no task can be computed.
    """
    for row in store.rows:
        _judge(loaded, row)
    begin = len(store.rows)
    progress(begin)
    if begin >= loaded.count or ends_by_rule(loaded.file, loaded.by, store.rows):
        return
    with closing(compute(loaded.list_tasks(begin))) as outcomes:
        for task, outcome in zip(loaded.list_tasks(begin), outcomes, strict=False):
            row = make_row(task, outcome)
            _judge(loaded, row)
            store.append(row)
            progress(len(store.rows))
            if ends_by_rule(loaded.file, loaded.by, store.rows):
                return


def _judge(loaded: LoadedCampaign, row: Row) -> None:
    """Refuse a row whose values do not have the measure as a number; a task that failed has none."""
    others = {*FIXED, *loaded.file.varied_keys}
    if values := [name for name, value in row.items() if name not in others and not isinstance(value, str)]:
        require_measure(loaded.by, values)


def write_report(loaded: LoadedCampaign, store: CampaignStore) -> Campaign:
    """Write the table and the page of the tasks that are done. Raises `DiskError`."""
    table, file = store.write_table(), store.folder / TABLE_FILE
    result = make_result(loaded, table, file=file, by_rule=ends_by_rule(loaded.file, loaded.by, store.rows))
    report = write_page(store.folder, loaded, result, table, SystemClock().utc())
    return Campaign(store.folder, result, file, report)
