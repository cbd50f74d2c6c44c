"""`labrig calibrate plane`: finds the map from pixels to mm in the steering plane."""

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from labrig.cli.calibration_files import (
    ForceOption,
    OutOption,
    collect_calibration_provenance,
    report_calibration,
    report_refusal,
    require_writable,
)
from labrig.cli.options import InsertionOption, IntrinsicsOption
from labrig.cli.output import SPEAKS_JSON, print_line
from labrig.cli.progress import show_working
from labrig.errors import CalibrationRefusedError, InputError
from labrig.library.names import find_named_rig_file
from labrig.text import number

if TYPE_CHECKING:
    from labrig.devices.operator import Answer, Operator, OperatorRequest
    from labrig.devices.rig_file import RigDescription
    from labrig.vision.intrinsics import Intrinsics

_NO_PLANE: Mapping[str, object] = dict.fromkeys(
    ("rms_mm", "holdout_rms_mm", "mm_per_px", "picture_mm", "camera_distance_mm", "view")
)


def plane(
    image: Annotated[Path, Argument(metavar="IMAGE", help="Picture of graph paper in the steering plane.")],
    origin_px: Annotated[tuple[float, float], Option(metavar="U V", help="Pixel of the plane's origin.")],
    insertion: InsertionOption,
    pitch_mm: Annotated[float, Option(help="Distance between the paper's nearest lines.")] = 1.0,
    px_per_mm: Annotated[
        float | None, Option(help="Scale of the picture, to 20 %. Default: by the distance.")
    ] = None,
    distance_mm: Annotated[
        float | None,
        Option(
            help="Distance from camera to paper by tape, to 20 %. Default: camera.distance_mm of the rig file, else "
            "the scale of the rig's last plane map, else you click two marks."
        ),
    ] = None,
    intrinsics: IntrinsicsOption = None,
    setup: Annotated[
        Path | None,
        Option(metavar="FILE", help="YAML file: gel, paper_sigma_mm as in a calibration protocol's plane."),
    ] = None,
    rig: Annotated[Path | None, Option(metavar="FILE", help="Rig file. Default: $LABRIG_RIG.")] = None,
    out: OutOption = None,
    force: ForceOption = False,
) -> int:
    """Exit with 1 when the calibration is refused."""
    from labrig.devices.rig_file import load_rig
    from labrig.experiments.camera_calibration.protocol import PaperSetup
    from labrig.protocol.yaml_file import load_yaml_model
    from labrig.vision.calibrate_plane import calibrate_plane
    from labrig.vision.calibration_file import load_intrinsics, save_plane
    from labrig.vision.picture import read_picture

    require_writable(out, force)
    above = PaperSetup() if setup is None else load_yaml_model(setup, PaperSetup)
    lens = None if intrinsics is None else load_intrinsics(intrinsics)
    rig_file = find_named_rig_file(rig)
    described = None if rig_file is None else load_rig(rig_file)
    picture = read_picture(image)
    scale = _find_scale(px_per_mm, distance_mm, described, lens) or _ask_scale(image)
    try:
        with show_working("finding the lines of the paper"):
            found = calibrate_plane(
                picture,
                lens,
                pitch_mm,
                origin_px,
                insertion,
                px_per_mm=scale,
                gel=above.gel,
                paper_sigma_mm=above.paper_sigma_mm,
            )
    except CalibrationRefusedError as refusal:
        return report_refusal(refusal, _NO_PLANE)
    if out is not None and (found.accepted or force):
        save_plane(out, found, collect_calibration_provenance([image]))
    return report_calibration(found.to_json(), _print_plane, out, force)


def _find_scale(
    px_per_mm: float | None,
    distance_mm: float | None,
    rig: "RigDescription | None",
    lens: "Intrinsics | None",
) -> float | None:
    """Return the scale [px/mm]: as typed, by a distance, or of the rig's last plane map; None if none tells it.

    Raises
    ------
    InputError
        If two options say it, or a distance has no lens.
    """
    from labrig.vision.calibrate_plane import find_px_per_mm
    from labrig.vision.calibration_file import load_px_per_mm

    if px_per_mm is not None and distance_mm is not None:
        raise InputError("--px-per-mm and --distance-mm both tell the scale", "give one of them")
    if distance_mm is not None and lens is None:
        raise InputError(
            "a distance tells the scale by the lens, and --intrinsics is missing",
            "give --intrinsics FILE, or --px-per-mm in place of --distance-mm",
        )
    if px_per_mm is not None or (rig is None and distance_mm is None):
        return px_per_mm
    if distance_mm is None and rig is not None:
        distance_mm = rig.camera.distance_mm
    if distance_mm is not None and lens is not None:
        return find_px_per_mm(lens, distance_mm)
    last = None if rig is None else rig.calibration_file("plane")
    return None if last is None or not last.is_file() else load_px_per_mm(last)


def _ask_scale(image: Path) -> float:
    """Return the scale by two marks [px/mm]. Raises `InputError` if nobody is there to click them."""
    from labrig.cli.signals import SignalNote
    from labrig.cli.terminal_operator import TerminalOperator

    if sys.stdin.isatty() and not SPEAKS_JSON.get():
        return read_scale_from(TerminalOperator(SignalNote(), sys.stdin), image)
    raise InputError(
        "nothing tells the scale of the picture, roughly",
        "give --px-per-mm, to 20 %: the pixels between two marks of a ruler over their millimetres; or "
        "--distance-mm with --intrinsics",
    )


def read_scale_from(person: "Operator", image: Path) -> float:
    """Ask for two marks on the picture and the millimetres between them, and return the scale [px/mm].

    Raises
    ------
    InputError
        If the person says no, or the answers tell no scale.
    """
    from labrig.devices.operator import PickMark, ReadLength

    def ask(request: "OperatorRequest") -> "Answer":
        answer = person.ask(request, lambda: None)
        if not answer.confirmed:
            raise InputError("the scale of the picture was not told", "give --px-per-mm, to 20 %")
        return answer

    first, second = (ask(PickMark(str(image), mark)).pixel for mark in ("first", "second"))
    length_mm = ask(ReadLength()).reading
    if first is None or second is None or not length_mm or length_mm <= 0.0 or first == second:
        raise InputError("two marks and a length above 0 mm tell the scale", "click two marks far apart")
    return math.dist(first, second) / length_mm


def _print_plane(document: Mapping[str, Any]) -> None:
    print_line(
        f"scale {document['mm_per_px']:.5f} mm/px, residual {document['rms_mm']:.4f} mm rms, "
        f"held out {number(document['holdout_rms_mm'], 4)} mm rms, flat within {document['flatness_mm']:.3f} mm"
    )
    if document["view"] is not None:
        print_line(document["view"])
    for sentence in document["assumptions"]:
        print_line(f"assumed: {sentence}")
    if document["not_in_interval"]:
        print_line(f"not in the interval: {', '.join(document['not_in_interval'])}")
