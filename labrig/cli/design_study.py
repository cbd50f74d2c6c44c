"""The work of `labrig design`: reads the measured radius, studies the design, writes the files."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrig.cli.damage import require_undamaged
from labrig.cli.output import say
from labrig.cli.progress import progress
from labrig.durable import write_atomically
from labrig.errors import AnswerIsNoError, InputError, OutputExistsError
from labrig.experiments.hinge_design.study import (
    DesignOrder,
    DesignStudy,
    design_file,
    encode_hinge_table,
    study_design,
)
from labrig.record.provenance import collect_provenance
from labrig.record.reader import open_run

_HINGE_S = 0.5
"""Time of a hinge on two cores: 49 of them take 38 s of the processor, in two processes, and start in a second."""

FIGURE_SUFFIXES = (".png", ".svg", ".pdf")

Document = Mapping[str, Any]


@dataclass(frozen=True)
class Outputs:
    """The files to write; None for a file that was not asked for."""

    out: Path | None
    figure: Path | None
    csv: Path | None

    def require_writable(self, *, force: bool) -> None:
        """Refuse existing files and unknown picture formats before half a minute of work.

        Raises
        ------
        OutputExistsError
            When a file exists and must not be replaced.
        InputError
            When the figure's name has no known format, or a folder is missing.
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
            from labrig.experiments.hinge_design.figure import draw_hinge_figure

            picture = draw_hinge_figure(
                study.cells, study.plane, self.figure.suffix.lower().removeprefix(".")
            )
            write_atomically(self.figure, picture)
            say(f"figure: {self.figure}")
        if self.csv is not None:
            write_atomically(self.csv, encode_hinge_table(study.cells, study.plane))
            say(f"table: {self.csv}")


def _require_writable(option: str, path: Path, *, force: bool) -> None:
    if path.exists() and not force:
        raise OutputExistsError(f"{option} {path} exists", "choose another name, or replace it with --force")
    if not path.parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}", "make the folder first")


def find_measured_radius(
    radius_mm: float | None, run: Path | None, beta_cut_deg: float | None
) -> float | None:
    """Return the measured radius: the given radius, or the mean of a run's newest result.

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
    opened = open_run(run, read_pictures=True)
    require_undamaged(opened.path, opened.damage)
    result = opened.latest_result()
    mean_mm = None if result is None else result.get("mean_radius_mm")
    if not isinstance(mean_mm, float):
        raise AnswerIsNoError(f"{run} has no mean radius", "run a sweep, or `labrig reanalyze` it")
    return mean_mm


def carry_out(order: DesignOrder, outputs: Outputs) -> Document:
    """Study the design with progress, write what was asked for, and return the document. Raises as `study_design`."""
    with progress("searching rotations", 1.0) as reporter:

        def report(done: int, total: int) -> None:
            if not done:
                say(f"searching {total} hinges, which takes about {_HINGE_S * total:.0f} s on two cores")
            reporter(done / total, f"{done} of {total} hinges")

        study = study_design(order, progress=report)
    outputs.write(study)
    return study.document
