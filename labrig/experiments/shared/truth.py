"""Compares the measurements with the truth of the simulated world; only this module reads the truth."""

from collections.abc import Mapping, Sequence

import numpy as np

from labrig.analysis.statistics import compute_spread
from labrig.experiments.shared.curvature_result import (
    PictureResult,
    SpecimenResult,
    SpecimenTruth,
    TruthComparison,
)
from labrig.experiments.shared.grouping import group_trials
from labrig.experiments.shared.needle_events import SpecimenTrialStart


def compare_with_truth(
    trials: Sequence[SpecimenTrialStart],
    finals: Mapping[int, PictureResult],
    specimens: Sequence[SpecimenResult],
    drawn_mm: Mapping[int, float],
) -> TruthComparison | None:
    """Return the comparison; None if no truth is recorded of any trial.

    Parameters
    ----------
    drawn_mm : Mapping
        The radius drawn for each trial. The error of a mean is taken from the mean of all radii drawn for
        that gel, refused pictures included, so that refusing difficult pictures cannot improve it.
    """
    if not drawn_mm:
        return None
    errors = {
        trial: picture.radius_mm - drawn_mm[trial]
        for trial, picture in finals.items()
        if picture.accepted and picture.radius_mm is not None and trial in drawn_mm
    }
    measured = {(specimen.needle_id, specimen.name): specimen.mean_radius_mm for specimen in specimens}
    compared = tuple(
        _compare(group, measured[pair], errors, drawn_mm)
        for pair, group in group_trials(trials).items()
        if any(trial.trial in drawn_mm for trial in group)
    )
    if not compared:
        return None
    return TruthComparison(
        specimens=compared,
        mean_radius_mm=float(np.mean([comparison.drawn_mean_radius_mm for comparison in compared])),
        worst_error_of_mean_mm=_find_largest(
            [
                comparison.error_of_mean_mm
                for comparison in compared
                if comparison.error_of_mean_mm is not None
            ]
        ),
        pictures=len(errors),
        worst_error_mm=_find_largest(list(errors.values())),
        intervals_holding_truth=sum(_covers(finals[trial], drawn_mm[trial]) for trial in errors),
    )


def _compare(
    group: Sequence[SpecimenTrialStart],
    mean_mm: float | None,
    errors: Mapping[int, float],
    drawn_mm: Mapping[int, float],
) -> SpecimenTruth:
    radii = [drawn_mm[trial.trial] for trial in group if trial.trial in drawn_mm]
    drawn_mean_mm = float(np.mean(radii))
    return SpecimenTruth(
        name=group[0].specimen,
        needle_id=group[0].needle_id,
        n_drawn=len(radii),
        drawn_mean_radius_mm=drawn_mean_mm,
        drawn_sd_radius_mm=compute_spread(radii).sd,
        error_of_mean_mm=None if mean_mm is None else mean_mm - drawn_mean_mm,
        worst_error_mm=_find_largest([errors[trial.trial] for trial in group if trial.trial in errors]),
    )


def _find_largest(errors: Sequence[float]) -> float | None:
    """Return the error with the largest magnitude, with its sign."""
    return max(errors, key=abs, default=None)


def _covers(picture: PictureResult, drawn_mm: float) -> bool:
    interval = picture.radius_ci95_mm
    return interval is not None and interval[0] <= drawn_mm <= interval[1]
