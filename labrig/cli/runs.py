"""`labrig runs`: the folder of runs as a catalogue; without a further word it lists them."""

import typer

from labrig.cli import checking
from labrig.cli.options import DEFAULT_RUNS_DIR, RunsDirOption
from labrig.cli.output import AsJson, print_json, print_table, say

app = typer.Typer(help="List the runs, newest first.", invoke_without_command=True)
checking.register(app)


@app.callback()
def list_(
    context: typer.Context,
    runs_dir: RunsDirOption = DEFAULT_RUNS_DIR,
    as_json: AsJson = False,
) -> None:
    """List every run of a folder, damaged ones too."""
    if context.invoked_subcommand is not None:
        return
    from dataclasses import asdict

    from labrig.record import list_runs

    found = list_runs(runs_dir)
    if as_json:
        print_json([{**asdict(summary), "run": str(summary.run)} for summary in found])
        return
    if not found:
        say(f"no runs in {runs_dir}; make the first with: labrig run protocols/steerability.yaml")
        return
    rows = [
        [
            summary.run.name,
            summary.protocol,
            summary.exit_status,
            f"{summary.trials_done} of {summary.trials_planned}" if summary.trials_planned else None,
        ]
        for summary in found
    ]
    print_table(("run", "experiment", "exit status", "trials"), rows)
