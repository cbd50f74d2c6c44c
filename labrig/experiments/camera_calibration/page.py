"""What the page of a camera calibration run shows: how well the board covered the picture, and the paper."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.pictures import INTRINSICS_FILE, PLANE_FILE
from labrig.analysis.result import AnalysisResult
from labrig.experiments.camera_calibration.events import CalibrationRole
from labrig.experiments.camera_calibration.protocol import CameraCalibrationProtocol
from labrig.experiments.camera_calibration.result import CalibrationResult
from labrig.record.reader import Run
from labrig.report.figures import DrawnFigure, clip_to_corners, draw_lens, svg
from labrig.report.page import Page
from labrig.report.pictures import PLATE, Pixel, photograph, pixel, polyline
from labrig.vision import lens_judgement
from labrig.vision.calibrate_plane import LARGEST_OFF_MM
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]

TEMPLATE = Path(__file__).with_name("page.html.jinja")


# Lines of the map that are drawn over the graph paper [mm].
_GRID_MM = 10.0


def make_page(
    run: Run, _protocol: CameraCalibrationProtocol, result: AnalysisResult[CalibrationResult]
) -> Page:
    """Return the page of a calibration."""
    content, plane = result.content, None
    if content.plane is not None:
        plane = load_plane(result.path / PLANE_FILE, load_intrinsics(result.path / INTRINSICS_FILE))
    seen = list(content.corners.values())
    needle_px = None if plane is None else clip_to_corners(_find_needle_px(plane), seen)
    papers = [line.frame for line in run.frame_lines if line.role == CalibrationRole.GRAPH_PAPER]
    paper = photograph(run, papers[-1], PLATE) if papers else None
    if paper is not None and plane is not None:
        paper = replace(paper, lines=tuple(_draw_grid(plane)), words=_name_axes(plane))
    shown = {
        "files": sorted(file.name for file in result.path.glob("*.json")),
        "coverage": _draw_coverage(content, needle_px),
        "paper": paper,
        "view": None if plane is None else plane.view_sentence(),
        "grid_mm": _GRID_MM,
        "limits": lens_judgement,
        "largest_off_mm": LARGEST_OFF_MM,
        "known": None if plane is None or needle_px is None else _find_length_mm(plane, needle_px),
    }
    return Page(TEMPLATE, shown=shown)


def _find_needle_px(plane: PlaneMap) -> FloatArray:
    """Return the line (2, 2) from the origin along z to the edge of the picture."""
    size = np.array(plane.image_size)
    ahead_px = plane.to_px(np.linspace((0.0, 0.0), (0.0, plane.mm_per_px * math.hypot(*size)), 500))
    return ahead_px[[0, np.flatnonzero(((ahead_px >= 0.0) & (ahead_px < size)).all(axis=1)).max(initial=0)]]


def _find_length_mm(plane: PlaneMap, ends_px: FloatArray) -> tuple[float, float, Mapping[str, float]]:
    """Return the distance of two pixels, its standard deviation and what each source gives to it [mm]."""
    length_mm = math.dist(*plane.to_mm(ends_px).tolist())
    parts_mm: dict[str, float] = {
        source: math.hypot(*(math.dist(*ends.tolist()) - length_mm for ends in maps))
        for source, maps in plane.map_by_variants(ends_px).items()
    }
    return length_mm, math.hypot(*parts_mm.values()), parts_mm


def _draw_grid(plane: PlaneMap) -> Iterator[tuple[str, str]]:
    """Yield the lines of the map over the picture, in both directions, the axes last."""
    width, height = plane.image_size or (1, 1)
    corners_mm = plane.to_mm(np.array(((0.0, 0.0), (width, 0.0), (0.0, height), (width, height))))
    across_mm = np.linspace(corners_mm.min(axis=0), corners_mm.max(axis=0), 41)
    lines = [
        (place, np.where(np.arange(2) == axis, place, across_mm))
        for axis, (low, *_, high) in enumerate(across_mm.T / _GRID_MM)
        for place in _GRID_MM * np.arange(math.ceil(low), high)
    ]
    for place, line_mm in sorted(lines, key=lambda line: line[0] == 0.0):
        yield "found" if place == 0.0 else "shaft", polyline(plane.to_px(line_mm))


def _name_axes(plane: PlaneMap) -> list[tuple[str, Pixel]]:
    places_mm = {"origin": (1.0, 1.0), "z": (1.0, 4.5 * _GRID_MM), "y": (1.5 * _GRID_MM, 1.0)}
    return [(words, pixel(plane.to_px([place_mm])[0])) for words, place_mm in places_mm.items()]


def _draw_coverage(content: CalibrationResult, needle_px: FloatArray | None) -> DrawnFigure | None:
    """Draw where the corners of the board were seen; None without a lens."""
    lens, views = content.intrinsics, ((corners, ()) for corners in content.corners.values())
    if lens is None:
        return None
    return svg(draw_lens(lens["image_size"], views, lens["rms_px"], needle_px), "coverage")
