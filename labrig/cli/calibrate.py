"""`labrig calibrate intrinsics` and `adopt`: the lens of the camera, and the result of a calibration run."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from labrig.cli.calibration_files import (
    ForceOption,
    OutOption,
    collect_calibration_provenance,
    report_calibration,
    report_refusal,
    require_writable,
)
from labrig.cli.each_picture import use_each
from labrig.cli.options import RigOption, RunArgument
from labrig.cli.output import print_json, print_line
from labrig.errors import CalibrationRefusedError, InputError, PictureError, RecordError
from labrig.library.names import find_rig_file
from labrig.text import number

_CALIBRATION = ("intrinsics.json", "plane.json")
_NO_INTRINSICS: Mapping[str, object] = {
    **dict.fromkeys(("fx", "fy", "cx", "cy", "sigma", "distortion", "rms_px", "holdout_rms_px")),
    "views": [],
}


def intrinsics(
    images: Annotated[list[Path], Argument(metavar="IMAGES...", help="Photographs of the board.")],
    board: Annotated[str, Option(metavar="COLUMNSxROWS", help="Inner corners, e.g. 9x6.")],
    square_mm: Annotated[float, Option(help="Side of a square.", min=0.01)],
    charuco: Annotated[
        str | None, Option(metavar="DICTIONARY", help="Dictionary of a ChArUco board, e.g. DICT_5X5_100.")
    ] = None,
    marker_mm: Annotated[float | None, Option(help="Side of a ChArUco board's marker.")] = None,
    out: OutOption = None,
    force: ForceOption = False,
) -> int:
    """Exit with 1 when the calibration is refused. A picture of residuals and coverage is drawn beside --out."""
    from labrig.report.figures import draw_lens, write_image
    from labrig.vision.calibrate_lens import Charuco, calibrate_from_pictures
    from labrig.vision.calibration_file import save_intrinsics
    from labrig.vision.intrinsics import ViewResidual
    from labrig.vision.picture import read_picture

    if out is not None:
        require_writable(out, force)
        require_writable(out.with_suffix(".png"), force)
        if out.suffix == ".png":
            raise InputError(f"{out} is the name of the picture that is drawn beside it", "name it .json")
    corners = re.fullmatch(r"(\d{1,2})x(\d{1,2})", board.lower(), re.ASCII)
    if corners is None or min(columns := int(corners[1]), rows := int(corners[2])) < 3:
        raise InputError(
            f"--board is {board[:40]!r}, and has to name inner corners, from 3x3 to 99x99",
            "count inner corners, for example --board 9x6",
        )
    if (charuco is None) != (marker_mm is None):
        raise InputError(
            "--charuco and --marker-mm belong together", "for example --charuco DICT_5X5_100 --marker-mm 12"
        )
    markers = None if charuco is None or marker_mm is None else Charuco(charuco, marker_mm / square_mm)

    def refuse(path: Path, error: PictureError) -> ViewResidual:
        return ViewResidual(path.name, None, used=False, reason=f"{error.message}: {error.hint}")

    views = use_each(images, lambda path: (path.name, read_picture(path)), refuse)
    pictures = [view for view in views if isinstance(view, tuple)]
    unread = [view for view in views if isinstance(view, ViewResidual)]
    try:
        found = calibrate_from_pictures(pictures, columns, rows, square_mm, charuco=markers)
    except CalibrationRefusedError as refusal:
        return report_refusal(refusal, _NO_INTRINSICS)
    found = replace(found, views=(*found.views, *unread))
    if out is not None and (found.accepted or force):
        save_intrinsics(out, found, collect_calibration_provenance(images))
        seen = ((view.corners_px, view.errors_px) for view in found.views if view.used)
        figure = draw_lens(found.image_size, seen, found.rms_px)
        write_image(out.with_suffix(".png"), figure, facecolor="white")
    return report_calibration(found.to_json(), _print_intrinsics, out, force)


def _print_intrinsics(document: Mapping[str, Any]) -> None:
    for name in ("fx", "fy", "cx", "cy"):
        sigma = document["sigma"][name]
        print_line(f"{name}  {document[name]:9.3f} px{'' if sigma is None else f'  ± {sigma:.3f} (SD)'}")
    print_line("k1 k2 p1 p2 k3  " + " ".join(f"{value:.5f}" for value in document["distortion"]))
    held_out = number(document["holdout_rms_px"])
    print_line(f"residual {document['rms_px']:.3f} px rms, held out {held_out} px rms")
    for told in ("effect", "board_warp"):
        if document[told] is not None:
            print_line(document[told]["sentence"])
    for view in document["views"]:
        state = f"{view['rms_px']:.3f} px" if view["used"] else f"left out: {view['reason']}"
        print_line(f"  {view['image']}  {state}")


def adopt(run_path: RunArgument, rig: RigOption = None, force: ForceOption = False) -> None:
    """Without --force, adopt no refused calibration and replace no file."""
    from labrig.cli.several_runs import require_undamaged
    from labrig.devices.rig_file import load_rig
    from labrig.durable import write_atomically
    from labrig.experiments.registry import load_run_result
    from labrig.input_file import read_file
    from labrig.record.layout import is_simulated
    from labrig.record.reader import open_run
    from labrig.vision.calibration_file import load_intrinsics, load_plane

    run = open_run(run_path)
    require_undamaged(run.path, run.damage)
    result = load_run_result(run)
    if result is None or not all((result.path / name).exists() for name in _CALIBRATION):
        raise RecordError(f"{run_path} holds no calibration", "run protocols/calibration.yaml first")
    if not result.document["accepted"] and not force:
        raise CalibrationRefusedError(
            f"the calibration of {run_path.name} was refused: {'; '.join(result.document['reasons'])}",
            "calibrate again as the reasons say; --force takes it over all the same",
        )
    adopting = load_rig(find_rig_file(rig))
    if is_simulated(run.manifest) and adopting.kind == "bench":
        told = f"{run_path.name} calibrated a simulated camera, and rig {adopting.name} is a bench"
        raise InputError(told, f"calibrate its own: labrig run protocols/calibration.yaml {adopting.option}")
    targets = adopting.calibration_paths()
    for path in targets.values():
        require_writable(
            path, force, "replace the old one with --force; copy it first if no run that made it is kept"
        )
    lens = load_intrinsics(result.path / "intrinsics.json")
    view = load_plane(result.path / "plane.json", lens).view_sentence()
    for name, path in targets.items():
        write_atomically(path, read_file(result.path / name))
    written = [str(path) for path in targets.values()]
    print_json({"run": str(run_path), "written": written, "view": view})
    for line in filter(None, (*written, view)):
        print_line(line)
