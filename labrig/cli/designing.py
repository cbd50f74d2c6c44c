"""The work behind `labrig design`: equations, search, figure and table, and the text for people."""

import multiprocessing
import os
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import typer

from labrig.analysis import load_result
from labrig.cli.output import interval, number, print_table, say
from labrig.cli.progress import progress
from labrig.errors import AnswerIsNoError, InputError, MachineError, OutputExistsError
from labrig.needle import (
    EQUATION_3,
    STEEPEST_CUT_DEG,
    TABLE_1,
    Cell,
    Hinge,
    RotationPlane,
    Tube,
    fit_plane,
    grid_of_hinges,
    links_in,
    radius_mm,
    radius_tolerance,
    rotation_for_radius_deg,
    search_cells,
    search_design,
)
from labrig.record import open_run, write_atomically

FIGURE_SUFFIXES = (".png", ".svg", ".pdf")

Document = dict[str, Any]


@dataclass(frozen=True)
class Tolerances:
    """How sure the laser is."""

    clearance_mm: float
    cut_deg: float


@dataclass(frozen=True)
class Measured:
    """A needle that was measured: its radius, how it was cut (None: as equation (3) says), and in which run."""

    radius_mm: float
    beta_cut_deg: float | None
    run: Path | None


@dataclass(frozen=True)
class DesignOrder:
    """What is asked."""

    tube: Tube
    radius_mm: float
    clearance_mm: float
    tolerances: Tolerances
    tip_length_mm: float | None
    measured: Measured | None
    grid_points: int
    figure: Path | None
    csv: Path | None


def require_writable(figure: Path | None, csv: Path | None, force: bool) -> None:
    """Refuse files that exist, or that no picture format is known for, before half a minute is spent.

    Raises
    ------
    OutputExistsError
        When one exists and is not to be replaced.
    InputError
        When the figure's name says no format, or a folder is missing.
    """
    if figure is not None and figure.suffix.lower() not in FIGURE_SUFFIXES:
        raise InputError(f"--figure {figure} has no known format", f"name it {', '.join(FIGURE_SUFFIXES)}")
    for option, path in (("--figure", figure), ("--csv", csv)):
        if path is None:
            continue
        if path.exists() and not force:
            raise OutputExistsError(
                f"{option} {path} exists", "choose another name, or replace it with --force"
            )
        if not path.parent.is_dir():
            raise InputError(f"{option} {path}: there is no folder {path.parent}", "make the folder first")


def measured_radius(radius_mm: float | None, run: Path | None, beta_cut_deg: float | None) -> float | None:
    """Return the measured radius: the one given, or the mean of a run's newest result.

    Raises
    ------
    InputError
        When both are given, or an inclination without a radius.
    AnswerIsNoError
        When the run has no mean radius.
    RecordError
        When the run cannot be read.
    """
    if radius_mm is not None and run is not None:
        raise InputError("--measured-radius-mm and --from-run both give a radius", "give one of them")
    if run is None:
        if radius_mm is None and beta_cut_deg is not None:
            raise InputError(
                "--beta-cut-deg says how a measured needle was cut, and no measured radius is given",
                "add --measured-radius-mm or --from-run",
            )
        return radius_mm
    result = load_result(open_run(run))
    mean_mm = None if result is None else result.document.get("mean_radius_mm")
    if not isinstance(mean_mm, float):
        raise AnswerIsNoError(f"{run} has no mean radius", "run a sweep, or `labrig reanalyze` it")
    return mean_mm


def carry_out(order: DesignOrder) -> Document:
    """Answer by equation (3), then by the search; write the figure and the table that were asked for.

    Raises
    ------
    InputError
        When a length or angle is beyond its limit.
    AnswerIsNoError
        When no inclination gives the radius, or no clearance explains the measured one.
    MachineError
        When a process that searches dies.
    """
    document = _by_equations(order)
    cells = _searched_grid(order)
    plane = fit_plane(cells)
    document["search"] = _by_search(order, cells, plane)
    if document["measured"] is not None:
        document["measured"]["search_clearance_mm"] = _clearance_or_none(plane, document["measured"])
    _write_outputs(order, cells, plane)
    return document


def _by_equations(order: DesignOrder) -> Document:
    """Return the answer of equations (1) to (3); everything that can be refused is refused here."""
    tube = order.tube
    Hinge(tube, order.clearance_mm, beta_cut_deg=0.0)
    beta_rot_deg = rotation_for_radius_deg(order.radius_mm, tube.link_length_mm)
    beta_cut_deg = EQUATION_3.beta_cut_deg(beta_rot_deg, order.clearance_mm)
    Hinge(tube, order.clearance_mm, beta_cut_deg)
    is_table_1 = (tube, order.clearance_mm, order.radius_mm) == (
        TABLE_1.tube,
        TABLE_1.clearance_mm,
        TABLE_1.radius_mm,
    )
    return {
        "beta_cut_deg": beta_cut_deg,
        "beta_rot_deg": beta_rot_deg,
        "radius_mm": radius_mm(beta_rot_deg, tube.link_length_mm),
        "clearance_mm": order.clearance_mm,
        "tube": asdict(tube),
        "equation_3": {**asdict(EQUATION_3), "same_tube": _same_section(tube)},
        "tolerance": _tolerance(order, EQUATION_3, beta_rot_deg),
        "table_1": {"beta_cut_deg": TABLE_1.beta_cut_deg, "beta_rot_deg": TABLE_1.beta_rot_deg}
        if is_table_1
        else None,
        "links": None if order.tip_length_mm is None else links_in(order.tip_length_mm, tube.link_length_mm),
        "measured": None if order.measured is None else _measured(order, order.measured, beta_cut_deg),
    }


def _same_section(tube: Tube) -> bool:
    """Return whether equation (3), which was fitted to one tube, speaks of this one; it holds for any link length."""
    paper = TABLE_1.tube
    return (tube.outer_diameter_mm, tube.inner_diameter_mm) == (
        paper.outer_diameter_mm,
        paper.inner_diameter_mm,
    )


def _tolerance(order: DesignOrder, plane: RotationPlane, beta_rot_deg: float) -> Document:
    found = radius_tolerance(
        plane,
        beta_rot_deg,
        order.tube.link_length_mm,
        clearance_tolerance_mm=order.tolerances.clearance_mm,
        cut_tolerance_deg=order.tolerances.cut_deg,
    )
    return {
        "clearance_mm": order.tolerances.clearance_mm,
        "cut_deg": order.tolerances.cut_deg,
        "radius_mm_per_clearance_mm": found.per_clearance,
        "radius_mm_per_cut_deg": found.per_degree_mm,
        "radius_mm": [found.low_mm, found.high_mm],
    }


def _measured(order: DesignOrder, measured: Measured, designed_cut_deg: float) -> Document:
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


def _clearance_or_none(plane: RotationPlane, measured: Document) -> float | None:
    """Return the clearance by our own plane; None where it would be negative."""
    try:
        return plane.clearance_mm(measured["beta_rot_deg"], measured["beta_cut_deg"])
    except AnswerIsNoError:
        return None


def _searched_grid(order: DesignOrder) -> tuple[Cell, ...]:
    hinges = grid_of_hinges(order.tube, order.clearance_mm, order.grid_points)
    with _processes() as executor, progress("searching rotations", float(len(hinges))) as reporter:
        return search_cells(
            hinges, executor, lambda done, total: reporter(float(done), f"{done} of {total} hinges")
        )


@contextmanager
def _processes() -> Iterator[Executor]:
    """Give one process a core; what has not begun is dropped when the command is interrupted."""
    pool = ProcessPoolExecutor(
        os.cpu_count(), multiprocessing.get_context("fork"), _leave_signals_to_the_parent
    )
    try:
        yield pool
    except BrokenProcessPool as error:
        raise MachineError("a process that searched died", "free some memory and try again") from error
    finally:
        pool.shutdown(cancel_futures=True)


def _leave_signals_to_the_parent() -> None:
    # Ctrl+C reaches every process of the terminal; the parent ends its workers. A signal sent to one worker ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def _by_search(order: DesignOrder, cells: tuple[Cell, ...], plane: RotationPlane) -> Document:
    found = search_design(order.tube, order.radius_mm, order.clearance_mm, plane)
    beta_cut_deg = found.hinge.beta_cut_deg
    return {
        "beta_cut_deg": beta_cut_deg,
        "beta_rot_deg": found.rotation.beta_rot_deg,
        "beta_a_deg": found.rotation.hinge_a.rotation_deg,
        "beta_b_deg": found.rotation.hinge_b.rotation_deg,
        "radius_mm": radius_mm(found.rotation.beta_rot_deg, order.tube.link_length_mm),
        "fit": asdict(plane),
        "tolerance": _tolerance(order, plane, found.rotation.beta_rot_deg),
        "grid": {
            "points": order.grid_points,
            "clearance_mm": [cells[0].clearance_mm, cells[-1].clearance_mm],
            "beta_cut_deg": [cells[0].beta_cut_deg, cells[-1].beta_cut_deg],
        },
        "inside_grid": beta_cut_deg <= STEEPEST_CUT_DEG,
    }


def _write_outputs(order: DesignOrder, cells: tuple[Cell, ...], plane: RotationPlane) -> None:
    if order.figure is None and order.csv is None:
        return
    # matplotlib takes half a second to load, and most calls draw nothing.
    from labrig.report import hinge_figure, hinge_table

    if order.figure is not None:
        picture = hinge_figure(cells, plane, order.figure.suffix.lower().removeprefix("."))
        write_atomically(order.figure, picture)
        say(f"figure: {order.figure}")
    if order.csv is not None:
        write_atomically(order.csv, hinge_table(cells, plane))
        say(f"table: {order.csv}")


def print_design(document: Document) -> None:
    """Print the answer for people."""
    search = document["search"]
    typer.echo(
        f"A radius of {number(document['radius_mm'], 2)} mm at a clearance of {document['clearance_mm']:g} mm: "
        f"two hinges turn {number(document['beta_rot_deg'], 2)} degrees."
    )
    print_table(("", "equation (3)", "our contour"), _rows(document, search))
    if document["table_1"] is not None:
        typer.echo(
            f"Table I prints {document['table_1']['beta_cut_deg']} degrees; "
            f"equation (3) solved for it gives {number(document['beta_cut_deg'], 2)}."
        )
    if document["links"] is not None:
        typer.echo(f"The tip takes {document['links']} links.")
    if document["measured"] is not None:
        _print_measured(document["measured"])
    for sentence in _warnings(document):
        typer.echo(sentence)


def _rows(document: Document, search: Document) -> list[list[str]]:
    paper_fit, own_fit = document["equation_3"], search["fit"]
    rows = [
        [
            "inclination to cut [degrees]",
            number(document["beta_cut_deg"], 2),
            number(search["beta_cut_deg"], 2),
        ],
        ["hinges turn [degrees]", number(document["beta_rot_deg"], 2), number(search["beta_rot_deg"], 2)],
        [
            "of it hinge a, hinge b",
            "-",
            f"{number(search['beta_a_deg'], 2)}, {number(search['beta_b_deg'], 2)}",
        ],
        [
            "radius within tolerances [mm]",
            interval(document["tolerance"]["radius_mm"]),
            interval(search["tolerance"]["radius_mm"]),
        ],
    ]
    for label, key, digits in (
        ("degrees per degree of inclination", "a", 3),
        ("degrees per mm of clearance", "b", 1),
        ("constant [degrees]", "c", 3),
        ("RMSE of the plane [degrees]", "rmse_deg", 4),
    ):
        rows.append([label, number(paper_fit[key], digits), number(own_fit[key], digits)])
    return rows


def _print_measured(measured: Document) -> None:
    own = measured["search_clearance_mm"]
    typer.echo(
        f"Measured {number(measured['radius_mm'], 2)} mm means {number(measured['beta_rot_deg'], 2)} degrees; cut at "
        f"{number(measured['beta_cut_deg'], 2)} degrees, a clearance of {number(measured['clearance_mm'], 4)} mm by "
        f"equation (3), {number(own, 4)} mm by our contour."
    )


def _warnings(document: Document) -> Iterator[str]:
    if not document["equation_3"]["same_tube"]:
        yield "Equation (3) was fitted to a tube of 1.2 and 0.7 mm; for this one only our contour was searched."
    if not document["search"]["inside_grid"]:
        yield f"The inclination is beyond the searched grid, which ends at {STEEPEST_CUT_DEG:g} degrees."
    yield "Our contour is not the paper's, whose figure 2 is not in its text: it shows trends, and is not for cutting."
