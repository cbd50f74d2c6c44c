"""The protocol of a camera calibration."""

import math
from typing import Annotated, Literal

from pydantic import Field

from labrig.protocol.model import Direction, Line, Model, PixelUv
from labrig.protocol.sections import ExperimentProtocol
from labrig.vision.refraction import Gel, Layer, Material, PaperPlace

Tilt = Annotated[float, Field(ge=-20, le=20)]


class Board(Model):
    """The chessboard that the operator holds."""

    columns: int = Field(ge=3, le=100, description="Inner corners in a row of the board.")
    rows: int = Field(ge=3, le=100, description="Inner corners in a column of the board.")
    square_mm: float = Field(gt=0, le=500, description="Side of a square [mm].")


class LayerAbove(Model):
    """A wall or an air gap between the camera and the gel."""

    index: Annotated[float, Field(ge=1, le=2)] | Material = Field(
        description="Refractive index, or the material: glass, acrylic, polycarbonate, air."
    )
    thickness_mm: float = Field(ge=0, le=1000, description="Thickness [mm].")
    thickness_sigma_mm: float | None = Field(
        None, ge=0, le=100, description="Standard deviation of the thickness [mm]; null: not in the interval."
    )
    index_sigma: float | None = Field(
        None,
        ge=0,
        le=0.5,
        description="Standard deviation of the index; null: that of the material, or not in the interval.",
    )

    def layer(self) -> Layer:
        """Return the layer as the plane map takes it."""
        return Layer.of(self.index, self.thickness_mm, self.thickness_sigma_mm, self.index_sigma)


class GelAbove(Model):
    """The gel that will lie between the camera and the needle, whose refraction is corrected."""

    index: float = Field(ge=1, le=2, description="Refractive index of the gel; gelatin has about 1.35.")
    depth_mm: float = Field(
        ge=0, le=1000, description="Depth of the needle below the gel's flat surface, at the origin [mm]."
    )
    paper_at: PaperPlace = Field(
        "needle",
        description="Where the paper lies when it is photographed: in air where the needle is to be, in air on the "
        "outermost surface, or in the gel where the needle is to be.",
    )
    index_sigma: float | None = Field(
        None, ge=0, le=0.5, description="Standard deviation of the index; null: not in the interval."
    )
    depth_sigma_mm: float | None = Field(
        None, ge=0, le=100, description="Standard deviation of the depth [mm]; null: not in the interval."
    )
    layers: tuple[LayerAbove, ...] = Field(
        (), description="Walls and air gaps, from the camera to the gel; all surfaces are parallel."
    )
    tilt_deg: tuple[Tilt, Tilt] = Field(
        (0.0, 0.0),
        description="By how much the surface rises towards the camera along +y and +z of the steering plane [deg].",
    )
    tilt_sigma_deg: float | None = Field(
        None, ge=0, le=10, description="Standard deviation of either tilt [deg]; null: not in the interval."
    )

    def gel(self) -> Gel:
        """Return the gel as the plane map takes it."""
        return Gel(
            self.index,
            self.depth_mm,
            self.paper_at,
            self.index_sigma,
            self.depth_sigma_mm,
            tuple(layer.layer() for layer in self.layers),
            (math.radians(self.tilt_deg[0]), math.radians(self.tilt_deg[1])),
            None if self.tilt_sigma_deg is None else math.radians(self.tilt_sigma_deg),
        )


class GraphPaper(Model):
    """The graph paper that lies in the steering plane, and the frame that it fixes."""

    pitch_mm: float = Field(
        gt=0, le=100, description="Distance from one line of the graph paper to the next [mm]."
    )
    origin_px: PixelUv = Field(description="Pixel (u, v) that becomes the origin of the steering plane [px].")
    insertion: Direction = Field(description="Where the insertion points in the picture.")
    paper_sigma_mm: float | None = Field(
        None,
        ge=0,
        le=10,
        description="Standard deviation of the paper's height over the needle's plane [mm]; null: not in the interval.",
    )
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


Protocol = CameraCalibrationProtocol
