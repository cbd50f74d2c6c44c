"""What the page of a steerability run, or of imported pictures, shows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from labrig.analysis.mapping import load_lens, load_mapping
from labrig.analysis.paper import PAPER_GELS, PAPER_MEAN_RADIUS_MM, PaperGel
from labrig.analysis.result import (
    AnalysisResult,
    CentreLines,
    CurvatureResult,
    PictureResult,
    SpecimenResult,
    SpecimenTruth,
    load_centre_lines,
)
from labrig.protocol.protocols import SteerabilityProtocol
from labrig.record.reader import Run
from labrig.report.figures import Design, GelSeries, steerability_figure
from labrig.report.palette import Mark, mark
from labrig.report.pictures import CameraView, DrawnPicture, draw_camera_view, draw_thumbnail
from labrig.report.provenance import Rows
from labrig.report.sheath_view import draw_sheath_view, worth_showing
from labrig.report.words import count_of, number, signed
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.plane import PlaneMap

_SHEATHS_SHOWN = 3


@dataclass(frozen=True)
class GelRow:
    """A line of the table: one needle in one gel, beside the paper's figures and the drawn truth."""

    measured: SpecimenResult
    label: str
    mark: Mark
    paper: PaperGel | None
    truth: SpecimenTruth | None


@dataclass(frozen=True)
class Sheet:
    """One picture of the contact sheet; `picture` is None where it cannot be read."""

    one: PictureResult
    picture: DrawnPicture | None


@dataclass(frozen=True)
class SheetGroup:
    """The pictures of one needle in one gel; imported ones are one group without a row."""

    row: GelRow | None
    sheets: tuple[Sheet, ...]


@dataclass(frozen=True)
class ExpectedRefusals:
    """Pictures on the way whose shaft was found and whose radius is not stated, by inserted length."""

    insertion: str
    count: int
    example: str


def curvature_page(run: Run, result: AnalysisResult, content: CurvatureResult) -> dict[str, Any]:
    """Return what the template needs, everything drawn."""
    lines = load_centre_lines(result)
    plane = load_mapping(run)
    rows = gel_rows(content)
    shown = [one for one in content.measurements if one.role in {"final", "imported"}]
    return {
        "content": content,
        "folder": f"analysis/{result.path.name}",
        "rows": rows,
        "paper_mean_mm": PAPER_MEAN_RADIUS_MM,
        "figure": _figure(run, rows, content, lines),
        "view": _camera_view(run, content, lines, plane),
        "sheaths": [
            view
            for one in worth_showing(content.origins, _SHEATHS_SHOWN)
            if (view := draw_sheath_view(run, one, plane)) is not None
        ],
        "groups": _sheet_groups(rows, [Sheet(one, draw_thumbnail(run, one, lines, plane)) for one in shown]),
        "refused": [one for one in content.measurements if _stands_alone(one)],
        "expected": _expected_refusals(content.measurements),
        "without_final": _without_final_picture(content),
        "simulated": content.truth is not None,
        "steerability": isinstance(run.protocol, SteerabilityProtocol),
    }


def curvature_verdict(run: Run, content: CurvatureResult) -> list[str]:
    """Return the page in a sentence or two."""
    if not isinstance(run.protocol, SteerabilityProtocol):
        found = sum(one.found for one in content.measurements)
        accepted = sum(one.accepted for one in content.measurements)
        pictures = count_of(len(content.measurements), "picture")
        return [f"Shaft and tip were found in {found} of {pictures}; a radius can be stated in {accepted}."]
    trials = sum(one.trials for one in content.specimens)
    measured = sum(one.n for one in content.specimens)
    if content.mean_radius_mm is None:
        return [f"No radius could be stated: {measured} of {count_of(trials, 'insertion')} measured."]
    groups = sum(one.mean_radius_mm is not None for one in content.specimens)
    sentences = [
        (
            f"{measured} of {count_of(trials, 'insertion')} measured. "
            f"The mean radius over {count_of(groups, 'gel')} is {number(content.mean_radius_mm)} mm; "
            f"the paper reports {PAPER_MEAN_RADIUS_MM:g} mm, "
            f"and the needle was designed for {run.protocol.needle.design_radius_mm:g} mm."
        )
    ]
    truth = content.truth
    if truth is not None and truth.worst_error_of_mean_mm is not None and truth.worst_error_mm is not None:
        sentences.append(
            f"The rig is simulated: no gel's mean is further than {abs(truth.worst_error_of_mean_mm):.3f} mm "
            f"from what was drawn, and no insertion further than {abs(truth.worst_error_mm):.3f} mm."
        )
    return sentences


def calibration_rows(run: Run) -> Rows:
    """Return how well lens and plane are known."""
    return (*_lens_rows(load_lens(run)), *_plane_rows(load_mapping(run)))


def gel_rows(content: CurvatureResult) -> list[GelRow]:
    """Return the lines of the table, each gel with the paper's figures for its gelatin and its truth."""
    truths = (
        {} if content.truth is None else {(one.needle_id, one.name): one for one in content.truth.specimens}
    )
    labels = _labels(content.specimens)
    return [
        GelRow(
            one, label, mark(index), _paper_gel(one.gelatin_percent), truths.get((one.needle_id, one.name))
        )
        for index, (one, label) in enumerate(zip(content.specimens, labels, strict=True))
    ]


def _labels(specimens: Sequence[SpecimenResult]) -> list[str]:
    """Return a short label a group: its gelatin, numbered where two groups have the same."""
    seen: dict[float, int] = {}
    labels = []
    for one in specimens:
        seen[one.gelatin_percent] = seen.get(one.gelatin_percent, 0) + 1
        again = seen[one.gelatin_percent]
        labels.append(f"{one.gelatin_percent:g} %" + (f" ({again})" if again > 1 else ""))
    return labels


def _paper_gel(gelatin_percent: float) -> PaperGel | None:
    return next((gel for gel in PAPER_GELS if gel.gelatin_percent == gelatin_percent), None)


def _figure(run: Run, rows: Sequence[GelRow], content: CurvatureResult, lines: CentreLines) -> Markup | None:
    """Return figure 8 of the paper; None for a run that is no steerability test, or measured nothing."""
    accepted = [one for one in content.measurements if one.role == "final" and one.accepted]
    if not isinstance(run.protocol, SteerabilityProtocol) or not accepted:
        return None
    bends = [one.bend for one in accepted]
    design = Design(
        radius_mm=run.protocol.needle.design_radius_mm,
        length_mm=run.protocol.insertion.length_mm,
        side=1 if bends.count("+y") > bends.count("-y") else -1,
    )
    return steerability_figure([_series(row, accepted, lines) for row in rows], design, "paths")


def _series(row: GelRow, accepted: Sequence[PictureResult], lines: CentreLines) -> GelSeries:
    own = [one for one in accepted if _belongs(one, row)]
    return GelSeries(
        label=row.label,
        mark=row.mark,
        paths_mm=tuple(
            lines.mm[one.frame] - np.asarray(one.entry_mm)
            for one in own
            if one.frame in lines.mm and one.entry_mm is not None
        ),
        radii_mm=tuple(one.radius_mm for one in own if one.radius_mm is not None),
        mean_mm=row.measured.mean_radius_mm,
        ci95_mm=row.measured.ci95_mm,
        paper_mm=None if row.paper is None else (row.paper.mean_radius_mm, row.paper.sd_radius_mm),
        drawn_mean_mm=None if row.truth is None else row.truth.drawn_mean_radius_mm,
    )


def _camera_view(
    run: Run, content: CurvatureResult, lines: CentreLines, plane: PlaneMap
) -> CameraView | None:
    """Return the view of the last accepted final picture of the first gel, in which older tracks are seen."""
    first = content.specimens[0].name if content.specimens else None
    candidates = [
        one for one in content.measurements if one.role == "final" and one.accepted and one.specimen == first
    ] or [one for one in content.measurements if one.accepted]
    if not candidates:
        return None
    shown = candidates[-1]
    commanded_mm = next((one.expected_mm for one in content.origins if one.trial == shown.trial), None)
    return draw_camera_view(run, shown, lines, plane, commanded_mm)


def _sheet_groups(rows: Sequence[GelRow], sheets: Sequence[Sheet]) -> list[SheetGroup]:
    groups = [SheetGroup(row, tuple(sheet for sheet in sheets if _belongs(sheet.one, row))) for row in rows]
    loose = tuple(sheet for sheet in sheets if sheet.one.trial is None)
    return [group for group in (*groups, SheetGroup(None, loose)) if group.sheets]


def _belongs(one: PictureResult, row: GelRow) -> bool:
    return (one.needle_id, one.specimen) == (row.measured.needle_id, row.measured.name)


def _stands_alone(one: PictureResult) -> bool:
    """Return whether a refusal is listed by itself: every one but those of short insertions on the way."""
    return not one.accepted and not (one.role == "advance" and one.found)


def _expected_refusals(measurements: Sequence[PictureResult]) -> list[ExpectedRefusals]:
    by_length: dict[str, list[PictureResult]] = {}
    for one in measurements:
        if not one.accepted and not _stands_alone(one):
            by_length.setdefault(number(one.insertion_mm, 0), []).append(one)
    return [
        ExpectedRefusals(insertion, len(group), group[0].reason or "")
        for insertion, group in by_length.items()
    ]


def _without_final_picture(content: CurvatureResult) -> Mapping[str, int]:
    return {one.name: one.without_final_picture for one in content.specimens if one.without_final_picture}


def _lens_rows(lens: Intrinsics | None) -> Rows:
    if lens is None:
        return (("lens", "no intrinsics: the pictures are taken as rectified"),)
    return (
        ("image size", f"{lens.image_size[0]} x {lens.image_size[1]} px"),
        *(
            (name, f"{number(getattr(lens, name), 3)} ± {number(lens.sigma.get(name), 3)} px (1 sigma)")
            for name in ("fx", "fy", "cx", "cy")
        ),
        ("k1, k2, p1, p2, k3", ", ".join(signed(value, 5) for value in lens.distortion)),
        (
            "reprojection error, rms",
            f"{number(lens.rms_px, 3)} px; held out {number(lens.holdout_rms_px, 3)} px",
        ),
    )


def _plane_rows(plane: PlaneMap) -> Rows:
    return (
        ("scale at the origin", f"{plane.mm_per_px:.5f} mm/px"),
        (
            "plane residual, rms",
            f"{number(plane.rms_mm, 4)} mm; held out {number(plane.holdout_rms_mm, 4)} mm",
        ),
        ("insertion in the picture", plane.insertion),
    )
