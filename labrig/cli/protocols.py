"""`labrig check` and `labrig schema`: what a protocol says, before anything moves."""

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import RigOption, SeedOption, SetOption, split_overrides
from labrig.cli.output import AsJson, failure_lines, plural, print_json, print_line, say, tell
from labrig.errors import FileFormatError, Problem


def check(
    protocol: Annotated[Path, typer.Argument(metavar="PROTOCOL", help="Protocol file (YAML).")],
    rig: RigOption = None,
    seed: SeedOption = None,
    settings: SetOption = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when it can run, 1 when this rig cannot do it, 2 when a file is malformed."""
    from labrig.cli.rigs import rig_for
    from labrig.experiments.declared import PROTOCOL_MODELS
    from labrig.experiments.registry import find_experiment
    from labrig.protocol.load import load_protocol
    from labrig.runner.plan import estimate

    protocol_settings, rig_settings = split_overrides(settings)
    try:
        loaded = load_protocol(protocol, PROTOCOL_MODELS, protocol_settings, seed)
        description = rig_for(loaded, protocol, rig, rig_settings)
    except FileFormatError as error:
        if not as_json:
            raise
        for line in failure_lines(error):
            say(line)
        _print_check(error.problems, None, None)
        return error.exit_code
    plan = find_experiment(loaded.experiment).plan(loaded, description)
    problems = plan.problems if plan.refusal is None else (plan.refusal,)
    needs = estimate(plan, description)
    if as_json:
        _print_check(problems, needs.duration_s, needs.disk_bytes)
    else:
        for problem in problems:
            tell(f"{problem.where}: {problem.message}")
            if problem.hint:
                tell(f"  hint: {problem.hint}", 4)
        verdict = "cannot run" if problems else "can run"
        where = "without a rig" if description is None else f"on rig {description.name}"
        tell(
            f"{protocol} {verdict} {where}: {needs.duration_s / 60:.0f} min of motion, "
            f"{plural(needs.operator_steps, 'operator step')}, {plural(needs.pictures, 'picture')}, "
            f"{needs.disk_bytes / 1e6:.0f} MB"
        )
    return 1 if problems else 0


def _print_check(problems: tuple[Problem, ...], duration_s: float | None, disk_bytes: int | None) -> None:
    print_json(
        {
            "ok": not problems,
            "problems": [asdict(problem) for problem in problems],
            "duration_s": duration_s,
            "disk_bytes": disk_bytes,
        }
    )


class Of(StrEnum):
    """Which schema."""

    PROTOCOL = "protocol"
    RIG = "rig"


def schema(
    of: Annotated[Of, typer.Argument(metavar="[protocol|rig]", help="Which files.")] = Of.PROTOCOL,
    as_json: AsJson = False,  # noqa: ARG001 - a schema is JSON either way
) -> None:
    """Print the schema; editors that know it complete and check the YAML files."""
    from labrig.experiments.declared import PROTOCOL_MODELS
    from labrig.protocol.load import protocol_schema
    from labrig.protocol.schema import schema_text

    if of is Of.PROTOCOL:
        print_line(schema_text(protocol_schema(PROTOCOL_MODELS)).rstrip())
        return
    from labrig.devices.rig_file import rig_schema

    print_line(schema_text(rig_schema()).rstrip())
