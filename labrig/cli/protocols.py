"""`labrig check`: whether a protocol can run on a rig, before anything moves."""

from dataclasses import asdict

from labrig.cli.options import (
    ProtocolArgument,
    RigOption,
    SeedOption,
    SetOption,
    find_runs_dir,
)
from labrig.cli.output import (
    AsJson,
    failure_document,
    failure_lines,
    print_json,
    print_line,
    say,
)
from labrig.cli.plugin_faults import find_plugin_faults
from labrig.devices.clocks import SystemClock
from labrig.errors import FileFormatError, Problem
from labrig.plugins import CAMERAS, DRIVES, EXPERIMENTS


def check(
    protocol: ProtocolArgument,
    rig: RigOption = None,
    seed: SeedOption = None,
    settings: SetOption = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when the protocol can run, 1 when the rig cannot do it, 2 when a file is malformed."""
    from labrig.cli.check_report import collect_report, find_disk_problems, find_state_warnings, print_report
    from labrig.experiments.registry import find_experiment
    from labrig.library.sources import Sources
    from labrig.library.specimens import prepare_specimens
    from labrig.runner.dry_run import plan_run
    from labrig.runner.plan import count_needed_bytes, estimate_disk_bytes

    faults = _report_plugin_faults(EXPERIMENTS)
    try:
        loaded, description = Sources(protocol, rig, tuple(settings or ()), seed).load()
    except FileFormatError as error:
        if not as_json:
            raise
        for line in failure_lines(error):
            say(line)
        _print_check(error.problems, (), None, None, faults, {})
        return error.exit_code
    if description is not None:
        faults += _report_plugin_faults(DRIVES, CAMERAS)
    experiment = find_experiment(loaded.experiment)
    experiment.require_parts()
    now = SystemClock().utc()
    folder = find_runs_dir(None)
    specimens = prepare_specimens(loaded, description, folder, now)
    plan = plan_run(experiment, specimens.protocol, description)
    disk_bytes = estimate_disk_bytes(plan, description)
    problems = (
        *specimens.problems,
        *(plan.problems if plan.refusal is None else (plan.refusal,)),
        *find_disk_problems(folder, count_needed_bytes(plan, description)),
    )
    warnings = (*specimens.warnings, *plan.warnings, *find_state_warnings(description))
    report = collect_report(plan, disk_bytes, description, now)
    if as_json:
        _print_check(problems, warnings, plan.duration_s, disk_bytes, faults, report.document())
    else:
        _print_problems(problems)
        _print_problems(warnings, "warning: ")
        print_report(report, f"{protocol} {'cannot' if problems else 'can'} run")
    return 1 if problems else 0


def _print_problems(problems: tuple[Problem, ...], kind: str = "") -> None:
    for problem in problems:
        print_line(f"{kind}{problem.where}: {problem.message}")
        if problem.hint:
            print_line(f"  hint: {problem.hint}", 4)


def _report_plugin_faults(*groups: str) -> list[dict[str, object]]:
    """Report the plugins of these groups that cannot be used, and return them for JSON; nothing else needs them."""
    faults = list(find_plugin_faults(*groups))
    for fault in faults:
        say(f"note: {fault.message}")
    return [failure_document(fault) for fault in faults]


def _print_check(
    problems: tuple[Problem, ...],
    warnings: tuple[Problem, ...],
    duration_s: float | None,
    disk_bytes: int | None,
    plugins: list[dict[str, object]],
    report: dict[str, object],
) -> None:
    print_json(
        {
            "ok": not problems,
            "problems": [asdict(problem) for problem in problems],
            "warnings": [asdict(warning) for warning in warnings],
            "duration_s": duration_s,
            "disk_bytes": disk_bytes,
            "plugins": plugins,
            **report,
        }
    )
