"""A campaign by one call; apart from the door, since a run does not wait for what only campaigns need."""

from collections.abc import Sequence
from pathlib import Path

from labrig.analysis.engine import run_in_order
from labrig.campaign.run import Campaign, compute_campaign, load_campaign_files, open_store
from labrig.campaign.run import write_report as write_campaign
from labrig.campaign.tasks import CampaignTasks, compute_task
from labrig.errors import WorkersError
from labrig.lab import CAMPAIGNS, find_in_lab
from labrig.library.names import find_protocol_file, find_rig_file
from labrig.library.pools import open_pool
from labrig.runner.attendant import Attendant
from labrig.text import format_count

_SILENT = Attendant()


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
    workers, cluster
        As for `open_pool`.

    Raises
    ------
    FileFormatError, InputError
        When something cannot be used.
    DiskError, MachineError
        When it cannot go on; what is done stays done.
    """
    with attendant.progress("reading the arms", 1.0) as progress:
        loaded = load_campaign_files(
            find_protocol_file(Path(file), is_campaign=True),
            find_rig_file,
            settings=settings,
            rig=None if rig is None else Path(rig),
            progress=lambda share: progress(share, "arms"),
        )
    folder = find_in_lab(CAMPAIGNS) / loaded.file.campaign if out is None else Path(out)
    with (
        open_pool(workers, cluster, "computed tasks", attendant.say) as pool,
        open_store(loaded, folder) as store,
    ):
        begin, count = store.done, CampaignTasks(loaded).count
        if store.change and begin:
            attendant.say(f"note: the first rows were {store.change}; last digits may differ")
        if begin == count or store.ended_by_rule:
            attendant.say(
                f"{folder}: the campaign has ended with {format_count(begin, 'task')}; nothing is left to do"
            )
        elif begin:
            attendant.say(f"{folder}: {begin} of {count} tasks are done; the campaign goes on behind them")
        try:
            with attendant.progress(loaded.file.campaign, float(max(1, count - begin))) as tell:
                compute_campaign(
                    loaded,
                    store,
                    lambda orders: run_in_order(pool, compute_task, orders),
                    lambda done, of: tell(float(done - begin), f"{done} of {of} tasks"),
                )
        except (KeyboardInterrupt, WorkersError):
            attendant.say(f"{store.done} of {count} tasks are done; the same command goes on behind them")
            if store.done:
                attendant.say(f"report  {write_campaign(loaded, store).report}")
            raise
        attendant.say("writing the report")
        return write_campaign(loaded, store)
