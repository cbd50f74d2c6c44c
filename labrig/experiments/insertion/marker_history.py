"""The markers of a recorded insertion, measured again from its pictures."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

from labrig.errors import PictureError, RecordError
from labrig.experiments.insertion.aim import Aim
from labrig.experiments.insertion.events import InsertionEvent, InsertionStart, MarkersSought, TipObserved
from labrig.experiments.insertion.marker_view import (
    MarkersFollowed,
    MarkerView,
    find_start,
    follow_markers,
    pass_unread_picture,
    place_settings,
    recall_start,
)
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.result import MarkerMotion, MarkerStep
from labrig.record.reader import Run
from labrig.steering.policy import Halt, SteeringSettings
from labrig.vision.marker import find_markers
from labrig.vision.plane import PlaneMap


@dataclass(frozen=True, eq=False)
class MarkerHistory:
    """The markers after each picture of an insertion in which they were sought, by its frame; empty without markers.

    `depths_mm` are the insertion lengths at these pictures.
    """

    start: InsertionStart
    followed: Mapping[int, MarkersFollowed]
    depths_mm: Mapping[int, float]

    @property
    def last(self) -> MarkersFollowed | None:
        """The markers after the last picture."""
        return self.followed[max(self.followed)] if self.followed else None

    def place_before(self, way: Sequence[InsertionEvent], settings: SteeringSettings) -> SteeringSettings:
        """Return the settings as the first path was planned, before the pictures on the way."""
        on_the_way = {event.frame for event in way if isinstance(event, TipObserved)}
        for frame in self.followed:
            if frame in on_the_way:
                break
            settings, _ = self.place_at(frame, settings)
        return settings

    def place_at(self, frame: int, settings: SteeringSettings) -> tuple[SteeringSettings, Halt | None]:
        """Return the settings after a picture, as they steered, and why the needle has to stop there, if it has to."""
        followed = self.followed.get(frame)
        if followed is None:
            return settings, None
        return place_settings(settings, Aim(self.start.target_mm, self.start.obstacles), followed)

    def place_at_end(self, settings: SteeringSettings) -> SteeringSettings:
        """Return the settings after the last picture."""
        for frame in self.followed:
            settings, _ = self.place_at(frame, settings)
        return settings

    def describe(self) -> dict[str, Any]:
        """Return the fields of the result of an insertion."""
        return {
            "marker_ids": self.start.marker_ids,
            "markers": self._summarise(),
            "marker_steps": self._steps,
        }

    def _summarise(self) -> tuple[MarkerMotion, ...]:
        marker_ids = self.start.marker_ids
        names = ("target", *(f"obstacle {number}" for number in range(1, len(marker_ids))))
        motions = []
        for marker_id in sorted({step.marker_id for step in self._steps}):
            own = [step for step in self._steps if step.marker_id == marker_id]
            bound = [name for name, bound_to in zip(names, marker_ids, strict=True) if bound_to == marker_id]
            motions.append(
                MarkerMotion(
                    marker_id=marker_id,
                    moves=", ".join(bound),
                    displacement_mm=own[-1].displacement_mm,
                    sd_mm=own[-1].sd_mm,
                    farthest_mm=max(math.hypot(*step.displacement_mm) for step in own),
                    pictures=len(own),
                    believed=sum(step.believed for step in own),
                )
            )
        return tuple(motions)

    @cached_property
    def _steps(self) -> tuple[MarkerStep, ...]:
        return tuple(
            step
            for frame, followed in self.followed.items()
            for step in _list_steps(followed, frame, self.depths_mm[frame])
        )


def seek_markers(
    run: Run,
    protocol: InsertionProtocol,
    plane: PlaneMap,
    start: InsertionStart,
    events: Sequence[MarkersSought],
) -> MarkerHistory:
    """Find and follow the markers again in the recorded pictures, as the live insertion did."""
    view, depths_mm = MarkerView.of(protocol, plane), {event.frame: event.depth_mm for event in events}
    if view is None or not events:
        return MarkerHistory(start, {}, {})
    followed = {events[0].frame: _find_start(run, events[0], view)}
    last = followed[events[0].frame]
    for event in events[1:]:
        try:
            last = follow_markers(last, partial(find_markers, run.pictures[event.frame]), event.depth_mm)
        except (PictureError, RecordError) as error:
            last = pass_unread_picture(last, error.message.replace(f"{run.path}/", ""), event.depth_mm)
        followed[event.frame] = last
    return MarkerHistory(start, followed, depths_mm)


def _find_start(run: Run, event: MarkersSought, view: MarkerView) -> MarkersFollowed:
    try:
        image = run.pictures[event.frame]
    except (PictureError, RecordError):
        return recall_start(event, view)
    return find_start(partial(find_markers, image), view)


def _list_steps(followed: MarkersFollowed, frame: int, depth_mm: float) -> Iterator[MarkerStep]:
    starts_mm = {marker.marker_id: marker.start_mm for marker in followed.tracked}
    for marker in followed.make_event(0, frame, depth_mm).markers:
        start_mm, place_mm = starts_mm[marker.marker_id], marker.place_mm
        seen_mm = None if place_mm is None else (place_mm[0] - start_mm[0], place_mm[1] - start_mm[1])
        measured = marker.model_dump(exclude={"corners_px", "place_mm"})
        yield MarkerStep(frame=frame, depth_mm=depth_mm, seen_mm=seen_mm, **measured)
