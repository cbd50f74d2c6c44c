"""The protocol of a camera calibration."""

from typing import Literal

from pydantic import Field

from labrig.protocol.model import Direction, Line, Model, PixelUv
from labrig.protocol.sections import ExperimentProtocol
from labrig.vision.gel import Gel

SCALE_HINT = (
    "state plane.distance_mm in the protocol, or camera.distance_mm in the rig file, by tape, to 20 %"
)


class Board(Model):
    """The chessboard that the operator holds."""

    columns: int = Field(ge=3, le=100)
    """Inner corners in a row of the board."""
    rows: int = Field(ge=3, le=100)
    """Inner corners in a column of the board."""
    square_mm: float = Field(gt=0, le=500)
    """Side of a square [mm]."""


class PaperSetup(Model):
    """What lies above the needle's plane, and how well the paper's place is known."""

    paper_sigma_mm: float | None = Field(None, ge=0, le=10)
    """Standard deviation of the paper's height over the needle's plane [mm]; null: not in the interval."""
    gel: Gel | None = None
    """The gel above the needle, to be corrected for; null where there is none."""


class GraphPaper(PaperSetup):
    """The graph paper that lies in the steering plane, and the frame that it fixes."""

    pitch_mm: float = Field(gt=0, le=100)
    """Distance between the nearest lines of the graph paper [mm]."""
    distance_mm: float | None = Field(None, gt=0, le=10_000)
    """Distance from the camera to the paper by tape, to 20 % [mm]; null: that of the rig file, else the scale
    of the rig's last plane map."""
    origin_px: PixelUv
    """Pixel (u, v) that becomes the origin of the steering plane [px]."""
    insertion: Direction
    """Where the insertion points in the picture."""


class CameraCalibrationProtocol(ExperimentProtocol):
    """Intrinsics from a board held by the operator, then the steering plane from graph paper."""

    experiment: Literal["camera-calibration"]
    """Which experiment this file describes."""
    title: Line = "Camera calibration"
    """Heading of the report."""
    board: Board
    """The chessboard that the operator holds."""
    views: int = Field(ge=3, le=200)
    """Pictures of the board, each in another pose."""
    plane: GraphPaper
    """The graph paper in the steering plane, and the frame that it fixes."""


Protocol = CameraCalibrationProtocol
