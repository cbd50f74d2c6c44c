"""The study of a design: what to cut by equation (3) and by our own search.

`labrig design` and runs of the experiment design both come through `study_design`; the numbers are the same.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from labrig.analysis.engine import DEFAULT_WORKERS, map_in_order, open_process_pool
from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.pictures import Progress
from labrig.analysis.result import Findings
from labrig.durable import write_atomically
from labrig.errors import AnswerIsNoError, InputError, Problem
from labrig.experiments.hinge_design.protocol import DesignProtocol
from labrig.experiments.hinge_design.result import DesignResult, DesignStudy, MeasuredAnswer, Searched
from labrig.needle.design_search import (
    STEEPEST_CUT_DEG,
    design_by_equations,
    fit_plane,
    make_hinge_grid,
    search_design,
)
from labrig.needle.equations import (
    EQUATION_3,
    RadiusTolerance,
    RotationPlane,
    radius_mm,
    radius_tolerance,
    rotation_for_radius_deg,
)
from labrig.needle.hinge import Hinge
from labrig.needle.rotation_search import GridPoint, search_rotations
from labrig.needle.tube import TABLE_1
from labrig.protocol.design_file import NeedleDesign
from labrig.record.json_lines import encode_document
from labrig.record.reader import Run

DESIGN_FILE = "design.json"
# On two processors, 1.4 s of one a hinge, with their start: 36 s for 49 hinges.
_SECONDS_A_HINGE = 0.73


def analyze(_run: Run, protocol: DesignProtocol, request: AnalysisRequest) -> Findings:
    """Carry out the study of a design run.

    Raises
    ------
    MachineError
        When processes that search die of the same hinge again.
    """
    stamp = request.stamp
    study = study_design(protocol, request.workers, request.progress)
    settings = {"grid_points": protocol.grid_points, "seed": protocol.seed}
    content = DesignResult(**stamp.list_members(settings), **dict(study))
    return Findings(content, partial(save_design_file, study, stamp.provenance))


def estimate_s(protocol: DesignProtocol) -> float:
    """Return about how long the search takes [s]."""
    return _SECONDS_A_HINGE * protocol.grid_points**2


def find_problems(protocol: DesignProtocol) -> tuple[Problem, ...]:
    """Return the first problem of the equations or of the contour's limits, at its key; empty for a valid design."""
    for key, check in _list_checks(protocol):
        try:
            check()
        except (InputError, AnswerIsNoError) as error:
            return (Problem(key, error.message, error.hint),)
    return ()


def _list_checks(protocol: DesignProtocol) -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield each key with its check; later checks assume that the earlier ones passed."""
    yield "clearance_mm", lambda: Hinge(protocol.tube, protocol.clearance_mm, 0.0)
    yield "radius_mm", lambda: _design(protocol)
    yield "tolerances", lambda: _require_bounded_radius(_find_tolerance(protocol, EQUATION_3))
    yield "measured", lambda: _describe_measured_needle(protocol)


def study_design(
    protocol: DesignProtocol, workers: int = DEFAULT_WORKERS, progress: Progress | None = None
) -> DesignStudy:
    """Answer by equation (3), then by the search; if our contour cannot give the radius, its answer holds the reason.

    Parameters
    ----------
    progress : callable or None
        Called with the number of hinges searched so far, at first 0, and of all.

    Raises
    ------
    InputError
        When a length or angle is beyond its limit; nothing has been searched.
    AnswerIsNoError
        When by equation (3) no inclination gives the radius, or no clearance explains the measured one.
    MachineError
        When processes that search die of the same hinge again.
    """
    tube, measured = protocol.tube, _describe_measured_needle(protocol)
    designed, tolerance = _design(protocol), _find_tolerance(protocol, EQUATION_3)
    hinges, cells = make_hinge_grid(tube, protocol.clearance_mm, protocol.grid_points), list[GridPoint]()
    if progress is not None:
        progress(0, len(hinges))
    with open_process_pool(workers, "searched rotations") as pool:
        for cell in map_in_order(pool, partial(search_rotations, seed=protocol.seed), hinges):
            cells.append(cell)
            if progress is not None:
                progress(len(cells), len(hinges))
    plane = fit_plane(cells)
    search = _search(protocol, plane)
    return DesignStudy(
        accepted=tube.is_papers or search.reason is None,
        beta_cut_deg=designed.beta_cut_deg,
        beta_rot_deg=rotation_for_radius_deg(protocol.radius_mm, tube.link_length_mm),
        radius_mm=protocol.radius_mm,
        clearance_mm=protocol.clearance_mm,
        tube=tube,
        tolerances=protocol.tolerances,
        tolerance=tolerance,
        measured=measured,
        search=search,
        cells=tuple(cells),
    )


def save_design_file(study: DesignStudy, provenance: Mapping[str, Any], folder: Path) -> None:
    """Write the design file where there is something to cut. Raises `DiskError`."""
    if study.accepted:
        write_atomically(folder / DESIGN_FILE, encode_design_file(study, provenance))


def encode_design_file(study: DesignStudy, provenance: Mapping[str, Any]) -> bytes:
    """Return the design file of an accepted study, which protocols can name.

    Raises
    ------
    InputError
        When the tolerances are so wide that the hinges may not turn at all, so that no radius can be guaranteed.
    """
    answer = study if study.basis == "equation (3)" else study.search
    assert answer.tolerance is not None
    assert answer.beta_cut_deg is not None
    design = NeedleDesign(
        kind="labrig-needle-design",
        schema_version=1,
        tube=study.tube,
        clearance_mm=study.clearance_mm,
        beta_cut_deg=answer.beta_cut_deg,
        radius_mm=study.radius_mm,
        radius_low_mm=answer.tolerance.low_mm,
        radius_high_mm=_require_bounded_radius(answer.tolerance),
        basis=study.basis,
        provenance=dict(provenance),
    )
    return encode_document(design.model_dump(mode="json"))


def _design(protocol: DesignProtocol) -> Hinge:
    return design_by_equations(protocol.tube, protocol.radius_mm, protocol.clearance_mm)


def _find_tolerance(
    protocol: DesignProtocol, plane: RotationPlane, beta_rot_deg: float | None = None
) -> RadiusTolerance:
    """Return the tolerance of the radius at a rotation, by default at that of the wanted radius."""
    link_mm = protocol.tube.link_length_mm
    return radius_tolerance(
        plane,
        rotation_for_radius_deg(protocol.radius_mm, link_mm) if beta_rot_deg is None else beta_rot_deg,
        link_mm,
        clearance_tolerance_mm=protocol.tolerances.clearance_mm,
        cut_tolerance_deg=protocol.tolerances.cut_deg,
    )


def _require_bounded_radius(tolerance: RadiusTolerance) -> float:
    """Return the largest radius; refuse hinges that might not turn at all."""
    if tolerance.high_mm is None:
        raise InputError(
            "the radius has no upper limit within the tolerances: the hinges might not turn at all",
            "give the tolerances of a laser that can cut this needle",
        )
    return tolerance.high_mm


def _describe_measured_needle(protocol: DesignProtocol) -> MeasuredAnswer | None:
    """Return what a measured needle says by equation (3).

    Without an inclination of its own it was cut as the needle asked for: as table I says for the paper's, otherwise as
    equation (3) does.
    """
    measured, tube = protocol.measured, protocol.tube
    if measured is None:
        return None
    cut_deg = measured.beta_cut_deg
    if cut_deg is None:
        is_table_1 = TABLE_1.is_asked(tube, protocol.clearance_mm, protocol.radius_mm)
        cut_deg = TABLE_1.beta_cut_deg if is_table_1 else _design(protocol).beta_cut_deg
    Hinge(tube, protocol.clearance_mm, cut_deg)
    beta_rot_deg = rotation_for_radius_deg(measured.radius_mm, tube.link_length_mm)
    return MeasuredAnswer(
        radius_mm=measured.radius_mm,
        beta_rot_deg=beta_rot_deg,
        beta_cut_deg=cut_deg,
        clearance_mm=EQUATION_3.clearance_mm(beta_rot_deg, cut_deg),
    )


def _search(protocol: DesignProtocol, plane: RotationPlane) -> Searched:
    """Return the answer of the search."""
    try:
        found = search_design(protocol.tube, protocol.radius_mm, protocol.clearance_mm, plane, protocol.seed)
    except (AnswerIsNoError, InputError) as error:
        return Searched(fit=plane, reason=f"on our contour {error.message}")
    return Searched(
        fit=plane,
        beta_cut_deg=found.beta_cut_deg,
        inside_grid=found.beta_cut_deg <= STEEPEST_CUT_DEG,
        beta_rot_deg=found.beta_rot_deg,
        beta_a_deg=found.beta_a_deg,
        beta_b_deg=found.beta_b_deg,
        radius_mm=radius_mm(found.beta_rot_deg, protocol.tube.link_length_mm),
        tolerance=_find_tolerance(protocol, plane, found.beta_rot_deg),
    )
