"""`labrig check`: whether a protocol can run on a rig, before anything moves."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

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
        told = [asdict(problem) for problem in error.problems]
        print_json({"ok": False, "problems": told, "duration_s": None, "disk_bytes": None, "plugins": faults})
        return error.exit_code
    if found.rig is not None:
        faults += _report(find_plugin_faults(DRIVES, CAMERAS))
    print_json({**found.document(), "plugins": faults})
    print_problems(found.problems)
    print_problems(found.warnings, "warning: ")
    place = f" on rig {found.rig.name}" if found.rig else ""
    # A dry run that was refused has not come to its end.
    doubt = ", but see the warning" * bool(found.warnings)
    needs = f" can run{place}{doubt}{_tell_needs(found.plan, found.rig, found.disk_bytes)}"
    print_line(f"{protocol}{needs}" if found.ok else f"{protocol} cannot run{place}; mend it and try again")
    for age in found.calibration:
        print_line(f"{age.check}: {age.value}" + (f"; {age.solution}" if age.solution else ""))
    if found.ok:
        print_line(f"not checked here: {', '.join(found.left_to_run)}")
    if found.problems:
        say_page(found.problems)
    return 0 if found.ok else 1


def _tell_needs(plan: Any, rig: Any, disk_bytes: int) -> str:
    """Return what a run takes: on a simulated rig that asks nobody, less time than its motion."""
    if rig is None:
        return f"; it moves nothing, and computes about {duration(plan.duration_s)} on two processors"
    motion = f"{duration(plan.duration_s)} of motion, {format_count(plan.operator_steps, 'question')}"
    held = f"{format_count(plan.pictures, 'picture')}, {disk_bytes / 1e6:.0f} MB"
    # The examples on two processors take so long, to a factor of two.
    simulated = f"about {duration(float(f'{10 + 0.12 * plan.pictures:.1g}'))}"
    return f": {motion}, {held}" if rig.asks_person else f": {simulated}, {held}; on a bench {motion}"


def _report(faults: Sequence[InputError]) -> list[dict[str, object]]:
    """Say which plugins cannot be used, and return them for JSON; nothing else needs them."""
    for fault in faults:
        say(f"note: {fault.message}")
    return [failure_document(fault) for fault in faults]
