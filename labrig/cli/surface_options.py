"""The options of `labrig calibrate plane` that describe what lies between camera and needle."""

from pathlib import Path
from typing import Annotated, Literal

import typer

GelIndexOption = Annotated[
    float | None,
    typer.Option(
        "--gel-index", help="Refractive index of the gel above the needle; about 1.35.", show_default=False
    ),
]
GelIndexSigmaOption = Annotated[
    float | None, typer.Option("--gel-index-sigma", help="Its standard deviation.", show_default=False)
]
GelDepthOption = Annotated[
    float | None,
    typer.Option("--gel-depth-mm", help="Depth of the needle below the gel's surface.", show_default=False),
]
GelDepthSigmaOption = Annotated[
    float | None, typer.Option("--gel-depth-sigma-mm", help="Its standard deviation.", show_default=False)
]
LayerOption = Annotated[
    list[str] | None,
    typer.Option(
        "--layer",
        metavar="MATERIAL:MM[:SIGMA_MM]",
        help="A wall or gap between camera and gel, e.g. glass:3:0.1; acrylic, polycarbonate, air or an index. "
        "Repeatable, from the camera to the gel.",
        show_default=False,
    ),
]
TiltOption = Annotated[
    tuple[float, float],
    typer.Option(
        "--tilt-deg", metavar="Y Z", help="By how much the surface rises towards the camera along +y and +z."
    ),
]
TiltSigmaOption = Annotated[
    float | None, typer.Option("--tilt-sigma-deg", help="Its standard deviation.", show_default=False)
]
ThroughOption = Annotated[
    Path | None,
    typer.Option(
        "--through-gel",
        metavar="FILE",
        help="The same paper in the same place through the gel: measures the tilt and, of depth and index, the one "
        "that is not given.",
        show_default=False,
    ),
]
PaperOption = Annotated[
    Literal["needle", "surface", "gel"],
    typer.Option(
        "--paper-at",
        help="Where the paper was: in air in the needle's place, in air on the outermost surface, or in the gel.",
    ),
]
PaperSigmaOption = Annotated[
    float | None,
    typer.Option(
        "--paper-sigma-mm",
        help="Standard deviation of the paper's height over the needle's plane.",
        show_default=False,
    ),
]
TelecentricOption = Annotated[
    bool,
    typer.Option("--telecentric", help="The lens is telecentric: no perspective, and no intrinsics."),
]
