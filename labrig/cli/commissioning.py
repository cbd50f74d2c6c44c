"""Homes and jogs axes from the command line: opens the rig with limited current and prints the findings."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from labrig.cli.needle_report import NeedleReport, say_where_needle_is
from labrig.cli.options import find_rig_file
from labrig.cli.output import print_checks
from labrig.cli.rigs import open_rig_for_person, remark_on_yes
from labrig.devices.axis_description import AXES
from labrig.devices.homing import HOME_ORDER
from labrig.devices.opening import Opening
from labrig.devices.rig import Rig
from labrig.devices.rig_file import load_rig
from labrig.errors import InputError, InterruptedRunError, SafetyStopError, WireError
from labrig.runner.commissioning import (
    USUAL_DISTANCE,
    Finding,
    check_backlash,
    check_limits,
    check_travel,
    home_axes,
    jog,
)

_LEAST_MA = 50


@dataclass(frozen=True)
class CommissioningOptions:
    """Options of every commissioning command: rig file, current limit, and whether to ask and to print JSON."""

    rig: Path | None
    current_ma: int
    yes: bool
    as_json: bool


def home_and_print(
    options: CommissioningOptions, names: Sequence[str] | None, method: int | None, *, needle_mounted: bool
) -> int:
    """Home axes and print their positions."""
    chosen = _require_axes(names or HOME_ORDER)
    if method is not None:
        _check_method(options, chosen, method)
    with _open_axes(options, chosen, "labrig devices home") as rig:
        findings = home_axes(rig, method, needle_mounted=needle_mounted)
    return _print_findings(findings, as_json=options.as_json)


def _check_method(options: CommissioningOptions, axes: Sequence[str], method: int) -> None:
    """Refuse a homing method that the drive of one of these axes does not have. Raises `InputError`."""
    for name, axis in load_rig(find_rig_file(options.rig)).axes.items():
        if name in axes and method not in axis.homing_directions:
            methods = ", ".join(map(str, axis.homing_directions))
            raise InputError(f"--method {method} is not a method that labrig uses", f"use one of {methods}")


def jog_and_print(
    options: CommissioningOptions, name: str, distance: float | None, speed: float | None, check: str | None
) -> int:
    """Jog an axis and print the findings."""
    with _open_axes(options, _require_axes([name]), "labrig devices jog") as rig:
        distance = USUAL_DISTANCE[rig.axis(name).unit] if distance is None else distance
        match check:
            case "limits":
                findings = check_limits(rig, name, speed)
            case "backlash":
                findings = [check_backlash(rig, name, distance, speed)]
            case "travel":
                findings = [check_travel(rig, name, distance, speed)]
            case _:
                findings = [jog(rig, name, distance, speed)]
    return _print_findings(findings, as_json=options.as_json)


def _require_axes(names: Sequence[str]) -> tuple[str, ...]:
    """Return axis names, all of which exist. Raises `InputError`."""
    for name in names:
        if name not in AXES:
            raise InputError(f"--axis {name} is not an axis of the rig", f"the axes are {', '.join(AXES)}")
    return tuple(names)


@contextmanager
def _open_axes(options: CommissioningOptions, axes: tuple[str, ...], doing: str) -> Iterator[Rig]:
    """Open axes of a rig, without its camera, with limited current; faults are reset if the person confirms.

    If bus or drives fail, or a signal ends the work, it says what the needle is doing and where it is.
    """
    if 0 < options.current_ma < _LEAST_MA:
        raise InputError(
            f"--current-ma {options.current_ma} moves nothing", f"give {_LEAST_MA} or more, or 0 for no limit"
        )
    description = load_rig(find_rig_file(options.rig))
    remark_on_yes(description, yes=options.yes)
    limits_ma = dict.fromkeys(axes, options.current_ma) if options.current_ma else {}
    opening = Opening(axes, camera=False, max_current_ma=limits_ma, reset_faults=True)
    with open_rig_for_person(description, doing, opening=opening) as (rig, _):
        try:
            yield rig
        except (InterruptedRunError, WireError):
            with suppress(SafetyStopError):  # closing the rig tries again and tells
                rig.stop()
            say_where_needle_is(
                NeedleReport(rig.locate_needle(), rig.state.find_way_out(rig.description.option))
            )
            raise


def _print_findings(findings: Sequence[Finding], *, as_json: bool) -> int:
    return print_checks([asdict(finding) for finding in findings], as_json)
