"""The roll zero of a needle as it is clamped, found and certified."""

from labrig.experiments.roll_zero.plan import order_of
from labrig.experiments.roll_zero.protocol import RollZeroProtocol
from labrig.experiments.shared.roll_zero_search import find_roll_zero
from labrig.runner.session import Session


def run(protocol: RollZeroProtocol, session: Session) -> None:
    """Find and certify the roll zero that a protocol asks for."""
    find_roll_zero(order_of(protocol), session)
