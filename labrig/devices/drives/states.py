"""The state machine of CiA 402: what a statusword says, and the next controlword towards a goal, as pure functions.

No controlword here resets a fault. One leads to an enabled power stage only if enabling is the goal, and then with the
Halt bit set, so that a stale target moves nothing.
"""

from enum import Enum, auto


class DriveState(Enum):
    """State that a statusword tells, with its patterns of the bits that name states; others are unknown."""

    NOT_READY = 0x0000, 0x0020
    SWITCH_ON_DISABLED = 0x0040, 0x0060
    READY_TO_SWITCH_ON = (0x0021,)
    SWITCHED_ON = (0x0023,)
    OPERATION_ENABLED = (0x0027,)
    QUICK_STOP_ACTIVE = (0x0007,)
    FAULT_REACTION = 0x000F, 0x002F
    FAULT = 0x0008, 0x0028
    UNKNOWN = ()

    # Every reading looks its state up in tables; Enum would hash the name each time, in Python.
    __hash__ = object.__hash__


class TargetState(Enum):
    """Where a drive is to be brought."""

    ENABLED = auto()
    QUICK_STOPPED = auto()
    POWER_OFF = auto()


# The bits of the controlword, object 0x6040.
SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
ENABLE = 0x000F
DISABLE_VOLTAGE = 0x0000
QUICK_STOP = 0x0002
NEW_SETPOINT = 0x0010
CHANGE_IMMEDIATELY = 0x0020
FAULT_RESET = 0x0080
HALT = 0x0100

# The bits of the statusword, object 0x6041.
REMOTE = 0x0200
TARGET_REACHED = 0x0400
SETPOINT_ACKNOWLEDGED = 0x1000
HOMING_ATTAINED = 0x1000
HOMING_ERROR = 0x2000

_STATE_BITS = 0x006F
"""The bits that name a state; bit 4 is the voltage, bits 8 and 14 are the manufacturer's."""

_STATES = {pattern: state for state in DriveState for pattern in state.value}

FAULTED = frozenset({DriveState.FAULT_REACTION, DriveState.FAULT})

_WITHOUT_POWER = {DriveState.READY_TO_SWITCH_ON, DriveState.SWITCH_ON_DISABLED, DriveState.FAULT}

_ATTAINED = {
    TargetState.ENABLED: {DriveState.OPERATION_ENABLED},
    TargetState.QUICK_STOPPED: {DriveState.QUICK_STOP_ACTIVE, *_WITHOUT_POWER},
    TargetState.POWER_OFF: _WITHOUT_POWER,
}
_SWITCH_OFF = dict.fromkeys(
    (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE, DriveState.SWITCHED_ON), DISABLE_VOLTAGE
)
_NEXT = {
    TargetState.ENABLED: {
        DriveState.SWITCH_ON_DISABLED: SHUTDOWN | HALT,
        DriveState.READY_TO_SWITCH_ON: SWITCH_ON | HALT,
        DriveState.SWITCHED_ON: ENABLE | HALT,
        DriveState.QUICK_STOP_ACTIVE: DISABLE_VOLTAGE | HALT,
    },
    TargetState.QUICK_STOPPED: _SWITCH_OFF | {DriveState.OPERATION_ENABLED: QUICK_STOP},
    TargetState.POWER_OFF: _SWITCH_OFF,
}


def decode_state(statusword: int) -> DriveState:
    """Return the state that a statusword tells."""
    return _STATES.get(statusword & _STATE_BITS, DriveState.UNKNOWN)


def describe_statusword(statusword: int) -> str:
    """Return what a drive does: `moving`, `holding`, `quick stop`, `fault` or `power off`."""
    state = decode_state(statusword)
    if state is DriveState.OPERATION_ENABLED:
        return "holding" if statusword & TARGET_REACHED else "moving"
    if state in FAULTED:
        return "fault"
    return "quick stop" if state is DriveState.QUICK_STOP_ACTIVE else "power off"


def is_attained(state: DriveState, goal: TargetState) -> bool:
    """Tell whether a state is the goal, or as good: a drive without power needs no quick stop."""
    return state in _ATTAINED[goal]


def plan_controlword(state: DriveState, goal: TargetState) -> int | None:
    """Return the next controlword towards a goal; None to wait, as in a state that the drive leaves by itself."""
    return None if is_attained(state, goal) else _NEXT[goal].get(state)
