"""The state machine of a drive (CiA 402, with the states that maxon's EPOS2 adds) as one pure function.

`plan_controlword` never resets a fault: its controlwords leave bit 7 alone, and from a fault it raises. It
leads to an enabled power stage only when enabling is the goal, and then with the Halt bit set, so that a
stale target moves nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from labrig.errors import DriveError


class DriveState(Enum):
    """State that a statusword tells; `UNKNOWN` stands for a pattern that no document lists."""

    START = auto()
    NOT_READY = auto()
    SWITCH_ON_DISABLED = auto()
    READY_TO_SWITCH_ON = auto()
    SWITCHED_ON = auto()
    REFRESH = auto()
    MEASURE_INIT = auto()
    OPERATION_ENABLED = auto()
    QUICK_STOP_ACTIVE = auto()
    FAULT_REACTION = auto()
    FAULT = auto()
    UNKNOWN = auto()

    # Every reading looks its state up in tables; Enum would hash the name each time, in Python.
    __hash__ = object.__hash__


class TargetState(Enum):
    """Where a drive is to be brought."""

    ENABLED = auto()
    QUICK_STOPPED = auto()
    POWER_OFF = auto()


@dataclass(frozen=True)
class NextStep:
    """The next step towards a goal: a controlword to send, None to wait, or `attained`."""

    controlword: int | None = None
    attained: bool = False


# The bits of the controlword, object 0x6040.
SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
ENABLE = 0x000F
DISABLE_VOLTAGE = 0x0000
QUICK_STOP = 0x0002
NEW_SETPOINT = 0x0010
CHANGE_IMMEDIATELY = 0x0020
RELATIVE = 0x0040
FAULT_RESET = 0x0080
HALT = 0x0100

# The bits of the statusword, object 0x6041.
REMOTE = 0x0200
TARGET_REACHED = 0x0400
SETPOINT_ACKNOWLEDGED = 0x1000
HOMING_ATTAINED = 0x1000
HOMING_ERROR = 0x2000
REFERENCED = 0x8000

STATE_BITS = 0x417F
"""The bits that name a state of an EPOS2: 0 to 6, 8 and 14."""

STANDARD_STATE_BITS = 0x006F
"""The bits that name a state in CiA 402; bit 4 is the voltage, bits 8 and 14 are the manufacturer's."""

STATUSWORDS = {
    0x0000: DriveState.START,
    0x0100: DriveState.NOT_READY,
    0x0140: DriveState.SWITCH_ON_DISABLED,
    0x0121: DriveState.READY_TO_SWITCH_ON,
    0x0123: DriveState.SWITCHED_ON,
    0x4123: DriveState.REFRESH,
    0x0133: DriveState.MEASURE_INIT,
    0x4133: DriveState.MEASURE_INIT,
    0x0137: DriveState.OPERATION_ENABLED,
    0x0117: DriveState.QUICK_STOP_ACTIVE,
    0x010F: DriveState.FAULT_REACTION,
    0x011F: DriveState.FAULT_REACTION,
    0x0108: DriveState.FAULT,
}

STANDARD_STATUSWORDS = {
    0x0000: DriveState.NOT_READY,
    0x0020: DriveState.NOT_READY,
    0x0040: DriveState.SWITCH_ON_DISABLED,
    0x0060: DriveState.SWITCH_ON_DISABLED,
    0x0021: DriveState.READY_TO_SWITCH_ON,
    0x0023: DriveState.SWITCHED_ON,
    0x0027: DriveState.OPERATION_ENABLED,
    0x0007: DriveState.QUICK_STOP_ACTIVE,
    0x000F: DriveState.FAULT_REACTION,
    0x002F: DriveState.FAULT_REACTION,
    0x0008: DriveState.FAULT,
    0x0028: DriveState.FAULT,
}

FAULTED = frozenset({DriveState.FAULT_REACTION, DriveState.FAULT})

_WAIT = NextStep()
_ATTAINED = NextStep(attained=True)
_PLANS: dict[TargetState, dict[DriveState, NextStep]] = {
    TargetState.ENABLED: {
        DriveState.SWITCH_ON_DISABLED: NextStep(SHUTDOWN | HALT),
        DriveState.READY_TO_SWITCH_ON: NextStep(SWITCH_ON | HALT),
        DriveState.SWITCHED_ON: NextStep(ENABLE | HALT),
        DriveState.QUICK_STOP_ACTIVE: NextStep(DISABLE_VOLTAGE | HALT),
        DriveState.OPERATION_ENABLED: _ATTAINED,
    },
    TargetState.QUICK_STOPPED: {
        DriveState.OPERATION_ENABLED: NextStep(QUICK_STOP),
        DriveState.QUICK_STOP_ACTIVE: _ATTAINED,
        DriveState.SWITCH_ON_DISABLED: _ATTAINED,
        DriveState.READY_TO_SWITCH_ON: _ATTAINED,
        DriveState.SWITCHED_ON: NextStep(SHUTDOWN),
        DriveState.MEASURE_INIT: NextStep(DISABLE_VOLTAGE),
        DriveState.REFRESH: NextStep(DISABLE_VOLTAGE),
        DriveState.FAULT: _ATTAINED,
    },
    TargetState.POWER_OFF: {
        DriveState.OPERATION_ENABLED: NextStep(DISABLE_VOLTAGE),
        DriveState.QUICK_STOP_ACTIVE: NextStep(DISABLE_VOLTAGE),
        DriveState.SWITCHED_ON: NextStep(DISABLE_VOLTAGE),
        DriveState.REFRESH: NextStep(DISABLE_VOLTAGE),
        DriveState.MEASURE_INIT: NextStep(DISABLE_VOLTAGE),
        DriveState.READY_TO_SWITCH_ON: _ATTAINED,
        DriveState.SWITCH_ON_DISABLED: _ATTAINED,
        DriveState.FAULT: _ATTAINED,
    },
}


def decode_state(statusword: int) -> DriveState:
    """Return the state that a statusword of an EPOS2 tells."""
    return STATUSWORDS.get(statusword & STATE_BITS, DriveState.UNKNOWN)


def decode_standard_state(statusword: int) -> DriveState:
    """Return the state that a statusword tells as CiA 402 has it."""
    return STANDARD_STATUSWORDS.get(statusword & STANDARD_STATE_BITS, DriveState.UNKNOWN)


_DOES = {
    DriveState.QUICK_STOP_ACTIVE: "quick stop",
    DriveState.FAULT_REACTION: "fault",
    DriveState.FAULT: "fault",
}


def describe_statusword(statusword: int) -> str:
    """Return what any CiA 402 drive does: `moving`, `holding`, `quick stop`, `fault` or `power off`."""
    state = decode_standard_state(statusword)
    if state is DriveState.OPERATION_ENABLED:
        return "holding" if statusword & TARGET_REACHED else "moving"
    return _DOES.get(state, "power off")


def plan_controlword(
    statusword: int, goal: TargetState, decode: Callable[[int], DriveState] = decode_state
) -> NextStep:
    """Return the next step from `statusword`, whose state `decode` tells, towards `goal`.

    States that a drive passes by itself (start, refresh, measure init, fault reaction) and patterns that are
    in no document are waited through; who waits must bound it.

    Raises
    ------
    DriveError
        When the drive is to be enabled and reports a fault: a fault is reset by a person, never from here.
    """
    state = decode(statusword)
    if goal is TargetState.ENABLED and state in FAULTED:
        raise DriveError(
            f"the drive reports a fault (statusword 0x{statusword:04X}) and cannot be enabled",
            "find the cause; labrig devices home, or withdraw with a needle in tissue, resets it once you confirm",
        )
    return _PLANS[goal].get(state, _WAIT)
