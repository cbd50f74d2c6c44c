"""`labrig calibrate plane`: finds the map from pixels to mm in the steering plane."""

from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.calibration_files import ForceOption, OutOption, report_refusal, require_writable
from labrig.cli.options import CameraMovedOption, InsertionOption, IntrinsicsOption
from labrig.cli.output import AsJson
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
from labrig.errors import CalibrationRefusedError

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
        return report_refusal(refusal, NO_PLANE, as_json)
    compared = compare_scale(found, last, rig, camera_moved=camera_moved)
    pictures = [path for path in (image, through_gel) if path is not None]
    return finish_plane(compared, pictures, out, force=force, as_json=as_json)
