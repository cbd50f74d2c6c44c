"""The commands that other settings would have given on the recorded pictures: one result compared with another."""

from functools import cache
from typing import Any

import pytest

from labrig.analysis.divergence import find_divergence
from labrig.experiments.insertion.result import InsertionResult
from labrig.experiments.insertion.summary import compare_steering, summarise_steering
from tests.analysis.insertions import analyse, analyse_recorded, observations, record_insertion


@cache
def _document(*overrides: str) -> dict[str, Any]:
    document: dict[str, Any] = _result(*overrides).model_dump(mode="json")
    return document


@cache
def _result(*overrides: str) -> InsertionResult:
    return analyse(record_insertion(), *overrides) if overrides else analyse_recorded()


def test_unchanged_settings_give_every_command_again() -> None:
    """Unchanged settings give every recorded estimate and every turn of the bevel, to the last digit."""
    (insertion,) = _result().insertions
    assert insertion.as_recorded is True
    (found,) = compare_steering(_document(), _document())
    assert (found.divergence, found.old) == (None, found.new)
    flips = [event for event in record_insertion().lines("events") if event["kind"] == "flip"]
    assert list(found.new.turns_at_mm) == [flip["depth_mm"] for flip in flips]
    assert found.new.stop == "target_reached"
    assert [command.frame for command in insertion.commands[1:]] == [
        observation["frame"] for observation in observations(record_insertion())
    ]


def test_the_first_command_that_differs_is_named() -> None:
    """Another radius for the planner already changes the first command, before any picture."""
    (found,) = compare_steering(_document(), _document("planner.radius_mm=33"))
    assert found.divergence is not None
    assert found.divergence.frame is None
    assert found.divergence.old != found.divergence.new


def test_a_policy_shows_in_commands_alone() -> None:
    """A policy that never replans changes commands but no estimates, since the recorded turns are known."""
    other = _document("policy.replan_every_mm=500", "policy.deviation_mm=null", "policy.final_mm=0")
    (found,) = compare_steering(_document(), other)
    assert found.new.replans < found.old.replans
    assert found.divergence is not None
    assert found.divergence.frame is not None
    assert [step["estimate_mm"] for step in other["insertions"][0]["steps"]] == [
        step["estimate_mm"] for step in _document()["insertions"][0]["steps"]
    ]


def test_an_estimator_of_another_kind_parts_at_a_picture() -> None:
    """The first difference is in a step, and its picture is named."""
    found = find_divergence(_document(), _document("estimator.observation_sd_mm=2.0"))
    assert found is not None
    assert found.key.startswith("insertions.0.steps.")
    assert found.frame in {observation["frame"] for observation in observations(record_insertion())}


def test_after_a_stop_no_more_commands_are_given() -> None:
    """Commands end at a stop that comes earlier than in the run; the estimates continue to the end."""
    other = _document("planner.radius_mm=200")
    what_if = summarise_steering(other["insertions"][0])
    assert what_if.stop is not None
    assert len(other["insertions"][0]["commands"]) <= len(other["insertions"][0]["steps"])
    assert len(other["insertions"][0]["steps"]) == len(observations(record_insertion()))


@pytest.mark.parametrize("lacking", [{}, {"insertions": [{"trial": 0, "steps": []}]}])
def test_a_result_without_commands_has_nothing_to_compare(lacking: dict[str, Any]) -> None:
    """Results of other experiments or of versions that stored no commands are left out."""
    assert compare_steering(lacking, _document()) == ()
