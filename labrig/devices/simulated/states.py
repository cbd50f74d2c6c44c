"""The state machine of CiA 402 as a drive has it: where a controlword leads, and how the statusword shows a state."""

from labrig.devices.drives.states import DriveState

STATUS = {
    DriveState.SWITCH_ON_DISABLED: 0x0140,
    DriveState.READY_TO_SWITCH_ON: 0x0121,
    DriveState.SWITCHED_ON: 0x0123,
    DriveState.OPERATION_ENABLED: 0x0137,
    DriveState.QUICK_STOP_ACTIVE: 0x0117,
    DriveState.FAULT_REACTION: 0x010F,
    DriveState.FAULT: 0x0108,
}
"""What the statusword of an EPOS2 says of each state."""

POWERED = frozenset({DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION})
STOPPING = POWERED - {DriveState.OPERATION_ENABLED}


def obey(state: DriveState, controlword: int) -> DriveState:
    """Return the state to which a controlword leads from one without a fault."""
    if not controlword & 0x02:
        return DriveState.SWITCH_ON_DISABLED
    if not controlword & 0x04:
        return DriveState.QUICK_STOP_ACTIVE if state in POWERED else DriveState.SWITCH_ON_DISABLED
    if state is DriveState.QUICK_STOP_ACTIVE:
        return state
    if not controlword & 0x01:
        return DriveState.READY_TO_SWITCH_ON
    if state is DriveState.SWITCH_ON_DISABLED:
        return state
    # Transitions 3 and 4 may be combined.
    return DriveState.OPERATION_ENABLED if controlword & 0x08 else DriveState.SWITCHED_ON
