"""The work of `labrig campaign`: reads the files, computes what is left, writes table and page, prints them."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrig.analysis.engine import run_in_order
from labrig.campaign.campaign_file import load_campaign_file
from labrig.campaign.conduct import conduct_campaign
from labrig.campaign.inputs import CampaignFiles, LoadedCampaign, load_campaign
from labrig.campaign.page import require_own_page, write_page
from labrig.campaign.result import CampaignResult, make_result
from labrig.campaign.store import CampaignStore
from labrig.campaign.tasks import CampaignTasks, compute_task, describe_campaign, plan_campaign
from labrig.cli.options import find_rig_file
from labrig.cli.output import print_json, print_line, print_table, say
from labrig.cli.progress import Reporter, progress, progress_if_slow
from labrig.cli.signals import Interruption
from labrig.cli.worker_pool import open_pool
from labrig.clock import Clock
from labrig.devices.clocks import SystemClock
from labrig.durable import disk_errors
from labrig.errors import DiskError, WorkersError
from labrig.lab.folder import CAMPAIGNS, find_in_lab
from labrig.record.urls import is_url, restore_url
from labrig.runner.run_control import RunControl
from labrig.text import format_count, interval, number

_LOOK_S = 0.2
"""How often a campaign that is paused looks for a request to continue."""


@dataclass(frozen=True)
class CampaignOrder:
    """What was typed: file, overrides, rig, processes or cluster, and where the table goes; None: not given."""

    file: Path
    settings: tuple[str, ...]
    rig: Path | None
    workers: int | None
    cluster: str | None
    out: str | None


def carry_out(order: CampaignOrder, *, as_json: bool) -> int:
    """Compute a campaign, write its table and page, print what it found, and return the exit code.

    Raises
    ------
    InputError, DiskError, MachineError
        When it cannot begin or go on; what is done stays done.
    """
    loaded = _load(order)
    place = str(find_in_lab(CAMPAIGNS) / loaded.file.campaign) if order.out is None else order.out
    page = _find_page_folder(place, loaded.file.campaign)
    with CampaignStore.open(place, describe_campaign(loaded), plan_campaign(loaded)) as store:
        if store.change and store.done:
            say(f"note: the first rows were {store.change}; last digits may differ")
        try:
            by_rule = _conduct(loaded, store, order)
        except (Interruption, WorkersError):
            if store.done:
                _, report = _write_report(loaded, store, page, by_rule=False)
                say(f"report  {report}")
            raise
        if by_rule:
            store.note_end()
        result, report = _write_report(loaded, store, page, by_rule=by_rule)
    _print(result, report, as_json=as_json)
    return 0 if result.failed < result.done else 1


def _write_report(
    loaded: LoadedCampaign, store: CampaignStore, folder: Path, *, by_rule: bool
) -> tuple[CampaignResult, Path]:
    """Write the page of the tasks that are done, and return what it says and where it is."""
    say("writing the report")
    table = store.read()
    tasks = CampaignTasks(loaded).count
    result = make_result(loaded, table, tasks=tasks, place=store.place, by_rule=by_rule)
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return result, write_page(folder, loaded, result, table, SystemClock().utc())


def _find_page_folder(place: str, name: str) -> Path:
    """Return the folder of the page: that of the table, or one of this computer for a table at a URL.

    Raises
    ------
    OutputExistsError
        When that folder holds anything but the page of the table.
    """
    if not is_url(place):
        return Path(place)
    folder = find_in_lab(CAMPAIGNS) / name
    require_own_page(folder, restore_url(place).rstrip("/"))
    return folder


def _load(order: CampaignOrder) -> LoadedCampaign:
    """Read a campaign and all that it names. Raises `FileFormatError`, `InputError`."""
    file, rig = order.file, order.rig
    content = load_campaign_file(file, order.settings)
    base = _resolve(file, content.base)
    named = rig if content.rig is None or rig is not None else _resolve(file, content.rig)
    files = CampaignFiles(file, base, lambda: find_rig_file(named, base))
    with progress_if_slow("reading the arms", SystemClock(), shown=True) as report:
        return load_campaign(files, content, report)


def _resolve(file: Path, name: str) -> Path:
    """Return a file that a campaign file names, relative to the working folder as that is."""
    return Path(os.path.normpath(file.parent / name))


def _conduct(loaded: LoadedCampaign, store: CampaignStore, order: CampaignOrder) -> bool:
    """Compute what is left of a campaign, and return whether its rule ended it."""
    tasks, clock = CampaignTasks(loaded), SystemClock()
    if store.torn is not None:
        say(f"note: {store.place}/{store.torn} was cut short; its tasks are computed again")
    if store.done == tasks.count or store.ended_by_rule:
        say(
            f"{store.place}: the campaign has ended with {format_count(store.done, 'task')}; nothing is left to do"
        )
    elif store.done:
        say(f"{store.place}: {store.done} of {tasks.count} tasks are done; the campaign goes on behind them")
    with (
        open_pool(order.workers, order.cluster, "computed tasks") as pool,
        progress(loaded.file.campaign, float(max(1, tasks.count - store.done))) as reporter,
        _take_requests(store) as control,
    ):
        watch = _Watch(reporter, control, clock, store.done)
        try:
            end = conduct_campaign(
                tasks,
                store,
                lambda orders: run_in_order(pool, compute_task, orders, clock=clock),
                clock,
                watch,
            )
        except (Interruption, WorkersError):
            say(f"{store.done} of {tasks.count} tasks are done; the same command goes on behind them")
            raise
    return end.by_rule


@contextmanager
def _take_requests(store: CampaignStore) -> Iterator[RunControl | None]:
    """Take requests to pause from other terminals; none at a URL, or where no socket can be made."""
    try:
        control = None if is_url(store.place) else RunControl(Path(store.place))
    except DiskError as error:
        say(f"note: labrig pause cannot reach this campaign: {error.message}")
        control = None
    try:
        yield control
    finally:
        if control is not None:
            control.close()


class _Watch:
    """Shows how far a campaign is, and holds it while it is paused."""

    def __init__(self, reporter: Reporter, control: RunControl | None, clock: Clock, begin: int) -> None:
        self._reporter = reporter
        self._control = control
        self._clock = clock
        self._begin = begin

    def note(self, done: int, of: int) -> None:
        """Show it; while the campaign is paused, wait."""
        self._reporter(float(done - self._begin), f"{done} of {of} tasks")
        control = self._control
        if control is None:
            return
        control.poll("after the tasks at hand", paused=False)
        if control.asks_for_pause:
            control.meet()
            say("labrig pause: the campaign is paused; labrig continue goes on")
            while not control.asks_to_continue:
                self._clock.sleep(_LOOK_S)
                control.poll("", paused=True)
            control.meet()
            say("labrig continue: the campaign goes on")


def _print(result: CampaignResult, report: Path, *, as_json: bool) -> None:
    if as_json:
        print_json(_make_document(result, report))
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
    print_line(f"table   {result.table}\nreport  {report}")


def _make_document(result: CampaignResult, report: Path) -> Mapping[str, Any]:
    mean, ci95 = ("mean_error_mm", "ci95_mm") if result.measure.endswith("error_mm") else ("mean", "ci95")
    arms = [
        {
            **arm.model_dump(mode="json", exclude={"mean", "ci95"}),
            mean: arm.mean,
            ci95: arm.ci95,
        }
        for arm in result.arms
    ]
    whole = result.model_dump(mode="json", exclude={"arms", "settling", "campaign"})
    return {
        "campaign": result.table,
        "name": result.campaign,
        "report": str(report),
        "arms": arms,
        **whole,
    }
