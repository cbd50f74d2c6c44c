"""What the page of a camera calibration run shows."""

from pathlib import Path

from labrig.analysis.result import AnalysisResult, AnyResult
from labrig.experiments.camera_calibration.events import CalibrationRole
from labrig.experiments.camera_calibration.protocol import CameraCalibrationProtocol
from labrig.experiments.camera_calibration.result import CalibrationResult
from labrig.record.reader import Run
from labrig.report.figures import DrawnFigure, draw_lens, svg
from labrig.report.page import Page
from labrig.report.pictures import PLATE, Photograph, photograph

TEMPLATE = Path(__file__).with_name("page.html.jinja")


def make_page(
    run: Run, protocol: CameraCalibrationProtocol, result: AnalysisResult[CalibrationResult] | None
) -> Page:
    """Return the page of a calibration: lens and plane, how well the board covered the picture, and the paper."""
    board = protocol.board
    pitch_mm = protocol.plane.pitch_mm if result is None else result.content.settings.plane.pitch_mm
    facts = (
        ("Board", f"{board.columns} x {board.rows} inner corners, squares of {board.square_mm:g} mm"),
        ("Graph paper", f"{pitch_mm:g} mm"),
    )
    if result is None:
        return Page(facts)
    return Page(
        facts, TEMPLATE, _write_verdict(result.content), shown=_collect_content(run, result, result.content)
    )


def _collect_content(run: Run, result: AnyResult, content: CalibrationResult) -> dict[str, object]:
    return {
        "files": sorted(file.name for file in result.path.glob("*.json")),
        "coverage": _draw_coverage(content),
        "paper": _show_paper(run),
    }


def _write_verdict(content: CalibrationResult) -> list[str]:
    """Return the page in a sentence or two."""
    lens, plane = content.intrinsics, content.plane
    if lens is None or plane is None:
        return ["The camera could not be calibrated.", *content.reasons]
    used = sum(view["used"] for view in lens["views"])
    word = "Accepted" if content.accepted else "Refused"
    sentence = (
        f"{word}: {used} photographs of the board, fx {lens['fx']:.2f} px; "
        f"graph paper maps to mm within {plane['rms_mm']:.3f} mm rms."
    )
    return [sentence, *content.reasons]


def _draw_coverage(content: CalibrationResult) -> DrawnFigure | None:
    """Draw where the corners of the board were seen; None without a lens."""
    lens, views = content.intrinsics, ((corners, ()) for corners in content.corners.values())
    return None if lens is None else svg(draw_lens(lens["image_size"], views, lens["rms_px"]), "coverage")


def _show_paper(run: Run) -> Photograph | None:
    papers = [line.frame for line in run.frame_lines if line.role == CalibrationRole.GRAPH_PAPER]
    return photograph(run.read_frame(papers[-1]), PLATE) if papers else None
