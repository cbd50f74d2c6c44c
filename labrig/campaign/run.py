"""Runs a campaign: reads its files, computes what is left of it, writes its table and its page."""

import os
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from labrig.analysis.experiment import TaskOutcome
from labrig.campaign.campaign_file import load_campaign_file
from labrig.campaign.inputs import CampaignFiles, LoadedCampaign, load_campaign
from labrig.campaign.page import write_page
from labrig.campaign.result import CampaignResult, make_result
from labrig.campaign.statistics import WidthRule, require_measure
from labrig.campaign.store import CampaignStore
from labrig.campaign.tasks import CampaignTasks, TaskOrder, describe_campaign, list_values, plan_campaign
from labrig.devices.clocks import SystemClock
from labrig.errors import LabrigError

Compute = Callable[[Iterable[TaskOrder]], Generator[TaskOutcome | LabrigError, None, None]]
"""Returns what comes of each task, in their order."""
Progress = Callable[[int, int], None]
"""Told how many tasks are done, and how many there are."""


@dataclass(frozen=True)
class Campaign:
    """A campaign in its folder: what it found, its table, and its page."""

    path: Path
    result: CampaignResult
    table: Path
    report: Path


def load_campaign_files(
    file: Path,
    find_rig: Callable[[Path | None, Path], Path],
    *,
    settings: Sequence[str] = (),
    rig: Path | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> LoadedCampaign:
    """Read a campaign and all that it names, relative to its own folder.

    Parameters
    ----------
    find_rig : callable
        Returns the rig file for the one that is named, if any, and the protocol.
    settings : sequence of str
        `key=value` each; they replace values of the campaign file.
    rig : Path or None
        Takes the place of the rig that the file names.
    progress : callable
        Told the share of the arms that was read.

    Raises
    ------
    FileFormatError, InputError
        When something cannot be used.
    """
    content = load_campaign_file(file, settings)
    base = _resolve(file, content.base)
    named = rig if content.rig is None or rig is not None else _resolve(file, content.rig)
    return load_campaign(CampaignFiles(file, base, lambda: find_rig(named, base)), content, progress)


def _resolve(file: Path, name: str) -> Path:
    """Return a file that a campaign file names, relative to the working folder as that is."""
    return Path(os.path.normpath(file.parent / name))


def open_store(loaded: LoadedCampaign, folder: Path) -> CampaignStore:
    """Begin a campaign in a folder, or go on with it; raises as `CampaignStore.open`."""
    return CampaignStore.open(folder, describe_campaign(loaded), plan_campaign(loaded))


def compute_campaign(
    loaded: LoadedCampaign, store: CampaignStore, compute: Compute, progress: Progress
) -> None:
    """Compute the tasks that the store does not have, until the last or a rule, and keep their rows as they come.

    Rows come back in order. However it ends, those that came until then are kept, and the campaign can go on.

    Parameters
    ----------
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
    tasks, rule = CampaignTasks(loaded), WidthRule(loaded.file, loaded.by.measure)
    ends = False
    for row in store.read_rows():
        if values := list_values(row, loaded.file):
            require_measure(loaded.by, values)
        ends = rule.take(row)
    progress(store.done, tasks.count)
    if not ends:
        with closing(compute(tasks.list_orders(store.done))) as outcomes:
            for new in tasks.make_rows(store.done, outcomes):
                store.append([new])
                if ends := rule.take(new):
                    break
                progress(store.done, tasks.count)
    if ends:
        store.note_end()


def write_report(loaded: LoadedCampaign, store: CampaignStore) -> Campaign:
    """Write the table and the page of the tasks that are done. Raises `DiskError`, `RecordError`."""
    table = store.write_table()
    result = make_result(
        loaded, table, tasks=CampaignTasks(loaded).count, file=store.table_file, by_rule=store.ended_by_rule
    )
    report = write_page(store.folder, loaded, result, table, SystemClock().utc())
    return Campaign(store.folder, result, store.table_file, report)
