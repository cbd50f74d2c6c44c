"""`labrig check`: whether a protocol can run on a rig, before anything moves."""

from collections.abc import Sequence
from dataclasses import asdict

from labrig.cli.options import ProtocolArgument, RigOption, SeedOption, SetOption, find_runs_dir
from labrig.cli.output import (
    failure_document,
    print_json,
    print_line,
    print_problems,
    say,
    say_failure,
    say_page,
)
from labrig.errors import FileFormatError, InputError
from labrig.plugins import CAMERAS, DRIVES, EXPERIMENTS
from labrig.text import duration, format_count


def check(
    protocol: ProtocolArgument, rig: RigOption = None, seed: SeedOption = None, settings: SetOption = None
) -> int:
    """Exit with 0 when the protocol can run, 1 when the rig cannot do it, 2 when a file is malformed."""
    from labrig.library.checking import check_sources
    from labrig.library.plugin_faults import find_plugin_faults
    from labrig.library.sources import Sources

    faults = _report(find_plugin_faults(EXPERIMENTS))
    try:
        found = check_sources(Sources(protocol, rig, tuple(settings or ()), seed), find_runs_dir())
    except FileFormatError as error:
        say_failure(error)
        problems = [asdict(problem) for problem in error.problems]
        unknown = dict.fromkeys(("duration_s", "disk_bytes"))
        print_json({"ok": False, "problems": problems, **unknown, "plugins": faults})
        return error.exit_code
    if found.rig_name is not None:
        faults += _report(find_plugin_faults(DRIVES, CAMERAS))
    print_json({**found.document(), "plugins": faults})
    print_problems(found.problems)
    print_problems(found.warnings, "warning: ")
    takes, place = duration(found.plan.duration_s), f" on rig {found.rig_name}" if found.rig_name else ""
    figures = (
        f": {takes} of motion, {format_count(found.plan.operator_steps, 'operator step')}, "
        f"{format_count(found.plan.pictures, 'picture')}, {found.disk_bytes / 1e6:.0f} MB"
        if place
        else f"; it moves nothing, and computes about {takes} on two processors"
    )
    # A dry run that was refused has not come to its end.
    print_line(f"{protocol} can run{place}{figures}" if found.ok else f"{protocol} cannot run{place}")
    for age in found.calibration:
        print_line(f"{age.check}: {age.value}" + (f"; {age.solution}" if age.solution else ""))
    print_line(f"not checked here: {', '.join(found.left_to_run)}")
    if found.problems:
        say_page(found.problems)
    return 0 if found.ok else 1


def _report(faults: Sequence[InputError]) -> list[dict[str, object]]:
    """Say which plugins cannot be used, and return them for JSON; nothing else needs them."""
    for fault in faults:
        say(f"note: {fault.message}")
    return [failure_document(fault) for fault in faults]
