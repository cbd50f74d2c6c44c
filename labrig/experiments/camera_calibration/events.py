"""What a camera calibration writes."""

from labrig.record.events import PictureRole


class CalibrationRole(PictureRole):
    """Pictures of the chessboard, for the lens, and of the graph paper, for the steering plane."""

    BOARD = "board"
    GRAPH_PAPER = "graph-paper"
