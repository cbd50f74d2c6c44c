"""Conducts a campaign: tasks go out, rows come back in order and are kept as they come, until the last or a rule."""

from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Protocol

from labrig.analysis.outcome import TaskOutcome
from labrig.campaign.statistics import WidthRule, require_measure
from labrig.campaign.store import CampaignStore
from labrig.campaign.tasks import CampaignTasks, Row, TaskOrder
from labrig.clock import Clock
from labrig.errors import LabrigError

_KEEP_S = 2.0
_KEEP_SHARE = 0.01
"""A row waits to be kept for at most so long, or this share of the time so far; a killed labrig computes it again."""
_KEEP_ROWS = 5000

Compute = Callable[[Iterable[TaskOrder]], Generator[TaskOutcome | LabrigError, None, None]]
"""Returns what comes of each task, in their order."""


class Watch(Protocol):
    """Whoever watches a campaign."""

    def note(self, done: int, of: int) -> None:
        """Take note of how many tasks are done; return when the campaign may go on, later if it is paused."""
        ...


@dataclass(frozen=True)
class CampaignEnd:
    """How far a campaign came: tasks that are done, and whether a rule ended it."""

    done: int
    by_rule: bool


def conduct_campaign(
    tasks: CampaignTasks, store: CampaignStore, compute: Compute, clock: Clock, watch: Watch
) -> CampaignEnd:
    """Compute the tasks that the store does not have, and keep their rows.

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
    watch : Watch
        Is told how far it is.

    Raises
    ------
    InputError
        When tasks do not have the quantity by which they are judged.
    DiskError, MachineError
        When rows cannot be kept, or no task can be computed.
    """
    _require_measure(tasks, store)
    rule = _WatchedRule.of(tasks)
    if rule.take_all(_list_rows(store)):
        return CampaignEnd(store.done, by_rule=True)
    done = store.done
    with closing(_RowBuffer(store, clock)) as buffer:
        watch.note(done, tasks.count)
        with closing(compute(tasks.list_orders(done))) as outcomes:
            for row in tasks.make_rows(done, outcomes):
                buffer.add(row)
                done += 1
                if rule.take(row):
                    return CampaignEnd(done, by_rule=True)
                watch.note(done, tasks.count)
    return CampaignEnd(done, by_rule=False)


def _require_measure(tasks: CampaignTasks, store: CampaignStore) -> None:
    """Refuse a measure that the rows that are kept do not have; rows of failures tell nothing."""
    known = [name for name in store.quantities if name not in tasks.campaign.varied_keys]
    if known:
        require_measure(tasks.loaded.by, dict.fromkeys(known))


def _list_rows(store: CampaignStore) -> Iterator[Row]:
    """Yield the rows that are kept, with None where there is no value."""
    for part in store.iter_parts():
        for row in part.astype(object).where(part.notna(), None).to_dict("records"):
            yield {str(name): value for name, value in row.items()}


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


class _WatchedRule:
    """The rule of a campaign, asked after each repetition of all arms; none, for a campaign without one."""

    def __init__(self, rule: WidthRule | None, round_tasks: int) -> None:
        self._rule = rule
        self._round_tasks = round_tasks
        self._taken = 0

    @classmethod
    def of(cls, tasks: CampaignTasks) -> "_WatchedRule":
        """Return the rule of a campaign."""
        campaign = tasks.campaign
        if campaign.stop_when is None:
            return cls(None, tasks.round_tasks)
        width = campaign.stop_when.ci95_width_mm
        return cls(WidthRule(width, campaign.first_look(), tasks.loaded.by.measure), tasks.round_tasks)

    def take(self, row: Row) -> bool:
        """Take a row, and return whether the campaign ends with it."""
        self._taken += 1
        if self._rule is None:
            return False
        self._rule.take(row)
        repetitions, rest = divmod(self._taken, self._round_tasks)
        return rest == 0 and self._rule.is_met(repetitions)

    def take_all(self, rows: Iterable[Row]) -> bool:
        """Take the rows that are kept, and return whether the last of them ended the campaign."""
        ends = False
        if self._rule is not None:
            for row in rows:
                ends = self.take(row)
        return ends
