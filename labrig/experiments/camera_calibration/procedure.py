"""The pictures of a camera calibration: a chessboard held in many poses (Zhang 1999), then graph paper in the plane."""

from labrig.devices.operator import ClearBench, HoldBoard, LayGraphPaper
from labrig.errors import InputError
from labrig.experiments.camera_calibration.events import CalibrationRole
from labrig.experiments.camera_calibration.protocol import SCALE_HINT, CameraCalibrationProtocol
from labrig.runner.session import Session


def run(protocol: CameraCalibrationProtocol, session: Session) -> None:
    """Take every picture through the rig's camera; no axis moves.

    Raises
    ------
    InputError
        If nothing tells how far the camera is.
    """
    rig = session.description
    if not (protocol.plane.distance_mm or rig.camera.distance_mm or "plane.json" in rig.calibration_files()):
        raise InputError("nothing tells how far the camera is from the graph paper", SCALE_HINT)
    board = protocol.board
    for view in range(protocol.views):
        session.tell(f"board, view {view + 1} of {protocol.views}")
        session.ask(HoldBoard(view, protocol.views, board.columns, board.rows, board.square_mm))
        session.take_picture(CalibrationRole.BOARD)
    session.ask(LayGraphPaper(protocol.plane.pitch_mm))
    session.take_picture(CalibrationRole.GRAPH_PAPER)
    session.ask(ClearBench("the graph paper"))
