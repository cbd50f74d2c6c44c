"""Withdrawing a needle as it came: back, its bevel turned back where it was turned, then the sheath.

After a crash, an emergency stop or a power cut the same is done from the record (`recover`). Nothing is homed for it:
where a drive has lost its position, the needle is believed to stand where the record ends, once a person has looked.

A needle that has been turned on its way lies in a track with bends in several directions; pulled out without turning
back, its stiff tip would cut another one. The path is what the axes read while it went in.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from labrig.devices.operator import ConfirmNeedleOut, ConfirmStance, ConfirmWithdrawal
from labrig.record.events import TrialStart, TrialStop, WithdrawalStart, WithdrawalStop
from labrig.record.reader import Run, open_run
from labrig.runner.axis_positions import AxisPositions, axis_positions_of
from labrig.runner.session import Session

_SAME_DEPTH_MM = 0.02
"""Readings that differ by less are of one depth: servos at rest dither."""

_SAME_ROLL_RAD = 0.05
"""Smaller turns are not undone one by one; a turn while the needle advances is undone in steps of this."""


@dataclass(frozen=True)
class ReverseMove:
    """One move of a withdrawal: which axis, and where to, absolute [mm or rad]."""

    axis: str
    position: float


SLOWLY: Mapping[str, float] = {"insertion": 1.0, "rotation": 0.5, "linear": 1.0}
"""The speed of each axis at which a needle is withdrawn unless somebody says otherwise [mm/s or rad/s]."""


def read_needle_path(run: Run) -> tuple[AxisPositions, ...]:
    """Return the states of the trial in which a run ended, first to last; none when its needle was out by then.

    A withdrawal that did not come to its end has a record of its own; its states follow those of the run whose
    needle it withdrew.

    Raises
    ------
    RecordError
        When a record is damaged or missing.
    """
    if run.withdraws is not None:
        return (*read_needle_path(open_run(run.path.parent / run.withdraws)), *_read_positions(run.states))
    trials = run.read_trials(TrialStart, TrialStop)
    if not trials:
        # The roll zero is found before any trial. What the needle went back is not gone in again.
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
    """Return the moves that take needle and sheath out along the path by which they came.

    Parameters
    ----------
    path : sequence of Stance
        From before the needle went in to where it stands now. What it went back meanwhile is not gone in again.

    Returns
    -------
    tuple of ReverseMove
        The needle never goes deeper. It ends flush with the sheath (0 mm), then the sheath goes to 0 mm; the bevel
        is left as it was where the needle went in.
    """
    return tuple(_join_moves(_plan_moves(path))) if path else ()


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
    """Return the part of the path that the needle still lies in, its depths rising, from where it left the sheath."""
    lying: list[AxisPositions] = []
    for positions in path:
        while lying and lying[-1].insertion_mm > positions.insertion_mm + _SAME_DEPTH_MM:
            lying.pop()
        lying.append(positions)
    # Turns that were made before the needle left the sheath cut nothing, and are not undone.
    outside = [number for number, positions in enumerate(lying) if positions.insertion_mm <= _SAME_DEPTH_MM]
    return lying[outside[-1] if outside else 0 :]


def _join_moves(moves: Iterator[ReverseMove]) -> list[ReverseMove]:
    """Make one move of those that follow each other on one axis."""
    joined: list[ReverseMove] = []
    for move in moves:
        if joined and joined[-1].axis == move.axis:
            joined.pop()
        joined.append(move)
    return joined


def withdraw(session: Session, path: Sequence[AxisPositions], speeds: Mapping[str, float] = SLOWLY) -> None:
    """Withdraw the needle from where it stands along the path by which it came, and the sheath after it.

    The needle counts as out when every axis has a reference and has arrived; where positions are only believed, when
    the operator confirms it.

    Parameters
    ----------
    session : Session
        Every axis of its rig has a reference, or a position that a person has confirmed.
    path : sequence of Stance
        The path so far, as `read_needle_path` or the states of this trial give it.
    speeds : mapping of str to float
        How fast each axis moves [mm/s or rad/s]; rounded down to what the motor's integer rpm allow.

    Raises
    ------
    SafetyStopError
        When the operator does not confirm that the needle is out, or an axis' position is not known.
    DriveError, BusError, InterruptedRunError
        The needle still counts as in tissue.
    """
    rig = session.rig
    moves = plan_reverse_moves((*path, axis_positions_of(rig.read_states())))
    session.record(WithdrawalStart(moves=len(moves)))
    for move in moves:
        axis = rig.axis(move.axis)
        session.move(move.axis, move.position, axis.nearest_speed(min(speeds[move.axis], axis.max_speed)))
    if not all(axis.referenced for axis in rig.axes):
        session.ask(ConfirmNeedleOut("the positions from which it was withdrawn were only believed"))
    rig.needle.mark_out()
    session.record(WithdrawalStop())


def recover(session: Session, run_name: str, path: Sequence[AxisPositions], standing: AxisPositions) -> None:
    """Withdraw a needle that a run has left in tissue, each step on confirmation; nothing is homed.

    Parameters
    ----------
    session : Session
        The opened rig, and the record of the withdrawal.
    run_name : str
        The run that left it.
    path : sequence of Stance
        Its path, as `read_needle_path` gives it.
    standing : Stance
        Where axes that have lost their positions are believed to stand.

    Raises
    ------
    SafetyStopError
        When the operator says no to anything.
    DriveError, BusError, InterruptedRunError
        The needle still counts as in tissue.
    """
    rig = session.rig
    believed = {
        "insertion": standing.insertion_mm,
        "rotation": standing.rotation_rad,
        "linear": standing.linear_mm,
    }
    lost = tuple(axis.name for axis in rig.axes if not axis.referenced)
    if lost:
        session.ask(
            ConfirmStance(run_name, standing.insertion_mm, standing.rotation_rad, standing.linear_mm, lost)
        )
        rig.assume_positions({name: believed[name] for name in lost})
    moves = plan_reverse_moves((*path, axis_positions_of(rig.read_states())))
    session.ask(ConfirmWithdrawal(tuple(_describe_move(move) for move in moves)))
    rig.needle.mark_in_tissue(session.recorder.run_name)
    withdraw(session, path)


def _describe_move(move: ReverseMove) -> str:
    unit = "rad" if move.axis == "rotation" else "mm"
    return f"{move.axis} to {move.position:.1f} {unit}"
