"""`labrig design`: what to cut for a radius."""

from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import RunsDirOption, find_run_folder, find_runs_dir
from labrig.cli.output import AsJson, print_json
from labrig.needle.tube import Tube


def design(
    radius_mm: Annotated[float, typer.Option(help="Wanted steering radius.")] = 30.0,
    clearance_mm: Annotated[float, typer.Option(help="Width of the laser's cut.")] = 0.025,
    outer_diameter_mm: Annotated[float, typer.Option(help="Outer diameter of the tube.")] = 1.2,
    inner_diameter_mm: Annotated[float, typer.Option(help="Inner diameter of the tube.")] = 0.7,
    link_length_mm: Annotated[float, typer.Option(help="Length of a link, from hinge to hinge.")] = 3.0,
    clearance_tolerance_mm: Annotated[float, typer.Option(help="Tolerance of the laser's width.")] = 0.003,
    cut_tolerance_deg: Annotated[float, typer.Option(help="Tolerance of the inclination.")] = 0.1,
    tip_length_mm: Annotated[
        float | None, typer.Option(help="Length of the tip; states how many links fit.", show_default=False)
    ] = None,
    measured_radius_mm: Annotated[
        float | None,
        typer.Option(help="Measured radius of a needle; states its effective clearance.", show_default=False),
    ] = None,
    from_run: Annotated[
        Path | None,
        typer.Option(
            metavar="RUN",
            help="Take the measured radius from a run: its folder, or its name in --runs-dir.",
            show_default=False,
        ),
    ] = None,
    runs_dir: RunsDirOption = None,
    beta_cut_deg: Annotated[
        float | None,
        typer.Option(
            help="Inclination at which the measured needle was cut. Default: table I of the paper, else equation (3).",
            show_default=False,
        ),
    ] = None,
    grid_points: Annotated[
        int, typer.Option(min=3, max=25, help="Points along each side of the searched grid.")
    ] = 7,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write a design file (JSON), which protocols name as needle.design_file.",
            show_default=False,
        ),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw figure 3: .png, .svg or .pdf.", show_default=False),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the searched grid as a table.", show_default=False),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
    as_json: AsJson = False,
) -> int:
    """Print both answers; the search takes about half a minute on two cores.

    Exit with 0 when equation (3) has an answer, even if our contour cannot give the radius, and says why; with 1 when
    neither gives it, or when the tube is one for which only our contour is valid and it cannot.
    """
    from labrig.cli.design_study import Outputs, carry_out, find_measured_radius
    from labrig.cli.finished_run import print_summary
    from labrig.experiments.hinge_design.study import DesignOrder, MeasuredRadius
    from labrig.experiments.hinge_design.summary import summarise

    outputs = Outputs(out, figure, csv)
    outputs.require_writable(force=force)
    run = None if from_run is None else find_run_folder(from_run, find_runs_dir(runs_dir))
    radius = find_measured_radius(measured_radius_mm, run, beta_cut_deg)
    order = DesignOrder(
        tube=Tube(outer_diameter_mm, inner_diameter_mm, link_length_mm),
        radius_mm=radius_mm,
        clearance_mm=clearance_mm,
        clearance_tolerance_mm=clearance_tolerance_mm,
        cut_tolerance_deg=cut_tolerance_deg,
        tip_length_mm=tip_length_mm,
        measured=None if radius is None else MeasuredRadius(radius, beta_cut_deg, run),
        grid_points=grid_points,
    )
    document = carry_out(order, outputs)
    if as_json:
        print_json(document)
    else:
        print_summary(summarise(document))
    return 0 if document["accepted"] else 1
