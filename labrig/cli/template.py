"""`labrig calibrate template`: cuts the picture by which runs and `labrig measure tip` find the tip."""

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.calibration_files import ForceOption, collect_calibration_provenance, require_writable
from labrig.cli.options import find_run_or_picture
from labrig.cli.output import AsJson, print_line, show
from labrig.errors import InputError

# Needle widths that a template shows to each side of the tip, and its side where no shaft was measured.
_WIDTHS, _SIDE_PX = 1.75, 41


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
        int | None, typer.Option(help="Frame of the run. Default: its last picture of a needle.")
    ] = None,
    tip_px: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="U V", help="Pixel of the tip. Default in a run: the end of the shaft."),
    ] = None,
    heading_deg: Annotated[
        float | None,
        typer.Option(
            help="Heading of the needle, in a picture of no run from its right. Default in a run: that of the shaft."
        ),
    ] = None,
    force: ForceOption = False,
    as_json: AsJson = False,
) -> None:
    """Of a picture that belongs to no run, tip and heading have to be given."""
    from labrig.vision.picture import read_picture
    from labrig.vision.template import cut_template, save_template, template_files

    for written in template_files(out):
        require_writable(written, force)
    heading_rad = None if heading_deg is None else math.radians(heading_deg)
    if source.is_dir():
        file, cut = _cut_from_run(source, frame, tip_px, heading_rad)
    elif frame is not None:
        raise InputError(f"--frame is for runs, and {source} is not a run", "leave it out, or name the run")
    elif tip_px is None or heading_rad is None:
        raise InputError(
            "tip and heading cannot both be measured: it is not known how the picture maps to mm",
            "give --tip-px and --heading-deg, or name a run",
        )
    else:
        file = source
        cut = cut_template(read_picture(file), tip_px, heading_rad, side_px=_SIDE_PX, insertion="right")
    save_template(out, cut, collect_calibration_provenance([file]))
    document = {
        "template": str(out),
        "side_px": cut.picture.shape[0],
        "tip_px": list(cut.tip_px),
        "heading_deg": math.degrees(cut.heading_rad),
        "roll_deg": math.degrees(cut.roll_rad),
        "insertion": cut.insertion,
    }
    show(document, as_json, _print)


def _cut_from_run(
    folder: Path, frame: int | None, tip_px: tuple[float, float] | None, heading_rad: float | None
) -> tuple[Path, Any]:
    """Return the file of a frame, by default the last one of a needle, and its template.

    What is not given of the tip is measured by the shaft.

    Raises
    ------
    InputError
        When the run holds no such picture, or no map of its pictures to mm.
    MeasurementRefusedError
        When the picture does not show one shaft.
    """
    from labrig.analysis.pictures import load_plane_map
    from labrig.experiments.registry import load_run_protocol
    from labrig.experiments.shared.needle_events import NeedleRole
    from labrig.record.reader import open_run
    from labrig.vision.shaft_tip import measure_shaft_tip
    from labrig.vision.template import cut_template

    run = open_run(folder)
    if frame is None:
        shown = [line.frame for line in run.frame_lines if line.role in set(NeedleRole)]
        if not shown:
            raise InputError(f"{folder} holds no picture of a needle", "name one with --frame")
        frame = shown[-1]
    image, line = run.read_frame(frame), run.frame_lines[frame]
    plane, needle, side_px = load_plane_map(run), load_run_protocol(run).pictured_needle, _SIDE_PX
    if tip_px is None or heading_rad is None:
        if needle is None:
            raise InputError(f"{folder} holds no needle", "give --tip-px and --heading-deg")
        shaft = measure_shaft_tip(image, plane, needle.diameter_mm, needle.sheath_diameter_mm)
        tip_px = tip_px or shaft.tip_px
        heading_rad = shaft.heading_rad if heading_rad is None else heading_rad
        side_px = 2 * round(_WIDTHS * shaft.width_px) + 1
    roll_rad = line.rotation_rad or 0.0
    cut = cut_template(
        image, tip_px, heading_rad, side_px=side_px, insertion=plane.insertion, roll_rad=roll_rad
    )
    return folder / line.file, cut


def _print(document: dict[str, Any]) -> None:
    side_px, (u, v) = document["side_px"], document["tip_px"]
    print_line(f"template  {document['template']}, {side_px} x {side_px} px")
    print_line(f"tip       ({u:.2f}, {v:.2f}) px")
    print_line(
        f"heading   {document['heading_deg']:.2f} degrees, bevel at {document['roll_deg']:.0f} degrees"
    )
