"""Conducts a campaign: tasks go out, rows come back in order and are kept as they come, until the last or a rule."""

from collections.abc import Callable, Generator, Iterable
from contextlib import closing

from labrig.analysis.experiment import TaskOutcome
from labrig.campaign.statistics import WidthRule, require_measure
from labrig.campaign.store import CampaignStore
from labrig.campaign.tasks import CampaignTasks, TaskOrder, list_values
from labrig.errors import LabrigError

Compute = Callable[[Iterable[TaskOrder]], Generator[TaskOutcome | LabrigError, None, None]]
"""Returns what comes of each task, in their order."""
Progress = Callable[[int, int], None]
"""Told how many tasks are done, and how many there are."""


def conduct_campaign(
    tasks: CampaignTasks, store: CampaignStore, compute: Compute, progress: Progress
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
    with closing(compute(tasks.list_orders(store.done))) as outcomes:
        for new in tasks.make_rows(store.done, outcomes):
            store.append([new])
            if rule.take(new):
                return True
            progress(int(str(new["task"])) + 1, tasks.count)
    return False
