from labrig.devices.axis import Axis, AxisReadback, Setpoint
from labrig.devices.camera import Camera, CameraSettings, Frame, PictureSource
from labrig.devices.check import CheckResult, CheckStatus, check_calibration, check_rig
from labrig.devices.cia402 import DriveState
from labrig.devices.clocks import SimulatedClock, SystemClock
from labrig.devices.homing import DIRECTIONS as HOMING_DIRECTIONS
from labrig.devices.homing import HERE as HOMING_HERE
from labrig.devices.homing import ORDER as HOME_ORDER
from labrig.devices.homing import ZEROS
from labrig.devices.operator import (
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
from labrig.devices.past import PastInsertion
from labrig.devices.replayed.comparison import Comparison, ReplayDifference
from labrig.devices.replayed.opening import open_replayed, recorded_rig
from labrig.devices.replayed.plant import ReplayedPlant
from labrig.devices.replayed.recording import Recording, recording_without_rig, recordings
from labrig.devices.rig import AXES, Opening, Rig, open_rig
from labrig.devices.rig_file import (
    AxisDescription,
    RigDescription,
    check_axis_move,
    load_rig,
    rig_schema,
    unknown_entries,
)
from labrig.devices.simulated.serving import ServedBus, serve_drives
from labrig.devices.state import RigState, RollZero, rig_state
from labrig.devices.stop import StopReport, stop_rig

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
    "DriveState",
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
