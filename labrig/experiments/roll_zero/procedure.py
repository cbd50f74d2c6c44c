"""Find and certify the roll zero of a needle as it is clamped."""

from labrig.devices.rig_file import RigDescription
from labrig.experiments.roll_zero.protocol import RollZeroProtocol
from labrig.experiments.shared.roll_zero_search import RollZeroOrder, find_roll_zero
from labrig.runner.experiment import RunPlan
from labrig.runner.plan import count_sentinel_work, find_rig_problems, plan_insertion_moves, plan_roll_move
from labrig.runner.session import Session


def make_order(protocol: RollZeroProtocol) -> RollZeroOrder:
    """Return the order for the search, from the protocol."""
    return RollZeroOrder(
        protocol.needle,
        protocol.sheath,
        protocol.insertion,
        protocol.roll_zero,
        protocol.needle.design_radius_mm,
        protocol.sentinel,
    )


def plan(protocol: RollZeroProtocol, rig: RigDescription) -> RunPlan:
    """Return the plan of a run on a rig."""
    order, steps = make_order(protocol), protocol.roll_zero
    moves = plan_insertion_moves("roll_zero.length_mm", steps.length_mm, protocol.insertion, protocol.sheath)
    turn = plan_roll_move(rig, "roll_zero.rolls", order.farthest_roll_rad)
    pictures, operator_steps = count_sentinel_work(protocol.sentinel)
    return RunPlan(
        duration_s=order.duration_s,
        pictures=order.pictures + pictures,
        operator_steps=3 + order.holes + operator_steps,
        moves=moves,
        problems=find_rig_problems(protocol, rig, (turn, *moves, *order.plan_torsion_moves(rig))),
        uses_calibration=True,
    )


def run(protocol: RollZeroProtocol, session: Session) -> None:
    """Find and certify the roll zero that a protocol asks for."""
    find_roll_zero(make_order(protocol), session)
