"""What was done with a rig before, as far as a gel remembers it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PastInsertion:
    """An insertion of an earlier session, whose track is still in its specimen.

    Attributes
    ----------
    specimen, gelatin_percent : str, float
        The block of gel.
    hole, hole_position_mm : int, float
        Where the needle went in.
    path : tuple of (float, float, float)
        Where the axes stood meanwhile: insertion [mm], rotation [rad], linear [mm].
    """

    specimen: str
    gelatin_percent: float
    hole: int
    hole_position_mm: float
    path: tuple[tuple[float, float, float], ...]
