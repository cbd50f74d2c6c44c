"""Withdraws a needle along its path, turning the bevel back where it was turned, and then the sheath.

After a crash, an emergency stop or a power cut the path is taken from the record (`recover`). Nothing is homed then:
if a drive has lost its position, the needle is assumed to be where the record ends, once a person has confirmed it.

A needle that was turned on its way lies in a track with bends in several directions. If it were pulled out without
turning back, its stiff tip would cut another track. The path consists of the axis positions during the insertion.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from itertools import groupby

import pandas as pd

from labrig.devices.axis_positions import AxisPositions
from labrig.devices.operator import ConfirmNeedleOut, ConfirmStance, ConfirmWithdrawal, WithdrawNeedle
from labrig.devices.rig_file import RigDescription
from labrig.protocol.sections import Advance, Sheath
from labrig.record.events import TrialStart, TrialStop, WithdrawalStart, WithdrawalStop
from labrig.record.reader import Run, open_run
from labrig.runner.session import Session

_SAME_DEPTH_MM = 0.02
"""Readings that differ by less count as one depth: servos at rest dither."""

_SAME_ROLL_RAD = 0.05
"""Smaller turns are not undone one by one; a turn during an advance is undone in steps of this size."""


@dataclass(frozen=True)
class ReverseMove:
    """One move of a withdrawal: the axis, and its absolute target [mm or rad]."""

    axis: str
    position: float


SLOWLY: Mapping[str, float] = {"insertion": 1.0, "rotation": 0.5, "linear": 1.0}
"""Default speed of each axis in a withdrawal [mm/s or rad/s]."""


def find_speeds(rig: RigDescription, advance: Advance, sheath: Sheath) -> Mapping[str, float]:
    """Return the speed of each axis in the withdrawals of a run, by its protocol's sections [mm/s or rad/s]."""
    return {
        "insertion": advance.withdraw_speed_mm_s,
        "rotation": rig.axes.rotation.max_speed / 2,
        "linear": sheath.speed_mm_s,
    }


def read_needle_path(run: Run) -> tuple[AxisPositions, ...]:
    """Return the axis positions during the last trial of a run, in order; empty if its needle was out by then.

    An incomplete withdrawal has a record of its own; its positions follow those of the run whose needle it withdrew.

    Raises
    ------
    RecordError
        When a record is damaged or missing.
    """
    if run.withdraws is not None:
        return (*read_needle_path(open_run(run.path.parent / run.withdraws)), *_read_positions(run.states))
    trials = run.read_trials(TrialStart, TrialStop)
    if not trials:
        # The roll zero is found before any trial. Retracted parts of the path are dropped later.
        return _read_positions(run.states)
    if trials[-1].exit_status == "success":
        return ()
    return _read_positions(run.states[run.states["t_s"] >= trials[-1].start.t_s])


def _read_positions(states: pd.DataFrame) -> tuple[AxisPositions, ...]:
    if states.empty:
        return ()
    columns = (states["insertion_mm"], states["rotation_rad"], states["linear_mm"])
    return tuple(AxisPositions(*map(float, row)) for row in zip(*columns, strict=True))


def plan_reverse_moves(path: Sequence[AxisPositions]) -> tuple[ReverseMove, ...]:
    """Return the moves that withdraw needle and sheath along their path.

    Parameters
    ----------
    path : sequence of AxisPositions
        From before the insertion to the present position. Parts that were retracted meanwhile are left out.

    Returns
    -------
    tuple of ReverseMove
        The needle never goes deeper. It ends flush with the sheath (0 mm), then the sheath goes to 0 mm; the bevel
        ends at its roll at the entry.
    """
    moves = _plan_moves(path) if path else ()
    return tuple(list(same)[-1] for _, same in groupby(moves, key=lambda move: move.axis))


def _plan_moves(path: Sequence[AxisPositions]) -> Iterator[ReverseMove]:
    here = path[-1]
    depth_mm, roll_rad = here.insertion_mm, here.rotation_rad
    for positions in reversed(_find_path_in_tissue(path)):
        if abs(positions.rotation_rad - roll_rad) <= _SAME_ROLL_RAD:
            continue
        if depth_mm - positions.insertion_mm > _SAME_DEPTH_MM:
            depth_mm = max(positions.insertion_mm, 0.0)
            yield ReverseMove("insertion", depth_mm)
        roll_rad = positions.rotation_rad
        yield ReverseMove("rotation", roll_rad)
    if depth_mm > 0:
        yield ReverseMove("insertion", 0.0)
    if here.linear_mm > 0:
        yield ReverseMove("linear", 0.0)


def _find_path_in_tissue(path: Sequence[AxisPositions]) -> list[AxisPositions]:
    """Return the part of the path that the needle lies in, in order of depth, from where it left the sheath."""
    lying: list[AxisPositions] = []
    for positions in path:
        while lying and lying[-1].insertion_mm > positions.insertion_mm + _SAME_DEPTH_MM:
            lying.pop()
        lying.append(positions)
    # Turns before the needle left the sheath cut nothing, and are not undone.
    outside = [number for number, positions in enumerate(lying) if positions.insertion_mm <= _SAME_DEPTH_MM]
    return lying[outside[-1] if outside else 0 :]


def withdraw(session: Session, path: Sequence[AxisPositions], speeds: Mapping[str, float] = SLOWLY) -> None:
    """Withdraw the needle along its path, and then the sheath.

    The needle counts as out when every axis has a reference and has arrived; if positions are only assumed, when the
    operator confirms it.

    Parameters
    ----------
    session : Session
        Every axis of its rig has a reference, or a position confirmed by a person.
    path : sequence of AxisPositions
        The path so far, from `read_needle_path` or the states of this trial.
    speeds : mapping of str to float
        Speed of each axis [mm/s or rad/s], rounded down to integer rpm of the motor.

    Raises
    ------
    SafetyStopError
        When the operator does not confirm that the needle is out, or the position of an axis is unknown.
    DriveError, BusError, InterruptedRunError
        The needle still counts as in tissue.
    """
    moves = plan_reverse_moves((*path, session.read_positions()))
    session.record(WithdrawalStart(moves=len(moves)))
    for move in moves:
        axis = session.axis(move.axis)
        session.move(move.axis, move.position, axis.nearest_speed(min(speeds[move.axis], axis.max_speed)))
    if not session.is_referenced:
        session.ask(ConfirmNeedleOut("the positions from which it was withdrawn were only believed"))
    session.rig.needle.mark_out()
    session.record(WithdrawalStop())


def confirm_needle_out(session: Session) -> None:
    """Have the operator confirm that no needle is in tissue, unless the rig knows it.

    Raises
    ------
    SafetyStopError
        When the operator does not confirm.
    """
    if session.state.needle_in_tissue is not False:
        session.ask(ConfirmNeedleOut(session.state.doubt))
        session.rig.needle.mark_out()


def take_needle_out(session: Session, path: Sequence[AxisPositions]) -> None:
    """Withdraw a needle that this run left in tissue, if the operator agrees; otherwise ask whether it is out.

    It can only be withdrawn along its path if every drive has kept its reference; otherwise its position is unknown.
    """
    state = session.state
    is_known = path and state.since_run == session.run_name and session.is_referenced
    if state.needle_in_tissue is not False and is_known:
        deepest_mm = max(positions.insertion_mm for positions in path)
        if session.offer(WithdrawNeedle(session.run_name, deepest_mm)):
            withdraw(session, path)
    confirm_needle_out(session)


def recover(session: Session, run_name: str, path: Sequence[AxisPositions], standing: AxisPositions) -> None:
    """Withdraw a needle that a run has left in tissue, once each step is confirmed; nothing is homed.

    Parameters
    ----------
    session : Session
        The opened rig, and the record of the withdrawal.
    run_name : str
        The run that left it.
    path : sequence of AxisPositions
        Its path, from `read_needle_path`.
    standing : AxisPositions
        Assumed positions of the axes that have lost theirs.

    Raises
    ------
    SafetyStopError
        When the operator does not confirm a step.
    DriveError, BusError, InterruptedRunError
        The needle still counts as in tissue.
    """
    assumed = dict(zip(("insertion", "rotation", "linear"), astuple(standing), strict=True))
    lost = tuple(name for name in assumed if name not in session.referenced)
    if lost:
        insertion_mm, rotation_rad, linear_mm = astuple(standing)
        session.ask(ConfirmStance(run_name, insertion_mm, rotation_rad, linear_mm, lost))
        session.rig.assume_positions({name: assumed[name] for name in lost})
    moves = plan_reverse_moves((*path, session.read_positions()))
    units = {"rotation": "rad"}
    told = (f"{move.axis} to {move.position:.1f} {units.get(move.axis, 'mm')}" for move in moves)
    session.ask(ConfirmWithdrawal(tuple(told)))
    session.rig.needle.mark_in_tissue(session.run_name)
    withdraw(session, path)
