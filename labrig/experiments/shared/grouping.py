"""Insertions grouped by needle and gel, the paper's needle-tissue pair."""

from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from labrig.analysis.statistics import add_roll_uncertainty, compute_spread
from labrig.experiments.shared.curvature_result import PictureResult, SpecimenResult
from labrig.experiments.shared.needle_events import NeedleRole, SpecimenTrialStart


def find_final_pictures(pictures: Sequence[PictureResult]) -> dict[int, PictureResult]:
    """Return the final picture of each trial that has one."""
    return {
        picture.trial: picture
        for picture in pictures
        if picture.role == NeedleRole.FINAL and picture.trial is not None
    }


def summarise_specimens(
    trials: Sequence[SpecimenTrialStart],
    finals: Mapping[int, PictureResult],
    roll_sd_deg: float = 0.0,
    drawn_mm: Mapping[int, float] = MappingProxyType({}),
) -> tuple[SpecimenResult, ...]:
    """Return the mean, spread and interval of each needle in each specimen, in order of first appearance.

    They are of the accepted radii of final pictures; `drawn_mm` holds the radius that a simulated world drew for each
    trial.
    """
    groups: dict[tuple[str, str], list[SpecimenTrialStart]] = {}
    for trial in trials:
        groups.setdefault(trial.pair, []).append(trial)
    return tuple(_summarise(group, finals, roll_sd_deg, drawn_mm) for group in groups.values())


def _summarise(
    group: Sequence[SpecimenTrialStart],
    finals: Mapping[int, PictureResult],
    roll_sd_deg: float,
    drawn_mm: Mapping[int, float],
) -> SpecimenResult:
    pictures = [finals[trial.trial] for trial in group if trial.trial in finals]
    accepted = [picture for picture in pictures if picture.accepted and picture.radius_mm is not None]
    radii = [picture.radius_mm for picture in accepted if picture.radius_mm is not None]
    reasons = Counter(picture.reason or "no reason given" for picture in pictures if not picture.accepted)
    summary = compute_spread(radii)
    drawn = [drawn_mm[trial.trial] for trial in group if trial.trial in drawn_mm]
    errors = [
        picture.radius_mm - picture.true_radius_mm
        for picture in accepted
        if picture.radius_mm is not None and picture.true_radius_mm is not None
    ]
    return SpecimenResult(
        name=group[0].specimen,
        needle_id=group[0].needle_id,
        gelatin_percent=group[0].gelatin_percent,
        trials=len(group),
        n=summary.n,
        mean_radius_mm=summary.mean,
        sd_radius_mm=summary.sd,
        ci95_mm=add_roll_uncertainty(summary.ci95, roll_sd_deg, _combine_shared(accepted)),
        refused=len(pictures) - summary.n,
        refused_reasons=tuple(f"{count} x {reason}" for reason, count in reasons.items()),
        without_final_picture=len(group) - len(pictures),
        true_mean_radius_mm=float(np.mean(drawn)) if drawn else None,
        worst_error_mm=max(errors, key=abs, default=None),
    )


def _combine_shared(pictures: Sequence[PictureResult]) -> float | None:
    """Return the standard deviation [mm] of their mean by all that they share; None if the roll's is not known."""
    budgets = [budget for picture in pictures if (budget := picture.radius_budget_mm) is not None]
    if not budgets or len(budgets) < len(pictures) or any(budget.roll is None for budget in budgets):
        return None
    sigmas = ([vars(budget)[source] for budget in budgets] for source in vars(budgets[0]) if source != "fit")
    return float(np.linalg.norm([np.mean(of) for of in sigmas if None not in of]))


def average_means(specimens: Sequence[SpecimenResult]) -> float | None:
    """Return the mean of the groups' means; each group counts once, however many insertions it has."""
    means = [group.mean_radius_mm for group in specimens if group.mean_radius_mm is not None]
    return float(np.mean(means)) if means else None
