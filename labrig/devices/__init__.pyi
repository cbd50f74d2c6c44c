from .axis import Axis, AxisReadback, Setpoint
from .camera import Camera, CameraSettings, Exposure, Frame, PictureSource
from .camera_kind import CameraContext, CameraKind
from .camera_settings import CameraDescription, ControlledCameraDescription
from .check import check_calibration, check_rig
from .check_result import CheckResult, CheckStatus
from .cia402 import DriveState
from .clocks import SimulatedClock, SystemClock
from .homing import HOME_ORDER, HOMING_DIRECTIONS, HOMING_HERE, ZEROS
from .operator import (
    Answer,
    ClearBench,
    ConfirmAxesAtZero,
    ConfirmFaultReset,
    ConfirmFree,
    ConfirmHere,
    ConfirmMotion,
    ConfirmNeedleOut,
    ConfirmPlan,
    ConfirmStance,
    ConfirmStopped,
    ConfirmWithdrawal,
    HoldBoard,
    LayGraphPaper,
    MountNeedle,
    Operator,
    OperatorRequest,
    PickTarget,
    PlacePhantom,
    PlaceSpecimen,
    ReadScale,
    ShiftToHole,
    WithdrawNeedle,
    request_details,
)
from .past import PastInsertion
from .replayed.comparison import Comparison, ReplayDifference
from .replayed.opening import open_replayed, recorded_rig
from .replayed.plant import ReplayedPlant
from .replayed.recording import Recording, recording_without_rig, recordings
from .rig import AXES, Opening, Rig, open_rig
from .rig_file import (
    AxisDescription,
    RigDescription,
    check_axis_move,
    load_rig,
    rig_schema,
    unknown_entries,
)
from .simulated.serving import ServedBus, serve_drives
from .state import RigState, RollZero, rig_state
from .stop import StopReport, stop_rig

__all__ = [
    "AXES",
    "HOME_ORDER",
    "HOMING_DIRECTIONS",
    "HOMING_HERE",
    "ZEROS",
    "Answer",
    "Axis",
    "AxisDescription",
    "AxisReadback",
    "Camera",
    "CameraContext",
    "CameraDescription",
    "CameraKind",
    "CameraSettings",
    "CheckResult",
    "CheckStatus",
    "ClearBench",
    "Comparison",
    "ConfirmAxesAtZero",
    "ConfirmFaultReset",
    "ConfirmFree",
    "ConfirmHere",
    "ConfirmMotion",
    "ConfirmNeedleOut",
    "ConfirmPlan",
    "ConfirmStance",
    "ConfirmStopped",
    "ConfirmWithdrawal",
    "ControlledCameraDescription",
    "DriveState",
    "Exposure",
    "Frame",
    "HoldBoard",
    "LayGraphPaper",
    "MountNeedle",
    "Opening",
    "Operator",
    "OperatorRequest",
    "PastInsertion",
    "PickTarget",
    "PictureSource",
    "PlacePhantom",
    "PlaceSpecimen",
    "ReadScale",
    "Recording",
    "ReplayDifference",
    "ReplayedPlant",
    "Rig",
    "RigDescription",
    "RigState",
    "RollZero",
    "ServedBus",
    "Setpoint",
    "ShiftToHole",
    "SimulatedClock",
    "StopReport",
    "SystemClock",
    "WithdrawNeedle",
    "check_axis_move",
    "check_calibration",
    "check_rig",
    "load_rig",
    "open_replayed",
    "open_rig",
    "recorded_rig",
    "recording_without_rig",
    "recordings",
    "request_details",
    "rig_schema",
    "rig_state",
    "serve_drives",
    "stop_rig",
    "unknown_entries",
]
