"""Find and certify the roll zero of a needle as it is clamped."""

from labrig.experiments.roll_zero.protocol import RollZeroProtocol
from labrig.experiments.shared.roll_zero_order import RollZeroOrder
from labrig.experiments.shared.roll_zero_search import find_roll_zero
from labrig.runner.session import Session


def run(protocol: RollZeroProtocol, session: Session) -> None:
    """Find and certify the roll zero that a protocol asks for."""
    order = RollZeroOrder(
        protocol.needle,
        protocol.sheath,
        protocol.insertion,
        protocol.roll_zero,
        protocol.needle.design_radius_mm,
        protocol.sentinel,
    )
    find_roll_zero(order, session, session.open_sight())
