"""`labrig campaign`: repeats a protocol virtually, thousands of times, and writes one table and its page."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from labrig.cli.options import CampaignArgument, find_rig_file
from labrig.cli.output import AsJson, print_json, print_line, print_table, say
from labrig.cli.progress import Reporter, progress, progress_if_slow
from labrig.clock import Clock
from labrig.devices.clocks import SystemClock
from labrig.errors import DiskError, InputError
from labrig.lab.folder import CAMPAIGNS, find_in_lab
from labrig.posix import count_usable_cores
from labrig.runner.run_control import RunControl
from labrig.text import interval, number

if TYPE_CHECKING:
    from labrig.analysis.engine import Pool
    from labrig.campaign.campaign_file import CampaignFile
    from labrig.campaign.inputs import LoadedCampaign
    from labrig.campaign.result import CampaignResult
    from labrig.campaign.store import CampaignStore

_LOOK_S = 0.2
"""How often a campaign that is paused looks for a request to continue."""


def campaign(
    file: CampaignArgument = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig",
            metavar="FILE",
            help="Simulated rig. Default: the campaign's own, else as for labrig run.",
            show_default=False,
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, max=1000, help="Processes. Default: one for each core.", show_default=False),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Workers of a dask scheduler (tcp://HOST:PORT), or of a dask-jobqueue file.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        str | None,
        typer.Option(
            metavar="DIR",
            help="Folder or URL of the table; one that was begun is gone on with. Default: data/campaigns/NAME.",
            show_default=False,
        ),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when the campaign is done. Started again, it goes on; Ctrl+C ends it with what is done."""
    if file is None:
        raise InputError("no campaign is named", "for example labrig campaign campaign-replanning")
    if workers is not None and cluster is not None:
        raise InputError("--workers and --cluster exclude each other", "a cluster has its own workers")
    loaded = _load(file, rig)
    place = str(find_in_lab(CAMPAIGNS) / loaded.file.campaign) if out is None else out
    from labrig.campaign.store import CampaignStore
    from labrig.campaign.tasks import describe_campaign

    with CampaignStore.open(place, describe_campaign(loaded)) as store:
        result = _conduct(loaded, store, workers, cluster)
        table = store.read()
    folder = _choose_page_folder(place, loaded.file)
    report = _write_page(folder, loaded, result, table)
    _print(result, place, report, as_json=as_json)
    return 0 if result.failed < result.done else 1


def _load(file: Path, rig: Path | None) -> "LoadedCampaign":
    """Read a campaign and all that it names. Raises `FileFormatError`, `InputError`."""
    from labrig.campaign.campaign_file import load_campaign_file
    from labrig.campaign.inputs import CampaignFiles, load_campaign

    content = load_campaign_file(file)
    base = _resolve(file, content.base)
    named = rig if content.rig is None or rig is not None else _resolve(file, content.rig)
    files = CampaignFiles(file, base, lambda: find_rig_file(named, base))
    with progress_if_slow("reading the arms", SystemClock(), shown=True) as report:
        return load_campaign(files, content, report)


def _resolve(file: Path, name: str) -> Path:
    """Return a file that a campaign file names, relative to the working folder as that is."""
    return Path(os.path.normpath(file.parent / name))


def _conduct(
    loaded: "LoadedCampaign", store: "CampaignStore", workers: int | None, cluster: str | None
) -> "CampaignResult":
    """Compute what is left of a campaign, and return what its table says."""
    from labrig.analysis.engine import run_in_order
    from labrig.campaign.conduct import conduct_campaign
    from labrig.campaign.result import make_result
    from labrig.campaign.tasks import CampaignTasks, compute_task

    tasks, clock = CampaignTasks(loaded), SystemClock()
    if store.done:
        say(f"{store.place}: {store.done} of {tasks.count} tasks are done; the campaign goes on behind them")
    with (
        _open_pool(workers, cluster) as pool,
        progress(loaded.file.campaign, float(max(1, tasks.count - store.done))) as reporter,
        _take_requests(store) as control,
    ):
        watch = _Watch(reporter, control, clock, store.done)
        end = conduct_campaign(
            tasks, store, lambda orders: run_in_order(pool, compute_task, orders, clock=clock), clock, watch
        )
    return make_result(loaded, store.read(), tasks=tasks.count, by_rule=end.by_rule)


@contextmanager
def _open_pool(workers: int | None, cluster: str | None) -> Iterator["Pool"]:
    from labrig.analysis.engine import open_process_pool

    work = "computed tasks"
    if cluster is None:
        with open_process_pool(workers or count_usable_cores(), work) as pool:
            yield pool
        return
    from labrig.cli.missing_package import require_package

    require_package("distributed", "dask", "--cluster")
    from labrig.analysis.cluster import open_cluster

    with open_cluster(cluster, work) as pool:
        yield pool


@contextmanager
def _take_requests(store: "CampaignStore") -> Iterator[RunControl | None]:
    """Take requests to pause from other terminals; none at a URL, or where no socket can be made."""
    from labrig.record.urls import is_url

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


def _choose_page_folder(place: str, file: "CampaignFile") -> Path:
    """Return the folder of the page: that of the table, or one of this computer for a table at a URL."""
    from labrig.record.urls import is_url

    return find_in_lab(CAMPAIGNS) / file.campaign if is_url(place) else Path(place)


def _write_page(folder: Path, loaded: "LoadedCampaign", result: "CampaignResult", table: Any) -> Path:
    from labrig.campaign.page import write_page

    say("writing the report")
    return write_page(folder, loaded, result, table, SystemClock().utc())


def _print(result: "CampaignResult", place: str, report: Path, *, as_json: bool) -> None:
    if as_json:
        print_json(_make_document(result, place, report))
        return
    judged = result.tolerance is not None
    heads = (
        "arm",
        "tasks",
        "failed",
        *(("within", "share %", "95 %") if judged else ()),
        "mean",
        "95 %",
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
        mean = (number(arm.mean), interval(arm.ci95, 3), number(arm.median))
        rows.append((arm.name, arm.tasks, arm.failed, *(within if judged else ()), *mean))
    tolerance = f", within {result.tolerance:g}" if judged else ""
    print_line(f"{result.campaign}: {result.measure}{tolerance}")
    print_table(heads, rows)
    for failure in result.failures[:3]:
        say(f"note: {failure.tasks} tasks failed, task {failure.first} first: {failure.error}")
    print_line(f"table   {place}\nreport  {report}")


def _make_document(result: "CampaignResult", place: str, report: Path) -> Mapping[str, Any]:
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
        "campaign": place,
        "name": result.campaign,
        "table": place,
        "report": str(report),
        "arms": arms,
        **whole,
    }
