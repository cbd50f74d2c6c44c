"""Where the sheath's tip stands in each trial, from the picture taken once it is in, beside what the encoder says.

The plane's origin is fixed when the camera is calibrated; the sheath stands anew in every trial. Its tip and direction
are found in the picture of role "sheath", before the needle leaves it. What the trials have in common, tip minus travel
of the linear module, is their median; a trial that is further from it than the sheath can be was measured through a
bumped camera or with a sheath that slipped, and its radii are refused. The tip is where the darkness ends: for a blunt
end some tenths of a millimetre late, the same in all trials.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labrig.analysis.result import PictureResult, Point, TrialOrigin
from labrig.errors import MeasurementRefusedError, PictureError, RecordError
from labrig.vision import Picture, PlaneMap, measure_shaft_tip

ReadFrame = Callable[[int], Picture]

SHEATH_ROLE = "sheath"
_LARGEST_DISAGREEMENT_MM = 1.0
# Trials that a median takes to speak against one of them.
_LEAST_TRIALS = 3


@dataclass(frozen=True)
class _Sheath:
    """The sheath of one trial: tip (y, z), pixel (u, v), heading and travel of the linear module."""

    line: Mapping[str, Any]
    tip_mm: Point
    tip_px: Point
    heading_rad: float

    @property
    def offset_mm(self) -> tuple[float, float]:
        """Return the tip less the travel, the same in every trial."""
        return self.tip_mm[0], self.tip_mm[1] - float(self.line["linear_mm"])


def find_origins(
    read: ReadFrame, lines: Iterable[Mapping[str, Any]], plane: PlaneMap, sheath_diameter_mm: float | None
) -> tuple[TrialOrigin, ...]:
    """Find the sheath in the picture of each trial that shows it alone.

    Parameters
    ----------
    read : callable
        Gives the picture of a frame number.
    lines : iterable of Mapping
        Of frames.jsonl; those of another role are passed over.
    sheath_diameter_mm : float or None
        None for pictures without a sheath: there is nothing to find then.
    """
    if sheath_diameter_mm is None:
        return ()
    wanted = [line for line in lines if line["role"] == SHEATH_ROLE and line.get("trial") is not None]
    found = [_found(read, line, plane, sheath_diameter_mm) for line in wanted]
    sheaths = [one for one in found if isinstance(one, _Sheath)]
    return tuple(_judged(one, sheaths) if isinstance(one, _Sheath) else one for one in found)


def refused_by_origin(
    results: Sequence[PictureResult], origins: Sequence[TrialOrigin]
) -> tuple[PictureResult, ...]:
    """Return the pictures, those of a trial whose sheath disagrees with the encoder refused."""
    reasons = {
        one.trial: one.reason for one in origins if one.disagreement_mm is not None and not one.accepted
    }
    return tuple(
        one.model_copy(update={"accepted": False, "reason": reasons[one.trial]})
        if one.trial in reasons and one.accepted
        else one
        for one in results
    )


def _found(
    read: ReadFrame, line: Mapping[str, Any], plane: PlaneMap, diameter_mm: float
) -> "_Sheath | TrialOrigin":
    """Return the sheath in a picture, or a refused origin where it is not seen."""
    try:
        tip = measure_shaft_tip(read(int(line["frame"])), plane, diameter_mm, None)
    except (MeasurementRefusedError, PictureError, RecordError) as refusal:
        reason = f"The sheath's tip was not found in frame {line['frame']}: {refusal.message}."
        return TrialOrigin(trial=int(line["trial"]), frame=int(line["frame"]), accepted=False, reason=reason)
    return _Sheath(line, tip.tip_mm, tip.tip_px, tip.heading_rad)


def _judged(one: _Sheath, all_of_them: Sequence[_Sheath]) -> TrialOrigin:
    off: float | None = None
    if len(all_of_them) >= _LEAST_TRIALS:
        common = np.median([each.offset_mm for each in all_of_them], axis=0)
        off = float(np.hypot(*(np.array(one.offset_mm) - common)))
    refused = off is not None and off > _LARGEST_DISAGREEMENT_MM
    reason = (
        f"The sheath's tip is {off:.2f} mm from where the linear encoder and the other trials put it, and "
        f"{_LARGEST_DISAGREEMENT_MM:g} mm is the most: the camera was bumped, or the sheath slipped."
        if refused
        else None
    )
    return TrialOrigin(
        trial=int(one.line["trial"]),
        frame=int(one.line["frame"]),
        tip_mm=one.tip_mm,
        tip_px=one.tip_px,
        heading_rad=one.heading_rad,
        linear_mm=float(one.line["linear_mm"]),
        disagreement_mm=off,
        accepted=not refused,
        reason=reason,
    )
