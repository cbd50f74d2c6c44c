"""Insertions grouped by needle and gel, beside what a simulated world drew."""

from typing import Any

import pytest

from labrig.experiments.shared.curvature_result import PictureResult
from labrig.experiments.shared.grouping import average_means, summarise_specimens
from labrig.experiments.shared.needle_events import SpecimenTrialStart
from labrig.experiments.shared.paper import PAPER_GELS


def _trial(number: int, specimen: str = "gel", needle_id: str = "N1") -> SpecimenTrialStart:
    return SpecimenTrialStart(
        trial=number, specimen=specimen, gelatin_percent=10.0, hole=number, hole_position_mm=10.0 * number,
        needle_id=needle_id,
    )  # fmt: skip


def _picture(trial: SpecimenTrialStart, radius_mm: float | None, reason: str | None = None) -> PictureResult:
    own: dict[str, Any] = trial.model_dump(
        include={"trial", "specimen", "gelatin_percent", "hole", "needle_id"}
    )
    own |= {"found": radius_mm is not None, "accepted": reason is None, "reason": reason}
    return PictureResult(
        frame=trial.trial, image="a.png", role="final", insertion_mm=40.0, radius_mm=radius_mm, **own
    )


def test_a_needle_in_a_gel_is_a_group_and_counts_once() -> None:
    """A new needle in the same gel is a group of its own, and one with many insertions weighs no more than another."""
    trials = [_trial(0), _trial(1, needle_id="N2"), _trial(2)]
    radii_mm = zip(trials, (28.0, 30.0, 28.4), strict=True)
    groups = summarise_specimens(trials, {trial.trial: _picture(trial, radius) for trial, radius in radii_mm})
    assert [(group.needle_id, group.n) for group in groups] == [("N1", 2), ("N2", 1)]
    assert [group.mean_radius_mm for group in groups] == pytest.approx([28.2, 30.0])
    assert average_means(groups) == pytest.approx(29.1)


def test_refused_and_missing_pictures_are_counted_apart_and_enter_no_mean() -> None:
    """A refused radius is left out of the mean and counted with its reason, even if a circle was fitted."""
    trials = [_trial(number) for number in range(4)]
    finals = {
        0: _picture(trials[0], 28.0),
        1: _picture(trials[1], 90.0, "too uncertain"),
        2: _picture(trials[2], None, "no shaft"),
    }
    (group,) = summarise_specimens(trials, finals)
    assert (group.trials, group.n, group.refused, group.mean_radius_mm) == (4, 1, 2, 28.0)
    assert (group.refused_reasons, group.without_final_picture) == (("1 x too uncertain", "1 x no shaft"), 1)
    assert (group.sd_radius_mm, group.ci95_mm) == (None, None)
    assert average_means(summarise_specimens(trials, {})) is None


def test_refusing_a_picture_does_not_flatter_the_error_of_the_mean() -> None:
    """The mean is compared with that of all drawn radii, including those of refused pictures."""
    trials, drawn_mm = [_trial(0), _trial(1)], {0: 28.05, 1: 27.05}
    seen = _picture(trials[0], 28.0).model_copy(update={"true_radius_mm": 28.05})
    (gel,) = summarise_specimens(trials, {0: seen, 1: _picture(trials[1], None, "no shaft")}, 0.0, drawn_mm)
    assert gel.error_of_mean_mm == pytest.approx(28.0 - 27.55)
    assert gel.worst_error_mm == pytest.approx(-0.05)
    (unknown,) = summarise_specimens(trials, {0: _picture(trials[0], 28.0)})
    assert (unknown.true_mean_radius_mm, unknown.error_of_mean_mm, unknown.worst_error_mm) == (None,) * 3


def test_the_papers_mean_is_that_of_its_four_gels() -> None:
    """The mean of the paper's four means rounds to its 27.6 mm."""
    mean = sum(mean_mm for mean_mm, _ in PAPER_GELS.values()) / len(PAPER_GELS)
    assert mean == pytest.approx(27.6, abs=0.05)  # as the paper rounds it
