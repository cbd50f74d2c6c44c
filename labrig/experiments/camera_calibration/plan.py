"""What a camera calibration asks of a rig."""

from labrig.devices.rig_file import RigDescription
from labrig.experiments.camera_calibration.protocol import CameraCalibrationProtocol
from labrig.runner.experiment import RunPlan
from labrig.runner.plan import find_rig_file_problems


def plan(protocol: CameraCalibrationProtocol, rig: RigDescription) -> RunPlan:
    """Return what the protocol is going to ask of a rig: pictures of the board, and one of the graph paper."""
    views = protocol.views
    return RunPlan(pictures=views + 1, operator_steps=views + 2, problems=tuple(find_rig_file_problems(rig)))
