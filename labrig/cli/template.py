"""`labrig calibrate template`: cuts the picture by which runs and `labrig measure tip` find the tip."""

import math
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from labrig.cli.calibration_files import ForceOption, collect_calibration_provenance, require_writable
from labrig.cli.output import print_json, print_line
from labrig.errors import InputError
from labrig.lab import choose_runs_dir
from labrig.library.names import find_run_folder

# Needle widths that a template shows to each side of the tip, and its side where no shaft was measured.
_WIDTHS, _SIDE_PX = 1.75, 41


def template(
    source: Annotated[Path, Argument(metavar="RUN|IMAGE", help="A run by folder or name, or a picture.")],
    out: Annotated[
        Path, Option(metavar="FILE.png", help="Template to write; a JSON file is written beside it.")
    ],
    frame: Annotated[int | None, Option(help="Of the run. Default: its last picture of a needle.")] = None,
    tip_px: Annotated[
        tuple[float, float] | None, Option(metavar="U V", help="Tip. Default in a run: the end of the shaft.")
    ] = None,
    heading_deg: Annotated[
        float | None,
        Option(help="Heading, in a picture of no run from its right. Default in a run: the shaft's."),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Of a picture that belongs to no run, tip and heading have to be given."""
    from labrig.vision.picture import read_picture
    from labrig.vision.template import cut_template, save_template, template_files

    for written in template_files(out):
        require_writable(written, force)
    heading_rad = None if heading_deg is None else math.radians(heading_deg)
    source = find_run_folder(source, choose_runs_dir().path)
    if source.is_dir():
        source, cut = _cut_from_run(source, frame, tip_px, heading_rad)
    elif frame is not None:
        raise InputError(f"--frame is for runs, and {source} is not a run", "leave it out, or name the run")
    elif tip_px is None or heading_rad is None:
        raise InputError(
            "tip and heading cannot both be measured: it is not known how the picture maps to mm",
            "give --tip-px and --heading-deg, or name a run",
        )
    else:
        cut = cut_template(read_picture(source), tip_px, heading_rad, side_px=_SIDE_PX, insertion="right")
    save_template(out, cut, collect_calibration_provenance([source]))
    side_px, (u, v) = cut.picture.shape[0], cut.tip_px
    heading, roll = math.degrees(cut.heading_rad), math.degrees(cut.roll_rad)
    print_json({
        "template": str(out),
        "side_px": side_px,
        "tip_px": [u, v],
        "heading_deg": heading,
        "roll_deg": roll,
        "insertion": cut.insertion,
    })  # fmt: skip
    print_line(f"template  {out}, {side_px} x {side_px} px\ntip       ({u:.2f}, {v:.2f}) px")
    print_line(f"heading   {heading:.2f} degrees, bevel at {roll:.0f} degrees")


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
        shown = [one.frame for one in run.frame_lines if one.role in {NeedleRole.FINAL, NeedleRole.IMPORTED}]
        if not shown:
            raise InputError(f"{folder} holds no final picture of a needle", "name another run, or --frame")
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
