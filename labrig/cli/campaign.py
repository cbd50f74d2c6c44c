"""`labrig campaign`: repeats a protocol virtually, thousands of times, and writes one table and its page."""

from pathlib import Path
from typing import Annotated, Any

from typer import Option

from labrig.cli.options import CampaignArgument, WorkersOption
from labrig.cli.output import print_json, print_line, print_table, quote
from labrig.report.formatting import name_settings
from labrig.text import interval, number, split_quantity, tell_value


def campaign(
    file: CampaignArgument,
    settings: Annotated[
        list[str] | None,
        Option("--set", metavar="KEY=VALUE", help="Override a key, such as repetitions=5; repeatable."),
    ] = None,
    workers: WorkersOption = None,
    cluster: Annotated[
        str | None, Option(metavar="ADDRESS", help="Workers of a dask scheduler (tcp://HOST:PORT).")
    ] = None,
    out: Annotated[
        Path | None, Option(metavar="DIR", help="Its folder, new or begun. Default: data/campaigns/NAME.")
    ] = None,
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
    result = done.result
    mean, ci95 = ("mean_error_mm", "ci95_mm") if result.measure.endswith("error_mm") else ("mean", "ci95")
    arms = [
        {**arm.model_dump(mode="json", exclude={"mean", "ci95"}), mean: arm.mean, ci95: arm.ci95}
        for arm in result.arms
    ]
    print_json({
        "campaign": str(done.path),
        "name": result.campaign,
        "report": str(done.report),
        "arms": arms,
        **result.model_dump(mode="json", exclude={"arms", "campaign"}),
    })  # fmt: skip
    _print(done)
    return 0 if result.failed < result.done else 1


def _print(campaign: Any) -> None:
    result = campaign.result
    rows = []
    for arm in result.arms:
        share = None if arm.share_ci95 is None else [100 * limit for limit in arm.share_ci95]
        within = "-" if share is None else f"{arm.within_tolerance} of {arm.tasks - arm.failed}"
        mean = (arm.n, number(arm.mean, 2), interval(arm.ci95), number(arm.median, 2))
        rows.append((name_settings(arm.name), within, interval(share, 1), *mean))
    quote(campaign.report)
    if len(rows) > 1:  # the result tells a single one
        unit = split_quantity(result.measure)[1] or ""
        told = "" if result.tolerance is None else tell_value(result.tolerance, result.measure)
        columns = ("arm", f"within {told}", "95 % interval %", "n")
        heads = (*columns, f"mean {unit}", "95 % interval", f"median {unit}")
        print_table(heads, rows)
    print_line(f"table   {campaign.table}\nreport  {campaign.report}")
