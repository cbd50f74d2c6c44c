"""The commands that other settings would have given on the recorded pictures."""

from functools import cache
from typing import Any

from labrig.analysis.divergence import find_divergence
from labrig.experiments.insertion.result import InsertionResult
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
    flips = [event for event in record_insertion().lines("events") if event["kind"] == "flip"]
    turns = [command for command in insertion.commands if command.roll_rad != 0.0]
    assert [turn.depth_mm for turn in turns] == [flip["depth_mm"] for flip in flips]
    assert insertion.commands[-1].stop == "target_reached"
    assert [command.frame for command in insertion.commands[1:]] == [
        observation["frame"] for observation in observations(record_insertion())
    ]


def test_another_radius_already_changes_the_first_command() -> None:
    """Before any picture."""
    first, other = (
        _result(*changed).insertions[0].commands[0] for changed in ((), ("planner.radius_mm=33",))
    )
    assert first.frame is None
    assert first != other


def test_a_policy_shows_in_commands_alone() -> None:
    """A policy that never replans changes commands but no estimates, since the recorded turns are known."""
    other = _document("policy.replan_every_mm=500", "policy.deviation_mm=null", "policy.final_mm=0")
    found = find_divergence(_document(), other)
    assert found.key.startswith("insertions.0.commands.")
    assert found.frame is not None
    (old, new) = (document["insertions"][0] for document in (_document(), other))
    assert new["commands"][-1]["replans"] < old["commands"][-1]["replans"]
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
    assert other["insertions"][0]["commands"][-1]["stop"] is not None
    assert len(other["insertions"][0]["commands"]) <= len(other["insertions"][0]["steps"])
    assert len(other["insertions"][0]["steps"]) == len(observations(record_insertion()))
