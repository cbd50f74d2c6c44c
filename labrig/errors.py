"""Every failure that labrig reports, as a tree.

.. code-block:: text

    LabrigError                    message, hint, exit_code
    ├── AnswerIsNoError       (1)  the command ran, and the answer is no
    │   ├── CalibrationRefusedError
    │   ├── MeasurementRefusedError
    │   ├── ConditionMetError      a run that a condition of its protocol stopped
    │   └── TargetMissedError      an insertion that did not reach its target; carries the reason as a word
    │       └── TrialsFailedError  a run at its end, some of whose trials have failed
    ├── InputError            (2)  the input cannot be used; also a ValueError
    │   ├── FileFormatError        a YAML or JSON file; carries a list of `Problem` with line and column
    │   ├── PictureError           a file that is not a picture, or a picture of another size
    │   ├── OutputExistsError      something would be overwritten
    │   ├── PluginError            an experiment, drive or camera of a package that cannot be used
    │   └── LimitError             a move beyond an axis' limits, refused before it starts
    ├── MachineError          (3)  a device or the computer failed, or motion had to stop
    │   ├── WireError              bus or drive; carries a `Fault`: name, code, register, text; the hint is the remedy
    │   │   ├── BusError           bus-lost: no CAN interface, adapter unplugged
    │   │   │   ├── BusPassiveError   error-passive: the computer's CAN controller sees many errors
    │   │   │   └── BusOffError       bus-off: so many errors that it has left the bus
    │   │   ├── SecondMasterError  second-master: another program commands the drives, or beats as labrig does
    │   │   └── DriveError         a drive that does not do what it should
    │   │       ├── DriveFaultError     emergency: it reports an error, with its code and register
    │   │       ├── DriveRefusedError   sdo-abort: it refused an object, with the abort code
    │   │       ├── DriveRestartedError    boot-up: it lost power or was reset, and with it its reference
    │   │       ├── DriveSilentError    no-answer or heartbeat-lost
    │   │       ├── ForceGuardError     stalled or input-limit: the axis is held up, or an input is beyond its limit
    │   │       └── DriveStrayedError   strayed, position-jump, target-changed or not-operational
    │   ├── CameraError            no camera, a setting ignored, no picture
    │   ├── DiskError              no space, not writable
    │   ├── LockedError            a rig or a run that another labrig uses
    │   ├── WorkersError           processes or computers that do the work are lost, or cannot do it rightly
    │   └── SafetyStopError        stopped because continuing was not known to be safe
    │       └── OperatorDeclinedError  the operator said no
    ├── RecordError           (4)  a damaged run, or a folder that is not a run
    ├── BugError              (5)  labrig itself failed; names the traceback's file, or what it damaged
    └── InterruptedRunError (130)  INT, TERM or HUP

A message names the thing, its value and the limit; the hint says what to do. `cli/` prints both and exits with
`exit_code`; nothing else in labrig prints or exits.
"""

from copy import copy
from dataclasses import dataclass
from typing import Self


class LabrigError(Exception):
    """A failure with a sentence for the user and a hint.

    Parameters
    ----------
    message : str
        Names the thing, its value and the limit.
    hint : str
        What the user can do about it; may be empty.
    """

    exit_code = 3

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def reword(self, message: str, hint: str | None = None) -> Self:
        """Return a copy of this error with another message, and another hint if one is given."""
        twin = copy(self)
        twin.args = (message,)
        twin.message = message
        twin.hint = self.hint if hint is None else hint
        return twin


class AnswerIsNoError(LabrigError):
    """The command ran to its end and the answer is no."""

    exit_code = 1


class CalibrationRefusedError(AnswerIsNoError):
    """A calibration whose numbers would be wrong."""


class MeasurementRefusedError(AnswerIsNoError):
    """A picture from which the wanted quantity cannot be measured."""


class ConditionMetError(AnswerIsNoError):
    """A run that a condition of its protocol stopped."""


class TargetMissedError(AnswerIsNoError):
    """An insertion that did not reach its target, or could not begin.

    Parameters
    ----------
    reason : str
        target_missed, reached_in_plane_only, needle_lost, needle_stuck, marker_lost or marker_jumped if the needle was
        inserted and withdrawn again; sheath_astray if it did not leave its sheath; no_path, no_target, no_roll_zero or
        no_marker if nothing was inserted.
    """

    def __init__(self, message: str, hint: str = "", *, reason: str = "target_missed") -> None:
        super().__init__(message, hint)
        self.reason = reason


class TrialsFailedError(TargetMissedError):
    """A run that has come to its end, and some of whose trials have failed; it can be measured."""


class InputError(LabrigError, ValueError):
    """The input cannot be used."""

    exit_code = 2


@dataclass(frozen=True)
class Problem:
    """A problem of a file: its place, what is wrong, what to do.

    `where` reads `file:line:column key.path`; parts that are not known are left out.
    """

    where: str
    message: str
    hint: str = ""


class FileFormatError(InputError):
    """A YAML or JSON file with problems, all of which are reported."""

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        first = problems[0]
        lines = [
            f"{p.where}: {p.message}" + (f" ({p.hint})" if p.hint and p is not first else "")
            for p in problems
        ]
        super().__init__("\n".join(lines), first.hint)
        self.problems = problems

    def __reduce__(self) -> tuple[type[Self], tuple[tuple[Problem, ...]]]:
        """Allow a worker process to pass the error to its parent."""
        return type(self), (self.problems,)


class PictureError(InputError):
    """A file that is not a picture, or a picture of another size."""


class PluginError(InputError):
    """An experiment, a drive or a camera of an installed package that cannot be imported or does not fit labrig."""


class OutputExistsError(InputError):
    """A file or folder would be overwritten."""


class LimitError(InputError):
    """A move beyond the limits of an axis; refused before anything is sent."""


class MachineError(LabrigError):
    """A device or the computer failed, or motion had to stop."""


class WorkersError(MachineError):
    """The workers of a pool are lost, or cannot do these tasks rightly: no further task can be done."""


@dataclass(frozen=True)
class Fault:
    """What is wrong with bus or drive: a word that never changes, and the number that manuals use.

    Parameters
    ----------
    name : str
        The word: see the tree above.
    code : int
        Error code of an EMCY (CiA 301; 0x81FD is maxon's), or SDO abort code if a transfer failed; 0 if there is
        neither, as for a boot-up message.
    register : int
        Its bits in the error register 0x1001.
    text : str
        What it means.
    """

    name: str
    code: int
    register: int
    text: str


_COMMUNICATION = 0x10
"""Bit of the error register 0x1001 (CiA 301)."""

HEARTBEAT_LOST = Fault("heartbeat-lost", 0x8130, _COMMUNICATION, "the drive's heartbeat has stopped")
NO_ANSWER = Fault("no-answer", 0x05040000, _COMMUNICATION, "SDO protocol timed out")
STRAYED = Fault("strayed", 0, 0, "the axis is not where it should be")
POSITION_JUMPED = Fault("position-jump", 0, 0, "the position changed faster than the axis can move")
TARGET_CHANGED = Fault("target-changed", 0, 0, "the drive has another target than the one sent")
NOT_OPERATIONAL = Fault("not-operational", 0, 0, "the drive has left the NMT state operational")

STALLED = Fault("stalled", 0, 0, "the motor gives all its current, and the axis lags")
INPUT_BEYOND_LIMIT = Fault("input-limit", 0, 0, "an input of a drive is beyond its limit")


class WireError(MachineError):
    """The CAN bus or a drive on it fails.

    Parameters
    ----------
    fault : Fault or None
        The fault, if it has a name; by default that of the class. The remedy is the hint.
    """

    fault: Fault | None = None

    def __init__(self, message: str, hint: str = "", *, fault: Fault | None = None) -> None:
        super().__init__(message, hint)
        if fault is not None:
            self.fault = fault

    @property
    def code(self) -> int:
        """The number of the fault; 0 without one."""
        return 0 if self.fault is None else self.fault.code


def fault_of(error: Exception | None) -> Fault | None:
    """Return the fault of bus or drive that an error carries, or None."""
    return error.fault if isinstance(error, WireError) else None


class BusError(WireError):
    """The CAN interface is missing or unreachable."""

    fault = Fault("bus-lost", 0x8100, _COMMUNICATION, "no communication over the CAN bus")


class BusPassiveError(BusError):
    """The computer's CAN controller has counted many errors: frames may be lost."""

    fault = Fault("error-passive", 0x8120, _COMMUNICATION, "CAN controller in error passive mode")


class BusOffError(BusError):
    """The computer's CAN controller has counted too many errors and has left the bus."""

    fault = Fault("bus-off", 0x81FD, _COMMUNICATION, "CAN controller off the bus")


class SecondMasterError(WireError):
    """Another program on the bus commands the drives, or sends heartbeats under labrig's own node id."""

    fault = Fault("second-master", 0, 0, "another program commands the drives")


class DriveError(WireError):
    """A drive does not do what it should.

    Parameters
    ----------
    axis : str
        Its axis; empty if the error is not of one alone.
    """

    def __init__(self, message: str, hint: str = "", *, fault: Fault | None = None, axis: str = "") -> None:
        super().__init__(message, hint, fault=fault)
        self.axis = axis


class DriveFaultError(DriveError):
    """A drive reports an error; its fault, `emergency`, has code and register as reported."""


class DriveRefusedError(DriveError):
    """A drive refused an object; its fault, `sdo-abort`, has the abort code."""


class DriveRestartedError(DriveError):
    """A drive has restarted: it lost power, and with it position and reference."""

    fault = Fault("boot-up", 0, 0, "the drive has restarted")


class DriveSilentError(DriveError):
    """A drive does not answer (`NO_ANSWER`), or its heartbeat has stopped (`HEARTBEAT_LOST`)."""

    fault = NO_ANSWER


class DriveStrayedError(DriveError):
    """An axis that is not where it should be, or whose drive was given another target or NMT state by somebody."""

    fault = STRAYED


class ForceGuardError(DriveError):
    """An axis that something holds up, or an input of a drive with which no run may go on."""

    fault = STALLED


class CameraError(MachineError):
    """No camera, a setting that the camera ignored, or no picture."""


class DiskError(MachineError):
    """No space is left, or a folder cannot be written."""


class LockedError(MachineError):
    """A rig or a run is in use by another process."""


class SafetyStopError(MachineError):
    """Stopped because continuing was not known to be safe."""


class OperatorDeclinedError(SafetyStopError):
    """The operator said no to what the run needs."""


class RecordError(LabrigError):
    """A run that is damaged or of a newer schema, or a folder that is not a run."""

    exit_code = 4


class BugError(LabrigError):
    """Something in labrig failed that should not.

    The message names the file that holds the traceback, or what is damaged in a run as labrig wrote it.
    """

    exit_code = 5


class InterruptedRunError(LabrigError):
    """INT, TERM or HUP arrived."""

    exit_code = 130
