"""What is known of a trial or of a whole run, carried into the results of its pictures: origin, refusal, drift."""

from collections.abc import Sequence

import numpy as np

from labrig.analysis.origin import to_origin_frame
from labrig.analysis.result import Sentinel, TrialOrigin
from labrig.experiments.shared.curvature_result import PictureResult

_TWO_SIDED_95 = 1.96


def refuse_by_origin(
    results: Sequence[PictureResult], origins: Sequence[TrialOrigin]
) -> tuple[PictureResult, ...]:
    """Return the pictures, those of a trial whose sheath stands elsewhere than it should refused."""
    reasons = {one.trial: one.reason for one in origins if one.tip_mm is not None and not one.accepted}
    return tuple(
        one.model_copy(update={"accepted": False, "reason": reasons[one.trial]})
        if one.trial in reasons and one.accepted
        else one
        for one in results
    )


def add_origins(
    results: Sequence[PictureResult], origins: Sequence[TrialOrigin]
) -> tuple[PictureResult, ...]:
    """Return the pictures with the origin that holds for each, and the needle's tip told from it.

    It is the one of the trial; of an imported picture the sheath's end in that picture.
    """
    by_trial = {one.trial: one for one in origins}
    return tuple(_add_origin(one, None if one.trial is None else by_trial.get(one.trial)) for one in results)


def _add_origin(one: PictureResult, origin: TrialOrigin | None) -> PictureResult:
    place, heading_rad = (
        (one.sheath_tip_mm, one.sheath_heading_rad) if origin is None else (origin.tip_mm, origin.heading_rad)
    )
    if place is None or heading_rad is None:
        return one
    known: dict[str, object] = {"origin_mm": place, "origin_heading_rad": heading_rad}
    if one.tip_mm is not None:
        known["tip_from_origin_mm"] = to_origin_frame(one.tip_mm, place, heading_rad)
    return one.model_copy(update=known)


def add_drift(results: Sequence[PictureResult], sentinel: Sentinel | None) -> tuple[PictureResult, ...]:
    """Return the pictures with the drift in their error bars, or refused."""
    if sentinel is None:
        return tuple(results)
    if not sentinel.accepted:
        refused = {"accepted": False, "reason": sentinel.reason}
        return tuple(one.model_copy(update=refused) if one.accepted else one for one in results)
    return tuple(_widen(one, sentinel.drift or 0.0) for one in results)


def _widen(one: PictureResult, drift: float) -> PictureResult:
    """Return a picture whose radius may be off by the drift as well, taken as one standard deviation."""
    if one.radius_mm is None or one.sigma_radius_mm is None or not drift:
        return one
    more = drift * one.radius_mm
    update: dict[str, object] = {"sigma_radius_mm": float(np.hypot(one.sigma_radius_mm, more))}
    if one.radius_ci95_mm is not None:
        low, high = (abs(end - one.radius_mm) for end in one.radius_ci95_mm)
        reach = _TWO_SIDED_95 * more
        update["radius_ci95_mm"] = (
            one.radius_mm - float(np.hypot(low, reach)),
            one.radius_mm + float(np.hypot(high, reach)),
        )
    return one.model_copy(update=update)
