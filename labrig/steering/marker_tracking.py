"""How far a marker has moved since the start of an insertion, picture by picture, as pure functions.

The last believed sighting counts. While a marker is not seen, its displacement is held and becomes less certain with
each millimetre that the needle moves. A sighting beyond what that allows is not believed; if the next picture shows the
marker there too, it has been moved, and the needle stops. So it does if the marker is not seen for too long.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

from labrig.steering.parameters import MarkerTrust

MarkerStop = Literal["marker_lost", "marker_jumped"]
PlanePoint = tuple[float, float]

# A marker that was not seen may have moved by so many standard deviations of its displacement.
_SIGMAS = 3.0


@dataclass(frozen=True)
class TrackedMarker:
    """A marker on its way; places are (y, z) [mm].

    Attributes
    ----------
    marker_id : int
    start_mm : (y, z)
        Where it was at the start of the insertion.
    moved_mm : (y, z)
        Its displacement since then, by the last believed sighting.
    inserted_mm : float
        Insertion length at the last picture.
    unseen_mm : float
        How far the needle has moved since the last believed sighting.
    strayed_mm : (y, z) or None
        Its displacement in the last picture if that was not believed.
    stop : str or None
        Why the needle has to stop.
    detail : str
        A sentence about it.
    """

    marker_id: int
    start_mm: PlanePoint
    moved_mm: PlanePoint = (0.0, 0.0)
    inserted_mm: float = 0.0
    unseen_mm: float = 0.0
    strayed_mm: PlanePoint | None = None
    stop: MarkerStop | None = None
    detail: str = ""

    def sd_mm(self, trust: MarkerTrust) -> float:
        """Return the standard deviation of the displacement along each axis."""
        return math.hypot(trust.sd_mm, trust.lost_sd_mm_per_mm * self.unseen_mm)


def follow_marker(
    marker: TrackedMarker, seen_mm: PlanePoint | None, inserted_mm: float, trust: MarkerTrust
) -> TrackedMarker:
    """Return a marker after another picture, in which it was seen at a place (y, z), or not at all."""
    unseen_mm = marker.unseen_mm + abs(inserted_mm - marker.inserted_mm)
    passed = replace(marker, inserted_mm=inserted_mm, unseen_mm=unseen_mm, strayed_mm=None)
    if seen_mm is None:
        return _stop_if_lost(passed, trust)
    moved_mm = seen_mm[0] - marker.start_mm[0], seen_mm[1] - marker.start_mm[1]
    allowed_mm = trust.jump_mm + _SIGMAS * trust.lost_sd_mm_per_mm * unseen_mm
    if math.dist(moved_mm, marker.moved_mm) <= allowed_mm:
        return replace(passed, moved_mm=moved_mm, unseen_mm=0.0)
    passed = replace(passed, strayed_mm=moved_mm)
    if marker.strayed_mm is not None and math.dist(moved_mm, marker.strayed_mm) <= trust.jump_mm:
        detail = (
            f"marker {marker.marker_id} has jumped by {math.dist(moved_mm, marker.moved_mm):.1f} mm and stays there, "
            f"and {allowed_mm:.1f} mm are allowed (markers.jump_mm): the gel slid, or somebody moved it"
        )
        return replace(passed, stop="marker_jumped", detail=detail)
    return _stop_if_lost(passed, trust)


def _stop_if_lost(marker: TrackedMarker, trust: MarkerTrust) -> TrackedMarker:
    if marker.unseen_mm <= trust.most_lost_mm:
        return marker
    detail = (
        f"marker {marker.marker_id} was not seen while the needle moved by {marker.unseen_mm:.1f} mm, and "
        f"{trust.most_lost_mm:g} mm are allowed (markers.most_lost_mm)"
    )
    return replace(marker, stop="marker_lost", detail=detail)
