"""The study of a design: what to cut by equation (3) and by our own search, with the data of figure 3.

`labrig design` and runs of the experiment design both come through `study_design`; the numbers are the same.
"""

import csv
import io
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from labrig.analysis.engine import DEFAULT_WORKERS, WorkQueue, open_process_pool
from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.pictures import Progress
from labrig.analysis.result import Findings
from labrig.durable import write_atomically
from labrig.errors import AnswerIsNoError, InputError
from labrig.experiments.hinge_design.protocol import DesignProtocol
from labrig.experiments.hinge_design.result import DesignResult
from labrig.needle.design_search import (
    STEEPEST_CUT_DEG,
    GridPoint,
    design_by_equations,
    fit_plane,
    make_hinge_grid,
    search_design,
    search_grid,
)
from labrig.needle.equations import (
    EQUATION_3,
    RotationPlane,
    count_links,
    radius_mm,
    radius_tolerance,
    rotation_for_radius_deg,
)
from labrig.needle.hinge import Hinge
from labrig.needle.rotation_search import DEFAULT_SEED
from labrig.needle.tube import TABLE_1, Tube
from labrig.protocol.design_file import Basis, NeedleDesign, TubeSection
from labrig.record.json_lines import encode_document
from labrig.record.reader import Run

DESIGN_FILE = "design.json"
GRID_FILE = "grid.csv"

Document = dict[str, Any]

_NO_DESIGN_HINT = "ask for a smaller radius, or cut with a smaller clearance"

_COLUMNS = (
    "clearance_mm",
    "beta_cut_deg",
    "beta_a_deg",
    "beta_b_deg",
    "beta_rot_deg",
    "plane_deg",
    "residual_deg",
    "equation_3_deg",
)


@dataclass(frozen=True)
class MeasuredRadius:
    """A needle that was measured: its radius, how it was cut, and in which run.

    An inclination of None stands for the one that the needle asked for is cut at: table I's for the paper's, that of
    equation (3) for any other.
    """

    radius_mm: float
    beta_cut_deg: float | None
    run: Path | None = None


@dataclass(frozen=True)
class DesignOrder:
    """The question of a study; the tolerances are those of the laser."""

    radius_mm: float
    clearance_mm: float
    tube: Tube = TABLE_1.tube
    clearance_tolerance_mm: float = 0.003
    cut_tolerance_deg: float = 0.1
    tip_length_mm: float | None = None
    measured: MeasuredRadius | None = None
    grid_points: int = 7
    seed: int = DEFAULT_SEED

    @classmethod
    def of(cls, protocol: DesignProtocol) -> "DesignOrder":
        """Return the order of a protocol."""
        measured = protocol.measured
        return cls(
            tube=Tube(**protocol.tube.model_dump()),
            radius_mm=protocol.radius_mm,
            clearance_mm=protocol.clearance_mm,
            clearance_tolerance_mm=protocol.tolerances.clearance_mm,
            cut_tolerance_deg=protocol.tolerances.cut_deg,
            tip_length_mm=protocol.tip_length_mm,
            measured=None if measured is None else MeasuredRadius(measured.radius_mm, measured.beta_cut_deg),
            grid_points=protocol.grid_points,
            seed=protocol.seed,
        )


@dataclass(frozen=True)
class DesignStudy:
    """Both answers as a document, the searched grid, and the plane fitted to it."""

    document: Document
    cells: tuple[GridPoint, ...]
    plane: RotationPlane

    def save(self, provenance: Mapping[str, Any], folder: Path) -> None:
        """Write the grid as CSV, and the design file where there is something to cut.

        Raises
        ------
        DiskError
            When a file cannot be written.
        """
        write_atomically(folder / GRID_FILE, encode_hinge_table(self.cells, self.plane))
        if self.document["accepted"]:
            write_atomically(folder / DESIGN_FILE, design_file(self.document, provenance))


def analyze(_run: Run, protocol: DesignProtocol, request: AnalysisRequest) -> Findings:
    """Carry out the study of a design run.

    Raises
    ------
    MachineError
        When processes that search die of the same hinge again.
    """
    stamp = request.stamp
    study = study_design(DesignOrder.of(protocol), request.workers, request.progress)
    settings = {"grid_points": protocol.grid_points, "seed": protocol.seed}
    content = DesignResult(**stamp.fields(settings), **study.document, cells=study.cells)
    return Findings(content, partial(study.save, stamp.provenance))


def study_design(
    order: DesignOrder, workers: int = DEFAULT_WORKERS, progress: Progress | None = None
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
    document = _solve_equations(order)
    hinges = make_hinge_grid(order.tube, order.clearance_mm, order.grid_points)
    if progress is not None:
        progress(0, len(hinges))
    with open_process_pool(workers, "searched rotations") as pool:
        cells = search_grid(hinges, WorkQueue(pool).map, progress, order.seed)
    plane = fit_plane(cells)
    document["search"] = _search_answer(order, cells, plane)
    # Equation (3) always has an answer for a tube of the paper's section; any other tube has only our contour.
    document["accepted"] = (
        find_design_basis(document) == "equation (3)" or document["search"]["reason"] is None
    )
    if document["measured"] is not None:
        document["measured"]["search_clearance_mm"] = _find_clearance_mm(plane, document["measured"])
    return DesignStudy(document, cells, plane)


def find_design_basis(document: Mapping[str, Any]) -> Basis:
    """Return what a design is based on: equation (3) if it covers the tube, otherwise our contour."""
    return "equation (3)" if document["equation_3"]["same_tube"] else "our contour"


def design_file(document: Mapping[str, Any], provenance: Mapping[str, Any]) -> bytes:
    """Return the design file of a study, which protocols can name.

    Raises
    ------
    AnswerIsNoError
        When nothing was found to cut.
    InputError
        When the tolerances are so wide that the hinges may not turn at all, so that no radius can be guaranteed.
    """
    if not document["accepted"]:
        raise AnswerIsNoError(document["search"]["reason"], _NO_DESIGN_HINT)
    basis = find_design_basis(document)
    answer = document if basis == "equation (3)" else document["search"]
    low_mm, high_mm = answer["tolerance"]["radius_mm"]
    if high_mm is None:
        raise InputError(
            "the radius has no upper limit within the tolerances: the hinges might not turn at all",
            "give the tolerances of a laser that can cut this needle",
        )
    design = NeedleDesign(
        kind="labrig-needle-design",
        schema_version=1,
        tube=TubeSection(**document["tube"]),
        clearance_mm=document["clearance_mm"],
        beta_cut_deg=answer["beta_cut_deg"],
        radius_mm=document["radius_mm"],
        radius_low_mm=low_mm,
        radius_high_mm=high_mm,
        basis=basis,
        provenance=dict(provenance),
    )
    return encode_document(design.model_dump(mode="json"))


def encode_hinge_table(cells: tuple[GridPoint, ...], plane: RotationPlane) -> bytes:
    """Return the searched grid as CSV: a line for each cell, with the values of both planes."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for cell in cells:
        fitted_deg = plane.beta_rot_deg(cell.beta_cut_deg, cell.clearance_mm)
        angles_deg = (
            cell.beta_a_deg,
            cell.beta_b_deg,
            cell.beta_rot_deg,
            fitted_deg,
            cell.beta_rot_deg - fitted_deg,
            EQUATION_3.beta_rot_deg(cell.beta_cut_deg, cell.clearance_mm),
        )
        place = (f"{cell.clearance_mm:.6g}", f"{cell.beta_cut_deg:.6g}")
        writer.writerow([*place, *(f"{angle_deg:.4f}" for angle_deg in angles_deg)])
    return text.getvalue().encode("utf-8")


def _solve_equations(order: DesignOrder) -> Document:
    """Return the answer of equations (1) to (3). All checks of the order are made here."""
    tube = order.tube
    beta_rot_deg = rotation_for_radius_deg(order.radius_mm, tube.link_length_mm)
    beta_cut_deg = design_by_equations(tube, order.radius_mm, order.clearance_mm).beta_cut_deg
    is_table_1 = (tube, order.clearance_mm, order.radius_mm) == (
        TABLE_1.tube,
        TABLE_1.clearance_mm,
        TABLE_1.radius_mm,
    )
    return {
        "beta_cut_deg": beta_cut_deg,
        "beta_rot_deg": beta_rot_deg,
        "radius_mm": order.radius_mm,
        "clearance_mm": order.clearance_mm,
        "tube": asdict(tube),
        "equation_3": {**asdict(EQUATION_3), "same_tube": covers_tube(tube)},
        "tolerance": _find_tolerance(order, EQUATION_3, beta_rot_deg),
        "table_1": {"beta_cut_deg": TABLE_1.beta_cut_deg, "beta_rot_deg": TABLE_1.beta_rot_deg}
        if is_table_1
        else None,
        "links": None
        if order.tip_length_mm is None
        else count_links(order.tip_length_mm, tube.link_length_mm),
        "measured": None
        if order.measured is None
        else _describe_measured_needle(
            order, order.measured, TABLE_1.beta_cut_deg if is_table_1 else beta_cut_deg
        ),
    }


def covers_tube(tube: Tube) -> bool:
    """Return whether equation (3), which was fitted to one tube, covers this one; it holds for any link length."""
    paper = TABLE_1.tube
    return (tube.outer_diameter_mm, tube.inner_diameter_mm) == (
        paper.outer_diameter_mm,
        paper.inner_diameter_mm,
    )


def _find_tolerance(order: DesignOrder, plane: RotationPlane, beta_rot_deg: float) -> Document:
    found = radius_tolerance(
        plane,
        beta_rot_deg,
        order.tube.link_length_mm,
        clearance_tolerance_mm=order.clearance_tolerance_mm,
        cut_tolerance_deg=order.cut_tolerance_deg,
    )
    return {
        "clearance_mm": order.clearance_tolerance_mm,
        "cut_deg": order.cut_tolerance_deg,
        "radius_mm_per_clearance_mm": found.per_clearance,
        "radius_mm_per_cut_deg": found.per_degree_mm,
        "radius_mm": [found.low_mm, found.high_mm],
    }


def _describe_measured_needle(
    order: DesignOrder, measured: MeasuredRadius, designed_cut_deg: float
) -> Document:
    beta_rot_deg = rotation_for_radius_deg(measured.radius_mm, order.tube.link_length_mm)
    beta_cut_deg = designed_cut_deg if measured.beta_cut_deg is None else measured.beta_cut_deg
    Hinge(order.tube, order.clearance_mm, beta_cut_deg)
    return {
        "run": None if measured.run is None else str(measured.run),
        "radius_mm": measured.radius_mm,
        "beta_rot_deg": beta_rot_deg,
        "beta_cut_deg": beta_cut_deg,
        "clearance_mm": EQUATION_3.clearance_mm(beta_rot_deg, beta_cut_deg),
    }


def _find_clearance_mm(plane: RotationPlane, measured: Document) -> float | None:
    """Return the clearance by our own plane; None if it would be negative."""
    try:
        return plane.clearance_mm(measured["beta_rot_deg"], measured["beta_cut_deg"])
    except AnswerIsNoError:
        return None


def _search_answer(order: DesignOrder, cells: tuple[GridPoint, ...], plane: RotationPlane) -> Document:
    """Return the answer of the search; if our contour has none, its numbers are None and `reason` is a sentence."""
    answer: Document = {
        "beta_cut_deg": None,
        "beta_rot_deg": None,
        "beta_a_deg": None,
        "beta_b_deg": None,
        "radius_mm": None,
        "tolerance": None,
        "inside_grid": None,
        "reason": None,
        "fit": asdict(plane),
        "grid": {
            "points": order.grid_points,
            "clearance_mm": [cells[0].clearance_mm, cells[-1].clearance_mm],
            "beta_cut_deg": [cells[0].beta_cut_deg, cells[-1].beta_cut_deg],
        },
    }
    try:
        found = search_design(order.tube, order.radius_mm, order.clearance_mm, plane, order.seed)
    except (AnswerIsNoError, InputError) as error:
        return {**answer, "reason": f"on our contour {error.message}"}
    beta_cut_deg = found.hinge.beta_cut_deg
    return {
        **answer,
        "beta_cut_deg": beta_cut_deg,
        "beta_rot_deg": found.rotation.beta_rot_deg,
        "beta_a_deg": found.rotation.hinge_a.rotation_deg,
        "beta_b_deg": found.rotation.hinge_b.rotation_deg,
        "radius_mm": radius_mm(found.rotation.beta_rot_deg, order.tube.link_length_mm),
        "tolerance": _find_tolerance(order, plane, found.rotation.beta_rot_deg),
        "inside_grid": beta_cut_deg <= STEEPEST_CUT_DEG,
    }
