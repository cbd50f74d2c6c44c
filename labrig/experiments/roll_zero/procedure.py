"""Find and certify the roll zero of a needle as it is clamped."""

from labrig.analysis.sentinel import GridRole
from labrig.experiments.roll_zero.protocol import RollZeroProtocol
from labrig.experiments.shared.roll_zero_search import find_roll_zero
from labrig.runner.graph_paper import photograph_grid, require_same_grid
from labrig.runner.session import Session


def run(protocol: RollZeroProtocol, session: Session) -> None:
    """Find the roll zero, and certify it in the rig's state.

    Raises
    ------
    MeasurementRefusedError
        When the zero is not found, or too uncertain.
    CalibrationRefusedError
        When the camera was bumped during the search.
    """
    sight = session.open_sight()
    before = photograph_grid(protocol.sentinel, GridRole.BEFORE, session)
    found = find_roll_zero(protocol, protocol.roll_zero, session, sight)
    after = photograph_grid(protocol.sentinel, GridRole.AFTER, session)
    require_same_grid(before, after, protocol.sentinel, sight, session)
    session.certify_roll_zero(found)
