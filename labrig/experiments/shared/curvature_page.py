"""The page of a steerability run or of imported pictures."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import numpy as np
from markupsafe import Markup

from labrig.analysis.comparison import Comparison, compare_runs
from labrig.analysis.measurements import read_measured
from labrig.analysis.pictures import load_plane_map
from labrig.analysis.result import AnalysisResult, CentreLines, load_centre_lines
from labrig.errors import InputError
from labrig.experiments.shared.curvature_result import CurvatureResult, PictureResult, SpecimenResult
from labrig.experiments.shared.needle_events import NeedleRole
from labrig.experiments.shared.needle_pictures import draw_picture
from labrig.experiments.shared.paper import PAPER_GELS
from labrig.record.reader import Run
from labrig.report.figures import Design, GelSeries, draw_steerability_figure
from labrig.report.page import Page
from labrig.report.palette import mark

TEMPLATE = Path(__file__).with_name("curvature.html.jinja")


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
    gels = _list_gels(content, lines)
    shown = [one for one in content.measurements if one.role in {NeedleRole.FINAL, NeedleRole.IMPORTED}]
    sheets = [(measurement, draw_picture(run, measurement, lines, plane)) for measurement in shown]
    return Page(
        TEMPLATE,
        plane,
        {
            "gels": gels,
            "paper_mean_mm": _average_paper(content),
            "comparison": _compare_gels(run, result),
            "budgets": {
                "Radius": [measurement.radius_budget_mm for measurement in shown if measurement.accepted],
                "Needle's tip": [measurement.tip_budget_mm for measurement in shown],
            },
            "figure": _draw_figure(design, [series for _, series in gels], _list_accepted(content)),
            "groups": [
                *(
                    (gel, series, [sheet for sheet in sheets if _is_in(sheet[0], gel)])
                    for gel, series in gels
                ),
                (None, None, [sheet for sheet in sheets if sheet[0].trial is None]),
            ],
        },
    )


def _average_paper(content: CurvatureResult) -> float | None:
    """Return the mean of the paper's radii in the gels that have one here; None if it has not measured one of them."""
    gels = [gel.gelatin_percent for gel in content.specimens if gel.mean_radius_mm is not None]
    return fmean(PAPER_GELS[gel][0] for gel in gels) if gels and PAPER_GELS.keys() >= set(gels) else None


def _compare_gels(run: Run, result: AnalysisResult[CurvatureResult]) -> Comparison | None:
    """Return the gels compared as `labrig compare` compares them; None where there is nothing to compare."""
    with suppress(InputError):
        return compare_runs([read_measured(run, int(result.path.name))], quantity="radius_mm").comparison
    return None


def _list_gels(content: CurvatureResult, lines: CentreLines) -> list[tuple[SpecimenResult, GelSeries]]:
    """Return each group and what is drawn of it; groups of the same gelatin are numbered."""
    gels, seen = list[tuple[SpecimenResult, GelSeries]](), Counter[float]()
    for number, gel in enumerate(content.specimens):
        seen[gel.gelatin_percent] += 1
        again = seen[gel.gelatin_percent]
        own = [picture for picture in _list_accepted(content) if _is_in(picture, gel)]
        series = GelSeries(
            label=f"{gel.gelatin_percent:g} %" + (f" ({again})" if again > 1 else ""),
            mark=mark(number),
            paths_mm=tuple(
                path_mm[np.hypot(*(path_mm - path_mm[-1]).T) >= content.settings.window_end_mm]
                - picture.entry_mm
                for picture in own
                if picture.frame in lines and picture.entry_mm is not None
                for path_mm in [lines[picture.frame].mm]
            ),
            radii_mm=tuple(picture.radius_mm for picture in own if picture.radius_mm is not None),
            mean_mm=gel.mean_radius_mm,
            sd_mm=gel.sd_radius_mm,
            ci95_mm=gel.ci95_mm,
            paper_mm=PAPER_GELS.get(gel.gelatin_percent),
            drawn_mean_mm=gel.true_mean_radius_mm,
        )
        gels.append((gel, series))
    return gels


def _list_accepted(content: CurvatureResult) -> list[PictureResult]:
    return [
        picture for picture in content.measurements if picture.role == NeedleRole.FINAL and picture.accepted
    ]


def _is_in(picture: PictureResult, gel: SpecimenResult) -> bool:
    return (picture.needle_id, picture.specimen) == (gel.needle_id, gel.name)


def _draw_figure(
    design: Design | None, gels: Sequence[GelSeries], accepted: Sequence[PictureResult]
) -> Markup | None:
    """Return figure 8 of the paper; None if no radius of an insertion was accepted."""
    if design is None or not accepted:
        return None
    bends = [measurement.bend for measurement in accepted]
    towards = replace(design, side=1 if bends.count("+y") > bends.count("-y") else -1)
    return draw_steerability_figure(gels, towards, "paths")
