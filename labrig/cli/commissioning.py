"""Homing and jogging from the command line: the rig opened gently, and what was found told."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from labrig.cli.options import rig_file
from labrig.cli.output import tell_checks
from labrig.cli.rigs import remark_on_yes, rig_for_person
from labrig.devices.axis_description import AXES
from labrig.devices.homing import HOME_ORDER
from labrig.devices.rig import Opening, Rig
from labrig.devices.rig_file import load_rig
from labrig.errors import InputError
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
class Careful:
    """How a rig is opened for commissioning: its file, the current limit, and what is said and how."""

    rig: Path | None
    current_ma: int
    yes: bool
    as_json: bool


def home_and_tell(
    careful: Careful, names: Sequence[str] | None, method: int | None, *, needle_mounted: bool
) -> int:
    """Home axes and print where they stand."""
    chosen = _checked(names or HOME_ORDER)
    if method is not None:
        _check_method(careful, chosen, method)
    with _opened(careful, chosen, "labrig devices home") as rig:
        findings = home_axes(rig, method, needle_mounted=needle_mounted)
    return _tell(findings, as_json=careful.as_json)


def _check_method(careful: Careful, axes: Sequence[str], method: int) -> None:
    """Refuse a homing method that the drive of one of these axes does not have. Raises `InputError`."""
    for name, axis in load_rig(rig_file(careful.rig)).axes.items():
        if name in axes and method not in axis.homing_directions:
            known = ", ".join(map(str, axis.homing_directions))
            raise InputError(f"--method {method} is none that labrig uses", f"use one of {known}")


def jog_and_tell(
    careful: Careful, name: str, asked: float | None, speed: float | None, check: str | None
) -> int:
    """Jog one axis and print what was found."""
    with _opened(careful, _checked([name]), "labrig devices jog") as rig:
        distance = USUAL_DISTANCE[rig.axis(name).unit] if asked is None else asked
        match check:
            case "limits":
                findings = check_limits(rig, name, speed)
            case "backlash":
                findings = [check_backlash(rig, name, distance, speed)]
            case "travel":
                findings = [check_travel(rig, name, distance, speed)]
            case _:
                findings = [jog(rig, name, distance, speed)]
    return _tell(findings, as_json=careful.as_json)


def _checked(names: Sequence[str]) -> tuple[str, ...]:
    """Return axis names that exist. Raises `InputError`."""
    for name in names:
        if name not in AXES:
            raise InputError(f"--axis {name} is no axis of the rig", f"the axes are {', '.join(AXES)}")
    return tuple(names)


@contextmanager
def _opened(careful: Careful, axes: tuple[str, ...], doing: str) -> Iterator[Rig]:
    """Open axes of a rig without its camera, gently; faults are reset where the person confirms it."""
    if 0 < careful.current_ma < _LEAST_MA:
        raise InputError(
            f"--current-ma {careful.current_ma} moves nothing", f"give {_LEAST_MA} or more, or 0 for no limit"
        )
    description = load_rig(rig_file(careful.rig))
    remark_on_yes(description, yes=careful.yes)
    opening = Opening(axes, camera=False, max_current_ma=careful.current_ma or None, reset_faults=True)
    with rig_for_person(description, doing, opening=opening) as (rig, _):
        yield rig


def _tell(findings: Sequence[Finding], *, as_json: bool) -> int:
    return tell_checks([asdict(finding) for finding in findings], as_json)
