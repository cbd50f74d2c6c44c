"""What a stop during each move of a trial does: how far the axis runs on, where the needle is, and the way back."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from labrig.devices.axis_positions import AxisPositions
from labrig.devices.rig_file import RigDescription
from labrig.runner.experiment import PlannedMove
from labrig.runner.withdrawal import SLOWLY, ReverseMove, plan_reverse_moves

_FIELDS = {"insertion": "insertion_mm", "rotation": "rotation_rad", "linear": "linear_mm"}


@dataclass(frozen=True)
class RehearsedStop:
    """A stop at the deepest point of a move.

    Attributes
    ----------
    axis, start, end : str, float, float
        The move [mm or rad].
    runs_on : float
        By how much it goes on while it brakes with the deceleration of its moves [mm or rad].
    brakes_s : float
        How long it brakes [s]; the stop itself is told to the drive within a cycle of the supervision.
    in_tissue : bool
        Whether the needle counts as in tissue.
    withdrawal : tuple of ReverseMove
        The moves of `labrig devices withdraw` from there.
    withdrawal_s : float
        How long those take at its speeds [s], without the questions.
    """

    axis: str
    start: float
    end: float
    runs_on: float
    brakes_s: float
    in_tissue: bool
    withdrawal: tuple[ReverseMove, ...]
    withdrawal_s: float


def rehearse_stops(moves: Sequence[PlannedMove], rig: RigDescription) -> tuple[RehearsedStop, ...]:
    """Return a stop during each move of a trial, which begins with the sheath and ends when the sheath is out.

    The way back is planned by the code that withdraws a needle, from the positions that the record would hold.

    Parameters
    ----------
    moves : sequence of PlannedMove
        The moves of the trial, in order.
    rig : RigDescription
        Its axes say how they brake.
    """
    return tuple(_rehearse(moves, rig))


def _rehearse(moves: Sequence[PlannedMove], rig: RigDescription) -> Iterator[RehearsedStop]:
    axes = dict(rig.axes.items())
    path = [AxisPositions(0.0, 0.0, 0.0)]
    for move in moves:
        field, axis = _FIELDS[move.axis], axes[move.axis]
        deepest = max(move.start, move.position)
        at_worst = [*path, replace(path[-1], **{field: deepest})]
        withdrawal = plan_reverse_moves(at_worst)
        yield RehearsedStop(
            axis=move.axis,
            start=move.start,
            end=move.position,
            runs_on=move.speed**2 / (2 * axis.acceleration),
            brakes_s=move.speed / axis.acceleration,
            in_tissue=bool(withdrawal),
            withdrawal=withdrawal,
            withdrawal_s=_count_seconds(withdrawal, at_worst[-1], rig),
        )
        path.append(replace(path[-1], **{field: move.position}))


def _count_seconds(moves: Sequence[ReverseMove], here: AxisPositions, rig: RigDescription) -> float:
    axes, total_s = dict(rig.axes.items()), 0.0
    for move in moves:
        field = _FIELDS[move.axis]
        speed = min(SLOWLY[move.axis], axes[move.axis].max_speed)
        total_s += abs(move.position - getattr(here, field)) / speed
        here = replace(here, **{field: move.position})
    return total_s
