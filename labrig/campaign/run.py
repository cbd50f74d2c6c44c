"""Runs a campaign: reads its files, computes what is left of it, writes its table and its page."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from labrig.analysis.engine import Pool, run_in_order
from labrig.campaign.campaign_file import load_campaign_file
from labrig.campaign.conduct import Progress, conduct_campaign
from labrig.campaign.inputs import CampaignFiles, LoadedCampaign, load_campaign
from labrig.campaign.page import write_page
from labrig.campaign.result import CampaignResult, make_result
from labrig.campaign.store import CampaignStore
from labrig.campaign.tasks import CampaignTasks, compute_task, describe_campaign, plan_campaign
from labrig.devices.clocks import SystemClock


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
    loaded: LoadedCampaign,
    store: CampaignStore,
    pool: Pool,
    *,
    progress: Progress = lambda _done, _of: None,
) -> None:
    """Compute what is left of a campaign.

    Raises
    ------
    InputError, DiskError, MachineError
        When it cannot go on; what is done stays done.
    """
    by_rule = conduct_campaign(
        CampaignTasks(loaded),
        store,
        lambda orders: run_in_order(pool, compute_task, orders),
        progress,
    )
    if by_rule:
        store.note_end()


def write_report(loaded: LoadedCampaign, store: CampaignStore) -> Campaign:
    """Write the table and the page of the tasks that are done. Raises `DiskError`, `RecordError`."""
    table = store.write_table()
    result = make_result(
        loaded, table, tasks=CampaignTasks(loaded).count, file=store.table_file, by_rule=store.ended_by_rule
    )
    report = write_page(store.folder, loaded, result, table, SystemClock().utc())
    return Campaign(store.folder, result, store.table_file, report)
