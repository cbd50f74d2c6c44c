"""`labrig calibrate`: camera intrinsics, plane map and tip template, and adopting the result of a calibration run."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.calibrate_plane import plane
from labrig.cli.calibration_files import (
    ForceOption,
    OutOption,
    collect_calibration_provenance,
    report_output,
    report_refusal,
    require_writable,
)
from labrig.cli.options import RigOption, RunArgument
from labrig.cli.output import AsJson, print_line, show
from labrig.cli.template import template
from labrig.errors import CalibrationRefusedError, InputError, PictureError, RecordError
from labrig.library.names import find_rig_file

_MOST_DIGITS = 2
_CALIBRATION = ("intrinsics.json", "plane.json")
_NO_INTRINSICS: dict[str, object] = {
    **dict.fromkeys(("fx", "fy", "cx", "cy", "sigma", "distortion", "rms_px", "holdout_rms_px")),
    "views": [],
}

app = typer.Typer(no_args_is_help=True)
app.command("template", help="Cut a template of the needle's tip out of a recorded frame or a picture.")(
    template
)
app.command(
    "plane", help="Find the map from pixels to mm in the steering plane from a picture of graph paper."
)(plane)


@app.command(
    "intrinsics",
    help="Find intrinsics and distortion from photographs of a chessboard or a ChArUco board.",
)
def intrinsics(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGES...", help="Photographs of the board.")],
    board: Annotated[str, typer.Option(metavar="COLUMNSxROWS", help="Inner corners, e.g. 9x6.")],
    square_mm: Annotated[float, typer.Option(help="Side of a square.")],
    charuco: Annotated[
        str | None,
        typer.Option(metavar="DICTIONARY", help="Dictionary of a ChArUco board, e.g. DICT_5X5_100."),
    ] = None,
    marker_mm: Annotated[float | None, typer.Option(help="Side of a ChArUco board's marker.")] = None,
    out: OutOption = None,
    force: ForceOption = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 1 when the calibration is refused. A picture of residuals and coverage is drawn beside --out."""
    from labrig.report.figures import draw_lens, write_image
    from labrig.vision.calibrate_lens import calibrate_from_pictures
    from labrig.vision.calibration_file import save_intrinsics

    if out is not None:
        if out.suffix == ".png":
            raise InputError(
                f"{out} is the name of the picture that is drawn beside the calibration", "name it .json"
            )
        require_writable(out, force)
        require_writable(out.with_suffix(".png"), force)
    columns, rows = _read_board_size(board)
    markers = _describe_markers(square_mm, charuco, marker_mm)
    pictures, unread = _read_views(images)
    try:
        found = calibrate_from_pictures(pictures, columns, rows, square_mm, charuco=markers)
    except CalibrationRefusedError as refusal:
        return report_refusal(refusal, _NO_INTRINSICS, as_json)
    found = replace(found, views=(*found.views, *unread))
    if out is not None and (found.accepted or force):
        save_intrinsics(out, found, collect_calibration_provenance(images))
        seen = ((view.corners_px, view.errors_px) for view in found.views if view.used)
        write_image(
            out.with_suffix(".png"), draw_lens(found.image_size, seen, found.rms_px), facecolor="white"
        )
    show(found.to_json(), as_json, _print_intrinsics)
    report_output(out, found.accepted, force)
    return 0 if found.accepted else 1


@app.command("adopt", help="Copy the calibration of a run of protocols/calibration.yaml to the rig's files.")
def adopt(
    run_path: RunArgument,
    rig: RigOption = None,
    force: ForceOption = False,
    as_json: AsJson = False,
) -> None:
    """Without --force, adopt no refused calibration and replace no file."""
    from labrig.cli.damage import require_undamaged
    from labrig.devices.rig_file import load_rig
    from labrig.durable import write_atomically
    from labrig.experiments.registry import load_run_result
    from labrig.input_file import read_file
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
    rig_file = find_rig_file(rig)
    targets = load_rig(rig_file).calibration_paths()
    for path in targets.values():
        require_writable(
            path, force, "replace the old calibration with --force; the run that made it keeps it"
        )
    found = load_plane(result.path / "plane.json", load_intrinsics(result.path / "intrinsics.json"))
    for name, path in targets.items():
        write_atomically(path, read_file(result.path / name))
    document = {
        "run": str(run_path),
        "written": [str(path) for path in targets.values()],
        "view": found.view_sentence(),
    }
    show(document, as_json, _print_adopted)


def _print_adopted(document: dict[str, Any]) -> None:
    for line in filter(None, (*document["written"], document["view"])):
        print_line(line)


def _read_board_size(board: str) -> tuple[int, int]:
    """Read `9x6` as nine columns and six rows of inner corners."""
    columns, _, rows = board.lower().partition("x")
    numbers = columns.isdecimal() and rows.isdecimal() and max(len(columns), len(rows)) <= _MOST_DIGITS
    if numbers and int(columns) >= 3 and int(rows) >= 3:
        return int(columns), int(rows)
    raise InputError(
        f"--board is {board[:40]!r}, and has to name inner corners, from 3x3 to 99x99",
        "count inner corners, for example --board 9x6",
    )


def _describe_markers(square_mm: float, charuco: str | None, marker_mm: float | None) -> Any:
    """Return what makes the board a ChArUco board, or None. Raises `InputError` for what does not go together."""
    from labrig.vision.calibrate_lens import Charuco

    if not square_mm > 0:
        raise InputError(
            f"--square-mm is {square_mm:g}, and has to be above 0", "measure the side of a square"
        )
    if (charuco is None) != (marker_mm is None):
        raise InputError(
            "--charuco and --marker-mm belong together", "for example --charuco DICT_5X5_100 --marker-mm 12"
        )
    return None if charuco is None or marker_mm is None else Charuco(charuco, marker_mm / square_mm)


def _read_views(images: list[Path]) -> tuple[list[tuple[str, Any]], list[Any]]:
    """Return the pictures that can be read, by name, and a view for each of the others that says why it cannot.

    Raises
    ------
    InputError
        If none can be read.
    """
    from labrig.vision.intrinsics import ViewResidual
    from labrig.vision.picture import read_picture

    pictures: list[tuple[str, Any]] = []
    unread: list[Any] = []
    first = PictureError("")
    for path in images:
        try:
            pictures.append((path.name, read_picture(path)))
        except PictureError as error:
            first = first if unread else error
            reason = f"{error.message}: {error.hint}"
            unread.append(ViewResidual(path.name, None, used=False, reason=reason))
    if not pictures:
        raise InputError(f"none of the {len(images)} pictures can be read: {first.message}", first.hint)
    return pictures, unread


def _print_intrinsics(document: dict[str, Any]) -> None:
    print_line("accepted" if document["accepted"] else "refused")
    for reason in document["reasons"]:
        print_line(f"  {reason}")
    for name in ("fx", "fy", "cx", "cy"):
        sigma = document["sigma"][name]
        print_line(
            f"{name}  {document[name]:9.3f} px" + ("" if sigma is None else f"  ± {sigma:.3f} (1 sigma)")
        )
    if document["sigma"]["fx"] is not None:
        print_line(f"1 sigma is {document['sigma_sentence']}")
    print_line("k1 k2 p1 p2 k3  " + " ".join(f"{value:.5f}" for value in document["distortion"]))
    held_out = document["holdout_rms_px"]
    print_line(
        f"residual {document['rms_px']:.3f} px rms"
        + ("" if held_out is None else f", held out {held_out:.3f} px rms")
    )
    for told in ("effect", "board_warp"):
        if document[told] is not None:
            print_line(document[told]["sentence"])
    for view in document["views"]:
        state = f"{view['rms_px']:.3f} px" if view["used"] else f"left out: {view['reason']}"
        print_line(f"  {view['image']}  {state}")
