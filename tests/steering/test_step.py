"""The step that joins estimator and planner, with an independent model of the needle."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labrig.steering.parameters import PAPER_POLICY, SteeringPolicy
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import Obstacle, PlanProblem
from labrig.steering.replanning import replan
from labrig.steering.step import LEAD_MM, start_steering
from labrig.steering.tip import EstimatorSettings
from tests.steering.driven_needle import DrivenNeedle, drive

RADIUS_MM = 27.6
OBSTACLES = (Obstacle((0.0, -2.0, 35.0), 8.0), Obstacle((0.0, 6.0, 68.0), 8.0))
PLANAR = PlanProblem((0.0, 5.0, 100.0), OBSTACLES, planar=True)
SPATIAL = PlanProblem((12.0, 5.0, 90.0), (Obstacle((6.0, 2.0, 45.0), 8.0),))
NO_BACKLASH = SteeringPolicy(backlash_mm=0.0, closing_mm=0.0)


def settings(problem=PLANAR, policy=None, **how: Any):
    """Return settings for a problem; the default policy's filter also estimates the radius."""
    noise: Any = {"process_sd_deg_per_root_mm": 0.3, "start_sd_deg": math.degrees(0.02)}
    known = {
        "radius_mm": problem.radius_mm,
        "planar": problem.planar,
        "cavity_every_mm": None,
        "slip_sd": 0.0,
    }
    return SteeringSettings(problem, EstimatorSettings(**known, **noise, **how), policy or SteeringPolicy())


def gap_mm(needle, problem):
    """Return the smallest distance from the needle's surface to an obstacle's."""
    path = np.array(needle.path)
    far = [np.linalg.norm(path - o.position_mm, axis=1).min() - o.radius_mm for o in problem.obstacles]
    return min(far) - problem.diameter_mm / 2


PLAY: Any = {"closing_mm": 3.0, "backlash_mm": 1.5}
WIDE: Any = {"radius_mm": 1.03 * RADIUS_MM, **PLAY}


@pytest.mark.processors
@pytest.mark.parametrize(
    ("needle", "chosen", "noise", "miss_mm", "least_gap_mm"),
    [
        ({}, settings(policy=NO_BACKLASH), {}, 0.1, 0.5),
        (PLAY, settings(PLANAR), {}, 0.2, 0.4),
        (PLAY, settings(SPATIAL), {}, 0.2, 0.4),
        *((WIDE, settings(), {"sigma_mm": 0.2, "seed": seed}, 0.5, 0.0) for seed in range(3)),
    ],
    ids=["undisturbed", "play", "play in space", "other radius 0", "other radius 1", "other radius 2"],
)
def test_a_needle_arrives(needle, chosen, noise, miss_mm, least_gap_mm):
    """A play that is counted with costs nothing; with noise of 0.2 mm and a radius 3 % off it is half a millimetre."""
    driven = DrivenNeedle(**{"radius_mm": RADIUS_MM, **needle})
    assert drive(driven, chosen, **noise).stop == "target_reached"
    assert np.linalg.norm(driven.place - chosen.problem.target_mm) < miss_mm
    assert gap_mm(driven, chosen.problem) > least_gap_mm


def test_the_papers_policy_plans_every_20_mm():
    """The paper's policy, planner and filter arrive too; they plan at the start and then every 20 mm alone."""
    problem = replace(PLANAR, target_mm=(0.0, 1.0, 62.0), obstacles=OBSTACLES[:1])
    papers = settings(problem, PAPER_POLICY, method="paper", radius_sd_mm=0.0)
    needle = DrivenNeedle(RADIUS_MM)
    done = drive(needle, replace(papers, method="paper"))
    assert done.stop == "target_reached"
    assert np.linalg.norm(needle.place - problem.target_mm) < 2.0
    assert gap_mm(needle, problem) > 0.5
    sought = [(state.why, state.insertion_mm) for state in done.states if state.why]
    assert sought[0] == ("start", 0.0)
    assert {why for why, _ in sought[1:]} == {"schedule"}
    apart_mm = np.diff([at_mm for _, at_mm in sought])
    assert len(apart_mm) == 3
    assert apart_mm.min() > 19.9
    assert apart_mm.max() < 21.6


@pytest.mark.parametrize(("made_at_mm", "acts_at_mm"), [(0.0, 1.5), (0.74, 1.5), (0.76, 1.51), (50.0, 50.75)])
def test_a_turn_acts_where_the_play_is_through(made_at_mm, acts_at_mm):
    """After half the backlash, and at the start not before half of the length over which the hinges close."""
    policy = SteeringPolicy(closing_mm=3.0, backlash_mm=1.5)
    assert policy.find_acting_mm(made_at_mm) == pytest.approx(acts_at_mm)


def test_commands_lead_on():
    """The needle is observed about every millimetre, never advances past its next turn, and turns by half turns."""
    done = drive(DrivenNeedle(RADIUS_MM, **PLAY), settings())
    for state, command in zip(done.states[:-1], done.commands[:-1], strict=True):
        assert state.insertion_mm < command.observe_at_mm <= command.run_to_mm + 1e-9
        assert command.observe_at_mm - state.insertion_mm < 1.6
        assert abs(command.roll_rad) in {0.0, math.pi}
        assert all(turn.at_mm >= command.run_to_mm - LEAD_MM - 1e-9 for turn in state.ahead)


@pytest.mark.parametrize(
    ("radius_mm", "problem"),
    [(3 * RADIUS_MM, PLANAR), (1e6, replace(PLANAR, target_mm=(0.0, 20.0, 60.0), obstacles=()))],
    ids=["stiff", "straight"],
)
def test_a_needle_halts_for_a_thorough_search(radius_mm, problem):
    """A needle too stiff for its target is told so only where it was told to halt; it does not go on to its length."""
    needle = DrivenNeedle(radius_mm)
    done = drive(needle, settings(problem))
    assert done.stop in ({"blocked", "target_missed"} if problem.obstacles else {"target_missed"})
    assert needle.inserted_mm < 0.8 * problem.max_length_mm
    last, before = done.states[-1], done.states[-2]
    assert last.refusal is not None
    assert before.sought is not None
    assert last.insertion_mm == before.run_to_mm == before.insertion_mm + LEAD_MM


@pytest.mark.parametrize(("over_mm", "sought"), [(-0.3, None), (0.3, "schedule")])
def test_without_a_new_path_the_old_one_will_do_for_a_while_or_if_it_can_be_corrected(over_mm, sought):
    """For 15 mm; then up to the tolerance and 5 % of what is left, beyond which a thorough search is called for.

    Where a search could not find the old path, for too few arcs, that is mended.
    """
    chosen = settings()
    states = drive(DrivenNeedle(RADIUS_MM, **PLAY), chosen).states
    number = next(at for at, state in enumerate(states) if state.insertion_mm - state.followed_mm > 15.0)
    miss_mm = chosen.problem.tolerance_mm + 0.05 * states[number].left_mm + over_mm
    elsewhere = replace(chosen.problem, target_mm=(0.0, 5.0 + miss_mm, 100.0), max_length_mm=60.0)
    before, after = (
        replan(states[at], "schedule", replace(chosen, problem=elsewhere)) for at in (number - 1, number)
    )
    assert (before.sought, after.sought) == (None, sought)
    one_arc = replace(chosen, problem=replace(chosen.problem, max_arcs=1))
    assert replan(states[number], "schedule", one_arc).replans == states[number].replans + 1


@pytest.mark.parametrize(
    ("seen_mm", "stops", "word"),
    [(None, {"needle_lost"}, "8 sightings"), (np.zeros(3), {"needle_stuck", "needle_lost"}, "")],
    ids=["unseen", "standing"],
)
def test_a_tip_that_is_not_seen_or_does_not_advance_stops_the_needle(seen_mm, stops, word):
    """After the allowed misses, which the sentence states, or after a few millimetres without an advance."""
    done = drive(DrivenNeedle(RADIUS_MM), settings(), see=lambda needle: seen_mm)
    assert done.stop in stops
    assert word in done.commands[-1].detail
    assert done.states[-1].insertion_mm < 10


@pytest.mark.parametrize(
    ("change", "stop", "word"),
    [
        ({"target_mm": (0.0, 20.0, 10.0)}, "target_missed", "turning circle"),
        ({"obstacles": (Obstacle((0.0, 0.0, 10.0), 5.0),)}, "blocked", "no path found"),
        ({"max_length_mm": 50.0, "obstacles": ()}, "target_missed", "too long"),
    ],
)
def test_without_a_path_nothing_moves(change, stop, word):
    """Without a path at the start the first command is a stop with the reason."""
    _, command = start_steering(settings(replace(PLANAR, **change)))
    assert command.stop == stop
    assert word in command.detail
    assert command.run_to_mm == 0.0


def test_no_path_ends_beyond_the_longest_insertion():
    """Not where a turn would act beyond it either, near the target, as with a needle that slips."""
    near = next(one for one in drive(DrivenNeedle(RADIUS_MM, **PLAY), settings()).states if one.left_mm < 4.0)
    short = replace(PLANAR, max_length_mm=near.insertion_mm + 0.3)
    assert replan(near, "near", settings(short)).end_mm <= short.max_length_mm


@pytest.mark.parametrize("target_y_mm", [0.0, 15.0])
def test_paths_do_not_lead_far_aside(target_y_mm):
    """The heading stays within the policy's cap, except for its error and its lag."""
    problem = replace(PLANAR, target_mm=(0.0, target_y_mm, 100.0))
    states = drive(DrivenNeedle(RADIUS_MM, **PLAY), settings(problem)).states
    assert max(abs(state.tip.heading_rad) for state in states) < math.radians(50.0)
