"""What the page of a camera calibration run shows: how well the board covered the picture, and the paper."""

from pathlib import Path

from labrig.analysis.result import AnalysisResult
from labrig.experiments.camera_calibration.events import CalibrationRole
from labrig.experiments.camera_calibration.protocol import CameraCalibrationProtocol
from labrig.experiments.camera_calibration.result import CalibrationResult
from labrig.record.reader import Run
from labrig.report.figures import DrawnFigure, draw_lens, svg
from labrig.report.page import Page
from labrig.report.pictures import PLATE, photograph

TEMPLATE = Path(__file__).with_name("page.html.jinja")


def make_page(
    run: Run, _protocol: CameraCalibrationProtocol, result: AnalysisResult[CalibrationResult]
) -> Page:
    """Return the page of a calibration."""
    papers = [line.frame for line in run.frame_lines if line.role == CalibrationRole.GRAPH_PAPER]
    shown = {
        "files": sorted(file.name for file in result.path.glob("*.json")),
        "coverage": _draw_coverage(result.content),
        "paper": photograph(run, papers[-1], PLATE) if papers else None,
    }
    return Page(TEMPLATE, shown=shown)


def _draw_coverage(content: CalibrationResult) -> DrawnFigure | None:
    """Draw where the corners of the board were seen; None without a lens."""
    lens, views = content.intrinsics, ((corners, ()) for corners in content.corners.values())
    return None if lens is None else svg(draw_lens(lens["image_size"], views, lens["rms_px"]), "coverage")
