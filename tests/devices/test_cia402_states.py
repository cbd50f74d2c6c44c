"""The planner of the state machine, over every possible statusword."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.devices.cia402_states import (
    FAULT_RESET,
    FAULTED,
    HALT,
    STATUSWORDS,
    DriveState,
    TargetState,
    decode_state,
    plan_controlword,
)
from labrig.errors import DriveError

EVERY_STATUSWORD = range(0x10000)


def _enables(controlword: int | None) -> bool:
    return controlword is not None and controlword & 0x0F == 0x0F


@pytest.mark.parametrize("goal", TargetState)
def test_the_planner_never_resets_a_fault(goal: TargetState) -> None:
    """Every statusword gives a plan or a refusal, and no plan sets the fault reset bit."""
    for statusword in EVERY_STATUSWORD:
        if goal is TargetState.ENABLED and decode_state(statusword) in FAULTED:
            with pytest.raises(DriveError):
                plan_controlword(statusword, goal)
            continue
        plan = plan_controlword(statusword, goal)
        assert plan.controlword is None or not plan.controlword & FAULT_RESET
        assert not (plan.attained and plan.controlword is not None)


def test_only_the_goal_enabled_switches_power_on() -> None:
    """It does so from switched on, with the Halt bit set."""
    for goal in TargetState:
        for statusword in EVERY_STATUSWORD:
            state = decode_state(statusword)
            if goal is TargetState.ENABLED and state in FAULTED:
                continue
            plan = plan_controlword(statusword, goal)
            if _enables(plan.controlword):
                assert goal is TargetState.ENABLED
                assert state is DriveState.SWITCHED_ON
                assert plan.controlword is not None
                assert plan.controlword & HALT


def test_only_documented_patterns_name_a_state() -> None:
    """Other bits do not matter; an undocumented pattern is unknown, and the planner waits."""
    known = dict.fromkeys(DriveState, 0)
    for statusword in EVERY_STATUSWORD:
        known[decode_state(statusword)] += 1
    # Seven bits do not name the state: 2^7 statuswords for each of the documented patterns.
    documented = [state for state in STATUSWORDS.values() if state is not DriveState.UNKNOWN]
    assert known[DriveState.OPERATION_ENABLED] == 2**7
    assert sum(known.values()) - known[DriveState.UNKNOWN] == len(documented) * 2**7
    assert plan_controlword(0x0177, TargetState.ENABLED).controlword is None


@given(st.lists(st.integers(0, 0xFFFF), max_size=30))
def test_no_sequence_of_statuswords_enables_out_of_a_fault(statuswords: list[int]) -> None:
    """A faulted statusword gives a refusal and no command, whatever comes before and after."""
    for statusword in [*statuswords, 0x0108, *statuswords, 0x010F]:
        if decode_state(statusword) in FAULTED:
            with pytest.raises(DriveError, match="fault"):
                plan_controlword(statusword, TargetState.ENABLED)
            assert not _enables(plan_controlword(statusword, TargetState.POWER_OFF).controlword)
            assert not _enables(plan_controlword(statusword, TargetState.QUICK_STOPPED).controlword)


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        (0x0340, DriveState.SWITCH_ON_DISABLED),
        (0x0321, DriveState.READY_TO_SWITCH_ON),
        (0x0323, DriveState.SWITCHED_ON),
        (0x8737, DriveState.OPERATION_ENABLED),
        (0x0317, DriveState.QUICK_STOP_ACTIVE),
        (0x031F, DriveState.FAULT_REACTION),
        (0x0308, DriveState.FAULT),
        (0x4323, DriveState.REFRESH),
    ],
)
def test_statuswords_of_a_running_drive_are_understood(statusword: int, state: DriveState) -> None:
    """Remote, target reached and referenced are set, as in a real drive."""
    assert decode_state(statusword) is state
