"""Fit the roll zero of a needle again to the pictures of the run that certified it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any, TypeVar

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.origin import find_origins, lateral_offset_mm
from labrig.analysis.pictures import load_plane_map, measure_pictures
from labrig.analysis.result import Findings, TrialOrigin
from labrig.analysis.sentinel import check_sentinel
from labrig.errors import InputError, MeasurementRefusedError, PictureError, RecordError
from labrig.experiments.roll_zero.protocol import RollZeroProtocol
from labrig.experiments.roll_zero.result import RollZeroResult, TorsionHoleResult, TorsionResult
from labrig.experiments.shared.roll_zero_events import RollZeroRole, TorsionHole, explain_doubt
from labrig.experiments.shared.torsion_bends import find_lengths, measure_bend
from labrig.protocol.sections import Sheath
from labrig.record.reader import Run
from labrig.steering.roll_zero import RollZeroFit, correct_perspective, fit_roll_zero
from labrig.steering.torsion_fit import TorsionBend, TorsionFit, fit_torsion
from labrig.vision.curvature import CurvatureSettings
from labrig.vision.out_of_plane import Perspective
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_tip import measure_shaft_tip

_Fit = TypeVar("_Fit", RollZeroFit, TorsionFit)


def analyze(run: Run, protocol: RollZeroProtocol, request: AnalysisRequest) -> Findings:
    """Measure the lateral deflection of each insertion, and fit the cosine of the roll to it.

    Raises
    ------
    InputError
        When the run has no map from pixels to mm.
    RecordError
        When its lines are damaged.
    """
    pictures = [line for line in run.frame_lines if line.role == RollZeroRole.NEEDLE]
    settings = CurvatureSettings(
        needle_diameter_mm=protocol.needle.diameter_mm, sheath_diameter_mm=protocol.sheath.diameter_mm
    )
    places = tuple(run.pictures.places[line.frame] for line in pictures)
    plane = load_plane_map(run)
    origins = _find_hole_origins(run, plane, protocol.sheath)
    sentinel = check_sentinel(protocol.sentinel, run.read_frame, run.frame_lines, plane)
    measured, _ = measure_pictures(
        places, plane, settings, request.mask, workers=request.workers, progress=request.progress
    )
    seen = [
        (roll_rad, lateral_offset_mm(measurement.tip_mm, find_last_origin(line.frame, origins)))
        for line, measurement in zip(pictures, measured, strict=True)
        if measurement.tip_mm is not None and (roll_rad := line.rotation_rad) is not None
    ]
    rolls_rad = [roll for roll, _ in seen]
    strays_mm = correct_perspective(rolls_rad, [stray for _, stray in seen], Perspective.of(plane))
    steps, radius_mm, reasons = protocol.roll_zero, protocol.needle.design_radius_mm, list[str]()
    fit = _judge(
        "the roll zero",
        lambda: fit_roll_zero(rolls_rad, strays_mm, steps.length_mm, radius_mm),
        steps.max_sd_deg,
        reasons,
    )
    if sentinel is not None and not sentinel.accepted:
        reasons.append(sentinel.reason or "the grid pictures differ")
    result = RollZeroResult(
        **request.stamp.list_members({"rolls": steps.rolls, "length_mm": steps.length_mm}),
        torsion=_analyze_torsion(run, protocol, plane, request, reasons),
        accepted=not reasons,
        reasons=tuple(reasons),
        needle_id=protocol.needle.needle_id,
        rolls_rad=tuple(rolls_rad),
        deflections_mm=tuple(strays_mm),
        fit=None if fit is None else asdict(fit),
        offset_mm=None if fit is None else _find_offset_mm(fit, rolls_rad, strays_mm),
        origins=origins,
        sentinel=sentinel,
    )
    return Findings(result)


def _judge(what: str, fit: Callable[[], _Fit], most_deg: float, reasons: list[str]) -> _Fit | None:
    """Return a fit, None if it is refused; add to the reasons why it is, or why it is too uncertain."""
    try:
        fitted = fit()
    except (InputError, MeasurementRefusedError) as error:
        reasons.append(error.message)
        return None
    if doubt := explain_doubt(what, fitted.sd_rad, most_deg):
        reasons.append(doubt)
    return fitted


def _analyze_torsion(
    run: Run, protocol: RollZeroProtocol, plane: PlaneMap, request: AnalysisRequest, reasons: list[str]
) -> TorsionResult | None:
    """Return the torsion of the recorded holes, None if it is not asked for; add to the reasons why it is refused."""
    steps, holes, bends = protocol.roll_zero.torsion, list[TorsionHoleResult](), list[TorsionBend]()
    if steps is None:
        return None
    for hole in run.read_events(TorsionHole):
        seen: dict[str, Any] = {"bent_mm": None, "turned_mm": None, "reason": None}
        try:
            bends.append(_measure_hole(run, hole, protocol, plane, request))
            seen |= {"bent_mm": bends[-1].bent_mm, "turned_mm": bends[-1].turned_mm}
        except (MeasurementRefusedError, PictureError, RecordError) as error:
            seen["reason"] = error.message.replace(f"{run.path}/", "")
        holes.append(
            TorsionHoleResult(hole=hole.hole, depth_mm=hole.depth_mm, direction=hole.direction, **seen)
        )
    radius_mm = protocol.needle.design_radius_mm
    fit = _judge(
        "the torsional lag",
        lambda: fit_torsion(bends, find_lengths(steps), radius_mm),
        steps.max_sd_deg,
        reasons,
    )
    return TorsionResult(holes=tuple(holes), fit=fit)


def _measure_hole(
    run: Run, hole: TorsionHole, protocol: RollZeroProtocol, plane: PlaneMap, request: AnalysisRequest
) -> TorsionBend:
    """Return the bends in the pictures of a hole. Raises as `measure_shaft_tip`, and `RecordError`."""
    diameters_mm = protocol.needle.diameter_mm, protocol.sheath.diameter_mm
    images = (run.pictures.places[frame].read() for frame in (hole.turn_frame, hole.end_frame))
    shafts = [measure_shaft_tip(image, plane, *diameters_mm, mask=request.mask) for image in images]
    return measure_bend(hole, *shafts)


def _find_hole_origins(run: Run, plane: PlaneMap, sheath: Sheath) -> tuple[TrialOrigin, ...]:
    """Return the sheath's origin in each hole if the protocol asks for it; holes count as trials here."""
    if sheath.origin is None:
        return ()
    shown = [line for line in run.frame_lines if line.role == RollZeroRole.SHEATH]
    holes = [line.model_copy(update={"trial": hole}) for hole, line in enumerate(shown)]
    return find_origins(run.read_frame, holes, plane, sheath)


def find_last_origin(frame: int, origins: Sequence[TrialOrigin]) -> TrialOrigin | None:
    """Return the last origin that was found before a picture."""
    return next((origin for origin in reversed(origins) if origin.frame < frame), None)


def _find_offset_mm(fit: RollZeroFit, rolls_rad: Sequence[float], strays_mm: Sequence[float]) -> float:
    """Return the constant of the least-squares cosine, whose residuals sum to zero."""
    bends = (fit.bend_mm * math.cos(roll - fit.zero_rad) for roll in rolls_rad)
    return math.fsum(stray + bend for stray, bend in zip(strays_mm, bends, strict=True)) / len(rolls_rad)
