"""What decides whether an insertion reached its target in space: live, and again in the analysis."""

import math
from dataclasses import replace

import numpy as np
import pytest

from labrig.experiments.insertion.ending import SeenEnd, bound_error, trace_path
from labrig.experiments.insertion.events import BevelTurn
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.result import summarise
from labrig.experiments.insertion.settings import make_out_of_plane
from labrig.steering.out_of_plane import OutOfPlaneBudget, budget_out_of_plane
from labrig.vision.depth import Depth, PossibleDepth
from tests.experiments.insertion.recorded import analyse_recorded, record_insertion
from tests.experiments.insertion.test_procedure import analyse, events, insertion

SURE, UNSURE = (), ("out_of_plane.heading_sd_deg_per_root_mm=1",)
ELSEWHERE = ("target.sd_mm=1.5", "target.position_mm=[0,-2,20]", "obstacles=[]")


def seen_at(y_mm: float, sd_mm: float = 0.1) -> SeenEnd:
    """Return an end seen at z = 40 under the camera, with its standard deviation."""
    return SeenEnd(np.array((y_mm, 40.0)), np.full(2, sd_mm), np.zeros(2), "shaft")


def unseen(heading_mm: float) -> OutOfPlaneBudget:
    """Return the budget of a needle that wanders out of the plane."""
    return OutOfPlaneBudget(0.0, 0.0, heading_mm, 0.0)


@pytest.mark.parametrize("settings", [SURE, UNSURE, ELSEWHERE])
def test_the_analysis_decides_as_the_run_did(settings: tuple[str, ...]) -> None:
    """Outcome, reason and cause are the recorded ones, to the last digit; the largest source of doubt is named."""
    (stop,) = events(record_insertion(*settings), "trial_stop")
    (trial,) = analyse_recorded(*settings).insertions
    assert (trial.outcome, trial.stop, trial.cause) == (stop["outcome"], stop["stop"], stop["cause"])
    assert trial.outcome == ("reached" if settings == SURE else "reached_in_plane_only")
    assert ("comes from the place of the target" in trial.cause) == (settings == ELSEWHERE)


@pytest.mark.parametrize(("settings", "fit_mm"), [(SURE, 0.06), (ELSEWHERE, 0.22)])
def test_an_end_just_after_a_turn_is_read_less_surely(settings: tuple[str, ...], fit_mm: float) -> None:
    """The error in the plane says so too: the last turns were made 7.7 and 2.9 mm before the end."""
    (trial,) = analyse_recorded(*settings).insertions
    assert trial.target_error_budget_mm.fit == pytest.approx(fit_mm, rel=0.2)
    assert fit_mm < trial.sigma_target_error_mm < fit_mm + 0.02


def test_the_picture_alone_tells_less_and_rests_on_no_stated_wandering() -> None:
    """Its interval ends farther off than with path and estimate; that with them grows more with the wandering."""
    sure, unsure = (analyse_recorded(*settings).insertions[0] for settings in (SURE, UNSURE))
    assert sure.picture_interval_mm[1] > sure.target_error_interval_mm[1]
    assert unsure.picture_interval_mm[1] < 1.5 * sure.picture_interval_mm[1]
    assert unsure.target_error_interval_mm[1] > 1.5 * sure.target_error_interval_mm[1]


def test_where_the_plane_alone_says_so_a_target_is_not_reached() -> None:
    """Neither reached nor missed, unless a smaller wandering, measured since, says that it was."""
    run, content = record_insertion(*UNSURE), analyse_recorded(*UNSURE)
    assert (run.manifest["exit_status"], run.manifest["reason"]) == ("failed", "reached_in_plane_only")
    assert (content.reached, content.arrived, content.causes) == (None, 0, {"reached_in_plane_only": 1})
    low_mm, high_mm = content.target_error_interval_mm
    assert low_mm < content.target_error_mm + 0.2 < 2 < high_mm
    (trial,) = content.insertions
    assert trial.target_error_sources_mm.largest == "heading_noise"
    said = "\n".join(str(line) for line in summarise(content.model_dump(mode="json")))
    assert trial.target_error_interval_by == "shaft_and_estimate"
    assert math.dist(trial.target_error_interval_tip_mm, trial.tip_mm) < 0.3
    told = ("reached in plane only", "error mm: by the shaft in the final picture; ", "shaft and estimate")
    assert all(words in said for words in told)
    measured_since = analyse(run, "out_of_plane.heading_sd_deg_per_root_mm=0.05")
    assert (measured_since.reached, measured_since.causes) == (True, {})


def test_a_missed_target_stays_missed() -> None:
    """In the plane beyond the tolerance is a miss, whatever is not seen; so is an interval that lies beyond it."""
    for unseen_mm in (0.0, 5.0):
        ending = bound_error(seen_at(2.5), unseen(unseen_mm), (0.0, 0.0, 40.0), 0.0).decide(2.0)
        assert (ending.outcome, ending.stop, ending.reached) == ("missed", "target_missed", False)
    aside = bound_error(seen_at(0.0), unseen(0.1), (5.0, 0.0, 40.0), 0.0).decide(2.0)
    assert (aside.outcome, aside.stop, "between 4." in aside.cause) == ("missed", "target_missed", True)


def test_a_needle_that_has_left_the_plane_is_measured_where_it_is() -> None:
    """Its place is that on the line of sight at the told depth, whose standard deviation makes it uncertain."""
    depth = Depth((PossibleDepth(1.0, 10.0, 0.5),), 10.0, 0.5, contradicts=True)
    seen = replace(seen_at(5.0), slope=np.array((0.2, 0.0)), depth=depth)
    bounds = bound_error(seen, unseen(0.5), (0.0, 0.0, 40.0), 0.0)
    assert (bounds.in_plane_mm, *bounds.ray_sd_mm) == pytest.approx((7.0, 0.1, 0.0))


def test_what_is_seen_aside_of_the_camera_is_less_certain() -> None:
    """Where the line of sight is oblique, what is not known out of the plane makes the place in it uncertain too."""
    target, under, aside = (0.0, 0.0, 40.0), seen_at(1.0), replace(seen_at(1.0), slope=np.array((0.5, 0.0)))
    near_mm, far_mm = (bound_error(seen, unseen(1.0), target, 0.0).interval_mm[1] for seen in (under, aside))
    assert far_mm > near_mm + 0.2


@pytest.mark.parametrize("sd_mm", [0.3, 1.0, 2.0])
def test_the_interval_holds_targets_that_are_elsewhere_as_often_as_it_says(sd_mm: float) -> None:
    """Ends that were steered to the stated place, and targets spread about it as stated, in 95 of 100 draws or so."""
    random, target, held = np.random.default_rng(1), (0.0, 0.0, 40.0), 0
    for _ in range(200):
        seen = replace(seen_at(0.0), place_mm=np.array(target[1:]) + random.normal(0.0, 0.1, 2))
        low_mm, high_mm = bound_error(seen, unseen(0.5), target, sd_mm).interval_mm
        end = np.array((random.normal(0.0, 0.5), 0.0, 40.0))
        held += bool(low_mm <= np.linalg.norm(end - random.normal(target, sd_mm)) <= high_mm)
    assert 0.91 < held / 200 < 0.995


@pytest.mark.parametrize(("target_sd_mm", "largest"), [(0.55, "in_plane"), (0.6, "target")])
def test_the_largest_source_is_that_over_all_axes(target_sd_mm: float, largest: str) -> None:
    """A target that is uncertain along three axes outweighs a picture whose two axes together are 1 mm."""
    bounds = bound_error(seen_at(0.0, 1 / math.sqrt(2)), unseen(0.3), (0.0, 0.0, 40.0), target_sd_mm)
    assert bounds.sources.in_plane == pytest.approx(1.0)
    assert (bounds.sources.target, bounds.sources.largest) == (target_sd_mm, largest)


def test_a_turn_counts_from_where_it_acts() -> None:
    """The budget of a recorded path is that of its stretches, each from half a backlash after the turn."""
    protocol = insertion("out_of_plane.lag_sd_deg=5")
    assert isinstance(protocol, InsertionProtocol)
    settings_unseen = make_out_of_plane(protocol, 0.01, None)
    turn = BevelTurn(trial=0, depth_mm=20.0, from_rad=0.3, to_rad=0.3 + math.pi)
    stretches = trace_path((turn,), 0.3, 40.0, 0, protocol.policy.backlash_mm)
    budget = budget_out_of_plane(stretches, protocol.planner.radius_mm, settings_unseen)
    first_mm, radius_mm = 20.75, protocol.planner.radius_mm
    parts = (first_mm * (40 - first_mm / 2) / radius_mm, -((40 - first_mm) ** 2) / 2 / radius_mm)
    assert budget.roll_zero == pytest.approx(0.01 * abs(sum(parts)))
    assert budget.torsion == pytest.approx(math.radians(5) * math.hypot(*parts))
