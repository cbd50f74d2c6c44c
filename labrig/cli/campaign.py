"""`labrig campaign`: repeats a protocol virtually, thousands of times, and writes one table and its page."""

from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.options import CampaignArgument, ClusterOption, WorkersOption
from labrig.cli.output import AsJson, print_json, print_line, print_table, say
from labrig.text import format_count, interval, number


def campaign(
    file: CampaignArgument,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override a key of the campaign file, such as repetitions=5; repeatable.",
        ),
    ] = None,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the campaign; one that was begun is gone on with. Default: data/campaigns/NAME.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when the campaign is done. Started again, it goes on; Ctrl+C ends it with what is done."""
    from labrig.campaign.run import run_campaign
    from labrig.cli.attendant import TerminalAttendant

    done = run_campaign(
        file,
        out=out,
        settings=settings or (),
        workers=workers,
        cluster=cluster,
        attendant=TerminalAttendant(),
    )
    if as_json:
        print_json(_make_document(done))
    else:
        _print(done)
    return 0 if done.result.failed < done.result.done else 1


def _print(campaign: Any) -> None:
    result, is_judged = campaign.result, campaign.result.tolerance is not None
    rows = []
    for arm in result.arms:
        share = None if arm.share_ci95 is None else [100 * limit for limit in arm.share_ci95]
        percent = number(None if arm.share is None else 100 * arm.share, 1)
        within = (arm.within_tolerance, percent, interval(share, 1)) if is_judged else ()
        mean = (number(arm.mean), interval(arm.ci95, 3), number(arm.sd), number(arm.median))
        rows.append((arm.name, arm.tasks, arm.failed, *within, *mean))
    print_line(
        f"{result.campaign}: {result.measure}" + (f", within {result.tolerance:g}" if is_judged else "")
    )
    within_heads = ("within", "share %", "95 %") if is_judged else ()
    print_table(("arm", "tasks", "failed", *within_heads, "mean", "95 %", "SD", "median"), rows)
    for failure in result.failures[:3]:
        count = format_count(failure.tasks, "task")
        say(f"note: {count} failed, task {failure.first} first: {failure.error}")
    print_line(f"table   {campaign.table}\nreport  {campaign.report}")


def _make_document(campaign: Any) -> dict[str, Any]:
    result = campaign.result
    mean, ci95 = ("mean_error_mm", "ci95_mm") if result.measure.endswith("error_mm") else ("mean", "ci95")
    arms = [
        {**arm.model_dump(mode="json", exclude={"mean", "ci95"}), mean: arm.mean, ci95: arm.ci95}
        for arm in result.arms
    ]
    return {
        "campaign": str(campaign.path),
        "name": result.campaign,
        "report": str(campaign.report),
        "arms": arms,
        **result.model_dump(mode="json", exclude={"arms", "campaign"}),
    }
