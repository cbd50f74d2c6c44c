"""What stands in the pictures of a run: its needle, and the sheath that it comes out of."""

from dataclasses import dataclass

from labrig.protocol.insertion import InsertionProtocol, RollZeroProtocol
from labrig.protocol.load import AnyProtocol
from labrig.protocol.protocols import ImportProtocol, SteerabilityProtocol


@dataclass(frozen=True)
class NeedleInPicture:
    """Outer diameters; the sheath's is None where the pictures show none."""

    diameter_mm: float
    sheath_diameter_mm: float | None


def needle_in(protocol: AnyProtocol) -> NeedleInPicture | None:
    """Return needle and sheath of a protocol, or None for one that takes no picture of a needle."""
    match protocol:
        case SteerabilityProtocol() | InsertionProtocol() | RollZeroProtocol():
            return NeedleInPicture(protocol.needle.diameter_mm, protocol.sheath.diameter_mm)
        case ImportProtocol():
            return NeedleInPicture(protocol.needle.diameter_mm, protocol.sheath_diameter_mm)
        case _:
            return None
