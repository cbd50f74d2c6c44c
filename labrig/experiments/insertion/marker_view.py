"""The markers of an insertion in its pictures: a live insertion and its analysis find and follow them by this."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self, TypeAlias

from labrig.errors import InputError, Problem, TargetMissedError
from labrig.experiments.insertion.aim import Aim
from labrig.experiments.insertion.events import MarkersSought, RecordedMarker
from labrig.experiments.insertion.protocol import InsertionProtocol, Markers
from labrig.steering.marker_tracking import TrackedMarker, follow_marker
from labrig.steering.moving import Displacement, Displacements, displace_problem
from labrig.steering.policy import Halt, SteeringSettings
from labrig.vision.marker import (
    MarkerFix,
    MarkerPlace,
    count_bits,
    count_markers,
    locate_marker,
)
from labrig.vision.out_of_plane import Perspective
from labrig.vision.plane import PlaneMap

SearchMarkers: TypeAlias = Callable[[str, Iterable[int]], Sequence[MarkerFix]]
"""(dictionary, ids) -> what one picture shows of them; see `labrig.vision.marker.find_markers`."""

# A marker that is seen larger or smaller by more lies beside where markers.x_mm puts it, or was printed otherwise.
_SIDE_SHARE = 0.05
# Smallest size of a bit in the picture. In the simulated world 150 of 150 markers of six dictionaries are read at this
# size, and at 3 px 22 of 25 of DICT_4X4_50.
_LEAST_BIT_PX = 3.5
# A marker is at least this share of the camera's height away from the camera.
_NEAREST = 0.1


def find_marker_problems(protocol: InsertionProtocol, plane: PlaneMap) -> Iterator[Problem]:
    """Yield markers that are in no dictionary, too small in the picture, or beside a plane without perspective."""
    markers = protocol.markers
    if markers is None:
        return
    count, bits = count_markers(markers.dictionary), count_bits(markers.dictionary)
    for key, place in protocol.places.items():
        if place.marker_id is not None and place.marker_id >= count:
            message = (
                f"marker {place.marker_id} is not in {markers.dictionary}, whose markers are 0 to {count - 1}"
            )
            yield Problem(f"{key}.marker_id", message, "correct the id, or markers.dictionary")
    perspective, bit_px = Perspective.of(plane), markers.side_mm / bits / plane.mm_per_px
    if perspective is not None:
        bit_px /= max(1.0 + markers.x_mm / perspective.height_mm, _NEAREST)
    if bit_px < _LEAST_BIT_PX:
        yield Problem(
            "markers.side_mm",
            f"a bit of a marker of {markers.side_mm:g} mm is {bit_px:.1f} px large in the picture ({bits} bits, border "
            f"included), and {_LEAST_BIT_PX:g} px are needed",
            f"print them {math.ceil(markers.side_mm * _LEAST_BIT_PX / bit_px)} mm large, or take a dictionary with "
            "fewer bits",
        )
    if markers.x_mm != 0.0 and perspective is None:
        yield Problem(
            "markers.x_mm",
            f"the markers lie {markers.x_mm:g} mm from the plane, and the plane map does not know where the camera is",
            "calibrate the camera's intrinsics, or put the markers into the plane",
        )
    elif perspective is not None and markers.x_mm <= (_NEAREST - 1.0) * perspective.height_mm:
        yield Problem(
            "markers.x_mm",
            f"the markers lie {-markers.x_mm:g} mm before the plane, and the camera {perspective.height_mm:.0f} mm",
            "state how far they are from the plane, negative towards the camera",
        )


def list_marker_ids(protocol: InsertionProtocol) -> tuple[int | None, ...]:
    """Return the markers that target and obstacles are bound to, as `InsertionStart` has them; empty without any."""
    bound = tuple(place.marker_id for place in protocol.places.values())
    return () if protocol.markers is None else bound


def find_target_sd_mm(protocol: InsertionProtocol, followed: "MarkersFollowed | None") -> float:
    """Return the standard deviation of the target's place along each axis: as stated, and by its marker, if any.

    Before the markers are followed (None) that is by a marker that is seen.
    """
    if protocol.markers is None or protocol.target.marker_id is None:
        return protocol.target.sd_mm
    moved = None if followed is None else followed.displacements.target
    return math.hypot(protocol.target.sd_mm, protocol.markers.sd_mm if moved is None else moved.sd_mm)


@dataclass(frozen=True, eq=False)
class MarkerView:
    """How the markers of a protocol are seen.

    `bound` are the ids of the markers that the target and each obstacle are bound to, the target's first; None for what
    is bound to none.
    """

    markers: Markers
    plane: PlaneMap
    bound: tuple[int | None, ...]

    @classmethod
    def of(cls, protocol: InsertionProtocol, plane: PlaneMap) -> Self | None:
        """Return the view of a protocol's markers; None if it has none."""
        return None if protocol.markers is None else cls(protocol.markers, plane, list_marker_ids(protocol))

    @property
    def marker_ids(self) -> list[int]:
        """The ids of all markers, in order."""
        return sorted({marker_id for marker_id in self.bound if marker_id is not None})

    def search(self, search: SearchMarkers) -> "dict[int, _Seen]":
        """Find all markers in a picture."""
        found = search(self.markers.dictionary, self.marker_ids)
        return {fix.marker_id: _Seen(fix, self.locate(fix)) for fix in found}

    def locate(self, fix: MarkerFix) -> MarkerPlace | None:
        """Return where a marker is; None if it was not found."""
        return (
            None if fix.corners_px is None else locate_marker(fix.corners_px, self.plane, self.markers.x_mm)
        )


@dataclass(frozen=True, eq=False)
class _Seen:
    """A marker in a picture; `place` is None if it was not found."""

    fix: MarkerFix
    place: MarkerPlace | None


@dataclass(frozen=True, eq=False)
class MarkersFollowed:
    """The markers of an insertion after a picture: how far each has moved, and what this picture shows."""

    view: MarkerView
    tracked: tuple[TrackedMarker, ...]
    seen: Mapping[int, _Seen] = field(default_factory=dict)

    @property
    def halt(self) -> Halt | None:
        """Why the needle has to stop; None if it need not."""
        return next(
            (Halt(marker.stop, marker.detail) for marker in self.tracked if marker.stop is not None), None
        )

    @property
    def doubt(self) -> Halt | None:
        """Why places are not known after the last picture, when none follows that could tell whether a jump stays."""
        strayed = (
            Halt("marker_jumped", f"in the last picture marker {marker.marker_id} is not where it was before")
            for marker in self.tracked
            if marker.strayed_mm is not None
        )
        return self.halt or next(strayed, None)

    @property
    def displacements(self) -> Displacements:
        """The displacements of what is bound to them."""
        moved = {
            marker.marker_id: Displacement(marker.moved_mm, marker.sd_mm(self.view.markers))
            for marker in self.tracked
        }
        return Displacements.by_marker(self.view.bound, moved)

    def make_event(self, trial: int, frame: int, depth_mm: float) -> MarkersSought:
        """Return the event of the picture."""
        return MarkersSought(
            trial=trial, frame=frame, depth_mm=depth_mm, markers=tuple(map(self._describe, self.tracked))
        )

    def _describe(self, marker: TrackedMarker) -> RecordedMarker:
        seen = self.seen[marker.marker_id]
        corners = None if seen.fix.corners_px is None else seen.fix.corners_px.tolist()
        return RecordedMarker(
            marker_id=marker.marker_id,
            corners_px=corners,
            place_mm=None if seen.place is None else seen.place.centre_mm,
            reason=seen.fix.reason,
            believed=seen.place is not None and marker.strayed_mm is None,
            displacement_mm=marker.moved_mm,
            sd_mm=marker.sd_mm(self.view.markers),
            unseen_mm=marker.unseen_mm,
        )


def find_start(search: SearchMarkers, view: MarkerView) -> MarkersFollowed:
    """Find every marker before the needle moves.

    Raises
    ------
    TargetMissedError
        When one is not seen, or is seen in another size than the protocol says.
    """
    seen = view.search(search)
    tracked = tuple(
        TrackedMarker(marker_id, _require_marker(marker.fix, marker.place, view).centre_mm)
        for marker_id, marker in seen.items()
    )
    return MarkersFollowed(view, tracked, seen)


def follow_markers(followed: MarkersFollowed, search: SearchMarkers, inserted_mm: float) -> MarkersFollowed:
    """Find the markers in another picture, at an insertion length, and return how far they have moved."""
    seen, trust = followed.view.search(search), followed.view.markers
    tracked = tuple(
        follow_marker(marker, None if place is None else place.centre_mm, inserted_mm, trust)
        for marker in followed.tracked
        for place in (seen[marker.marker_id].place,)
    )
    return replace(followed, tracked=tracked, seen=seen)


def place_settings(
    settings: SteeringSettings, aim: Aim, followed: MarkersFollowed
) -> tuple[SteeringSettings, Halt | None]:
    """Return the settings with target and obstacles where they are now, and why the needle has to stop, if it has to.

    `aim` has them where they were at the start. They stay where they were planned with last if they overlap now.
    """
    at_start = replace(settings.problem, target_mm=aim.target_mm, obstacles=aim.obstacles)
    try:
        problem = displace_problem(at_start, followed.displacements)
    except InputError as error:
        return settings, followed.halt or Halt("blocked", f"with what the markers have moved {error.message}")
    return replace(settings, problem=problem), followed.halt


def _require_marker(fix: MarkerFix, place: MarkerPlace | None, view: MarkerView) -> MarkerPlace:
    """Return the place of a marker; refuse one that was not found, or has another size than the protocol says."""
    name = f"marker {fix.marker_id} of {view.markers.dictionary}"
    if place is None:
        raise TargetMissedError(
            f"{name} is missing: {fix.reason} in the picture taken before the needle moves",
            "lay it where the camera sees all of it with its white rim, evenly lit, and only once",
            reason="no_marker",
        )
    stated_mm = view.markers.side_mm
    if abs(place.side_mm - stated_mm) > _SIDE_SHARE * stated_mm:
        raise TargetMissedError(
            f"{name} is seen with sides of {place.side_mm:.2f} mm, and markers.side_mm is {stated_mm:g}",
            "measure the black square with a caliper, and state how far from the steering plane it lies "
            "(markers.x_mm, negative towards the camera)",
            reason="no_marker",
        )
    return place
