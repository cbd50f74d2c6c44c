"""`labrig campaign`: repeats a protocol virtually, thousands of times, and writes one table and its page."""

from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import CampaignArgument, ClusterOption, WorkersOption
from labrig.cli.output import AsJson


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
    from labrig.cli.worker_pool import require_one_pool

    require_one_pool(workers, cluster)
    from labrig.cli.campaign_run import CampaignOrder, carry_out

    return carry_out(CampaignOrder(file, tuple(settings or ()), workers, cluster, out), as_json=as_json)
