"""The fault matrix as a table: what goes wrong, and what must come of it; written down before anything is run.

Each fault strikes an axis that idles, that moves with the needle in tissue, and that homes; what somebody else does to
the drives strikes while axes idle, move, and hold still during a question. `Cell.outcome` is the whole expectation;
`tests/runner/fault_cells.py` makes it come true or not.
"""

from dataclasses import dataclass, replace
from enum import Enum

from labrig import errors

HEARTBEAT_S = 0.5
"""Silence after which a drive stops by itself, and the computer believes a drive to be dead."""

SPEED_MM_S, QUICK_STOP_MM_S2 = 5.0, 200.0


class Phase(Enum):
    """What the axis is doing when the fault strikes."""

    IDLE = "idle"
    MOVING = "moving"
    HOMING = "homing"
    ASKING = "asking"


class Stop(Enum):
    """By when the struck axis stands still, counted from the strike in the drive's own time [s].

    The computer or the drive can act; only the drive can, after heartbeat time and deceleration; the computer can, but
    knows of a missed heartbeat only after that time; the axis goes on until something asks, or to where it was sent.
    """

    BY_ANYBODY = 0.4
    BY_THE_DRIVE = HEARTBEAT_S + SPEED_MM_S / QUICK_STOP_MM_S2
    AFTER_SILENCE = HEARTBEAT_S + 0.5
    NO_DEADLINE = 60.0


class Lost(Enum):
    """Which axes have to be referenced again by the next run: those whose drive has to be switched off and on."""

    NONE = "none"
    STRUCK = "the struck one"
    ALL = "all"


@dataclass(frozen=True)
class FaultOutcome:
    """What must come of a fault."""

    ends: str  # exit status of the run
    error: type[errors.LabrigError] | None  # what names the fault
    words: str  # stand in the reason that the record states
    stop: Stop  # by when the axis stands still
    lost: Lost  # references that the next run does not believe
    counted: bool = False  # whether it shows in the counts of repeated questions and stray answers
    found_in_tissue: bool = False  # whether the needle is in tissue by the time it is found out
    fault: tuple[str, int] | None = None  # name and code that the error and the record's last event carry


SURVIVED = FaultOutcome("success", None, "", Stop.NO_DEADLINE, Lost.NONE, counted=True)
UNNOTICED = FaultOutcome("success", None, "", Stop.NO_DEADLINE, Lost.NONE)


_ONLY_FAULT: dict[type[errors.LabrigError], tuple[str, int]] = {
    errors.BusError: ("bus-lost", 0x8100), errors.BusPassiveError: ("error-passive", 0x8120),
    errors.BusOffError: ("bus-off", 0x81FD), errors.DriveRestartedError: ("boot-up", 0),
    errors.DriveRefusedError: ("sdo-abort", 0x08000022), errors.SecondMasterError: ("second-master", 0),
    errors.DriveStrayedError: ("strayed", 0),
}  # fmt: skip
_HEARTBEAT_LOST, _NO_ANSWER = ("heartbeat-lost", 0x8130), ("no-answer", 0x05040000)


def _fails(
    error: type[errors.LabrigError],
    words: str,
    stop: Stop = Stop.BY_ANYBODY,
    lost: Lost = Lost.STRUCK,
    fault: tuple[str, int] | None = None,
) -> FaultOutcome:
    return FaultOutcome("failed", error, words, stop, lost, fault=fault or _ONLY_FAULT.get(error))


def _emergency(code: int, words: str, stop: Stop = Stop.BY_ANYBODY, lost: Lost = Lost.STRUCK) -> FaultOutcome:
    return _fails(errors.DriveFaultError, f"error 0x{code:04X}, {words}", stop, lost, ("emergency", code))


def _find_later(
    error: type[errors.LabrigError], words: str, *, in_tissue: bool = False
) -> dict[Phase, FaultOutcome]:
    """Return what comes of a fault that is found when the next picture is taken, or the next line written."""
    found = _fails(error, words, lost=Lost.NONE)
    later = replace(found, found_in_tissue=in_tissue)
    return {Phase.IDLE: later, Phase.MOVING: found, Phase.HOMING: replace(later, stop=Stop.NO_DEADLINE)}


def _aborts(error: type[errors.LabrigError], words: str) -> FaultOutcome:
    return FaultOutcome("aborted", error, words, Stop.BY_ANYBODY, Lost.NONE)


_SILENT = _fails(errors.DriveSilentError, "did not answer", lost=Lost.ALL, fault=_NO_ANSWER)
_SILENT_AT_REST = replace(_SILENT, stop=Stop.AFTER_SILENCE)  # nothing moves, and the dead-man acts
_HUNG = _emergency(0x8130, "life guarding", Stop.BY_THE_DRIVE, Lost.ALL)
_STOOD_STILL = replace(_HUNG, words="labrig itself stood still for")
_RESTARTED = _fails(errors.DriveRestartedError, "has restarted: it lost power")


def _at_the_next_question(outcome: FaultOutcome) -> dict[Phase, FaultOutcome]:
    """Return what comes of a fault in an answer: axes report without being asked, until the next move is to start."""
    return dict.fromkeys(Phase, outcome) | {Phase.MOVING: replace(outcome, stop=Stop.NO_DEADLINE)}


EMERGENCIES = {
    "over-current": (0x2310, "over-current"),
    "under-voltage": (0x3220, "under-voltage"),
    "CAN overrun": (0x8110, "CAN overrun"),
}
"""Error of the drive -> its code, and what the reason says of it: one at which power goes at once, one of which the
cause may persist, one after which it brakes first. The codes of all others are rows of `labrig.devices.drives.errors`.
"""

FAULTS: dict[str, FaultOutcome | dict[Phase, FaultOutcome]] = {
    # Survived and counted
    "one frame duplicated": SURVIVED,
    "one frame lost": SURVIVED,
    "one answer lost": SURVIVED,
    "one frame late": SURVIVED,
    # The drive or its answers
    "node silent": _SILENT,
    "node deaf": replace(_SILENT, stop=Stop.BY_THE_DRIVE),
    "boot-up": _RESTARTED,
    "SDO abort": _at_the_next_question(
        _fails(errors.DriveRefusedError, "SDO abort 0x08000022", lost=Lost.NONE)
    ),
    "SDO timeout": _at_the_next_question(replace(_SILENT, lost=Lost.NONE)),
    "heartbeat of the drive lost": _fails(
        errors.DriveSilentError, "has sent no heartbeat", Stop.AFTER_SILENCE, Lost.NONE, _HEARTBEAT_LOST
    ),
    "node-id clash": _RESTARTED,
    # What the drive reports
    **{f"EMCY {name}": _emergency(code, words) for name, (code, words) in EMERGENCIES.items()},
    "following error": {
        # It is found out once the axis is to move.
        Phase.IDLE: replace(_emergency(0x8611, "following error"), found_in_tissue=True),
        Phase.MOVING: _emergency(0x8611, "following error"),
        # Homing by current takes what blocks it for the stop; it is found out on the way back.
        Phase.HOMING: _emergency(0x8611, "following error", Stop.NO_DEADLINE),
    },
    "software limit": _emergency(0xFF09, "software position limit"),
    "limit switch": dict.fromkeys(Phase, _emergency(0xFF07, "positive limit switch"))
    | {Phase.HOMING: UNNOTICED},
    "emergency stop": _emergency(0x3220, "under-voltage: supply cut or emergency stop"),
    # The bus
    "bus off": _fails(errors.BusOffError, "the CAN bus is off", Stop.BY_THE_DRIVE, Lost.ALL),
    "bus passive": _fails(errors.BusPassiveError, "error passive", lost=Lost.NONE),
    "adapter unplugged": _fails(errors.BusError, "took no frame", Stop.BY_THE_DRIVE, Lost.ALL),
    # Another drive in place of the one that was verified
    "wrong encoder resolution": _RESTARTED,
    "wrong vendor": _RESTARTED,
    "unknown hardware": _RESTARTED,
    "fingerprint mismatch": _RESTARTED,
    # The computer
    "computer hangs": _HUNG,
    "signal": _aborts(errors.InterruptedRunError, "interrupted by SIGINT"),
    "camera lost": _find_later(errors.CameraError, "gave no picture"),
    "camera frozen": _find_later(errors.CameraError, "the same picture", in_tissue=True),
    "disk full": _find_later(errors.DiskError, "cannot write"),
}
"""Fault -> what must come of it, in every phase or by phase."""


def _second_master(words: str, lost: Lost = Lost.NONE) -> FaultOutcome:
    return _fails(errors.SecondMasterError, words, lost=lost)


def _strayed(words: str, fault: str, lost: Lost = Lost.NONE) -> FaultOutcome:
    return _fails(errors.DriveStrayedError, words, lost=lost, fault=(fault, 0))


def _guarded(words: str, fault: str = "input-limit") -> FaultOutcome:
    return _fails(errors.ForceGuardError, words, lost=Lost.NONE, fault=(fault, 0))


_STALLED = _guarded("the insertion axis is stalled: 1500 mA for", "stalled")

SCENARIOS: dict[str, FaultOutcome | dict[Phase, FaultOutcome]] = {
    # Another program commands the drives
    "second master retargets": _second_master("it writes object 0x607A:00 of axis insertion"),
    "second master retargets by process data": _second_master("CAN frame 401#"),
    "second master moves an idle axis": _second_master("it writes object 0x607A:00 of axis linear"),
    "second master writes a setting": _second_master("it writes object 0x6065:00"),
    "second master takes the dead-man away": _second_master("it writes object 0x6007:00"),
    "second master homes": _second_master("it writes object 0x6098:00", Lost.STRUCK),
    "second master takes power away": _second_master("CAN frame 201#0000"),
    "second master resets": _second_master("NMT command 0x81 to node 1", Lost.STRUCK),
    "second master resets the communication": _second_master("NMT command 0x82 to node 0"),
    "second master makes nodes pre-operational": _second_master("NMT command 0x80 to node 0"),
    "second master stops a node": _second_master("NMT command 0x02 to node 1"),
    "second master beats": _second_master("it sends the heartbeat of node 127"),
    "another client reads": SURVIVED,
    # The drives are lost, labrig itself stands still, or its terminal has gone
    "all nodes silent": dict.fromkeys(Phase, _SILENT_AT_REST) | {Phase.MOVING: _SILENT},
    "labrig stopped for 0.3 s": UNNOTICED,
    "labrig stopped for 0.8 s": _STOOD_STILL,
    "terminal closes": _aborts(errors.InterruptedRunError, "interrupted by SIGHUP"),
    "terminal gone stale": dict.fromkeys(Phase, UNNOTICED)
    | {Phase.ASKING: _aborts(errors.SafetyStopError, "before the operator answered")},
    # Nothing on the bus tells of it
    "target changed in the drive": _strayed("axis insertion has the target 60.0000 mm", "target-changed"),
    "idle axis moved": _strayed("axis linear should stand at", "strayed"),
    "encoder jumps": _strayed("jumped from", "position-jump", Lost.STRUCK),
    # Something holds the needle, or an input of a drive says that nothing may move
    # It is found out once the axis is to move.
    "stall in gel": dict.fromkeys(Phase, replace(_STALLED, stop=Stop.NO_DEADLINE, found_in_tissue=True))
    | {Phase.MOVING: _STALLED},
    "force limit exceeded": _guarded("input needle_force is 25 N, limits [-20, 20] N"),
    "door opened": _guarded("input door is off, expected on"),
    "node becomes pre-operational": _strayed("is in NMT state pre-operational", "not-operational"),
}
"""What somebody else does -> what must come of it, in every phase or by phase."""

TOLD_WITHIN_S = 1.0
"""Longest time from the loss of the drives until the person at the rig is told."""

REFUSED_AT_CONNECT = {
    "node-id clash": "two nodes answer as node",
    "wrong encoder resolution": "counts_per_turn 4000 (0x2210:01), the rig file says 2000",
    "wrong vendor": "is no EPOS2 that labrig knows: profile 402, vendor 0x",
    "unknown hardware": "vendor 0xFB, product code 0x65520000",
    "fingerprint mismatch": "configuration fingerprint",
    "force limit exceeded": "input needle_force is 25 N",
    "door opened": "input door is off",
}
"""Fault -> what the next run says when it finds it there; these are not mended by switching off and on."""

WITHDRAWN_NEVERTHELESS = {"force limit exceeded", "door opened"}
"""Faults at which no run begins, and which must not keep a needle in tissue."""


def outcome_of(fault: str, phase: Phase) -> FaultOutcome:
    """Return what must come of a fault in a phase."""
    expected = (FAULTS | SCENARIOS)[fault]
    return expected if isinstance(expected, FaultOutcome) else expected[phase]


CELLS = [
    *((fault, phase) for fault in FAULTS for phase in (Phase.IDLE, Phase.MOVING, Phase.HOMING)),
    *((fault, phase) for fault in SCENARIOS for phase in (Phase.IDLE, Phase.MOVING, Phase.ASKING)),
]
"""Every cell of the matrix."""
