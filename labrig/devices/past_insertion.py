"""An insertion of an earlier session, which left a track in its gel."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PastInsertion:
    """An insertion of an earlier session, with its track still in the specimen.

    Attributes
    ----------
    specimen, gelatin_percent : str, float
        The block of gel.
    hole, hole_position_mm : int, float
        Where the needle went in.
    path : tuple of (float, float, float)
        Positions of the axes during it: insertion [mm], rotation [rad], linear [mm].
    """

    specimen: str
    gelatin_percent: float
    hole: int
    hole_position_mm: float
    path: tuple[tuple[float, float, float], ...]
