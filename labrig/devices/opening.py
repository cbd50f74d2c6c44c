"""What of a rig is opened, and how its drives are made ready for power; nothing moves, and power stays off.

What is decided here
--------------------
- Every drive is tried, and the failures of all of them are told together.
- A fault is reset only where the opening allows it and a person has confirmed that its cause is gone. Drives that
  report the same error have one cause: there is one question for them.
- A current limit that labrig sets is remembered in the rig's state first: a labrig that is killed leaves it behind, and
  the next one gives the drive its own again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from labrig.devices.axis import Axis
from labrig.devices.axis_description import AXES
from labrig.devices.drives.drive import Identity, raise_together, try_all
from labrig.devices.needle_state import NeedleState
from labrig.devices.operator import ConfirmFaultReset, ConfirmUnguarded
from labrig.devices.rig_file import RigDescription
from labrig.errors import DriveError, DriveFaultError, MachineError


@dataclass(frozen=True)
class Opening:
    """Which parts of a rig are opened, and how.

    Parameters
    ----------
    axes : tuple of str
        The axes; the others need not be connected, nor complete in the rig file.
    camera : bool
        Whether the camera is opened too.
    max_current_ma : mapping of str to int
        Axis -> limit of its output current while it is open, besides that of the rig file [mA].
    reset_faults : bool
        Whether the operator may confirm the reset of a fault; otherwise a drive in fault is refused.
    hold_inputs : bool
        Whether limits of inputs hold. A withdrawal goes as the person at the rig confirms: an open door or a force
        must not keep the needle in the tissue.
    power : bool
        Whether power is switched on at once; a run does so when it has its record.
    """

    axes: tuple[str, ...] = AXES
    camera: bool = True
    max_current_ma: Mapping[str, int] = field(default_factory=dict)
    reset_faults: bool = False
    hold_inputs: bool = True
    power: bool = True

    def limit_ma(self, axis: Axis) -> int | None:
        """Return the limit of an axis' output current while it is open [mA]; None keeps the drive's own."""
        limits_ma = (axis.description.max_current_ma, self.max_current_ma.get(axis.name))
        return min((limit_ma for limit_ma in limits_ma if limit_ma is not None), default=None)


WHOLE = Opening()
"""The whole rig, as a run has it."""


def prepare_drives(
    axes: Sequence[Axis],
    description: RigDescription,
    opening: Opening,
    needle: NeedleState,
    confirms: Callable[[ConfirmFaultReset | ConfirmUnguarded], bool],
) -> dict[str, Identity]:
    """Verify and configure every drive, and return what each is, by its axis.

    Parameters
    ----------
    axes : sequence of Axis
        The axes.
    description : RigDescription
        The rig file.
    opening : Opening
        How they are opened.
    needle : NeedleState
        The state of the rig: references, and current limits that a labrig that was killed has left.
    confirms : callable
        Tells whether the operator confirms the reset of a fault, or a drive that may move on when labrig ends.

    Raises
    ------
    DriveError
        With the failures of all drives, not only the first.
    BusError
    """
    identities: dict[str, Identity] = {}

    def identify(axis: Axis) -> None:
        identities[axis.name] = axis.drive.identify()

    def configure(axis: Axis) -> None:
        limit_ma, found_ma = opening.limit_ma(axis), axis.drive.reports.current_limit_ma()
        own_ma, set_ma = needle.state.current_limits.get(axis.name, (found_ma, found_ma))
        own_ma = own_ma if found_ma == set_ma else found_ma  # somebody else has set another one since
        if limit_ma is not None and own_ma is not None and limit_ma < own_ma:
            needle.note_current_limit(axis.name, own_ma, limit_ma)
        axis.drive.configure(description.can.heartbeat, limit_ma, own_ma)

    def find_faults(axis: Axis) -> None:
        if fault := axis.drive.fault():
            faults[axis] = fault

    def guard(axis: Axis) -> None:
        doubt = identities[axis.name].unguarded
        if doubt and not confirms(ConfirmUnguarded(axis.drive.name, doubt)):
            raise DriveError(
                f"{axis.drive.name}: {doubt}; the operator did not confirm its use",
                "find out in its manual how it stops when the heartbeat of the computer ends, or use another drive",
            )

    faults: dict[Axis, DriveFaultError] = {}
    raise_together(try_all(axes, identify))
    raise_together(try_all(axes, guard))
    raise_together(
        [*try_all(axes, find_faults), *_reset_faults(faults, description, opening, needle, confirms)]
    )
    raise_together(try_all(axes, configure))
    _find_references(axes, needle)
    return identities


def _reset_faults(
    faults: Mapping[Axis, DriveFaultError],
    description: RigDescription,
    opening: Opening,
    needle: NeedleState,
    confirms: Callable[[ConfirmFaultReset | ConfirmUnguarded], bool],
) -> list[MachineError]:
    """Reset the faults that may be reset, one question for each cause; return an error for each that stays."""
    stay: list[MachineError] = []
    causes: dict[int, list[tuple[Axis, DriveFaultError]]] = {}
    for axis, fault in faults.items():
        causes.setdefault(fault.code, []).append((axis, fault))
    for struck in causes.values():
        first, told = struck[0][1], "; ".join(fault.message for _, fault in struck)
        if not opening.reset_faults:
            named = f" --axis {struck[0][0].name}" if len(struck) == 1 else ""
            command = "withdraw" if needle.state.needle_in_tissue else f"home{named}"
            way_out = f"labrig devices {command} {description.option} resets it once you confirm"
            stay.append(first.reword(told, f"{first.hint}; {way_out}"))
        elif confirms(ConfirmFaultReset(told, first.hint)):
            stay += try_all([axis for axis, _ in struck], lambda axis: axis.drive.reset_fault())
        else:
            stay.append(first.reword(f"{told}; the operator did not confirm its reset"))
    return stay


def _find_references(axes: Sequence[Axis], needle: NeedleState) -> None:
    """Accept an axis as referenced if both the state file and its drive say so."""
    for axis in axes:
        axis.referenced = axis.name in needle.state.referenced and axis.drive.is_referenced()
        if axis.referenced:
            axis.drive.set_limits(axis.limits)
    needle.forget_references(axis.name for axis in axes if not axis.referenced)
