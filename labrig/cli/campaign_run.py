"""The work of `labrig campaign`: computes what is left, writes table and page, prints them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrig.campaign.inputs import LoadedCampaign
from labrig.campaign.run import Campaign, compute_campaign, load_campaign_files, open_store, write_report
from labrig.campaign.store import CampaignStore
from labrig.campaign.tasks import CampaignTasks
from labrig.cli.output import print_json, print_line, print_table, say
from labrig.cli.progress import progress, show_working
from labrig.cli.signals import Interruption
from labrig.cli.worker_pool import open_pool
from labrig.errors import WorkersError
from labrig.lab import CAMPAIGNS, find_in_lab
from labrig.library.names import find_rig_file
from labrig.text import format_count, interval, number


@dataclass(frozen=True)
class CampaignOrder:
    """What was typed: file, overrides, processes or cluster, and the folder; None: not given."""

    file: Path
    settings: tuple[str, ...]
    workers: int | None
    cluster: str | None
    out: Path | None


def carry_out(order: CampaignOrder, *, as_json: bool) -> int:
    """Compute a campaign, write its table and page, print what it found, and return the exit code.

    Raises
    ------
    InputError, DiskError, MachineError
        When it cannot begin or go on; what is done stays done.
    """
    with show_working("reading the arms"):
        loaded = load_campaign_files(order.file, find_rig_file, settings=order.settings)
    folder = find_in_lab(CAMPAIGNS) / loaded.file.campaign if order.out is None else order.out
    with open_store(loaded, folder) as store:
        try:
            _compute(loaded, store, order)
        except (Interruption, WorkersError):
            say(
                f"{store.done} of {CampaignTasks(loaded).count} tasks are done; the same command goes on behind them"
            )
            if store.done:
                say(f"report  {write_report(loaded, store).report}")
            raise
        say("writing the report")
        campaign = write_report(loaded, store)
    _print(campaign, as_json=as_json)
    return 0 if campaign.result.failed < campaign.result.done else 1


def _compute(loaded: LoadedCampaign, store: CampaignStore, order: CampaignOrder) -> None:
    """Compute what is left of a campaign, and say what is done of it already."""
    begin, count = store.done, CampaignTasks(loaded).count
    if store.change and begin:
        say(f"note: the first rows were {store.change}; last digits may differ")
    if begin == count or store.ended_by_rule:
        say(
            f"{store.folder}: the campaign has ended with {format_count(begin, 'task')}; nothing is left to do"
        )
    elif begin:
        say(f"{store.folder}: {begin} of {count} tasks are done; the campaign goes on behind them")
    with (
        open_pool(order.workers, order.cluster, "computed tasks") as pool,
        progress(loaded.file.campaign, float(max(1, count - begin))) as reporter,
    ):
        compute_campaign(
            loaded,
            store,
            pool,
            progress=lambda done, of: reporter(float(done - begin), f"{done} of {of} tasks"),
        )


def _print(campaign: Campaign, *, as_json: bool) -> None:
    result = campaign.result
    if as_json:
        print_json(_make_document(campaign))
        return
    judged = result.tolerance is not None
    heads = (
        "arm",
        "tasks",
        "failed",
        *(("within", "share %", "95 %") if judged else ()),
        "mean",
        "95 %",
        "SD",
        "median",
    )
    rows = []
    for arm in result.arms:
        share = arm.share_ci95
        within = (
            arm.within_tolerance,
            number(None if arm.share is None else 100 * arm.share, 1),
            interval(None if share is None else [100 * limit for limit in share], 1),
        )
        mean = (number(arm.mean), interval(arm.ci95, 3), number(arm.sd), number(arm.median))
        rows.append((arm.name, arm.tasks, arm.failed, *(within if judged else ()), *mean))
    tolerance = f", within {result.tolerance:g}" if judged else ""
    print_line(f"{result.campaign}: {result.measure}{tolerance}")
    print_table(heads, rows)
    for failure in result.failures[:3]:
        count = format_count(failure.tasks, "task")
        say(f"note: {count} failed, task {failure.first} first: {failure.error}")
    print_line(f"table   {campaign.table}\nreport  {campaign.report}")


def _make_document(campaign: Campaign) -> Mapping[str, Any]:
    result = campaign.result
    mean, ci95 = ("mean_error_mm", "ci95_mm") if result.measure.endswith("error_mm") else ("mean", "ci95")
    arms = [
        {
            **arm.model_dump(mode="json", exclude={"mean", "ci95"}),
            mean: arm.mean,
            ci95: arm.ci95,
        }
        for arm in result.arms
    ]
    whole = result.model_dump(mode="json", exclude={"arms", "campaign"})
    return {
        "campaign": str(campaign.path),
        "name": result.campaign,
        "report": str(campaign.report),
        "arms": arms,
        **whole,
    }
