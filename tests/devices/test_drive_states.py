"""The state machine of CiA 402 as pure functions: what statuswords say, and what no plan ever commands."""

import pytest

from labrig.devices.drives.states import (
    FAULT_RESET,
    FAULTED,
    HALT,
    DriveState,
    TargetState,
    decode_state,
    is_attained,
    plan_controlword,
)

_ENABLES = 0x0F


@pytest.mark.parametrize("goal", TargetState)
def test_no_plan_resets_a_fault_or_enables_out_of_one(goal: TargetState) -> None:
    """From every state there is a command, a goal that is attained, or waiting; never the fault reset bit.

    Only the goal enabled switches power on, from switched on, with the Halt bit set.
    """
    for state in DriveState:
        word = plan_controlword(state, goal)
        if word is not None:
            assert not word & FAULT_RESET
            assert not is_attained(state, goal)
            assert state not in FAULTED
            if word & 0x0F == _ENABLES:
                assert (goal, state, word) == (TargetState.ENABLED, DriveState.SWITCHED_ON, _ENABLES | HALT)
    assert plan_controlword(DriveState.SWITCHED_ON, TargetState.ENABLED) == _ENABLES | HALT


def test_bits_that_name_no_state_do_not_matter() -> None:
    """Ten bits do not: 2^10 statuswords for each of the twelve documented patterns; others are unknown."""
    states = [decode_state(statusword) for statusword in range(0x10000)]
    assert states.count(DriveState.OPERATION_ENABLED) == 2**10
    assert len(states) - states.count(DriveState.UNKNOWN) == 12 * 2**10


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        (0x0000, DriveState.NOT_READY), (0x0250, DriveState.SWITCH_ON_DISABLED),
        (0x0231, DriveState.READY_TO_SWITCH_ON), (0x0633, DriveState.SWITCHED_ON),
        (0xC737, DriveState.OPERATION_ENABLED), (0x0317, DriveState.QUICK_STOP_ACTIVE),
        (0x003F, DriveState.FAULT_REACTION), (0x0638, DriveState.FAULT), (0x0001, DriveState.UNKNOWN),
    ],
)  # fmt: skip
def test_statuswords_of_running_drives_are_understood(statusword: int, state: DriveState) -> None:
    """Those of an EPOS2 and of an EPOS4, with remote, target reached and referenced set."""
    assert decode_state(statusword) is state
