"""What a campaign is told of a virtual run of one insertion: the world's truth, and what the last picture says."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from labrig.experiments.insertion.events import BevelTurn, InsertionStart, InsertionStop, PathSought
from labrig.record.events import Event


def tell_values(
    events: Iterable[Event], truths: Sequence[Mapping[str, Any]]
) -> Mapping[str, float | int | bool | str | None]:
    """Return the quantities of the first insertion of a run, from its events and truths; none if it was not made.

    `true_` is the world's truth: the distance from the target in space, in the plane and across it, and the least
    clearance of an obstacle. `broken_off`: the needle was stopped on the way, as no path was left or it was lost; the
    distance is then what was left of the way. `target_error_mm` and its interval are what the last picture tells.
    `target_` is where the target was told to be.
    """
    made = list(events)
    start = next((event for event in made if isinstance(event, InsertionStart)), None)
    stop = next((event for event in made if isinstance(event, InsertionStop)), None)
    if start is None or stop is None or not truths or truths[0]["target_mm"] is None:
        return {}
    way = made[: made.index(stop)]
    turns = sum(isinstance(event, BevelTurn) for event in way)
    refusals = [event.refusal for event in way if isinstance(event, PathSought)]
    truth = truths[0]
    off_mm = np.array((truth["tip_x_mm"], *truth["tip_mm"])) - truth["target_mm"]
    low_mm, high_mm = stop.interval_mm or (None, None)
    x_mm, y_mm, z_mm = start.target_mm
    return {
        "true_target_error_mm": truth["true_target_error_mm"],
        "true_in_plane_error_mm": math.hypot(*off_mm[1:]),
        "true_out_of_plane_mm": abs(float(off_mm[0])),
        "true_min_clearance_mm": truth["true_min_clearance_mm"],
        "target_error_mm": stop.error_mm,
        "target_error_low_mm": low_mm,
        "target_error_high_mm": high_mm,
        "reached": None if stop.outcome == "reached_in_plane_only" else stop.outcome == "reached",
        "broken_off": stop.outcome == "stopped" or refusals[-1] is not None,
        "replans": stop.replans,
        "turns": turns,
        "length_mm": stop.depth_mm,
        "target_x_mm": x_mm,
        "target_y_mm": y_mm,
        "target_z_mm": z_mm,
    }
