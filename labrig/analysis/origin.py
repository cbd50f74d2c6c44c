"""Where the sheath stands in each trial, found in the picture taken once it is in, beside what was commanded.

The plane's origin and its direction are the command's, fixed when the camera was calibrated; the sheath stands anew in
every trial. Its tip and heading are found before the needle leaves it, by the functions that serve the live run too.
Expected is the tip at the origin, further on by what the linear encoder says beyond the depth that belongs to the
origin.

What is off is judged by where it points, because the causes differ:

- **Along the insertion** the encoder measures. A sheath that slipped in its clamp, or a camera that was bumped, is
  further off than the encoder's errors and the zero that was set by eye.
- **Across it** the sheath has play in its guide, from hole to hole. The needle goes where the sheath goes, and what is
  found is reckoned with, so that play costs nothing; only what no play explains is refused.
- **A turned** sheath is bent, or it is the camera that was turned.

The first trial can be refused by that. What the trials have in common is their median: from three on each is compared
with it as well, which finds a slip that the eye's zero hides. Without `sheath.origin` in the protocol the median is
all there is.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.result import Point, TrialOrigin
from labrig.errors import MeasurementRefusedError, PictureError, RecordError
from labrig.protocol.sections import Sheath, SheathOrigin
from labrig.record.events import FrameLine
from labrig.vision.picture import Picture
from labrig.vision.plane import PlaneMap
from labrig.vision.sheath import SheathPose, measure_sheath

ReadFrame = Callable[[int], Picture]

# Trials that a median takes to speak against one of them.
_LEAST_TRIALS = 3
_COMMAND = "origin and linear encoder put it"
_OTHERS = "linear encoder and the other trials put it"


@dataclass(frozen=True)
class _Off:
    """How far a sheath is from where it should be: beyond it along the insertion, to the side of +y, and turned."""

    along_mm: float
    across_mm: float
    turn_rad: float

    def reasons(self, limits: SheathOrigin, by: str) -> Iterator[str]:
        """Yield a sentence for each limit that is passed; `by` says what put the sheath where it should be."""
        if abs(self.along_mm) > limits.along_mm:
            where = "beyond" if self.along_mm > 0 else "short of"
            yield (
                f"The sheath's tip is {abs(self.along_mm):.2f} mm {where} where {by}, and {limits.along_mm:g} mm along "
                "the insertion is the most: the sheath slipped, or the camera was bumped."
            )
        if abs(self.across_mm) > limits.across_mm:
            yield (
                f"The sheath's tip is {abs(self.across_mm):.2f} mm aside of where {by}, and {limits.across_mm:g} mm is "
                "the most that its play explains: the camera was bumped, or the sheath is bent."
            )
        if abs(math.degrees(self.turn_rad)) > limits.turn_deg:
            yield (
                f"The sheath heads {abs(math.degrees(self.turn_rad)):.1f} degrees off where {by}, and "
                f"{limits.turn_deg:g} degrees is the most: the camera was turned, or the sheath is bent."
            )


def sheath_origin(
    pose: SheathPose, sheath: Sheath, linear_mm: float, *, trial: int, frame: int
) -> TrialOrigin:
    """Return where the sheath stands in a trial, compared with the command where the protocol says how far is too far.

    Parameters
    ----------
    pose : SheathPose
        As found in the picture of number `frame`.
    linear_mm : float
        The linear encoder's reading there.
    """
    beyond_mm = linear_mm - sheath.origin_depth_mm
    off = _Off(pose.tip_mm[1] - beyond_mm, pose.tip_mm[0], pose.heading_rad)
    known = sheath.origin is not None
    reasons = tuple(off.reasons(sheath.origin, _COMMAND)) if sheath.origin is not None else ()
    return TrialOrigin(
        trial=trial,
        frame=frame,
        tip_mm=pose.tip_mm,
        tip_px=pose.tip_px,
        heading_rad=pose.heading_rad,
        linear_mm=linear_mm,
        expected_mm=(0.0, beyond_mm) if known else None,
        along_mm=off.along_mm if known else None,
        across_mm=off.across_mm if known else None,
        disagreement_mm=math.hypot(off.along_mm, off.across_mm) if known else None,
        accepted=not reasons,
        reason=" ".join(reasons) or None,
    )


def find_origins(
    read: ReadFrame, lines: Iterable[FrameLine], plane: PlaneMap, sheath: Sheath
) -> tuple[TrialOrigin, ...]:
    """Find the sheath in the picture of each trial that shows it alone, and compare it with command and other trials.

    Parameters
    ----------
    read : callable
        Gives the picture of a frame number.
    lines : iterable of FrameLine
        Those of the pictures that show the sheath alone; pictures of no trial are passed over.
    """
    found = [_read_origin(read, line, plane, sheath) for line in lines if line.trial is not None]
    return _told_of_bumps(_beside_others(found, sheath))


def find_sheath(
    image: Picture, plane: PlaneMap, sheath: Sheath, linear_mm: float, *, trial: int, frame: int
) -> TrialOrigin:
    """Return where the sheath stands in a picture that shows it alone; refused where it is not seen.

    Parameters
    ----------
    linear_mm : float
        The linear encoder's reading at the exposure.
    """
    try:
        pose = measure_sheath(image, plane, sheath.diameter_mm)
    except MeasurementRefusedError as refusal:
        return _unseen_origin(refusal.message, trial=trial, frame=frame)
    return sheath_origin(pose, sheath, linear_mm, trial=trial, frame=frame)


def aside_mm(tip_mm: Point, origin: TrialOrigin | None) -> float:
    """Return how far aside of the sheath a tip lies, positive towards +y; of the plane's axis without one."""
    if origin is None or origin.tip_mm is None or origin.heading_rad is None:
        return tip_mm[0]
    return told_from(tip_mm, origin.tip_mm, origin.heading_rad)[0]


def told_from(point_mm: Point, origin_mm: Point, heading_rad: float) -> Point:
    """Return a point of the plane as (aside, along) of an origin with a heading; aside is positive to the left of it.

    For a heading of zero these are its y and z from there.
    """
    y, z = point_mm[0] - origin_mm[0], point_mm[1] - origin_mm[1]
    sine, cosine = math.sin(heading_rad), math.cos(heading_rad)
    return y * cosine - z * sine, y * sine + z * cosine


def _read_origin(read: ReadFrame, line: FrameLine, plane: PlaneMap, sheath: Sheath) -> TrialOrigin:
    """Return the sheath in a recorded picture, or a refused origin where it is not seen."""
    place = {"trial": line.trial or 0, "frame": line.frame}
    if line.linear_mm is None:
        return _unseen_origin("its line does not say where the linear axis stood", **place)
    try:
        return find_sheath(read(line.frame), plane, sheath, line.linear_mm, **place)
    except (PictureError, RecordError) as refusal:
        return _unseen_origin(refusal.message, **place)


def _unseen_origin(why: str, *, trial: int, frame: int) -> TrialOrigin:
    """Return the origin of a trial whose picture does not show the sheath."""
    reason = f"The sheath's tip was not found in frame {frame}: {why}."
    return TrialOrigin(trial=trial, frame=frame, accepted=False, reason=reason)


def _beside_others(found: Sequence[TrialOrigin], sheath: Sheath) -> list[TrialOrigin]:
    """Return the origins, each compared as well with the median of those not refused, where there are enough."""
    stands = [_stand(one) for one in found]
    good = [stand for one, stand in zip(found, stands, strict=True) if one.accepted and stand is not None]
    if len(good) < _LEAST_TRIALS:
        return list(found)
    usual = np.median(good, axis=0)
    return [
        one if stand is None else _beside(one, _Off(*(stand - usual).tolist()), sheath)
        for one, stand in zip(found, stands, strict=True)
    ]


def _stand(one: TrialOrigin) -> NDArray[np.float64] | None:
    """Return what a sheath has in every trial alike: tip less travel along, across, and heading; None if not seen."""
    if one.tip_mm is None or one.linear_mm is None or one.heading_rad is None:
        return None
    return np.array((one.tip_mm[1] - one.linear_mm, one.tip_mm[0], one.heading_rad))


def _beside(one: TrialOrigin, off: _Off, sheath: Sheath) -> TrialOrigin:
    reasons = tuple(off.reasons(sheath.origin or SheathOrigin(), _OTHERS))
    apart_mm = math.hypot(off.along_mm, off.across_mm)
    known = one.model_copy(
        update={
            "from_others_mm": apart_mm,
            "disagreement_mm": one.disagreement_mm if one.expected_mm else apart_mm,
        }
    )
    if not one.accepted or not reasons:
        return known
    return known.model_copy(update={"accepted": False, "reason": " ".join(reasons)})


def _told_of_bumps(origins: Sequence[TrialOrigin]) -> tuple[TrialOrigin, ...]:
    """Return the origins, a refused one told so where each later sheath is refused too: it was no single slip."""
    seen = [one for one in origins if one.tip_mm is not None]
    last_good = max((index for index, one in enumerate(seen) if one.accepted), default=-1)
    since = {one.trial for one in seen[last_good + 1 :]} if len(seen) - last_good > _LEAST_TRIALS else set()
    return tuple(
        one.model_copy(update={"reason": f"{one.reason} So it is in every trial from {min(since)} on."})
        if one.trial in since and one.tip_mm is not None
        else one
        for one in origins
    )
