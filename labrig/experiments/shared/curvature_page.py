"""The page of a steerability run or of imported pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from markupsafe import Markup

from labrig.analysis.pictures import load_plane_map
from labrig.analysis.result import AnalysisResult, CentreLines, load_centre_lines
from labrig.experiments.shared.curvature_result import (
    CurvatureResult,
    PictureResult,
    SpecimenResult,
)
from labrig.experiments.shared.needle_events import NeedleRole
from labrig.experiments.shared.needle_pictures import (
    draw_camera_view,
    draw_picture,
)
from labrig.experiments.shared.paper import PAPER_GELS, PAPER_MEAN_RADIUS_MM, PaperGel
from labrig.record.reader import Run
from labrig.report.figures import Design, GelSeries, draw_steerability_figure
from labrig.report.page import Page
from labrig.report.palette import Mark, mark
from labrig.report.pictures import Plate
from labrig.vision.plane import PlaneMap

TEMPLATE = Path(__file__).with_name("curvature.html.jinja")


@dataclass(frozen=True)
class GelRow:
    """A line of the table: one needle in one gel, beside the paper's figures."""

    measured: SpecimenResult
    label: str
    mark: Mark
    paper: PaperGel | None


def make_curvature_page(
    run: Run, result: AnalysisResult[CurvatureResult], design: Design | None = None
) -> Page:
    """Return the page of measured curvatures with all figures drawn.

    Parameters
    ----------
    design : Design or None
        The arc that the needle was designed for; None for imported pictures, which have no figure 8.
    """
    content = result.content
    lines = load_centre_lines(result.path)
    plane = load_plane_map(run)
    rows = list_gel_rows(content)
    shown = [
        measurement
        for measurement in content.measurements
        if measurement.role in {NeedleRole.FINAL, NeedleRole.IMPORTED}
    ]
    sheets = [(measurement, draw_picture(run, measurement, lines, plane)) for measurement in shown]
    return Page(
        TEMPLATE,
        plane,
        {
            "rows": rows,
            "budgets": {
                "Radius": [measurement.radius_budget_mm for measurement in shown if measurement.accepted],
                "Needle's tip": [measurement.tip_budget_mm for measurement in shown],
            },
            "paper_mean_mm": PAPER_MEAN_RADIUS_MM,
            "figure": _draw_figure(design, rows, content, lines),
            "view": _draw_last_picture(run, content, lines, plane),
            "groups": [
                *((row, [sheet for sheet in sheets if _is_of_row(sheet[0], row)]) for row in rows),
                (None, [sheet for sheet in sheets if sheet[0].trial is None]),
            ],
            "simulated": any(row.measured.true_mean_radius_mm is not None for row in rows),
            "roll_sd_deg": content.settings.roll_sd_deg,
        },
    )


def list_gel_rows(content: CurvatureResult) -> list[GelRow]:
    """Return the rows of the table: each gel with the paper's values for its gelatin."""
    labels = _make_labels(content.specimens)
    return [
        GelRow(specimen, label, mark(index), _find_paper_gel(specimen.gelatin_percent))
        for index, (specimen, label) in enumerate(zip(content.specimens, labels, strict=True))
    ]


def _make_labels(specimens: Sequence[SpecimenResult]) -> list[str]:
    """Return a short label for each group: its gelatin, numbered if several groups have the same."""
    seen: dict[float, int] = {}
    labels = []
    for specimen in specimens:
        seen[specimen.gelatin_percent] = seen.get(specimen.gelatin_percent, 0) + 1
        again = seen[specimen.gelatin_percent]
        labels.append(f"{specimen.gelatin_percent:g} %" + (f" ({again})" if again > 1 else ""))
    return labels


def _find_paper_gel(gelatin_percent: float) -> PaperGel | None:
    return next((gel for gel in PAPER_GELS if gel.gelatin_percent == gelatin_percent), None)


def _draw_figure(
    design: Design | None, rows: Sequence[GelRow], content: CurvatureResult, lines: CentreLines
) -> Markup | None:
    """Return figure 8 of the paper; None if no radius of an insertion was accepted."""
    accepted = [
        measurement
        for measurement in content.measurements
        if measurement.role == NeedleRole.FINAL and measurement.accepted
    ]
    if design is None or not accepted:
        return None
    bends = [measurement.bend for measurement in accepted]
    towards = replace(design, side=1 if bends.count("+y") > bends.count("-y") else -1)
    return draw_steerability_figure([_make_series(row, accepted, lines) for row in rows], towards, "paths")


def _make_series(row: GelRow, accepted: Sequence[PictureResult], lines: CentreLines) -> GelSeries:
    own = [result for result in accepted if _is_of_row(result, row)]
    return GelSeries(
        label=row.label,
        mark=row.mark,
        paths_mm=tuple(
            lines[result.frame].mm - np.asarray(result.entry_mm)
            for result in own
            if result.frame in lines and result.entry_mm is not None
        ),
        radii_mm=tuple(result.radius_mm for result in own if result.radius_mm is not None),
        mean_mm=row.measured.mean_radius_mm,
        sd_mm=row.measured.sd_radius_mm,
        ci95_mm=row.measured.ci95_mm,
        paper_mm=None if row.paper is None else (row.paper.mean_radius_mm, row.paper.sd_radius_mm),
        drawn_mean_mm=row.measured.true_mean_radius_mm,
    )


def _draw_last_picture(
    run: Run, content: CurvatureResult, lines: CentreLines, plane: PlaneMap
) -> Plate | None:
    """Return the view of the last accepted final picture of the first gel, which also shows the older tracks."""
    first = content.specimens[0].name if content.specimens else None
    candidates = [
        result
        for result in content.measurements
        if result.role == NeedleRole.FINAL and result.accepted and result.specimen == first
    ] or [result for result in content.measurements if result.accepted]
    if not candidates:
        return None
    shown = candidates[-1]
    commanded_mm = next(
        (origin.expected_mm for origin in content.origins if origin.trial == shown.trial), None
    )
    return draw_camera_view(run, shown, lines, plane, commanded_mm)


def _is_of_row(result: PictureResult, row: GelRow) -> bool:
    return (result.needle_id, result.specimen) == (row.measured.needle_id, row.measured.name)
