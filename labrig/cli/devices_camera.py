"""`labrig devices camera`: the camera's picture with scores, to set up focus, light and view."""

from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import RigOption, find_rig_file
from labrig.cli.output import AsJson
from labrig.errors import InputError

_SHEATH_MM = 2.0


def camera(
    rig: RigOption = None,
    web: Annotated[
        bool,
        typer.Option(
            "--web", help="Show the picture in a browser too, on this computer alone, until interrupted."
        ),
    ] = False,
    port: Annotated[
        int | None,
        typer.Option(min=1, max=65_535, help="Port of the page. Default: a free one.", show_default=False),
    ] = None,
    pictures: Annotated[
        int | None,
        typer.Option(
            "--pictures",
            min=1,
            max=100_000,
            help="Take so many pictures and end. Default: until interrupted; with --json, --save or without a "
            "terminal 16.",
            show_default=False,
        ),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png",
            help="Write the last picture to a new file, as a test frame.",
            show_default=False,
        ),
    ] = None,
    sheath_diameter_mm: Annotated[
        float,
        typer.Option(help="Outer diameter of the sheath that is searched, within a factor of about 1.5."),
    ] = _SHEATH_MM,
    as_json: AsJson = False,
) -> int:
    """Exit with 1 when a score of the last picture is beyond its limit, and with 130 when interrupted."""
    from labrig.cli.camera_view import CameraOrder, view_camera
    from labrig.devices.rig_file import load_rig

    if port is not None and not web:
        raise InputError("--port belongs to --web", "give --web, or leave it out")
    if not 0 < sheath_diameter_mm < 100:
        raise InputError(
            f"--sheath-diameter-mm is {sheath_diameter_mm:g}, and has to be above 0 and below 100",
            "measure the sheath",
        )
    order = CameraOrder(
        load_rig(find_rig_file(rig)), web, port or 0, pictures, save, sheath_diameter_mm, as_json
    )
    return view_camera(order)
