"""The printed markers of an insertion: where they are before it, and how far each has moved, picture by picture.

The last believed sighting counts. While a marker is not seen, its displacement is held and becomes less certain with
each millimetre that the needle moves. A sighting beyond what that allows is not believed; if the next picture shows the
marker there too, it has been moved, and the needle stops. So it does if the marker is not seen for too long.

The recorded events are all that is needed to go on: a live insertion and its analysis follow the markers by this.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

from labrig.errors import InputError, Problem, TargetMissedError
from labrig.experiments.insertion.aim import Aim
from labrig.experiments.insertion.ending import Ending
from labrig.experiments.insertion.events import MarkersSought, RecordedMarker, SeenMarker
from labrig.experiments.insertion.protocol import InsertionProtocol, Markers
from labrig.steering.policy import Halt, SteeringSettings
from labrig.steering.problem import Obstacle, Point
from labrig.vision.marker import MarkerFix, MarkerPlace, count_bits, count_markers, locate_marker
from labrig.vision.out_of_plane import Perspective
from labrig.vision.plane import PlaneMap

# A marker that is seen larger or smaller by more lies beside where markers.x_mm puts it, or was printed otherwise.
_SIDE_SHARE = 0.05
# Smallest size of a bit in the picture. In the simulated world 150 of 150 markers of six dictionaries are read at this
# size, and at 3 px 22 of 25 of DICT_4X4_50.
_LEAST_BIT_PX = 3.5
# A marker is at least this share of the camera's height away from the camera.
_NEAREST = 0.1
# A marker that was not seen may have moved by so many standard deviations of its displacement.
_SIGMAS = 3.0


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
    height_mm = None if perspective is None else perspective.height_mm
    if markers.x_mm != 0.0 and (height_mm is None or markers.x_mm <= (_NEAREST - 1.0) * height_mm):
        camera = "is at an unknown height" if height_mm is None else f"is {height_mm:.0f} mm before it"
        yield Problem(
            "markers.x_mm",
            f"the markers lie {markers.x_mm:g} mm from the plane, and the camera {camera}",
            "state how far they are from the plane, negative towards the camera, or calibrate the camera's intrinsics",
        )


def list_marker_ids(protocol: InsertionProtocol) -> tuple[int | None, ...]:
    """Return the markers that target and obstacles are bound to, as `InsertionStart` has them; empty without any."""
    return () if protocol.markers is None else tuple(place.marker_id for place in protocol.places.values())


def find_target_sd_mm(protocol: InsertionProtocol, followed: "FollowedMarkers | None") -> float:
    """Return the standard deviation of the target's place along each axis: as stated, and by its marker, if any.

    Before the markers are followed (None) that is by a marker that is seen.
    """
    if protocol.markers is None or protocol.target.marker_id is None:
        return protocol.target.sd_mm
    markers = () if followed is None else followed.last
    seen = (marker.sd_mm for marker in markers if marker.marker_id == protocol.target.marker_id)
    return math.hypot(protocol.target.sd_mm, next(seen, protocol.markers.sd_mm))


def locate_places(aim: Aim, bound: Sequence[int | None], markers: Sequence[SeenMarker]) -> Aim:
    """Return target and obstacles where the markers that they are bound to have moved them.

    Parameters
    ----------
    aim : Aim
        Where they were at the start.
    bound : sequence of int or None
        The markers of the target and of each obstacle, the target's first; empty without markers.
    markers : sequence of SeenMarker
        After the last picture.
    """
    moved = {marker.marker_id: marker.displacement_mm for marker in markers}
    target_by, *obstacles_by = bound or (None,) * (1 + len(aim.obstacles))

    def move(place_mm: Point, by: int | None) -> Point:
        x, y, z = place_mm
        along_y, along_z = (0.0, 0.0) if by is None else moved.get(by, (0.0, 0.0))
        return x, y + along_y, z + along_z

    obstacles = (
        Obstacle(move(obstacle.position_mm, by), obstacle.radius_mm)
        for obstacle, by in zip(aim.obstacles, obstacles_by, strict=True)
    )
    return Aim(move(aim.target_mm, target_by), tuple(obstacles))


@dataclass(frozen=True, eq=False)
class FollowedMarkers:
    """The markers of an insertion after its pictures so far.

    Attributes
    ----------
    markers : Markers
        How they were printed, and how far they are trusted.
    bound : tuple of int or None
        As in `locate_places`.
    plane : PlaneMap
    sought : tuple of MarkersSought
        What each picture showed; the first says where the markers start.
    halt : Halt or None
        Why the needle has to stop; None if it need not.
    """

    markers: Markers
    bound: tuple[int | None, ...]
    plane: PlaneMap
    sought: tuple[MarkersSought, ...] = ()
    halt: Halt | None = None

    @classmethod
    def of(cls, protocol: InsertionProtocol, plane: PlaneMap) -> Self | None:
        """Return the markers of a protocol before the first picture; None if it has none."""
        return None if protocol.markers is None else cls(protocol.markers, list_marker_ids(protocol), plane)

    @property
    def marker_ids(self) -> list[int]:
        """The ids of all markers, in order."""
        return sorted({marker_id for marker_id in self.bound if marker_id is not None})

    @property
    def last(self) -> Sequence[RecordedMarker]:
        """The markers after the last picture; none before the first."""
        return self.sought[-1].markers if self.sought else ()

    @property
    def doubt(self) -> Ending | None:
        """Why places are not known after the last picture, when none follows that could tell whether a jump stays."""
        if self.halt is not None:
            return Ending("stopped", self.halt.reason, self.halt.detail)
        for marker in self.last:
            if marker.place_mm is not None and not marker.believed:
                detail = f"in the last picture marker {marker.marker_id} is not where it was before"
                return Ending("stopped", "marker_jumped", detail)
        return None

    def take(self, found: Sequence[MarkerFix], trial: int, frame: int, depth_mm: float) -> Self:
        """Return the markers after a picture at an insertion length, which shows this of them.

        Raises
        ------
        TargetMissedError
            When one is not seen in the first picture, or is seen in another size than the protocol says.
        """
        halts = list[Halt]()
        if not self.sought:
            markers = tuple(map(self._begin, found))
        else:
            advanced_mm, last = abs(depth_mm - self.sought[-1].depth_mm), self.last
            pairs = zip(self.sought[0].markers, last, found, strict=True)
            markers = tuple(self._follow(*pair, advanced_mm, halts) for pair in pairs)
        event = MarkersSought(trial=trial, frame=frame, depth_mm=depth_mm, markers=markers)
        return replace(self, sought=(*self.sought, event), halt=self.halt or next(iter(halts), None))

    def place(self, settings: SteeringSettings, aim: Aim) -> tuple[SteeringSettings, Halt | None]:
        """Return the settings with target and obstacles where they are now, and why the needle has to stop.

        `aim` has them where they were at the start. They stay where they were planned with last if they overlap now.
        """
        moved = locate_places(aim, self.bound, self.last)
        sds_mm = {marker.marker_id: marker.sd_mm for marker in self.last}
        obstacle_sds_mm = tuple(0.0 if by is None else sds_mm[by] for by in self.bound[1:])
        try:
            problem = replace(settings.problem, **vars(moved), obstacle_sds_mm=obstacle_sds_mm)
        except InputError as error:
            blocked = Halt("blocked", f"with what the markers have moved {error.message}")
            return settings, self.halt or blocked
        return replace(settings, problem=problem), self.halt

    def _begin(self, fix: MarkerFix) -> RecordedMarker:
        """Return a marker before the needle moves; refuse one that is not seen, or has another size than stated."""
        place, stated_mm, wrong = self._locate(fix), self.markers.side_mm, None
        if place is None:
            wrong = f"is missing: {fix.reason} in the picture taken before the needle moves"
            hint = "lay it where the camera sees all of it with its white rim, evenly lit, and only once"
        elif abs(place.side_mm - stated_mm) > _SIDE_SHARE * stated_mm:
            wrong = f"is seen with sides of {place.side_mm:.2f} mm, and markers.side_mm is {stated_mm:g}"
            hint = (
                "measure the black square with a caliper, and state how far from the steering plane it lies "
                "(markers.x_mm, negative towards the camera)"
            )
        if wrong is not None:
            name = f"marker {fix.marker_id} of {self.markers.dictionary}"
            raise TargetMissedError(f"{name} {wrong}", hint, reason="no_marker")
        return self._describe(fix, place, (0.0, 0.0), 0.0, believed=True)

    def _follow(
        self,
        first: RecordedMarker,
        before: RecordedMarker,
        fix: MarkerFix,
        advanced_mm: float,
        halts: list[Halt],
    ) -> RecordedMarker:
        """Return a marker in another picture; add why the needle has to stop, if it has to."""
        trust, place, name = self.markers, self._locate(fix), f"marker {fix.marker_id}"
        unseen_mm, moved_mm, believed = before.unseen_mm + advanced_mm, before.displacement_mm, False
        if place is not None:
            assert first.place_mm is not None
            seen_mm = place.centre_mm[0] - first.place_mm[0], place.centre_mm[1] - first.place_mm[1]
            jumped_mm = math.dist(seen_mm, moved_mm)
            allowed_mm = trust.jump_mm + _SIGMAS * trust.lost_sd_mm_per_mm * unseen_mm
            believed, old_mm = jumped_mm <= allowed_mm, before.place_mm
            if believed:
                moved_mm, unseen_mm = seen_mm, 0.0
            elif not before.believed and old_mm and math.dist(place.centre_mm, old_mm) <= trust.jump_mm:
                detail = (
                    f"{name} has jumped by {jumped_mm:.1f} mm and stays there, and {allowed_mm:.1f} mm are allowed "
                    "(markers.jump_mm): the gel slid, or somebody moved it"
                )
                halts.append(Halt("marker_jumped", detail))
        if unseen_mm > trust.most_lost_mm:
            detail = (
                f"{name} was not seen while the needle moved by {unseen_mm:.1f} mm, and {trust.most_lost_mm:g} mm are "
                "allowed (markers.most_lost_mm)"
            )
            halts.append(Halt("marker_lost", detail))
        return self._describe(fix, place, moved_mm, unseen_mm, believed=believed)

    def _locate(self, fix: MarkerFix) -> MarkerPlace | None:
        """Return where a marker is; None if it was not found."""
        if fix.corners_px is None:
            return None
        return locate_marker(fix.corners_px, self.plane, self.markers.x_mm)

    def _describe(
        self,
        fix: MarkerFix,
        place: MarkerPlace | None,
        moved_mm: tuple[float, float],
        unseen_mm: float,
        *,
        believed: bool,
    ) -> RecordedMarker:
        return RecordedMarker(
            marker_id=fix.marker_id,
            corners_px=None if fix.corners_px is None else fix.corners_px.tolist(),
            place_mm=None if place is None else place.centre_mm,
            reason=fix.reason,
            believed=believed,
            displacement_mm=moved_mm,
            sd_mm=math.hypot(self.markers.sd_mm, self.markers.lost_sd_mm_per_mm * unseen_mm),
            unseen_mm=unseen_mm,
        )
