"""The work behind `labrig design`: what it is given, the files that it writes, and the text for people."""

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrig.analysis.design import DesignOrder, DesignStudy, design_file, hinge_table, study_design
from labrig.analysis.result import load_result
from labrig.cli.damage import require_undamaged
from labrig.cli.output import interval, number, print_line, print_table, say
from labrig.cli.progress import progress
from labrig.errors import AnswerIsNoError, InputError, OutputExistsError
from labrig.needle.study import STEEPEST_CUT_DEG
from labrig.record.durable import write_atomically
from labrig.record.provenance import collect_provenance
from labrig.record.reader import open_run

FIGURE_SUFFIXES = (".png", ".svg", ".pdf")

Document = Mapping[str, Any]


@dataclass(frozen=True)
class Outputs:
    """Files that were asked for, None where one was not."""

    out: Path | None
    figure: Path | None
    csv: Path | None

    def require_writable(self, *, force: bool) -> None:
        """Refuse files that exist, or that no picture format is known for, before half a minute is spent.

        Raises
        ------
        OutputExistsError
            When one exists and is not to be replaced.
        InputError
            When the figure's name says no format, or a folder is missing.
        """
        if self.figure is not None and self.figure.suffix.lower() not in FIGURE_SUFFIXES:
            raise InputError(
                f"--figure {self.figure} has no known format", f"name it {', '.join(FIGURE_SUFFIXES)}"
            )
        for option, path in (("--out", self.out), ("--figure", self.figure), ("--csv", self.csv)):
            if path is not None:
                _require_writable(option, path, force=force)

    def write(self, study: DesignStudy) -> None:
        """Write the design file, the figure and the table. Raises `DiskError`."""
        if self.out is not None and study.document["accepted"]:
            write_atomically(self.out, design_file(study.document, collect_provenance(tuple(sys.argv))))
            say(f"design: {self.out}")
        if self.figure is not None:
            # matplotlib takes half a second to load, and most calls draw nothing.
            from labrig.report.design_figure import hinge_figure

            picture = hinge_figure(study.cells, study.plane, self.figure.suffix.lower().removeprefix("."))
            write_atomically(self.figure, picture)
            say(f"figure: {self.figure}")
        if self.csv is not None:
            write_atomically(self.csv, hinge_table(study.cells, study.plane))
            say(f"table: {self.csv}")


def _require_writable(option: str, path: Path, *, force: bool) -> None:
    if path.exists() and not force:
        raise OutputExistsError(f"{option} {path} exists", "choose another name, or replace it with --force")
    if not path.parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}", "make the folder first")


def run_by_name(given: Path, runs_dir: Path) -> Path:
    """Return a run's folder: the one given, or the run of that name."""
    named = runs_dir / given
    return named if len(given.parts) == 1 and not given.exists() and named.is_dir() else given


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
    opened = open_run(run)
    require_undamaged(opened)
    result = load_result(opened)
    mean_mm = None if result is None else result.document.get("mean_radius_mm")
    if not isinstance(mean_mm, float):
        raise AnswerIsNoError(f"{run} has no mean radius", "run a sweep, or `labrig reanalyze` it")
    return mean_mm


def carry_out(order: DesignOrder, outputs: Outputs) -> Document:
    """Study the design with progress, write what was asked for, and return the document. Raises as `study_design`."""
    with progress("searching rotations", 1.0) as reporter:
        study = study_design(
            order, progress=lambda done, total: reporter(done / total, f"{done} of {total} hinges")
        )
    outputs.write(study)
    return study.document


def print_design(document: Document) -> None:
    """Print the answer for people."""
    search = document["search"]
    print_line(
        f"A radius of {number(document['radius_mm'], 2)} mm at a clearance of {document['clearance_mm']:g} mm: "
        f"two hinges turn {number(document['beta_rot_deg'], 2)} degrees."
    )
    print_table(("", "equation (3)", "our contour"), _rows(document, search))
    if document["table_1"] is not None:
        print_line(
            f"Table I prints {document['table_1']['beta_cut_deg']} degrees; "
            f"equation (3) solved for it gives {number(document['beta_cut_deg'], 2)}."
        )
    if document["links"] is not None:
        print_line(f"The tip takes {document['links']} links.")
    if document["measured"] is not None:
        _print_measured(document["measured"])
    for sentence in _warnings(document):
        print_line(sentence)


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
            interval(None if search["tolerance"] is None else search["tolerance"]["radius_mm"]),
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
    print_line(
        f"Measured {number(measured['radius_mm'], 2)} mm means {number(measured['beta_rot_deg'], 2)} degrees; cut at "
        f"{number(measured['beta_cut_deg'], 2)} degrees, a clearance of {number(measured['clearance_mm'], 4)} mm by "
        f"equation (3), {number(own, 4)} mm by our contour."
    )


def _warnings(document: Document) -> Iterator[str]:
    if not document["equation_3"]["same_tube"]:
        yield "Equation (3) was fitted to a tube of 1.2 and 0.7 mm; for this one only our contour was searched."
    if document["search"]["reason"] is not None:
        yield f"No answer of our own: {document['search']['reason']}."
    if document["search"]["inside_grid"] is False:
        yield f"The inclination is beyond the searched grid, which ends at {STEEPEST_CUT_DEG:g} degrees."
    yield "Our contour is not the paper's, whose figure 2 is not in its text: it shows trends, and is not for cutting."
