"""The markers of a recorded insertion, followed again by their recorded corners."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labrig.experiments.insertion.aim import Aim
from labrig.experiments.insertion.events import InsertionEvent, InsertionStart, MarkersSought, TipObserved
from labrig.experiments.insertion.marker_view import (
    MarkersFollowed,
    MarkerView,
    find_start,
    follow_markers,
    place_settings,
)
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.result import MarkerStep
from labrig.steering.policy import SteeringSettings
from labrig.vision.marker import MarkerFix
from labrig.vision.plane import PlaneMap


@dataclass(frozen=True, eq=False)
class MarkerHistory:
    """The markers after each picture of an insertion in which they were sought, by its frame; empty without markers."""

    start: InsertionStart
    followed: Mapping[int, MarkersFollowed]
    steps: tuple[MarkerStep, ...]

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
            settings = self.place_at(frame, settings)
        return settings

    def place_at(self, frame: int, settings: SteeringSettings) -> SteeringSettings:
        """Return the settings after a picture, as they steered."""
        followed = self.followed.get(frame)
        if followed is None:
            return settings
        aim = Aim(self.start.target_mm, self.start.obstacles)
        return place_settings(settings, aim, followed)[0]

    def place_at_end(self, settings: SteeringSettings) -> SteeringSettings:
        """Return the settings after the last picture."""
        for frame in self.followed:
            settings = self.place_at(frame, settings)
        return settings


def follow_recorded(
    protocol: InsertionProtocol, plane: PlaneMap, start: InsertionStart, events: Sequence[MarkersSought]
) -> MarkerHistory:
    """Follow the markers again, as the live insertion did."""
    view, last = MarkerView.of(protocol, plane), None
    followed, steps = dict[int, MarkersFollowed](), list[MarkerStep]()
    for event in events if view is not None else ():
        assert view is not None
        fixes = [
            MarkerFix(
                marker.marker_id,
                None if marker.corners_px is None else np.array(marker.corners_px),
                marker.reason,
            )
            for marker in event.markers
        ]

        def search(
            _dictionary: object, _ids: object, found: Sequence[MarkerFix] = fixes
        ) -> Sequence[MarkerFix]:
            return found

        last = find_start(search, view) if last is None else follow_markers(last, search, event.depth_mm)
        followed[event.frame] = last
        steps += (
            MarkerStep(
                frame=event.frame, depth_mm=event.depth_mm, **marker.model_dump(exclude={"corners_px"})
            )
            for marker in last.make_event(start.trial, event.frame, event.depth_mm).markers
        )
    return MarkerHistory(start, followed, tuple(steps))
