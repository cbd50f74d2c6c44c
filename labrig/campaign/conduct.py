"""Conducts a campaign: tasks go out, rows come back in order and are kept as they come, until the last or a rule."""

from collections.abc import Callable, Generator, Iterable
from contextlib import closing

from labrig.analysis.outcome import TaskOutcome
from labrig.campaign.statistics import WidthRule, require_measure
from labrig.campaign.store import CampaignStore
from labrig.campaign.tasks import CampaignTasks, Row, TaskOrder, list_values
from labrig.clock import Clock
from labrig.errors import LabrigError

_KEEP_S = 2.0
_KEEP_SHARE = 0.01
"""A row waits to be kept for at most so long, or this share of the time so far; a killed labrig computes it again."""
_KEEP_ROWS = 5000

Compute = Callable[[Iterable[TaskOrder]], Generator[TaskOutcome | LabrigError, None, None]]
"""Returns what comes of each task, in their order."""
Progress = Callable[[int, int], None]
"""Told how many tasks are done, and how many there are."""


def conduct_campaign(
    tasks: CampaignTasks, store: CampaignStore, compute: Compute, clock: Clock, progress: Progress
) -> bool:
    """Compute the tasks that the store does not have, keep their rows, and return whether a rule ended the campaign.

    However it ends, the rows that came until then are kept, and the campaign can go on.

    Parameters
    ----------
    tasks : CampaignTasks
    store : CampaignStore
        Has the rows of the leading tasks, if it was begun before.
    compute : callable
        Computes tasks.
    clock : Clock
        Says when rows are kept.

    Raises
    ------
    InputError
        When tasks do not have the quantity by which they are judged.
    DiskError, MachineError
        When rows cannot be kept, or no task can be computed.
    """
    rule = WidthRule(tasks.campaign, tasks.loaded.by.measure)
    ends = False
    for row in store.read_rows():
        if values := list_values(row, tasks.campaign):
            require_measure(tasks.loaded.by, values)
        ends = rule.take(row)
    if ends:
        return True
    progress(store.done, tasks.count)
    with (
        closing(_RowBuffer(store, clock)) as buffer,
        closing(compute(tasks.list_orders(store.done))) as outcomes,
    ):
        for new in tasks.make_rows(store.done, outcomes):
            buffer.add(new)
            if rule.take(new):
                return True
            progress(int(str(new["task"])) + 1, tasks.count)
    return False


class _RowBuffer:
    """Rows that wait to be kept together."""

    def __init__(self, store: CampaignStore, clock: Clock) -> None:
        self._store = store
        self._clock = clock
        self._rows: list[Row] = []
        self._begin_s = self._kept_s = clock.now_s()

    def add(self, row: Row) -> None:
        self._rows.append(row)
        now_s = self._clock.now_s()
        patience_s = max(_KEEP_S, _KEEP_SHARE * (now_s - self._begin_s))
        if len(self._rows) >= _KEEP_ROWS or now_s - self._kept_s >= patience_s:
            self.close()

    def close(self) -> None:
        """Keep the rows that wait."""
        rows, self._rows = self._rows, []
        if rows:
            self._store.append(rows)
        self._kept_s = self._clock.now_s()
