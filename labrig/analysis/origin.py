"""The sheath's pose in each trial, found in a picture once the sheath is in, and compared with the command.

The command fixes the origin and direction of the plane when the camera is calibrated, but the sheath has a pose of its
own in every trial. Its tip and heading are found before the needle leaves it, by the functions that serve the live run
too. The expected tip is the origin, shifted by the linear encoder's reading less the depth that belongs to the origin.

A deviation is judged by its direction, because the causes differ:

- **Along the insertion** the encoder measures. A sheath that slipped in its clamp, or a bumped camera, deviates by more
  than the encoder's errors and the zero that was set by eye.
- **Across it** the sheath has play in its guide, from hole to hole. The needle goes where the sheath goes, and the
  measured pose is used, so play costs nothing. Only a deviation that no play explains is refused.
- **A turned** sheath is bent, or the camera was turned.

So even the first trial can be refused. From three trials on, each is also compared with the median of all, which finds
a slip that the zero set by eye hides. Without `sheath.origin` in the protocol the median is the only check.
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

# The fewest trials for a median.
_LEAST_TRIALS = 3
_COMMAND = "origin and linear encoder put it"
_OTHERS = "linear encoder and the other trials put it"


@dataclass(frozen=True)
class _Deviation:
    """Deviation of a sheath from its expected pose: along the insertion, across it towards +y, and in heading."""

    along_mm: float
    across_mm: float
    turn_rad: float

    def list_reasons(self, limits: SheathOrigin, by: str) -> Iterator[str]:
        """Yield a sentence for each limit that is exceeded; `by` names the source of the expected pose."""
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


def compare_with_command(
    pose: SheathPose, sheath: Sheath, linear_mm: float, *, trial: int, frame: int
) -> TrialOrigin:
    """Return the sheath's pose in a trial, compared with the command if the protocol sets limits.

    Parameters
    ----------
    pose : SheathPose
        Pose found in picture number `frame`.
    linear_mm : float
        The linear encoder's reading there.
    """
    beyond_mm = linear_mm - sheath.origin_depth_mm
    off = _Deviation(pose.tip_mm[1] - beyond_mm, pose.tip_mm[0], pose.heading_rad)
    is_limited = sheath.origin is not None
    reasons = tuple(off.list_reasons(sheath.origin, _COMMAND)) if sheath.origin is not None else ()
    return TrialOrigin(
        trial=trial,
        frame=frame,
        tip_mm=pose.tip_mm,
        tip_px=pose.tip_px,
        heading_rad=pose.heading_rad,
        linear_mm=linear_mm,
        expected_mm=(0.0, beyond_mm) if is_limited else None,
        along_mm=off.along_mm if is_limited else None,
        across_mm=off.across_mm if is_limited else None,
        disagreement_mm=math.hypot(off.along_mm, off.across_mm) if is_limited else None,
        accepted=not reasons,
        reason=" ".join(reasons) or None,
    )


def find_origins(
    read: ReadFrame, lines: Iterable[FrameLine], plane: PlaneMap, sheath: Sheath
) -> tuple[TrialOrigin, ...]:
    """Find the sheath in the picture of each trial that shows only it; compare it with command and other trials.

    Parameters
    ----------
    read : callable
        Returns the picture of a frame number.
    lines : iterable of FrameLine
        Lines of the pictures that show only the sheath; those without a trial are skipped.
    """
    found = [_read_origin(read, line, plane, sheath) for line in lines if line.trial is not None]
    return tuple(_compare_with_others(found, sheath))


def find_sheath(
    image: Picture, plane: PlaneMap, sheath: Sheath, linear_mm: float, *, trial: int, frame: int
) -> TrialOrigin:
    """Return the sheath's pose in a picture that shows only it; a refused origin if it is not found.

    Parameters
    ----------
    linear_mm : float
        The linear encoder's reading at the exposure.
    """
    try:
        pose = measure_sheath(image, plane, sheath.diameter_mm)
    except MeasurementRefusedError as refusal:
        return _refuse_origin(refusal.message, trial=trial, frame=frame)
    return compare_with_command(pose, sheath, linear_mm, trial=trial, frame=frame)


def lateral_offset_mm(tip_mm: Point, origin: TrialOrigin | None) -> float:
    """Return the offset of a tip from the sheath's axis, or without an origin from the plane's; positive towards +y."""
    if origin is None or origin.tip_mm is None or origin.heading_rad is None:
        return tip_mm[0]
    return to_origin_frame(tip_mm, origin.tip_mm, origin.heading_rad)[0]


def to_origin_frame(point_mm: Point, origin_mm: Point, heading_rad: float) -> Point:
    """Return a point of the plane as (lateral, along) relative to an origin with a heading; left is positive.

    For a heading of zero these are y and z relative to the origin.
    """
    y, z = point_mm[0] - origin_mm[0], point_mm[1] - origin_mm[1]
    sine, cosine = math.sin(heading_rad), math.cos(heading_rad)
    return y * cosine - z * sine, y * sine + z * cosine


def _read_origin(read: ReadFrame, line: FrameLine, plane: PlaneMap, sheath: Sheath) -> TrialOrigin:
    """Return the sheath's pose in a recorded picture; a refused origin if it is not found."""
    place = {"trial": line.trial or 0, "frame": line.frame}
    if line.linear_mm is None:
        return _refuse_origin("its line does not say where the linear axis stood", **place)
    try:
        return find_sheath(read(line.frame), plane, sheath, line.linear_mm, **place)
    except (PictureError, RecordError) as refusal:
        return _refuse_origin(refusal.message, **place)


def _refuse_origin(why: str, *, trial: int, frame: int) -> TrialOrigin:
    """Return the origin of a trial whose picture does not show the sheath."""
    reason = f"The sheath's tip was not found in frame {frame}: {why}."
    return TrialOrigin(trial=trial, frame=frame, accepted=False, reason=reason)


def _compare_with_others(found: Sequence[TrialOrigin], sheath: Sheath) -> list[TrialOrigin]:
    """Return the origins, each also compared with the median of the accepted ones if there are enough."""
    poses = [_invariant_pose(origin) for origin in found]
    good = [pose for origin, pose in zip(found, poses, strict=True) if origin.accepted and pose is not None]
    if len(good) < _LEAST_TRIALS:
        return list(found)
    median = np.median(good, axis=0)
    return [
        origin if pose is None else _add_comparison(origin, _Deviation(*(pose - median).tolist()), sheath)
        for origin, pose in zip(found, poses, strict=True)
    ]


def _invariant_pose(origin: TrialOrigin) -> NDArray[np.float64] | None:
    """Return what is equal in all trials: tip less travel along, tip across, and heading; None if not found."""
    if origin.tip_mm is None or origin.linear_mm is None or origin.heading_rad is None:
        return None
    return np.array((origin.tip_mm[1] - origin.linear_mm, origin.tip_mm[0], origin.heading_rad))


def _add_comparison(origin: TrialOrigin, off: _Deviation, sheath: Sheath) -> TrialOrigin:
    reasons = tuple(off.list_reasons(sheath.origin or SheathOrigin(), _OTHERS))
    apart_mm = math.hypot(off.along_mm, off.across_mm)
    disagreement_mm = origin.disagreement_mm if origin.expected_mm else apart_mm
    update: dict[str, object] = {"from_others_mm": apart_mm, "disagreement_mm": disagreement_mm}
    if origin.accepted and reasons:
        update |= {"accepted": False, "reason": " ".join(reasons)}
    return origin.model_copy(update=update)
