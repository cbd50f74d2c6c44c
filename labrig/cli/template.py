"""`labrig calibrate template`: cuts the picture by which runs and `labrig measure tip` find the tip."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.calibration_files import ForceOption, collect_calibration_provenance, require_writable
from labrig.cli.options import (
    IntrinsicsOption,
    OptionalInsertion,
    OriginOption,
    PlaneOption,
    PxPerMmOption,
    find_run_or_picture,
)
from labrig.cli.output import AsJson, print_json, print_line
from labrig.errors import InputError


def template(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RUN|IMAGE",
            help="Folder of a run, its name in data/runs, or a picture.",
            callback=find_run_or_picture,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE.png", help="Template to write; a JSON file is written beside it."
        ),
    ],
    frame: Annotated[
        int | None,
        typer.Option(help="Frame of the run. Default: its last picture of a needle.", show_default=False),
    ] = None,
    tip_px: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="U V", help="Pixel of the tip. Default: the end of the shaft.", show_default=False
        ),
    ] = None,
    heading_deg: Annotated[
        float | None,
        typer.Option(help="Heading of the needle. Default: that of the shaft.", show_default=False),
    ] = None,
    roll_deg: Annotated[
        float | None,
        typer.Option(help="Roll of the bevel. Default: recorded with the frame, else 0.", show_default=False),
    ] = None,
    side_px: Annotated[
        int | None,
        typer.Option(help="Side of the square. Default: three and a half needle widths.", show_default=False),
    ] = None,
    intrinsics: IntrinsicsOption = None,
    plane: PlaneOption = None,
    px_per_mm: PxPerMmOption = None,
    origin_px: OriginOption = None,
    insertion: OptionalInsertion = None,
    needle_diameter_mm: Annotated[
        float | None,
        typer.Option(help="Outer diameter of the needle. Default: the run's, else 1.2.", show_default=False),
    ] = None,
    sheath_diameter_mm: Annotated[
        float | None,
        typer.Option(
            help="Outer diameter of the sheath. Default: the run's, else no sheath.",
            show_default=False,
        ),
    ] = None,
    force: ForceOption = False,
    as_json: AsJson = False,
) -> None:
    """Cut the template out; tip and heading that are not given are measured by the shaft."""
    from labrig.cli.cut_template import cut_tip, read_recorded_frame, read_single_picture
    from labrig.cli.mapping import load_plane_map
    from labrig.vision.template_file import save_template, template_files

    for file in template_files(out):
        require_writable(file, force)
    mapped = plane is not None or px_per_mm is not None
    given = load_plane_map(intrinsics, plane, px_per_mm, origin_px, insertion) if mapped else None
    if frame is not None and not source.is_dir():
        raise InputError(f"--frame is for runs, and {source} is not a run", "leave it out, or name the run")
    found = read_recorded_frame(source, frame) if source.is_dir() else read_single_picture(source)
    found = replace(
        found,
        plane=given or found.plane,
        roll_rad=found.roll_rad if roll_deg is None else math.radians(roll_deg),
        needle_diameter_mm=needle_diameter_mm or found.needle_diameter_mm,
        sheath_diameter_mm=sheath_diameter_mm or found.sheath_diameter_mm,
    )
    heading_rad = None if heading_deg is None else math.radians(heading_deg)
    cut = cut_tip(found, tip_px, heading_rad, side_px, insertion or "right")
    save_template(out, cut, collect_calibration_provenance([found.file]))
    document = {
        "template": str(out),
        "side_px": cut.picture.shape[0],
        "tip_px": list(cut.tip_px),
        "heading_deg": math.degrees(cut.heading_rad),
        "roll_deg": math.degrees(cut.roll_rad),
        "insertion": cut.insertion,
    }
    if as_json:
        print_json(document)
    else:
        _print(document)


def _print(document: dict[str, Any]) -> None:
    side_px, (u, v) = document["side_px"], document["tip_px"]
    print_line(f"template  {document['template']}, {side_px} x {side_px} px")
    print_line(f"tip       ({u:.2f}, {v:.2f}) px")
    print_line(
        f"heading   {document['heading_deg']:.2f} degrees, bevel at {document['roll_deg']:.0f} degrees"
    )
