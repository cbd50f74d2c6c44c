"""`labrig calibrate`: camera intrinsics, plane map and tip template, and adopting the result of a calibration run."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from labrig.cli.calibration_files import (
    ForceOption,
    OutOption,
    collect_calibration_provenance,
    report_output,
    require_writable,
)
from labrig.cli.damage import require_undamaged
from labrig.cli.options import (
    InsertionOption,
    IntrinsicsOption,
    RigOption,
    RunArgument,
    find_rig_file,
)
from labrig.cli.output import AsJson, failure_lines, print_json, print_line, say
from labrig.cli.progress import show_working
from labrig.cli.surface_options import (
    GelDepthOption,
    GelDepthSigmaOption,
    GelIndexOption,
    GelIndexSigmaOption,
    LayerOption,
    PaperOption,
    PaperSigmaOption,
    TelecentricOption,
    ThroughOption,
    TiltOption,
    TiltSigmaOption,
)
from labrig.cli.template import template
from labrig.durable import write_atomically
from labrig.errors import CalibrationRefusedError, InputError, RecordError
from labrig.input_file import read_file

_MOST_DIGITS = 2

CameraMovedOption = Annotated[
    bool,
    typer.Option(
        "--camera-moved",
        help="The camera, its lens or the height of the paper was changed since the last plane map, so "
        "its scale may be another one.",
    ),
]

app = typer.Typer(no_args_is_help=True)


app.command("template", help="Cut a template of the needle's tip out of a recorded frame or a picture.")(
    template
)


@app.command(
    "intrinsics",
    help="Find intrinsics and distortion from photographs of a chessboard, ChArUco board or AprilGrid.",
)
def intrinsics(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGES...", help="Photographs of the board.")],
    board: Annotated[
        str, typer.Option(metavar="COLUMNSxROWS", help="Inner corners, e.g. 9x6; tags of an AprilGrid.")
    ],
    square_mm: Annotated[float, typer.Option(help="Side of a square, or of a tag of an AprilGrid.")],
    charuco: Annotated[
        str | None,
        typer.Option(
            metavar="DICTIONARY", help="Dictionary of a ChArUco board, e.g. DICT_5X5_100.", show_default=False
        ),
    ] = None,
    marker_mm: Annotated[
        float | None, typer.Option(help="Side of a ChArUco board's marker.", show_default=False)
    ] = None,
    tag_spacing: Annotated[
        float | None,
        typer.Option(
            help="Gap between the tags of an AprilGrid over their side, tagSpacing of Kalibr.",
            show_default=False,
        ),
    ] = None,
    partial: Annotated[
        bool, typer.Option("--partial", help="The pictures may show only a part of the chessboard.")
    ] = False,
    model: Annotated[
        Literal["brown", "zhang"],
        typer.Option(help="brown: five distortion coefficients; zhang: two and a skew."),
    ] = "brown",
    window_px: Annotated[
        int | None,
        typer.Option(help="Half side of the corner window.", show_default="a third of the spacing"),
    ] = None,
    out: OutOption = None,
    force: ForceOption = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 1 when the calibration is refused."""
    from labrig.cli.lens import draw_figure, make_board_search, name_figure, read_views
    from labrig.vision.calibration_file import save_intrinsics
    from labrig.vision.zhang import calibrate_from_pictures

    require_writable(out, force)
    require_writable(name_figure(out), force)
    columns, rows = _read_board_size(board)
    if not square_mm > 0:
        raise InputError(
            f"--square-mm is {square_mm:g}, and has to be above 0", "measure the side of a square"
        )
    search = make_board_search(charuco, marker_mm, square_mm, partial, window_px, tag_spacing)
    pictures, unread = read_views(images)
    try:
        found = calibrate_from_pictures(pictures, columns, rows, square_mm, search=search, model=model)
    except CalibrationRefusedError as refusal:
        return _refuse(refusal, NO_INTRINSICS, as_json)
    found = replace(found, views=(*found.views, *unread))
    if out is not None and (found.accepted or force):
        save_intrinsics(out, found, collect_calibration_provenance(images))
        draw_figure(out, found)
    document = found.to_json()
    if as_json:
        print_json(document)
    else:
        _print_intrinsics(document)
        if found.board_warp is not None:
            print_line(found.board_warp.sentence())
        _print_views(document)
    report_output(out, found.accepted, force)
    return 0 if found.accepted else 1


@app.command(
    "plane", help="Find the map from pixels to mm in the steering plane from a picture of graph paper."
)
def plane(
    image: Annotated[
        Path, typer.Argument(metavar="IMAGE", help="Picture of graph paper in the steering plane.")
    ],
    origin_px: Annotated[
        tuple[float, float], typer.Option(metavar="U V", help="Pixel of the plane's origin.")
    ],
    insertion: InsertionOption,
    pitch_mm: Annotated[float, typer.Option(help="Distance between the finest lines.")] = 1.0,
    intrinsics: IntrinsicsOption = None,
    index: GelIndexOption = None,
    depth_mm: GelDepthOption = None,
    paper_at: PaperOption = "needle",
    index_sigma: GelIndexSigmaOption = None,
    depth_sigma_mm: GelDepthSigmaOption = None,
    layer: LayerOption = None,
    tilt_deg: TiltOption = (0.0, 0.0),
    tilt_sigma_deg: TiltSigmaOption = None,
    through_gel: ThroughOption = None,
    paper_sigma_mm: PaperSigmaOption = None,
    telecentric: TelecentricOption = False,
    rig: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Rig file, with whose plane map the scale is compared. Default: $LABRIG_RIG, else the file that --out "
            "replaces.",
            show_default=False,
        ),
    ] = None,
    camera_moved: CameraMovedOption = False,
    out: OutOption = None,
    force: ForceOption = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 1 when the calibration is refused."""
    from labrig.cli.last_plane import find_last_plane, require_picture_of_rig
    from labrig.cli.plane_output import compare_scale, finish_plane
    from labrig.cli.surface import SurfaceOptions
    from labrig.vision.calibration_file import load_intrinsics
    from labrig.vision.picture import read_picture
    from labrig.vision.plane_calibration import calibrate_plane

    surface = SurfaceOptions(
        index, depth_mm, paper_at, index_sigma, depth_sigma_mm, layer, tilt_deg, tilt_sigma_deg, through_gel
    )
    gel = surface.make_gel(camera_known=intrinsics is not None or telecentric)
    require_writable(out, force)
    last = find_last_plane(rig, out)
    camera = None if intrinsics is None else load_intrinsics(intrinsics)
    picture, through = read_picture(image), surface.read_seen_through()
    require_picture_of_rig(picture, rig)
    try:
        with show_working("finding the lines of the paper", shown=not as_json):
            found = calibrate_plane(
                picture,
                camera,
                pitch_mm,
                origin_px,
                insertion,
                gel=gel,
                through=through,
                paper_sigma_mm=paper_sigma_mm,
                telecentric=telecentric,
            )
    except CalibrationRefusedError as refusal:
        return _refuse(refusal, NO_PLANE, as_json)
    compared = compare_scale(found, last, rig, camera_moved=camera_moved)
    pictures = [path for path in (image, through_gel) if path is not None]
    return finish_plane(compared, pictures, out, force=force, as_json=as_json)


@app.command("adopt", help="Copy the calibration of a run of protocols/calibration.yaml to the rig's files.")
def adopt(
    run_path: RunArgument,
    rig: RigOption = None,
    camera_moved: CameraMovedOption = False,
    force: ForceOption = False,
    as_json: AsJson = False,
) -> None:
    """Without --force, adopt no refused calibration and replace no file."""
    from labrig.cli.last_plane import compare_with_file, explain_no_comparison, require_confirmed
    from labrig.devices.rig_file import load_rig
    from labrig.experiments.registry import load_run_result
    from labrig.record.reader import open_run
    from labrig.vision.calibration_file import load_intrinsics, load_plane

    run = open_run(run_path, read_pictures=True)
    require_undamaged(run.path, run.damage)
    result = load_run_result(run)
    if result is None or not {"intrinsics.json", "plane.json"} <= {
        path.name for path in result.path.iterdir()
    }:
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
    moved = camera_moved or result.document["settings"]["plane"].get("camera_moved", False)
    comparison = compare_with_file(found, targets.get("plane.json"), camera_moved=moved)
    require_confirmed(run_path.name, comparison)
    for name, path in targets.items():
        write_atomically(path, read_file(result.path / name))
    written = [str(path) for path in targets.values()]
    if as_json:
        compared = None if comparison is None else asdict(comparison)
        told = {"written": written, "view": found.view_sentence(), "scale_comparison": compared}
        print_json({"run": str(run_path), **told})
        return
    uncompared = explain_no_comparison(rig_file, camera_moved=camera_moved)
    compared_with = uncompared if comparison is None else comparison.sentence
    for line in filter(None, (*written, found.view_sentence(), compared_with)):
        print_line(line)


def _read_board_size(board: str) -> tuple[int, int]:
    """Read `9x6` as nine columns and six rows of inner corners."""
    columns, _, rows = board.lower().partition("x")
    if columns.isdecimal() and rows.isdecimal() and max(len(columns), len(rows)) > _MOST_DIGITS:
        raise InputError(f"--board is {board[:40]!r}, at most 99x99 are searched for", "count inner corners")
    if columns.isdecimal() and rows.isdecimal() and int(columns) >= 3 and int(rows) >= 3:
        return int(columns), int(rows)
    raise InputError(
        f"--board is {board!r}, and has to name inner corners, or tags of an AprilGrid, at least 3x3",
        "for example --board 9x6",
    )


NO_INTRINSICS: dict[str, object] = {
    **dict.fromkeys(("fx", "fy", "cx", "cy", "sigma", "distortion", "rms_px", "holdout_rms_px")),
    "views": [],
}
NO_PLANE: dict[str, object] = dict.fromkeys(
    (
        "rms_mm",
        "holdout_rms_mm",
        "mm_per_px",
        "picture_mm",
        "camera_distance_mm",
        "view",
        "scale_comparison",
    )
)


def _refuse(refusal: CalibrationRefusedError, nothing: dict[str, object], as_json: bool) -> int:
    """Report a calibration without any numbers; unknown values are null."""
    if as_json:
        print_json({"accepted": False, "reasons": [refusal.message], **nothing})
    for line in failure_lines(refusal):
        say(line)
    return refusal.exit_code


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
    if document["skew"]:
        print_line(f"skew {document['skew']:.5f} px")
    held_out = document["holdout_rms_px"]
    print_line(
        f"residual {document['rms_px']:.3f} px rms"
        + ("" if held_out is None else f", held out {held_out:.3f} px rms")
    )


def _print_views(document: dict[str, Any]) -> None:
    for view in document["views"]:
        state = f"{view['rms_px']:.3f} px" if view["used"] else f"left out: {view['reason']}"
        print_line(f"  {view['image']}  {state}")
