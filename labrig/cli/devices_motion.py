"""`labrig devices home|jog|withdraw`: commission a rig axis by axis, and withdraw a needle from tissue."""

import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from labrig.cli.options import RigOption, YesOption, find_runs_dir
from labrig.cli.output import (
    AsJson,
    failure_document,
    failure_lines,
    print_checks,
    print_json,
    print_line,
    say,
)
from labrig.errors import InputError, InterruptedRunError, SafetyStopError, WireError
from labrig.library.names import find_rig_file

_NAMES = "insertion, rotation or linear"
_LEAST_MA, _GENTLE_MA = 50, 1000

CurrentOption = Annotated[
    int,
    typer.Option(
        "--current-ma",
        min=0,
        max=20_000,
        help="Limit of the drives' output current in mA; 0 leaves their own limits.",
    ),
]


def home(
    axis: Annotated[
        list[str] | None, typer.Option("--axis", metavar="NAME", help=f"{_NAMES}; repeatable. Default: all.")
    ] = None,
    needle: Annotated[
        Literal["mounted", "none"],
        typer.Option(help="Whether a needle is in the clamp; if so, no search that could bend it."),
    ] = "mounted",
    method: Annotated[
        int | None,
        typer.Option(
            help="Homing method of the drive; 35 homes where the axis stands. Default: the rig file's."
        ),
    ] = None,
    rig: RigOption = None,
    current_ma: CurrentOption = _GENTLE_MA,
    yes: YesOption = False,
    as_json: AsJson = False,
) -> int:
    """Home the linear module first."""
    from labrig.devices.homing import HOME_ORDER
    from labrig.devices.rig_file import load_rig
    from labrig.runner.commissioning import home_axes

    chosen = _require_axes(axis or HOME_ORDER)
    for name, description in load_rig(find_rig_file(rig)).axes.items():
        if method is not None and name in chosen and method not in description.homing_directions:
            methods = ", ".join(map(str, description.homing_directions))
            raise InputError(f"--method {method} is not a method that labrig uses", f"use one of {methods}")
    with _open_axes(rig, chosen, current_ma, "labrig devices home", yes=yes) as opened:
        findings = home_axes(opened, method, needle_mounted=needle == "mounted")
    return print_checks([asdict(finding) for finding in findings], as_json)


def jog(
    axis: Annotated[str, typer.Option("--axis", metavar="NAME", help=f"{_NAMES}.")],
    distance: Annotated[
        float | None,
        typer.Option(
            "--distance",
            help="Signed distance in mm or rad; without a reference at most 20 mm or half a turn. "
            "Default: 10 mm or a quarter turn.",
        ),
    ] = None,
    check: Annotated[
        Literal["travel", "limits"] | None,
        typer.Option(
            help="travel: go there and back, and compare direction, lead and play with your readings of graph paper. "
            "limits: go to both limits of a referenced axis."
        ),
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(
            "--speed", help="Speed in mm/s or rad/s, at most 5 mm/s or 1 rad/s. Default: 1 mm/s or 0.2 rad/s."
        ),
    ] = None,
    rig: RigOption = None,
    current_ma: CurrentOption = _GENTLE_MA,
    yes: YesOption = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 1 when a check found the rig file wrong; the file is never changed."""
    from labrig.runner import commissioning

    with _open_axes(rig, _require_axes([axis]), current_ma, "labrig devices jog", yes=yes) as opened:
        far = commissioning.USUAL_DISTANCE[opened.axis(axis).unit] if distance is None else distance
        match check:
            case "limits":
                findings = commissioning.check_limits(opened, axis, speed)
            case "travel":
                findings = commissioning.check_travel(opened, axis, far, speed)
            case _:
                findings = [commissioning.jog(opened, axis, far, speed)]
    return print_checks([asdict(finding) for finding in findings], as_json)


def withdraw(
    run: Annotated[
        Path | None,
        typer.Option(
            "--run", metavar="RUN", help="Run that left the needle. Default: the run that the rig remembers."
        ),
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            metavar="AXIS=POSITION",
            help="Where an axis stands, in mm or rad, if not as recorded: insertion=12.5 is the needle outside the "
            "sheath; repeatable.",
        ),
    ] = None,
    rig: RigOption = None,
    yes: YesOption = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when the needle is out; the withdrawal is recorded as a run of its own."""
    from labrig.cli.attendant import TerminalAttendant
    from labrig.cli.finished_run import say_where_needle_is
    from labrig.cli.rigs import remark_on_yes
    from labrig.devices.rig_file import load_rig
    from labrig.library.withdrawal import withdraw_needle
    from labrig.record.manifest import read_checksum

    description = load_rig(find_rig_file(rig))
    remark_on_yes(description, yes=yes)
    done = withdraw_needle(
        description,
        run,
        find_runs_dir(),
        standing=dict(map(_read_position, at or ())),
        attendant=TerminalAttendant(),
        command_line=sys.argv,
    )
    error, checksum = done.outcome.error, read_checksum(done.path)
    if error is not None:
        say_where_needle_is(done.needle)
        for line in failure_lines(error):
            say(line)
        say(f"again: {done.retry}\nthe record is kept: {done.path}")
    if as_json:
        document: dict[str, object] = {
            "run": str(done.path),
            "exit_status": done.outcome.exit_status,
            "reason": done.outcome.reason or None,
            "checksum": checksum,
            "needle": done.needle.document(),
        }
        print_json(document if error is None else {**document, "error": failure_document(error)})
    elif error is None:
        print_line(f"the needle is out\nrecord  {done.path}\nchecksum {checksum}")
    return 0 if error is None else error.exit_code


def _read_position(text: str) -> tuple[str, float]:
    """Return field and value of `AxisPositions` for `insertion=12.5`. Raises `InputError`."""
    axis, _, position = text.partition("=")
    (name,), hint = _require_axes([axis], "--at"), "for example --at insertion=12.5"
    try:
        value = float(position)
    except ValueError:
        raise InputError(f"--at {text} has no position", hint) from None
    if not math.isfinite(value):
        raise InputError(f"--at {text} is not finite", hint)
    return f"{name}_{'rad' if name == 'rotation' else 'mm'}", value


def _require_axes(names: Sequence[str], option: str = "--axis") -> tuple[str, ...]:
    """Return axis names, all of which exist. Raises `InputError`."""
    from labrig.devices.axis_description import AXES

    for name in names:
        if name not in AXES:
            raise InputError(f"{option} {name} is not an axis of the rig", f"the axes are {', '.join(AXES)}")
    return tuple(names)


@contextmanager
def _open_axes(
    rig: Path | None, axes: tuple[str, ...], current_ma: int, doing: str, *, yes: bool
) -> Iterator[Any]:
    """Open axes of a rig, without its camera, with limited current; faults are reset if the person confirms.

    If bus or drives fail, or a signal ends the work, it says what the needle is doing and where it is.
    """
    from labrig.cli.finished_run import say_where_needle_is
    from labrig.cli.rigs import open_rig_for_person, remark_on_yes
    from labrig.devices.opening import Opening
    from labrig.devices.rig_file import load_rig
    from labrig.runner.needle_report import NeedleReport

    if 0 < current_ma < _LEAST_MA:
        raise InputError(
            f"--current-ma {current_ma} moves nothing", f"give {_LEAST_MA} or more, or 0 for no limit"
        )
    description = load_rig(find_rig_file(rig))
    remark_on_yes(description, yes=yes)
    limits_ma = dict.fromkeys(axes, current_ma) if current_ma else {}
    opening = Opening(axes, camera=False, max_current_ma=limits_ma, reset_faults=True)
    with open_rig_for_person(description, doing, opening=opening) as (opened, _):
        try:
            yield opened
        except (InterruptedRunError, WireError):
            with suppress(SafetyStopError):  # closing the rig tries again and tells
                opened.stop()
            way_out = opened.state.find_way_out(opened.description.option)
            say_where_needle_is(NeedleReport(opened.locate_needle(), way_out))
            raise
