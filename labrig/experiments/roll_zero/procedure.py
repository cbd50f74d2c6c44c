"""The roll zero of a needle as it is clamped, found and certified."""

from labrig.devices.rig_file import RigDescription
from labrig.experiments.roll_zero.protocol import RollZeroProtocol
from labrig.experiments.shared.roll_zero_search import RollZeroOrder, find_roll_zero
from labrig.runner.experiment import RunPlan
from labrig.runner.plan import find_rig_problems, insertion_moves, roll_move, sentinel_work
from labrig.runner.session import Session


def order_of(protocol: RollZeroProtocol) -> RollZeroOrder:
    """Return what a protocol of this experiment asks for."""
    return RollZeroOrder(
        protocol.needle,
        protocol.sheath,
        protocol.insertion,
        protocol.roll_zero,
        protocol.needle.design_radius_mm,
        protocol.sentinel,
    )


def plan(protocol: RollZeroProtocol, rig: RigDescription) -> RunPlan:
    """Return what the protocol is going to ask of a rig."""
    order, steps = order_of(protocol), protocol.roll_zero
    moves = (
        roll_move(rig, "roll_zero.rolls", order.farthest_roll_rad),
        *insertion_moves("roll_zero.length_mm", steps.length_mm, protocol.insertion, protocol.sheath),
    )
    pictures, operator_steps = sentinel_work(protocol.sentinel)
    return RunPlan(
        duration_s=order.duration_s,
        pictures=order.pictures + pictures,
        operator_steps=3 + steps.rolls + operator_steps,
        problems=find_rig_problems(protocol, rig, moves),
    )


def run(protocol: RollZeroProtocol, session: Session) -> None:
    """Find and certify the roll zero that a protocol asks for."""
    find_roll_zero(order_of(protocol), session)
