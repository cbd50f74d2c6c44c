"""The protocol of a camera calibration."""

from typing import Literal

from pydantic import Field

from labrig.protocol.model import Direction, Line, Model, PixelUv
from labrig.protocol.sections import ExperimentProtocol


class Board(Model):
    """The chessboard that the operator holds."""

    columns: int = Field(ge=3, le=100, description="Inner corners in a row of the board.")
    rows: int = Field(ge=3, le=100, description="Inner corners in a column of the board.")
    square_mm: float = Field(gt=0, le=500, description="Side of a square [mm].")


class GelAbove(Model):
    """The gel that will lie between the camera and the needle, whose refraction is corrected."""

    index: float = Field(ge=1, le=2, description="Refractive index of the gel; gelatin has about 1.35.")
    depth_mm: float = Field(
        ge=0,
        le=1000,
        description="Depth of the needle below the gel's flat surface, which is parallel to the paper [mm].",
    )
    paper_at: Literal["needle", "surface"] = Field(
        "needle",
        description="Where the paper lies when it is photographed, in air: where the needle is to be, or on the gel's "
        "surface.",
    )


class GraphPaper(Model):
    """The graph paper that lies in the steering plane, and the frame that it fixes."""

    pitch_mm: float = Field(
        gt=0, le=100, description="Distance from one line of the graph paper to the next [mm]."
    )
    origin_px: PixelUv = Field(description="Pixel (u, v) that becomes the origin of the steering plane [px].")
    insertion: Direction = Field(description="Where the insertion points in the picture.")
    gel: GelAbove | None = Field(
        None,
        description="The gel above the needle, to be corrected for; null where the paper lies at the needle's depth in "
        "the same gel, or where there is none.",
    )
    camera_moved: bool = Field(
        default=False,
        description="Whether camera, lens or the height of the paper were changed since the rig's last plane map; "
        "if not, a scale more than 1.2 times as large or as small is refused: other lines may have been counted.",
    )


class CameraCalibrationProtocol(ExperimentProtocol):
    """Intrinsics from a board held by the operator, then the steering plane from graph paper."""

    experiment: Literal["camera-calibration"] = Field(description="Which experiment this file describes.")
    title: Line = Field("Camera calibration", description="Heading of the report.")
    board: Board = Field(description="The chessboard that the operator holds.")
    views: int = Field(ge=3, le=200, description="Pictures of the board, each in another pose.")
    plane: GraphPaper = Field(
        description="The graph paper in the steering plane, and the frame that it fixes."
    )
